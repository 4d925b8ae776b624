"""The laws of the siege: what left as torque, how long it paused, what each process holds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

ROUNDING = 1e-9
PERIODS = 2.0  # that torque may pause beyond the time the system was away
TIMER = 5e-4  # s: what a stamp taken before or after a publish may be off
WARM_UP = 120.0  # s after a process's start until its memory is held to be settled
LONG_ENOUGH = 240.0  # s of settled memory that say something of its slope
GROWTH = 24e6  # bytes that a process may grow by after that, and ...
SLOPE = 60e6  # ... bytes per hour: one of both may be exceeded
MORE_FILES = 8  # descriptors


OPEN = 1 << 62  # ns: the end of a stretch of time that has not ended


@dataclass
class Span:
    """A stretch of time [ns of the system's clock]."""

    begin: int
    end: int = OPEN

    def meets(self, other: Span) -> bool:
        return self.begin <= other.end and other.begin <= self.end

    @property
    def seconds(self) -> float:
        return 1e-9 * (self.end - self.begin)


class Spans:
    """Many stretches of time, looked through at once: a busy machine has very many."""

    def __init__(self, spans: Iterable[Span]) -> None:
        bounds = [(span.begin, span.end) for span in spans]
        self._begins, self._ends = np.array(bounds, dtype=np.int64).reshape(-1, 2).T

    @property
    def seconds(self) -> NDArray[np.float64]:
        return np.asarray(1e-9 * (self._ends - self._begins))

    def meet(self, other: Span) -> NDArray[np.bool_]:
        """Say of each whether it meets another."""
        return np.asarray((self._begins <= other.end) & (other.begin <= self._ends))


@dataclass
class TorqueLedger:
    """Holds each torque message to the laws as it comes.

    Parameters
    ----------
    limits : (n,) array
        N m or N.
    delta : float
        Largest change per tick.
    rate : float
        Hz.

    Attributes
    ----------
    count : int
        Messages.
    non_finite : int
        Of these, those that were not finite.
    largest_delta : float
        Largest change from one message to the next.
    pauses : list of Span
        Without torque for more than two periods, not judged yet.
    lull : float
        s that torque may pause in addition: a simulated clock stands between two of its messages;
        the torque of all periods until the next leaves at once when that comes.
    """

    limits: NDArray[np.float64]
    delta: float
    rate: float
    count: int = 0
    non_finite: int = 0
    largest_delta: float = 0.0
    pauses: list[Span] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)
    anew: list[Span] = field(default_factory=list)  # in which torque may begin anew
    clock_set: list[Span] = field(default_factory=list)  # in which simulated time is set
    lull: float = 0.0
    _last: tuple[int, int, NDArray[np.float64], int] | None = None

    def take(
        self, sent_ns: int, number: int, effort: NDArray[np.float64], tick_ns: int = 0
    ) -> None:
        """Judge a message.

        Parameters
        ----------
        sent_ns : int
            When it left, by the system's clock.
        number : int
            Its publisher's count of messages, from 1.
        effort : (n,) array
        tick_ns : int
            The moment of simulated time that it is for, 0 in real time.
        """
        self.count += 1
        if effort.shape != self.limits.shape or not np.isfinite(effort).all():
            self.non_finite += 1
            self._break(f'torque must be finite, got {effort.tolist()}')
            self._last = None
            return
        if (np.abs(effort) > self.limits).any():
            self._break(f'torque must be within {self.limits.tolist()}, got {effort.tolist()}')
        before, self._last = self._last, (sent_ns, number, effort, tick_ns)
        if before is None or number <= 1:
            return
        span = Span(before[0], sent_ns)
        if span.seconds > PERIODS / self.rate + self.lull + TIMER:
            self.pauses.append(span)
        if number == before[1] + 1:
            self._compare(span, effort - before[2])
            self._count_periods(span, before[3], tick_ns)

    def _count_periods(self, span: Span, before: int, now: int) -> None:
        """Hold simulated time [ns] from one message to the next to one period."""
        periods = round(1e-9 * (now - before) * self.rate)
        if periods > 1 and not any(span.meets(each) for each in [*self.anew, *self.clock_set]):
            self._break(
                f'each period of simulated time must have its torque, got {periods} from '
                f'{before} to {now} ns, sent at {span.begin} and {span.end}'
            )

    def _compare(self, span: Span, change: NDArray[np.float64]) -> None:
        largest = float(np.abs(change).max())
        over = largest > self.delta * (1.0 + ROUNDING) + ROUNDING
        if over and not any(span.meets(each) for each in self.anew):
            self._break(f'torque must change by at most {self.delta:g} per tick, got {largest:g}')
            return
        if not over:
            self.largest_delta = max(self.largest_delta, largest)

    def _break(self, law: str) -> None:
        if len(self.broken) < 20:
            self.broken.append(law)

    def told(self) -> list[str]:
        """Return the broken laws since the last call."""
        broken, self.broken = self.broken, []
        return broken


def unexplained(pause: Span, allowed: float, away: float) -> bool:
    """Say whether a pause is longer than periods [s] and the system's absence [s] make it."""
    return pause.seconds > allowed + away + TIMER


@dataclass
class Life:
    """What one process held, second by second, from its start to its end."""

    name: str
    pid: int
    at: list[float] = field(default_factory=list)  # s
    memory: list[float] = field(default_factory=list)  # bytes
    files: list[int] = field(default_factory=list)

    def settled(self, warm_up: float = WARM_UP) -> tuple[NDArray[np.float64], ...]:
        at = np.array(self.at)
        after = at >= (at[0] if len(at) else 0.0) + warm_up
        return at[after], np.array(self.memory)[after], np.array(self.files, dtype=float)[after]

    def judge(self, warm_up: float = WARM_UP) -> list[str]:
        """Return the broken laws; a life too short to say is lawful."""
        at, memory, files = self.settled(warm_up)
        if len(at) < 10 or at[-1] - at[0] < LONG_ENOUGH:
            return []
        broken = []
        quarter = max(1, len(at) // 4)
        grown = float(np.median(memory[-quarter:]) - np.median(memory[:quarter]))
        per_hour = 3600.0 * slope(at, memory)
        if grown > GROWTH and per_hour > SLOPE:
            broken.append(
                f'{self.name}: memory must stay, grew by {1e-6 * grown:.1f} MB '
                f'({1e-6 * per_hour:.0f} MB/h) in {at[-1] - at[0]:.0f} s'
            )
        more = float(np.median(files[-quarter:]) - np.median(files[:quarter]))
        if more > MORE_FILES:
            broken.append(f'{self.name}: descriptors must stay as many, got {more:.0f} more')
        return broken


def slope(at: Sequence[float] | NDArray[np.float64], values: NDArray[np.float64]) -> float:
    """Return how fast values grow per second: the median of all pairs' slopes (Theil, Sen)."""
    at = np.asarray(at)
    chosen = np.unique(np.linspace(0, len(at) - 1, 200).astype(int))
    t, v = at[chosen], np.asarray(values)[chosen]
    first, second = np.triu_indices(len(t), 1)
    return float(np.median((v[second] - v[first]) / (t[second] - t[first])))
