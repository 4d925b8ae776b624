"""The fixed step of the real-time side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from denoc_ros.errors import SolverError, StateError
from denoc_ros.kernels.articulated import GOOD, SINGULAR
from denoc_ros.kernels.step import STEP_ROWS, advance

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot

Array = NDArray[np.float64]


class Stepper:
    """Advances a robot's state by a fixed step; allocates nothing per call.

    A Rosenbrock W-method of order 2, linearly implicit in elasticity, damping and friction, so a
    mode faster than the step stays stable (see :mod:`denoc_ros.kernels.step`).

    Parameters
    ----------
    robot : Robot
        Its workspace is used: do not share it with another thread.
    step : float [s]
    """

    def __init__(self, robot: Robot, step: float) -> None:
        if not (np.isfinite(step) and step > 0.0):
            raise StateError(f'step must be > 0 s, got {step}')
        self.robot = robot
        self.step = float(step)
        self._steps = np.zeros((STEP_ROWS, robot.n))
        self._zero = np.zeros(robot.n)
        self._given = np.zeros(robot.n)
        self._free = robot.held_bodies(np.zeros(0, dtype=np.int64))
        self._held = robot.held_bodies(robot.joint_indices)

    def free(self, q: Array, qd: Array, tau: Array) -> None:
        """Advance q and qd (n,) in place under generalized forces tau (n,), held over the step.

        Raises
        ------
        StateError
            A number is not finite; q and qd are then as they were.
        """
        self._advance(self._free, q, qd, self._zero, tau)

    def driven(self, q: Array, qd: Array, qdd_joints: Array) -> None:
        """Advance q and qd (n,) in place with the joints' accelerations (joints,) given.

        Joints move with constant acceleration over the step, amplitudes by their dynamics.
        """
        self._given[self.robot.joint_indices] = qdd_joints
        self._advance(self._held, q, qd, self._given, self._zero)

    def _advance(
        self, held: NDArray[np.int64], q: Array, qd: Array, given: Array, tau: Array
    ) -> None:
        ints, reals, work, diagonals, bodies, slip = self.robot.model_arrays
        status = advance(
            ints, reals, work, diagonals, self._steps, held, bodies, slip, self.step,
            q, qd, given, tau,
        )  # fmt: skip
        if status == GOOD:
            return
        if status == SINGULAR:
            raise SolverError(f'{self.robot.tree.name}: the inertia must be positive definite')
        raise StateError('state, acceleration and torque must be finite, got one that is not')
