"""Keeps the ticks of a loop at a fixed place between the stamps of an input."""

from __future__ import annotations

import cmath
import math

MEMORY = 0.05  # weight of the newest stamp in the mean phase
STEADY = 0.5  # length of the mean of unit vectors: stamps at any phase give 0
SLEW = 0.01  # of a period that a deadline moves per tick, at most
PLACE = 0.5  # of a period after a stamp: what is asked of it is there before the next one


class PhaseLock:
    """Moves a loop's deadlines to half a period after the stamps of a periodic input.

    A stamp is the time that a measurement is for. Half a period later it has come, and what is
    sent arrives half a period before the next one is due: the delay is the same in every period,
    and neither side's lateness changes it unless it is more than half a period.

    Parameters
    ----------
    period : float
        Of the loop [s].

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
