"""The smallest stretching of time that keeps the joints' limits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from denoc_ros.dynamics.driven.joint_limits import TOLERANCE
from denoc_ros.dynamics.driven.motion_plan import LimitUse, Plan
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError
from denoc_ros.planning.timing.limit_rows import LimitRows
from denoc_ros.planning.tip.tip_solver import CancelledError

CLOSE = 0.005  # the stretch is found to this share
SEARCHES = 14
ROOM = 0.05  # least step toward slower motions, as a share
# which power of time a quantity falls with, the inverse; that of what is not here is 2
SLOWER = {'velocity': 1.0, 'tip_speed': 1.0, 'jerk': 1 / 3, 'effort_rate': 1 / 3, 'power': 1 / 3}
UNSOLVED = 1.5  # how much slower to go where no plan was found at all


class LimitError(SolverError):
    """A plan exceeds a limit; `slower` is about how much more time it needs."""

    def __init__(self, message: str, slower: float) -> None:
        super().__init__(message)
        self.slower = slower


def within_limits(
    robot: Robot, plan: Callable[[float], Plan], limits: LimitRows, largest: float
) -> Plan:
    """Return the plan that keeps the limits with its time stretched as little as possible.

    Parameters
    ----------
    robot : Robot
    plan : callable
        Makes the plan of the motion, so many times slower.
    limits : LimitRows
    largest : float
        The largest stretch that is tried.

    Raises
    ------
    SolverError
        No stretch up to the largest keeps them; which limit, and by how much. Or none has a plan.
    """
    stretch, beyond = 1.0, 1.0
    within: Plan | None = None
    reason: SolverError | None = None
    for _ in range(SEARCHES):
        slower = UNSOLVED
        try:
            within, reason = _kept(robot, plan(stretch), limits, stretch), None
        except CancelledError:
            raise
        except LimitError as error:
            beyond, slower, reason = stretch, error.slower, error
        except SolverError as error:
            beyond, reason = stretch, error
        if within is None:
            if stretch >= largest or math.isinf(slower):
                break
            stretch = min(stretch * max(slower, 1.0 + ROOM), largest)
        elif within.stretch <= beyond * (1.0 + CLOSE):
            break
        else:
            stretch = math.sqrt(beyond * within.stretch)
    if within is None:
        assert reason is not None
        raise reason
    return within


def _kept(robot: Robot, plan: Plan, limits: LimitRows, stretch: float) -> Plan:
    """Return the plan with its use of the limits if it keeps them, or raise LimitError."""
    use = limits.use(plan)
    name, factor = _most(use)
    if factor <= 1.0 + TOLERANCE:
        return replace(plan, limits=use)
    at = f'the motion {stretch:.4g} times slower' if stretch > 1.0 else 'the motion as it is'
    resting, most = _most(replace(use, shares=use.shares[[0, -1]]))
    what, _, whose = (resting if most > 1.0 + TOLERANCE else name).partition(' ')
    where = f'shape_motion: {robot.tree.name}: {whose} must keep its limit of {what}'
    if most > 1.0 + TOLERANCE:
        raise LimitError(
            f'{where} at rest, got {most:.4g} times that at the start or end of the motion, '
            'however slow',
            math.inf,
        )
    slower = factor ** SLOWER.get(what, 0.5)
    raise LimitError(f'{where}, got {factor:.4g} times that with {at}', slower)


def _most(use: LimitUse) -> tuple[str, float]:
    """Return the limit that is used most, and its largest share."""
    largest = use.largest
    if not largest:
        return '', 0.0
    name = max(largest, key=lambda each: largest[each])
    return name, largest[name]
