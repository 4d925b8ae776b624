"""The load of a real-time loop on its core, and the priority that it gives up where that is full.

Under SCHED_FIFO a loop that its core cannot carry takes the processor from everything else. So it
looks at itself four times a second. While it is overloaded it runs as an ordinary thread; after a
rest it takes its priority back, and after a longer one if that was too early. The same holds where
several loops fill their cores together, of which each alone takes little.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from denoc_ros.runtime.realtime import REFUSED, schedule_thread
from denoc_ros.types import Array

WINDOW = 0.25  # s: four loops of one core that give up in turn leave it before a second is over
FEWEST = 20  # ticks of a window
FIRST_REST, LONGEST_REST = 2.0, 64.0  # s as an ordinary thread
HOLDS = 1.0  # s without overload after which the machine counts as carrying the loop again
SHARE = 0.7  # of a core
FULL = 0.9  # share of their time that cores are busy which may leave somebody without
SAMPLE = 0.05  # s over which the real-time threads of full cores are looked at
HARMLESS = 0.5  # share of full cores below which real-time threads are not looked at for a while
CALM = 1.0  # s of that
REALTIME = (os.SCHED_FIFO, os.SCHED_RR)


class LoopLoad:
    """Judges whether the machine carries a loop, window by window, in the loop's thread.

    Parameters
    ----------
    period : float
        Of the loop [s].
    priority : int
        Its SCHED_FIFO priority; 0: none, so there is nothing to give up.
    tell : callable
        Takes a sentence when the loop is overloaded, and when it no longer is.

    Attributes
    ----------
    period : float
        As given.
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
    has_yielded : bool
        Whether the loop runs without its priority.
    """

    def __init__(
        self, period: float, priority: int, tell: Callable[[str], None] = lambda _: None
    ) -> None:
        self.threshold = SHARE
        self.due = math.inf
        self.share = self.response = 0.0
        self.cause = ''
        self.has_yielded = False
        self.period, self._priority, self._tell = period, priority, tell
        self._window = max(WINDOW, FEWEST * period)
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

    def realtime_share(self) -> float:
        """Return the share that all real-time threads took of these cores together.

        0 while the cores were busy for less than `FULL` of the time since the last call, and for
        a while after a share that was harmless: to look at every thread takes milliseconds.
        """
        before, self._before = self._before, self._times()
        busy, whole = (now - then for now, then in zip(self._before, before, strict=True))
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

    def _realtime_threads(self) -> list[int]:
        """Return the real-time threads that may run on these cores."""
        found = []
        for process in os.listdir('/proc'):  # as text: a Path for each takes several times as long
            if not process.isdecimal():
                continue
            try:
                for thread in map(int, os.listdir(f'/proc/{process}/task')):
                    policy = os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK
                    if policy in REALTIME and os.sched_getaffinity(thread) & self._cores:
                        found.append(thread)
            except OSError:  # it has ended, or is not ours to look at
                continue
        return found


def _runtimes(threads: Sequence[int]) -> dict[int, int]:
    """Return how long threads have run [ns], of those that are still there."""
    found = {}
    for thread in threads:
        with suppress(OSError):
            text = Path(f'/proc/{thread}/schedstat').read_text(encoding='ascii')
            found[thread] = int(text.split()[0])
    return found
