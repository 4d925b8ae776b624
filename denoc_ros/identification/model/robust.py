"""Statistics and losses that few values far off do not decide."""

from __future__ import annotations

import math

import numpy as np

from denoc_ros.types import Array

HUBER = 2.5  # standard deviations from which a residual counts linearly
WILD = 10.0  # robust deviations: what is beyond says nothing of the size of residuals


def root_mean_square(values: Array) -> float:
    """Return the root of the mean of squares."""
    return float(np.sqrt(np.mean(values**2)))


def held_rms(values: Array) -> float:
    """Return the rms of values, those beyond ten of their robust deviations held to that."""
    bound = WILD * 1.48 * float(np.median(np.abs(values)))
    return root_mean_square(np.clip(values, -bound, bound) if bound > 0.0 else values)


def roughness(values: Array) -> float:
    """Return the deviation of white noise with such second differences."""
    second = np.diff(values, 2) if len(values) > 2 else values
    return 1.48 * float(np.median(np.abs(second))) / math.sqrt(6.0)


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
