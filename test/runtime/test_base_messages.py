"""Messages of a base's motion that are cut off are refused as such, never an error of the node."""

from __future__ import annotations

import numpy as np
import pytest

from denoc_ros.errors import ConfigError
from denoc_ros.runtime.inputs.input_monitor import InputError
from denoc_ros.runtime.inputs.message_readers import (
    BaseLimits,
    imu_mounting,
    read_accel,
    read_imu,
    read_odometry,
)

HEADER = bytes([0, 1, 0, 0]) + bytes(8) + bytes([1, 0, 0, 0, 0])


@pytest.mark.parametrize('read', [read_accel, read_imu, read_odometry])
def test_a_message_that_ends_early_is_refused(read: object) -> None:
    assert callable(read)
    with pytest.raises(InputError) as caught:
        read(HEADER + bytes(11))
    assert caught.value.cause == 'malformed'


@pytest.mark.parametrize(
    ('source', 'xyz', 'rpy', 'said'),
    [
        ('imu', [1.0], [0.0] * 3, r"'base_imu_xyz' must be three finite numbers, got \[1.0\]"),
        ('imu', [0.0] * 3, [0.0, 0.0, float('nan')], "'base_imu_rpy' must be three finite"),
        ('odometry', [0.0, 0.1, 0.0], [0.0] * 3, "must be 0 where 'base_motion' is 'odometry'"),
    ],
)
def test_a_pose_of_no_imu_is_refused(
    source: str, xyz: list[float], rpy: list[float], said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        imu_mounting('node', source, xyz, rpy)


def test_readings_of_what_no_base_does_are_refused() -> None:
    limits = BaseLimits(35.0, 200.0, 1000.0, 0.1)
    twist = np.array([0.0, 0.0, 0.0, 0.0, 3.0, 0.0])
    limits.require(1.0, twist, np.array([0.0, 0.0, 9.81]))
    with pytest.raises(InputError, match=r'angular velocity must be at most 35 rad/s, got 1000'):
        limits.require(1.0, np.array([0.0, 0.0, 0.0, 0.0, 0.0, -1000.0]))
    with pytest.raises(InputError, match=r'acceleration must be at most 200 m/s\^2, got 300'):
        limits.require(1.0, twist, np.array([0.0, 300.0, 0.0]))
    with pytest.raises(InputError, match=r'angular acceleration must be at most 1000'):
        limits.require(1.0, None, np.array([0.0, 0.0, 0.0, 0.0, 2000.0, 0.0]))
    limits.took(1.0, twist)
    limits.require(1.005, 1.5 * twist)
    with pytest.raises(InputError, match=r'change of angular velocity must be at most 1000'):
        limits.require(1.005, -twist)
    limits.require(1.2, -twist)  # a gap: it is not compared
    limits.forget()
    limits.require(1.005, -twist)
