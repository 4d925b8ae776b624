"""Springs of elastic joints: where they stand, their forces at a state."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.robot_model import Held, RobotModel
from denoc_ros.kernels.compiled import ready
from denoc_ros.kernels.handle import PLAY, STIFFNESS3
from denoc_ros.kernels.link_side import elastic_terms
from denoc_ros.types import Array


def half_play(robot: RobotModel) -> Array:
    """Return half the backlash (n,) of springs [rad or m], 0 along other coordinates."""
    play: Array = robot.arrays.diagonals[PLAY]
    return play


def spring_indices(robot: RobotModel) -> NDArray[np.intp]:
    """Return the indices of elastic joints' springs among the coordinates."""
    places = robot.arrays.link_map
    if places is None:
        return np.zeros(0, dtype=np.intp)
    return np.asarray(places[0][places[1] == 1], dtype=np.intp)


def elasticity(robot: RobotModel, q: Array) -> tuple[Array, Array]:
    """Return the elastic forces (n,) along the coordinates q (n,), and their derivatives."""
    if not robot.arrays.diagonals[STIFFNESS3 : PLAY + 1].any():
        return robot.stiffness * q, robot.stiffness
    ready(elastic_terms)
    force, slope = np.empty((2, robot.n))
    elastic_terms(robot.handle, np.ascontiguousarray(q, dtype=np.float64), force, slope)
    return force, slope


def with_motors(robot: Held) -> Held:
    """Robot whose kernels leave the torques of all rows in the workspace.

    Of a robot with elastic joints, inverse and forward dynamics else work on its link side.
    """
    if robot.arrays.link_side is None:
        return robot
    other = robot.copy()
    other._adopt(robot.arrays.without_link_side())
    other.constants[:] = robot.constants
    other.move_base(robot.base_motion)
    return other
