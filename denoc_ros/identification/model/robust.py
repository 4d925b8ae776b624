"""Statistics and losses that few values far off do not decide; wild samples replaced."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import median_filter

from denoc_ros.types import Array

WINDOW = 5  # samples, of which two may be wild
SPIKE_DEVIATIONS = 8.0  # robust deviations of what samples are off the median of their window
LEAST = 0.005  # of a signal's robust deviation: nothing nearer to that median is wild
AROUND = 31  # samples: links that ring are off the median for as many
ECHO_SHARE = 0.25  # of how far a sample is off: links that ring come near that time and again ...
BESIDE = 6  # samples on each side: ... a wild one stands there by itself, or with one other
LARGEST_WILD_SHARE = 0.05  # of the samples: where more are, it is not single ones that are wild
HUBER = 2.5  # standard deviations from which a residual counts linearly
FOURTH = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
WILD_DEVIATIONS = 10.0  # robust deviations: what is beyond says nothing of the size of residuals


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
        bound = SPIKE_DEVIATIONS * 1.48 * usual + LEAST * spread
        wild = off > bound
        for row in np.flatnonzero(wild) if wild.sum() <= LARGEST_WILD_SHARE * len(column) else ():
            around = off[max(row - BESIDE, 0) : row + BESIDE + 1]
            wild[row] = np.sum(around > ECHO_SHARE * off[row]) <= 2
        if 0 < wild.sum() <= LARGEST_WILD_SHARE * len(column):
            found[wild, k] = np.interp(rows[wild], rows[~wild], column[~wild])
    return found


def root_mean_square(values: Array) -> float:
    """Return the root of the mean of squares."""
    return float(np.sqrt(np.mean(values**2)))


def held_rms(values: Array) -> float:
    """Return the rms of values, those beyond ten of their robust deviations held to that."""
    bound = WILD_DEVIATIONS * 1.48 * float(np.median(np.abs(values)))
    return root_mean_square(np.clip(values, -bound, bound) if bound > 0.0 else values)


def noise_of(values: Array, period: float, memory: float = 0.0) -> float:
    """Return the deviation of the noise on a smooth signal, by its fourth differences.

    Parameters
    ----------
    period : float
        Between them [s].
    memory : float
        Standard deviation of the Gaussian low-pass that the noise has passed [s]; 0: it is white.
    """
    if len(values) <= len(FOURTH):
        return 0.0
    apart = period * np.subtract.outer(np.arange(len(FOURTH)), np.arange(len(FOURTH)))
    alike = np.exp(-((apart / (2.0 * memory)) ** 2)) if memory else np.eye(len(FOURTH))
    size = math.sqrt(float(FOURTH @ alike @ FOURTH))
    return 1.48 * float(np.median(np.abs(np.diff(values, 4)))) / size


def huber_residual(residual: Array) -> Array:
    """Return residuals whose squares are Huber's loss."""
    size = np.abs(residual)
    far = size > HUBER
    found: Array = residual.copy()
    found[far] = np.sign(residual[far]) * np.sqrt(HUBER * (2.0 * size[far] - HUBER))
    return found


def huber_slope(residual: Array) -> Array:
    """Return the derivative of Huber residuals by the plain ones."""
    size = np.maximum(np.abs(residual), HUBER)
    slope: Array = HUBER / np.sqrt(HUBER * (2.0 * size - HUBER))
    return slope
