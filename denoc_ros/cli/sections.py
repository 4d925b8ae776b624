"""The sections of a report: a heading, what it shows, figures and tables."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from denoc_ros.cli.figures import (
    DIFFERENCE_COLOUR,
    PHASE_COLOURS,
    TRUTH_COLOUR,
    Curve,
    Panel,
    histogram_figure,
    line_figure,
)
from denoc_ros.cli.measures import LoopMeasure, PhaseMeasures, peak, rms

if TYPE_CHECKING:
    from denoc_ros.bags.series import Diagnostic
    from denoc_ros.cli.recording import Recording, Series

PREFIXES = ((1e6, 'M'), (1e3, 'k'), (1.0, ''), (1e-3, 'm'), (1e-6, 'µ'), (1e-9, 'n'))
HIDDEN_KEYS = ('histogram_edges', 'histogram_counts')


@dataclass(frozen=True)
class Table:
    """A table: its heading row, then rows of text."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    folded: bool = False
    title: str = ''


@dataclass(frozen=True)
class Section:
    """One section of the page."""

    title: str
    text: str
    figures: Sequence[Markup] = ()
    tables: Sequence[Table] = ()


@dataclass(frozen=True)
class Card:
    """A figure of merit on top of the page."""

    label: str
    value: str
    note: str = ''


def engineering(value: float, unit: str) -> str:
    """Return a number with three digits and an SI prefix, such as `1.23 mrad`."""
    if not np.isfinite(value):
        return '–'
    size = abs(float(f'{value:.3g}'))  # as shown: 999.7 µs is 1 ms
    factor, prefix = next((entry for entry in PREFIXES if size >= entry[0]), PREFIXES[-1])
    if size == 0.0:
        factor, prefix = 1.0, ''
    return f'{value / factor:.3g} {prefix}{unit}'


def cards(phases: Sequence[PhaseMeasures], loops: Sequence[LoopMeasure]) -> list[Card]:
    """Return what a reader wants to know first."""
    found = []
    for label, series, unit in (
        ('Joint tracking error, rms', 'error', 'rad'),
        ('Tip off its reference, rms', 'tip_error', 'm'),
    ):
        values = [(p.name, getattr(p, series)) for p in phases if getattr(p, series) is not None]
        shown = [f'{engineering(rms(s.values), unit)}' for _, s in values]
        if values:
            found.append(Card(label, ' → '.join(shown), ' → '.join(name for name, _ in values)))
    percents = [
        (100.0 * rms(entry.predicted - entry.true) / peak(entry.true), entry.name)
        for phase in phases
        for entry in phase.deflections
        if entry.true is not None
    ]
    if percents:
        worst, name = max(percents)
        found.append(Card('Deflection prediction, worst', f'{worst:.2g} %', f'of peak, {name}'))
    if loops:
        share, node = max((100.0 * loop.late / max(loop.ticks, 1), loop.node) for loop in loops)
        found.append(Card('Late ticks, worst', f'{share:.2g} %', node))
    return found


def tracking(phases: Sequence[PhaseMeasures]) -> Section | None:
    """Return the section on joint and tip tracking errors."""
    shown = [(k, phase) for k, phase in enumerate(phases) if phase.error is not None]
    if not shown:
        return None
    panels = _by_column([(k, p.name, p.error) for k, p in shown], lambda name: name, 'rad')
    tips = [(k, p.name, p.tip_error) for k, p in shown if p.tip_error is not None]
    panels += _by_column(tips, lambda name: f'tip ({name}), distance', 'm')
    errors = [(phase.name, phase.error) for _, phase in shown]
    rows = _compared(errors, lambda name: name, 'rad')
    rows += _compared([(name, tip) for _, name, tip in tips], lambda n: f'tip ({n})', 'm')
    return Section(
        'Tracking error',
        'Reference minus measured position of each joint; for the tip, how far it is from where '
        'the undeformed robot on the reference would have it. A feedforward of the flexible model '
        'makes the joints follow: the links still swing, and the tip with them.',
        [_svg(line_figure(panels))],
        [Table(_compared_head([name for name, _ in errors]), rows)],
    )


def deflection(phases: Sequence[PhaseMeasures]) -> Section | None:
    """Return the section on predicted over true deflection."""
    figures, rows = [], []
    for k, phase in enumerate(phases):
        if not phase.deflections:
            continue
        colour = _colour(k)
        panels = []
        for entry in phase.deflections:
            title = _deflection_title(entry.name, phase.name, len(phases) > 1)
            curves = [Curve('predicted', colour, entry.t, entry.predicted, True)]
            if entry.true is not None:
                gap = entry.predicted - entry.true
                curves.insert(0, Curve('true (plant)', TRUTH_COLOUR, entry.t, entry.true))
                curves.append(Curve('difference', DIFFERENCE_COLOUR, entry.t, gap))
                error, largest = rms(gap), peak(entry.true)
                rows.append(
                    [
                        phase.name,
                        entry.name,
                        engineering(largest, entry.unit),
                        engineering(error, entry.unit),
                        f'{100.0 * error / largest:.2g} %',
                    ]
                )
            panels.append(Panel(title, entry.unit, curves))
        figures.append(_svg(line_figure(panels)))
    if not figures:
        return None
    head = ('phase', 'deflection', 'true peak', 'error rms', 'of peak')
    judged = 'over the true one of the plant' if rows else '(no truth to compare with here)'
    return Section(
        'Deflection of the flexible links',
        f'Tip deflection in the beam frame as the predictor has it, {judged}.',
        figures,
        [Table(head, rows)] if rows else [],
    )


def torque(phases: Sequence[PhaseMeasures]) -> Section | None:
    """Return the section on the torque that was commanded."""
    shown = [(k, p.name, p.torque) for k, p in enumerate(phases) if p.torque is not None]
    if not shown:
        return None
    panels = _by_column(shown, lambda name: name, 'N m')
    text = 'What the feedforward node commanded (N m; N for a prismatic joint).'
    if len(phases) == 1 and phases[0].effort is not None:
        panels = [_beside(panel, phases[0].effort) for panel in panels]
        text = 'What the feedforward node computed, and the effort measured beside it (N m; N).'
    torques = [(name, series) for _, name, series in shown]
    rows = _compared(torques, lambda name: name, 'N m')
    return Section(
        'Feedforward torque',
        text,
        [_svg(line_figure(panels))],
        [Table(_compared_head([name for name, _ in torques]), rows)],
    )


def motion(phases: Sequence[PhaseMeasures]) -> Section | None:
    """Return the section on the measured motion, for runs that show no tracking error."""
    shown = [
        (k, p.name, p.joints)
        for k, p in enumerate(phases)
        if p.joints is not None and p.error is None
    ]
    if not shown:
        return None
    panels = _by_column(shown, lambda name: name, 'rad')
    return Section('Measured joints', 'Positions as recorded.', [_svg(line_figure(panels, 1.5))])


def loops(measures: Sequence[LoopMeasure]) -> Section | None:
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
    return Section(
        'Loop periods',
        'Time between ticks from the first phase on, by each node itself; median and p99 are of '
        'the last second.',
        [_svg(histogram_figure(measures))],
        [Table(head, rows)],
    )


def warned(found: Mapping[str, tuple[int, str]]) -> Section | None:
    """Return the section on what the nodes warned of."""
    if not found:
        return None
    rows = [[name, str(count), text] for name, (count, text) in sorted(found.items())]
    table = Table(('status', 'times', 'last'), rows)
    return Section('Warnings', 'Each node speaks once a second on /diagnostics.', [], [table])


def nodes(statuses: Iterable[Diagnostic]) -> Section | None:
    """Return the section with the nodes' last words on /diagnostics."""
    last = {status.name: status for status in statuses}
    if not last:
        return None
    tables = [
        Table(
            ('key', 'value'),
            [[key, value] for key, value in status.values.items() if key not in HIDDEN_KEYS],
            folded=True,
            title=f'{name} — {status.message}',
        )
        for name, status in sorted(last.items())
    ]
    return Section('Node statistics', 'The last word of each on /diagnostics.', [], tables)


def topics(recording: Recording) -> Section:
    """Return the section on what the bag holds."""
    counts = recording.counts
    rows = [[name, kind, str(counts[name])] for name, kind in sorted(recording.topics.items())]
    text = f'{recording.path}: {sum(counts.values())} messages.'
    return Section('Recorded topics', text, [], [Table(('topic', 'type', 'messages'), rows)])


def _by_column(
    shown: Sequence[tuple[int, str, Series | None]], title: Callable[[str], str], unit: str
) -> list[Panel]:
    """Return one panel per column name, with a curve for each phase that has it."""
    names = dict.fromkeys(name for _, _, s in shown if s is not None for name in s.names)
    return [
        Panel(
            title(name),
            unit,
            [
                Curve(phase, _colour(k), series.t, series.column(name))
                for k, phase, series in shown
                if series is not None and name in series.names
            ],
        )
        for name in names
    ]


def _compared_head(names: Sequence[str]) -> list[str]:
    """Return the heading of a table of rms and largest value, phase beside phase."""
    return ['', *(f'{name}: {what}' for name in names for what in ('rms', 'largest'))]


def _compared(
    shown: Sequence[tuple[str, Series | None]], title: Callable[[str], str], unit: str
) -> list[list[str]]:
    """Return one row per column name: rms and largest value in each phase."""
    names = dict.fromkeys(name for _, s in shown if s is not None for name in s.names)
    rows = []
    for name in names:
        row = [title(name)]
        for _, series in shown:
            values = series.column(name) if series and name in series.names else None
            for measure in (rms, peak):
                row.append('–' if values is None else engineering(measure(values), unit))
        rows.append(row)
    return rows


def _beside(panel: Panel, effort: Series) -> Panel:
    """Return a torque panel with the measured effort of its joint under the computed one."""
    if panel.title not in effort.names:
        return panel
    measured = Curve('measured', DIFFERENCE_COLOUR, effort.t, effort.column(panel.title))
    computed = [dataclasses.replace(curve, label='computed') for curve in panel.curves]
    return dataclasses.replace(panel, curves=[measured, *computed])


def _deflection_title(name: str, phase: str, several: bool) -> str:
    link, _, component = name.rpartition('/')
    kind = {'u': 'deflection along', 'r': 'turn about'}[component[0]]
    return f'{link}, {kind} {component[1]}' + (f' ({phase})' if several else '')


def _colour(k: int) -> str:
    return PHASE_COLOURS[k % len(PHASE_COLOURS)]


def _svg(text: str) -> Markup:
    return Markup(text)
