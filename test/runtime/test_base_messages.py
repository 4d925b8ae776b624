"""Messages of a base's motion that are cut off are refused as such, never an error of the node."""

from __future__ import annotations

import pytest

from denoc_ros.errors import ConfigError
from denoc_ros.runtime.base_messages import imu_mounting, read_accel, read_imu, read_odometry
from denoc_ros.runtime.input_error import InputError

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
