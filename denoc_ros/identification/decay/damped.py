"""Damped cosines, an offset and a drift fitted to samples: the linear part eliminated.

The model is y(t) = c + d t / T + sum of exp(-sigma t) (a cos w t + b sin w t). For given decay
rates sigma and damped frequencies w the rest is linear least squares; what is searched are the
pairs (sigma, w) only (variable projection, with Kaufman's Jacobian).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr
from scipy.optimize import least_squares

from denoc_ros.identification.decay.records import Mask
from denoc_ros.types import Array

LARGEST_EXPONENT = 30.0
LOCAL_LINES = 16
COLOURED = 0.5  # correlation of neighbouring residuals
NEAR = 1.5  # typical steps to the next sample: farther is a gap


@dataclass(frozen=True, eq=False)
class Damped:
    """A fit of m damped cosines."""

    poles: Array  # (m, 2) decay rate sigma [1/s] and damped angular frequency [rad/s] of each
    # (2 m + 2,) a and b of each, then offset and drift over the whole span (where there are such)
    weights: Array
    residual: Array  # (k,) measured minus fitted
    jacobian: Array  # (k, 2 m) of the fitted values by the poles, linear part eliminated
    span: float  # what the drift is scaled by [s]

    def prediction(self, t: Array) -> Array:
        """Return the fitted values at times t [s]."""
        base = self.weights.size > self.poles.size
        return np.asarray(columns(t, self.poles, self.span, base) @ self.weights)

    @property
    def rss(self) -> float:
        """Sum of squared residuals."""
        return float(self.residual @ self.residual)

    @property
    def variance(self) -> float:
        """Variance of the noise."""
        freedom = self.residual.size - self.weights.size - self.poles.size
        return self.rss / max(freedom, 1)

    @property
    def complex_amplitudes(self) -> NDComplex:
        """A - i b of each, shape (m,): the component is Re of it times exp((i w - sigma) t)."""
        pairs = self.weights[: 2 * len(self.poles)].reshape(-1, 2)
        return np.asarray(pairs[:, 0] - 1j * pairs[:, 1])

    def covariance(self) -> Array:
        """Return the covariance of the poles (row by row), shape (2 m, 2 m)."""
        scale = np.linalg.norm(self.jacobian, axis=0)
        scale[scale == 0.0] = 1.0
        gram = np.linalg.pinv((self.jacobian / scale).T @ (self.jacobian / scale))
        return np.asarray(self.variance * gram / np.outer(scale, scale))


NDComplex = np.ndarray[tuple[int], np.dtype[np.complex128]]


def columns(t: Array, poles: Array, span: float, base: bool = True) -> Array:
    """Return the linear part's columns, shape (k, 2 m + 2); (k, 2 m) without offset and drift.

    Each lies in one piece (Fortran's order): LAPACK takes them as they are.
    """
    m = len(poles)
    out = np.empty((t.size, 2 * m + 2 * base), order='F')
    for k, (sigma, omega) in enumerate(poles):
        decay = np.exp(np.clip(-sigma * t, -LARGEST_EXPONENT, LARGEST_EXPONENT))
        angle = omega * t
        np.multiply(decay, np.cos(angle), out=out[:, 2 * k])
        np.multiply(decay, np.sin(angle), out=out[:, 2 * k + 1])
    if base:
        out[:, -2] = 1.0
        out[:, -1] = t / span
    return out


class _Projection:
    """Residual and Jacobian at given poles; the last evaluation is kept."""

    def __init__(self, t: Array, y: Array, span: float, base: bool) -> None:
        self.t, self.y, self.span, self.base = t, y, span, base
        self.at: Array | None = None

    def evaluate(self, flat: Array) -> None:
        if self.at is not None and np.array_equal(flat, self.at):
            return
        self.at = flat.copy()
        poles = flat.reshape(-1, 2)
        phi = columns(self.t, poles, self.span, self.base)
        size = np.linalg.norm(phi, axis=0)
        size[size == 0.0] = 1.0
        basis, triangle = qr(phi / size, overwrite_a=True, mode='economic', check_finite=False)
        seen = basis.T @ self.y
        self.weights = np.linalg.lstsq(triangle, seen, rcond=1e-12)[0] / size
        self.residual = self.y - basis @ seen
        slopes = np.empty((self.t.size, flat.size), order='F')
        for k in range(len(poles)):
            a, b = self.weights[2 * k : 2 * k + 2]
            cosine, sine = phi[:, 2 * k], phi[:, 2 * k + 1]
            np.multiply(self.t, -a * cosine - b * sine, out=slopes[:, 2 * k])
            np.multiply(self.t, b * cosine - a * sine, out=slopes[:, 2 * k + 1])
        slopes -= basis @ (basis.T @ slopes)
        self.jacobian = slopes

    def residuals(self, flat: Array) -> Array:
        self.evaluate(flat)
        return np.asarray(self.residual)

    def slopes(self, flat: Array) -> Array:
        self.evaluate(flat)
        return np.asarray(-self.jacobian)


def fit_damped(
    t: Array,
    y: Array,
    start: Array,
    span: float | None = None,
    base: bool = True,
    rounds: int = 40,
) -> Damped:
    """Fit damped cosines, an offset and a drift.

    Parameters
    ----------
    t, y : ndarray, shape (k,)
        Times from the start of the decay [s], values.
    start : ndarray, shape (m, 2)
        First guess of the poles (sigma [1/s], w [rad/s]).
    span : float, optional
        What the drift is scaled by [s]; default the last time.
    """
    span = float(t[-1]) if span is None else span
    projection = _Projection(t, y, span, base)
    flat = np.asarray(start, float).reshape(-1)
    if flat.size:
        found = least_squares(
            projection.residuals,
            flat,
            jac=projection.slopes,
            method='lm',
            x_scale='jac',
            xtol=1e-9,
            ftol=1e-10,
            gtol=1e-12,
            max_nfev=rounds,
        )
        flat = found.x
    projection.evaluate(flat)
    return Damped(
        flat.reshape(-1, 2), projection.weights, projection.residual, projection.jacobian, span
    )


def neighbour_correlation(residual: Array) -> float:
    """Return the correlation of a residual with itself one sample on, 0 to below 1."""
    power = float(residual @ residual)
    if power == 0.0:
        return 0.0
    return float(np.clip(residual[1:] @ residual[:-1] / power, 0.0, 0.999))


def independent_samples(residual: Array) -> float:
    """Return how many independent samples a residual is worth (as a first-order process)."""
    correlation = neighbour_correlation(residual)
    return residual.size * (1.0 - correlation) / (1.0 + correlation)


def coloured(residual: Array) -> bool:
    """Say whether a residual hangs together: more than noise of the sensor is in it."""
    return neighbour_correlation(residual) > COLOURED


def even_values(t: Array, residual: Array, span: float) -> Array:
    """Return a residual at as many even times from 0 to span, 0 where samples are missing."""
    grid = np.linspace(0.0, span, t.size)
    return np.where(in_gap(t, grid), 0.0, np.interp(grid, t, residual))


def in_gap(t: Array, grid: Array) -> Mask:
    """Return which times (m,) of a grid are far from all stamps (k,)."""
    step = float(np.median(np.diff(t)))
    after = np.clip(np.searchsorted(t, grid), 1, t.size - 1)
    near = np.minimum(np.abs(grid - t[after - 1]), np.abs(t[after] - grid))
    return np.asarray(near > NEAR * step)


def local_variance(t: Array, residual: Array, span: float, sigma: float, omega: float) -> float:
    """Return the variance that white noise would have, were it as strong as near a pole.

    Parameters
    ----------
    t, residual : ndarray, shape (k,)
        Times from the start [s], what is left.
    span : float
        Duration of the record [s].
    sigma, omega : float
        Decay rate [1/s] and damped angular frequency [rad/s]: the lines within the mode's width,
        16 on either side at least, are averaged.
    """
    power = np.abs(np.fft.rfft(even_values(t, residual, span))) ** 2 / t.size
    middle = round(omega / (2.0 * np.pi) * span)
    width = LOCAL_LINES + int(abs(sigma) / np.pi * span)
    low = min(max(1, middle - width), power.size - 2)
    return float(np.mean(power[low : middle + width + 1]))
