"""Rotations: sine and cosine, the rotation of a rotation vector, unit quaternions.

Sine and cosine are inlined: no call spills the registers, and several angles go at once. Beside
the rotation of a rotation vector stand its left Jacobian, and the series of both near zero.
"""

import math

import numpy as np

from denoc_ros.kernels.algebra.vector import load
from denoc_ros.kernels.jit.compiled import inlined, kernel, ordered

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


@inlined
def quaternion_of(first, second, third):
    """Return x, y, z, w (w >= 0, or the first other > 0) of a rotation with these three rows.

    Of the columns of 4 q q^T that with the largest norm, which never divides by a small number.
    """
    a, e, i = first[0], second[1], third[2]
    w = 1.0 + a + e + i
    x, y, z = 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i
    xy, xz, yz = first[1] + second[0], first[2] + third[0], second[2] + third[1]
    xw, yw, zw = third[1] - second[2], first[2] - third[0], second[0] - first[1]
    if x >= y and x >= z and x >= w:
        column = x, xy, xz, xw
    elif y >= z and y >= w:
        column = xy, y, yz, yw
    elif z >= w:
        column = xz, yz, z, zw
    else:
        column = xw, yw, zw, w
    norm = np.sqrt(column[0] ** 2 + column[1] ** 2 + column[2] ** 2 + column[3] ** 2)
    scale = -1.0 / norm if column[3] < 0.0 else 1.0 / norm
    return scale * column[0], scale * column[1], scale * column[2], scale * column[3]


@inlined
def rotation_vector(turn, o):
    """Return the rotation vector, at most pi long, of the rotation row-major at offset o."""
    x, y, z, w = quaternion_of(load(turn, o), load(turn, o + 3), load(turn, o + 6))
    sine = np.sqrt(x * x + y * y + z * z)
    stretch = 2.0 * np.arctan2(sine, w) / sine if sine > 0.0 else 2.0
    return stretch * x, stretch * y, stretch * z


@kernel('void(float64[:, ::1], float64[::1])')
def write_quaternion(pose, out):
    """Write x, y, z, w of :func:`quaternion_of` of the rotation in a pose (3 or 4 rows)."""
    out[0], out[1], out[2], out[3] = quaternion_of(pose[0], pose[1], pose[2])


# pi/2 in three parts: products of the first with a whole number below 2^20 are exact
HALF_PI_1 = 1.5707963267341256
HALF_PI_2 = 6.0771005063039659e-11
HALF_PI_3 = 2.0222662487959506e-21
TWO_OVER_PI = 0.6366197723675814
FARTHEST = 1e6  # rad


@ordered
def near_sine(r):
    """Return the sine of |r| <= pi/4 (the polynomial of fdlibm)."""
    z = r * r
    p = -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10
    p = -1.98412698298579493134e-04 + z * (2.75573137070700676789e-06 + z * p)
    p = -1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * p)
    return r + r * z * p


@ordered
def near_cosine(r):
    """Return the cosine of |r| <= pi/4 (the polynomial of fdlibm)."""
    z = r * r
    p = 2.08757232129817482790e-09 - z * 1.13596475577881948265e-11
    p = 2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 + z * p)
    p = 4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * p)
    return 1.0 - z * (0.5 - z * p)


@ordered
def near_pair(x):
    """Return the sine and the cosine of |x| < FARTHEST to a unit in the last place or so."""
    quarters = np.rint(x * TWO_OVER_PI)
    r = ((x - quarters * HALF_PI_1) - quarters * HALF_PI_2) - quarters * HALF_PI_3
    s, c = near_sine(r), near_cosine(r)
    halves = np.floor(0.5 * quarters)
    odd = quarters - 2.0 * halves
    sign = 1.0 - 2.0 * (halves - 2.0 * np.floor(0.5 * halves))
    along, across = sign * (1.0 - odd), sign * odd
    return along * s + across * c, along * c - across * s


@inlined
def sine_cosine(x):
    """Return the sine and the cosine of x."""
    if abs(x) < FARTHEST:
        return near_pair(x)
    return np.sin(x), np.cos(x)


@inlined
def write_sines(q, n, sines, cosines):
    """Write the sines and cosines of n angles."""
    far = False
    for j in range(n):
        sines[j], cosines[j] = near_pair(q[j])
        far |= not abs(q[j]) < FARTHEST
    if far:
        for j in range(n):
            sines[j], cosines[j] = sine_cosine(q[j])
