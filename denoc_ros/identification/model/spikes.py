"""Wild values in samples: one or two that nothing else in the record has led to."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter

from denoc_ros.types import Array

WINDOW = 5  # samples, of which two may be wild
WILD = 8.0  # robust deviations of what samples are off the median of their window
LEAST = 0.005  # of a signal's robust deviation: nothing nearer to that median is wild
AROUND = 31  # samples: links that ring are off the median for as many
NEAR = 0.25  # of how far a sample is off: links that ring come near that time and again ...
BESIDE = 6  # samples on each side: ... a wild one stands there by itself, or with one other
MOST = 0.05  # of the samples: where more are, it is not single ones that are wild


def without_spikes(values: Array) -> Array:
    """Return samples (k, columns), lines through their neighbours in place of wild ones.

    Notes
    -----
    Hampel's identifier; the scale is that of the samples around as much as that of all.
    """
    found: Array = values.copy()
    rows = np.arange(len(values))
    for k in range(values.shape[1]):
        column = values[:, k]
        if not np.isfinite(column).all():
            continue
        off = np.abs(column - median_filter(column, WINDOW, mode='nearest'))
        spread = 1.48 * float(np.median(np.abs(column - np.median(column))))
        usual = np.maximum(np.median(off), median_filter(off, AROUND))
        bound = WILD * 1.48 * usual + LEAST * spread
        wild = off > bound
        for row in np.flatnonzero(wild) if wild.sum() <= MOST * len(column) else ():
            around = off[max(row - BESIDE, 0) : row + BESIDE + 1]
            wild[row] = np.sum(around > NEAR * off[row]) <= 2
        if 0 < wild.sum() <= MOST * len(column):
            found[wild, k] = np.interp(rows[wild], rows[~wild], column[~wild])
    return found
