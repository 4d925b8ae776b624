"""Laws of ticks that keep their place between the stamps of an input."""

from __future__ import annotations

import time

import pytest

from denoc_ros.runtime.loop.realtime_loop import SLEW, PhaseLock, RealtimeLoop

PERIOD = 1e-3


def place(deadline: float, stamp: float) -> float:
    """Return how far after a stamp a deadline is, in periods, 0 to 1."""
    return (deadline - stamp) / PERIOD % 1.0


@pytest.mark.parametrize('begin', [0.0, 0.1, 0.49, 0.51, 0.9])
@pytest.mark.parametrize('every', [1, 3])
def test_ticks_come_to_half_a_period_after_the_stamps_and_stay_there(
    begin: float, every: int
) -> None:
    lock, stamp = PhaseLock(PERIOD), 1234.5678
    deadline = stamp + begin * PERIOD
    places, largest = [], 0.0
    for k in range(600):
        if k % every == 0:
            lock.take(stamp + k * PERIOD)
        shift = lock.shift(deadline)
        largest = max(largest, abs(shift))
        deadline += PERIOD + shift
        places.append(place(deadline, stamp))
    assert lock.is_steady
    # the phase of a moment a thousand seconds on is rounded to some 1e-9 of a period
    assert places[-100:] == pytest.approx([0.5] * 100, abs=1e-5)
    assert largest == pytest.approx(SLEW * PERIOD, rel=1e-9)


def test_ticks_follow_a_clock_that_drifts() -> None:
    lock, drift = PhaseLock(PERIOD), 1e-4
    deadline, gaps = 0.2 * PERIOD, []
    for k in range(3000):
        stamp = k * PERIOD * (1.0 + drift)
        lock.take(stamp)
        deadline += PERIOD + lock.shift(deadline)
        gaps.append(place(deadline, stamp))
    # 1e-4 of a period per tick, and a mean over some 20 of them
    assert gaps[-500:] == pytest.approx([0.5] * 500, abs=0.01)


def test_stamps_at_any_phase_move_nothing() -> None:
    lock = PhaseLock(PERIOD)
    assert lock.shift(0.3 * PERIOD) == 0.0
    moved = []
    for k in range(2000):
        lock.take(k * 1.2718 * PERIOD)
        moved.append(lock.shift(k * PERIOD))
    assert not any(moved[200:])
    for k in range(200):
        lock.take(k * PERIOD)
    assert lock.is_steady
    lock.forget()
    assert lock.shift(0.0) == 0.0


def test_a_tick_moves_the_deadlines_of_its_loop() -> None:
    period, deadlines = 5e-3, []

    def tick(_steps: int) -> None:
        deadlines.append(loop.deadline)
        if len(deadlines) == 3:
            loop.shift = 0.4 * period

    loop = RealtimeLoop(1.0 / period, tick)
    loop.start()
    end = time.perf_counter() + 60.0
    while len(deadlines) < 8:
        assert time.perf_counter() < end
        time.sleep(0.005)
    loop.stop()
    # once, whatever periods a busy machine skips
    places = [((each - deadlines[0]) / period + 0.25) % 1.0 - 0.25 for each in deadlines]
    assert places == pytest.approx([0.0] * 3 + [0.4] * (len(places) - 3), abs=1e-3)
