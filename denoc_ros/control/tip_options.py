"""Options of a tip-exact motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.control.limit_rows import LimitOptions
from denoc_ros.control.plan import Plan
from denoc_ros.errors import StateError

TIMES = ('asked', 'minimum')
LARGEST_STRETCH = 10.0


@dataclass(frozen=True, kw_only=True)
class TipOptions(LimitOptions):
    """Options of a tip-exact motion; a motion that exceeds a limit is made slower.

    Attributes
    ----------
    joints : names, optional
        The driven joints; default all that mimic none.
    path : (k, 4, 4) array or mapping of frame to such, optional
        Poses in the base frame that the tip must have at the times, in place of those of the
        undeformed robot; the joints given are then only where to begin looking.
    weights : (frames,) floats, optional
        Of the frames' errors; default 1 each.
    turn : float, optional
        How many metres of position a radian of turn counts as; 0: only positions matter. Default
        a hundredth of the tip's distance from the base.
    draw : float, optional
        How many metres of the tip a radian (or metre) of the driven joints away from the asked
        motion counts as; default 1e-4 of the tip's distance. It decides where the tip's pose does
        not, or the arm is stretched.
    preaction, postaction : float, optional
        How long the joints may move before and after the motion that was asked for [s]; default
        what the robot's zeros need.
    step : float, optional
        Between the nodes at which the equations hold [s]; default a 400th of the motion, at most
        40 ms.
    output_step : float, optional
        Between the rows of the plan [s]; default 4 ms.
    time : str
        ``asked``: the motion takes the time that was asked for, or is made slower as a whole.
        ``minimum``: its path stays and its timing is free: the shortest within the limits.
    stretch : float
        The largest factor by which it may be made slower, in minimum time as well; 1: it is
        refused.
    near : Plan, optional
        A plan of a similar motion with ``time='minimum'`` whose timing is begun with.
    progress : callable, optional
        Takes the share of the work that is done, 0 to 1.
    cancel : callable, optional
        Returns True where the work must end: SolverError then; with ``time='minimum'`` the best
        plan within the limits so far, if there is one.
    """

    joints: Sequence[str] | None = None
    path: ArrayLike | Mapping[str, ArrayLike] | None = None
    weights: Sequence[float] | None = None
    turn: float | None = None
    draw: float | None = None
    preaction: float | None = None
    postaction: float | None = None
    step: float | None = None
    output_step: float | None = None
    time: str = 'asked'
    near: Plan | None = None
    stretch: float = LARGEST_STRETCH
    progress: Callable[[float], object] | None = None
    cancel: Callable[[], bool] | None = None

    def __post_init__(self) -> None:
        for name in ('turn', 'preaction', 'postaction'):
            _require(name, getattr(self, name), 0.0, strict=False)
        for name in ('draw', 'step', 'output_step'):
            _require(name, getattr(self, name), 0.0, strict=True)
        _require('stretch', self.stretch, 1.0, strict=False)
        require_time(self.time)
        for weight in self.weights or ():
            _require('weights', weight, 0.0, strict=True)


def require_time(time: str) -> None:
    """Raise StateError where a time is none of `TIMES`."""
    if time not in TIMES:
        raise StateError(f'shape_motion: time must be one of {", ".join(TIMES)}, got {time!r}')


def _require(name: str, value: float | None, least: float, strict: bool) -> None:
    """Raise StateError where an option is not a number above a bound."""
    if value is None:
        return
    good = isinstance(value, int | float | np.number) and np.isfinite(value)
    if not good or not (value > least if strict else value >= least):
        sign = '>' if strict else '>='
        raise StateError(f'shape_motion: {name} must be a number {sign} {least:g}, got {value!r}')
