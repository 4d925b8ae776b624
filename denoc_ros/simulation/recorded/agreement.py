"""Agreement of computed and measured torque or deflection, and their curves, block by block."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from denoc_ros.types import Array, Flags

LONGEST_LAG = 0.25  # s that a lag is looked for
LAGS = 25  # periods, at most, to each side
BINS = 2000  # of a curve, at most, each with its smallest and largest value
SURE = 0.9  # correlation below which a lag means nothing


@dataclass(frozen=True)
class Agreement:
    """A measured and a computed quantity, column by column."""

    samples: NDArray[np.int64]  # (columns,) int rows in which both are known
    # (columns,) of the measured one alone
    measured_rms: Array
    measured_peak: Array
    # (columns,) of measured minus computed
    rms: Array
    bias: Array
    # (columns,) how much later the measured one is than the computed [s]; NaN where they are not
    # alike enough to say
    lag: Array


class Comparison:
    """Compares a measured with a computed quantity, block by block.

    Parameters
    ----------
    columns : int
        How many.
    period : float
        Usual time between rows [s].
    """

    def __init__(self, columns: int, period: float) -> None:
        self._samples = np.zeros(columns, dtype=np.int64)
        self._square, self._peak, self._error, self._error_square = np.zeros((4, columns))
        reach = max(1, min(LAGS, int(LONGEST_LAG / period)))
        self._lags = period * np.arange(-reach, reach + 1)
        self._sums = np.zeros((6, len(self._lags), columns))

    def add(self, t: Array, measured: Array, computed: Array, starts: Flags) -> None:
        """Take rows in.

        Parameters
        ----------
        t : (k,) array
            Times [s].
        measured, computed : (k, columns) array
            Where either is NaN the row does not count.
        starts : (k,) bool array
            Where a motion begins anew: lags are not looked for across.
        """
        known = np.isfinite(measured) & np.isfinite(computed)
        error = np.where(known, measured - computed, 0.0)
        self._samples += np.count_nonzero(known, axis=0)
        self._square += np.sum(np.where(known, measured, 0.0) ** 2, axis=0)
        self._error += error.sum(axis=0)
        self._error_square += np.sum(error**2, axis=0)
        largest = np.max(np.where(known, np.abs(measured), 0.0), axis=0, initial=0.0)
        self._peak = np.maximum(self._peak, largest)
        edges = [0, *(np.flatnonzero(starts[1:]) + 1), len(t)]
        for a, b in itertools.pairwise(edges):
            self._add_lags(t[a:b], measured[a:b], computed[a:b])

    def include(self, other: Comparison) -> None:
        """Take the rows of another comparison in, which has the same columns and period."""
        for name in ('_samples', '_square', '_error', '_error_square', '_sums'):
            getattr(self, name)[...] += getattr(other, name)
        self._peak = np.maximum(self._peak, other._peak)

    def _add_lags(self, t: Array, measured: Array, computed: Array) -> None:
        """Add to the sums of (1, y, y^2, m, m^2, y m), m shifted by each lag."""
        reach = self._lags[-1]
        rows = (t >= t[0] + reach) & (t <= t[-1] - reach)
        y = measured[rows]
        for lag, sums in zip(self._lags, np.moveaxis(self._sums, 1, 0), strict=True):
            m = np.column_stack([np.interp(t[rows] - lag, t, column) for column in computed.T])
            known = np.isfinite(y) & np.isfinite(m)
            for total, values in zip(sums, (1.0, y, y * y, m, m * m, y * m), strict=True):
                total += np.sum(np.where(known, values, 0.0), axis=0)

    def result(self) -> Agreement:
        """Return the measures; NaN for columns without a row."""
        count = np.where(self._samples > 0, self._samples, np.nan)
        return Agreement(
            self._samples,
            np.sqrt(self._square / count),
            np.where(self._samples > 0, self._peak, np.nan),
            np.sqrt(self._error_square / count),
            self._error / count,
            self._lag(),
        )

    def _lag(self) -> Array:
        """Return the lag of the largest correlation, refined by the parabola through three."""
        count, y, yy, m, mm, ym = self._sums
        with np.errstate(divide='ignore', invalid='ignore'):
            spread = np.sqrt((yy - y * y / count) * (mm - m * m / count))
            correlation = (ym - y * m / count) / spread
        lag = np.full(correlation.shape[1], np.nan)
        for column, values in enumerate(correlation.T):
            if not np.isfinite(values).all():
                continue
            k = int(np.argmax(values))
            if 0 < k < len(values) - 1 and values[k] >= SURE:
                before, here, after = values[k - 1 : k + 2]
                bend = before - 2.0 * here + after
                shift = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
                lag[column] = self._lags[k] + shift * (self._lags[1] - self._lags[0])
        return lag


class Shares:
    """Shares of a quantity's mean square that parts explain, block by block.

    The share of a part p of y is sum(p y) / sum(y^2): with what no part explains, shares add up
    to 1. A part that works against y has a negative share.

    Parameters
    ----------
    columns : int
        How many.
    """

    def __init__(self, columns: int) -> None:
        self._square = np.zeros(columns)
        self._products: dict[str, Array] = {}

    def add(self, y: Array, parts: Mapping[str, Array]) -> None:
        """Take rows of the quantity and its parts (k, columns) in; NaN does not count."""
        known = np.isfinite(y)
        y = np.where(known, y, 0.0)
        self._square += np.sum(y * y, axis=0)
        for name, part in parts.items():
            self._products.setdefault(name, np.zeros(len(self._square)))
            self._products[name] += np.sum(part * y, axis=0)

    def include(self, other: Shares) -> None:
        """Take the rows of other shares in, which have the same columns."""
        self._square += other._square
        for name, products in other._products.items():
            self._products.setdefault(name, np.zeros(len(self._square)))
            self._products[name] += products

    def result(self) -> dict[str, Array]:
        """Return each part's share (columns,), and the `unexplained` rest; NaN without rows."""
        square = np.where(self._square > 0.0, self._square, np.nan)
        shares = {name: product / square for name, product in self._products.items()}
        shares['unexplained'] = 1.0 - np.sum(list(shares.values()), axis=0)
        return shares


class Traces:
    """Named curves over the same times.

    Parameters
    ----------
    names : sequence of str
        Of the columns.
    bins : int
        Of a curve, at most, each with its smallest and largest value.
    """

    def __init__(self, names: Sequence[str], bins: int = BINS) -> None:
        self.names = tuple(names)
        self._bins = bins
        self._rows = 1  # per bin
        # of each bin: time, smallest and largest value, and how many rows it has
        self._t = np.zeros(0)
        self._low, self._high = np.zeros((2, 0, len(self.names)))
        self._count = np.zeros(0, dtype=np.int64)

    def __bool__(self) -> bool:
        """Whether there is a row."""
        return len(self._t) > 0

    def add(self, t: Array, values: Array) -> None:
        """Take rows in: times (k,) [s] and values (k, names); NaN where there is none."""
        self._t = np.concatenate([self._t, t])
        self._low = np.concatenate([self._low, values])
        self._high = np.concatenate([self._high, values])
        self._count = np.concatenate([self._count, np.ones(len(t), dtype=np.int64)])
        total = int(self._count.sum())
        while total > self._bins * self._rows:
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


class JoinedTraces:
    """Curves of several times one after another, with a NaN between each two of them.

    Parameters
    ----------
    parts : sequence of Traces
        With the same names, at least one.
    """

    def __init__(self, parts: Sequence[Traces]) -> None:
        self.names = parts[0].names
        self._parts = [part for part in parts if part] or parts[:1]

    def curve(self, name: str) -> tuple[Array, Array]:
        """Return times and values of a curve."""
        times, values = zip(*(part.curve(name) for part in self._parts), strict=True)
        apart = np.cumsum([len(each) for each in times])[:-1]
        behind = [each[0] for each in times[1:]]
        return (
            np.insert(np.concatenate(times), apart, behind),
            np.insert(np.concatenate(values), apart, np.nan),
        )
