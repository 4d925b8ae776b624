"""How often something that may wait is done."""

from __future__ import annotations

import pytest

from denoc_ros.runtime.loop.rate_limiter import SLOWEST, RateLimiter


def rounds(pace: RateLimiter, cost: float, count: int, busy: float = 0.0) -> list[float]:
    """Return when rounds begin that take `busy` and keep processors for `cost` [s]."""
    now, begun = 100.0, []
    pace.begin(now)
    for _ in range(count):
        begun.append(now)
        end = now + busy
        now = end + pace.wait(end, cost)
    return begun


def test_cheap_rounds_keep_the_rate_whatever_they_take() -> None:
    begun = rounds(RateLimiter(30.0, 0.25), 0.004, 100, busy=0.004)
    # the time that a round takes is not added to the period
    assert begun[-1] - begun[0] == pytest.approx(99 / 30.0, abs=1e-9)


def test_costly_rounds_take_their_share_of_the_time_and_no_more() -> None:
    cost, share = 0.02, 0.25
    begun = rounds(RateLimiter(30.0, share), cost, 200, busy=cost)
    tail = (begun[-1] - begun[100]) / 99
    assert tail == pytest.approx(cost / share, rel=1e-6)
    assert tail > 1.0 / 30.0


def test_the_rate_comes_back_when_rounds_are_cheap_again() -> None:
    pace = RateLimiter(30.0, 0.25)
    rounds(pace, 0.05, 100)
    slow = pace.period
    rounds(pace, 0.001, 100)
    assert slow == pytest.approx(0.2, rel=1e-6)
    assert pace.period == pytest.approx(1.0 / 30.0)


def test_whatever_rounds_cost_there_is_one_a_second() -> None:
    pace = RateLimiter(30.0, 0.25)
    rounds(pace, 50.0, 100)
    assert pace.period == SLOWEST


def test_rounds_that_are_held_up_cost_nothing() -> None:
    begun = rounds(RateLimiter(30.0, 0.25), 0.001, 50, busy=0.03)
    assert begun[-1] - begun[0] == pytest.approx(49 / 30.0, abs=1e-9)


def test_missed_rounds_are_not_made_up_for() -> None:
    pace = RateLimiter(10.0, 0.5)
    pace.begin(0.0)
    assert pace.wait(0.0, 0.0) == pytest.approx(0.1)
    assert pace.wait(5.0, 0.0) == 0.0
    assert pace.wait(5.0, 0.0) == pytest.approx(0.1)
