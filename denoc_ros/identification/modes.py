"""What a fit of modes says: values, intervals, verdicts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from denoc_ros.identification.records import Floats

GOOD = 'good'
DOUBTFUL = 'doubtful'
NOT_IDENTIFIABLE = 'not identifiable'
WORST_FIRST = (NOT_IDENTIFIABLE, DOUBTFUL, GOOD)


def worst(verdicts: tuple[str, ...]) -> str:
    """Return the worst of the verdicts, `not identifiable` where there is none."""
    return next((word for word in WORST_FIRST if word in verdicts), NOT_IDENTIFIABLE)


@dataclass(frozen=True, eq=False)
class AmplitudeCurve:
    """Damping of one mode over windows along its decay.

    Attributes
    ----------
    time, amplitude : ndarray, shape (w,)
        Middle of each window [s], on the record's clock, and the envelope there [record's unit].
    frequency : ndarray, shape (w,)
        Undamped natural frequency in the window [Hz].
    damping_ratio, deviation : ndarray, shape (w,)
        Damping ratio in the window and its standard deviation from noise alone.
    trend : float
        Change of the damping ratio per e-fold of amplitude (positive: grows with amplitude).
    dependent : bool
        The windows differ by more than noise explains.
    """

    time: Floats
    amplitude: Floats
    frequency: Floats
    damping_ratio: Floats
    deviation: Floats
    trend: float
    dependent: bool


@dataclass(frozen=True)
class Line:
    """A component of the record that is no mode: a harmonic, a sum or a difference.

    Attributes
    ----------
    frequency : float
        [Hz]
    decay : float
        Decay rate [1/s].
    amplitude : float
        At the start of the record [record's unit].
    origin : str
        Of which modes, such as `2 x 1.85 Hz`.
    """

    frequency: float
    decay: float
    amplitude: float
    origin: str


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
        Standard deviation of the frequency [Hz].
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

    frequency: Floats
    damping_ratio: Floats
    amplitude: Floats
    phase: Floats
    interval: Floats
    formal_interval: Floats
    window_interval: Floats
    bound: Floats
    frequency_deviation: Floats
    snr_db: Floats
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
        """Verdict on the record: its worst mode's, `not identifiable` where there is none."""
        return worst(self.verdict)

    def component(self, k: int, t: Floats) -> Floats:
        """Return mode k alone at times t [s]."""
        rate = 2.0 * np.pi * self.frequency[k]
        zeta = self.damping_ratio[k]
        tau = np.asarray(t, float) - self.start
        turn = rate * np.sqrt(1.0 - zeta**2) * tau + self.phase[k]
        return np.asarray(self.amplitude[k] * np.exp(-zeta * rate * tau) * np.cos(turn))

    def prediction(self, t: Floats) -> Floats:
        """Return offset, drift and modes at times t [s] (lines left out)."""
        base = self.offset + self.drift * (np.asarray(t, float) - self.start)
        return np.asarray(base + sum(self.component(k, t) for k in range(self.frequency.size)))
