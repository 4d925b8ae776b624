"""Targets of frames: weighted errors of position and rotation, with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.rotations import left_jacobians
from denoc_ros.types import Array


@dataclass(frozen=True)
class Target:
    """A frame and the poses that it is to have.

    Attributes
    ----------
    frame : str
    poses : (k, 4, 4) array
        In the base frame, at each node.
    weight : float
        Of the position's error.
    turn : float
        How many metres of position a radian of turn counts as [m]; 0 leaves the turn free.
    """

    frame: str
    poses: Array
    weight: float
    turn: float

    def error(self, robot: Robot, q: Array, rows: slice = slice(None)) -> tuple[Array, Array]:
        """Return errors of position (k, 3) [m] and turn (k, 3) [rad] in base axes."""
        poses, wanted = robot.frame_pose(self.frame, q), self.poses[rows]
        turn = poses[:, :3, :3] @ wanted[:, :3, :3].transpose(0, 2, 1)
        return poses[:, :3, 3] - wanted[:, :3, 3], Rotation.from_matrix(turn).as_rotvec()

    def weighed(self, robot: Robot, q: Array, rows: slice = slice(None)) -> Array:
        """Return the weighed errors (k, 6) [m]."""
        position, turn = self.error(robot, q, rows)
        return np.concatenate([self.weight * position, self.weight * self.turn * turn], axis=1)

    def derivative(self, robot: Robot, q: Array, errors: Array) -> Array:
        """Return the derivative (k, 6, n) of weighed errors (k, 6) by q."""
        jacobian = self.weight * robot.frame_jacobian(self.frame, q)
        if self.turn == 0.0:
            jacobian[:, 3:] = 0.0
            return jacobian
        change = np.linalg.inv(left_jacobians(errors[:, 3:] / (self.weight * self.turn)))
        jacobian[:, 3:] = self.turn * (change @ jacobian[:, 3:])
        return jacobian

    def curvature(self, robot: Robot, q: Array, errors: Array) -> Array:
        """Return weighed errors (k, 6) times their second derivatives by q, (k, n, n).

        To first order in the turn that is left.
        """
        weighed = np.repeat([self.weight, self.weight * self.turn], 3) * errors
        found = np.empty((len(q), robot.n, robot.n))
        for j in range(robot.n):
            along = np.zeros_like(q)
            along[:, j] = 1.0
            rate = robot.frame_jacobian_rate(self.frame, q, along)
            found[:, j] = np.einsum('ki,kin->kn', weighed, rate)
        return np.asarray(0.5 * (found + found.transpose(0, 2, 1)))
