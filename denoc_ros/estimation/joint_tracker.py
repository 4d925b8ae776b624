"""Motion of joints from sampled measurements: a tracking filter with extrapolation."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from denoc_ros.errors import StateError
from denoc_ros.kernels.jit.compiled import ready
from denoc_ros.kernels.jit.handle import GOOD
from denoc_ros.kernels.runtime.joint_tracking import ROWS, track_joints
from denoc_ros.types import Array


class TrackingFilter:
    """A critically damped fading-memory filter per joint, all with one bandwidth.

    Parameters
    ----------
    joints : int
        How many joints.
    cutoff : float
        Bandwidth [Hz]: lower is smoother, higher follows faster. Steady acceleration is followed
        without lag.

    Attributes
    ----------
    q, qd, qdd : (joints,) arrays
        Estimates at the last measurement.
    mean : (joints,) array
        Acceleration that makes the change of the rates since the measurement before.
    unsteady : (joints,) array
        Variance of the acceleration against that.
    state : (ROWS, joints) array
        All of these, as kernels take them.
    bandwidth : float
        [rad/s]

    Notes
    -----
    With z = exp(-2 pi cutoff T) for measurements T apart: a first-order correction of the
    position and a second-order one of rate and acceleration where rates are measured; the
    third-order (g, h, k) one where only positions are.
    """

    def __init__(self, joints: int, cutoff: float) -> None:
        self.bandwidth = 2.0 * math.pi * cutoff
        ready(track_joints)
        self.state = np.zeros((ROWS, joints))
        self.q, self.qd, self.qdd, self.mean, self.unsteady = self.state

    def reset(self, q: Array, qd: Array | None = None) -> None:
        """Start at positions and rates (joints,); no rates: at rest."""
        self.q[:] = q
        self.qd[:] = 0.0 if qd is None else qd
        self.qdd[:] = self.mean[:] = 0.0

    def adopt(self, other: TrackingFilter) -> None:
        """Go on from the state of another filter of as many joints."""
        for name in ('q', 'qd', 'qdd', 'mean'):
            getattr(self, name)[:] = getattr(other, name)

    def update(self, q: Array, qd: Array | None, interval: float) -> None:
        """Go on to the next measurement and take it in.

        Parameters
        ----------
        q : (joints,) array
            Measured positions.
        qd : (joints,) array or None
            Measured rates.
        interval : float
            Time since the measurement before this one [s], > 0.

        Raises
        ------
        StateError
            The measurement is not of as many joints.
        """
        rates = q if qd is None else qd
        how = qd is not None, interval, self.bandwidth
        try:
            status = track_joints(self.state, q, rates, *how)
        except TypeError:  # no contiguous, writable rows of doubles
            q, rates = np.array(q, dtype=np.float64), np.array(rates, dtype=np.float64)
            status = track_joints(self.state, q, rates, *how)
        if status != GOOD:
            raise StateError(
                f'measured joints must be {len(self.q)}, got arrays of shape {q.shape} and '
                f'{rates.shape}'
            )


def connecting_acceleration(
    interval: float | Array, q: Array, qd: Array, q_after: Array, qd_after: Array
) -> tuple[Array, Array]:
    """Return the linear acceleration that leads from one position and rate to another.

    Parameters
    ----------
    interval : float or (k, 1) array
        Between the two [s], > 0.
    q, qd, q_after, qd_after : (joints,) or (k, joints) arrays
        Positions and rates before and after.

    Returns
    -------
    mean, slope : (joints,) arrays
        q''(t) = mean + slope (t - interval / 2): the mean makes the change of the rates, the slope
        what that leaves of the change of the positions.
    """
    mean = (qd_after - qd) / interval
    missed = q_after - q - interval * qd - (0.5 * interval * interval) * mean
    return mean, missed * (-12.0 / interval**3)


def joining_acceleration(
    interval: float, before: tuple[Array, Array], after: tuple[Array, Array], shortest: float
) -> Callable[[float], Array]:
    """Return the accelerations (joints,) over an interval [s] that lead from one state to another.

    Their mean makes the change of the rates, not the filter's acceleration: so the amplitudes'
    rates feel a jump of the joints' rates once and noise does not pile up. Over an interval that
    is not shorter than `shortest` [s] they also change linearly so that they make the change of
    the positions.
    """
    if interval < shortest:
        steady = (after[1] - before[1]) / interval
        return lambda _: steady
    mean, slope = connecting_acceleration(interval, *before, *after)
    return lambda t: mean + slope * (t - 0.5 * interval)
