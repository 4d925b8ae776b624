"""Rate limiting for low-priority work, and for attempts that fail."""

from __future__ import annotations

import math

SLOWEST = 1.0  # s between two rounds of whatever cost
SMOOTHING = 0.2  # weight of the newest round in the mean cost


class RateLimiter:
    """Rounds at a rate, and at a lower one where they take more than their share of a processor.

    Parameters
    ----------
    rate : float
        Hz, at most.
    share : float
        Of a processor's time that rounds may take.

    Attributes
    ----------
    period : float
        s between rounds, as things are.
    """

    def __init__(self, rate: float, share: float) -> None:
        self._shortest = 1.0 / rate
        self._share = share
        self._cost = 0.0
        self._due = 0.0
        self.period = self._shortest

    def begin(self, now: float) -> None:
        """Start with a round at once [s]; the cost of earlier rounds is remembered."""
        self._due = now

    def wait(self, now: float, cost: float) -> float:
        """Return how long to wait until the next round [s]."""
        self._cost += SMOOTHING * (cost - self._cost)
        self.period = min(max(self._shortest, self._cost / self._share), SLOWEST)
        # rounds keep their times; those that were missed are not made up for
        self._due = max(self._due + self.period, now)
        return self._due - now


class Backoff:
    """Spaces attempts that fail, so that they take no more than a share of the time.

    Parameters
    ----------
    longest : float
        s at most between two attempts.
    """

    def __init__(self, share: float, longest: float) -> None:
        self._share, self._longest = share, longest
        self._due = -math.inf

    def reset(self) -> None:
        """Let the next attempt be at once."""
        self._due = -math.inf

    def due(self, now: float) -> bool:
        """Say whether it may be tried again at `now` [s]."""
        return now >= self._due

    def failed(self, now: float, cost: float) -> None:
        """Wait after an attempt that failed at `now` [s] and took `cost` [s] of a processor."""
        self._due = now + min(cost / self._share, self._longest)
