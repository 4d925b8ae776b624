"""The page of `denoc replay`: computed and measured values, and the share of each term."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.model.joint_units import Units
from denoc_ros.pages.figures import Curve, Ink, Panel, line_figure
from denoc_ros.pages.html_page import (
    UNKNOWN,
    Card,
    PageSection,
    PageTable,
    ReportPage,
    Verdict,
    engineering,
)
from denoc_ros.simulation.recorded.adapted import NORMAL
from denoc_ros.simulation.recorded.compared import MEASURED
from denoc_ros.simulation.recorded.replay_bag import Replay
from denoc_ros.simulation.recorded.replay_summary import parts_of
from denoc_ros.simulation.recorded.residual_friction import TERMS
from denoc_ros.simulation.recorded.run_files import recording_name
from denoc_ros.simulation.recorded.run_snapshots import SHOWN_COMPONENTS, notable_deflections
from denoc_ros.text_table import cell_text
from denoc_ros.units import deflection_unit

Look = tuple[str, bool]  # colour, dashed
Summary = Mapping[str, Any]

LOOKS: Mapping[str, Look] = {
    MEASURED: (Ink.DIFFERENCE, False),
    'rigid': (Ink.PHASES[0], True),
    'flexible': (Ink.PHASES[1], True),
}
DEFLECTION_LOOKS = ((Ink.TRUTH, False), (Ink.PHASES[2], False), (Ink.PHASES[1], True))


def page(
    replay: Replay, summary: Summary, robot: Robot, provenance: Mapping[str, str]
) -> ReportPage:
    """Return the page of a replay."""
    units = Units.of(robot.tree)
    path = replay.plan.source.path
    return ReportPage(
        title=f'Replay of {recording_name(path)}',
        subtitle=f'{path.name} · {robot.tree.name} · {replay.duration:.4g} s · '
        f'{summary["derivative"]}, {summary["cutoff_hz"]:.3g} Hz',
        verdict=_verdict(summary),
        cards=_cards(summary),
        sections=[
            _torque(replay, summary, units),
            _shares(summary),
            _friction(summary, units),
            _deflection(replay, summary),
            _adapted(replay),
            _said('Doubtful', summary['doubts']),
            _said('Notes', summary['notes']),
            _what(summary, robot),
        ],
        provenance=provenance,
    )


def _verdict(summary: Summary) -> Verdict:
    if summary['doubts']:
        return Verdict(f'{"; ".join(summary["doubts"])}.', 'doubtful')
    found = [
        f'the error of the {model} model is {share} % of the measured effort{_in(phase)}'
        for phase, model, share in _missed(summary)
    ]
    if worst := _worst_deflections(summary):
        percent, name, topic, phase = max(worst)
        found.append(
            f'deflection agrees with {topic} to {percent:.2g} % of its peak ({name}){_in(phase)}'
        )
    text = '; '.join(found) or f'{summary["samples"]} joint states replayed, none with an effort'
    return Verdict(f'{text[0].upper()}{text[1:]}.')


def _in(phase: str) -> str:
    return f' in {phase}' if phase else ''


def _missed(summary: Summary) -> list[tuple[str, str, str]]:
    """Return phase, model and unexplained share of the effort, rms of all joints [%], in words.

    Of several phases those count in which the plant was the model; the worst one is named.
    """
    found: dict[str, tuple[float, str]] = {}
    for phase, part in _judged(summary).items():
        for model, joints in part['torque'].items():
            square = sum(one['rms'] ** 2 for one in joints.values())
            whole = sum(one['measured_rms'] ** 2 for one in joints.values())
            if whole:
                share = 100.0 * (square / whole) ** 0.5
                found[model] = max(found.get(model, (0.0, '')), (share, phase))
    return [
        (phase, model, f'{float(f"{share:.3g}"):g}') for model, (share, phase) in found.items()
    ]


def _judged(summary: Summary) -> dict[str, Summary]:
    """Return the phases whose plant was the model; all where there is none."""
    parts = parts_of(summary)
    return {name: part for name, part in parts.items() if not part.get('plant')} or parts


def _worst_deflections(summary: Summary) -> list[tuple[float, str, str, str]]:
    """Return by topic what agrees least: percent of the peak, deflection, topic, and phase."""
    found: dict[str, tuple[float, str, str, str]] = {}
    for phase, part in _judged(summary).items():
        for topic, agreements in part['deflection'].items():
            percents = [
                (_share_of_peak(one), name, topic, phase)
                for name, one in agreements.items()
                if one['measured_peak'] and name.rpartition('/')[2] in ('uy', 'uz')
            ]
            if percents:
                found[topic] = max([*percents, *([found[topic]] if topic in found else [])])
    return [*found.values()]


def _share_of_peak(agreement: Mapping[str, float]) -> float:
    """Return the error of a deflection as a percentage of its peak."""
    return 100.0 * agreement['rms'] / agreement['measured_peak']


def _cards(summary: Summary) -> list[Card]:
    cards = [Card('Joint states', f'{summary["samples"]}', summary['joint_states'])]
    for phase, model, share in _missed(summary):
        cards.append(Card(f'Off by, {model}', f'{share} %', f'of the effort, rms{_in(phase)}'))
    for percent, name, topic, phase in _worst_deflections(summary):
        where = f'{name} over {topic}{_in(phase)}'
        cards.append(Card('Deflection, worst', f'{percent:.2g} %', where))
    return cards


def _torque(replay: Replay, summary: Summary, units: Units) -> PageSection:
    traces = replay.torque_traces
    figures = []
    for model in (name for name in traces if name != MEASURED):
        shown = [MEASURED, model] if replay.torque else [model]
        panels = [
            Panel(
                joint,
                units.effort(joint),
                [
                    Curve(name, LOOKS[name][0], *traces[name].curve(joint), LOOKS[name][1])
                    for name in shown
                ],
            )
            for joint in replay.plan.joints
        ]
        figures.append(line_figure(panels))
    head = [*_phase_head(summary), 'joint', 'effort rms']
    head += [f'{m}: {what}' for m in summary['torque'] for what in ('rms', 'bias', 'lag')]
    rows = []
    for (phase, part), joint in product(parts_of(summary).items(), replay.plan.joints):
        models = [model[joint] for model in part['torque'].values() if joint in model]
        row = [*([phase] if phase else []), joint]
        for k, one in enumerate(models):
            row += [engineering(one['measured_rms'], units.effort(joint))] if k == 0 else []
            row += [
                engineering(one['rms'], units.effort(joint)),
                engineering(one['bias'], units.effort(joint)),
                UNKNOWN if one['lag'] is None else engineering(one['lag'], 's'),
            ]
        rows.append(row)
    title = 'torque: measured, and measured minus computed'
    return PageSection(
        'Torque',
        'Measured effort and that of the models for the recorded motion. rms and bias are of '
        'measured minus computed. A positive lag means that the measured effort is later, a dash '
        'that the two are too different.',
        figures,
        [PageTable(head, rows, title=title)] if summary['torque'] else [],
    )


def _shares(summary: Summary) -> PageSection:
    shares = summary['shares']
    rows = [
        [
            *([phase] if phase else []),
            joint,
            *(_percent(share[joint]) for share in part['shares'].values()),
        ]
        for (phase, part), joint in product(parts_of(summary).items(), summary['joints'])
    ]
    of = 'measured effort' if summary['torque'] else 'computed torque'
    return PageSection(
        'What explains it',
        f'Share of the {of}, mean square, that each term of the best model explains; a term that '
        'opposes it has a negative share. With the unexplained rest they add up to 100 %.',
        [],
        [
            PageTable(
                [*_phase_head(summary), 'joint', *shares],
                rows,
                title=f'shares of the {of}, mean square',
            )
        ],
    )


def _friction(summary: Summary, units: Units) -> PageSection | None:
    if summary['friction'] is None:
        return None
    head = ('joint', *TERMS, 'rms before', 'rms after', 'explained')
    rows = []
    for joint, fit in summary['friction'].items():
        cells = []
        for term in TERMS:
            formal, spread = (
                fit[f'standard_error_{kind}'][term] for kind in ('formal', 'by_window')
            )
            known = formal is not None and spread is not None
            errors = f' ± {spread:.2g} (formally {formal:.2g})' if known else ''
            cells.append(f'{fit[term]:.4g}{errors}')
        rms = [
            engineering(fit[f'rms_{when}'], units.effort(joint)) for when in ('before', 'after')
        ]
        rows.append([joint, *cells, *rms, _percent(fit['explained'])])
    return PageSection(
        'Friction, fitted',
        'viscous · rate + coulomb · tanh(rate / 1e-3) + offset, SI units, fitted to the '
        'residual of the model without joint friction, and used here. Standard errors assume '
        'residuals that are correlated over one second; those in brackets assume independent '
        'samples, which they are not.',
        [],
        [PageTable(head, rows, title='friction, fitted, SI units')],
    )


def _deflection(replay: Replay, summary: Summary) -> PageSection | None:
    shown = _shown(replay)
    if not shown:
        return None
    topics = [*(topic for topic in replay.deflection_traces if topic != 'replay'), 'replay']
    panels = [
        Panel(
            name,
            deflection_unit(name),
            [
                Curve(topic.strip('/'), colour, *replay.deflection_traces[topic].curve(name), dash)
                for topic, (colour, dash) in zip(topics, DEFLECTION_LOOKS, strict=False)
            ],
        )
        for name in shown
    ]
    rows = [
        [
            *([phase] if phase else []),
            topic,
            name,
            *(engineering(one[key], deflection_unit(name)) for key in ('measured_peak', 'rms')),
            f'{_share_of_peak(one):.2g} %' if one['measured_peak'] else UNKNOWN,
        ]
        for phase, part in parts_of(summary).items()
        for topic, agreements in part['deflection'].items()
        for name, one in agreements.items()
        if name in shown
    ]
    head = (
        *_phase_head(summary),
        'topic',
        'deflection',
        'peak',
        'replay off by, rms',
        'of the peak',
    )
    return PageSection(
        'Deflection of the flexible links',
        'Tip deflection in the beam frame along the recorded joint motion, beside that of the '
        'bag.',
        [line_figure(panels)],
        [PageTable(head, rows, title='deflection')] if rows else [],
    )


def _shown(replay: Replay) -> list[str]:
    """Return the deflections that matter, by their largest value among those of a kind."""
    traces = replay.deflection_traces['replay']
    names = [name for name in traces.names if name.rpartition('/')[2] in SHOWN_COMPONENTS]
    peaks = {name: float(np.nanmax(np.abs(traces.curve(name)[1]), initial=0.0)) for name in names}
    return notable_deflections(peaks)


def _adapted(replay: Replay) -> PageSection | None:
    found = replay.adapted
    if found is None:
        return None
    panels, rows = [], []
    for k, path in enumerate(found.paths):
        value, half = found.values[:, k], NORMAL * found.deviations[:, k]
        curves = [Curve('value', Ink.PHASES[0], found.t, value)]
        for side in (value - half, value + half):
            held = np.clip(side, *found.bounds[k])
            curves.append(Curve('95 % interval', Ink.TRUTH, found.t, held, dashed=True))
        panels.append(Panel(path, '', curves))
        last = f'{found.last[k]:.5g}' + (f' ± {half[-1]:.2g}' if len(half) else '')
        low, high = found.bounds[k]
        supported = 'yes' if found.supported[k] else 'no'
        rows.append([path, f'{found.start[k]:.5g}', last, supported, f'{low:.4g} to {high:.4g}'])
    title = 'tracked numbers, SI units (95 %)'
    title += f'; at the end: {found.cause}' if found.cause else ''
    return PageSection(
        'Tracked numbers',
        'Numbers of the model as the predictor tracks them with `adapt`, SI units, within their '
        'bounds. Values change only while the motion shows them. The rest of the model may be off '
        f'by {100.0 * found.model_error:.2g} % of its torques.',
        [line_figure(panels)] if len(found.t) else [],
        [PageTable(('number', 'start', 'last', 'supported', 'bounds'), rows, title=title)],
    )


def _phase_head(summary: Summary) -> list[str]:
    return ['phase'] if summary['phases'] else []


def _said(title: str, texts: Sequence[str]) -> PageSection | None:
    if not texts:
        return None
    return PageSection(title, '', [], [PageTable(('what',), [[text] for text in texts])])


def _what(summary: Summary, robot: Robot) -> PageSection:
    keys = ('joint_states', 'effort', 'samples', 'incomplete', 'repeated', 'motions', 'period_s')
    rows = [[key.replace('_', ' '), cell_text(summary[key])] for key in keys]
    for key in ('joints', 'held_joints', 'ignored_joints'):
        rows.append([key.replace('_', ' '), ', '.join(summary[key]) or UNKNOWN])
    rows += [[path, f'{value}'] for path, value in robot.tree.overrides.items()]
    return PageSection(
        'What was replayed',
        'The recording, the settings, and the changes of the robot.',
        [],
        [PageTable((), rows)],
    )


def _percent(share: float | None) -> str:
    return UNKNOWN if share is None else f'{100.0 * share:.1f} %'


def tables(shown: ReportPage) -> Iterator[str]:
    """Yield the titled tables of a page as text for the terminal."""
    for section in filter(None, shown.sections):
        yield from (table.text() for table in section.tables if table.title)
