"""The robot's time: of the steady clock, or of the topic `/clock`; stamps of its moments."""

from __future__ import annotations

import math
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from time import perf_counter

TRIES = 4
SAME_MOMENT = 2e-5  # s between two readings that count as the same moment
COMPARED = 0.01  # s for which the distance of the steady clock and the system's is taken as known
ORIGINS = (1 << 20) * 1_000_000_000  # ns between origins: a float has the moments to 0.1 ns
FARTHEST = 10_000_000_000  # ns that a clock may be ahead of the moment at hand and be caught up
LOOK = 0.02  # s of wall time between looks while a clock stands
STANDS = 1.0  # s of wall time without progress after which nothing more is expected
BEHIND = 0.1  # s of wall time that a simulation makes up for
REPEAT = 0.05  # s of wall time between repetitions of a time that stands
SET_BACK = 1_000_000_000  # ns by which a clock that goes back has been set back


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

    @property
    def shown_ns(self) -> int:
        """Newest time that is known [ns]: a loop that is behind has an earlier moment at hand."""
        return self.now_ns()

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
    def sleep(self, duration: float) -> bool:
        """Let time pass [s]; False: it stands."""

    @abstractmethod
    def wait(self, deadline: float) -> float | None:
        """Wait for a deadline [s]; return the time then.

        None: it has not come yet, or time has begun anew; the loop's next deadline is then that
        of `first`.
        """


class SteadyClock(Clock):
    """The computer's steady clock (`time.perf_counter`); stamps are of the system's clock.

    The two are compared every 10 ms: one that is set shows in stamps that much later.
    """

    def __init__(self, now_ns: Callable[[], int] = time.time_ns) -> None:
        self._now_ns = now_ns
        self._zero_ns, self._due = 0, -math.inf  # stamp of moment 0; when to compare again
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
        if perf_counter() >= self._due:
            self._compare()
        return self._zero_ns + round(1e9 * moment)

    def moment(self, stamp_ns: int) -> float:
        """Return the moment [s] of a stamp [ns]."""
        if perf_counter() >= self._due:
            self._compare()
        return 1e-9 * (stamp_ns - self._zero_ns)

    def _compare(self) -> None:
        now, now_ns = at_once(self._now_ns)
        self._zero_ns, self._due = now_ns - round(1e9 * now), now + COMPARED

    def first(self, period: float) -> float:
        """Return the moment a period from now [s]."""
        return time.perf_counter() + period

    def after(self, deadline: float, period: float) -> float:
        """Return the deadline a period later [s]."""
        return deadline + period

    def sleep(self, duration: float) -> bool:
        """Sleep [s]."""
        time.sleep(duration)
        return True

    def wait(self, deadline: float) -> float:
        """Sleep until a deadline [s]; return the time then."""
        left = deadline - time.perf_counter()
        if left > 0.0:
            time.sleep(left)
        return time.perf_counter()


def at_once(now_ns: Callable[[], int]) -> tuple[float, int]:
    """Read `time.perf_counter` [s] and another clock [ns] at the same moment.

    The two clocks are read close together: a thread that loses the processor between the readings
    would see one clock jump by the time it was away.
    """
    before, shown, after = perf_counter(), now_ns(), perf_counter()
    best, moment = after - before, 0.5 * (before + after)
    tries = 1
    while best >= SAME_MOMENT and tries < TRIES:
        before, reading, after = perf_counter(), now_ns(), perf_counter()
        tries += 1
        if after - before < best:
            best, moment, shown = after - before, 0.5 * (before + after), reading
    return moment, shown


class _StampedTime(Clock):
    """Time that is told in stamps: the moments of a tick are exact, the same in every process.

    The origin is a multiple of `ORIGINS`, and deadlines are multiples of a loop's period: neither
    depends on when a process heard of the clock first. Moments are exact to the nanosecond.
    """

    is_simulated = True

    def __init__(self) -> None:
        self._origin_ns = 0
        self._now_ns = 0
        self._now = 0.0
        self.begun = False

    def now(self) -> float:
        """Return the moment at hand [s]; 0 before the clock has begun."""
        return self._now

    def now_ns(self) -> int:
        """Return the stamp of the moment at hand [ns]."""
        return self._now_ns

    def stamp_ns(self, moment: float) -> int:
        """Return the stamp [ns] of a moment [s]."""
        return self._origin_ns + round(1e9 * moment)

    def moment(self, stamp_ns: int) -> float:
        """Return the moment [s] of a stamp [ns]."""
        return 1e-9 * (stamp_ns - self._origin_ns)

    def first(self, period: float) -> float:
        """Return the next multiple of a period [s]; infinite before the clock has begun."""
        if not self.begun:
            return math.inf
        since, step = self._now_ns - self._origin_ns, 1e9 * period
        count = int(since / step)
        while (following := round(count * step)) <= since:
            count += 1
        return 1e-9 * following

    def after(self, deadline: float, period: float) -> float:
        """Return the next multiple of a period [s]."""
        return self.first(period)

    def sleep(self, duration: float) -> bool:
        """Let time pass [s]; False: it stands."""
        end = time.perf_counter() + STANDS
        while time.perf_counter() < end:
            if self.wait(self.first(duration)) is not None:
                return True
        return False

    def _begin(self, now_ns: int) -> None:
        self._origin_ns = now_ns // ORIGINS * ORIGINS
        self.begun = True
        self._set(now_ns)

    def _set(self, now_ns: int) -> None:
        self._now_ns, self._now = now_ns, self.moment(now_ns)


class SimulatedClock(_StampedTime):
    """Time of the topic `/clock`: it goes as fast as whoever publishes there.

    All deadlines that a message passes over are worked through in order, each with its deadline as
    the moment at hand. A clock that stands is a pause. One that is set back, or ahead by more than
    `FARTHEST`, begins anew.

    One thread at a time takes messages: a loop's in `wait`, else whoever calls `poll`.

    Parameters
    ----------
    receive : callable
        Waits for a message, so many seconds of wall time at most; returns the newest time [ns],
        None where none came.
    restarted : callable
        Called when time begins anew, with how far it was set [s].
    standing : callable
        Called about every 20 ms of wall time while a loop waits for a clock that stands.

    Attributes
    ----------
    begun : bool
        Whether a message has come.
    heard : float
        When it came, or when this was made, steady clock [s].
    """

    def __init__(
        self,
        receive: Callable[[float], int | None],
        restarted: Callable[[float], None] = lambda _by: None,
        standing: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__()
        self._receive, self._restarted, self._standing = receive, restarted, standing
        self._taking = threading.Lock()
        self._shown_ns = 0
        self.heard = time.perf_counter()

    @property
    def shown_ns(self) -> int:
        """Time that the last message told [ns]."""
        return self._shown_ns

    def poll(self) -> None:
        """Take the waiting message, where no loop does: it sets the moment."""
        with self._taking:
            if self._take(0.0):
                self._set(self.shown_ns)

    def wait(self, deadline: float) -> float | None:
        """Wait for a deadline [s]; return it, or None where it has not come yet."""
        if deadline == math.inf or self.shown_ns < self.stamp_ns(deadline):
            before = self.shown_ns
            with self._taking:
                ran = self._take(LOOK)
            if not ran or self.shown_ns == before:
                self._standing()
            if not ran or deadline == math.inf or self.shown_ns < self.stamp_ns(deadline):
                return None
        self._set(self.stamp_ns(deadline))
        return deadline

    def _take(self, timeout: float) -> bool:
        """Take a message; say whether one came and time goes on from before."""
        shown_ns = self._receive(timeout)
        if shown_ns is None:
            return False
        self.heard = time.perf_counter()
        if not self.begun:
            self._shown_ns = shown_ns
            self._begin(shown_ns)
            return True
        back, ahead = shown_ns < self.shown_ns, shown_ns - self._now_ns > FARTHEST
        by = 1e-9 * (shown_ns - (self.shown_ns if back else self._now_ns))
        self._shown_ns = shown_ns
        if back or ahead:
            self._begin(shown_ns)
            self._restarted(by)
            return False
        return True


class SourceClock(_StampedTime):
    """Time that a simulation, or a recording, makes: it goes on step by step.

    Parameters
    ----------
    tell : callable
        Tells others the time [ns].
    may_leave : callable
        Says whether all that belongs to a time [ns] has been done by others; may wait a moment.
    standing : callable
        Called about every 20 ms of wall time while time stands.
    start_ns : int
        Where it begins [ns].

    Attributes
    ----------
    factor : float
        Simulated time over wall time, at most; 0: as fast as it goes.
    pause_at : float
        s of simulated time where it stands.
    paused : bool
        Whether it stands there.
    """

    def __init__(
        self,
        tell: Callable[[int], None],
        may_leave: Callable[[int], bool] = lambda _now_ns: True,
        standing: Callable[[], None] = lambda: None,
        start_ns: int = 0,
    ) -> None:
        super().__init__()
        self._tell, self._may_leave, self._standing = tell, may_leave, standing
        self.factor, self.pause_at, self.paused = 1.0, math.inf, False
        self._due = self._told = -math.inf  # s of the steady clock
        self._begin(start_ns)

    def tell(self) -> None:
        """Publish the moment at hand; its messages have been published before."""
        self._told = time.perf_counter()
        self._tell(self._now_ns)

    def wait(self, deadline: float) -> float | None:
        """Go on to a deadline [s] as soon as that is allowed; None: not yet."""
        self.paused = deadline > self.pause_at
        if self.paused:
            time.sleep(LOOK)
        if self.paused or not self._may_leave(self._now_ns):
            self._stand()
            return None
        if self.factor > 0.0 and not self._pace(deadline):
            return None
        self._set(self.stamp_ns(deadline))
        return deadline

    def _pace(self, deadline: float) -> bool:
        """Wait for the wall time that a deadline has; say whether it has come."""
        now = time.perf_counter()
        if now - self._due > BEHIND:  # time lost, or stood: it is not made up for
            self._due = now
        due = self._due + (deadline - self._now) / self.factor
        if due - now > LOOK:
            time.sleep(LOOK)
            return False
        if due > now:
            time.sleep(due - now)
        self._due = due
        return True

    def _stand(self) -> None:
        """Tell the time again: to who has come since, or did not hear it."""
        if time.perf_counter() - self._told > REPEAT:
            self.tell()
        self._standing()


class StampOf:
    """Gives the stamp [ns] of a moment of a clock [s]; none earlier than before."""

    def __init__(self, clock: Clock) -> None:
        self._stamp_ns = clock.stamp_ns
        self._last = 0

    def __call__(self, moment: float) -> int:
        """Return the stamp of a moment [s]."""
        stamp = self._stamp_ns(moment)
        if not 0 < self._last - stamp < SET_BACK:
            self._last = stamp
        return self._last
