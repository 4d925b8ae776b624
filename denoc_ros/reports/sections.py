"""Sections of a report: a heading, text, figures and tables."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.bags.run import Diagnostic, RecordedTopics
from denoc_ros.bags.series import Series
from denoc_ros.model.joint_units import Units
from denoc_ros.pages.figures import Curve, Ink, Panel, histogram_figure, line_figure
from denoc_ros.pages.html_page import UNKNOWN, PageSection, PageTable, engineering
from denoc_ros.pages.loop_timing import LoopMeasure, NodeWarnings
from denoc_ros.reports.measures import (
    SETTLED,
    Deflection,
    PhaseMeasures,
    deflection_error,
    peak,
    rms,
)
from denoc_ros.types import Array

FOLDERS = re.compile(r'(?<![\w.:/])/(?:[^\s/:\'"]+/)+')
HIDDEN_KEYS = ('histogram_edges', 'histogram_counts')
FLOOR = 1e-5  # m: what is less is drawn as this
AVERAGED = 0.05  # s over which the distance is averaged in the figure


def failure(text: str) -> PageSection | None:
    """Return the section on why a session ended before its end, None where it did not.

    Parameters
    ----------
    text : str
        The cause, and below it the last words of the process that failed; '' if nothing failed.
    """
    if not text:
        return None
    cause, *words = without_folders(text).splitlines()
    return PageSection(
        'Why the session ended',
        f'{cause}. All that was recorded until then is below; logs/ has the output of each node.',
        tables=[PageTable(['last words'], [[line.strip()] for line in words])] if words else [],
    )


def notes(texts: Sequence[str]) -> PageSection | None:
    """Return the section on what a session has noted, None where it has nothing."""
    if not texts:
        return None
    return PageSection('Notes of the session', ' '.join(f'{without_folders(t)}.' for t in texts))


def without_folders(text: str) -> str:
    """Return a text with files by their names only: a page tells nobody's folders."""
    return FOLDERS.sub('', text)


def tracking(phases: Sequence[PhaseMeasures], units: Units) -> PageSection | None:
    """Return the section on joint and tip tracking errors."""
    shown = [(k, phase) for k, phase in enumerate(phases) if phase.error is not None]
    if not shown:
        return None
    panels = _by_column([(k, p.name, p.error) for k, p in shown], units.position)
    errors = [(phase.name, phase.error) for _, phase in shown]
    rows = _compared(errors, units.position)
    return PageSection(
        'Tracking error',
        'Reference minus measured position of each joint. A feedforward of the flexible model '
        'makes the joints follow: the links still swing, and the tip with them.',
        [line_figure(panels)],
        [PageTable(_compared_head([name for name, _ in errors]), rows)],
    )


def deflection(phases: Sequence[PhaseMeasures]) -> PageSection | None:
    """Return the section on predicted over true deflection."""
    figures, rows = [], []
    predicted = any(e.predicted is not None for phase in phases for e in phase.deflections)
    for k, phase in enumerate(phases):
        if not phase.deflections:
            continue
        panels = [
            Panel(
                _deflection_title(entry.name, phase.name, len(phases) > 1),
                entry.unit,
                _deflection_curves(entry, colour_of(k)),
            )
            for entry in phase.deflections
        ]
        figures.append(line_figure(panels))
        rows += [_deflection_row(phase.name, entry, predicted) for entry in phase.deflections]
    if not figures:
        return None
    head = ['phase', 'deflection', 'peak']
    text = 'Tip deflection in the beam frame'
    if predicted:
        head += ['error rms', 'of peak']
        judged = any(e.true is not None for phase in phases for e in phase.deflections)
        beside = 'over the true one of the plant' if judged else '(no truth to compare with here)'
        text += f' as the predictor has it, {beside}'
    return PageSection(
        'Deflection of the flexible links', f'{text}.', figures, [PageTable(head, rows)]
    )


def _deflection_curves(entry: Deflection, colour: str) -> list[Curve]:
    curves = []
    if entry.true is not None:
        curves.append(Curve('true (plant)', Ink.TRUTH, entry.t, entry.true))
    if entry.predicted is not None:
        curves.append(Curve('predicted', colour, entry.t, entry.predicted, True))
    if entry.error is not None:
        curves.append(Curve('difference', Ink.DIFFERENCE, entry.t, entry.error))
    return curves


def _deflection_row(phase: str, entry: Deflection, predicted: bool) -> list[str]:
    shown = entry.predicted if entry.true is None else entry.true
    row = [phase, entry.name, UNKNOWN if shown is None else engineering(peak(shown), entry.unit)]
    error = deflection_error(entry)
    if error is not None:
        return [*row, engineering(error['rms'], entry.unit), f'{error["percent_of_peak"]:.2g} %']
    return [*row, UNKNOWN, UNKNOWN] if predicted else row


def torque(phases: Sequence[PhaseMeasures], units: Units) -> PageSection | None:
    """Return the section on the torque that was commanded, or else recorded with the states."""
    commanded = [(k, p.name, p.torque) for k, p in enumerate(phases) if p.torque is not None]
    recorded = [(k, p.name, p.effort) for k, p in enumerate(phases) if p.effort is not None]
    shown = commanded or recorded
    if not shown:
        return None
    panels = _by_column(shown, units.effort)
    title, text = 'Feedforward torque', 'What the feedforward node commanded.'
    if not commanded:
        title, text = 'Torque', 'Effort of the joints as recorded with their states.'
    elif len(phases) == 1 and phases[0].effort is not None:
        panels = [_beside(panel, phases[0].effort) for panel in panels]
        text = 'What the feedforward node computed, and the effort measured beside it.'
    torques = [(name, series) for _, name, series in shown]
    head = _compared_head([name for name, _ in torques])
    return PageSection(
        title, text, [line_figure(panels)], [PageTable(head, _compared(torques, units.effort))]
    )


def motion(phases: Sequence[PhaseMeasures], units: Units) -> PageSection | None:
    """Return the section on the measured motion, for runs that show no tracking error."""
    shown = [
        (k, p.name, p.joints)
        for k, p in enumerate(phases)
        if p.joints is not None and p.error is None
    ]
    if not shown:
        return None
    panels = _by_column(shown, units.position)
    return PageSection('Joint motion', 'Positions as recorded.', [line_figure(panels, 1.5)])


def loops(measures: Sequence[LoopMeasure]) -> PageSection | None:
    """Return the section on how evenly the nodes' loops ran."""
    if not measures:
        return None
    rows = [
        [
            loop.node,
            f'{1.0 / loop.nominal:g} Hz',
            engineering(loop.median, 's'),
            engineering(loop.p99, 's'),
            engineering(loop.longest, 's'),
            f'{loop.ticks}',
            f'{loop.late} ({100.0 * loop.late / max(loop.ticks, 1):.2g} %)',
            f'{loop.skipped}',
        ]
        for loop in measures
    ]
    head = ('node', 'rate', 'median', 'p99', 'longest', 'ticks', 'late by > ½ period', 'skipped')
    return PageSection(
        'Loop periods',
        'Time between ticks from the first phase on, by each node itself; median and p99 are of '
        'the last second.',
        [histogram_figure(measures)],
        [PageTable(head, rows)],
    )


def warned(found: Mapping[str, NodeWarnings]) -> PageSection | None:
    """Section of the nodes' warnings."""
    if not found:
        return None
    rows = [
        [name, str(each.times), each.last, ', '.join(each.phases)]
        for name, each in sorted(found.items())
    ]
    table = PageTable(('status', 'times', 'last', 'phases'), rows)
    return PageSection('Warnings', 'Each node reports once a second on /diagnostics.', [], [table])


def nodes(statuses: Iterable[Diagnostic]) -> PageSection | None:
    """Return the section with the nodes' last words on /diagnostics."""
    last = {status.name: status for status in statuses}
    if not last:
        return None
    tables = [
        PageTable(
            ('key', 'value'),
            [
                [key, _without_folder(value, status)]
                for key, value in status.values.items()
                if key not in HIDDEN_KEYS
            ],
            folded=True,
            title=f'{name} — {_without_folder(status.message, status)}',
        )
        for name, status in sorted(last.items())
    ]
    return PageSection(
        'Node statistics', 'The last status of each node on /diagnostics.', [], tables
    )


def _without_folder(text: str, status: Diagnostic) -> str:
    """Return a text of a status with the file that it writes by its name only."""
    path = status.values.get('path', '')
    return text.replace(path, Path(path).name) if path else text


def topics(recording: RecordedTopics) -> PageSection:
    """Section of the bag's topics."""
    counts = recording.counts
    rows = [[name, kind, str(counts[name])] for name, kind in sorted(recording.topics.items())]
    text = f'{recording.path.name}: {sum(counts.values())} messages.'
    return PageSection(
        'Recorded topics', text, [], [PageTable(('topic', 'type', 'messages'), rows)]
    )


def _by_column(
    shown: Sequence[tuple[int, str, Series | None]], unit: Callable[[str], str]
) -> list[Panel]:
    """Return one panel per column name, with a curve for each phase that has it."""
    names = dict.fromkeys(name for _, _, s in shown if s is not None for name in s.names)
    return [
        Panel(
            name,
            unit(name),
            [
                Curve(phase, colour_of(k), series.t, series.column(name))
                for k, phase, series in shown
                if series is not None and name in series.names
            ],
        )
        for name in names
    ]


def _compared_head(names: Sequence[str]) -> list[str]:
    """Return the heading of a table of rms and largest value, phase beside phase."""
    of = [f'{name}: ' for name in names] if len(names) > 1 else ['']
    return ['joint', *(f'{name}{what}' for name in of for what in ('rms', 'largest'))]


def _compared(
    shown: Sequence[tuple[str, Series | None]], unit: Callable[[str], str]
) -> list[list[str]]:
    """Return one row per column name: rms and largest value in each phase."""
    names = dict.fromkeys(name for _, s in shown if s is not None for name in s.names)
    rows = []
    for name in names:
        row = [name]
        for _, series in shown:
            values = series.column(name) if series and name in series.names else None
            for measure in (rms, peak):
                row.append(UNKNOWN if values is None else engineering(measure(values), unit(name)))
        rows.append(row)
    return rows


def _beside(panel: Panel, effort: Series) -> Panel:
    """Return a torque panel with the measured effort of its joint under the computed one."""
    if panel.title not in effort.names:
        return panel
    measured = Curve('measured', Ink.DIFFERENCE, effort.t, effort.column(panel.title))
    computed = [dataclasses.replace(curve, label='computed') for curve in panel.curves]
    return dataclasses.replace(panel, curves=[measured, *computed])


def _deflection_title(name: str, phase: str, several: bool) -> str:
    link, _, component = name.rpartition('/')
    kind = {'u': 'deflection along', 'r': 'turn about'}[component[0]]
    return f'{link}, {kind} {component[1]}' + (f' ({phase})' if several else '')


def identified(phases: Sequence[Mapping[str, Any]]) -> PageSection | None:
    """Return the section on numbers that a session has identified, None where there are none.

    Parameters
    ----------
    phases : sequence of mapping
        As session.json has them.
    """
    tables, whose = [], []
    for phase in phases:
        found = phase.get('identified')
        if not found:
            continue
        plant = phase.get('plant', {})
        rows = [
            [
                one['path'],
                f'{one["start"]:.5g}',
                f'{one["value"]:.5g}',
                _interval(one['interval']),
                _true_number(plant, one['path']),
                one['verdict'],
            ]
            for one in found['numbers']
        ]
        head = ('number', 'assumed', 'found', '95 % interval', 'true', 'verdict')
        tables.append(PageTable(head, rows))
        whose.append(f'“{found["from"]}” for “{phase["name"]}”')
    if not tables:
        return None
    text = (
        'What the recording of a phase told of the robot for the plan of a later one: '
        f'{", ".join(whose)}. Numbers that are not identifiable stayed as assumed. SI units.'
    )
    return PageSection('Numbers identified', text, tables=tables)


def _interval(ends: Sequence[float | None]) -> str:
    low, high = ends
    return UNKNOWN if low is None or high is None else f'{low:.5g} … {high:.5g}'


def _true_number(plant: Mapping[str, Any], path: str) -> str:
    """Return the plant's number at a path, where the session says it."""
    head, _, axis = path.rpartition('.')
    value = plant.get(path, plant.get(head) if axis in AXES else None)
    if isinstance(value, list):
        value = value[AXES.index(axis) if axis in AXES else 0]
    return UNKNOWN if value is None else f'{value:.5g}'


AXES = ('x', 'y', 'z')


def colour_of(k: int) -> str:
    """Return the colour of the phase at a place: the same in every figure."""
    return Ink.PHASES[k % len(Ink.PHASES)]


def tip(phases: Sequence[PhaseMeasures]) -> PageSection | None:
    """Return the section on the tip's distance from where it was asked to be."""
    shown = [(k, phase) for k, phase in enumerate(phases) if phase.tip_error is not None]
    if not shown:
        return None
    return PageSection(
        'Tip',
        'Distance of the deflected tip from where the undeformed robot on the motion that was '
        'asked for would have it. Each value is the rms over '
        f'{AVERAGED:g} s. A feedforward of the flexible model alone makes the joints follow, and '
        'the tip swings; a reference that is shaped moves the joints so that the tip follows.',
        [line_figure([tip_panel([phase for _, phase in shown], [k for k, _ in shown])], 2.6)],
        [PageTable(TIP_HEAD, [_tip_row(phase) for _, phase in shown])],
    )


TIP_HEAD = (
    'phase',
    'moving: rms',
    'largest',
    'after the stop: largest',
    f'from {SETTLED:g} s after it',
)


def tip_panel(phases: Sequence[PhaseMeasures], colours: Sequence[int]) -> Panel:
    """Return the tip's distance over time in phases that have one, on a logarithmic axis."""
    curves = []
    for phase, colour in zip(phases, colours, strict=True):
        assert phase.tip_error is not None
        t, distance = averaged(phase.tip_error.t, phase.tip_error.values[:, 0])
        curves.append(Curve(phase.name, colour_of(colour), t, np.maximum(distance, FLOOR)))
    (frame,) = {phase.tip_error.names[0] for phase in phases if phase.tip_error is not None}
    return Panel(f'{frame}: distance from where it was asked to be', 'm', curves, log_y=True)


def averaged(t: Array, distance: Array) -> tuple[Array, Array]:
    """Return the rms of distances (k,) over stretches of `AVERAGED` s, and their middles [s]."""
    stretch = np.floor((t - t[0]) / AVERAGED).astype(np.intp)
    _, stretch, counts = np.unique(stretch, return_inverse=True, return_counts=True)
    squares = np.bincount(stretch, distance**2) / counts
    return np.bincount(stretch, t) / counts, np.sqrt(squares)


def _tip_row(phase: PhaseMeasures) -> list[str]:
    moving, swing, settled = phase.moving, phase.swing, phase.settled
    if moving is None or not len(moving):  # it stands from the start
        assert phase.tip_error is not None
        moving = phase.tip_error.values[:, 0]
    after = (
        UNKNOWN if part is None else engineering(peak(part), 'm') for part in (swing, settled)
    )
    return [phase.name, engineering(rms(moving), 'm'), engineering(peak(moving), 'm'), *after]
