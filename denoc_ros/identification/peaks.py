"""Peaks of a sampled curve, those that `scipy.signal.find_peaks` finds.

Importing scipy.signal takes longer than `denoc identify` takes to fit a decay.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from denoc_ros.types import Array

Indices = NDArray[np.intp]


def find_peaks(
    y: Array, height: float = -np.inf, distance: int = 1, prominence: float = 0.0
) -> Indices:
    """Return the samples that are higher than their neighbours; of a plateau the middle.

    Parameters
    ----------
    distance : int
        Samples that peaks are apart; of closer ones the higher is kept.
    prominence : float
        That a peak must have: its height above the higher of the lowest values that separate it,
        on either side, from something higher or the end.

    Returns
    -------
    ndarray of int, shape (m,)
        Rising.
    """
    every = _local_maxima(y)
    kept = y[every] >= height
    kept[kept] = _apart(y[every[kept]], every[kept], distance)
    if prominence > 0.0 and kept.any():
        kept &= _prominences(y, every) >= prominence
    return every[kept]


def _local_maxima(y: Array) -> Indices:
    starts = np.append(0, np.flatnonzero(np.diff(y)) + 1)  # of runs of one value
    level = y[starts]
    inner = 1 + np.flatnonzero((level[1:-1] > level[:-2]) & (level[1:-1] > level[2:]))
    return np.asarray((starts[inner] + starts[inner + 1] - 1) // 2, np.intp)


def _apart(height: Array, index: Indices, distance: int) -> NDArray[np.bool_]:
    """Say which peaks are kept, the highest first."""
    kept = np.ones(index.size, bool)
    if distance < 2:
        return kept
    first = np.searchsorted(index, index - distance, 'right')
    last = np.searchsorted(index, index + distance, 'left')
    for k in np.argsort(height)[::-1]:
        if kept[k]:
            kept[first[k] : last[k]] = False
            kept[k] = True
    return kept


def _prominences(y: Array, maxima: Indices) -> Array:
    lows = np.minimum.reduceat(y, np.append(0, maxima))  # before, between and after them
    before = _lowest_before(y[maxima], lows[:-1])
    after = _lowest_before(y[maxima][::-1], lows[:0:-1])[::-1]
    return np.asarray(y[maxima] - np.maximum(before, after))


def _lowest_before(heights: Array, lows: Array) -> Array:
    """Return the lowest value between each peak and the nearest higher one before it."""
    lowest = np.empty(heights.size)
    higher: list[tuple[float, float]] = []
    for k, (height, low) in enumerate(zip(heights.tolist(), lows.tolist(), strict=True)):
        while higher and higher[-1][0] <= height:
            low = min(low, higher.pop()[1])
        higher.append((height, low))
        lowest[k] = low
    return lowest
