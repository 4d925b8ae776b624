"""Laws of the robot's clocks, without a topic: a list of times stands for it."""

from __future__ import annotations

import math
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from denoc_ros.runtime.loop.clocks import FARTHEST, SimulatedClock, SourceClock, SteadyClock
from denoc_ros.runtime.loop.realtime_loop import RealtimeLoop

SECOND = 1_000_000_000
NOW = 1_795_461_265 * SECOND + 123_456_789  # a system's clock
times = st.integers(0, 2 * NOW)
rates = st.sampled_from([50.0, 250.0, 300.0, 1000.0, 937.5])


class Told:
    """Messages of a clock: each `receive` takes one, and None where there is none."""

    def __init__(self, *times_ns: int) -> None:
        self.times = list(times_ns)

    def __call__(self, timeout: float) -> int | None:
        return self.times.pop(0) if self.times else None


def ticks(told: Told, rate: float, count: int) -> list[tuple[float, float]]:
    """Return deadline and moment at hand of the ticks that messages of a clock make."""
    clock = SimulatedClock(told)
    found: list[tuple[float, float]] = []
    loop = RealtimeLoop(rate, lambda _: found.append((loop.deadline, clock.now())), clock=clock)
    loop.start()
    end = time.perf_counter() + 20.0
    while (len(found) < count or told.times) and time.perf_counter() < end:
        time.sleep(0.001)
    loop.stop()
    assert loop.failure is None
    assert loop.statistics().late_total == loop.statistics().skipped_total == 0
    return found


@pytest.mark.parametrize('steps', [[20], [1] * 20, [7, 0, 13], [3, 3, 3, 11]])
def test_deadlines_that_a_message_passes_are_worked_through_in_order(steps: list[int]) -> None:
    shown, told = 0, [0]
    for step in steps:
        shown += step * 1_000_000
        told.append(shown)
    found = ticks(Told(*told), 1000.0, 20)
    assert [round(1e9 * deadline) for deadline, _ in found] == [
        1_000_000 * k for k in range(1, 21)
    ]
    assert all(deadline == now for deadline, now in found)


@given(times, st.integers(1, 5 * SECOND), rates)
def test_deadlines_depend_on_no_process_s_start(begun: int, later: int, rate: float) -> None:
    early, late = SimulatedClock(Told(begun, begun + later)), SimulatedClock(Told(begun + later))
    for _ in range(2):
        early.poll()
    late.poll()
    if early.stamp_ns(0.0) == late.stamp_ns(0.0):  # between two origins there are 12 days
        assert early.first(1.0 / rate) == late.first(1.0 / rate)
    assert early.now_ns() == late.now_ns()


@given(times, rates)
def test_next_deadline_is_within_a_period(begun: int, rate: float) -> None:
    clock = SimulatedClock(Told(begun))
    assert clock.first(1.0 / rate) == math.inf
    clock.poll()
    ahead = clock.stamp_ns(clock.first(1.0 / rate)) - begun
    assert 0 < ahead <= round(1e9 / rate) + 1


@given(times, st.integers(0, SECOND))
def test_moments_have_their_stamps_to_the_nanosecond(begun: int, later: int) -> None:
    clock = SimulatedClock(Told(begun))
    clock.poll()
    assert clock.stamp_ns(clock.moment(begun + later)) == begun + later


@pytest.mark.parametrize(
    ('second', 'by'), [(NOW - 1, -1e-9), (NOW - SECOND, -1.0), (NOW + FARTHEST + 1, 10.000000001)]
)
def test_clock_that_jumps_begins_anew(second: int, by: float) -> None:
    restarts: list[float] = []
    clock = SimulatedClock(Told(NOW, second), restarts.append)
    clock.poll()
    deadline = clock.first(0.001)
    assert clock.wait(deadline) is None
    assert restarts == [pytest.approx(by, abs=1e-12)]
    assert clock.now_ns() == second
    assert clock.stamp_ns(clock.first(0.001)) > second


def test_statistics_hold_over_a_clock_that_is_set_back() -> None:
    clock = SimulatedClock(Told(0, 10_000_000, 2_000_000, 12_000_000))
    loop = RealtimeLoop(1000.0, lambda _: None, clock=clock)
    loop.start()
    end = time.perf_counter() + 20.0
    while clock.now_ns() != 12_000_000 or loop.record()[0].size < 20:
        assert time.perf_counter() < end
        time.sleep(0.001)
    loop.stop()
    statistics = loop.statistics()
    assert statistics.ticks_total == 20
    assert statistics.period_max < 0.0011


def test_clock_that_stands_moves_nothing_and_is_noticed() -> None:
    stood: list[float] = []
    clock = SimulatedClock(Told(NOW, NOW, NOW), standing=lambda: stood.append(clock.now()))
    clock.poll()
    now = clock.now()
    for _ in range(5):
        assert clock.wait(clock.first(0.001)) is None
    assert clock.now() == now
    assert stood == [now] * 5
    assert not clock.sleep(0.001)


def test_sleep_passes_simulated_time() -> None:
    clock = SimulatedClock(Told(0, 4_000_000, 8_000_000))
    clock.poll()
    assert clock.sleep(0.005)
    assert clock.now_ns() == 5_000_000


def test_source_stands_at_its_pause_and_goes_on_when_it_is_set_later() -> None:
    told: list[int] = []
    clock = SourceClock(told.append)
    clock.factor, clock.pause_at = 0.0, 0.003
    for wanted in (1, 2, 3):
        assert clock.wait(clock.first(0.001)) == pytest.approx(1e-3 * wanted)
    assert clock.wait(clock.first(0.001)) is None
    assert clock.paused
    assert told[-1] == 3_000_000  # told again, for those who come late
    clock.pause_at = math.inf
    assert clock.wait(clock.first(0.001)) is not None
    assert not clock.paused


@pytest.mark.parametrize('factor', [0.5, 2.0])
def test_source_is_not_faster_than_its_factor(factor: float) -> None:
    clock = SourceClock(lambda _: None)
    clock.factor = factor
    begin = time.perf_counter()
    while clock.now() < 0.1:
        clock.wait(clock.first(0.01))
    assert time.perf_counter() - begin >= 0.1 / factor


def test_source_waits_for_its_partners() -> None:
    answered = {0}
    clock = SourceClock(lambda _: None, lambda now_ns: now_ns in answered)
    clock.factor = 0.0
    assert clock.wait(clock.first(0.001)) is not None
    assert clock.wait(clock.first(0.001)) is None
    answered.add(1_000_000)
    assert clock.wait(clock.first(0.001)) == pytest.approx(0.002)


def test_steady_stamps_and_moments_are_each_other_s_inverse() -> None:
    clock = SteadyClock()
    now = clock.now()
    assert clock.moment(clock.stamp_ns(now)) == pytest.approx(now, abs=1e-3)
    assert not clock.is_simulated
