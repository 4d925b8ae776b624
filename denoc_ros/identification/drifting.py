"""One mode with drifting decay rate and frequency, compared with several steady modes."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from denoc_ros.types import Array

DEGREES = (2, 3, 4, 5, 6)


def drifting_rss(t: Array, own: Array, pole: Array, value: complex) -> list[tuple[int, float]]:
    """Fit Re exp(p(t)), p a complex polynomial, and return (parameters, rss) per degree.

    A damping ratio that depends on amplitude bends the logarithm of the envelope, and a stiffness
    that does bends the phase: neither makes it beat, as two modes do.

    Parameters
    ----------
    t, own : ndarray, shape (k,)
        Times from the start [s]; the record without its other components.
    pole : ndarray, shape (2,)
        Decay rate [1/s] and damped angular frequency [rad/s] of the one steady mode nearest.
    value : complex
        Its amplitude at the start.
    """
    x = t / t[-1]
    start = np.array([np.log(value), (-pole[0] + 1j * pole[1]) * t[-1]])
    found = []
    for degree in DEGREES:
        start = np.append(start, np.zeros(degree + 1 - start.size))
        start = _fitted(x, own, start)
        rest = own - np.exp(_exponent(x, start)).real
        found.append((2 * (degree + 1), float(rest @ rest)))
    return found


def _exponent(x: Array, coefficients: np.ndarray[tuple[int], np.dtype[np.complex128]]) -> Array:
    exponent = np.polynomial.polynomial.polyval(x, coefficients)
    return np.asarray(np.minimum(exponent.real, 50.0) + 1j * exponent.imag)


def _fitted(
    x: Array, own: Array, start: np.ndarray[tuple[int], np.dtype[np.complex128]]
) -> np.ndarray[tuple[int], np.dtype[np.complex128]]:
    powers = x[:, None] ** np.arange(start.size)

    def residuals(flat: Array) -> Array:
        return np.asarray(np.exp(_exponent(x, flat.view(complex))).real - own)

    def slopes(flat: Array) -> Array:
        grown = np.exp(_exponent(x, flat.view(complex)))[:, None] * powers
        out = np.empty((x.size, flat.size))
        out[:, ::2], out[:, 1::2] = grown.real, -grown.imag
        return out

    found = least_squares(
        residuals, start.view(float), jac=slopes, method='lm', x_scale='jac', max_nfev=60
    )
    return np.asarray(found.x.view(complex))
