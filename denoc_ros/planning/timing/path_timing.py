"""Timings of a path: the squared pace at stations, the time that passes, and its derivatives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.optimize
from scipy.interpolate import BSpline, make_interp_spline

from denoc_ros.types import Array

STATIONS = 121  # of a motion, at least
EACH = 4  # in a piece of its splines
LEAST = 1e-3  # of the largest: squared paces that count, and coefficients
SLOWEST = 0.03  # of the largest speed
DEGREE = 3  # of the splines of the squared pace: the motion has a continuous jerk


@dataclass(frozen=True)
class TimingBasis:
    """Squared pace x = (ds/dt)^2 = B c at stations s of a path, linear between them.

    Attributes
    ----------
    stations : (k,) array
        Increasing, from 0 on, in any unit.
    design : (k, p) array
        B.
    asked : (p,) array
        Coefficients of the motion as it was asked for: B asked = 1.

    Notes
    -----
    Torques of a rigid robot are linear in x and dx/ds, and the duration is convex in it
    (Verscheure et al., Time-Optimal Path Tracking for Robots, 2009).
    """

    stations: Array
    design: Array
    asked: Array

    @classmethod
    def spline(cls, length: float, speed: Callable[[Array], Array], pieces: int) -> TimingBasis:
        """Return cubic splines over a motion, which may pass its slow parts faster.

        Parameters
        ----------
        length : float
            Of the motion [s].
        speed : callable
            Takes moments (m,) of the motion [s], returns how fast the joints are (m,).
        pieces : int
            Of the splines.

        Notes
        -----
        From rest with a jump of the acceleration a motion whose own acceleration is continuous
        has x as 1 / sqrt(speed): the splines are divided by the one that is nearest to its root.
        """
        even = np.linspace(0.0, 1.0, max(STATIONS, EACH * pieces + 1))
        at = length * (0.5 * even + 0.25 * (1.0 - np.cos(np.pi * even)))
        knots = np.concatenate(
            [np.zeros(DEGREE), np.linspace(0.0, length, pieces + 1), np.full(DEGREE, length)]
        )
        fast = speed(at)
        slow = fast / max(float(fast.max()), 1e-300) + SLOWEST
        columns = BSpline(knots, np.eye(pieces + DEGREE), DEGREE)(at)
        asked, _ = scipy.optimize.nnls(columns, np.sqrt(slow))
        return cls(at, columns / (columns @ asked)[:, None], asked)

    @classmethod
    def linear(cls, stations: Array) -> TimingBasis:
        """Return a number for each station but the ends, where the pace is 0."""
        return cls(stations, np.eye(len(stations))[:, 1:-1], np.ones(len(stations) - 2))

    def nearest(self, square: Array) -> Array:
        """Return the coefficients (p,) of the timing nearest to squared paces (k,)."""
        weights = 1.0 / np.maximum(square, LEAST * square.max())
        found, _ = scipy.optimize.nnls(weights[:, None] * self.design, weights * square)
        return np.asarray(np.maximum(found, LEAST * found.max()))


class Timing:
    """The times at which a path's stations are passed.

    Parameters
    ----------
    basis : TimingBasis
    coefficients : (p,) array
        With B c > 0 between the ends.

    Attributes
    ----------
    t : (k,) array
        Of the stations [s].
    by_coefficients : (k, p) array
        Derivatives of `t`.
    duration : float
        s.

    Notes
    -----
    With x linear from station to station the time between is 2 ds / (sqrt x_1 + sqrt x_2).
    """

    def __init__(self, basis: TimingBasis, coefficients: Array) -> None:
        self.basis, self.coefficients = basis, coefficients
        pace = np.sqrt(np.maximum(basis.design @ coefficients, 0.0))
        apart, both = np.diff(basis.stations), pace[:-1] + pace[1:]
        self.t: Array = np.concatenate([[0.0], np.cumsum(2.0 * apart / both)])
        self.duration = float(self.t[-1])
        with np.errstate(divide='ignore'):
            slope = np.where(pace > 0.0, 0.5 / pace, 0.0)[:, None] * basis.design
        each = -(2.0 * apart / both**2)[:, None] * (slope[:-1] + slope[1:])
        self.by_coefficients: Array = np.concatenate(
            [np.zeros((1, each.shape[1])), np.cumsum(each, axis=0)]
        )
        self.pace = pace
        self._path = make_interp_spline(self.t, basis.stations, k=5)
        self._later = make_interp_spline(self.t, self.by_coefficients, k=3)

    def stations_at(self, times: Array) -> Array:
        """Return the stations (m,) that are passed at times (m,), the ends outside."""
        found = self._path(np.clip(times, 0.0, self.duration))
        return np.clip(np.asarray(found, dtype=np.float64), 0.0, self.basis.stations[-1])

    def times_at(self, stations: Array) -> Array:
        """Return when stations (m,) are passed."""
        found = make_interp_spline(self.basis.stations, self.t, k=5)(stations)
        return np.clip(np.asarray(found, dtype=np.float64), 0.0, self.duration)

    def pace_at(self, times: Array) -> Array:
        """Return how fast stations are passed at times (m,), at the ends' pace outside."""
        return np.asarray(self._path(np.clip(times, 0.0, self.duration), 1))

    def change_of_times(self, times: Array) -> Array:
        """Return the derivatives (m, p) of the moments that pass the stations of times (m,)."""
        at = np.clip(times, 0.0, self.duration)
        return np.asarray(self._later(at))
