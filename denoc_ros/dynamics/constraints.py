"""Loops and mimic joints as constraint rows: multipliers and torques (book, section 5.1).

I q'' + h = tau + J^T lambda with J q'' + J' q' = 0. Rows that say the same twice are normal (a
planar loop in space has two or three of them): multipliers are then those of least norm.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from denoc_ros.errors import SolverError, StateError
from denoc_ros.kernels import closure, composite, inverse
from denoc_ros.kernels.compiled import entry
from denoc_ros.kernels.layout import SLIP_RATE
from denoc_ros.kernels.tie_layout import AXIS_ROWS

if TYPE_CHECKING:
    from denoc_ros.dynamics.held_model import HeldModel

Array = NDArray[np.float64]
Int = NDArray[np.int64]

# A singular value of the rows this far below the greatest is none: rounding leaves 1e-16 of a
# redundant row, axes printed with seven digits 1e-7, and what is above 1e-6 is meant.
RANK = 1e-6
# Equations that cannot all be met contradict each other by more than this part of their terms:
# a closed state is closed to 1e-9, torques and accelerations come from files and trajectories.
AGREEMENT = 1e-6


def closure_rows(robot: HeldModel, q: Array, qd: Array) -> Array:
    """Return errors, rates and acceleration biases (3, rows) of the loops and mimic joints."""
    out = np.empty((3, len(robot.lowered.tie_names)))
    robot.judge(closure.closure(robot.handle, q, qd, out), q=q, qd=qd)
    return out


def jacobian(robot: HeldModel, q: Array) -> tuple[Array, Array]:
    """Return J (rows, n) and the rows (axes, n) of free axes with damping or friction."""
    rows = len(robot.lowered.tie_names)
    out = np.empty((rows + int(robot.lowered.ints[0, AXIS_ROWS]), robot.n))
    robot.judge(closure.closure_jacobian(robot.handle, q, out), q=q)
    return out[:rows], out[rows:]


def required_force(robot: HeldModel, q: Array, qd: Array, qdd: Array, axes: Array) -> Array:
    """Return I q'' + h (n,) with the damping and friction of the loops' own joints."""
    force = np.empty(robot.n)
    kernel = entry(inverse.inverse_dynamics)
    robot.judge(kernel(robot.handle, q, qd, qdd, force), q=q, qd=qd, qdd=qdd)
    add_loop_friction(robot, qd, axes, force)
    return force


def add_loop_friction(robot: HeldModel, qd: Array, axes: Array, force: Array) -> None:
    """Add damping and friction of the loops' own joints to a force (n,) in place."""
    resisting = [loop for loop in robot.tree.loops if loop.damping > 0.0 or loop.friction > 0.0]
    for loop, axis in zip(resisting, axes, strict=True):
        rate = float(axis @ qd)
        slip = np.tanh(rate / robot.lowered.reals[SLIP_RATE])
        force += axis * (loop.damping * rate + loop.friction * slip)


def inertia(robot: HeldModel, q: Array) -> Array:
    """Return the inertia matrix (n, n)."""
    out = np.empty((robot.n, robot.n))
    robot.judge(entry(composite.inertia_matrix)(robot.handle, q, out), q=q)
    return out


def least_solution(matrix: Array, wanted: Array, least: float = RANK) -> tuple[Array, Array, int]:
    """Return x of least norm with matrix x = wanted, the residual, and the rank."""
    if not matrix.size:
        return np.zeros(matrix.shape[1]), wanted, 0
    solution, _, rank, _ = np.linalg.lstsq(matrix, wanted, rcond=least)
    x = np.asarray(solution, dtype=np.float64)
    return x, wanted - matrix @ x, int(rank)


def forward(robot: HeldModel, q: Array, qd: Array, tau: Array) -> tuple[Array, Array]:
    """Return accelerations (n,) and multipliers (rows,)."""
    return _accelerations(robot, q, qd, tau, np.zeros(0, dtype=np.int64), np.zeros(0))


def _accelerations(
    robot: HeldModel, q: Array, qd: Array, tau: Array, held: Int, given: Array
) -> tuple[Array, Array]:
    """Return accelerations and multipliers with those of some coordinates given."""
    rows, axes = jacobian(robot, q)
    bias = closure_rows(robot, q, qd)[2]
    start = np.zeros(robot.n)
    start[held] = given
    free = np.setdiff1d(np.arange(robot.n), held)
    force = tau - required_force(robot, q, qd, start, axes)
    try:
        factor = scipy.linalg.cho_factor(inertia(robot, q)[np.ix_(free, free)])
    except np.linalg.LinAlgError as error:
        raise SolverError(f'{robot.tree.name}: the inertia must be positive definite') from error
    start[free] = scipy.linalg.cho_solve(factor, force[free])
    if not len(rows):
        return start, np.zeros(0)
    spread = scipy.linalg.cho_solve(factor, rows[:, free].T)
    wanted = -bias - rows @ start
    multipliers, residual, rank = least_solution(rows[:, free] @ spread, wanted, RANK**2)
    size = 1.0 + float(np.abs(bias).max() + np.abs(wanted).max())
    _require_agreement(robot, residual, size, rank)
    start[free] += spread @ multipliers
    return start, multipliers


def inverse_torques(
    robot: HeldModel, q: Array, qd: Array, qdd: Array, actuated: Int, tau: Array | None = None
) -> tuple[Array, Array]:
    """Return torques of the actuated coordinates and multipliers, both of least norm.

    tau (n,) are generalized forces of the other coordinates, zero at the actuated ones.

    The multipliers come from the equations of the coordinates without an actuator (section 5.1.2);
    what these leave open goes to make the torques small.
    """
    rows, axes = jacobian(robot, q)
    require_closed_accelerations(robot, rows, closure_rows(robot, q, qd)[2], qdd)
    need = required_force(robot, q, qd, qdd, axes)
    if tau is not None:
        need -= tau
    passive = np.setdiff1d(np.arange(robot.n), actuated)
    multipliers, residual, _ = least_solution(rows[:, passive].T, need[passive])
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
    robot: HeldModel, q: Array, qd: Array, qdd_actuated: Array, actuated: Int, tau: Array
) -> tuple[Array, Array, Array]:
    """Return torques of the actuated coordinates, all accelerations and multipliers."""
    loads = tau.copy()
    loads[actuated] = 0.0
    qdd, _ = _accelerations(robot, q, qd, loads, actuated, qdd_actuated)
    torque, multipliers = inverse_torques(robot, q, qd, qdd, actuated, loads)
    return torque, qdd, multipliers


def require_closed_accelerations(robot: HeldModel, rows: Array, bias: Array, qdd: Array) -> None:
    """Raise StateError where J q'' + J' q' is not zero."""
    if not len(rows):
        return
    residual = rows @ qdd + bias
    size = 1.0 + float((np.abs(rows) @ np.abs(qdd) + np.abs(bias)).max())
    worst = int(np.argmax(np.abs(residual)))
    if abs(residual[worst]) > AGREEMENT * size:
        raise StateError(
            f'{robot.tree.name}: qdd must keep {robot.lowered.tie_names[worst]!r} closed, got '
            f'{residual[worst]:.3g} m/s^2 (or rad/s^2) of its row {worst}'
        )


def _require_agreement(robot: HeldModel, residual: Array, size: float, rank: int) -> None:
    worst = int(np.argmax(np.abs(residual)))
    if abs(residual[worst]) > AGREEMENT * size:
        raise SolverError(
            f'{robot.tree.name}: the rows of {robot.lowered.tie_names[worst]!r} must not '
            f'contradict the others, got a singular configuration: rank {rank} of '
            f'{len(residual)} rows and {residual[worst]:.3g} m/s^2 (or rad/s^2) left'
        )
