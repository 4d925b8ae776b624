"""Poses of a URDF: rotations as roll, pitch and yaw, and numbers as text."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.types import Array


def pose_of(place: ArrayLike = (0.0, 0.0, 0.0), rotation: Array | None = None) -> Array:
    """Return the pose (4, 4) of a place (3,) [m] and a rotation (3, 3), the identity if None."""
    pose = np.eye(4)
    pose[:3, 3] = place
    if rotation is not None:
        pose[:3, :3] = rotation
    return pose


def rotation_rpy(rpy: Array) -> Array:
    """Return the rotation (3, 3) of roll, pitch and yaw [rad] about fixed X, Y, Z."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rpy_of(rotation: Array) -> tuple[float, float, float]:
    """Return roll, pitch and yaw [rad] of a rotation (3, 3); pitch a quarter turn: yaw 0."""
    level = math.hypot(rotation[0, 0], rotation[1, 0])
    pitch = math.atan2(-rotation[2, 0], level)
    if level < 1e-9:
        roll = math.atan2(-rotation[1, 2], rotation[1, 1])
        return roll, pitch, 0.0
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    return roll, pitch, math.atan2(rotation[1, 0], rotation[0, 0])


def number_text(*numbers: float) -> str:
    """Return numbers to 15 digits, which do not depend on the machine; a rounded zero is 0."""
    return ' '.join(f'{0.0 if abs(number) < 1e-14 else number:.15g}' for number in numbers)
