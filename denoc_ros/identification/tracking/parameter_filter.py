"""A Kalman filter on amplitudes, slow parameters and constant offsets, block after block.

The mean of the amplitudes is not here: the nonlinear model moves it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from denoc_ros.types import Array, Flags

GATE = 4.0  # deviations of the noise by which a parameter must move a block's values to count
LATELY = 0.25  # s, over which that is looked at
OUTLIER_SIGMAS = 4.0  # deviations beyond which a value counts less, the more the farther


class BlockValues(NamedTuple):
    """Measurements of c channels over one block of time."""

    gap: Array  # (c,) measured minus predicted, the means over the block
    by_state: Array  # (c, s) derivatives of the prediction by the state at the block's beginning
    by_parameters: Array  # (c, p) derivatives by the parameters, over the block
    error: Array  # (c,) deviation of the gap for a known state and known parameters
    heard: Flags  # (c,) bool which channels have values


class Correction(NamedTuple):
    """Corrections by a block: of the state at its beginning, parameters, offsets.

    surprise : float
        Mean square of what no parameter explains of the gaps, in the deviations expected; NaN if
        parameters could explain all.
    """

    state: Array
    parameters: Array
    offsets: Array
    surprise: float


class ParameterFilter:
    """Covariance of x = [state (s); parameters (p); offsets (c)], parameters in deviations.

    Parameters
    ----------
    states, parameters, channels : int
        s, p and c.

    Attributes
    ----------
    covariance : (s + p + c, s + p + c) array
        Parameters begin with deviation 1, and never have a larger one.
    """

    def __init__(self, states: int, parameters: int, channels: int) -> None:
        self.covariance: Array = np.zeros((states + parameters + channels,) * 2)
        self._identity = np.eye(len(self.covariance))
        self._of_state = slice(0, states)
        self._of_parameters = slice(states, states + parameters)
        self._of_offsets = slice(states + parameters, None)
        self.covariance[self._of_parameters, self._of_parameters] = np.eye(parameters)

    @property
    def parameters(self) -> Array:
        """Covariance (p, p) of the parameters."""
        return self.covariance[self._of_parameters, self._of_parameters]

    def open_offset(self, channel: int, deviation: float) -> None:
        """Let a channel's offset be unknown by so much."""
        place = self._of_offsets.start + channel
        self.covariance[place, :] = self.covariance[:, place] = 0.0
        self.covariance[place, place] = deviation**2

    def forget_state(self, state: Array, by_parameters: Array) -> None:
        """Start a new state; the knowledge of parameters and offsets stays.

        Parameters
        ----------
        state : (s, s) array
            Covariance of the state for given parameters.
        by_parameters : (s, p) array
            Derivatives of the state by the parameters.
        """
        of, p, b = self._of_state, self._of_parameters, self._of_offsets
        whole = self.covariance
        whole[of, p] = by_parameters @ whole[p, p]
        whole[of, b] = by_parameters @ whole[p, b]
        whole[p, of], whole[b, of] = whole[of, p].T, whole[of, b].T
        whole[of, of] = state + whole[of, p] @ by_parameters.T

    def forget(self, directions: Array, growth: float) -> None:
        """Let the deviations of parameters grow along directions (p, e), to 1 at most."""
        stretch = np.eye(len(directions)) + (growth - 1.0) * directions @ directions.T
        self._scale(stretch)
        values, vectors = np.linalg.eigh(self.parameters)
        if values[-1] > 1.0:
            shrink = 1.0 / np.sqrt(np.maximum(values, 1.0))
            self._scale((vectors * shrink) @ vectors.T)

    def _scale(self, by: Array) -> None:
        p = self._of_parameters
        self.covariance[p, :] = by @ self.covariance[p, :]
        self.covariance[:, p] = self.covariance[:, p] @ by.T

    def take(self, block: BlockValues, free: Array) -> Correction:
        """Take a block in.

        Parameters
        ----------
        free : (p, e) array
            Orthonormal directions along which parameters may be corrected; along the others they
            stay, and so does what is known of them. Without any only the offsets are corrected:
            what stands still cannot be told from an offset.
        """
        heard = np.flatnonzero(block.heard)
        rows = np.zeros((len(heard), len(self.covariance)))
        rows[:, self._of_state] = block.by_state[heard]
        rows[:, self._of_parameters] = block.by_parameters[heard]
        rows[:, self._of_offsets] = np.eye(len(block.gap))[heard]
        gap, noise = block.gap[heard], block.error[heard] ** 2
        spread = rows @ self.covariance
        expected = spread @ rows.T
        surprise = _unexplained(gap, expected + np.diag(noise), spread[:, self._of_parameters])
        # a wild value counts as one that is OUTLIER_SIGMAS deviations off
        noise = np.maximum(noise, (gap / OUTLIER_SIGMAS) ** 2 - np.diag(expected))
        gain = np.linalg.solve(expected + np.diag(noise), spread).T
        p = self._of_parameters
        gain[p] = free @ (free.T @ gain[p])
        if not free.shape[1]:
            gain[self._of_state] = 0.0
        rest = self._identity - gain @ rows
        self.covariance = rest @ self.covariance @ rest.T + (gain * noise) @ gain.T
        change = gain @ gap
        return Correction(change[self._of_state], change[p], change[self._of_offsets], surprise)

    def go_on(self, transition: Array, by_parameters: Array, added: Array, drift: Array) -> None:
        """Bring the state to the block's end.

        Parameters
        ----------
        transition : (s, s) array
        by_parameters : (s, p) array
            Derivatives of the state at the end by the parameters, over the block.
        added : (s, s) array
            Covariance of what the model's error adds to the state.
        drift : (c,) array
            Deviation by which the offsets wander in a block.
        """
        of, p, b = self._of_state, self._of_parameters, self._of_offsets
        step = self._identity.copy()
        step[of, of], step[of, p] = transition, by_parameters
        self.covariance = step @ self.covariance @ step.T
        self.covariance[of, of] += added
        self.covariance[b, b] += np.diag(drift**2)
        self.covariance += self.covariance.T
        self.covariance *= 0.5


def _unexplained(gap: Array, expected: Array, by_parameters: Array) -> float:
    """Mean square of gaps (c,) of a covariance, orthogonal to the parameters' effect (c, p)."""
    factor = np.linalg.cholesky(expected)
    whole = np.linalg.solve(factor, np.column_stack([gap, by_parameters]))
    span, sizes, _ = np.linalg.svd(whole[:, 1:], full_matrices=False)
    span = span[:, sizes > 1e-9 * max(float(sizes[0]), 1e-300)]
    left = len(gap) - span.shape[1]
    if left == 0:
        return math.nan
    rest = whole[:, 0] - span @ (span.T @ whole[:, 0])
    return float(np.sum(rest**2)) / float(left)


class ExcitedDirections:
    """Directions of parameters whose effect on recent values exceeds the noise.

    Parameters
    ----------
    parameters : int
        p.
    """

    def __init__(self, parameters: int) -> None:
        self._information = np.zeros((parameters, parameters))

    def take(self, by_parameters: Array, noise: Array, duration: float) -> Array:
        """Take a block in; return orthonormal directions (p, e).

        Parameters
        ----------
        by_parameters : (c, p) array
            How the values change with the parameters, without what does not change with time.
        noise : (c,) array
            Deviations.
        duration : float
            Of the block [s].
        """
        rows = by_parameters / noise[:, None]
        share = -math.expm1(-duration / LATELY)
        self._information += share * (rows.T @ rows - self._information)
        values, vectors = np.linalg.eigh(self._information)
        return np.asarray(vectors[:, values > GATE**2])


# levels of the channels -------------------------------------------------------------------------

LEVEL = 5.0  # s, over which a level is taken
MOVEMENT = 2.0  # s, the same of movements about it
NOISE = 5.0  # s, the same of the noise
OUTLIER_SQUARES = 25.0  # times the usual square: more counts as so much
SECOND_DIFFERENCE = 6.0  # variance of x1 - 2 x2 + x3 of white noise of variance 1
ENOUGH = 6  # second differences until the noise is known


class ChannelLevels:
    """Levels of c channels and of their derivatives by p parameters; noise of their gaps.

    Noise is what second differences from block to block show: motion, even a wrong model's, is
    smoother than that.

    Parameters
    ----------
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
        rough = np.where(usual, np.minimum(rough, OUTLIER_SQUARES * self._rough), rough)
        share = np.maximum(-math.expm1(-duration / NOISE), 1.0 / np.maximum(self._seen, 1.0))
        self._rough[good] += (share * (rough - self._rough))[good]
