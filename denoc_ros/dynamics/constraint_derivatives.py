"""Derivatives of the rows of loops and mimic joints, and of the forces that they ask for."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from denoc_ros.dynamics.derivatives import DifferentiableModel
from denoc_ros.dynamics.robot_model import RobotModel
from denoc_ros.kernels import constraint_layout
from denoc_ros.kernels.compiled import ready
from denoc_ros.kernels.constrained_derivatives import (
    constraint_force_change,
    constraint_row_rates,
)
from denoc_ros.model.friction import Friction
from denoc_ros.types import Array


class RowDerivatives(NamedTuple):
    """Rows J (rows, n) of constraints, those (axes, n) of loops' free axes, and their changes.

    Derivatives of the rows' g'' = J q'' + J' q' by q and q', and of the free axes' rates by q.
    """

    rows: Array
    by_q: Array
    by_rate: Array
    axes: Array
    axis_rates_by_q: Array


class ForceDerivatives(NamedTuple):
    """Derivatives of I q'' + h - J^T multipliers (n, n) with the multipliers constant."""

    by_q: Array
    by_rate: Array
    inertia: Array


def _count(robot: RobotModel) -> int:
    """Return the number of all rows, those of free axes included."""
    axes = int(robot.arrays.topology[0, constraint_layout.AXIS_ROWS])
    return len(robot.constraint_names) + axes


def _run(robot: RobotModel, kernel: Any, *arrays: Array) -> None:
    """Run a kernel on arrays, compiling it first if need be."""
    if not kernel.signatures:
        ready(kernel)
    robot.raise_for_status(kernel(robot.handle, *arrays), q=arrays[0])


def row_derivatives(robot: RobotModel, q: Array, qd: Array, qdd: Array) -> RowDerivatives:
    """Return the rows and how their accelerations g'' change with a closed state."""
    out = np.zeros((3, _count(robot), robot.n))
    hard = len(robot.constraint_names)
    if out.size:
        _run(robot, constraint_row_rates, q, qd, qdd, out)
    (rows, rates, up), (axes, axis_rates, _) = out[:, :hard], out[:, hard:]
    return RowDerivatives(rows, up, 2.0 * rates, axes, axis_rates)


def applied_change(robot: RobotModel, q: Array, v: Array) -> Array:
    """Return d(J v)/dq (rows, n) with v (n,) constant."""
    return row_derivatives(robot, q, np.zeros(robot.n), v).by_q


def force_change_is_ready() -> bool:
    """Say whether the kernel of :func:`transposed_change` is compiled."""
    return bool(constraint_force_change.signatures)


def transposed_change(robot: RobotModel, q: Array, weights: Array, axis_weights: Array) -> Array:
    """Return d(J^T weights + axes^T axis_weights)/dq (n, n), both weights constant.

    Each loop's weights are a wrench on its child and the opposite one on its parent: they change
    as the frames move, and so does what they do to the coordinates.
    """
    change, given = np.zeros((robot.n, robot.n)), np.zeros(_count(robot))
    if given.size:
        given[: len(weights)] = weights
        given[len(weights) : len(weights) + len(axis_weights)] = axis_weights
        _run(robot, constraint_force_change, q, given, change)
    return -change


def _resistance(robot: RobotModel, axes: Array, qd: Array, friction: bool) -> tuple[Array, Array]:
    """Return force and slope (axes,) of damping and friction along the loops' free axes."""
    loops = [loop for loop in robot.tree.loops if loop.damping > 0.0 or loop.friction > 0.0]
    damping, dry = np.array([(x.damping, x.friction) for x in loops]).reshape(-1, 2).T
    rates, law = axes @ qd, Friction(damping, dry)
    return law.force(rates), law.slope(rates) if friction else damping


def force_derivatives(
    robot: DifferentiableModel,
    q: Array,
    qd: Array,
    qdd: Array,
    multipliers: Array,
    friction: bool = True,
) -> ForceDerivatives:
    """Return how the forces that motion in the loops asks for change.

    friction: False leaves out the slope of the loops' own friction.
    """
    change = row_derivatives(robot, q, qd, qdd)
    axes = change.axes
    force, slope = _resistance(robot, axes, qd, friction)
    by_q, by_rate, inertia = robot.inverse_dynamics_derivatives(q, qd, qdd)
    by_q = by_q - transposed_change(robot, q, multipliers, -force)
    by_q = by_q + axes.T @ (slope[:, None] * change.axis_rates_by_q)
    by_rate = by_rate + axes.T @ (slope[:, None] * axes)
    return ForceDerivatives(by_q, by_rate, inertia)
