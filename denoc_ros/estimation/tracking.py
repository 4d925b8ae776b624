"""Motion of joints from sampled measurements: a tracking filter with extrapolation."""

from __future__ import annotations

import math

import numpy as np

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

    Notes
    -----
    With z = exp(-2 pi cutoff T) for measurements T apart: a first-order correction of the
    position and a second-order one of rate and acceleration where rates are measured; the
    third-order (g, h, k) one where only positions are.
    """

    def __init__(self, joints: int, cutoff: float) -> None:
        self._rate = 2.0 * math.pi * cutoff
        self.q, self.qd, self.qdd = np.zeros(joints), np.zeros(joints), np.zeros(joints)

    def reset(self, q: Array, qd: Array | None = None) -> None:
        """Start at positions and rates (joints,); no rates: at rest."""
        self.q[:] = q
        self.qd[:] = 0.0 if qd is None else qd
        self.qdd[:] = 0.0

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
        """
        self.q += interval * self.qd + (0.5 * interval * interval) * self.qdd
        self.qd += interval * self.qdd
        pole = math.exp(-self._rate * interval)
        error = q - self.q
        if qd is not None:
            error_rate = qd - self.qd
            self.q += (1.0 - pole) * error
            self.qd += (1.0 - pole * pole) * error_rate
            self.qdd += ((1.0 - pole) ** 2 / interval) * error_rate
            return
        self.q += (1.0 - pole**3) * error
        self.qd += (1.5 * (1.0 - pole) ** 2 * (1.0 + pole) / interval) * error
        self.qdd += ((1.0 - pole) ** 3 / interval**2) * error


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
