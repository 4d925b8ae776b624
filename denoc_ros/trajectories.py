"""Desired motions of joints: the book's, sines, and C2 splines of points; exact derivatives.

Every trajectory starts at t = 0 of its own time and holds: before it its start, after it its end.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np
import scipy.linalg

from denoc_ros.kernels.algebra.spline import sample_quintics
from denoc_ros.kernels.jit.compiled import entry
from denoc_ros.types import Array

KNOTS = ('times', 'q', 'qd', 'qdd')  # names of the arrays that make a spline again


class Trajectory(ABC):
    """Positions, velocities and accelerations of n joints over time.

    Attributes
    ----------
    n : int
        Number of joints.
    duration : float
        s; from then on it holds.
    """

    def __init__(self, n: int, duration: float) -> None:
        self.n = n
        self.duration = duration

    @abstractmethod
    def _inside(self, t: float, q: Array, qd: Array, qdd: Array) -> None:
        """Sample at 0 <= t <= duration."""

    def sample(self, t: float, q: Array, qd: Array, qdd: Array) -> None:
        """Write the motion at time `t` [s] into (n,) arrays.

        Parameters
        ----------
        t : float
            s since the start.
        q, qd, qdd : (n,) array
            Output: rad or m, and per s, per s^2.
        """
        if 0.0 <= t < self.duration:
            self._inside(t, q, qd, qdd)
            return
        self._inside(0.0 if t < 0.0 else self.duration, q, qd, qdd)
        qd[:] = 0.0
        qdd[:] = 0.0

    def table(self, step: float) -> tuple[Array, Array, Array, Array]:
        """Return times (k,), positions, velocities, accelerations (k, n), `step` s or less apart.

        The last row is at the duration, with what the motion has there; holding begins after it.
        """
        k = max(1, math.ceil(self.duration / step - 1e-9)) + 1
        times = np.linspace(0.0, self.duration, k)
        return times, *self.rows(times)

    def rows(self, times: Array) -> tuple[Array, Array, Array]:
        """Return positions, velocities, accelerations (k, n) at times (k,) [s] within it."""
        q, qd, qdd = np.zeros((3, len(times), self.n))
        for row, t in enumerate(times):
            self._inside(float(t), q[row], qd[row], qdd[row])
        return q, qd, qdd


class CycloidalTrajectory(Trajectory):
    """The book's point-to-point motion, joint by joint.

    Parameters
    ----------
    start : (n,) array
        rad or m.
    rate : (n,) array
        k, the mean rate [rad/s or m/s].
    period : (n,) array
        T [s].
    form : {'full', 'half'}
        full: q = k (t - T/(2 pi) sin(2 pi t/T)), at rest at t = T (eqs. 4.1, 4.2 and the like);
        half: q = k (t - T/pi sin(pi t/T)), at rest at t = 2 T (eq. 3.56).
    duration : float, optional
        s; default the longest time to rest. The formula goes on to there in every joint.
    """

    def __init__(
        self,
        start: Array,
        rate: Array,
        period: Array,
        form: str = 'full',
        duration: float | None = None,
    ) -> None:
        self._start, self._rate = np.asarray(start, float), np.asarray(rate, float)
        to_rest = np.asarray(period, float) * (2.0 if form == 'half' else 1.0)
        self._omega = 2.0 * np.pi / to_rest
        super().__init__(len(self._start), float(to_rest.max()) if duration is None else duration)

    def _inside(self, t: float, q: Array, qd: Array, qdd: Array) -> None:
        angle = self._omega * t
        sine, cosine = np.sin(angle), np.cos(angle)
        q[:] = self._start + self._rate * (t - sine / self._omega)
        qd[:] = self._rate * (1.0 - cosine)
        qdd[:] = self._rate * self._omega * sine


class SineTrajectory(Trajectory):
    """Sines about a posture that swell from rest and die down to rest.

    q = start + e(t) amplitude sin(2 pi frequency t + phase), with the envelope e a quintic step
    over `ramp` at either end, so that position, velocity and acceleration are continuous.

    Parameters
    ----------
    start, amplitude : (n,) array
        rad or m.
    frequency, phase : (n,) array
        Hz, rad.
    duration : float
        s.
    ramp : float, optional
        s; default a quarter of the duration.
    """

    def __init__(
        self,
        start: Array,
        amplitude: Array,
        frequency: Array,
        phase: Array,
        duration: float,
        ramp: float | None = None,
    ) -> None:
        self._start, self._amplitude = np.asarray(start, float), np.asarray(amplitude, float)
        self._omega = 2.0 * np.pi * np.asarray(frequency, float)
        self._phase = np.asarray(phase, float)
        self._ramp = min(0.25 * duration if ramp is None else ramp, 0.5 * duration)
        super().__init__(len(self._start), duration)

    def _envelope(self, t: float) -> tuple[float, float, float]:
        """Return e, its rate and its second derivative."""
        falling = t > 0.5 * self.duration
        s = min(1.0, (self.duration - t if falling else t) / self._ramp)
        rate = 30.0 * s * s * (1.0 - s) ** 2 / self._ramp
        second = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / self._ramp**2
        return s**3 * (10.0 - 15.0 * s + 6.0 * s * s), -rate if falling else rate, second

    def _inside(self, t: float, q: Array, qd: Array, qdd: Array) -> None:
        e, ed, edd = self._envelope(t)
        angle = self._omega * t + self._phase
        sine, cosine = self._amplitude * np.sin(angle), self._amplitude * np.cos(angle)
        w = self._omega
        q[:] = self._start + e * sine
        qd[:] = ed * sine + e * w * cosine
        qdd[:] = edd * sine + 2.0 * ed * w * cosine - e * w * w * sine


class SplineTrajectory(Trajectory):
    """A C2 spline through points: quintic between knots with position, velocity, acceleration.

    Missing velocities and accelerations are those of the cubic C2 spline through the positions
    that starts and ends at rest; missing accelerations beside given velocities are the mean of
    what the cubics on either side of a knot have there.

    Parameters
    ----------
    times : (k,) array
        s, increasing.
    positions : (k, n) array
        rad or m.
    velocities, accelerations : (k, n) array, optional
        rad/s, rad/s^2 or m/s, m/s^2.
    start : tuple of (n,) arrays, optional
        Position, velocity, acceleration at t = 0 from which to go to a first point later than 0;
        default the first point, at rest.
    """

    def __init__(
        self,
        times: Array,
        positions: Array,
        velocities: Array | None = None,
        accelerations: Array | None = None,
        start: tuple[Array, Array, Array] | None = None,
    ) -> None:
        times, q = np.asarray(times, float), np.asarray(positions, float)
        qd, qdd, initial_rate = velocities, accelerations, np.zeros(q.shape[1])
        begins_in_motion = times[0] > 0.0
        if begins_in_motion:
            first = start or (q[0], np.zeros(q.shape[1]), np.zeros(q.shape[1]))
            times, q = np.concatenate(([0.0], times)), np.vstack((first[0], q))
            qd = None if qd is None else np.vstack((first[1], qd))
            qdd = None if qdd is None else np.vstack((first[2], qdd))
            initial_rate = first[1]
        super().__init__(q.shape[1], float(times[-1]))
        if len(times) == 1:  # a posture: one flat piece
            times, q, qd, qdd = np.array([0.0, 1.0]), np.vstack((q, q)), None, None
        if qd is None:
            qd = _spline_rates(times, q, initial_rate)
        if qdd is None:
            qdd = _knot_accelerations(times, q, qd)
            if begins_in_motion and start is not None:
                qdd[0] = start[2]
        self._times: Array = np.array(times, dtype=np.float64)
        self._pieces = _quintics(times, q, qd, qdd)
        rates = np.zeros_like(self._pieces)
        rates[:, :-1] = self._pieces[:, 1:] * np.arange(1.0, 6.0)[:, None]
        bends = np.zeros_like(rates)
        bends[:, :-1] = rates[:, 1:] * np.arange(1.0, 6.0)[:, None]
        # position, velocity and acceleration by the powers of the time: one call for all
        motion = np.concatenate((self._pieces, rates, bends), axis=2)
        self._motion = np.ascontiguousarray(motion)  # of columns it is not
        self._sample = entry(sample_quintics)
        self._result = np.zeros(3 * self.n)
        # views of it
        self._position, self._rate, self._acceleration = self._result.reshape(3, self.n)

    def knots(self) -> tuple[Array, Array, Array, Array]:
        """Return times (k,) and position, velocity, acceleration (k, n) of the same spline."""
        times, pieces = self._times, self._pieces
        last = times[-1] - times[-2]
        powers = last ** np.arange(6.0)
        order = np.arange(6)
        rate = np.where(order > 0, order * last ** np.maximum(order - 1.0, 0.0), 0.0)
        bend = order * (order - 1) * last ** np.maximum(order - 2.0, 0.0)
        ends = [np.asarray(row @ pieces[-1]) for row in (powers, rate, bend)]
        rows = pieces[:, 0], pieces[:, 1], 2.0 * pieces[:, 2]
        q, qd, qdd = (np.vstack((some, end)) for some, end in zip(rows, ends, strict=True))
        count = 1 if self.duration == 0.0 else len(times)  # a posture is one knot
        return times[:count], q[:count], qd[:count], qdd[:count]

    def rows(self, times: Array) -> tuple[Array, Array, Array]:
        """Return positions, velocities, accelerations (k, n) at times (k,) [s] within it."""
        knots = self._times
        pieces = np.searchsorted(knots, times, side='right') - 1
        pieces = np.clip(pieces, 0, len(knots) - 2)
        s = (times - knots[pieces])[:, None]
        q, qd, qdd = np.zeros((3, len(times), self.n))
        for order in range(5, -1, -1):  # Horner's rule, its derivatives beside it
            qdd *= s
            qdd += 2.0 * qd
            qd *= s
            qd += q
            q *= s
            q += self._pieces[pieces, order]
        return q, qd, qdd

    def _inside(self, t: float, q: Array, qd: Array, qdd: Array) -> None:
        self._sample(self._times, self._motion, t, self._result)
        q[:], qd[:], qdd[:] = self._position, self._rate, self._acceleration


def _quintics(times: Array, q: Array, qd: Array, qdd: Array) -> Array:
    """Return coefficients (k - 1, 6, n) of the quintics through values and two derivatives."""
    h = np.diff(times)[:, None]
    step = (q[1:] - q[:-1] - h * (qd[:-1] + 0.5 * h * qdd[:-1])) / h**3
    slope = (qd[1:] - qd[:-1] - h * qdd[:-1]) / h**2
    bend = (qdd[1:] - qdd[:-1]) / h
    return np.stack(
        (
            q[:-1],
            qd[:-1],
            0.5 * qdd[:-1],
            10.0 * step - 4.0 * slope + 0.5 * bend,
            (-15.0 * step + 7.0 * slope - bend) / h,
            (6.0 * step - 3.0 * slope + 0.5 * bend) / h**2,
        ),
        axis=1,
    )


def _spline_rates(times: Array, q: Array, first: Array) -> Array:
    """Return the knot velocities (k, n) of the cubic C2 spline from rate `first` to rest."""
    h = np.diff(times)
    slopes = np.diff(q, axis=0) / h[:, None]
    rates = np.zeros_like(q)
    rates[0] = first
    if len(times) == 2:
        return rates
    # h[i] v[i-1] + 2 (h[i-1] + h[i]) v[i] + h[i-1] v[i+1] = right, between the ends' rates
    right = 3.0 * (h[1:, None] * slopes[:-1] + h[:-1, None] * slopes[1:])
    right[0] -= h[1] * rates[0]
    bands = np.zeros((3, len(times) - 2))
    bands[0, 1:], bands[1], bands[2, :-1] = h[:-2], 2.0 * (h[:-1] + h[1:]), h[2:]
    rates[1:-1] = scipy.linalg.solve_banded((1, 1), bands, right, check_finite=False)
    return rates


def _knot_accelerations(times: Array, q: Array, qd: Array) -> Array:
    """Return one acceleration per knot (k, n): the mean of the cubics on either side."""
    h = np.diff(times)[:, None]
    slopes = np.diff(q, axis=0) / h
    at_start = (6.0 * slopes - 4.0 * qd[:-1] - 2.0 * qd[1:]) / h
    at_end = (2.0 * qd[:-1] + 4.0 * qd[1:] - 6.0 * slopes) / h
    return np.concatenate((at_start[:1], 0.5 * (at_end[:-1] + at_start[1:]), at_end[-1:]))
