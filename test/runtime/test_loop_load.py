"""A loop that its core cannot carry says so, yields, and takes its priority back later."""

from __future__ import annotations

import itertools
import re
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from denoc_ros.runtime.loop import realtime_loop as module
from denoc_ros.runtime.loop.realtime import schedule_thread
from denoc_ros.runtime.loop.realtime_loop import (
    FIRST_REST,
    HOLDS,
    LONGEST_REST,
    LOOK_WINDOW,
    LoopLoad,
    RealtimeLoop,
    SharedCores,
)

PERIOD = 1e-3


class Machine:
    """A loop's thread on a clock of its own: how long its ticks wait and work is set."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, priority: int) -> None:
        self.now = self.used = 100.0
        self.priorities: list[int] = []
        self.said: list[tuple[float, str]] = []
        monkeypatch.setattr(module, 'schedule_thread', self._schedule)
        monkeypatch.setattr(module, 'time', self)
        self.load = LoopLoad(PERIOD, priority, lambda text: self.said.append((self.now, text)))
        self.load.begin()

    def perf_counter(self) -> float:
        return self.now

    def thread_time(self) -> float:
        return self.used

    def _schedule(self, priority: int) -> str:
        self.priorities.append(priority)
        return 'taken'

    def run(self, seconds: float, tick: float, wait: float = 0.0) -> None:
        """Tick for a while; each tick waits for the processor, then works for so long [s]."""
        for _ in range(round(seconds / LOOK_WINDOW)):
            taken = max(PERIOD, tick)
            count = round(LOOK_WINDOW / taken)
            self.now, self.used = self.now + LOOK_WINDOW, self.used + count * tick
            assert self.now >= self.load.due - 1e-9
            self.load.look(self.now, np.full(count, wait), np.full(count, tick))

    @property
    def yielded(self) -> bool:
        return bool(self.priorities) and self.priorities[-1] == 0


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    return Machine(monkeypatch, priority=40)


def test_a_loop_that_its_core_carries_keeps_its_priority(machine: Machine) -> None:
    machine.run(60.0, tick=0.6 * PERIOD)
    assert not machine.priorities
    assert not machine.said
    assert not machine.load.finding
    assert machine.load.share == pytest.approx(0.6)


def test_an_overloaded_loop_yields_within_a_window_and_names_a_rate_that_holds(
    machine: Machine,
) -> None:
    machine.run(LOOK_WINDOW, tick=1.6 * PERIOD)
    assert machine.yielded
    assert len(machine.said) == 1
    (found,) = re.findall(r'at most (\d+) Hz', machine.said[0][1])
    rate = float(found)
    # a loop of this rate would be within the threshold, and not by much
    assert 0.6 < rate * 1.6 * PERIOD <= 0.7
    assert 'without SCHED_FIFO' in machine.load.finding


def test_a_loop_that_waits_for_others_yields_as_well(machine: Machine) -> None:
    machine.run(LOOK_WINDOW, tick=0.3 * PERIOD, wait=0.6 * PERIOD)
    assert machine.yielded
    assert '0.3' not in machine.said[0][1]
    assert '30 % of its core' in machine.said[0][1]


def test_loops_that_fill_their_core_together_yield_though_each_takes_little(
    machine: Machine,
) -> None:
    machine.load.crowd(0.9)
    machine.run(LOOK_WINDOW, tick=0.3 * PERIOD)
    assert machine.yielded
    (found,) = re.findall(r'at most (\d+) Hz', machine.said[0][1])
    assert 0.6 < 0.9 * float(found) * PERIOD <= 0.7
    assert 'all real-time threads 90 % of theirs' in machine.said[0][1]


def test_real_time_threads_count_where_cores_are_full(monkeypatch: pytest.MonkeyPatch) -> None:
    cores, ran = SharedCores(), itertools.count(0, 30_000_000)  # ns: 30 ms of 50 ms
    times = iter([(95.0, 100.0), (140.0, 200.0)])
    monkeypatch.setattr(cores, '_before', (0.0, 0.0))
    monkeypatch.setattr(cores, '_times', lambda: next(times))
    monkeypatch.setattr(cores, '_realtime_threads', lambda: {7: 40, 8: 40})
    monkeypatch.setattr(module, '_runtimes', lambda _threads: {7: next(ran), 8: 5})
    share = cores.realtime_share(40)  # busy for 95 % of the time
    assert 0.0 < share * len(cores._cores) <= 0.6 + 1e-9
    assert cores.realtime_share(40) == 0.0  # for 45 %


@pytest.mark.parametrize(
    ('others', 'shares'),
    [
        ([40, 39, 1], [0.6, 0.6, 0.6]),  # its own, and a recorder's
        ([40, 39, 29, 30], [0.0, 0.6, 0.0]),  # a loop of a lower priority may yield meanwhile
    ],
)
def test_loops_of_a_lower_priority_yield_first(
    monkeypatch: pytest.MonkeyPatch, others: list[int], shares: list[float]
) -> None:
    cores, ran = SharedCores(), itertools.count(0, 60_000_000)
    monkeypatch.setattr(cores, '_cores', {0, 1})
    times = itertools.count(1)
    monkeypatch.setattr(cores, '_before', (0.0, 0.0))
    monkeypatch.setattr(cores, '_times', lambda: (95.0 * (n := next(times)), 100.0 * n))
    monkeypatch.setattr(cores, '_realtime_threads', lambda: dict(enumerate(others)))
    monkeypatch.setattr(module, '_runtimes', lambda _threads: {7: next(ran)})
    clock = itertools.count(0.0, 0.05)
    monkeypatch.setattr('time.sleep', lambda _seconds: None)
    monkeypatch.setattr('time.perf_counter', lambda: next(clock))
    found = [cores.realtime_share(40) for _ in shares]
    assert found == pytest.approx(shares)


def test_a_real_time_thread_is_found_by_its_policy() -> None:
    cores, found = SharedCores(), threading.Event()
    policies: list[str] = []
    end = threading.Event()

    def run() -> None:
        policies.append(schedule_thread(1))
        found.set()
        end.wait(10.0)

    thread = threading.Thread(target=run)
    thread.start()
    found.wait(10.0)
    listed = thread.native_id in cores._realtime_threads()
    end.set()
    thread.join()
    assert listed == policies[0].startswith('taken')


def test_deadlines_that_were_passed_over_do_not_count_as_waiting(machine: Machine) -> None:
    machine.run(10.0, tick=0.3 * PERIOD, wait=40.1 * PERIOD)
    assert not machine.priorities


def test_a_loop_that_fills_its_core_never_takes_its_priority_back(machine: Machine) -> None:
    machine.run(200.0, tick=1.2 * PERIOD)
    assert machine.priorities == [0]
    assert len(machine.said) == 1


def test_rests_get_longer_while_the_machine_stays_full(machine: Machine) -> None:
    moments = []
    for _ in range(4000):
        before = len(machine.priorities)
        machine.run(LOOK_WINDOW, tick=0.3 * PERIOD, wait=0.6 * PERIOD)
        if len(machine.priorities) > before and machine.priorities[-1] == 40:
            moments.append(machine.now)
    rests = np.diff(moments)
    assert moments[0] == pytest.approx(100.0 + FIRST_REST, abs=2.0 * LOOK_WINDOW)
    assert (np.diff(rests) >= -1e-6).all()
    assert rests[-1] == pytest.approx(LONGEST_REST, abs=2.0 * LOOK_WINDOW)
    # all the while it had the processor to itself for a window per rest at most
    assert len(machine.said) == 1


def test_the_priority_comes_back_and_the_end_is_told(machine: Machine) -> None:
    machine.run(1.0, tick=0.3 * PERIOD, wait=0.6 * PERIOD)
    machine.run(FIRST_REST + HOLDS + 2.0, tick=0.3 * PERIOD)
    assert machine.priorities == [0, 40]
    assert not machine.load.finding
    assert machine.said[-1][1] == 'the machine carries the loop at 1000 Hz'


def test_a_loop_without_priority_says_the_same_and_schedules_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    machine = Machine(monkeypatch, priority=0)
    machine.run(1.0, tick=1.5 * PERIOD)
    assert not machine.priorities
    assert len(machine.said) == 1
    assert 'SCHED_FIFO' not in machine.load.finding


def test_the_threshold_is_live(machine: Machine) -> None:
    machine.run(1.0, tick=0.6 * PERIOD)
    assert not machine.load.finding
    machine.load.threshold = 0.5
    machine.run(LOOK_WINDOW, tick=0.6 * PERIOD)
    assert machine.load.finding


@pytest.fixture
def spinning() -> Iterator[tuple[RealtimeLoop, list[Any]]]:
    said: list[Any] = []

    def tick(_steps: int) -> None:
        end = time.thread_time() + 1.3 / 200.0
        while time.thread_time() < end:
            pass

    loop = RealtimeLoop(200.0, tick, tell=said.append)
    yield loop, said
    loop.stop()


def test_a_running_loop_judges_itself(spinning: tuple[RealtimeLoop, list[Any]]) -> None:
    loop, said = spinning
    loop.start()
    end = time.perf_counter() + 20.0
    while not said and time.perf_counter() < end:
        time.sleep(0.02)
    assert 'update_rate must be at most' in said[0]
    assert loop.load.finding
