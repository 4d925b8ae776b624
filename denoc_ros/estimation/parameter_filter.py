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
WILD = 4.0  # deviations beyond which a value counts less, the more the farther


class BlockValues(NamedTuple):
    """Measurements of c channels over one block of time.

    Attributes
    ----------
    gap : (c,) array
        Measured minus predicted, the means over the block.
    by_state : (c, s) array
        Derivatives of the prediction by the state at the block's beginning.
    by_parameters : (c, p) array
        Derivatives by the parameters, over the block.
    error : (c,) array
        Deviation of the gap for a known state and known parameters.
    heard : (c,) bool array
        Which channels have values.
    """

    gap: Array
    by_state: Array
    by_parameters: Array
    error: Array
    heard: Flags


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
        block : BlockValues
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
        # a wild value counts as one that is WILD deviations off
        noise = np.maximum(noise, (gap / WILD) ** 2 - np.diag(expected))
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
