"""Messages of a base's motion."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from denoc_ros.errors import ConfigError
from denoc_ros.model.poses import rotation_rpy
from denoc_ros.runtime.conversions import MessageReader, require_finite
from denoc_ros.runtime.input_error import InputError
from denoc_ros.types import Array

SHORTEST = 1e-3  # s between two messages whose difference says what the base does
UNIT = 1e-3  # how far a quaternion may be from unit length
LARGEST = 1e6  # m/s, rad/s, and per s: more is no base's motion


class BaseLimits:
    """Refusal of readings that no base can have, before they count.

    Parameters
    ----------
    rate, acceleration, angular_acceleration : float
        Largest of any component [rad/s, m/s^2, rad/s^2].
    gap : float
        s after which two readings are not compared.
    """

    def __init__(
        self, rate: float, acceleration: float, angular_acceleration: float, gap: float
    ) -> None:
        self._rate, self._acceleration = rate, acceleration
        self._angular, self._gap = angular_acceleration, gap
        self.forget()

    def forget(self) -> None:
        """Compare the next reading with none."""
        self._time, self._twist = -math.inf, np.zeros(6)

    def require(self, time: float, twist: Array | None, acceleration: Array | None = None) -> None:
        """Refuse a reading at a time [s]: twist (6,), acceleration (3,) or (6,), None: not said.

        Raises
        ------
        InputError
            Cause `out_of_range`.
        """
        if acceleration is not None:
            _require_within('acceleration', acceleration[:3], self._acceleration, 'm/s^2')
            _require_within('angular acceleration', acceleration[3:], self._angular, 'rad/s^2')
        if twist is None:
            return
        _require_within('angular velocity', twist[3:], self._rate, 'rad/s')
        interval = time - self._time
        if 0.0 < interval <= self._gap:
            change = (twist - self._twist) / max(interval, SHORTEST)
            _require_within('change of velocity', change[:3], self._acceleration, 'm/s^2')
            _require_within('change of angular velocity', change[3:], self._angular, 'rad/s^2')

    def took(self, time: float, twist: Array) -> None:
        """Compare the next twist with this one (6,)."""
        self._time, self._twist = time, twist


def _require_within(what: str, values: Array, most: float, unit: str) -> None:
    largest = float(np.abs(values).max(initial=0.0))
    if largest > most:
        raise InputError(
            'out_of_range', f'the {what} must be at most {most:g} {unit}, got {largest:.6g}'
        )


def imu_mounting(where: str, source: str, xyz: Sequence[float], rpy: Sequence[float]) -> Array:
    """Return the pose (4, 4) of the IMU in the base frame that a node's parameters say.

    Raises
    ------
    ConfigError
        They are not three finite numbers each, or there is no IMU; every finding.
    """
    findings = []
    for name, given in (('base_imu_xyz', xyz), ('base_imu_rpy', rpy)):
        if len(given) != 3 or not np.isfinite(given).all():
            findings.append(f'parameter {name!r} must be three finite numbers, got {list(given)}')
        elif any(given) and source != 'imu':
            findings.append(
                f"parameter {name!r} must be 0 where 'base_motion' is {source!r} (it is the pose "
                f'of an IMU), got {list(given)}'
            )
    ConfigError.raise_any(where, findings)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_rpy(np.array(rpy, dtype=np.float64)), xyz
    return pose


def _numbers(reader: MessageReader, count: int) -> Array:
    return np.array([reader.float64() for _ in range(count)])


def _require_motion(what: str, values: Array) -> None:
    require_finite(what, values)
    largest = float(np.abs(values).max())
    if largest > LARGEST:
        raise InputError('out_of_range', f'{what} must be within {LARGEST:g}, got {largest:.6g}')


def _rotation(quaternion: Array) -> Array:
    """Return the rotation (3, 3) of a quaternion (x, y, z, w)."""
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1.0) <= UNIT:
        raise InputError('no_rotation', f'orientation must have unit length, got {length:.6g}')
    x, y, z, w = quaternion / length
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def read_odometry(raw: bytes) -> tuple[int, Array, Array]:
    """Return stamp [ns], pose (4, 4) and twist (6,) in the child frame's axes of an Odometry."""
    reader = MessageReader(raw)
    stamp_ns = reader.stamp_ns()
    reader.string()
    reader.string()
    position, quaternion = _numbers(reader, 3), _numbers(reader, 4)
    for _ in range(36):
        reader.float64()
    twist = _numbers(reader, 6)
    require_finite('pose', np.concatenate([position, quaternion]))
    _require_motion('twist', twist)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = _rotation(quaternion), position
    return stamp_ns, pose, twist


def read_accel(raw: bytes) -> tuple[int, Array]:
    """Return stamp [ns] and acceleration (6,) of an AccelStamped."""
    reader = MessageReader(raw)
    stamp_ns = reader.stamp_ns()
    reader.string()
    acceleration = _numbers(reader, 6)
    _require_motion('accel', acceleration)
    return stamp_ns, acceleration


def read_imu(raw: bytes) -> tuple[int, Array, Array]:
    """Return stamp [ns], angular velocity (3,) and specific force (3,) of an Imu."""
    reader = MessageReader(raw)
    stamp_ns = reader.stamp_ns()
    reader.string()
    for _ in range(13):
        reader.float64()
    rate = _numbers(reader, 3)
    for _ in range(9):
        reader.float64()
    force = _numbers(reader, 3)
    _require_motion('angular_velocity', rate)
    _require_motion('linear_acceleration', force)
    return stamp_ns, rate, force
