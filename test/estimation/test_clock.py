"""Laws of the stamps' mapping to the steady clock."""

from __future__ import annotations

import numpy as np
import pytest

from denoc_ros.estimation.stamp_clock import StampClock

STEADY, WALL = 50.0, 1.7e9  # the two clocks at the start


def test_publisher_on_the_same_clock_is_believed() -> None:
    clock = StampClock()
    for t, latency in ((0.0, 0.002), (0.01, 0.009), (0.02, 0.001)):
        arrival = t + latency
        taken = clock.taken_at(WALL + t, STEADY + arrival, WALL + arrival)
        assert taken == pytest.approx(STEADY + t, abs=1e-6)


def test_publisher_on_another_clock_is_mapped_by_its_fastest_message() -> None:
    clock, rng = StampClock(), np.random.default_rng(2)
    taken = []
    for k in range(500):
        t, latency = 0.01 * k, 0.001 + 0.01 * rng.random() ** 3
        taken.append(clock.taken_at(7.0 + t, STEADY + t + latency, WALL + t) - STEADY - t)
    # The least latency, 1 ms, is not to be known; what comes on top of it is.
    np.testing.assert_allclose(taken[100:], 0.001, atol=5e-4)


def test_message_without_a_stamp_counts_from_its_arrival() -> None:
    assert StampClock().taken_at(0.0, STEADY, WALL) == STEADY


def test_stamp_ahead_of_a_shared_clock_is_not_in_the_future() -> None:
    clock = StampClock()
    clock.taken_at(WALL, STEADY + 0.001, WALL + 0.001)
    assert clock.taken_at(WALL + 5.0, STEADY + 0.01, WALL + 0.01) == STEADY + 0.01


@pytest.mark.parametrize('begin', [7.0, WALL])
def test_a_single_stamp_from_the_future_leaves_no_trace(begin: float) -> None:
    plain, spoilt = StampClock(), StampClock()
    for k in range(200):
        t = 0.01 * k
        given = begin + t, STEADY + t + 0.002, WALL + t + 0.002
        if k == 50:
            assert spoilt.taken_at(begin + t + 30.0, *given[1:]) <= given[1]
            continue
        assert spoilt.taken_at(*given) == pytest.approx(plain.taken_at(*given), abs=1e-6)


def test_a_clock_that_is_set_ahead_is_followed_from_its_second_message() -> None:
    clock = StampClock()
    for k in range(100):
        t = 0.01 * k
        taken = clock.taken_at(7.0 + t + (30.0 if k >= 50 else 0.0), STEADY + t, WALL + t)
        assert taken == pytest.approx(STEADY + t, abs=1e-3)
