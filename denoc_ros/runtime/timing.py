"""The real-time loop: its own thread on an absolute deadline of the robot's clock."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from denoc_ros.runtime.clocks import Clock, SteadyClock
from denoc_ros.runtime.load import LoopLoad
from denoc_ros.runtime.realtime import make_thread_timely

WINDOW = 1 << 15  # ticks kept between two readings of the statistics
# period over its nominal value: finer around 1, open at both ends
HISTOGRAM_EDGES = np.concatenate(
    ([0.0], np.linspace(0.1, 2.0, 96), [2.5, 3.0, 4.0, 5.0, 10.0, 20.0, 50.0, 100.0])
)


@dataclass(frozen=True)
class LoopStatistics:
    """Timing of the loop since the last reading; totals since its start."""

    rate: float  # Hz
    period_p50: float  # s
    period_p99: float  # s
    period_max: float  # s
    tick_p50: float  # s, time spent in the tick itself
    tick_p99: float  # s
    ticks: int
    late: int  # ticks late by more than half a period
    skipped: int  # deadlines passed over because a tick was later than a whole period
    ticks_total: int
    late_total: int
    skipped_total: int
    histogram: NDArray[np.int64]  # of period / nominal since the start, by HISTOGRAM_EDGES

    @property
    def late_share(self) -> float:
        """Share of deadlines missed by more than half a period since the last reading."""
        deadlines = self.ticks + self.skipped
        return (self.late + self.skipped) / deadlines if deadlines else 0.0


class RealtimeLoop:
    """Calls `tick(steps)` once per period until stopped.

    `steps` is 1 plus the deadlines skipped since the last call, so that a node that integrates
    keeps up with the clock. A tick that raises ends the loop; `failure` then holds the error.

    Parameters
    ----------
    rate : float
        Hz.
    tick : callable
        Called with the number of periods to advance.
    priority, core : int
        SCHED_FIFO priority (0: none) and core (-1: any) of the thread.
    clock : Clock, optional
        The clock of the deadlines; default the steady clock.
    tell : callable, optional
        Takes a sentence when the machine does not carry the loop, and when it does again.

    Attributes
    ----------
    load : LoopLoad
        What the loop takes; in simulated time, which waits for it, nothing is judged.
    deadline : float
        The moment of the clock [s] that the tick at hand is for.
    shift : float
        How much later than a period after this deadline the next one is [s]; a tick sets it for
        the next period only.
    realtime_options : dict of str to str
        What the thread asked of the system: `taken: …`, `refused: …` or `off`.
    """

    def __init__(
        self,
        rate: float,
        tick: Callable[[int], None],
        priority: int = 0,
        core: int = -1,
        clock: Clock | None = None,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.period = 1.0 / rate
        self.load = LoopLoad(self.period, priority, tell)
        self._clock = SteadyClock() if clock is None else clock
        self.deadline = self._clock.now()
        self.shift = 0.0
        self.realtime_options: dict[str, str] = {}
        self.failure: BaseException | None = None
        self._tick = tick
        self._priority, self._core = priority, core
        self._running = False
        self._thread: threading.Thread | None = None
        self._start = np.zeros(WINDOW)  # ring: when a tick began, against its deadline
        self._late = np.zeros(WINDOW)
        self._spent = np.zeros(WINDOW)
        self._count = 0
        self._read = 0
        self._skipped = 0
        self._skipped_read = 0
        self._late_total = 0
        self._last_start = np.nan
        self._histogram = np.zeros(len(HISTOGRAM_EDGES), dtype=np.int64)

    @property
    def running(self) -> bool:
        """Whether the thread is alive."""
        return self._thread is not None and self._thread.is_alive()

    def start(self) -> None:
        """Start the thread."""
        self._running = True
        self._thread = threading.Thread(target=self._run, name='loop', daemon=True)
        self._thread.start()

    def stop(self, timeout: float = 2.0) -> None:
        """Stop after the tick at hand and wait for the thread."""
        self._running = False
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout)

    def _run(self) -> None:
        self.realtime_options = make_thread_timely(self._priority, self._core)
        try:
            self._loop()
        except BaseException as error:
            self.failure = error

    def _loop(self) -> None:
        clock, now, tick, period = self._clock, time.perf_counter, self._tick, self.period
        start, late, spent = self._start, self._late, self._spent
        load, seen = self.load, self._count
        if not clock.is_simulated:
            load.begin()
        deadline = clock.first(period)
        while self._running:
            began = clock.wait(deadline)
            if began is None:
                deadline = clock.first(period)
                continue
            start_wall = now()
            if start_wall >= load.due:
                slots = np.arange(max(seen, self._count - WINDOW), self._count) % WINDOW
                load.look(start_wall, late[slots], spent[slots])
                seen = self._count
            behind = began - deadline
            missed = int(behind / period) if behind > period else 0
            deadline += period * missed
            self.deadline = deadline
            tick(missed + 1)
            slot = self._count % WINDOW
            start[slot] = began
            late[slot] = behind
            spent[slot] = now() - start_wall
            self._count += 1
            self._skipped += missed
            deadline = clock.after(deadline, period) + self.shift
            self.shift = 0.0

    def record(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return when the last ticks (at most `WINDOW`) began and how late each was.

        Returns
        -------
        start, late : (ticks,) arrays
            [s] of the clock, and [s] against the deadline: a tick later than a period
            has passed that many whole periods over.
        """
        count = self._count
        slots = np.arange(max(0, count - WINDOW), count) % WINDOW
        return self._start[slots], self._late[slots]

    def statistics(self) -> LoopStatistics:
        """Timing since the last call (at most the last `WINDOW` ticks)."""
        count = self._count
        new = min(count - self._read, WINDOW - 1)
        slots = np.arange(count - new, count) % WINDOW
        start, late, spent = self._start[slots], self._late[slots], self._spent[slots]
        self._read = count
        late_ticks = int(np.count_nonzero(late > 0.5 * self.period))
        self._late_total += late_ticks
        skipped = self._skipped
        new_skipped, self._skipped_read = skipped - self._skipped_read, skipped
        periods = np.diff(start, prepend=self._last_start)
        periods = periods[periods > 0.0]  # not before the first, nor where time was set back
        if new:
            self._last_start = start[-1]
        relative = periods / self.period
        self._histogram += np.bincount(
            np.searchsorted(HISTOGRAM_EDGES, relative, side='right') - 1,
            minlength=len(HISTOGRAM_EDGES),
        )
        some = len(periods) > 0
        return LoopStatistics(
            rate=float(1.0 / periods.mean()) if some else 0.0,
            period_p50=float(np.percentile(periods, 50)) if some else 0.0,
            period_p99=float(np.percentile(periods, 99)) if some else 0.0,
            period_max=float(periods.max()) if some else 0.0,
            tick_p50=float(np.percentile(spent, 50)) if new else 0.0,
            tick_p99=float(np.percentile(spent, 99)) if new else 0.0,
            ticks=int(new),
            late=late_ticks,
            skipped=new_skipped,
            ticks_total=count,
            late_total=self._late_total,
            skipped_total=skipped,
            histogram=self._histogram.copy(),
        )
