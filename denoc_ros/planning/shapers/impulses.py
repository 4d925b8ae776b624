"""Input shapers: impulse sequences that leave a mode at rest (ZV, ZVD, EI)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.errors import StateError
from denoc_ros.types import Array

METHODS: Final = ('zv', 'zvd', 'ei')
TOLERATED_SWING = 0.05  # share of the unshaped swing that EI leaves at the modelled frequency


@dataclass(frozen=True)
class Impulses:
    """Impulses of which the sum is 1: a motion convolved with them ends where it would.

    Attributes
    ----------
    times : (m,) array
        s, the first 0, increasing.
    weights : (m,) array
    """

    times: Array
    weights: Array

    @property
    def delay(self) -> float:
        """How much later the shaped motion ends [s]."""
        return float(self.times[-1])

    def then(self, other: Impulses) -> Impulses:
        """Return the impulses of both, one after the other: their convolution."""
        times = np.add.outer(self.times, other.times).ravel()
        weights = np.multiply.outer(self.weights, other.weights).ravel()
        order = np.argsort(times, kind='stable')
        return Impulses(times[order], weights[order])

    def residual(self, frequency: ArrayLike, ratio: float = 0.0) -> Array:
        """Return the share |V| of the unshaped swing that is left in a mode.

        Parameters
        ----------
        frequency : scalar or array
            The mode's natural frequency [Hz], undamped.
        ratio : float
            Its damping ratio.

        Notes
        -----
        V = exp(-zeta omega t_m) sum_i A_i exp((zeta + i sqrt(1 - zeta^2)) omega t_i).
        """
        omega = 2.0 * np.pi * np.asarray(frequency, dtype=np.float64)[..., None]
        pole = ratio + 1j * np.sqrt(1.0 - ratio**2)
        terms = self.weights * np.exp(omega * (pole * self.times - ratio * self.delay))
        return np.asarray(np.abs(terms.sum(axis=-1)))


def damped_frequency(frequency: ArrayLike, ratio: ArrayLike) -> Array:
    """Return the frequency [Hz] at which a mode of a natural frequency [Hz] rings."""
    ratios = np.asarray(ratio, dtype=np.float64)
    return np.asarray(np.asarray(frequency, dtype=np.float64) * np.sqrt(1.0 - ratios**2))


def impulse_weights(method: str, ratio: float) -> Array:
    """Return the weights (m,) of impulses that are half a damped period apart.

    Parameters
    ----------
    method : str
        ``zv``: nothing is left at the modelled frequency. ``zvd``: and the residual has no slope
        there. ``ei``: at most `TOLERATED_SWING` is left over the widest band about it.
    ratio : float
        Damping ratio of the mode, 0 <= ratio < 1.

    Raises
    ------
    StateError
        For another method or ratio.

    Notes
    -----
    With K = exp(-pi zeta / sqrt(1 - zeta^2)): ZV has 1, K; ZVD 1, 2 K, K^2; EI
    (1 + v)/4, (1 - v)/2 K, (1 + v)/4 K^2, each over its sum, with v such that what is left at the
    modelled frequency is the tolerated share.
    """
    if method not in METHODS:
        raise StateError(f'shaper: method must be one of {", ".join(METHODS)}, got {method!r}')
    if not 0.0 <= ratio < 1.0:
        raise StateError(f'shaper: damping ratio must be >= 0 and < 1, got {ratio}')
    decay = float(np.exp(-np.pi * ratio / np.sqrt(1.0 - ratio**2)))
    if method == 'zv':
        weights = np.array([1.0, decay])
    elif method == 'zvd':
        weights = np.array([1.0, 2.0 * decay, decay**2])
    else:
        v = _undamped_share(decay)
        outer, middle = 0.25 * (1.0 + v), 0.5 * (1.0 - v)
        weights = np.array([outer, middle * decay, outer * decay**2])
    return np.asarray(weights / weights.sum())


def _undamped_share(decay: float) -> float:
    """Return v of EI's weights: K^2 v / sum(weights) is the tolerated share."""
    least = decay**2 - 0.25 * TOLERATED_SWING * (1.0 - decay) ** 2
    wanted = 0.25 * TOLERATED_SWING * (1.0 + decay) ** 2
    return wanted / least if wanted < least else 1.0


def shaper(method: str, frequency: float, ratio: float = 0.0) -> Impulses:
    """Return the impulses for one mode.

    Parameters
    ----------
    method : str
        ``zv``, ``zvd`` or ``ei`` (see :func:`impulse_weights`).
    frequency : float
        The mode's natural frequency [Hz], undamped.
    ratio : float
        Its damping ratio.

    Raises
    ------
    StateError
        For a frequency that is not > 0, another method or ratio.
    """
    if not (np.isfinite(frequency) and frequency > 0.0):
        raise StateError(f'shaper: frequency must be > 0 Hz, got {frequency}')
    weights = impulse_weights(method, ratio)
    half = 0.5 / float(damped_frequency(frequency, ratio))
    return Impulses(half * np.arange(float(len(weights))), weights)


def modes_shaper(method: str, frequencies: ArrayLike, ratios: ArrayLike) -> Impulses:
    """Return the impulses for several modes: the convolution of one shaper each.

    Parameters
    ----------
    method : str
    frequencies, ratios : (k,) arrays
        Natural frequencies [Hz] and damping ratios.
    """
    found = Impulses(np.zeros(1), np.ones(1))
    for frequency, ratio in zip(np.ravel(frequencies), np.ravel(ratios), strict=True):
        found = found.then(shaper(method, float(frequency), float(ratio)))
    return found
