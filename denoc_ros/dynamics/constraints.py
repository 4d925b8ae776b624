"""Loops and mimic joints as constraint rows: multipliers and torques (book, section 5.1).

I q'' + h = tau + J^T lambda with J q'' + J' q' = 0. Rows that say the same twice are normal (a
planar loop in space has two or three of them): multipliers are then those of least norm.
"""

from __future__ import annotations

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
from denoc_ros.kernels.handle import GOOD, MISFIT
from denoc_ros.model.friction import Friction
from denoc_ros.types import Array

Int = NDArray[np.int64]

# A singular value of the rows this far below the greatest is none (as in kernels.multipliers).
RANK = 1e-6
# Equations that cannot all be met contradict each other by more than this part of their terms:
# a closed state is closed to 1e-9, torques and accelerations come from files and trajectories.
AGREEMENT = 1e-6


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
    out = np.empty((rows + int(robot.arrays.topology[0, constraint_layout.AXIS_ROWS]), robot.n))
    if not rows:
        return out, out
    robot.raise_for_status(closure.closure_jacobian(robot.handle, q, out), q=q)
    return out[:rows], out[rows:]


def required_force(robot: RobotModel, q: Array, qd: Array, qdd: Array, axes: Array) -> Array:
    """Return I q'' + h (n,) with the damping and friction of the loops' own joints."""
    force = np.empty(robot.n)
    kernel = entry(inverse.inverse_dynamics)
    robot.raise_for_status(kernel(robot.handle, q, qd, qdd, force), q=q, qd=qd, qdd=qdd)
    add_loop_friction(robot, qd, axes, force)
    return force


def add_loop_friction(robot: RobotModel, qd: Array, axes: Array, force: Array) -> None:
    """Add damping and friction of the loops' own joints to a force (n,) in place."""
    resisting = [loop for loop in robot.tree.loops if loop.damping > 0.0 or loop.friction > 0.0]
    for loop, axis in zip(resisting, axes, strict=True):
        force += axis * Friction(np.asarray(loop.damping), np.asarray(loop.friction)).force(
            float(axis @ qd)
        )


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
        inputs = (held, q, qd, given, tau)
        kernel = constrained.constrained_dynamics_rows
        status = run_rows(robot, kernel, 1, inputs, (qdd, multipliers))
    return status


def forward(robot: RobotModel, q: Array, qd: Array, tau: Array) -> tuple[Array, Array]:
    """Return accelerations (n,) and multipliers (rows,)."""
    return accelerations(robot, q, qd, tau, np.zeros(0, dtype=np.int64), np.zeros(0))


def forward_rows(robot: RobotModel, q: Array, qd: Array, tau: Array) -> tuple[Array, Array]:
    """Return accelerations (k, n) and multipliers (k, rows) of many states in one call."""
    qdd, multipliers = np.empty_like(q), np.zeros((len(q), len(robot.constraint_names)))
    inputs = (np.zeros(robot.n), q, qd, np.zeros_like(q), tau)
    if multipliers.size:
        kernel, outputs = constrained.constrained_dynamics_rows, (qdd, multipliers)
    else:
        kernel, outputs = articulated.articulated_dynamics_rows, (qdd, np.empty_like(q))
    if run_rows(robot, kernel, len(q), inputs, outputs) != GOOD:
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
