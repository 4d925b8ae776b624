"""Transcendental frequency responses of uniform beams: exact in space, undamped, no truncation.

A beam EI y'''' = rho omega^2 y is written by Krylov's functions of z = beta^4 = -rho s^2 / EI,
which are entire in z and real where s^2 is: so numerators and denominators of every transfer
function are entire in s^2, and poles and zeros are sign changes along both axes of s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from denoc_ros.types import Array

Krylov = tuple[float, float, float, float]


def krylov(z: float, x: float) -> Krylov:
    """C_0 .. C_3 with C_k' = C_{k-1}, C_0' = z C_3 and C_k ~ x^k / k! at the root."""
    b = complex(z) ** 0.25
    if abs(b * x) < 1e-2:
        terms = [(z * x**4) ** j for j in range(3)]
        factorial = np.array([1.0, 24.0, 40320.0])
        shift = (
            np.array([1, 1, 1]), np.array([1, 5, 9]),
            np.array([2, 30, 90]), np.array([6, 210, 990]),
        )  # fmt: skip
        sums = [float(sum(terms / (factorial * s))) * x**k for k, s in enumerate(shift)]
        return sums[0], sums[1], sums[2], sums[3]
    c, s, ch, sh = np.cos(b * x), np.sin(b * x), np.cosh(b * x), np.sinh(b * x)
    values = (ch + c) / 2, (sh + s) / (2 * b), (ch - c) / (2 * b**2), (sh - s) / (2 * b**3)
    real = [float(v.real) for v in values]
    return real[0], real[1], real[2], real[3]


@dataclass(frozen=True)
class Beam:
    """A uniform beam with a point mass at its tip."""

    ei: float  # N m^2
    density: float  # kg/m
    length: float  # m
    tip_mass: float = 0.0  # kg

    def _state(self, s2: float) -> tuple[float, float, Krylov]:
        """z, the tip mass' inertia over EI, and Krylov's functions at the tip, at s^2."""
        z = -self.density * s2 / self.ei
        return z, self.tip_mass * s2 / self.ei, krylov(z, self.length)

    def clamped(self, s2: float) -> float:
        """Characteristic function with the root clamped."""
        z, m, (c0, c1, c2, c3) = self._state(s2)
        return c0 * (c0 - m * c3) - c1 * (z * c3 - m * c2)

    def tip_force_to_tip(self, s2: float) -> float:
        """Deflection of the tip per force there, root clamped [m/N], times `clamped`."""
        _z, _m, (c0, c1, c2, c3) = self._state(s2)
        return (c1 * c2 - c0 * c3) / self.ei

    def tip_force_to_curvature(self, s2: float, station: float) -> float:
        """Curvature at a station per force at the tip, root clamped, times `clamped`."""
        z, _m, (c0, c1, _c2, _c3) = self._state(s2)
        here = krylov(z, station)
        return (c1 * here[0] - c0 * here[1]) / self.ei


@dataclass(frozen=True)
class HubBeam(Beam):
    """The same beam on a hub that turns about its root, small angles."""

    hub: float = 0.0  # kg m^2

    def _shape(self, s2: float) -> tuple[float, float, float]:
        """`clamped`, and with it as a factor the root's curvature and its slope per hub angle."""
        z, m, (c0, c1, c2, c3) = self._state(s2)
        clamped = c0 * (c0 - m * c3) - c1 * (z * c3 - m * c2)
        bend = -(z * c3 * (c0 - m * c3) - c1 * (z * c2 - m * c1))
        shear = -(c0 * (z * c2 - m * c1) - (z * c3 - m * c2) * z * c3)
        return clamped, bend, shear

    def free(self, s2: float) -> float:
        """Characteristic function of hub and beam: the denominator of all that follows."""
        clamped, bend, _shear = self._shape(s2)
        return self.hub * s2 * clamped - self.ei * bend

    def to_hub(self, s2: float) -> float:
        """Hub angle per hub torque [rad/(N m)], times `free`."""
        return self._shape(s2)[0]

    def to_tip(self, s2: float) -> float:
        """Displacement of the tip across the undeformed beam per hub torque, times `free`."""
        clamped, bend, shear = self._shape(s2)
        _z, _m, (_c0, c1, c2, c3) = self._state(s2)
        return clamped * c1 + bend * c2 + shear * c3

    def to_curvature(self, s2: float, station: float) -> float:
        """Curvature at a station [1/m] per hub torque, times `free`."""
        z = -self.density * s2 / self.ei
        clamped, bend, shear = self._shape(s2)
        c0, c1, _c2, c3 = krylov(z, station)
        return clamped * z * c3 + bend * c0 + shear * c1


def roots(function: Callable[[float], float], count: int, step: float, sign: float) -> Array:
    """The lowest `count` sizes |s| > 0 of simple roots on one axis of s.

    sign -1: s = +- i omega, s^2 = -omega^2; sign 1: real pairs s = +- sigma. `step` [rad/s] is
    finer than roots lie apart.
    """
    found: list[float] = []
    low = 0.5 * step
    value = function(sign * low**2)
    while len(found) < count:
        high = low + step
        after = function(sign * high**2)
        if value * after < 0.0:
            root = brentq(lambda w: function(sign * w * w), low, high, xtol=1e-14, rtol=1e-14)
            found.append(float(root))
        low, value = high, after
    return np.array(found)
