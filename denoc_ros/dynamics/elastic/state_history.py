"""Recent amplitudes, for sensor values that arrive late."""

from __future__ import annotations

import math

import numpy as np

from denoc_ros.types import Array


class StateHistory:
    """The last states of a motion with their times, oldest first; allocates nothing per state.

    Parameters
    ----------
    length : int
        How many at least are kept.
    size : int
        Of a state.

    Attributes
    ----------
    times, states : (k,) and (k, size) arrays
        The first ones, as many as `len` says, are those kept.
    last : float
        Newest time [s]; NaN without a state.
    """

    def __init__(self, length: int, size: int) -> None:
        self._length = length
        self.times: Array = np.zeros(2 * length)
        self.states: Array = np.zeros((2 * length, size))
        self.clear()

    def __len__(self) -> int:
        return self._end

    @property
    def first(self) -> float:
        """Oldest time [s]."""
        return float(self.times[0])

    def clear(self) -> None:
        """Forget all."""
        self._end, self.last = 0, math.nan

    def push(self, time: float) -> Array:
        """Return the place (size,) of the next state, at a later time [s]."""
        if self._end == len(self.times):
            self.times[: self._length] = self.times[self._length :]
            self.states[: self._length] = self.states[self._length :]
            self._end = self._length
        self.times[self._end] = self.last = time
        self._end += 1
        place: Array = self.states[self._end - 1]
        return place

    def _first_from(self, time: float) -> int:
        """Return the place of the first state that is not before a time [s]."""
        end, times = self._end, self.times
        # Most callers ask for the newest state.
        if end and time <= self.last and (end == 1 or times.item(end - 2) < time):
            return end - 1
        return int(times[:end].searchsorted(time))

    def at(self, time: float) -> Array:
        """Return the state at a time, on the line through the two about it."""
        if self._end == 1 or time == self.last:
            newest: Array = self.states[self._end - 1]
            return newest
        after = min(max(self._first_from(time), 1), self._end - 1)
        begin, end = self.times[after - 1], self.times[after]
        share = (time - begin) / (end - begin)
        before: Array = self.states[after - 1]
        state: Array = before + share * (self.states[after] - before)
        return state

    def since(self, time: float) -> tuple[Array, Array]:
        """Return views of the times (k,) and states (k, size) from a time [s] on."""
        begin = self._first_from(time)
        return self.times[begin : self._end], self.states[begin : self._end]

    def adopt(self, other: StateHistory) -> None:
        """Go on from another one of states of the same size."""
        times, states = other.since(-np.inf)
        kept = min(len(times), self._length)
        self.times[:kept], self.states[:kept] = times[-kept:], states[-kept:]
        self._end, self.last = kept, other.last
