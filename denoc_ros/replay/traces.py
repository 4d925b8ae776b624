"""Curves of a recording of any length, thinned as they grow: extremes stay."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from denoc_ros.types import Array

BINS = 2000  # at most, each with its smallest and largest value


class Traces:
    """Named curves over the same times.

    Parameters
    ----------
    names : sequence of str
        Of the columns.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self._rows = 1  # per bin
        # of each bin: time, smallest and largest value, and how many rows it has
        self._t = np.zeros(0)
        self._low, self._high = np.zeros((2, 0, len(self.names)))
        self._count = np.zeros(0, dtype=np.int64)

    def add(self, t: Array, values: Array) -> None:
        """Take rows in: times (k,) [s] and values (k, names); NaN where there is none."""
        self._t = np.concatenate([self._t, t])
        self._low = np.concatenate([self._low, values])
        self._high = np.concatenate([self._high, values])
        self._count = np.concatenate([self._count, np.ones(len(t), dtype=np.int64)])
        total = int(self._count.sum())
        while total > BINS * self._rows:
            self._rows *= 2
        self._merge()

    def curve(self, name: str) -> tuple[Array, Array]:
        """Return times and values of a curve."""
        column = self.names.index(name)
        if self._rows == 1:
            return self._t, self._low[:, column]
        both = np.stack([self._low[:, column], self._high[:, column]], axis=1)
        return np.repeat(self._t, 2), both.ravel()

    def _merge(self) -> None:
        """Bring as many neighbours together as make up whole bins."""
        if not len(self._t):
            return
        behind = np.cumsum(self._count) - self._count
        first = np.flatnonzero(np.diff(behind // self._rows, prepend=-1))
        self._t = self._t[first]
        self._low = np.fmin.reduceat(self._low, first)
        self._high = np.fmax.reduceat(self._high, first)
        self._count = np.add.reduceat(self._count, first)
