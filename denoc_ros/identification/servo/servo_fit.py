"""The servo of a position-controlled joint, from commanded and measured positions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy.optimize
import scipy.signal
from scipy.special import stdtrit

from denoc_ros.errors import IdentificationError
from denoc_ros.identification.decay.curves import NORMAL_95
from denoc_ros.identification.decay.modes import DOUBTFUL, GOOD, NOT_IDENTIFIABLE
from denoc_ros.types import Array

FEWEST = 50  # samples
SMALLEST = 1e-4  # rad or m that a joint must be told to move
SLOWEST, FASTEST = 0.1, 0.3  # Hz; share of the sampling rate
DAMPING = 0.05, 5.0
LONGEST_DELAY = 0.5  # s
WIDEST = 0.25  # relative standard deviation of a good value
WIDEST_DELAY = 0.25  # standard deviation of a good delay, of the lag's own time
MOST_UNEXPLAINED = 0.2  # of how far the joint was from its command
STARTS = 3  # of the search, the best of a grid
USUAL = np.log([2.0 * np.pi * 5.0, 0.8])  # of servos: angular frequency [rad/s], damping ratio
USUAL_SPREAD = np.array([1.0, 0.5])  # of their logarithms
USUAL_DELAY = 0.03  # s
MOST_EVALUATIONS = 40
STRETCHES = 24  # of all runs, within which residuals may hang together in any way
MOST_TOGETHER = 50.0  # samples that count as one, for the weight of what is usual
FULL_GAIN = 0.02  # from 1: the joint stops where it is told to
NAMES = ('bandwidth', 'damping', 'delay')

Run = tuple[Array, Array, Array]  # times in equal steps [s], commanded, measured [rad, m]


@dataclass(frozen=True, eq=False)
class ServoFit:
    """How one joint follows its commands."""

    joint: str
    # natural frequency [Hz] and damping ratio of a second-order lag, and a delay before it [s]
    bandwidth: float
    damping: float
    delay: float
    gain: float  # static gain: how far the joint goes, by how far it is told to
    # by how much the joint is late in a slow motion [s]: 2 damping / (2 pi bandwidth) + delay
    lag: float
    # dict of str to (2,) array: 95 % intervals of these five; they are positive
    interval: dict[str, Array]
    offset: float  # mean of measured minus commanded at rest [rad, m]
    distance: float  # how far the joint was from its command, rms [rad, m]
    residual: float  # how far it was from the fit, rms [rad, m]
    fitted: Array  # (k,) where the fit has the joint [rad, m], the runs one behind the other
    runs: int  # how many were fitted together
    verdict: str
    reasons: tuple[str, ...]


def fit_servo_runs(joint: str, runs: Sequence[Run]) -> ServoFit:
    """Fit a second-order lag with a delay and a static gain to a joint's commands and positions.

    Parameters
    ----------
    runs : sequence of (t, command, measured), each (k,)
        Times in equal steps [s], where the joint was told to be, and where it was [rad, m].

    Raises
    ------
    IdentificationError
        In every run fewer than `FEWEST` samples, or a command that stands still.

    Notes
    -----
    q'' / w^2 + 2 zeta q' / w + q = gain u(t - delay) + offset, integrated exactly for commands
    that are linear between samples; least squares on the position over log w, log zeta and the
    delay. The gain, and each run's offset and state at the start, are solved for linearly. A weak
    prior (a factor of e about 5 Hz, of e^0.5 about a damping ratio of 0.8, delays of 0.03 s) keeps
    apart what a slow motion does not tell apart. The deviations are the larger of those of white
    residuals and of residuals that hang together in any way within each of 24 stretches (Liang
    and Zeger, Biometrika 73, 1986); three or more runs show instead what differs between them.
    """
    moving = [run for run in runs if len(run[0]) >= FEWEST and np.ptp(run[1]) >= SMALLEST]
    if not moving:
        count = max((len(run[0]) for run in runs), default=0)
        moved = max((float(np.ptp(run[1])) for run in runs if len(run[1])), default=0.0)
        raise IdentificationError(
            f'{joint}: a servo needs {FEWEST} samples of a command that moves by {SMALLEST:g} rad '
            f'or m, got {count} of one that moves by {moved:.3g}'
        )
    model = _Model(moving)
    x = model.search(model.starts())
    alone = [_Model([run]).search([x]) for run in moving] if len(moving) > 2 else []
    white, together = model.covariances(x)
    spread = _Spread([white] if alone else [white, together], alone)
    omega, zeta, delay = float(np.exp(x[0])), float(np.exp(x[1])), float(x[2])
    gain, gain_deviation = model.gain(x)
    values = {
        'bandwidth': omega / (2.0 * np.pi),
        'damping': zeta,
        'delay': delay,
        'gain': gain,
        'lag': 2.0 * zeta / omega + delay,
    }
    slope = 2.0 * zeta / omega
    deviations = {
        'bandwidth': spread.of(np.array([1.0, 0.0, 0.0]), lambda at: at[0]),
        'damping': spread.of(np.array([0.0, 1.0, 0.0]), lambda at: at[1]),
        'delay': spread.of(np.array([0.0, 0.0, 1.0]), lambda at: at[2]),
        'gain': gain_deviation / max(abs(gain), 1e-9),
        'lag': spread.of(np.array([-slope, slope, 1.0]), _lag) / max(values['lag'], 1e-9),
    }
    residual = model.residual(x)
    measured = np.concatenate([run[2] for run in moving])
    distance = float(np.std(measured - np.concatenate([run[1] for run in moving])))
    left = float(np.sqrt(np.mean(residual**2)))
    verdict, reasons = _verdict(values, deviations, left, model.least_distance(x), x, model.bounds)
    return ServoFit(
        joint,
        **values,
        interval={name: _interval(name, values[name], deviations[name]) for name in values},
        offset=model.offset(x),
        distance=distance,
        residual=left,
        fitted=np.asarray(measured - residual),
        runs=len(moving),
        verdict=verdict,
        reasons=reasons,
    )


def _lag(x: Array) -> float:
    return float(2.0 * np.exp(x[1] - x[0]) + x[2])


def _interval(name: str, value: float, deviation: float) -> Array:
    """Return the 95 % interval (2,) of a positive number; deviations of delays are in seconds."""
    half = NORMAL_95 * deviation
    if name == 'delay':
        return np.array([max(value - half, 0.0), value + half])
    if value <= 0.0:  # a gain of a joint that goes the other way
        return np.array([value - half * abs(value), value + half * abs(value)])
    return np.asarray(value * np.exp([-half, half]))


class _Spread:
    """Standard deviations of functions of log w, log zeta and delay."""

    def __init__(self, covariances: Sequence[Array], alone: Sequence[Array]) -> None:
        self._covariances, self._alone = covariances, alone

    def of(self, slope: Array, value: Callable[[Array], float]) -> float:
        """Return the largest that residuals and the spread over runs say."""
        found = [np.sqrt(max(float(slope @ one @ slope), 0.0)) for one in self._covariances]
        if self._alone:
            values = np.array([value(one) for one in self._alone])
            count = values.size
            wide = float(stdtrit(count - 1, 0.975)) / NORMAL_95
            found.append(wide * values.std(ddof=1) / np.sqrt(count))
        return float(max(found))


class _Model:
    """Residuals by log w, log zeta and delay; linear parameters are eliminated."""

    def __init__(self, runs: Sequence[Run]) -> None:
        self._runs = [(t - t[0], told, was) for t, told, was in runs]
        step = max(float(t[-1]) / (len(t) - 1) for t, _, _ in self._runs)
        fastest = FASTEST / step
        slowest = min(SLOWEST, 0.5 * fastest)
        self._fastest = fastest
        self._longest = min(LONGEST_DELAY, 0.25 * min(float(t[-1]) for t, _, _ in self._runs))
        ends = np.log(2.0 * np.pi * np.array([slowest, fastest]))
        self.bounds = (
            np.array([ends[0], np.log(DAMPING[0]), 0.0]),
            np.array([ends[1], np.log(DAMPING[1]), self._longest]),
        )

    def starts(self) -> list[Array]:
        """Return the best of a grid."""
        frequencies = np.geomspace(min(0.5, 0.2 * self._fastest), 0.8 * self._fastest, 8)
        grid = [
            np.array([np.log(2.0 * np.pi * frequency), np.log(damping), delay * self._longest])
            for frequency, damping, delay in product(
                frequencies, (0.3, 0.7, 1.5), (0.002, 0.02, 0.1, 0.4)
            )
        ]
        return sorted(grid, key=lambda x: float(np.sum(self.residual(x) ** 2)))[:STARTS]

    def search(self, starts: Sequence[Array]) -> Array:
        """Return the most likely log w, log zeta and delay: first without, then with the prior."""
        found = [self._search(self.residual, start) for start in starts]
        first = min(found, key=lambda x: float(np.sum(self.residual(x) ** 2)))
        weight = self._prior_weight(self.residual(first))

        def with_prior(x: Array) -> Array:
            return np.append(self.residual(x), weight * (x[:2] - USUAL) / USUAL_SPREAD)

        return self._search(with_prior, first)

    def _search(self, residual: Callable[[Array], Array], start: Array) -> Array:
        lower, upper = self.bounds
        inside = np.clip(start, lower + 1e-9, upper - 1e-9)
        found = scipy.optimize.least_squares(
            residual,
            inside,
            bounds=(lower, upper),
            x_scale=(0.1, 0.1, 0.01),
            max_nfev=MOST_EVALUATIONS,
        )
        return np.asarray(found.x)

    def _prior_weight(self, residual: Array) -> float:
        """Return the standard deviation of a residual that counts as one sample."""
        power = float(residual @ residual)
        together = float(residual[1:] @ residual[:-1]) / power if power > 0.0 else 0.0
        together = min(max(together, 0.0), 0.999)
        samples = min((1.0 + together) / (1.0 - together), MOST_TOGETHER)
        return float(np.sqrt(samples * power / residual.size))

    def residual(self, x: Array) -> Array:
        """Return measured minus fitted (k,), the runs one behind the other."""
        forced, measured = self._projected(x)
        return np.asarray(measured - self._gain(forced, measured) * forced)

    def gain(self, x: Array) -> tuple[float, float]:
        """Return the static gain and its standard deviation."""
        forced, measured = self._projected(x)
        value = self._gain(forced, measured)
        residual = measured - value * forced
        power = max(float(forced @ forced), 1e-300)
        white = float(residual @ residual) / max(residual.size - 6, 1) / power
        parts = np.array_split(forced * residual, min(STRETCHES, residual.size))
        together = sum(float(part.sum()) ** 2 for part in parts) / power**2
        return value, float(np.sqrt(max(white, together)))

    def covariances(self, x: Array) -> tuple[Array, Array]:
        """Return covariances (3, 3) by white residuals, and by those of stretches."""
        residual = self.residual(x)
        steps = np.array([1e-4, 1e-4, 1e-5])
        jacobian = np.column_stack(
            [
                (self.residual(x + step) - self.residual(x - step)) / (2.0 * step.max())
                for step in np.diag(steps)
            ]
        )
        scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
        jacobian = jacobian / scale
        prior = np.diag(1.0 / np.append(USUAL_SPREAD, USUAL_DELAY) ** 2) / np.outer(scale, scale)
        variance = max(float(residual @ residual) / max(1, residual.size - 6), 1e-300)
        gram = jacobian.T @ jacobian
        stretches = np.array_split(np.arange(residual.size), min(STRETCHES, residual.size))
        slopes = np.array([jacobian[one].T @ residual[one] for one in stretches])
        scores = slopes.T @ slopes * len(stretches) / max(len(stretches) - 3, 1)
        white = np.linalg.pinv(gram / variance + prior)
        together = np.linalg.pinv(gram @ np.linalg.pinv(scores) @ gram + prior)
        both = np.outer(scale, scale)
        return np.asarray(white / both), np.asarray(together / both)

    def offset(self, x: Array) -> float:
        """Offset between command and position at rest, the mean over runs."""
        value = self.gain(x)[0]
        offsets = []
        for t, told, was in self._runs:
            forced, columns = self._parts(x, t, told)
            left = was - told[0] - value * forced
            offsets.append(float(np.linalg.lstsq(columns, left, rcond=None)[0][-1]))
        return float(np.mean(offsets))

    def least_distance(self, x: Array) -> float:
        """Return how far the joint was from its command without offset and gain, rms."""
        value = self.gain(x)[0]
        off = [was - value * told for _, told, was in self._runs]
        return float(np.sqrt(np.mean(np.concatenate([one - one.mean() for one in off]) ** 2)))

    @staticmethod
    def _gain(forced: Array, measured: Array) -> float:
        return float(forced @ measured) / max(float(forced @ forced), 1e-300)

    def _projected(self, x: Array) -> tuple[Array, Array]:
        """Return forced and measured motions (k,) without free motions and offsets of each run."""
        found = []
        for t, told, was in self._runs:
            forced, columns = self._parts(x, t, told)
            both = np.column_stack([forced, was - told[0]])
            size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
            basis, _ = np.linalg.qr(columns / size)
            found.append(both - basis @ (basis.T @ both))
        rows = np.vstack(found)
        return np.asarray(rows[:, 0]), np.asarray(rows[:, 1])

    @staticmethod
    def _parts(x: Array, t: Array, told: Array) -> tuple[Array, Array]:
        """Return the forced motion (k,) from the start on, free motions and an offset (k, 3)."""
        omega, zeta, delay = np.exp(x[0]), np.exp(x[1]), x[2]
        step = float(t[-1] / (len(t) - 1))
        lag = ([omega**2], [1.0, 2.0 * zeta * omega, omega**2])
        above, below, _ = scipy.signal.cont2discrete(lag, step, 'foh')
        late = np.interp(t - delay, t, told) - told[0]
        forced = scipy.signal.lfilter(np.ravel(above), below, late)
        first, second = np.zeros((2, len(late)))
        first[0] = second[min(1, len(late) - 1)] = 1.0
        free = [scipy.signal.lfilter([1.0], below, kick) for kick in (first, second)]
        return np.asarray(forced), np.column_stack([*free, np.ones(len(late))])


def _verdict(
    values: dict[str, float],
    deviations: dict[str, float],
    left: float,
    distance: float,
    x: Array,
    bounds: tuple[Array, Array],
) -> tuple[str, tuple[str, ...]]:
    if x[0] > bounds[1][0] - 0.01:
        return NOT_IDENTIFIABLE, (
            'the lag of the joint is too short for the samples: above '
            f'{values["bandwidth"]:.3g} Hz',
        )
    if values['gain'] <= 0.0 or deviations['gain'] > WIDEST:
        return NOT_IDENTIFIABLE, (f'the joint does not follow: static gain {values["gain"]:.2g}',)
    own = 1.0 / (2.0 * np.pi * values['bandwidth'])
    wide = [
        f'standard deviation of the {name} is {deviations[name]:.2g} s'
        if name == 'delay'
        else f'standard deviation of the {name} is {100.0 * deviations[name]:.0f} % of it'
        for name in NAMES
        if deviations[name] > (WIDEST_DELAY * own if name == 'delay' else WIDEST)
    ]
    if wide and deviations['lag'] > WIDEST:
        return NOT_IDENTIFIABLE, tuple(wide)
    reasons = []
    if wide:
        reasons.append(
            f'the motion tells the lag as a whole, {values["lag"]:.3g} s, not its parts: '
            f'{", ".join(wide)}; a faster start and a pause after it tell them'
        )
    if x[2] > bounds[1][2] - 1e-3:
        reasons.append(f'the delay is at its upper limit, {values["delay"]:.3g} s')
    if left > MOST_UNEXPLAINED * distance:
        reasons.append(
            f'{100.0 * left / max(distance, 1e-300):.0f} % of the lag is left unexplained'
        )
    verdict = DOUBTFUL if reasons else GOOD
    short = 1.0 - values['gain']
    if abs(short) > max(FULL_GAIN, NORMAL_95 * deviations['gain']):
        reasons.append(
            f'stops {100.0 * abs(short):.0f} % {"short of" if short > 0.0 else "beyond"} its '
            f'commands (static gain {values["gain"]:.3g}), which servo.* of the shaper does not '
            'have: scale its commands, or mend the servo'
        )
    return verdict, tuple(reasons)
