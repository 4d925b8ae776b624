"""The real-time loop: its thread on an absolute deadline, its load, its place between messages.

Under SCHED_FIFO a loop that its core cannot carry takes the processor from everything else. So it
looks at itself four times a second. While it is overloaded it runs as an ordinary thread; after a
rest it takes its priority back, and after a longer one if that was too early. The same holds where
several loops fill their cores together, of which each alone takes little.
"""

from __future__ import annotations

import cmath
import math
import os
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from denoc_ros.runtime.loop.clocks import Clock, SteadyClock
from denoc_ros.runtime.loop.realtime import REFUSED, make_thread_timely, schedule_thread
from denoc_ros.types import Array

# s: four loops of one core that give up in turn leave it before a second is over
LOOK_WINDOW = 0.25
FEWEST = 20  # ticks of a window
FIRST_REST, LONGEST_REST = 2.0, 64.0  # s as an ordinary thread
HOLDS = 1.0  # s without overload after which the machine counts as carrying the loop again
LOAD_SHARE = 0.7  # of a core
FULL = 0.9  # share of their time that cores are busy which may leave somebody without
SAMPLE = 0.05  # s over which the real-time threads of full cores are looked at
HARMLESS = 0.5  # share of full cores below which real-time threads are not looked at for a while
CALM = 1.0  # s of that
RECORDING = 1  # priority of threads that go before ordinary ones only, and yield to nobody
SEVERAL = 8  # processes that are looked at without a pause for others
REALTIME = (os.SCHED_FIFO, os.SCHED_RR)
LONGEST_WAIT, SHORT = 0.01, 1e-4  # s that others wait for the end of a tick; between two looks
QUANTILES = (50, 99, 100)  # % that are told of periods and ticks
WINDOW = 1 << 15  # ticks kept between two readings of the statistics
# period over its nominal value: finer around 1, open at both ends
HISTOGRAM_EDGES = np.concatenate(
    ([0.0], np.linspace(0.1, 2.0, 96), [2.5, 3.0, 4.0, 5.0, 10.0, 20.0, 50.0, 100.0])
)
MEMORY = 0.05  # weight of the newest stamp in the mean phase
STEADY = 0.5  # length of the mean of unit vectors: stamps at any phase give 0
SLEW = 0.01  # of a period that a deadline moves per tick, at most
PLACE = 0.5  # of a period after a stamp: what is asked of it is there before the next one


class LoopLoad:
    """Judges whether the machine carries a loop, window by window, in the loop's thread.

    Parameters
    ----------
    priority : int
        Its SCHED_FIFO priority; 0: none, so there is nothing to give up.
    tell : callable
        Takes a sentence when the loop is overloaded, and when it no longer is.

    Attributes
    ----------
    threshold : float
        Share of a core, and of a period, from which on the loop is overloaded.
    due : float
        When to look next, on the steady clock [s].
    share : float
        Of a core that the loop took in the last window.
    response : float
        Time from a deadline to the end of its tick, the median of the last window [s].
    cause : str
        Why the machine does not carry the loop; '' if it does.
    """

    def __init__(
        self, period: float, priority: int, tell: Callable[[str], None] = lambda _: None
    ) -> None:
        self.threshold = LOAD_SHARE
        self.due = math.inf
        self.share = self.response = 0.0
        self.cause = ''
        self.has_yielded = False
        self.period, self._priority, self._tell = period, priority, tell
        self._window = max(LOOK_WINDOW, FEWEST * period)
        self._begin = self._spent = 0.0
        self._rest = FIRST_REST
        self._crowd = 0.0
        self._back, self._good_since = -math.inf, math.inf

    def begin(self) -> None:
        """Begin in the loop's thread."""
        self._start_window(time.perf_counter())

    def look(self, now: float, late: Array, spent: Array) -> None:
        """Judge the window that ends at steady `now` [s].

        Parameters
        ----------
        late, spent : (ticks,) arrays
            How late each tick began, and how long it took [s].
        """
        if not len(late):
            return
        used = time.thread_time() - self._spent
        self.share = used / (now - self._begin)
        # deadlines that were passed over are not waited for
        self.response = float(np.median(late % self.period + spent))
        self._start_window(now)
        too_much = self.share > self.threshold
        crowd, self._crowd = self._crowd, 0.0
        if too_much:
            needed = used / len(late)
        else:
            needed = max(self.response, crowd * self.period)
        if needed > self.threshold * self.period:
            news = not self.cause
            self.cause = self._cause(needed, crowd)
            if not self.has_yielded:
                self._yield(now)
            if news:
                self._tell(self.finding)
        elif self.cause and not self.has_yielded:
            self._good_since = min(self._good_since, now)
            if now >= max(self._back, self._good_since + HOLDS):
                self.cause = ''
                self._tell(f'the machine carries the loop at {1.0 / self.period:g} Hz')
        if self.has_yielded:
            self._rest_until_back(now, too_much)

    def _start_window(self, now: float) -> None:
        self._begin, self._spent, self.due = now, time.thread_time(), now + self._window

    def crowd(self, share: float) -> None:
        """Take the share of their cores that all real-time threads took, from any thread."""
        self._crowd = share

    def _cause(self, needed: float, crowd: float) -> str:
        """Describe a loop's load from the time that a tick needs."""
        together = f', all real-time threads {100.0 * crowd:.0f} % of theirs' if crowd else ''
        return (
            f'the loop took {100.0 * self.share:.0f} % of its core{together}, and half of the '
            f'ticks ended later than {100.0 * self.response / self.period:.0f} % of a period: '
            f'update_rate must be at most {_rounded(self.threshold / needed):g} Hz on this '
            f'machine, got {1.0 / self.period:g}'
        )

    def _yield(self, now: float) -> None:
        """Go on as an ordinary thread; for longer each time that the last rest was too short."""
        long_ago = now - self._back > 2.0 * self._rest
        self._rest = FIRST_REST if long_ago else min(2.0 * self._rest, LONGEST_REST)
        self._back, self._good_since = now + self._rest, math.inf
        if self._priority > 0:
            self.has_yielded = not schedule_thread(0).startswith(REFUSED)

    def _rest_until_back(self, now: float, too_much: bool) -> None:
        """Take the priority back after the rest, but not while the loop would fill its core."""
        if too_much:
            self._back = now + self._rest
        elif now >= self._back:
            self.has_yielded = schedule_thread(self._priority).startswith(REFUSED)

    @property
    def finding(self) -> str:
        """Overload of the machine and its remedy so far; '' if it carries the loop."""
        state = '; it runs without SCHED_FIFO while that lasts' if self.has_yielded else ''
        return f'{self.cause}{state}' if self.cause else ''


def _rounded(rate: float) -> float:
    """Return a rate [Hz] rounded down to two digits."""
    digit = 10.0 ** math.floor(math.log10(rate) - 1.0)
    return math.floor(rate / digit) * digit


class SharedCores:
    """The cores that this process may run on, and how much real-time threads take of them."""

    def __init__(self) -> None:
        self._cores = os.sched_getaffinity(0)
        self._names = {f'cpu{core}' for core in self._cores}
        self._before = self._times()
        self._due = -math.inf
        self._has_waited = False

    def realtime_share(self, priority: int) -> float:
        """Return the share that all real-time threads took of these cores together.

        0 while the cores were busy for less than `FULL` of the time since the last call, and for
        a while after a share that was harmless: to look at every thread takes milliseconds. 0 at
        the first of several calls as well, if there are loops of a lower priority: they yield.

        Parameters
        ----------
        priority : int
            SCHED_FIFO priority of whoever asks, whose other threads have one less.
        """
        before, self._before = self._before, self._times()
        busy, whole = (now - then for now, then in zip(self._before, before, strict=True))
        has_waited, self._has_waited = self._has_waited, False
        if whole <= 0.0 or busy < FULL * whole or time.perf_counter() < self._due:
            return 0.0
        threads = self._realtime_threads()
        begin, first = time.perf_counter(), _runtimes(threads)
        time.sleep(SAMPLE)
        elapsed, second = time.perf_counter() - begin, _runtimes(threads)
        taken = sum(second[thread] - first[thread] for thread in first.keys() & second.keys())
        share = 1e-9 * taken / (elapsed * len(self._cores))
        if share < HARMLESS:
            self._due = time.perf_counter() + CALM
        if not has_waited and any(RECORDING < one < priority - 1 for one in threads.values()):
            self._has_waited = True
            return 0.0
        return share

    def _times(self) -> tuple[float, float]:
        """Return how long these cores have been busy, and the time in all [ticks]."""
        busy = whole = 0.0
        for line in Path('/proc/stat').read_text(encoding='ascii').splitlines():
            name, _, rest = line.partition(' ')
            if name in self._names:
                numbers = list(map(int, rest.split()[:8]))
                whole += sum(numbers)
                busy += sum(numbers) - numbers[3] - numbers[4]  # idle, and waiting for a disk
        return busy, whole

    def _realtime_threads(self) -> dict[int, int]:
        """Return the real-time threads that may run on these cores, and their priorities."""
        found = {}
        # as text: a Path for each takes several times as long
        processes = filter(str.isdecimal, os.listdir('/proc'))
        for count, process in enumerate(processes, 1):
            if count % SEVERAL == 0:  # a loop may be due
                time.sleep(SHORT)
            try:
                for thread in map(int, os.listdir(f'/proc/{process}/task')):
                    policy = os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK
                    if policy in REALTIME and os.sched_getaffinity(thread) & self._cores:
                        found[thread] = os.sched_getparam(thread).sched_priority
            except OSError:  # it has ended, or is not ours to look at
                continue
        return found


def _runtimes(threads: Iterable[int]) -> dict[int, int]:
    """Return how long threads have run [ns], of those that are still there."""
    found = {}
    for thread in threads:
        with suppress(OSError):
            text = Path(f'/proc/{thread}/schedstat').read_text(encoding='ascii')
            found[thread] = int(text.split()[0])
    return found


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
    priority, core : int
        SCHED_FIFO priority (0: none) and core (-1: any) of the thread.
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

    def await_pause(self) -> None:
        """Wait for the end of a tick, `LONGEST_WAIT` at most, in another thread.

        What that thread does next has the interpreter until the next tick; at any other time, each
        call of the middleware in a tick would wait for it once more.
        """
        count, end = self._count, time.perf_counter() + LONGEST_WAIT
        while self._count == count and time.perf_counter() < end:
            time.sleep(SHORT)

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
        usual, long, longest = np.percentile(periods, QUANTILES).tolist() if some else (0.0,) * 3
        usual_spent, long_spent, _ = (
            np.percentile(spent, QUANTILES).tolist() if new else (0.0,) * 3
        )
        return LoopStatistics(
            rate=float(1.0 / periods.mean()) if some else 0.0,
            period_p50=usual,
            period_p99=long,
            period_max=longest,
            tick_p50=usual_spent,
            tick_p99=long_spent,
            ticks=int(new),
            late=late_ticks,
            skipped=new_skipped,
            ticks_total=count,
            late_total=self._late_total,
            skipped_total=skipped,
            histogram=self._histogram.copy(),
        )


class PhaseLock:
    """Moves a loop's deadlines to half a period after the stamps of a periodic input.

    A stamp is the time that a measurement is for. Half a period later it has come, and what is
    sent arrives half a period before the next one is due: the delay is the same in every period,
    and neither side's lateness changes it unless it is more than half a period.

    Attributes
    ----------
    is_steady : bool
        Whether the stamps come at multiples of the period: else nothing is moved.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._mean = 0j

    @property
    def is_steady(self) -> bool:
        """Whether the stamps come at one phase of the period."""
        return abs(self._mean) > STEADY

    def forget(self) -> None:
        """Forget the input."""
        self._mean = 0j

    def take(self, stamp: float) -> None:
        """Take the stamp of a message, on the loop's clock [s]."""
        phase = cmath.exp(2j * math.pi * (stamp / self._period % 1.0))
        self._mean += MEMORY * (phase - self._mean)

    def shift(self, deadline: float) -> float:
        """Return by how much the deadline after this one [s] is to come later [s]."""
        if not self.is_steady:
            return 0.0
        phase = cmath.phase(self._mean) / (2.0 * math.pi)
        off = (phase + PLACE - deadline / self._period) % 1.0
        off -= off > 0.5
        return self._period * min(max(off, -SLEW), SLEW)
