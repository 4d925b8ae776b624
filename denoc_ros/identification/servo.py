"""The servo of a position-controlled joint, from commanded and measured positions."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy.optimize
import scipy.signal

from denoc_ros.errors import IdentificationError
from denoc_ros.identification.curves import NORMAL_95
from denoc_ros.identification.modes import DOUBTFUL, GOOD, NOT_IDENTIFIABLE
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
NAMES = ('bandwidth', 'damping', 'delay')


@dataclass(frozen=True, eq=False)
class ServoFit:
    """How one joint follows its commands.

    Attributes
    ----------
    joint : str
    bandwidth, damping, delay : float
        Natural frequency [Hz] and damping ratio of a second-order lag, and a delay before it [s].
    interval : dict of str to (2,) array
        95 % intervals.
    offset : float
        Mean of measured minus commanded at rest [rad, m].
    lag : float
        How far the joint was from its command, rms [rad, m].
    residual : float
        How far it was from the fit, rms [rad, m].
    fitted : (k,) array
        Where the fit has the joint [rad, m].
    verdict : str
    reasons : tuple of str
    """

    joint: str
    bandwidth: float
    damping: float
    delay: float
    interval: dict[str, Array]
    offset: float
    lag: float
    residual: float
    fitted: Array
    verdict: str
    reasons: tuple[str, ...]


def fit_servo(joint: str, t: Array, command: Array, measured: Array) -> ServoFit:
    """Fit a second-order lag with a delay to a joint's commands and positions.

    Parameters
    ----------
    joint : str
    t : (k,) array
        Times in equal steps [s].
    command, measured : (k,) arrays
        Where it was told to be, and where it was [rad, m].

    Raises
    ------
    IdentificationError
        Fewer than `FEWEST` samples, or a command that stands still.

    Notes
    -----
    q'' / w^2 + 2 zeta q' / w + q = u(t - delay) + offset, integrated exactly for commands that are
    linear between samples; least squares on the position, with the joint's state at the start and
    the offset solved for linearly. For the intervals, residuals that hang together count as fewer
    samples.
    """
    moved = float(np.ptp(command)) if len(command) else 0.0
    if len(t) < FEWEST or moved < SMALLEST:
        raise IdentificationError(
            f'{joint}: a servo needs {FEWEST} samples of a command that moves by {SMALLEST:g} rad '
            f'or m, got {len(t)} of one that moves by {moved:.3g}'
        )
    model = _Model(t, command, measured)
    lower, upper = model.bounds
    found = min(
        (
            scipy.optimize.least_squares(
                model.residual, start, bounds=(lower, upper), x_scale=(0.1, 0.1, 0.01)
            )
            for start in model.starts()
        ),
        key=lambda fit: float(fit.cost),
    )
    values = np.array([np.exp(found.x[0]) / (2.0 * np.pi), np.exp(found.x[1]), found.x[2]])
    residual = np.asarray(found.fun)
    spread = _spread(np.asarray(found.jac), residual)
    deviation = np.array([values[0] * spread[0], values[1] * spread[1], spread[2]])
    low, high = values - NORMAL_95 * deviation, values + NORMAL_95 * deviation
    off = measured - command
    lag = float(np.std(off))
    left = float(np.sqrt(np.mean(residual**2)))
    verdict, reasons = _verdict(values, deviation, left, lag, found.x, (lower, upper))
    return ServoFit(
        joint,
        float(values[0]),
        float(values[1]),
        float(values[2]),
        {name: np.array([low[k], high[k]]) for k, name in enumerate(NAMES)},
        model.offset(found.x),
        lag,
        left,
        np.asarray(measured - residual),
        verdict,
        reasons,
    )


class _Model:
    """Residuals by log w, log zeta and delay; what is linear is solved for."""

    def __init__(self, t: Array, command: Array, measured: Array) -> None:
        self._t = t - t[0]
        self._step = float(self._t[-1] / (len(t) - 1))
        self._command, self._measured = command, measured
        fastest = FASTEST / self._step
        slowest = min(SLOWEST, 0.5 * fastest)
        delay = min(LONGEST_DELAY, 0.25 * float(self._t[-1]))
        self._fastest, self._longest = fastest, delay
        ends = np.log(2.0 * np.pi * np.array([slowest, fastest]))
        self.bounds = (
            np.array([ends[0], np.log(DAMPING[0]), 0.0]),
            np.array([ends[1], np.log(DAMPING[1]), delay]),
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

    def residual(self, x: Array) -> Array:
        """Return measured minus fitted (k,)."""
        off, columns = self._parts(x)
        return np.asarray(off - columns @ np.linalg.lstsq(columns, off, rcond=None)[0])

    def offset(self, x: Array) -> float:
        """Return what is left of the command at rest."""
        off, columns = self._parts(x)
        return float(np.linalg.lstsq(columns, off, rcond=None)[0][-1])

    def _parts(self, x: Array) -> tuple[Array, Array]:
        """Return measured minus forced (k,), and the free motions and the offset (k, 3)."""
        omega, zeta, delay = np.exp(x[0]), np.exp(x[1]), x[2]
        lag = ([omega**2], [1.0, 2.0 * zeta * omega, omega**2])
        above, below, _ = scipy.signal.cont2discrete(lag, self._step, 'foh')
        start = self._command[0]
        late = np.interp(self._t - delay, self._t, self._command) - start
        forced = start + scipy.signal.lfilter(np.ravel(above), below, late)
        first, second = np.zeros((2, len(late)))
        first[0] = second[min(1, len(late) - 1)] = 1.0
        free = [scipy.signal.lfilter([1.0], below, kick) for kick in (first, second)]
        columns = np.column_stack([*free, np.ones(len(late))])
        return np.asarray(self._measured - forced), columns


def _spread(jacobian: Array, residual: Array) -> Array:
    """Return the standard deviations (3,), residuals that hang together counted as fewer."""
    variance = float(residual @ residual) / max(1, len(residual) - 6)
    together = 0.0
    if variance > 0.0:
        together = float(residual[1:] @ residual[:-1]) / float(residual @ residual)
    together = min(max(together, 0.0), 0.999)
    inflation = (1.0 + together) / (1.0 - together)
    covariance = variance * inflation * np.linalg.pinv(jacobian.T @ jacobian)
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)))


def _verdict(
    values: Array,
    deviation: Array,
    left: float,
    lag: float,
    x: Array,
    bounds: tuple[Array, Array],
) -> tuple[str, tuple[str, ...]]:
    reasons = []
    if x[0] > bounds[1][0] - 0.01:
        return NOT_IDENTIFIABLE, (
            f'the lag of the joint is too short for the samples: above {values[0]:.3g} Hz',
        )
    own = 1.0 / (2.0 * np.pi * values[0])
    for k, name in enumerate(NAMES):
        size, widest = (own, WIDEST_DELAY) if name == 'delay' else (values[k], WIDEST)
        if deviation[k] > widest * size:
            reasons.append(f'standard deviation of the {name} is {deviation[k]:.2g}')
    if reasons:
        return NOT_IDENTIFIABLE, tuple(reasons)
    if x[2] > bounds[1][2] - 1e-3:
        reasons.append(f'the delay is at its upper limit, {values[2]:.3g} s')
    if left > MOST_UNEXPLAINED * lag:
        reasons.append(f'{100.0 * left / max(lag, 1e-300):.0f} % of the lag is left unexplained')
    return (DOUBTFUL if reasons else GOOD), tuple(reasons)
