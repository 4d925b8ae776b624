"""The fixed step of the real-time side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from denoc_ros.errors import SolverError, StateError
from denoc_ros.kernels.articulated import articulated_dynamics
from denoc_ros.kernels.handle import ARMATURE, GOOD, MISFIT, SINGULAR
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
        self._held = robot.held(robot.joint_indices)
        self._armature = robot.lowered.diagonals[ARMATURE].copy()
        self._torque = np.zeros(robot.n)

    def free(self, q: Array, qd: Array, tau: Array) -> None:
        """Advance q and qd (n,) in place under generalized forces tau (n,), held over the step.

        Raises
        ------
        StateError
            A number is not finite; q and qd are then as they were.
        """
        self._advance(self._zero, q, qd, self._zero, tau)

    def driven(self, q: Array, qd: Array, qdd_joints: Array, tau: Array | None = None) -> None:
        """Advance q and qd (n,) in place with the joints' accelerations (joints,) given.

        Joints move with constant acceleration over the step, amplitudes by their dynamics, under
        generalized forces tau (n,) if given, of which those of joints do not matter.
        """
        self._given[self.robot.joint_indices] = qdd_joints
        force = self._zero if tau is None else tau
        self._advance(self._held, q, qd, self._given, force)

    def accelerations(self, q: Array, qd: Array, qdd_joints: Array, out: Array) -> None:
        """Write the accelerations (n,) at a state with those of the joints given.

        Raises
        ------
        StateError
            A number is not finite.
        """
        self._given[self.robot.joint_indices] = qdd_joints
        status = articulated_dynamics(
            self.robot.handle, self._armature, self._held, q, qd,
            self._given, self._zero, out, self._torque,
        )  # fmt: skip
        self._judge(status, q, qd, out)
        out[self.robot.joint_indices] = qdd_joints

    def _advance(self, held: Array, q: Array, qd: Array, given: Array, tau: Array) -> None:
        try:
            status = advance(self.robot.handle, self._steps, held, self.step, q, qd, given, tau)
        except TypeError:
            status = MISFIT
        self._judge(status, q, qd, tau)

    def _judge(self, status: int, *arrays: Array) -> None:
        if status == GOOD:
            return
        if status == SINGULAR:
            raise SolverError(f'{self.robot.tree.name}: the inertia must be positive definite')
        if status == MISFIT:
            raise StateError(
                f'states and forces must be float64 arrays of shape ({self.robot.n},), got '
                + ', '.join(str(np.shape(array)) for array in arrays)
            )
        raise StateError('state, acceleration and torque must be finite, got one that is not')
