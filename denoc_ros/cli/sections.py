"""The sections of a report: a heading, what it shows, figures and tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from denoc_ros.cli.figures import (
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
    size = abs(value)
    factor, prefix = next((entry for entry in PREFIXES if size >= entry[0]), PREFIXES[-1])
    if size == 0.0:
        factor, prefix = 1.0, ''
    return f'{value / factor:.3g} {prefix}{unit}'


def cards(phases: Sequence[PhaseMeasures], loops: Sequence[LoopMeasure]) -> list[Card]:
    """Return what a reader wants to know first."""
    found = []
    for label, series, unit in (
        ('Joint tracking error, rms', 'error', 'rad'),
        ('Tip error, rms', 'tip_error', 'm'),
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
    rows = []
    for _, phase in shown:
        for series, unit in ((phase.error, 'rad'), (phase.tip_error, 'm')):
            for name in series.names if series is not None else ():
                assert series is not None
                values = series.column(name)
                where = name if unit == 'rad' else f'tip ({name})'
                rows.append(
                    [
                        phase.name,
                        where,
                        engineering(rms(values), unit),
                        engineering(peak(values), unit),
                    ]
                )
    return Section(
        'Tracking error',
        'Reference minus measured position of each joint, and how far the deflected tip is from '
        'where the undeformed robot would have it on the reference.',
        [_svg(line_figure(panels))],
        [Table(('phase', 'joint', 'rms', 'largest'), rows)],
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
                curves.insert(0, Curve('true (plant)', TRUTH_COLOUR, entry.t, entry.true))
                gap = entry.predicted - entry.true
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
    rows = [
        [name, joint, engineering(rms(values), 'N m'), engineering(peak(values), 'N m')]
        for _, name, series in shown
        for joint, values in ((joint, series.column(joint)) for joint in series.names)
    ]
    return Section(
        'Feedforward torque',
        'What the feedforward node commanded (N m; N for a prismatic joint).',
        [_svg(line_figure(_by_column(shown, lambda name: name, 'N m')))],
        [Table(('phase', 'joint', 'rms', 'largest'), rows)],
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
        'Time between ticks since each node started, by its own clock; median and p99 are of the '
        'last second.',
        [_svg(histogram_figure(measures))],
        [Table(head, rows)],
    )


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
    rows = [[name, kind] for name, kind in sorted(recording.topics.items())]
    return Section('Recorded topics', str(recording.path), [], [Table(('topic', 'type'), rows)])


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


def _deflection_title(name: str, phase: str, several: bool) -> str:
    link, _, component = name.rpartition('/')
    kind = {'u': 'deflection along', 'r': 'turn about'}[component[0]]
    return f'{link}, {kind} {component[1]}' + (f' ({phase})' if several else '')


def _colour(k: int) -> str:
    return PHASE_COLOURS[k % len(PHASE_COLOURS)]


def _svg(text: str) -> Markup:
    return Markup(text)
