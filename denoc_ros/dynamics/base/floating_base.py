"""The coordinates of a floating base: position and rotation vector, and how they are kept small.

A rotation vector phi turns the base by Exp phi; its rate gives the angular velocity J phi', with
the left Jacobian J, which is singular at |phi| = 2 pi only. As phi and phi (1 - 2 pi / |phi|) are
the same attitude, every state is brought back within pi before that comes near.
"""

from __future__ import annotations

import numpy as np

from denoc_ros.dynamics.robot_model import RobotModel
from denoc_ros.dynamics.rotations import left_jacobians
from denoc_ros.errors import StateError
from denoc_ros.types import Array

ATTITUDE = slice(3, 6)  # of a floating base's coordinates


def wrap_attitude(phi: Array, rate: Array) -> tuple[Array, Array]:
    """Return the same attitude and angular velocity with |phi| <= pi."""
    angle = float(np.linalg.norm(phi))
    turns = np.round(angle / (2.0 * np.pi))
    if turns == 0.0:
        return phi, rate
    wrapped = phi * (1.0 - 2.0 * np.pi * turns / angle)
    spin = left_jacobians(phi) @ rate
    return wrapped, np.asarray(np.linalg.solve(left_jacobians(wrapped), spin), dtype=np.float64)


def require_known_base(robot: RobotModel, whose: str) -> None:
    """Refuse a robot whose base floats, for methods that need a known motion of the base.

    Raises
    ------
    StateError
        With a way out.
    """
    if len(robot.base_indices):
        raise StateError(
            f'{whose}: the base of {robot.tree.name} must be fixed, got one that floats '
            '(make the floating joint a fixed one where the base is held)'
        )
