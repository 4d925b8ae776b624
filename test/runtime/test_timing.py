"""The loop thread and its statistics. No ROS."""

from __future__ import annotations

import itertools
import time

import numpy as np
import pytest

from denoc_ros.runtime.timing import HISTOGRAM_EDGES, RealtimeLoop


def wait(loop: RealtimeLoop, ticks: int) -> None:
    end = time.perf_counter() + 10.0
    while loop.statistics().ticks_total < ticks and loop.running:
        assert time.perf_counter() < end
        time.sleep(0.01)


def test_deadlines_are_absolute_so_that_no_period_is_lost() -> None:
    steps: list[int] = []
    loop = RealtimeLoop(200.0, steps.append)
    begin = time.perf_counter()
    loop.start()
    wait(loop, 50)
    loop.stop()
    elapsed = time.perf_counter() - begin
    assert not loop.running
    # every period is accounted for, by a tick or as skipped, but the one under way
    assert abs(sum(steps) - elapsed * 200.0) < 4.0


def test_a_long_tick_skips_deadlines_and_says_so() -> None:
    steps: list[int] = []

    def tick(count: int) -> None:
        steps.append(count)
        if len(steps) == 5:
            time.sleep(0.05)

    loop = RealtimeLoop(200.0, tick)
    loop.start()
    wait(loop, 20)
    loop.stop()
    statistics = loop.statistics()
    assert steps[5] >= 9
    assert statistics.skipped_total == sum(steps) - len(steps)
    assert statistics.late_total >= 1


def test_each_tick_is_for_a_deadline_a_whole_number_of_periods_after_the_last() -> None:
    deadlines: list[tuple[int, float, float]] = []
    loop = RealtimeLoop(
        200.0, lambda steps: deadlines.append((steps, loop.deadline, time.perf_counter()))
    )
    loop.start()
    wait(loop, 20)
    loop.stop()
    for (_, before, _), (steps, deadline, now) in itertools.pairwise(deadlines):
        assert deadline - before == pytest.approx(steps * 0.005, abs=1e-9)
        assert deadline <= now


def test_the_histogram_has_every_period_once() -> None:
    loop = RealtimeLoop(500.0, lambda steps: None)
    loop.start()
    wait(loop, 30)
    wait(loop, 60)
    loop.stop()
    statistics = loop.statistics()
    assert statistics.histogram.sum() == statistics.ticks_total - 1
    assert len(statistics.histogram) == len(HISTOGRAM_EDGES)
    typical = HISTOGRAM_EDGES[int(np.argmax(statistics.histogram))]
    assert 0.5 < typical < 1.5


def test_a_tick_that_raises_ends_the_loop_and_is_kept() -> None:
    def tick(steps: int) -> None:
        raise RuntimeError('no more')

    loop = RealtimeLoop(100.0, tick)
    loop.start()
    wait(loop, 1)
    assert not loop.running
    with pytest.raises(RuntimeError, match='no more'):
        raise loop.failure or AssertionError


def test_statistics_are_those_since_the_last_reading() -> None:
    loop = RealtimeLoop(1000.0, lambda steps: None)
    loop.start()
    wait(loop, 100)
    loop.stop()
    loop.statistics()
    empty = loop.statistics()
    assert (empty.ticks, empty.late, empty.rate) == (0, 0, 0.0)
    assert empty.ticks_total >= 100
    assert empty.late_share == 0.0
