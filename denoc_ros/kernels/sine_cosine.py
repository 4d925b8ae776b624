"""Inlined sine and cosine: no call spills the registers, and several angles go at once."""

import numpy as np

from denoc_ros.kernels.compiled import inlined, ordered

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
