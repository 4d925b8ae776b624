"""Joint motion from samples at their own stamps: positions, rates, accelerations without delay.

Both ways look at samples before and after each stamp, so what they give is not late.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from denoc_ros.errors import StateError
from denoc_ros.types import Array, Flags

METHODS = ('filter', 'kalman')
DEGREE = 5  # of the local polynomials
GAP = 10.0  # usual times between samples: no polynomial reaches over a longer one
# of the largest eigenvalue of a window's normal matrix: with less its samples do not tell a degree
ILL = 1e-10
SETTLED_PERIODS = 8  # of the cutoff after which a smoother has forgotten an end of the samples


@dataclass(frozen=True)
class SmoothedMotion:
    """Joint motion at k stamps."""

    # (k, joints) rad or m, and per s, per s^2
    q: Array
    qd: Array
    qdd: Array


def smooth(
    t: Array,
    q: Array,
    qd: Array | None = None,
    method: str = 'filter',
    cutoff: float = 20.0,
    period: float | None = None,
) -> SmoothedMotion:
    """Return smoothed positions, rates and accelerations at the stamps.

    Parameters
    ----------
    t : (k,) array
        Stamps [s], rising; they need not be even.
    q : (k, joints) array
        Measured positions [rad, m].
    qd : (k, joints) array or None
        Measured rates.
    method : {'filter', 'kalman'}
        filter: polynomials of degree 5 fitted to the samples around each stamp (Savitzky and
        Golay's filter at the true stamps); rates and accelerations come from measured rates where
        there are, else from positions. kalman: a smoother (Rauch, Tung, Striebel) of a motion
        driven by white jerk, over positions and rates together.
    cutoff : float
        Frequency [Hz] above which motion counts as noise: half to 0.7 of the amplitude passes
        there.
    period : float, optional
        Usual time between samples [s]; default: the median here.

    Raises
    ------
    StateError
        For an unknown method or a cutoff that is not > 0.
    """
    if method not in METHODS:
        raise StateError(f'method must be one of {", ".join(METHODS)}, got {method!r}')
    if not (math.isfinite(cutoff) and cutoff > 0.0):
        raise StateError(f'cutoff must be > 0 Hz, got {cutoff}')
    if len(t) < 2:
        rest = np.zeros_like(q)
        return SmoothedMotion(q.copy(), rest if qd is None else qd.copy(), rest.copy())
    usual = float(np.median(np.diff(t))) if period is None else period
    if method == 'kalman':
        return _kalman(t, q, qd, cutoff, usual)
    smoothed = LocalPolynomials(t, cutoff, usual)
    if qd is None:
        return SmoothedMotion(*smoothed(q))
    joints = q.shape[1]
    value, slope, _ = smoothed(np.hstack([q, qd]))
    return SmoothedMotion(value[:, :joints], value[:, joints:], slope[:, joints:])


def settling(method: str, cutoff: float, period: float) -> int:
    """Return how many samples around a stamp matter to its smoothed motion.

    Parameters
    ----------
    method, cutoff
        As `smooth`.
    period : float
        Between samples [s].
    """
    if method == 'kalman':
        return math.ceil(SETTLED_PERIODS / (cutoff * period))
    return 2 * _half_width(cutoff, period)


def _half_width(cutoff: float, period: float) -> int:
    """Return the samples on each side of a window with this cutoff.

    From R. W. Schafer, What is a Savitzky-Golay filter?, IEEE Signal Processing Magazine 28
    (2011): f_c = (degree + 1) / (3.2 width - 4.6), in units of half the sampling rate; values and
    second derivatives of an odd degree are those of the even one below.
    """
    width = (0.5 * DEGREE / (cutoff * period) + 4.6) / 3.2
    return max(DEGREE // 2 + 1, math.ceil(width))


class LocalPolynomials:
    """The filter of `smooth` for samples at given stamps, worked out once for many of them.

    Parameters
    ----------
    t : (k,) array
        Stamps [s].
    cutoff : float
        [Hz]
    period : float
        Usual time between samples [s].
    """

    def __init__(self, t: Array, cutoff: float, period: float) -> None:
        self._rows, powers, self._scale = _windows(t, _half_width(cutoff, period), period)
        normal = np.swapaxes(powers, 1, 2) @ powers
        # powers that a window has too few samples for: their coefficients are 0
        degrees = np.arange(normal.shape[1])
        normal[:, degrees, degrees] += ~powers.any(axis=1)
        spread = np.linalg.eigvalsh(normal)
        is_told = spread[:, 0] > ILL * spread[:, -1]
        self._weights = np.zeros((len(t), 3, powers.shape[1]))
        kept = min(3, len(degrees))
        rows = np.linalg.solve(normal[is_told], np.eye(len(degrees))[:, :kept])
        self._weights[is_told, :kept] = np.swapaxes(powers[is_told] @ rows, 1, 2)
        self._weights[~is_told, :kept] = np.linalg.pinv(powers[~is_told], np.sqrt(ILL))[:, :kept]

    def __call__(self, y: Array) -> tuple[Array, Array, Array]:
        """Return samples y (k, joints) smoothed, and their first and second derivatives."""
        # about the first sample: large positions do not cost digits
        origin = y[self._rows[:, 0]]
        coefficients = self._weights @ (y[self._rows] - origin[:, None, :])
        return _derivatives(coefficients, origin, self._scale)

    def matrix(self, derivative: int) -> scipy.sparse.csr_array:
        """Return the filter (k, k) of samples near 0: 0 values, 1 first or 2 second derivatives.

        On many columns it takes a tenth of the time of a call.
        """
        weights = math.factorial(derivative) * self._weights[:, derivative]
        weights /= self._scale**derivative
        count, width = self._rows.shape
        edges = np.arange(count + 1) * width
        return scipy.sparse.csr_array(
            (weights.ravel(), self._rows.ravel(), edges), shape=(count, count)
        )


def stretch_starts(t: Array, period: float) -> Flags:
    """Return at which stamps (k,) a stretch begins: the first, and those behind a gap."""
    return np.concatenate([[True], np.diff(t) > GAP * period])


def _windows(t: Array, half: int, period: float) -> tuple[NDArray[np.int64], Array, Array]:
    """Return the samples around each stamp, the powers of their times in half widths, and these.

    Shapes are (k, width), (k, width, degree + 1) and (k, 1) [s]. No window reaches over a gap:
    powers are 0 of rows that fill a window up, and of degrees that it has too few samples for.
    """
    count = len(t)
    width = min(2 * half + 1, count)
    edges = np.append(np.flatnonzero(stretch_starts(t, period)), count)
    stretch = np.searchsorted(edges, np.arange(count), side='right') - 1
    begin, end = edges[stretch], edges[stretch + 1]
    own = np.minimum(width, end - begin)
    first = np.clip(np.arange(count) - width // 2, begin, end - own)
    rows = np.minimum(first[:, None] + np.arange(width), (end - 1)[:, None])
    scale = 0.5 * (t[first + own - 1] - t[first])[:, None]
    scale = np.where(own[:, None] > 1, scale, period)
    degrees = np.arange(min(DEGREE, width - 1) + 1)
    times = (t[rows] - t[:, None]) / scale
    powers = np.ones((*times.shape, len(degrees)))
    for degree in degrees[1:]:
        powers[..., degree] = powers[..., degree - 1] * times
    powers *= (np.arange(width) < own[:, None])[..., None] & (degrees < own[:, None, None])
    return rows, powers, scale


def _derivatives(coefficients: Array, origin: Array, scale: Array) -> tuple[Array, Array, Array]:
    """Return values, first and second derivatives of coefficients (k, 3, joints)."""
    return (
        coefficients[:, 0] + origin,
        coefficients[:, 1] / scale,
        2.0 * coefficients[:, 2] / scale**2,
    )


def _kalman(t: Array, q: Array, qd: Array | None, cutoff: float, period: float) -> SmoothedMotion:
    """Smooth by a Kalman filter forwards and Rauch, Tung and Striebel's recursion backwards.

    In time s = 2 pi cutoff t the state is [q, dq/ds, d2q/ds2], driven by white jerk. Positions
    have variance 1, and so have rates dq/ds; the jerk's intensity is the sampling period, so that
    positions alone are smoothed by 1 / (1 + (f / cutoff)^6) at any sampling rate.
    """
    unit = 2.0 * math.pi * cutoff
    intervals = np.diff(t) * unit
    jerk = period * unit
    count, joints = q.shape
    origin = q[0].copy()
    measured = [q - origin] if qd is None else [q - origin, qd / unit]
    state, before = np.zeros((2, count, 3, joints))
    spread, spread_before, transitions = np.zeros((3, count, 3, 3))
    x, p = np.zeros((3, joints)), 1e6 * np.eye(3)
    for k in range(count):
        if k:
            transitions[k], noise = _transition(intervals[k - 1], jerk)
            x = transitions[k] @ x
            p = transitions[k] @ p @ transitions[k].T + noise
        before[k], spread_before[k] = x, p
        for row, values in enumerate(measured):
            gain = p[:, row] / (p[row, row] + 1.0)
            x = x + np.outer(gain, values[k] - x[row])
            p = p - np.outer(gain, p[row])
        state[k], spread[k] = x, p
    for k in range(count - 2, -1, -1):
        back = np.linalg.solve(spread_before[k + 1], transitions[k + 1] @ spread[k]).T
        state[k] += back @ (state[k + 1] - before[k + 1])
    return SmoothedMotion(state[:, 0] + origin, state[:, 1] * unit, state[:, 2] * unit**2)


def _transition(h: float, jerk: float) -> tuple[Array, Array]:
    """Return the transition matrix over h and the covariance that white jerk adds."""
    transition = np.array([[1.0, h, 0.5 * h * h], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
    noise = jerk * np.array(
        [
            [h**5 / 20.0, h**4 / 8.0, h**3 / 6.0],
            [h**4 / 8.0, h**3 / 3.0, h**2 / 2.0],
            [h**3 / 6.0, h**2 / 2.0, h],
        ]
    )
    return transition, noise
