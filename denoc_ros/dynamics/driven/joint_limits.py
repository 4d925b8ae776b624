"""Limits of the joints of a planned motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.types import Array

Given = Mapping[str, float] | ArrayLike
TOLERANCE = 1e-6  # share by which a limit counts as kept
WITHIN = 0.01  # share by which a plan may be beyond a limit


@dataclass(frozen=True)
class JointLimits:
    """Limits of each joint, in the order of the robot's `joint_names`; inf: none.

    Attributes
    ----------
    lower, upper : (joints,) arrays
        Positions [rad, m].
    velocity, acceleration, jerk : (joints,) arrays
        Magnitudes [rad/s, rad/s^2, rad/s^3; m/s, …].
    effort, effort_rate : (joints,) arrays
        Magnitudes [N m, N; N m/s, N/s].
    """

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    effort: Array
    effort_rate: Array

    @property
    def room(self) -> Array:
        """Half of the positions' range; inf where there is none."""
        return 0.5 * (self.upper - self.lower)

    @property
    def middle(self) -> Array:
        """The middle of the positions' range; 0 where there is none."""
        found = np.isfinite(self.room)
        return np.where(found, self.upper, 0.0) - np.where(found, self.room, 0.0)

    def scaled(self, share: float) -> JointLimits:
        """Return a share of all limits but those of positions."""
        names = [each.name for each in fields(self)][2:]
        return replace(self, **{name: share * getattr(self, name) for name in names})

    def of(self, places: NDArray[np.int64]) -> JointLimits:
        """Return the limits of the joints at some places."""
        return JointLimits(*(getattr(self, each.name)[places] for each in fields(self)))

    def violation(
        self,
        q: Array,
        qd: Array,
        qdd: Array,
        torque: Array | None = None,
        tolerance: float = TOLERANCE,
    ) -> tuple[str, int, float] | None:
        """Most exceeded limit, with its joint and factor; None where all hold.

        Rows (k, joints) of a motion, and of its torque; a share beyond a limit is tolerated.
        """
        shares = {
            'position': _largest(q - self.middle, self.room),
            'velocity': _largest(qd, self.velocity),
            'acceleration': _largest(qdd, self.acceleration),
        }
        if torque is not None:
            shares['effort'] = _largest(torque, self.effort)
        worst = max(shares, key=lambda what: float(shares[what].max(initial=0.0)))
        factor = float(shares[worst].max(initial=0.0))
        if factor <= 1.0 + tolerance:
            return None
        return worst, int(shares[worst].argmax()), factor


def _largest(rows: Array, limit: Array) -> Array:
    """Return the largest magnitudes (joints,) as shares of the limits."""
    return np.asarray(np.abs(rows).max(axis=0, initial=0.0) / limit)


def plan_violation(
    robot: Robot, plan: Plan, limits: JointLimits, tolerance: float = TOLERANCE
) -> tuple[str, str, float] | None:
    """Most exceeded limit of a plan, with its driven joint and factor; None where all hold.

    Limits of all the robot's joints; a share beyond a limit is tolerated.
    """
    places = np.array([robot.joint_names.index(name) for name in plan.joint_names])
    columns = robot.joint_indices[places]
    rows = plan.q[:, columns], plan.qd[:, columns], plan.qdd[:, columns]
    found = limits.of(places).violation(*rows, plan.torque, tolerance)
    return None if found is None else (found[0], plan.joint_names[found[1]], found[2])


def require_limits(robot: Robot, plan: Plan, limits: JointLimits, advice: str = '') -> None:
    """Refuse a plan that is more than `WITHIN` beyond a limit.

    Raises
    ------
    SolverError
        Which limit, by what factor; ends with the advice.
    """
    broken = plan_violation(robot, plan, limits, WITHIN)
    if broken is not None:
        what, joint, factor = broken
        raise SolverError(
            f'{robot.tree.name}: the plan must keep the limits, got {factor:.3g} times the '
            f'{what} limit of {joint!r}{advice}'
        )


def joint_limits(
    robot: Robot,
    velocity: Given | None = None,
    acceleration: Given | None = None,
    jerk: Given | None = None,
    effort: Given | None = None,
    effort_rate: Given | None = None,
) -> JointLimits:
    """Return the limits of a robot's joints: the URDF's, or those given.

    Parameters
    ----------
    robot : Robot
    velocity, acceleration, jerk, effort, effort_rate : optional
        A number for all joints, one per joint, or a mapping of joint names; positive. A URDF has
        none of acceleration, jerk and effort rate.

    Raises
    ------
    StateError
        A limit that is not > 0, of another number than joints, or of an unknown joint.
    """
    own = [robot.tree.joints[name].limits for name in robot.joint_names]
    none = np.full(len(own), np.inf)

    def column(what: str) -> Array:
        return np.array([getattr(limits, what) for limits in own], dtype=np.float64)

    def magnitude(what: str) -> Array:
        found = column(what)  # many files have 0 where they mean that there is none
        return np.where(found > 0.0, found, np.inf)

    lower, upper = column('lower'), column('upper')
    meant = lower < upper
    limits = JointLimits(
        np.where(meant, lower, -np.inf),
        np.where(meant, upper, np.inf),
        magnitude('velocity'),
        none,
        none.copy(),
        magnitude('effort'),
        none.copy(),
    )
    given = {
        'velocity': velocity,
        'acceleration': acceleration,
        'jerk': jerk,
        'effort': effort,
        'effort_rate': effort_rate,
    }
    for what, value in given.items():
        if value is not None:
            before = getattr(limits, what)
            limits = replace(limits, **{what: _checked(robot, what, value, before)})
    return limits


def _checked(robot: Robot, what: str, value: Given, before: Array) -> Array:
    names = list(robot.joint_names)
    found: Array
    if isinstance(value, Mapping):
        found = before.copy()
        for name, each in value.items():
            if name not in names:
                raise StateError(f'limits: {what} must be of joints of {names}, got {name!r}')
            found[names.index(name)] = each
    else:
        try:
            found = np.broadcast_to(np.asarray(value, dtype=np.float64), before.shape).copy()
        except ValueError:
            raise StateError(
                f'limits: {what} must have one element, or one for each of {len(names)} joints, '
                f'got {value!r}'
            ) from None
    if not (found > 0.0).all():
        raise StateError(f'limits: {what} must be > 0, got {found.tolist()}')
    return found
