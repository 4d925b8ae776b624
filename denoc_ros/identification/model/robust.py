"""Statistics and losses that few values far off do not decide."""

from __future__ import annotations

import math

import numpy as np

from denoc_ros.types import Array

HUBER = 2.5  # standard deviations from which a residual counts linearly
FOURTH = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
WILD = 10.0  # robust deviations: what is beyond says nothing of the size of residuals


def root_mean_square(values: Array) -> float:
    """Return the root of the mean of squares."""
    return float(np.sqrt(np.mean(values**2)))


def held_rms(values: Array) -> float:
    """Return the rms of values, those beyond ten of their robust deviations held to that."""
    bound = WILD * 1.48 * float(np.median(np.abs(values)))
    return root_mean_square(np.clip(values, -bound, bound) if bound > 0.0 else values)


def noise_of(values: Array, period: float, memory: float = 0.0) -> float:
    """Return the deviation of the noise on a smooth signal, by its fourth differences.

    Parameters
    ----------
    values : (k,) array
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


def bent(residual: Array) -> Array:
    """Return residuals whose squares are Huber's loss."""
    size = np.abs(residual)
    far = size > HUBER
    found: Array = residual.copy()
    found[far] = np.sign(residual[far]) * np.sqrt(HUBER * (2.0 * size[far] - HUBER))
    return found


def bending_slope(residual: Array) -> Array:
    """Return the derivative of bent residuals by the straight ones."""
    size = np.maximum(np.abs(residual), HUBER)
    slope: Array = HUBER / np.sqrt(HUBER * (2.0 * size - HUBER))
    return slope
