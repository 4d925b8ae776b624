"""Residual of a fit: its correlation, and its strength near a frequency."""

from __future__ import annotations

import numpy as np

from denoc_ros.identification.quality import Mask
from denoc_ros.types import Array

LOCAL_LINES = 16
COLOURED = 0.5  # correlation of neighbouring residuals
NEAR = 1.5  # typical steps to the next sample: farther is a gap


def neighbour_correlation(residual: Array) -> float:
    """Return the correlation of a residual with itself one sample on, 0 to below 1."""
    power = float(residual @ residual)
    if power == 0.0:
        return 0.0
    return float(np.clip(residual[1:] @ residual[:-1] / power, 0.0, 0.999))


def independent_samples(residual: Array) -> float:
    """Return how many independent samples a residual is worth (as a first-order process)."""
    correlation = neighbour_correlation(residual)
    return residual.size * (1.0 - correlation) / (1.0 + correlation)


def coloured(residual: Array) -> bool:
    """Say whether a residual hangs together: more than noise of the sensor is in it."""
    return neighbour_correlation(residual) > COLOURED


def even_values(t: Array, residual: Array, span: float) -> Array:
    """Return a residual at as many even times from 0 to span, 0 where samples are missing."""
    grid = np.linspace(0.0, span, t.size)
    return np.where(in_gap(t, grid), 0.0, np.interp(grid, t, residual))


def in_gap(t: Array, grid: Array) -> Mask:
    """Return which times (m,) of a grid are far from all stamps (k,)."""
    step = float(np.median(np.diff(t)))
    after = np.clip(np.searchsorted(t, grid), 1, t.size - 1)
    near = np.minimum(np.abs(grid - t[after - 1]), np.abs(t[after] - grid))
    return np.asarray(near > NEAR * step)


def local_variance(t: Array, residual: Array, span: float, sigma: float, omega: float) -> float:
    """Return the variance that white noise would have, were it as strong as near a pole.

    Parameters
    ----------
    t, residual : ndarray, shape (k,)
        Times from the start [s], what is left.
    span : float
        Duration of the record [s].
    sigma, omega : float
        Decay rate [1/s] and damped angular frequency [rad/s]: the lines within the mode's width,
        16 on either side at least, are averaged.
    """
    power = np.abs(np.fft.rfft(even_values(t, residual, span))) ** 2 / t.size
    middle = round(omega / (2.0 * np.pi) * span)
    width = LOCAL_LINES + int(abs(sigma) / np.pi * span)
    low = min(max(1, middle - width), power.size - 2)
    return float(np.mean(power[low : middle + width + 1]))
