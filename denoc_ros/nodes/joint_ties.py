"""All joints of a robot from those that are measured: mimic joints follow their leaders."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.joint_ties import joint_ties
from denoc_ros.dynamics.robot import Robot

Array = NDArray[np.float64]


class JointTies:
    """Maps arrays over the measured joints to arrays over all joints of the robot.

    Parameters
    ----------
    robot : Robot
        The robot.
    joints : sequence of str
        Those measured; mimic joints follow, any other stands still at 0.
    """

    def __init__(self, robot: Robot, joints: Sequence[str]) -> None:
        names = list(robot.joint_names)
        self._matrix, self._offset, _ = joint_ties(robot, joints, {})
        self._own = np.array([names.index(joint) for joint in joints], dtype=np.intp)
        self._plain = bool(np.array_equal(self._matrix, np.eye(len(names), len(joints))))

    def positions(self, q: Array) -> Array:
        """Return positions of all joints from those measured."""
        positions: Array = q.copy() if self._plain else self._matrix @ q + self._offset
        return positions

    def rates(self, qd: Array) -> Array:
        """Return rates, or accelerations, of all joints from those measured."""
        rates: Array = qd.copy() if self._plain else self._matrix @ qd
        return rates

    def efforts(self, effort: Array) -> Array:
        """Return efforts of all joints: zero where none is measured."""
        result: Array = np.zeros(len(self._offset))
        result[self._own] = effort
        return result
