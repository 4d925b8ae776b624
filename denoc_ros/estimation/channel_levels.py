"""Usual level, range and noise of measured values."""

from __future__ import annotations

import math

import numpy as np

from denoc_ros.types import Array, Flags

LEVEL = 5.0  # s, over which a level is taken
MOVEMENT = 2.0  # s, the same of movements about it
NOISE = 5.0  # s, the same of the noise
WILD = 25.0  # times the usual square: more counts as so much
SECOND_DIFFERENCE = 6.0  # variance of x1 - 2 x2 + x3 of white noise of variance 1
ENOUGH = 6  # second differences until the noise is known


class ChannelLevels:
    """Levels of c channels and of their derivatives by p parameters; noise of their gaps.

    Noise is what second differences from block to block show: motion, even a wrong model's, is
    smoother than that.

    Parameters
    ----------
    channels, parameters : int
    least : (c,) array
        The least noise.

    Attributes
    ----------
    movement, noise : (c,) arrays
        Root mean square about the level, and of the noise of one block's mean.
    """

    def __init__(self, channels: int, parameters: int, least: Array) -> None:
        self._level: Array = np.full((channels, 1 + parameters), np.nan)
        self._square, self._rough = np.zeros((2, channels))
        self._gaps: Array = np.full((2, channels), np.nan)
        self._seen = np.zeros(channels)
        self._least = least

    @property
    def movement(self) -> Array:
        """Root mean square of each channel about its level (c,)."""
        return np.sqrt(self._square)

    @property
    def noise(self) -> Array:
        """Standard deviation of a block's mean (c,)."""
        return np.maximum(np.sqrt(self._rough / SECOND_DIFFERENCE), self._least)

    @property
    def known(self) -> Flags:
        """Which channels' noise is known (c,) bool."""
        return np.asarray(self._seen >= ENOUGH)

    def interrupt(self) -> None:
        """The next block does not follow the last one."""
        self._gaps[:] = np.nan

    def take(self, heard: Flags, gap: Array, value: Array, by: Array, duration: float) -> Array:
        """Take a block in; return the derivatives without their level (c, p).

        Parameters
        ----------
        heard : (c,) bool array
        gap, value : (c,) arrays
            Measured minus predicted, and predicted.
        by : (c, p) array
            Derivatives of the prediction.
        duration : float
            Of the block [s].
        """
        now = np.column_stack([value, by])
        new = heard & np.isnan(self._level[:, 0])
        self._level[new] = now[new]
        about = np.where(heard[:, None], now - self._level, 0.0)
        self._level += -math.expm1(-duration / LEVEL) * about
        self._square += -math.expm1(-duration / MOVEMENT) * (about[:, 0] ** 2 - self._square)
        self._roughen(heard, gap, duration)
        return np.asarray(about[:, 1:])

    def _roughen(self, heard: Flags, gap: Array, duration: float) -> None:
        rough = (gap - 2.0 * self._gaps[1] + self._gaps[0]) ** 2
        self._gaps[0] = self._gaps[1]
        self._gaps[1] = np.where(heard, gap, np.nan)
        good = heard & np.isfinite(rough)
        self._seen += good
        usual = self._seen > ENOUGH
        rough = np.where(usual, np.minimum(rough, WILD * self._rough), rough)
        share = np.maximum(-math.expm1(-duration / NOISE), 1.0 / np.maximum(self._seen, 1.0))
        self._rough[good] += (share * (rough - self._rough))[good]
