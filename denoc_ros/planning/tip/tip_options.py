"""Options of a tip-exact motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.errors import StateError
from denoc_ros.planning.timing.limit_rows import LimitOptions
from denoc_ros.settings import documented, optional, setting

TIMES = ('asked', 'minimum')
LARGEST_STRETCH = 10.0
PIECES, FEWEST_PIECES, MOST_PIECES = 14, 4, 200  # of the spline of a timing


@documented
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
    time : str
        ``asked``: the motion takes the time that was asked for, or is made slower as a whole.
        ``minimum``: its path stays and its timing is free: the shortest within the limits.
    near : Plan, optional
        A plan of a similar motion with ``time='minimum'`` whose timing is begun with.
    progress : callable, optional
        Takes the share of the work that is done, 0 to 1.
    cancel : callable, optional
        With ``time='minimum'`` it ends the work at the best plan within the limits so far, if
        there is one.

    Raises
    ------
    StateError
        If a number is out of range.
    """

    joints: Sequence[str] | None = None
    path: ArrayLike | Mapping[str, ArrayLike] | None = None
    weights: Sequence[float] | None = None
    turn: float | None = optional(
        float,
        'weight of a radian of rotation, in metres of position; 0: only positions matter; '
        "default: a hundredth of the tip's distance from the base",
        'm',
        0.0,
        finite=True,
    )
    # it decides where the tip's pose does not, or the arm is stretched
    draw: float | None = optional(
        float,
        'weight of a radian (or metre) of the driven joints away from the asked motion, in metres '
        "of position; default: 1e-4 of the tip's distance",
        'm',
        positive=True,
        finite=True,
    )
    preaction: float | None = optional(
        float,
        'longest time that the joints may move before the motion; default: what the '
        "robot's zeros need",
        's',
        0.0,
        finite=True,
    )
    postaction: float | None = optional(
        float, 'longest time that the joints may move after the motion', 's', 0.0, finite=True
    )
    step: float | None = optional(
        float,
        'time between the nodes at which the equations hold; default: a 400th of the motion, at '
        'most 40 ms',
        's',
        positive=True,
        finite=True,
    )
    time: str = 'asked'
    # twice as many at a time, as long as they save
    pieces: int = setting(
        PIECES,
        'in minimum time, pieces that the spline of the timing may have: more follow fast modes '
        'and take longer to find',
        '',
        FEWEST_PIECES,
        MOST_PIECES,
    )
    near: Plan | None = None
    stretch: float = setting(
        LARGEST_STRETCH,
        'largest factor by which a motion may be slowed down to keep the limits, in minimum time '
        'as well',
        '',
        1.0,
        finite=True,
    )
    progress: Callable[[float], object] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        require_time(self.time)
        for weight in self.weights or ():
            if not 0.0 < weight < np.inf:
                raise StateError(f'shape_motion: weights must be > 0, got {weight!r}')


def require_time(time: str) -> None:
    """Raise StateError where a time is none of `TIMES`."""
    if time not in TIMES:
        raise StateError(f'shape_motion: time must be one of {", ".join(TIMES)}, got {time!r}')
