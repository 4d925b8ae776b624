"""Loops and mimic joints as constraint rows: multipliers and torques (book, section 5.1).

I q'' + h = tau + J^T lambda with J q'' + J' q' = 0. Rows that say the same twice are normal (a
planar loop in space has two or three of them): multipliers are then those of least norm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.robot_model import RobotModel
from denoc_ros.dynamics.state_rows import run_rows
from denoc_ros.errors import SolverError, StateError
from denoc_ros.kernels.constraints import closure, constrained, constrained_torques
from denoc_ros.kernels.constraints.closing import OPEN, OPENED
from denoc_ros.kernels.constraints.constrained import CONTRADICTED
from denoc_ros.kernels.constraints.constrained_derivatives import (
    constraint_force_change,
    constraint_row_rates,
)
from denoc_ros.kernels.constraints.constrained_torques import AGREEMENT, BEYOND_REACH, OPENING
from denoc_ros.kernels.dynamics import articulated, inverse
from denoc_ros.kernels.jit.compiled import entry
from denoc_ros.kernels.jit.handle import GOOD, NOT_FINITE
from denoc_ros.kernels.layout import constraint_layout
from denoc_ros.model.joint_friction import Friction
from denoc_ros.model.tree import Mimic
from denoc_ros.types import Array

Int = NDArray[np.int64]

# A singular value of the rows this far below the greatest is none (as in kernels.multipliers).
RANK = 1e-6


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


def hybrid(
    robot: RobotModel,
    closed: bool,
    held: Array,
    q: Array,
    qd: Array,
    given: Array,
    tau: Array,
    check: bool = True,
) -> tuple[Array, Array, Array]:
    """Return torques of held joints, all accelerations and multipliers: dynamics in general.

    With nothing held it is forward dynamics.

    Parameters
    ----------
    closed : bool
        Whether the constraint rows count; without, or without any, the tree is open.
    held : (n,)
        1 for joints whose accelerations are given, as of :meth:`RobotModel.held`.
    q, qd, given, tau : (k, n)
        States, accelerations of held joints (0 elsewhere), and forces beside their torques.
    check : bool
        Whether results that are not finite are an error.

    Returns
    -------
    torques : (k, n)
        Of held joints; other columns have no meaning.
    qdd : (k, n)
    multipliers : (k, rows)
        Of least norm.
    """
    if closed and robot.constraint_names:
        qdd, multipliers = accelerations(robot, held, q, qd, given, tau)
        if not held.any():
            return np.zeros(q.shape), qdd, multipliers
        torque, multipliers = torques(robot, held, q, qd, qdd, tau)
        return torque, qdd, multipliers
    torque, qdd = np.empty(q.shape), np.empty(q.shape)
    rows = robot.armature, held, q, qd, given, tau, qdd, torque
    _run(robot, articulated.articulated_dynamics_rows, *rows, check=check)
    torque -= tau
    return torque, qdd, qdd[:, :0]


def accelerations(
    robot: RobotModel,
    held: Array,
    q: Array,
    qd: Array,
    given: Array,
    tau: Array,
    check: bool = True,
) -> tuple[Array, Array]:
    """Return accelerations (k, n) and multipliers (k, rows) of them alone; as :func:`hybrid`."""
    if not robot.constraint_names:
        return hybrid(robot, False, held, q, qd, given, tau, check)[1:]
    qdd, multipliers = np.empty(q.shape), np.empty((len(q), len(robot.constraint_names)))
    rows = held, q, qd, given, tau, qdd, multipliers
    _run(robot, constrained.constrained_dynamics_rows, *rows, check=check)
    return qdd, multipliers


def torques(
    robot: RobotModel, held: Array, q: Array, qd: Array, qdd: Array, tau: Array
) -> tuple[Array, Array]:
    """Return torques (k, n) of held joints and multipliers (k, rows) of a motion (k, n).

    Both are of least norm: the multipliers come from the equations of the other coordinates
    (section 5.1.2); what these leave open goes to make the torques small. Forces tau (k, n) act
    beside them.
    """
    torque, multipliers = np.empty(q.shape), np.empty((len(q), len(robot.constraint_names)))
    if robot.constraint_names:
        rows = (held, q, qd, qdd, tau, torque, multipliers)
        _run(robot, constrained_torques.constrained_torques_rows, *rows)
        return torque, multipliers
    _run(robot, inverse.inverse_dynamics_rows, q, qd, qdd, torque)
    torque -= tau
    left = np.where(held == 0.0, torque, 0.0)
    size = AGREEMENT * (1.0 + np.abs(torque).max(axis=1, initial=0.0))
    for row in left[np.abs(left).max(axis=1, initial=0.0) > size]:
        worst = int(np.argmax(np.abs(row)))
        raise StateError(_beyond_reach(robot, row[worst], worst))
    return torque, multipliers


def _run(robot: RobotModel, kernel: Any, *rows: Array, check: bool = True) -> None:
    """Run a kernel on rows (k, …) of states, others (m,); raise the error of the first bad one."""
    k = len(rows[-1])
    status = run_rows(robot, kernel, k, *rows)
    if status == GOOD or (status == NOT_FINITE and not check):
        return
    for i in range(k):
        row = [each if each.ndim == 1 else each[i : i + 1] for each in rows]
        raise_status(robot, run_rows(robot, kernel, 1, *row))


def _beyond_reach(robot: RobotModel, left: float, coordinate: int) -> str:
    return (
        f'{robot.tree.name}: qdd must be one that the actuated joints can give, got '
        f'{left:.3g} N m (or N) left on {robot.coordinate_names[coordinate]}'
    )


def raise_status(robot: RobotModel, status: int, **arguments: Array) -> None:
    """Raise the error of a constrained kernel's status."""
    if status not in (CONTRADICTED, OPENED, OPENING, BEYOND_REACH):
        robot.raise_for_status(status, **arguments)
        return
    found = robot.work[int(robot.arrays.topology[0, constraint_layout.CONSTRAINTS_WORK]) :]
    worst, residual = int(found[constraint_layout.WORST]), found[constraint_layout.RESIDUAL]
    if status == BEYOND_REACH:
        raise StateError(_beyond_reach(robot, residual, worst))
    name, left = robot.constraint_names[worst], f'{residual:.3g}'
    if status == OPENING:
        raise StateError(
            f'{robot.tree.name}: qdd must keep {name!r} closed, got {left} m/s^2 (or rad/s^2) of '
            f'its row {worst}'
        )
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
