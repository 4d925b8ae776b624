"""The section of a report on the tip's distance from where it was asked to be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from denoc_ros.reports.figures import Curve, Panel, line_figure
from denoc_ros.reports.measures import SETTLED, PhaseMeasures, peak, rms
from denoc_ros.reports.pages import UNKNOWN, PageSection, PageTable, engineering
from denoc_ros.reports.sections import colour_of
from denoc_ros.types import Array

FLOOR = 1e-5  # m: what is less is drawn as this
AVERAGED = 0.05  # s over which the distance is averaged in the figure


def section(phases: Sequence[PhaseMeasures]) -> PageSection | None:
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
        [line_figure([panel([phase for _, phase in shown], [k for k, _ in shown])], 2.6)],
        [PageTable(HEAD, [_row(phase) for _, phase in shown])],
    )


HEAD = (
    'phase',
    'moving: rms',
    'largest',
    'after the stop: largest',
    f'from {SETTLED:g} s after it',
)


def panel(phases: Sequence[PhaseMeasures], colours: Sequence[int]) -> Panel:
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


def _row(phase: PhaseMeasures) -> list[str]:
    moving, swing, settled = phase.moving, phase.swing, phase.settled
    if moving is None or not len(moving):  # it stands from the start
        assert phase.tip_error is not None
        moving = phase.tip_error.values[:, 0]
    after = (
        UNKNOWN if part is None else engineering(peak(part), 'm') for part in (swing, settled)
    )
    return [phase.name, engineering(rms(moving), 'm'), engineering(peak(moving), 'm'), *after]
