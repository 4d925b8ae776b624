"""Result of a fit of modes: values, intervals, verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from denoc_ros.types import Array

GOOD = 'good'
DOUBTFUL = 'doubtful'
NOT_IDENTIFIABLE = 'not identifiable'
WORST_FIRST = (NOT_IDENTIFIABLE, DOUBTFUL, GOOD)


def worst(verdicts: tuple[str, ...]) -> str:
    """Return the worst of the verdicts, `not identifiable` where there is none."""
    return next((word for word in WORST_FIRST if word in verdicts), NOT_IDENTIFIABLE)


def strongest(
    frequency: Array,
    strength: Array,
    band: tuple[float, float] = (0.0, np.inf),
    count: int | None = None,
) -> tuple[int, ...]:
    """Return which modes a verdict is of, strongest first.

    Parameters
    ----------
    frequency, strength : ndarray, shape (k,)
        [Hz]; what they are ordered by.
    band : (float, float)
        Frequencies that are asked for [Hz].
    count : int, optional
        How many are; default: all in a band that is narrower than everything, else one.
    """
    low, high = band
    inside = [int(k) for k in np.argsort(-strength) if low <= frequency[k] <= high]
    if count is None:
        count = 1 if (low <= 0.0 and high == np.inf) else len(inside)
    return tuple(inside[:count])


@dataclass(frozen=True, eq=False)
class AmplitudeCurve:
    """Damping of one mode over windows along its decay."""

    # (w,) middle of each window [s], on the record's clock, and the envelope there [record's unit]
    time: Array
    amplitude: Array
    frequency: Array  # (w,) undamped natural frequency in the window [Hz]
    # (w,) damping ratio in the window, and its standard deviation from noise alone
    damping_ratio: Array
    deviation: Array
    trend: float  # change of the damping ratio per e-fold of amplitude: > 0 if it grows with it
    dependent: bool  # the windows differ by more than noise explains


@dataclass(frozen=True)
class Line:
    """A component of the record that is no mode: a harmonic, a sum or a difference."""

    frequency: float  # [Hz]
    decay: float  # rate [1/s]
    amplitude: float  # at the start of the record [record's unit]
    origin: str  # of which modes, such as `2 x 1.85 Hz`


@dataclass(frozen=True, eq=False)
class Modes:
    """Modes of a free decay, by rising frequency.

    The record is y(t) = offset + drift (t - start) + sum of
    amplitude exp(-zeta w (t - start)) cos(w_d (t - start) + phase), with w = 2 pi frequency and
    w_d = w sqrt(1 - zeta^2), the lines likewise.

    Attributes
    ----------
    frequency : ndarray, shape (k,)
        Undamped natural frequencies [Hz].
    damping_ratio : ndarray, shape (k,)
        Damping ratios zeta.
    amplitude, phase : ndarray, shape (k,)
        At the start of the record [record's unit], [rad].
    interval : ndarray, shape (k, 2)
        95 % interval of zeta: the formal one where the windows of the record agree with each
        other, the window interval where they do not.
    formal_interval, window_interval : ndarray, shape (k, 2)
        95 % intervals of zeta from the fit's Jacobian and residual, and from the spread over
        windows of the record (nan where it has room for one window only).
    bound : ndarray, shape (k,)
        Cramer-Rao bound of zeta at the noise found: smallest possible standard deviation of an
        unbiased estimate, relative to zeta.
    frequency_deviation : ndarray, shape (k,)
        Standard deviation of the frequency [Hz]: the fit's, widened like that of zeta where the
        residual is coloured, and the spread over windows where noise does not explain it.
    snr_db : ndarray, shape (k,)
        Power of the mode at the start against that of the noise [dB].
    verdict : tuple of str
        `good`, `doubtful` or `not identifiable`, one per mode.
    reasons : tuple of tuple of str
        Why a verdict is not good, and what was noticed on the way.
    curves : tuple of AmplitudeCurve or None
        Damping ratio against amplitude; None where the decay has room for one window only.
    lines : tuple of Line
        Harmonics, sums and differences that were taken out of the modes.
    offset, drift, noise, start, stop : float
        Offset [unit], drift [unit/s], standard deviation of the residual [unit], span [s].
    remarks : tuple of str
        What concerns the whole record.
    """

    frequency: Array
    damping_ratio: Array
    amplitude: Array
    phase: Array
    interval: Array
    formal_interval: Array
    window_interval: Array
    bound: Array
    frequency_deviation: Array
    snr_db: Array
    verdict: tuple[str, ...]
    reasons: tuple[tuple[str, ...], ...]
    curves: tuple[AmplitudeCurve | None, ...]
    lines: tuple[Line, ...]
    offset: float
    drift: float
    noise: float
    start: float
    stop: float
    remarks: tuple[str, ...] = field(default=())

    @property
    def status(self) -> str:
        """Verdict on the record: its strongest mode's, `not identifiable` where there is none."""
        return self.status_of(strongest(self.frequency, self.energy))

    def status_of(self, asked: Sequence[int]) -> str:
        """Return the worst verdict of some modes, `not identifiable` where there is none."""
        return worst(tuple(self.verdict[k] for k in asked))

    @property
    def energy(self) -> Array:
        """Integral of each mode's square over the record, (k,): the measure of its strength."""
        rate = 2.0 * np.pi * self.frequency * self.damping_ratio
        span = self.stop - self.start
        small = np.abs(rate) * span < 1e-9
        fall = -np.expm1(-2.0 * rate * span) / np.where(small, 1.0, 2.0 * rate)
        return np.asarray(0.5 * self.amplitude**2 * np.where(small, span, fall))

    def component(self, k: int, t: Array) -> Array:
        """Return mode k alone at times t [s]."""
        rate = 2.0 * np.pi * self.frequency[k]
        zeta = self.damping_ratio[k]
        tau = np.asarray(t, float) - self.start
        turn = rate * np.sqrt(1.0 - zeta**2) * tau + self.phase[k]
        return np.asarray(self.amplitude[k] * np.exp(-zeta * rate * tau) * np.cos(turn))

    def prediction(self, t: Array) -> Array:
        """Return offset, drift and modes at times t [s] (lines left out)."""
        base = self.offset + self.drift * (np.asarray(t, float) - self.start)
        return np.asarray(base + sum(self.component(k, t) for k in range(self.frequency.size)))
