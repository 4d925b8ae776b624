"""Linear models of a robot: which inputs, which outputs, about which state.

Their states are minimal coordinates: small motions under locked joints, loops and mimic joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from denoc_ros.dynamics import constrained_dynamics as constraints
from denoc_ros.dynamics.constrained_dynamics import (
    RANK,
    applied_change,
    closure_rows,
    jacobian,
    row_derivatives,
)
from denoc_ros.dynamics.dynamics_derivatives import DifferentiableModel
from denoc_ros.dynamics.linear.linear_model import LinearModel
from denoc_ros.dynamics.linear.natural_modes import independent_joints
from denoc_ros.dynamics.sensor_values import SensorValues
from denoc_ros.dynamics.validation import as_vector
from denoc_ros.errors import StateError
from denoc_ros.kernels.constraints.closing import OPEN
from denoc_ros.model.joint_friction import Friction
from denoc_ros.types import Array

WRENCH = ('fx', 'fy', 'fz', 'mx', 'my', 'mz')
POSE = ('x', 'y', 'z', 'rx', 'ry', 'rz')
VELOCITY = ('vx', 'vy', 'vz', 'wx', 'wy', 'wz')
ACCELERATION = ('ax', 'ay', 'az', 'alx', 'aly', 'alz')
DEFLECTION = ('ux', 'uy', 'uz')
GROUPS = ('joints', 'rates', 'states', 'sensors')
KINDS = ('pose', 'velocity', 'acceleration', 'deflection')


@dataclass(frozen=True)
class Outputs:
    """Names, and derivatives (outputs, n) by q, q' and q''."""

    names: tuple[str, ...]
    by_q: Array
    by_qd: Array
    by_qdd: Array


def read_inputs(
    robot: SensorValues, q: Array, inputs: Sequence[str] | None
) -> tuple[tuple[str, ...], Array]:
    """Return names and the generalized forces (n, inputs) per unit of each input.

    Raises
    ------
    StateError
        For a name that the robot does not have.
    """
    if inputs is None:
        inputs = robot.tree.non_mimic_joints
    names: list[str] = []
    columns = [np.zeros((robot.n, 0))]
    for given in inputs:
        kind, _, frame = given.partition(':')
        if kind == 'wrench':
            names += [f'{given}/{part}' for part in WRENCH]
            columns.append(robot.frame_jacobian(frame, q).T)
        elif given in robot.coordinate_names:
            names.append(given)
            columns.append(np.eye(robot.n)[:, [robot.coordinate_names.index(given)]])
        else:
            known = ', '.join(robot.coordinate_names)
            raise StateError(f'input must be wrench:<frame> or one of {known}, got {given!r}')
    return tuple(names), np.hstack(columns)


def read_outputs(
    robot: SensorValues, state: tuple[Array, Array, Array], outputs: Sequence[str]
) -> Outputs:
    """Return the outputs of a linear model about a state q, q', q''.

    Raises
    ------
    StateError
        For a name that the robot does not have.
    """
    parts = [_read(robot, state, given) for given in outputs]
    empty = np.zeros((0, robot.n))
    return Outputs(
        tuple(name for part in parts for name in part.names),
        np.concatenate([empty, *(part.by_q for part in parts)]),
        np.concatenate([empty, *(part.by_qd for part in parts)]),
        np.concatenate([empty, *(part.by_qdd for part in parts)]),
    )


def _read(robot: SensorValues, state: tuple[Array, Array, Array], given: str) -> Outputs:
    kind, colon, name = given.partition(':')
    if colon and kind in KINDS:
        return _measured(robot, state, kind, name, given)
    zero = np.zeros((robot.n, robot.n))
    unit = np.eye(robot.n)
    coordinates = robot.coordinate_names
    rates = tuple(f'{coordinate}_rate' for coordinate in coordinates)
    joints = robot.joint_indices
    if given == 'joints':
        return Outputs(robot.joint_names, unit[joints], zero[joints], zero[joints])
    if given == 'rates':
        return Outputs(tuple(rates[k] for k in joints), zero[joints], unit[joints], zero[joints])
    if given == 'states':
        two, none = np.concatenate([unit, zero]), np.concatenate([zero, unit])
        return Outputs((*coordinates, *rates), two, none, np.zeros_like(two))
    if given in coordinates:
        k = [coordinates.index(given)]
        return Outputs((given,), unit[k], zero[k], zero[k])
    if given in rates:
        k = [rates.index(given)]
        return Outputs((given,), zero[k], unit[k], zero[k])
    return _sensors(robot, state, given)


def _sensors(robot: SensorValues, state: tuple[Array, Array, Array], given: str) -> Outputs:
    names = robot.sensor_names
    rows = robot.sensor_derivatives(*state, by_shapes=True)
    if given == 'sensors':
        return Outputs(names, *rows)
    if given in names:
        k = [names.index(given)]
        return Outputs((given,), *(row[k] for row in rows))
    groups = ', '.join((*GROUPS, *(f'{kind}:<name>' for kind in KINDS)))
    known = ', '.join((*robot.coordinate_names, *names))
    raise StateError(f'output must be {groups} or one of {known}, got {given!r}')


def _measured(
    robot: SensorValues, state: tuple[Array, Array, Array], kind: str, name: str, given: str
) -> Outputs:
    """Outputs of frames and beams."""
    q, qd, qdd = state
    if kind == 'deflection':
        by_q = robot.tip_deflection_jacobian(name, q)
        zero = np.zeros_like(by_q)
        return Outputs(tuple(f'{given}/{part}' for part in DEFLECTION), by_q, zero, zero)
    if kind == 'pose':
        by_q = robot.frame_jacobian(name, q)
        zero = np.zeros_like(by_q)
        return Outputs(tuple(f'{given}/{part}' for part in POSE), by_q, zero, zero)
    if kind == 'velocity':
        by_q, by_qd = robot.frame_velocity_derivatives(name, q, qd)
        parts = tuple(f'{given}/{part}' for part in VELOCITY)
        return Outputs(parts, by_q, by_qd, np.zeros_like(by_q))
    parts = tuple(f'{given}/{part}' for part in ACCELERATION)
    return Outputs(parts, *robot.frame_acceleration_derivatives(name, q, qd, qdd))


Int = NDArray[np.int64]
State = tuple[Array, Array, Array]

REGULAR = 1e-6  # least singular value of a choice of coordinates that determines the others


def linearize(
    robot: SensorValues,
    q: ArrayLike,
    qd: ArrayLike | None,
    tau: ArrayLike | None,
    inputs: Sequence[str] | None,
    outputs: Sequence[str],
    locked: Sequence[str],
    friction: bool,
) -> LinearModel:
    """Return the linear model about a state (see :meth:`Robot.linearize`)."""
    n = robot.n
    q = as_vector('q', q, (n,))
    qd = np.zeros(n) if qd is None else as_vector('qd', qd, (n,))
    held = robot.indices(locked)
    forces, qdd, multipliers = _nominal(robot, q, qd, tau, held)
    state = (q, qd, qdd)
    motion = minimal_coordinates(robot, state, held)
    by_q, by_qd, inertia = _forces(robot, state, multipliers, friction)
    m = len(motion.independent)
    basis = motion.basis
    mass = basis.T @ inertia @ basis
    positions = np.hstack([basis, np.zeros((n, m))])
    pull = by_q @ positions + by_qd @ motion.rates + inertia @ motion.accelerations
    input_names, push = read_inputs(robot, q, inputs)
    a = np.zeros((2 * m, 2 * m))
    a[:m, m:] = np.eye(m)
    a[m:] = -np.linalg.solve(mass, basis.T @ pull)
    b = np.zeros((2 * m, len(input_names)))
    b[m:] = np.linalg.solve(mass, basis.T @ push)
    made = read_outputs(robot, state, outputs)
    accelerations = motion.accelerations + basis @ a[m:]
    c = made.by_q @ positions + made.by_qd @ motion.rates + made.by_qdd @ accelerations
    names = [robot.coordinate_names[k] for k in motion.independent]
    return LinearModel(
        a, b, c, made.by_qdd @ basis @ b[m:],
        (*names, *(f'{name}_rate' for name in names)), input_names, made.names,
        q.copy(), qd.copy(), forces, qdd, mass, multipliers,
    )  # fmt: skip


def _nominal(
    robot: SensorValues, q: Array, qd: Array, tau: ArrayLike | None, locked: Int
) -> tuple[Array, Array, Array]:
    """Return forces, accelerations and multipliers at a state."""
    zero = np.zeros(robot.n)
    if tau is not None:
        forces = as_vector('tau', tau, (robot.n,)).copy()
        rows = q[None], qd[None], zero[None], forces[None]
        qdd, multipliers = constraints.accelerations(robot, robot.held(locked), *rows)
        return forces, qdd[0], multipliers[0]
    driven = np.union1d(robot.indices(independent_joints(robot, q)), locked)
    names, still = [robot.coordinate_names[k] for k in driven], np.zeros(len(driven))
    torque, qdd, multipliers = robot.constrained_hybrid_dynamics(q, qd, still, names)
    forces = zero
    forces[driven] = torque
    return forces, qdd, multipliers


def _forces(
    robot: SensorValues, state: State, multipliers: Array, friction: bool
) -> tuple[Array, Array, Array]:
    """Return the derivatives (n, n) by q and q' of I q'' + h - J^T lambda, and I.

    The multipliers stay; without friction its slope is left out.
    """
    q, qd, qdd = state
    change = constraints.row_derivatives(robot, q, qd, qdd)
    axes = change.axes
    force, slope = constraints.axis_resistance(robot, axes, qd, friction)
    by_q, by_rate, inertia = robot.inverse_dynamics_derivatives(q, qd, qdd)
    by_q = by_q - constraints.transposed_change(robot, q, multipliers, -force)
    by_q = by_q + axes.T @ (slope[:, None] * change.axis_rates_by_q)
    by_rate = by_rate + axes.T @ (slope[:, None] * axes)
    if not friction:
        by_rate = by_rate - np.diag(Friction(np.zeros(robot.n), robot.friction).slope(qd))
    return by_q, by_rate, inertia


@dataclass(frozen=True)
class MinimalCoordinates:
    """Changes of state and acceleration in terms of those of independent coordinates.

    With x = [y; y']: dq = basis y, dq' = rates x, dq'' = basis y'' + accelerations x.
    """

    independent: Int  # (m,) where y stand among the coordinates
    basis: Array  # (n, m) null space of the closure Jacobian, the unit matrix at y
    rates: Array  # (n, 2 m)
    accelerations: Array  # (n, 2 m)


def minimal_coordinates(
    robot: DifferentiableModel, state: tuple[Array, Array, Array], locked: Int
) -> MinimalCoordinates:
    """Return the motions that are left about a state q, q', q'' (n,) with some joints locked.

    Raises
    ------
    StateError
        The loops are open there, or the rates open them.

    Notes
    -----
    J dq = 0; J dq' + d(J q')/dq dq = 0; J dq'' + d(J q'' + g)/dq dq + dg/dq' dq' = 0 with
    g = J' q', whose solutions by least squares are moved along the basis until y, y', y'' are
    those of the independent coordinates.
    """
    q, qd, qdd = state
    free = np.setdiff1d(np.arange(robot.n), locked)
    rows = jacobian(robot, q)[0][:, free]
    if not len(rows):
        basis = np.eye(robot.n)[:, free]
        m = len(free)
        rates = np.hstack([np.zeros((robot.n, m)), basis])
        return MinimalCoordinates(free, basis, rates, np.zeros((robot.n, 2 * m)))
    _require_closed(robot, q, qd)
    null = scipy.linalg.null_space(rows, rcond=RANK)
    chosen = _independent(robot, q, free, null)
    m = len(chosen)
    basis = np.zeros((robot.n, m))
    basis[free] = null @ np.linalg.inv(null[chosen])
    inverse = np.linalg.pinv(rows, rcond=RANK)

    def completed(wanted: Array) -> Array:
        """Return the changes (n, ...) that meet J change = wanted, y standing still."""
        change = np.zeros((robot.n, wanted.shape[1]))
        change[free] = inverse @ wanted
        return change - basis @ change[free[chosen]]

    rates = np.hstack([completed(-applied_change(robot, q, qd) @ basis), basis])
    change = row_derivatives(robot, q, qd, qdd)
    positions = np.hstack([basis, np.zeros((robot.n, m))])
    accelerations = completed(-change.by_q @ positions - change.by_rate @ rates)
    return MinimalCoordinates(free[chosen], basis, rates, accelerations)


def _require_closed(robot: DifferentiableModel, q: Array, qd: Array) -> None:
    errors, rates, _bias = closure_rows(robot, q, qd)
    for what, values, unit, verb in (
        ('q', errors, 'm (or rad)', 'assemble'),
        ('qd', rates, 'm/s (or rad/s)', 'assemble_rates'),
    ):
        worst = int(np.argmax(np.abs(values)))
        if abs(values[worst]) > OPEN:
            raise StateError(
                f'{robot.tree.name}: {what} must keep {robot.constraint_names[worst]!r} closed '
                f'to {OPEN:g} {unit} (see {verb}), got {values[worst]:.3g}'
            )


def _independent(robot: DifferentiableModel, q: Array, free: Int, null: Array) -> Int:
    """Return which rows of a null space (free, m) determine the others.

    Amplitudes, and the joints that hold the mechanism still, if they do; else those that come
    first by pivoting.
    """
    held = robot.indices(independent_joints(robot, q))
    wanted = np.flatnonzero(np.isin(free, np.union1d(robot.flexible_indices, held)))
    if len(wanted) == null.shape[1]:
        smallest = np.linalg.svd(null[wanted], compute_uv=False).min(initial=1.0)
        if smallest > REGULAR:
            return wanted
    order = scipy.linalg.qr(null.T, mode='r', pivoting=True)[1]
    return np.sort(order[: null.shape[1]]).astype(np.int64)
