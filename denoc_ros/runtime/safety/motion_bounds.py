"""Bounds of positions, velocities and accelerations of joints.

A finite number may still be no motion of the robot: 1.7e308 rad overflows in every model, and a
loop that closes step by step never gets there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from operator import le

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.model.tree import Limits
from denoc_ros.runtime.inputs.input_monitor import InputError
from denoc_ros.runtime.parameters.parameter_table import Settings
from denoc_ros.types import Array

LARGEST_RATE = 1e4  # rad/s or m/s, where the URDF has no velocity limit
LARGEST_ACCELERATION = 1e6  # rad/s^2 or m/s^2


class MotionBounds:
    """Refuses motions that the joints cannot have, with the cause `out_of_range`.

    Parameters
    ----------
    margin : float
        How far beyond a position limit a joint may be [rad or m].
    farthest : float
        Largest position of any joint [rad or m].
    factor : float
        How many times a velocity limit a rate may be.
    continuous : sequence of bool, optional
        Whether a turn more or less of a joint is the same position; default of none.

    Attributes
    ----------
    continuous : (joints,) array of bool
        As given.
    table : (4, joints) array
        Least and largest position, least and largest velocity.
    """

    def __init__(
        self,
        joints: Sequence[str],
        limits: Sequence[Limits],
        margin: float,
        farthest: float,
        factor: float,
        continuous: Sequence[bool] = (),
    ) -> None:
        self._joints = tuple(joints)
        self.continuous = np.array(continuous or [False] * len(joints), dtype=bool)
        self._options = margin, farthest, factor
        self.update(limits)

    def update(self, limits: Sequence[Limits]) -> None:
        """Take other limits of the same joints over; may be called beside the loop."""
        margin, farthest, factor = self._options
        ranges = [_range(each, margin, farthest) for each in limits]
        rates = [_rate(each, factor) for each in limits]
        # one assignment: the loop sees all of the old ones or all of the new ones
        self._bounds = (
            [lower for lower, _ in ranges],
            [upper for _, upper in ranges],
            rates,
            [-rate for rate in rates],
        )
        # the same for kernels: rows LOWER, UPPER, BACKWARDS, FORWARDS of message_values
        lower, upper, rates, backwards = self._bounds
        self.table: Array = np.array((lower, upper, backwards, rates), dtype=np.float64)

    def require(self, position: Array, velocity: Array | None = None) -> None:
        """Refuse a state (n,), (n,) beyond the bounds."""
        lower, upper, rates, backwards = self._bounds
        values = position.tolist()
        if not (all(map(le, lower, values)) and all(map(le, values, upper))):
            raise self._refusal('position', values, lower, upper)
        if velocity is None:
            return
        values = velocity.tolist()
        if not (all(map(le, backwards, values)) and all(map(le, values, rates))):
            raise self._refusal('velocity', values, backwards, rates)

    def require_rates(self, velocity: Array, acceleration: Array) -> None:
        """Refuse rates and accelerations (..., n) beyond the bounds."""
        _, _, rates, backwards = self._bounds
        most = [LARGEST_ACCELERATION] * len(rates)
        self._require_all('velocity', velocity, backwards, rates)
        self._require_all('acceleration', acceleration, [-each for each in most], most)

    def require_points(
        self,
        times: Array,
        positions: Array,
        velocities: Array | None,
        accelerations: Array | None,
        chosen: Sequence[int],
    ) -> None:
        """Refuse a trajectory of which a point, or the way to the next, is beyond the bounds.

        Parameters
        ----------
        times : (k,) array
            s, increasing.
        positions, velocities, accelerations : (k, c) array
            Of the `chosen` joints.
        chosen : sequence of int
            Places of c joints.
        """
        bounds = self if len(chosen) == len(self._joints) else self._part(chosen)
        lower, upper, rates, backwards = bounds._bounds
        bounds._require_all('position', positions, lower, upper)
        none = np.zeros((1, positions.shape[1]))
        bounds.require_rates(
            none if velocities is None else velocities,
            none if accelerations is None else accelerations,
        )
        if len(times) > 1:
            mean = np.diff(positions, axis=0) / np.diff(times)[:, None]
            bounds._require_all('mean velocity between points', mean, backwards, rates)

    def _part(self, chosen: Sequence[int]) -> MotionBounds:
        """Return the bounds of some of the joints."""
        part = copy(self)
        part._joints = tuple(self._joints[k] for k in chosen)
        lower, upper, rates, backwards = ([each[k] for k in chosen] for each in self._bounds)
        part._bounds = lower, upper, rates, backwards
        return part

    def _require_all(
        self, what: str, values: Array, lower: list[float], upper: list[float]
    ) -> None:
        held = (values >= lower) & (values <= upper)
        if not held.all():
            rows, whole = np.atleast_2d(values), np.atleast_2d(held).all(axis=1)
            raise self._refusal(what, rows[int(np.argmin(whole))].tolist(), lower, upper)

    def _refusal(
        self, what: str, values: list[float], lower: list[float], upper: list[float]
    ) -> InputError:
        name, value, least, most = next(
            each
            for each in zip(self._joints, values, lower, upper, strict=True)
            if not each[2] <= each[1] <= each[3]
        )
        return InputError(
            'out_of_range', f'{name}: {what} must be from {least:g} to {most:g}, got {value:g}'
        )


def _range(limits: Limits, margin: float, farthest: float) -> tuple[float, float]:
    """Return the smallest and largest position; limits that leave no motion count as none."""
    if limits.lower < limits.upper:
        return max(limits.lower - margin, -farthest), min(limits.upper + margin, farthest)
    return -farthest, farthest


def _rate(limits: Limits, factor: float) -> float:
    """Return the largest rate; a velocity limit of 0, as many files have, counts as none."""
    if 0.0 < limits.velocity < math.inf:
        return min(factor * limits.velocity, LARGEST_RATE)
    return LARGEST_RATE


def limits_of(robot: Robot, joints: Sequence[str]) -> list[Limits]:
    """Return the limits of joints of a robot."""
    return [robot.tree.joints[joint].limits for joint in joints]


def motion_bounds(robot: Robot, joints: Sequence[str], settings: Settings) -> MotionBounds:
    """Return the bounds that a node's parameters ask for."""
    return MotionBounds(
        joints,
        limits_of(robot, joints),
        settings.number('position_margin'),
        settings.number('position_limit'),
        settings.number('velocity_factor'),
        [robot.tree.joints[joint].continuous for joint in joints],
    )


def largest_accelerations(robot: Robot, joints: Sequence[str], posture: Array) -> Array:
    """Return the accelerations (joints,) by the effort limits alone, in a posture (n,).

    A joint without an effort limit has an infinite one.
    """
    inertia = np.diagonal(robot.inertia_matrix(posture))[robot.joint_indices]
    inertia = inertia[[robot.joint_names.index(joint) for joint in joints]]
    effort = np.array([limits.effort for limits in limits_of(robot, joints)])
    found: Array = np.full(len(effort), np.inf)
    known = np.isfinite(effort) & (effort > 0.0) & (inertia > 0.0)
    np.divide(effort, inertia, out=found, where=known)
    return found
