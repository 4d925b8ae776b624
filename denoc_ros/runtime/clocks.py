"""The robot's time: of the steady clock, or of the topic `/clock`."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable

TRIES = 4
NEAR = 2e-5  # s between two readings that count as the same moment


class Clock(ABC):
    """The time by which a robot moves: ages, timeouts, references, ramps, horizons.

    Moments are seconds from an origin of the process; stamps are nanoseconds of what stamps
    messages. Processor budgets, child processes and watchdogs of a process go by wall time.

    Attributes
    ----------
    is_simulated : bool
        Whether time comes from a topic.
    """

    is_simulated = False

    @abstractmethod
    def now(self) -> float:
        """Return the present moment [s]: in a tick of simulated time, the tick's deadline."""

    @abstractmethod
    def now_ns(self) -> int:
        """Return the stamp of now [ns]."""

    @abstractmethod
    def stamp_ns(self, moment: float) -> int:
        """Return the stamp [ns] of a moment [s]."""

    @abstractmethod
    def moment(self, stamp_ns: int) -> float:
        """Return the moment [s] of a stamp [ns]."""

    @abstractmethod
    def first(self, period: float) -> float:
        """Return the first deadline [s] of a loop with a period [s] that begins now."""

    @abstractmethod
    def after(self, deadline: float, period: float) -> float:
        """Return the deadline [s] that follows one whose tick is done."""

    @abstractmethod
    def wait(self, deadline: float) -> float | None:
        """Wait for a deadline [s]; return the time then.

        None: it has not come yet, or time has begun anew; the loop's next deadline is then that
        of `first`.
        """


class SteadyClock(Clock):
    """The computer's steady clock (`time.perf_counter`); stamps are of the system's clock.

    Parameters
    ----------
    now_ns : callable, optional
        The clock that stamps.
    """

    def __init__(self, now_ns: Callable[[], int] = time.time_ns) -> None:
        self._now_ns = now_ns
        # no call between: it is asked several times a tick
        self.now = time.perf_counter  # type: ignore[method-assign]
        self.now_ns = now_ns  # type: ignore[method-assign]

    def now(self) -> float:
        """Return the present moment [s]."""
        return time.perf_counter()

    def now_ns(self) -> int:
        """Return the stamp of now [ns]."""
        return self._now_ns()

    def stamp_ns(self, moment: float) -> int:
        """Return the stamp [ns] of a moment [s]."""
        now, now_ns = at_once(self._now_ns)
        return now_ns - round(1e9 * (now - moment))

    def moment(self, stamp_ns: int) -> float:
        """Return the moment [s] of a stamp [ns]."""
        now, now_ns = at_once(self._now_ns)
        return now + 1e-9 * (stamp_ns - now_ns)

    def first(self, period: float) -> float:
        """Return the moment a period from now [s]."""
        return time.perf_counter() + period

    def after(self, deadline: float, period: float) -> float:
        """Return the deadline a period later [s]."""
        return deadline + period

    def wait(self, deadline: float) -> float:
        """Sleep until a deadline [s]; return the time then."""
        left = deadline - time.perf_counter()
        if left > 0.0:
            time.sleep(left)
        return time.perf_counter()


def at_once(now_ns: Callable[[], int]) -> tuple[float, int]:
    """Return a moment of `time.perf_counter` [s] and what another clock shows then [ns].

    The two clocks are read close together: a thread that loses the processor between the readings
    would see one clock jump by the time it was away.
    """
    best, moment, shown = math.inf, 0.0, 0
    for _ in range(TRIES):
        before = time.perf_counter()
        reading = now_ns()
        after = time.perf_counter()
        if after - before < best:
            best, moment, shown = after - before, 0.5 * (before + after), reading
        if best < NEAR:
            break
    return moment, shown
