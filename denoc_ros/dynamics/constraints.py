"""Loops and mimic joints as constraint rows: multipliers and torques (book, section 5.1).

I q'' + h = tau + J^T lambda with J q'' + J' q' = 0. Rows that say the same twice are normal (a
planar loop in space has two or three of them): multipliers are then those of least norm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from denoc_ros.dynamics.batch import each_row, run_rows
from denoc_ros.dynamics.robot_model import RobotModel
from denoc_ros.errors import SolverError, StateError
from denoc_ros.kernels import articulated, closure, constrained, constraint_layout, inverse
from denoc_ros.kernels.closing import OPEN, OPENED
from denoc_ros.kernels.compiled import entry
from denoc_ros.kernels.constrained import CONTRADICTED
from denoc_ros.kernels.constrained_derivatives import (
    constraint_force_change,
    constraint_row_rates,
)
from denoc_ros.kernels.handle import GOOD, MISFIT
from denoc_ros.model.friction import Friction
from denoc_ros.model.tree import Mimic
from denoc_ros.types import Array

Int = NDArray[np.int64]

# A singular value of the rows this far below the greatest is none (as in kernels.multipliers).
RANK = 1e-6
# Equations that cannot all be met contradict each other by more than this part of their terms:
# a closed state is closed to 1e-9, torques and accelerations come from files and trajectories.
AGREEMENT = 1e-6


class RowDerivatives(NamedTuple):
    """Rows J (rows, n) of constraints, those (axes, n) of loops' free axes, and their changes.

    Derivatives of the rows' g'' = J q'' + J' q' by q and q', and of the free axes' rates by q.
    """

    rows: Array
    by_q: Array
    by_rate: Array
    axes: Array
    axis_rates_by_q: Array


def row_count(robot: RobotModel) -> int:
    """Return the number of all rows, those of free axes included."""
    axes = int(robot.arrays.topology[0, constraint_layout.AXIS_ROWS])
    return len(robot.constraint_names) + axes


def closure_rows(robot: RobotModel, q: Array, qd: Array) -> Array:
    """Return errors, rates and acceleration biases (3, rows) of the loops and mimic joints."""
    out = np.empty((3, len(robot.constraint_names)))
    if not out.size:  # a robot without constraints has not got their kernels ready
        return out
    robot.raise_for_status(closure.closure(robot.handle, q, qd, out), q=q, qd=qd)
    return out


def jacobian(robot: RobotModel, q: Array) -> tuple[Array, Array]:
    """Return J (rows, n) and the rows (axes, n) of free axes with damping or friction."""
    rows = len(robot.constraint_names)
    out = np.empty((row_count(robot), robot.n))
    if not rows:
        return out, out
    robot.raise_for_status(closure.closure_jacobian(robot.handle, q, out), q=q)
    return out[:rows], out[rows:]


def row_derivatives(robot: RobotModel, q: Array, qd: Array, qdd: Array) -> RowDerivatives:
    """Return the rows and how their accelerations g'' change with a closed state."""
    out = np.zeros((3, row_count(robot), robot.n))
    hard = len(robot.constraint_names)
    if out.size:
        kernel = entry(constraint_row_rates)
        robot.raise_for_status(kernel(robot.handle, q, qd, qdd, out), q=q)
    (rows, rates, up), (axes, axis_rates, _) = out[:, :hard], out[:, hard:]
    return RowDerivatives(rows, up, 2.0 * rates, axes, axis_rates)


def applied_change(robot: RobotModel, q: Array, v: Array) -> Array:
    """Return d(J v)/dq (rows, n) with v (n,) constant."""
    return row_derivatives(robot, q, np.zeros(robot.n), v).by_q


def transposed_change(robot: RobotModel, q: Array, weights: Array, axis_weights: Array) -> Array:
    """Return d(J^T weights + axes^T axis_weights)/dq (n, n), both weights constant.

    Each loop's weights are a wrench on its child and the opposite one on its parent: they change
    as the frames move, and so does what they do to the coordinates.
    """
    change, given = np.zeros((robot.n, robot.n)), np.zeros(row_count(robot))
    if given.size:
        given[: len(weights)] = weights
        given[len(weights) : len(weights) + len(axis_weights)] = axis_weights
        kernel = entry(constraint_force_change)
        robot.raise_for_status(kernel(robot.handle, q, given, change), q=q)
    return -change


def required_force(robot: RobotModel, q: Array, qd: Array, qdd: Array, axes: Array) -> Array:
    """Return I q'' + h (n,) with the damping and friction of the loops' own joints."""
    force = np.empty(robot.n)
    kernel = entry(inverse.inverse_dynamics)
    robot.raise_for_status(kernel(robot.handle, q, qd, qdd, force), q=q, qd=qd, qdd=qdd)
    add_loop_friction(robot, qd, axes, force)
    return force


def add_loop_friction(robot: RobotModel, qd: Array, axes: Array, force: Array) -> None:
    """Add damping and friction of the loops' own joints to a force (n,) in place."""
    for axis, resisting in zip(axes, axis_resistance(robot, axes, qd)[0], strict=True):
        force += axis * resisting


def axis_resistance(
    robot: RobotModel, axes: Array, qd: Array, friction: bool = True
) -> tuple[Array, Array]:
    """Return force and slope (axes,) of damping and friction along the loops' free axes.

    friction: False leaves out the slope of friction.
    """
    loops = [loop for loop in robot.tree.loops if loop.damping > 0.0 or loop.friction > 0.0]
    damping, dry = np.array([(x.damping, x.friction) for x in loops]).reshape(-1, 2).T
    rates, law = axes @ qd, Friction(damping, dry)
    return law.force(rates), law.slope(rates) if friction else damping


def least_solution(matrix: Array, wanted: Array) -> tuple[Array, Array]:
    """Return x of least norm with matrix x = wanted, and the residual."""
    if not matrix.size:
        return np.zeros(matrix.shape[1]), wanted
    x = np.asarray(np.linalg.lstsq(matrix, wanted, rcond=RANK)[0], dtype=np.float64)
    return x, wanted - matrix @ x


def accelerations(
    robot: RobotModel, q: Array, qd: Array, tau: Array, held: Int, given: Array
) -> tuple[Array, Array]:
    """Return accelerations (n,) and multipliers (rows,) with those of some coordinates given.

    Parameters
    ----------
    q, qd, tau : (n,)
    held : (h,) int
        The coordinates, joints, whose accelerations are given.
    given : (h,)
    """
    start, qdd, scratch = np.zeros((3, robot.n))
    start[held] = given
    flags, multipliers = robot.held(held), np.zeros(len(robot.constraint_names))
    if len(multipliers):
        status = constrained_dynamics(robot, flags, q, qd, start, tau, qdd, multipliers)
    else:
        shift = robot.armature
        status = articulated.articulated_dynamics(
            robot.handle, shift, flags, q, qd, start, tau, qdd, scratch
        )
    raise_status(robot, status, q=q, qd=qd, tau=tau)
    return qdd, multipliers


def constrained_dynamics(robot: RobotModel, *arrays: Array) -> int:
    """Run the kernel of that name on arrays, whatever the interpreter; return its status."""
    status = int(entry(constrained.constrained_dynamics)(robot.handle, *arrays))
    if status == MISFIT:
        held, *rows = arrays
        q, qd, given, tau, qdd, multipliers = (row[None] for row in rows)
        kernel = constrained.constrained_dynamics_rows
        status = run_rows(robot, kernel, 1, held, q, qd, given, tau, qdd, multipliers)
    return status


def forward(robot: RobotModel, q: Array, qd: Array, tau: Array) -> tuple[Array, Array]:
    """Return accelerations (n,) and multipliers (rows,)."""
    return accelerations(robot, q, qd, tau, np.zeros(0, dtype=np.int64), np.zeros(0))


def forward_rows(robot: RobotModel, q: Array, qd: Array, tau: Array) -> tuple[Array, Array]:
    """Return accelerations (k, n) and multipliers (k, rows) of many states in one call."""
    qdd, multipliers = np.empty_like(q), np.zeros((len(q), len(robot.constraint_names)))
    none, given = np.zeros(robot.n), np.zeros_like(q)
    if multipliers.size:
        kernel = constrained.constrained_dynamics_rows
        rows = [none, q, qd, given, tau, qdd, multipliers]
    else:
        kernel = articulated.articulated_dynamics_rows
        rows = [robot.armature, none, q, qd, given, tau, qdd, np.empty_like(q)]
    if run_rows(robot, kernel, len(q), *rows) != GOOD:
        # the first state that has no answer says why
        each_row(lambda q, qd, tau: forward(robot, q, qd, tau), q, qd, tau)
    return qdd, multipliers


def inverse_torques(
    robot: RobotModel, q: Array, qd: Array, qdd: Array, actuated: Int, tau: Array | None = None
) -> tuple[Array, Array]:
    """Return torques of the actuated coordinates and multipliers, both of least norm.

    tau (n,) are generalized forces that act beside these torques.

    The multipliers come from the equations of the coordinates without an actuator (section 5.1.2);
    what these leave open goes to make the torques small.
    """
    rows, axes = jacobian(robot, q)
    require_closed_accelerations(robot, rows, closure_rows(robot, q, qd)[2], qdd)
    need = required_force(robot, q, qd, qdd, axes)
    if tau is not None:
        need -= tau
    passive = np.setdiff1d(np.arange(robot.n), actuated)
    multipliers, residual = least_solution(rows[:, passive].T, need[passive])
    if np.abs(residual).max(initial=0.0) > AGREEMENT * (1.0 + np.abs(need).max(initial=0.0)):
        worst = int(np.argmax(np.abs(residual)))
        raise StateError(
            f'{robot.tree.name}: qdd must be one that the actuated joints can give, got '
            f'{residual[worst]:.3g} N m (or N) left on {robot.coordinate_names[passive[worst]]}'
        )
    open_to = scipy.linalg.null_space(rows[:, passive].T, rcond=RANK) if len(passive) else None
    open_to = np.eye(len(rows)) if open_to is None else open_to
    torque = need[actuated] - rows[:, actuated].T @ multipliers
    reach = rows[:, actuated].T @ open_to
    # what redundant rows leave of the actuated joints' columns is rounding, not a way to push
    if np.abs(reach).max(initial=0.0) > RANK * np.abs(rows).max(initial=0.0):
        multipliers = multipliers + open_to @ least_solution(reach, torque)[0]
    return need[actuated] - rows[:, actuated].T @ multipliers, multipliers


def hybrid(
    robot: RobotModel,
    q: Array,
    qd: Array,
    qdd_actuated: Array,
    actuated: Int,
    tau: Array,
    load: Array,
) -> tuple[Array, Array, Array]:
    """Return torques of the actuated coordinates, all accelerations and multipliers.

    tau (n,) are generalized forces of the other coordinates, load (n,) those of wrenches.
    """
    loads = tau.copy()
    loads[actuated] = 0.0
    loads += load
    qdd, _ = accelerations(robot, q, qd, loads, actuated, qdd_actuated)
    torque, multipliers = inverse_torques(robot, q, qd, qdd, actuated, loads)
    return torque, qdd, multipliers


def require_closed_accelerations(robot: RobotModel, rows: Array, bias: Array, qdd: Array) -> None:
    """Raise StateError where J q'' + J' q' is not zero."""
    if not len(rows):
        return
    residual = rows @ qdd + bias
    size = 1.0 + float((np.abs(rows) @ np.abs(qdd) + np.abs(bias)).max())
    worst = int(np.argmax(np.abs(residual)))
    if abs(residual[worst]) > AGREEMENT * size:
        raise StateError(
            f'{robot.tree.name}: qdd must keep {robot.constraint_names[worst]!r} closed, got '
            f'{residual[worst]:.3g} m/s^2 (or rad/s^2) of its row {worst}'
        )


def raise_status(robot: RobotModel, status: int, **arguments: Array) -> None:
    """Raise the error of a constrained kernel's status."""
    if status not in (CONTRADICTED, OPENED):
        robot.raise_for_status(status, **arguments)
        return
    found = robot.work[int(robot.arrays.topology[0, constraint_layout.CONSTRAINTS_WORK]) :]
    name = robot.constraint_names[int(found[constraint_layout.WORST])]
    left = f'{found[constraint_layout.RESIDUAL]:.3g}'
    if status == OPENED:
        raise SolverError(
            f'{robot.tree.name}: {name!r} must stay closed to {OPEN:g} m (or rad) in a step, got '
            f'{left}: the state before it is not closed, or the step is too long'
        )
    rank = f'{int(found[constraint_layout.RANK])} of {len(robot.constraint_names)} rows'
    raise SolverError(
        f'{robot.tree.name}: the rows of {name!r} must not contradict the others, got a singular '
        f'configuration: rank {rank}, {left} m/s^2 (or rad/s^2) left'
    )


def mimic_ties(
    robot: RobotModel, joints: Sequence[str] | None, held: Mapping[str, float]
) -> tuple[Array, Array, tuple[str, ...]]:
    """Return T (all joints, driven) and c (all joints,) of q_all = T q + c, and the driven names.

    Raises
    ------
    StateError
        A driven joint is unknown, repeated or a mimic; a mimic's leader is unknown.
    """
    free, mimics = list(robot.tree.non_mimic_joints), robot.tree.mimics
    driven = tuple(joints) if joints is not None else tuple(free)
    if len(set(driven)) != len(driven) or not set(driven) <= set(free):
        raise StateError(f'driven joints must be different ones of {free}, got {list(driven)}')
    constraints = np.zeros((len(robot.joint_names), len(driven)))
    offsets = np.zeros(len(robot.joint_names))
    for row, name in enumerate(robot.joint_names):
        mimic = mimics.get(name, Mimic(name, 1.0, 0.0))
        if mimic.leader in driven:
            constraints[row, driven.index(mimic.leader)] = mimic.multiplier
            offsets[row] = mimic.offset
        else:
            offsets[row] = mimic.multiplier * held.get(mimic.leader, 0.0) + mimic.offset
    return constraints, offsets, driven
