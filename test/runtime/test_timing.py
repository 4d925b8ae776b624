"""The loop thread and its statistics. No ROS.

Most loops go by a clock whose lateness is given: no law depends on how fast the machine is.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from denoc_ros.runtime.loop.clocks import SteadyClock
from denoc_ros.runtime.loop.realtime_loop import HISTOGRAM_EDGES, RealtimeLoop

RATE = 200.0  # Hz
PERIOD = 1.0 / RATE
PATIENCE = 60.0  # s for what takes a tenth of a second on a machine that does nothing else


class LateClock(SteadyClock):
    """Time that stands at each deadline, or late by what is given, in periods."""

    def __init__(self, late: Sequence[float]) -> None:
        super().__init__()
        self.late: Iterator[float] = iter(late)
        self.at = 10.0

    def first(self, period: float) -> float:
        return self.at + period

    def wait(self, deadline: float) -> float:
        self.at = deadline + PERIOD * next(self.late)
        return self.at


class Ticks:
    """Steps and deadlines of a loop's ticks by a late clock; the last of them stops it."""

    def __init__(self, late: Sequence[float]) -> None:
        self.steps: list[int] = []
        self.deadlines: list[float] = []
        self._count = len(late)
        self.loop = RealtimeLoop(RATE, self._tick, clock=LateClock(late))
        self.loop.start()
        wait_for_end(self.loop)
        assert self.loop.failure is None

    def _tick(self, steps: int) -> None:
        self.steps.append(steps)
        self.deadlines.append(self.loop.deadline)
        if len(self.steps) == self._count:
            self.loop.stop()


def wait_for_end(loop: RealtimeLoop) -> None:
    end = time.perf_counter() + PATIENCE
    while loop.running:
        assert time.perf_counter() < end
        time.sleep(0.001)


def test_a_tick_never_comes_before_its_deadline_and_no_period_is_lost() -> None:
    seen: list[tuple[int, float, float]] = []

    def tick(steps: int) -> None:
        seen.append((steps, loop.deadline, time.perf_counter()))
        if len(seen) == 50:
            loop.stop()

    loop = RealtimeLoop(RATE, tick)
    begin = time.perf_counter()
    loop.start()
    wait_for_end(loop)
    assert all(deadline <= now for _, deadline, now in seen)
    for (_, before, _), (steps, deadline, _) in itertools.pairwise(seen):
        assert deadline - before == pytest.approx(steps * PERIOD, abs=1e-9)
    # every period since the loop began is accounted for, by a tick or as skipped
    counted = sum(steps for steps, _, _ in seen) * PERIOD
    assert begin <= seen[-1][1] - counted <= seen[0][1] - PERIOD + 1e-9


def test_a_long_tick_skips_deadlines_and_says_so() -> None:
    ticks = Ticks([0.0, 0.1, 9.3, 0.3, 0.0])
    assert ticks.steps == [1, 1, 10, 1, 1]
    np.testing.assert_allclose(np.diff(ticks.deadlines), np.array([1, 10, 1, 1]) * PERIOD)
    statistics = ticks.loop.statistics()
    assert (statistics.skipped_total, statistics.ticks_total) == (9, 5)
    assert statistics.late_total == 1


def test_a_tick_is_late_by_more_than_half_a_period() -> None:
    statistics = Ticks([0.0, 0.4, 0.6, 0.9, 0.0]).loop.statistics()
    assert (statistics.late, statistics.skipped) == (2, 0)
    assert statistics.late_share == pytest.approx(0.4)


def test_the_histogram_has_every_period_once() -> None:
    late = [0.0, 0.21, 0.12, 0.13, 3.46, 0.05]  # between the edges
    loop = Ticks(late).loop
    # a deadline that was passed over is no end of a period
    begins = np.arange(6) + np.array([*late[:5], 3.05])
    expected, _ = np.histogram(np.diff(begins), [*HISTOGRAM_EDGES, np.inf])
    np.testing.assert_array_equal(loop.statistics().histogram, expected)
    assert expected.sum() == len(late) - 1
    # read again: nothing counts twice
    np.testing.assert_array_equal(loop.statistics().histogram, expected)


def test_rate_and_periods_are_those_of_the_clock() -> None:
    statistics = Ticks([0.0] * 100).loop.statistics()
    assert statistics.rate == pytest.approx(RATE)
    for period in (statistics.period_p50, statistics.period_p99, statistics.period_max):
        assert period == pytest.approx(PERIOD)


def test_a_tick_that_raises_ends_the_loop_and_is_kept() -> None:
    def tick(steps: int) -> None:
        raise RuntimeError('no more')

    loop = RealtimeLoop(100.0, tick)
    loop.start()
    wait_for_end(loop)
    with pytest.raises(RuntimeError, match='no more'):
        raise loop.failure or AssertionError


def test_statistics_are_those_since_the_last_reading() -> None:
    loop = Ticks([0.0] * 100).loop
    assert loop.statistics().ticks == 100
    empty = loop.statistics()
    assert (empty.ticks, empty.late, empty.rate) == (0, 0, 0.0)
    assert empty.ticks_total == 100
    assert empty.late_share == 0.0
