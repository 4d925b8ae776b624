"""Recent amplitudes, for sensor values that arrive late."""

from __future__ import annotations

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
    """

    def __init__(self, length: int, size: int) -> None:
        self._length = length
        self.times: Array = np.zeros(2 * length)
        self.states: Array = np.zeros((2 * length, size))
        self._end = 0

    def __len__(self) -> int:
        return self._end

    @property
    def first(self) -> float:
        """Oldest time [s]."""
        return float(self.times[0])

    @property
    def last(self) -> float:
        """Newest time [s]."""
        return float(self.times[self._end - 1])

    def clear(self) -> None:
        """Forget all."""
        self._end = 0

    def push(self, time: float) -> Array:
        """Return the place (size,) of the next state, at a later time [s]."""
        if self._end == len(self.times):
            self.times[: self._length] = self.times[self._length :]
            self.states[: self._length] = self.states[self._length :]
            self._end = self._length
        self.times[self._end] = time
        self._end += 1
        place: Array = self.states[self._end - 1]
        return place

    def at(self, time: float) -> Array:
        """Return the state at a time, on the line through the two about it."""
        if self._end == 1:
            only: Array = self.states[0]
            return only
        after = int(np.searchsorted(self.times[: self._end], time))
        after = min(max(after, 1), self._end - 1)
        begin, end = self.times[after - 1], self.times[after]
        share = (time - begin) / (end - begin)
        before: Array = self.states[after - 1]
        state: Array = before + share * (self.states[after] - before)
        return state

    def since(self, time: float) -> tuple[Array, Array]:
        """Return views of the times (k,) and states (k, size) from a time [s] on."""
        begin = int(np.searchsorted(self.times[: self._end], time))
        return self.times[begin : self._end], self.states[begin : self._end]

    def adopt(self, other: StateHistory) -> None:
        """Go on from another one of states of the same size."""
        times, states = other.since(-np.inf)
        kept = min(len(times), self._length)
        self.times[:kept], self.states[:kept] = times[-kept:], states[-kept:]
        self._end = kept
