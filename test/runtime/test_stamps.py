"""Laws of the stamps of moments."""

from __future__ import annotations

import time

import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from denoc_ros.bags.joint_state import JointStateMessage
from denoc_ros.runtime.loop.clocks import StampOf, SteadyClock


def test_moment_gets_the_stamp_that_the_clock_showed_then() -> None:
    stamp_of = StampOf(SteadyClock())
    before, moment, after = time.time_ns(), time.perf_counter(), time.time_ns()
    time.sleep(0.01)
    # the readings may each be off by the time this process was stopped between them
    assert before - 10**6 <= stamp_of(moment) <= after + 10**6


def test_stamps_go_back_only_with_a_clock_that_was_set_back() -> None:
    stamp_of = StampOf(SteadyClock())
    now = time.perf_counter()
    first = stamp_of(now)
    assert stamp_of(now - 0.5) == first
    assert stamp_of(now - 100.0) < first


def test_pause_between_two_readings_does_not_shift_the_stamp() -> None:
    calls: list[None] = []

    def slow_once() -> int:
        calls.append(None)
        value = time.time_ns()
        if len(calls) == 1:
            time.sleep(0.05)
        return value

    moment, wanted = time.perf_counter(), time.time_ns()
    assert abs(StampOf(SteadyClock(slow_once))(moment) - wanted) < 20_000_000
    assert len(calls) > 1


@pytest.mark.parametrize(
    ('stamp_ns', 'seconds', 'nanoseconds'),
    [
        (1_234_567_891_011, 1234, 567_891_011),
        (-1, -1, 999_999_999),
        (2_147_483_648_000_000_001, 2_147_483_647, 1),
        (-(1 << 80), -2_147_483_647, None),
        (1 << 80, 2_147_483_647, None),
    ],
)
def test_stamps_beyond_what_a_message_can_say_are_the_nearest(
    stamp_ns: int, seconds: int, nanoseconds: int | None
) -> None:
    message = JointStateMessage(['a'], ('position',))
    stamp = deserialize_message(message.bytes(stamp_ns), JointState).header.stamp
    assert stamp.sec == seconds
    if nanoseconds is not None:
        assert stamp.nanosec == nanoseconds
