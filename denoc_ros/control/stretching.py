"""The smallest stretching of time that keeps the joints' limits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from denoc_ros.control.joint_limits import JointLimits, plan_violation
from denoc_ros.control.plan import Plan
from denoc_ros.control.tip_solver import CancelledError
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError

CLOSE = 0.005  # the stretch is found to this share
SEARCHES = 14
ROOM = 0.05  # least step toward slower motions, as a share
UNSOLVED = 1.5  # how much slower to go where no plan was found at all


class LimitError(SolverError):
    """A plan exceeds a limit; `slower` is about how much more time it needs."""

    def __init__(self, message: str, slower: float) -> None:
        super().__init__(message)
        self.slower = slower


def within_limits(
    robot: Robot, plan: Callable[[float], Plan], limits: JointLimits, largest: float
) -> Plan:
    """Return the plan that keeps the limits with its time stretched as little as possible.

    Parameters
    ----------
    robot : Robot
    plan : callable
        Makes the plan of the motion, so many times slower.
    limits : JointLimits
        Of all joints; those that the plan drives are looked at.
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


def _kept(robot: Robot, plan: Plan, limits: JointLimits, stretch: float) -> Plan:
    """Return the plan if it keeps the limits, or raise LimitError."""
    found = plan_violation(robot, plan, limits)
    if found is None:
        return plan
    what, joint, factor = found
    at = f'the motion {stretch:.4g} times slower' if stretch > 1.0 else 'the motion as it is'
    where = f'shape_motion: {robot.tree.name}: {joint} must keep its limit of {what}'
    resting = plan_violation(robot, _ends(plan), limits)
    if resting is not None:
        what, joint, factor = resting
        raise LimitError(
            f'shape_motion: {robot.tree.name}: {joint} must keep its limit of {what} at rest, got '
            f'{factor:.4g} times that at the start or end of the motion, however slow',
            math.inf,
        )
    power = 1.0 if what == 'velocity' else 0.5
    raise LimitError(f'{where}, got {factor:.4g} times that with {at}', factor**power)


def _ends(plan: Plan) -> Plan:
    """Return the first and last row of a plan."""
    rows = [0, -1]
    names = ('t', 'q', 'qd', 'qdd', 'torque', 'tip_error', 'tip_turn')
    return replace(plan, **{name: getattr(plan, name)[rows] for name in names})
