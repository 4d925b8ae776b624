"""Joint motions from rest to rest as splines with free coefficients."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline

from denoc_ros.types import Array

DEGREE = 5
ENDS = 4  # coefficients fixed at each end: position, velocity, acceleration and jerk 0


class RestBasis:
    """Quintic B-splines over a duration; velocity, acceleration and jerk are 0 at both ends.

    Parameters
    ----------
    duration : float
        s.
    segments : int
        Equal pieces, at least 6.

    Attributes
    ----------
    free : int
        Coefficients of each joint that are free.
    """

    def __init__(self, duration: float, segments: int) -> None:
        self.duration = float(duration)
        inner = np.linspace(0.0, self.duration, segments + 1)
        ends = np.full(DEGREE, self.duration)
        self._knots = np.concatenate((np.zeros(DEGREE), inner, ends))
        self._count = segments + DEGREE
        self.free = self._count - 2 * ENDS

    def design(self, times: ArrayLike, derivative: int = 0) -> Array:
        """Basis functions of the free coefficients at times (k,): (k, free); 0 outside."""
        return self._columns(times, derivative)[:, ENDS:-ENDS]

    def ends(self, start: Array, end: Array, times: ArrayLike, derivative: int = 0) -> Array:
        """Motion by the fixed coefficients at times (k,): (k, joints)."""
        columns = self._columns(times, derivative)
        first, last = columns[:, :ENDS].sum(axis=1), columns[:, -ENDS:].sum(axis=1)
        return np.asarray(np.outer(first, start) + np.outer(last, end))

    def rows(
        self, free: Array, start: Array, end: Array, times: ArrayLike, derivative: int = 0
    ) -> Array:
        """Return the motion (k, joints) of coefficients (free, joints), held outside."""
        return np.asarray(
            self.design(times, derivative) @ free + self.ends(start, end, times, derivative)
        )

    def _columns(self, times: ArrayLike, derivative: int) -> Array:
        moments = np.asarray(times, dtype=np.float64)
        inside = np.clip(moments, 0.0, self.duration)
        spline = BSpline(self._knots, np.eye(self._count), DEGREE)
        columns = np.array(spline(inside, derivative))
        if derivative:
            columns[inside != moments] = 0.0
        return columns
