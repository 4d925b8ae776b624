"""Finite Fourier series of joints that begin and end at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from denoc_ros.types import Array

FEWEST = 3  # harmonics: fewer leave nothing free beside the rest at the ends


@dataclass(frozen=True)
class MotionRows:
    """A motion of k rows.

    Attributes
    ----------
    t : (k,) array
        [s]
    q, qd, qdd : (k, joints) arrays
        [rad, m], and per s, per s^2.
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array


class RestSeries:
    """Sums of s_k sin(k w t) + c_k (cos(k w t) - 1), w = 2 pi / duration, at rest at both ends.

    Velocity, acceleration and jerk are 0 at both ends, so that flexible links start without a
    jolt: sum k s_k = 0, sum k^3 s_k = 0, sum k^2 c_k = 0. The motion ends where it begins.

    Parameters
    ----------
    duration : float
        s.
    harmonics : int
        At least 3.

    Attributes
    ----------
    free : int
        Coefficients of each joint that are free: 2 harmonics - 3. Each alone has a peak velocity
        of 1 per s.

    Notes
    -----
    Finite Fourier series as excitation: J. Swevers et al., Optimal robot excitation and
    identification, IEEE Transactions on Robotics and Automation 13, 1997.
    """

    def __init__(self, duration: float, harmonics: int) -> None:
        self.duration = float(duration)
        self.harmonics = int(harmonics)
        self._order = np.arange(1, harmonics + 1, dtype=np.float64)
        self._omega = 2.0 * np.pi / self.duration
        k = self._order
        sines = scipy.linalg.null_space(np.array([k, k**3 / harmonics**2]))
        cosines = scipy.linalg.null_space(k[None, :] ** 2)
        self._basis = scipy.linalg.block_diag(sines, cosines)
        self.free = self._basis.shape[1]
        t = np.linspace(0.0, self.duration, 64 * harmonics + 1)
        self._basis = self._basis / np.abs(self.design(t, 1)).max(axis=0)

    def design(self, times: Array, derivative: int = 0) -> Array:
        """Basis functions of the free coefficients at times (k,) in [0, duration]: (k, free)."""
        angle = np.outer(times, self._order * self._omega)
        power = (self._order * self._omega) ** derivative
        turn = 0.5 * np.pi * derivative
        cosine = np.cos(angle + turn) - (1.0 if derivative == 0 else 0.0)
        waves = np.hstack([power * np.sin(angle + turn), power * cosine])
        columns: Array = waves @ self._basis
        return columns

    def coefficients(self, free: Array) -> tuple[Array, Array]:
        """Return s_k and c_k (harmonics, joints) of free coefficients (free, joints)."""
        both = self._basis @ free
        return both[: len(self._order)], both[len(self._order) :]

    def rows(self, free: Array, start: Array, times: Array) -> MotionRows:
        """Return the motion of free coefficients (free, joints) about a start (joints,)."""
        q, qd, qdd = (self.design(times, order) @ free for order in range(3))
        return MotionRows(times, q + start, qd, qdd)
