"""Rotation of a rotation vector, its left Jacobian and their series near zero."""

import math

import numpy as np

from denoc_ros.kernels.compiled import inlined

# Taylor series in s: of b and c, and of twice their derivatives
SERIES_B = tuple((-1) ** k / math.factorial(2 * k + 2) for k in range(7))
SERIES_C = tuple((-1) ** k / math.factorial(2 * k + 3) for k in range(7))
SERIES_DB = tuple(2 * (k + 1) * SERIES_B[k + 1] for k in range(6))
SERIES_DC = tuple(2 * (k + 1) * SERIES_C[k + 1] for k in range(6))


@inlined
def six_terms(p, s):
    """Return the sum of p_k s^k, six of them."""
    return p[0] + s * (p[1] + s * (p[2] + s * (p[3] + s * (p[4] + s * p[5]))))


@inlined
def exponential_coefficients(s):
    """Return a, b, c and the rates of b and c per phi . phi', for s = |phi|^2.

    Exp phi = 1 + a K + b K^2, left Jacobian = 1 + b K + c K^2, K = phi x.
    """
    if s < 0.25:
        b = SERIES_B[0] + s * six_terms(SERIES_B[1:], s)
        c = SERIES_C[0] + s * six_terms(SERIES_C[1:], s)
        return 1.0 - s * c, b, c, six_terms(SERIES_DB, s), six_terms(SERIES_DC, s)
    t = np.sqrt(s)
    a = np.sin(t) / t
    b = (1.0 - np.cos(t)) / s
    c = (1.0 - a) / s
    return a, b, c, (a - 2.0 * b) / s, (b - 3.0 * c) / s


@inlined
def square_plus(a, b, phi, out, o):
    """Write 1 + a K + b K^2 with K = phi x, row-major, at offset o of out."""
    x, y, z = phi
    out[o] = 1.0 - b * (y * y + z * z)
    out[o + 1] = -a * z + b * x * y
    out[o + 2] = a * y + b * x * z
    out[o + 3] = a * z + b * x * y
    out[o + 4] = 1.0 - b * (x * x + z * z)
    out[o + 5] = -a * x + b * y * z
    out[o + 6] = -a * y + b * x * z
    out[o + 7] = a * x + b * y * z
    out[o + 8] = 1.0 - b * (x * x + y * y)
