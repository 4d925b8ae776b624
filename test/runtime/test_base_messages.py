"""Messages of a base's motion that are cut off are refused as such, never an error of the node."""

from __future__ import annotations

import pytest

from denoc_ros.runtime.base_messages import read_accel, read_imu, read_odometry
from denoc_ros.runtime.input_error import InputError

HEADER = bytes([0, 1, 0, 0]) + bytes(8) + bytes([1, 0, 0, 0, 0])


@pytest.mark.parametrize('read', [read_accel, read_imu, read_odometry])
def test_a_message_that_ends_early_is_refused(read: object) -> None:
    assert callable(read)
    with pytest.raises(InputError) as caught:
        read(HEADER + bytes(11))
    assert caught.value.cause == 'malformed'
