"""Joint motion from measurements, smoothed according to their own noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from denoc_ros.estimation.joint_motion import LocalPolynomials, SmoothedMotion, smooth
from denoc_ros.identification.model.robust import noise_of, without_spikes
from denoc_ros.types import Array, Flags

FINEST = 0.3  # of the sampling rate: the cutoff of smoothing, as high as it goes
STEPS = 0.7 ** np.arange(8)  # cutoffs that are tried, in terms of the finest
STILL = 6.0  # deviations of its noise within which a joint that stands still is seen
FEWEST = 20  # samples that tell noise from motion


@dataclass(frozen=True)
class MeasuredMotion:
    """Motion of the joints, and the noise of its measurement.

    Attributes
    ----------
    motion : SmoothedMotion
    position_noise, velocity_noise : (joints,) array
        Standard deviations of what was measured [rad, m] and [rad/s, m/s].
    cutoffs : (2, joints) array
        Of the smoothing of positions and rates [Hz]; 0 where rates were not measured.
    period : float
        Usual time between samples [s].
    smoothers : dict of float to LocalPolynomials
        Of the stamps, by cutoff.
    """

    motion: SmoothedMotion
    position_noise: Array
    velocity_noise: Array
    cutoffs: Array
    period: float
    smoothers: Mapping[float, LocalPolynomials]

    def disturbed(self, draw: np.random.Generator, times: float = 1.0) -> SmoothedMotion:
        """Return the motion with noise of this size once more on top.

        `times` as large; -1 is the same noise with the other sign.
        """
        own, shape = self.motion, self.motion.q.shape
        position = times * self.position_noise * draw.standard_normal(shape)
        velocity = times * self.velocity_noise * draw.standard_normal(shape)
        measured = bool((self.cutoffs[1] > 0.0).any())
        given = velocity if measured else None
        more = _smoothed(position, given, self.cutoffs, self.smoothers)
        return SmoothedMotion(own.q + more.q, own.qd + more.qd, own.qdd + more.qdd)


def measured_motion(t: Array, position: Array, velocity: Array | None) -> MeasuredMotion:
    """Return smoothed joint motion.

    Parameters
    ----------
    t : (k,) array
        Stamps [s].
    position : (k, joints) array
    velocity : (k, joints) array or None

    Notes
    -----
    Each signal's cutoff is one step above that of generalized cross-validation, with which the
    samples' prediction by their neighbours is best (P. Craven, G. Wahba, Numerische Mathematik 31,
    1979): what is cut off there is as large as what is left of the noise, and of no known sign.
    A joint that shows noise alone stands still: it has neither rates nor noise that drives links,
    and its friction makes no torque that is known.
    """
    period = float(np.median(np.diff(t)))
    tried: Array = np.asarray(FINEST / period * STEPS, dtype=np.float64)
    position = without_spikes(position)
    velocity = None if velocity is None else without_spikes(velocity)
    signals = [position, velocity]
    cutoffs: Array = np.zeros((2, position.shape[1]))
    noise: Array = np.zeros((2, position.shape[1]))
    for row, values in enumerate(signals):
        if values is not None:
            cutoffs[row], noise[row] = _chosen(t, values, tried, period)
    still = np.all([_is_noise(values) for values in signals if values is not None], axis=0)
    position = np.where(still, np.median(position, axis=0), position)
    velocity = None if velocity is None else np.where(still, 0.0, velocity)
    noise[:, still] = 0.0
    smoothers = {
        float(cutoff): LocalPolynomials(t, float(cutoff), period)
        for cutoff in np.unique(cutoffs[cutoffs > 0.0])
    }
    motion = _smoothed(position, velocity, cutoffs, smoothers)
    return MeasuredMotion(motion, noise[0], noise[1], cutoffs, period, smoothers)


def _smoothed(
    position: Array,
    velocity: Array | None,
    cutoffs: Array,
    smoothers: Mapping[float, LocalPolynomials],
) -> SmoothedMotion:
    q, qd, qdd = (np.empty(position.shape) for _ in range(3))
    for cutoff, smoothed in smoothers.items():
        own, rates = cutoffs == cutoff
        if own.any():
            q[:, own], slope, bend = smoothed(position[:, own])
            if velocity is None:
                qd[:, own], qdd[:, own] = slope, bend
        if velocity is not None and rates.any():
            qd[:, rates], qdd[:, rates], _ = smoothed(velocity[:, rates])
    return SmoothedMotion(q, qd, qdd)


def _chosen(t: Array, values: Array, tried: Array, period: float) -> tuple[Array, Array]:
    """Return the cutoff and the noise of each column (joints,)."""
    scores, noises = np.empty((2, len(tried), values.shape[1]))
    for row, cutoff in enumerate(tried):
        left = values - smooth(t, values, cutoff=cutoff, period=period).q
        kept = 1.0 - own_weight(len(t), cutoff, period)
        square = np.mean(left**2, axis=0)
        scores[row], noises[row] = square / kept**2, np.sqrt(square / kept)
    best = np.argmin(scores, axis=0)
    columns = np.arange(values.shape[1])
    return tried[np.maximum(best - 1, 0)], noises[best, columns]


def _is_noise(values: Array) -> Flags:
    """Return which columns (joints,) show white noise about a constant and nothing else."""
    if len(values) < FEWEST:
        return np.zeros(values.shape[1], dtype=bool)
    apart = np.abs(values - np.median(values, axis=0))
    white = np.array([noise_of(column, 1.0) for column in values.T])
    return np.asarray((apart <= STILL * white).all(axis=0))


def own_weight(count: int, cutoff: float, period: float) -> float:
    """Return how much a sample counts in its own smoothed value."""
    size = min(count, 401)
    stamps: Array = period * np.arange(size, dtype=np.float64)
    impulse: Array = np.zeros((size, 1))
    impulse[size // 2] = 1.0
    return float(smooth(stamps, impulse, cutoff=cutoff, period=period).q[size // 2, 0])
