"""Joints of which a motion is planned, and those that follow them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.constrained_dynamics import mimic_ties
from denoc_ros.dynamics.driven.driven_motion import driven_motion
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import StateError
from denoc_ros.types import Array


class DrivenJoints:
    """The joints of a robot without loops that mimic none.

    Parameters
    ----------
    robot : Robot
    what : str
        Who asks, for the error.

    Attributes
    ----------
    names : tuple of str
    places : (driven,) int array
        In the robot's `joint_names`.
    ties : (joints, driven) array
        Of all joints, by the driven ones.

    Raises
    ------
    StateError
        The robot has loops.
    """

    def __init__(self, robot: Robot, what: str) -> None:
        if robot.tree.loops:
            names = [loop.name for loop in robot.tree.loops]
            raise StateError(
                f'{robot.tree.name}: {what} needs a robot without loops, got the loops {names}'
            )
        self.ties, self._offsets, self.names = mimic_ties(robot, None, {})
        joints = list(robot.joint_names)
        self.places: NDArray[np.int64] = np.array([joints.index(name) for name in self.names])

    def all(self, rows: Array, derivative: int = 0) -> Array:
        """Return the motion of all joints (k, joints), or a derivative, by the driven ones'."""
        moved = np.asarray(rows @ self.ties.T)
        return moved if derivative else moved + self._offsets

    def following(self, rows: Array) -> Array:
        """Return positions (k, joints) with the mimic joints on their leaders."""
        return self.all(np.asarray(rows)[..., self.places])

    def torque(self, rows: Array) -> Array:
        """Return the driven joints' torques (k, driven) for those of all joints (k, joints)."""
        return np.asarray(rows @ self.ties)


def all_joints(
    robot: Robot, joints: Sequence[str], rows: Array, posture: Array | None = None
) -> Array:
    """Return the positions (k, joints) of all joints by those of the driven ones.

    Parameters
    ----------
    robot : Robot
        Its workspace is used.
    joints : sequence of str
        The driven ones.
    rows : (k, driven) array
        Of a motion: the loops of a row close near those of the row before.
    posture : (n,) array, optional
        Near which the loops of the first row close; default 0.

    Raises
    ------
    StateError, SolverError
        As of :func:`driven_motion`, and where the loops do not close.
    """
    motion = driven_motion(robot, joints, posture=posture, flexible=False)
    q, found = motion.posture.copy(), np.empty((len(rows), len(robot.joint_names)))
    for row, driven in zip(found, rows, strict=True):
        motion.positions(q, driven)
        row[:] = q[robot.joint_indices]
    return found
