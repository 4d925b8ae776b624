"""Decays with known truth and a bag's defects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from denoc_ros.identification.damped import columns
from denoc_ros.identification.records import Record
from denoc_ros.types import Array


@dataclass(frozen=True)
class Truth:
    """One mode of a synthetic decay.

    Attributes
    ----------
    frequency : float
        Undamped natural frequency [Hz].
    damping_ratio : float
        Below 1.
    amplitude, phase : float
        At the release [unit], [rad].
    """

    frequency: float
    damping_ratio: float
    amplitude: float = 1.0
    phase: float = 0.0

    @property
    def pole(self) -> tuple[float, float]:
        """Decay rate [1/s] and damped angular frequency [rad/s]."""
        omega = 2.0 * np.pi * self.frequency
        return self.damping_ratio * omega, omega * float(np.sqrt(1.0 - self.damping_ratio**2))


@dataclass(frozen=True)
class Defects:
    """Defects that a recording adds to a signal.

    Attributes
    ----------
    snr_db : float
        20 log10 of the largest value of the decay over the noise's standard deviation.
    offset, drift : float
        In parts of the largest value; the drift is that over the whole record.
    jitter : float
        Standard deviation of the stamps in parts of the sample time; the stamps say when.
    lost : float
        Part of the samples that is missing.
    lsb : float
        Resolution in parts of the largest value; 0: none.
    clip : float
        Part of the largest value (either side of the offset) that is cut off.
    """

    snr_db: float = 40.0
    offset: float = 0.0
    drift: float = 0.0
    jitter: float = 0.0
    lost: float = 0.0
    lsb: float = 0.0
    clip: float = 0.0


@dataclass(frozen=True, eq=False)
class Decay:
    """A synthetic record and its true parameters.

    Attributes
    ----------
    record : Record
    truth : tuple of Truth
        By rising frequency.
    bound : ndarray, shape (k,)
        Cramer-Rao bound of each damping ratio, relative to it: at the true poles and noise, at
        the samples that are there and not clipped, offset and drift unknown.
    """

    record: Record
    truth: tuple[Truth, ...]
    bound: Array


def synthetic_decay(
    modes: Sequence[Truth],
    rate: float,
    duration: float,
    defects: Defects = Defects(),
    seed: int | np.random.Generator = 0,
) -> Decay:
    """Return a free decay with known modes, as a bag would hold it.

    Parameters
    ----------
    modes : sequence of Truth
    rate, duration : float
        [Hz], [s]; the record starts at the release.
    defects : Defects
    seed : int or numpy Generator
    """
    draw = np.random.default_rng(seed)
    truth = tuple(sorted(modes, key=lambda mode: mode.frequency))
    t = _stamps(rate, duration, defects, draw)
    phi = columns(t, np.array([mode.pole for mode in truth]), duration)
    weights = np.array(
        [
            value
            for mode in truth
            for value in (
                mode.amplitude * np.cos(mode.phase),
                -mode.amplitude * np.sin(mode.phase),
            )
        ]
    )
    clean = phi[:, :-2] @ weights
    peak = float(np.abs(clean).max())
    noise = peak * 10.0 ** (-defects.snr_db / 20.0)
    y = clean + peak * (defects.offset + defects.drift * t / duration)
    y = y + noise * draw.standard_normal(t.size)
    if defects.lsb:
        lsb = peak * defects.lsb
        y = lsb * np.round(y / lsb)
    seen = np.ones(t.size, bool)
    if defects.clip:
        level = (1.0 - defects.clip) * peak
        low, high = peak * defects.offset - level, peak * defects.offset + level
        seen = (y > low) & (y < high)
        y = np.clip(y, low, high)
    bound = damping_bound(t[seen], truth, noise, duration)
    return Decay(Record(t, y, 'synthetic'), truth, bound)


def _stamps(rate: float, duration: float, defects: Defects, draw: np.random.Generator) -> Array:
    t = np.arange(int(duration * rate) + 1) / rate
    t = t + np.clip(defects.jitter * draw.standard_normal(t.size), -0.45, 0.45) / rate
    kept = draw.random(t.size) >= defects.lost
    return np.asarray(np.abs(t[kept]))


def damping_bound(t: Array, truth: Sequence[Truth], noise: float, span: float) -> Array:
    """Return the Cramer-Rao bounds of the damping ratios, relative to them, shape (k,).

    Parameters
    ----------
    t : ndarray
        Times from the release [s].
    truth : sequence of Truth
    noise : float
        Standard deviation of white Gaussian noise [unit].
    span : float
        What the drift is scaled by [s].
    """
    phi = columns(t, np.array([mode.pole for mode in truth]), span)
    slopes = []
    for k, mode in enumerate(truth):
        cosine, sine = phi[:, 2 * k], phi[:, 2 * k + 1]
        c, s = mode.amplitude * np.cos(mode.phase), mode.amplitude * np.sin(mode.phase)
        along, across = c * cosine - s * sine, c * sine + s * cosine
        omega = 2.0 * np.pi * mode.frequency
        zeta, damped = mode.damping_ratio, np.sqrt(1.0 - mode.damping_ratio**2)
        slopes += [
            omega * (-t * along + t * across * zeta / damped),
            -t * (zeta * along + damped * across),
        ]
    jacobian = np.column_stack((*slopes, phi))
    scale = np.linalg.norm(jacobian, axis=0)
    inverse = np.linalg.inv((jacobian / scale).T @ (jacobian / scale))
    deviation = noise * np.sqrt(np.diag(inverse)) / scale
    zetas = np.array([mode.damping_ratio for mode in truth])
    return np.asarray(deviation[: 2 * len(truth) : 2] / zetas)
