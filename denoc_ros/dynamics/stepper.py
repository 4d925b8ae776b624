"""The fixed step of the real-time side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from denoc_ros.dynamics.constraints import constrained_dynamics, raise_status
from denoc_ros.errors import StateError
from denoc_ros.kernels.articulated import articulated_dynamics
from denoc_ros.kernels.closing import advance_tied
from denoc_ros.kernels.handle import GOOD, MISFIT, NOT_FINITE
from denoc_ros.kernels.step import STEP_ROWS, advance
from denoc_ros.types import Array

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot


class Stepper:
    """Advances a robot's state by a fixed step; allocates nothing per call.

    A Rosenbrock W-method of order 2, linearly implicit in elasticity, damping and friction, so a
    mode faster than the step stays stable (see :mod:`denoc_ros.kernels.step`). Loops stay closed
    and mimic joints on their leaders: every state it leaves obeys them to rounding.

    Parameters
    ----------
    robot : Robot
        Its workspace is used: do not share it with another thread.
    step : float [s]
    driven : joint names, optional
        Those whose accelerations :meth:`driven` and :meth:`accelerations` take, in this order;
        default all. In a robot with loops the other joints follow.
    """

    def __init__(self, robot: Robot, step: float, driven: Sequence[str] | None = None) -> None:
        if not (np.isfinite(step) and step > 0.0):
            raise StateError(f'step must be > 0 s, got {step}')
        self.robot = robot
        self.step = float(step)
        self._tied = bool(robot.constraint_names)
        self._kernel = advance_tied if self._tied else advance
        self._steps = np.zeros((STEP_ROWS, robot.n))
        self._zero, self._given, self._torque = np.zeros((3, robot.n))
        self._multipliers = np.zeros(len(robot.constraint_names))
        self._driven = robot.indices(robot.joint_names if driven is None else driven)
        self._held = robot.held(self._driven)
        self._armature = robot.armature.copy()

    def free(self, q: Array, qd: Array, tau: Array) -> None:
        """Advance q and qd (n,) in place under generalized forces tau (n,), held over the step.

        Mimic joints are placed by their leaders, whatever q and qd say of them.

        Raises
        ------
        StateError
            A number is not finite; q and qd are then as they were.
        SolverError
            The inertia is not positive definite; a loop is not closed before the step, or cannot
            be kept closed in it.
        """
        self._advance(self._zero, q, qd, self._zero, tau)

    def driven(self, q: Array, qd: Array, qdd_driven: Array, tau: Array | None = None) -> None:
        """Advance q and qd (n,) in place with the driven joints' accelerations (driven,) given.

        These joints move with constant acceleration over the step, all else by its dynamics, under
        generalized forces tau (n,) if given, of which those of driven joints do not matter.
        """
        self._given[self._driven] = qdd_driven
        force = self._zero if tau is None else tau
        self._advance(self._held, q, qd, self._given, force)

    def accelerations(
        self, q: Array, qd: Array, qdd_driven: Array, out: Array, tau: Array | None = None
    ) -> None:
        """Write the accelerations (n,) at a state with those of the driven joints given.

        Generalized forces tau (n,) act, if given, of which those of driven joints do not matter.

        Raises
        ------
        StateError
            A number is not finite.
        """
        self._given[self._driven] = qdd_driven
        robot, given = self.robot, self._given
        force = self._zero if tau is None else tau
        if self._tied:
            status = constrained_dynamics(
                robot, self._held, q, qd, given, force, out, self._multipliers
            )
        else:
            status = articulated_dynamics(
                robot.handle, self._armature, self._held, q, qd, given, force, out,
                self._torque,
            )  # fmt: skip
        raise_step_status(robot, status, q, qd, out)
        out[self._driven] = qdd_driven

    def _advance(self, held: Array, q: Array, qd: Array, given: Array, tau: Array) -> None:
        try:
            status = self._kernel(
                self.robot.handle, self._steps, held, self.step, q, qd, given, tau
            )
        except TypeError:
            status = MISFIT
        raise_step_status(self.robot, status, q, qd, tau)


def raise_step_status(robot: Robot, status: int, *arrays: Array) -> None:
    """Raise what a status of a step means."""
    if status == GOOD:
        return
    if status == MISFIT:
        raise StateError(
            f'states and forces must be float64 arrays of shape ({robot.n},), got '
            + ', '.join(str(np.shape(array)) for array in arrays)
        )
    if status == NOT_FINITE:
        raise StateError('state, acceleration and torque must be finite, got one that is not')
    raise_status(robot, status)
