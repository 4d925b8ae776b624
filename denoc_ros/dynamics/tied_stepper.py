"""The fixed step of the real-time side for robots with mimic joints: ties hold exactly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from denoc_ros.dynamics.joint_ties import coordinate_ties, has_mimics
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.errors import SolverError, StateError
from denoc_ros.kernels.handle import DAMPING, FRICTION, STIFFNESS
from denoc_ros.kernels.step import GAMMA
from denoc_ros.model.lowering import SLIP_RATE

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot

Array = NDArray[np.float64]


def stepper_of(robot: Robot, step: float) -> Stepper:
    """Return what advances a robot by a fixed step [s]: tied where it has mimic joints."""
    return TiedStepper(robot, step) if has_mimics(robot) else Stepper(robot, step)


class TiedStepper(Stepper):
    """Advances the state of a robot with mimic joints; every state it leaves obeys the ties.

    Parameters
    ----------
    robot : Robot
        Its workspace is used: do not share it with another thread.
    step : float [s]

    Notes
    -----
    The Rosenbrock W-method of :mod:`denoc_ros.kernels.step` in the coordinates z that follow no
    other, q = T z + c, dense: with D = gamma dt C + (gamma dt)^2 K, per stage

        T^T (I + D) T z'' = T^T (tau - h - ...).

    A follower's efforts, inertia, stiffness and damping so are its leader's to carry.
    """

    def __init__(self, robot: Robot, step: float) -> None:
        super().__init__(robot, step)
        self._ties, self._offset, self._places = coordinate_ties(robot)
        n = robot.n
        self._inertia = np.zeros((n, n))
        self._bias, self._stage_q, self._stage_qd = np.zeros((3, n))
        diagonals = robot.lowered.diagonals
        self._stiffness = diagonals[STIFFNESS].copy()
        self._damping = diagonals[DAMPING].copy()
        self._slope = diagonals[FRICTION] / SLIP_RATE

    def free(self, q: Array, qd: Array, tau: Array) -> None:
        """Advance q and qd (n,) in place under generalized forces tau (n,), held over the step.

        Followers are placed by their leaders, whatever q and qd say of them.

        Raises
        ------
        StateError
            A number is not finite; q and qd are then as they were.
        SolverError
            The inertia is not positive definite.
        """
        self._require(q, qd, tau)
        ties, dt, g = self._ties, self.step, GAMMA * self.step
        z, zd = q[self._places], qd[self._places]
        start, rate = ties @ z + self._offset, ties @ zd
        stiffness = self._stiffness
        damping = self._damping + self._slope * (1.0 - np.tanh(rate / SLIP_RATE) ** 2)
        implicit = g * damping + g * g * stiffness
        first = self._solve(implicit, start, rate, tau - g * stiffness * rate)
        velocity = zd + g * first
        np.matmul(ties, z + dt * velocity, out=self._stage_q)
        self._stage_q += self._offset
        np.matmul(ties, zd + dt * first, out=self._stage_qd)
        force = tau - g * stiffness * (self._stage_qd - 2.0 * (ties @ velocity))
        force += 2.0 * implicit * (ties @ first)
        second = self._solve(implicit, self._stage_q, self._stage_qd, force) - 2.0 * first
        second_velocity = zd + dt * first - 2.0 * velocity + g * second
        z = z + dt * (1.5 * velocity + 0.5 * second_velocity)
        zd = zd + dt * (1.5 * first + 0.5 * second)
        if not (np.isfinite(z).all() and np.isfinite(zd).all()):
            raise StateError('state and torque must be finite, got one that is not')
        q[:] = ties @ z + self._offset
        qd[:] = ties @ zd

    def driven(self, q: Array, qd: Array, qdd_joints: Array, tau: Array | None = None) -> None:
        """Advance q and qd (n,) in place with the joints' accelerations (joints,) given.

        As :meth:`Stepper.driven`; followers are placed by their leaders, whatever is given.
        """
        super().driven(q, qd, qdd_joints, tau)
        q[:] = self._ties @ q[self._places] + self._offset
        qd[:] = self._ties @ qd[self._places]

    def _solve(self, implicit: Array, q: Array, qd: Array, force: Array) -> Array:
        """Return z'' (r,) of T^T (I + diag(implicit)) T z'' = T^T (force - h)."""
        robot, ties = self.robot, self._ties
        inertia = robot.inertia_matrix(q, out=self._inertia, check=False)
        bias = robot.bias_forces(q, qd, out=self._bias, check=False)
        inertia.flat[:: robot.n + 1] += implicit
        _, acceleration, status = dposv(ties.T @ inertia @ ties, ties.T @ (force - bias))
        if status > 0:
            if not np.isfinite(inertia).all():
                raise StateError('state and torque must be finite, got one that is not')
            raise SolverError(f'{robot.tree.name}: the inertia must be positive definite')
        return np.asarray(acceleration, dtype=np.float64)

    def _require(self, *arrays: Array) -> None:
        n = self.robot.n
        if any(getattr(array, 'shape', None) != (n,) for array in arrays):
            raise StateError(
                f'q, qd and tau must be writable float64 arrays of shape ({n},), got '
                + ', '.join(str(np.shape(array)) for array in arrays)
            )
