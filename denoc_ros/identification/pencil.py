"""Matrix pencil: poles of a sum of damped cosines from evenly spaced samples."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import hankel, svd

from denoc_ros.types import Array

LONGEST = 600


def even_samples(t: Array, y: Array, step: float, count: int) -> Array:
    """Return y at t[0] + k step, k < count (cubic between the samples)."""
    grid = t[0] + step * np.arange(count)
    return np.asarray(CubicSpline(t, y)(np.minimum(grid, t[-1])))


def matrix_pencil(y: Array, step: float, order: int) -> Array:
    """Return poles of a decay (sigma [1/s], damped w [rad/s]), shape (m, 2), w > 0.

    Parameters
    ----------
    y : ndarray, shape (k,)
        Evenly spaced samples without their mean.
    step : float
        Between the samples [s].
    order : int
        Number of exponentials kept: twice that of the cosines, and what offset and drift take.

    Notes
    -----
    The eigenvalues of the pencil of the signal subspace of the samples' Hankel matrix and the same
    subspace one sample on are exp(s step) (Hua and Sarkar, IEEE Trans. ASSP 38, 1990).
    """
    rows = y.size // 2
    trajectory = hankel(y[:rows], y[rows - 1 :])
    subspace = svd(trajectory, full_matrices=False)[0][:, :order]
    steps = np.linalg.eigvals(np.linalg.pinv(subspace[:-1]) @ subspace[1:])
    s = np.log(np.where(np.abs(steps) < 1e-12, 1e-12, steps)) / step
    upper = s[s.imag > 0.0]
    return np.column_stack((-upper.real, upper.imag))


def pencil_poles(t: Array, y: Array, highest: float, cosines: int) -> Array:
    """Return poles of up to `cosines` damped cosines below `highest` [Hz], shape (m, 2).

    Long records are taken at the lowest rate that holds `highest`, and where that is not short
    enough from their beginning only.
    """
    span = float(t[-1] - t[0])
    step = max(span / (t.size - 1), 1.0 / (2.6 * highest))
    count = int(min(span / step, LONGEST)) + 1
    values = even_samples(t, y, step, count)
    return matrix_pencil(values - values.mean(), step, min(2 * cosines + 2, count // 3))
