"""Linear models of a robot: which inputs, which outputs, about which state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from denoc_ros.dynamics import constraints
from denoc_ros.dynamics.constraint_derivatives import force_derivatives
from denoc_ros.dynamics.linear_model import LinearModel
from denoc_ros.dynamics.linear_signals import read_inputs, read_outputs
from denoc_ros.dynamics.mechanism_modes import independent_joints
from denoc_ros.dynamics.minimal_coordinates import minimal_coordinates
from denoc_ros.dynamics.robot_model import RobotModel
from denoc_ros.dynamics.sensor_values import SensorValues
from denoc_ros.dynamics.validation import as_vector
from denoc_ros.model.friction import Friction
from denoc_ros.types import Array

Int = NDArray[np.int64]
State = tuple[Array, Array, Array]


class Linearizable(SensorValues):
    """Linear models of a robot about a state."""

    def linearize(
        self,
        q: ArrayLike,
        qd: ArrayLike | None = None,
        tau: ArrayLike | None = None,
        inputs: Sequence[str] | None = None,
        outputs: Sequence[str] = ('joints', 'sensors'),
        locked: Sequence[str] = (),
        friction: bool = True,
    ) -> LinearModel:
        """Return the linear model about a state: an equilibrium, or an instant of a motion.

        Parameters
        ----------
        q : (n,)
            Closed, where there are loops and mimic joints.
        qd : (n,), optional
            Default zero.
        tau : (n,), optional
            Generalized forces that act at that state. Default those of the joints that hold
            them: their accelerations are then zero, and where the amplitudes are not in
            equilibrium theirs are what `qdd` of the model says.
        inputs : names, optional
            A joint or any other coordinate (a generalized force along it), or `wrench:<frame>`
            (six: force and moment, base axes, at its origin). Default the joints, without those
            that mimic.
        outputs : names
            `joints`, `rates` (of the joints), `states`, `sensors`, a coordinate, a sensor,
            `deflection:<link>` (ux, uy, uz), `pose:<frame>` (position and small rotation, base
            axes), `velocity:<frame>`, `acceleration:<frame>`.
        locked : names of joints
            They do not move, whatever acts.
        friction : bool
            False leaves out the slope of Coulomb friction, which at rest is that of a damper of
            friction / 1e-3 rad/s: as for joints that are moving.

        Returns
        -------
        LinearModel
            Of x = [y; y'], y the coordinates that are left independent by locked joints, loops
            and mimic joints, in their order.

        Raises
        ------
        StateError
            For a wrong shape, unknown names, or a state that opens a loop.

        Notes
        -----
        Z^T (I dq'' + d(tau)/dq dq + d(tau)/dq' dq' - d(J^T lambda)/dq dq) = Z^T dtau with the
        null space Z of the closure Jacobian, dq = Z y, and dq', dq'' as the rows of the loops
        then say (docs/linear_models.md).
        """
        return _linearize(self, q, qd, tau, inputs, outputs, locked, friction)


def _linearize(
    robot: Linearizable,
    q: ArrayLike,
    qd: ArrayLike | None,
    tau: ArrayLike | None,
    inputs: Sequence[str] | None,
    outputs: Sequence[str],
    locked: Sequence[str],
    friction: bool,
) -> LinearModel:
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
    robot: Linearizable, q: Array, qd: Array, tau: ArrayLike | None, locked: Int
) -> tuple[Array, Array, Array]:
    """Return forces, accelerations and multipliers at a state."""
    zero = np.zeros(robot.n)
    if tau is not None:
        forces = as_vector('tau', tau, (robot.n,)).copy()
        qdd, multipliers = constraints.accelerations(
            robot, q, qd, forces, locked, np.zeros(len(locked))
        )
        return forces, qdd, multipliers
    driven = np.union1d(robot.indices(independent_joints(robot, q)), locked)
    torque, qdd, multipliers = constraints.hybrid(
        robot, q, qd, np.zeros(len(driven)), driven, zero, zero
    )
    forces = zero
    forces[driven] = torque
    return forces, qdd, multipliers


def _forces(
    robot: Linearizable, state: State, multipliers: Array, friction: bool
) -> tuple[Array, Array, Array]:
    """Return the derivatives (n, n) by q and q' of I q'' + h - J^T lambda, and I."""
    _q, qd, _qdd = state
    tied = force_derivatives(robot, *state, multipliers, friction)
    by_qd = tied.by_rate if friction else tied.by_rate - np.diag(friction_slope(robot, qd))
    return tied.by_q, by_qd, tied.inertia


def friction_slope(robot: RobotModel, qd: Array) -> Array:
    """Return the slope (n,) of the coordinates' Coulomb friction at rates qd."""
    return Friction(np.zeros(robot.n), robot.friction).slope(qd)
