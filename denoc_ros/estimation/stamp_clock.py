"""Time of measurement of a stamped message, on the clock of the loop."""

from __future__ import annotations

import math

# A stamp this close to the wall clock at arrival was given by the same clock.
SAME_CLOCK = 1.0  # s
# Two clocks drift apart by less than this.
DRIFT = 1e-4  # s/s
AHEAD_S = 0.05  # A single stamp that is ahead of the fastest message by more may be wrong.


class StampClock:
    """Maps the stamps of one publisher to the steady clock.

    A publisher on this machine's clock is believed: the age of its messages is known. One on
    another clock (or a replayed recording) is mapped by its fastest message: what comes later
    than that was late by the difference.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the publisher."""
        self._offset = math.nan
        self._shared = self._jumped = False
        self._arrival = 0.0

    def taken_at(self, stamp: float, arrival: float, wall: float) -> float:
        """Return when a message was taken on the steady clock [s].

        Parameters
        ----------
        stamp : float
            Of its header [s]; 0: none, it counts as taken on arrival.
        arrival : float
            When it arrived, steady clock [s].
        wall : float
            The same on the clock that stamps here [s].
        """
        if stamp == 0.0:
            return arrival
        if math.isnan(self._offset):
            self._shared = 0.0 <= wall - stamp <= SAME_CLOCK
            self._offset, self._arrival = arrival - stamp, arrival
        if self._shared:
            return min(arrival, arrival - (wall - stamp))
        self._offset += DRIFT * (arrival - self._arrival)
        self._arrival = arrival
        self._jumped = arrival - stamp < self._offset - AHEAD_S and not self._jumped
        if self._jumped:
            return arrival
        self._offset = min(self._offset, arrival - stamp)
        return stamp + self._offset
