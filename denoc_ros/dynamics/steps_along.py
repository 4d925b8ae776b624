"""Fixed steps along a motion of all joints, many in one call."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from denoc_ros.dynamics.stepper import raise_step_status
from denoc_ros.errors import ModelError, StateError
from denoc_ros.kernels.compiled import ready
from denoc_ros.kernels.handle import MISFIT
from denoc_ros.kernels.step import ALONG_ROWS, advance_along
from denoc_ros.types import Array

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot


class StepsAlong:
    """Takes the steps of :meth:`Stepper.driven` along a motion of all joints.

    Parameters
    ----------
    robot : Robot
        Its workspace is used: do not share it with another thread.
    step : float
        Longest step [s]: the steps of an interval are of equal length.

    Raises
    ------
    ModelError
        The robot has loops or mimic joints.
    """

    def __init__(self, robot: Robot, step: float) -> None:
        if robot.constraint_names:
            rule = f'must have no loops or mimic joints here, got {robot.constraint_names}'
            raise ModelError(robot.tree.name, [rule])
        ready(advance_along)
        self.robot, self.step = robot, float(step)
        self._work = np.zeros((ALONG_ROWS, robot.n))
        self._held = robot.held(robot.joint_indices)

    def write(
        self, states: Array, intervals: Array, accelerations: Array, first: int, last: int
    ) -> None:
        """Write the undriven coordinates into rows first .. last - 1 of the states.

        Parameters
        ----------
        states : (2, k, n) array
            Coordinates and rates: joints in all rows, all coordinates in row first - 1.
        intervals : (k,) array
            Of each row from the one before [s].
        accelerations : (2, k, n) array
            Mean of the joints' over each interval, and slope about its middle, 0 elsewhere.
        first, last : int

        Raises
        ------
        StateError
            A shape is wrong, a number not finite, or an interval not > 0.
        SolverError
            The inertia is not positive definite.
        """
        status = advance_along(
            self.robot.handle, self._work, self._held, self.step, intervals, accelerations,
            states, first, last,
        )  # fmt: skip
        if status == MISFIT:
            k, n = len(intervals), self.robot.n
            raise StateError(
                f'states and accelerations must have shape {(2, k, n)}, and rows be in 1 .. {k}, '
                f'got {states.shape}, {accelerations.shape} and {first} .. {last}'
            )
        raise_step_status(self.robot, status)
