"""A stop on the way: a motion that slows down to rest along its own path."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from denoc_ros.trajectories import SplineTrajectory
from denoc_ros.types import Array

Rows = tuple[Array, Array, Array, Array]  # times (k,), q, qd, qdd (k, joints)
LONGER = 1.25  # factor between the braking times that are tried
LEAST = 60  # steps of a braking, at least


def slowed(trajectory: SplineTrajectory, moment: float, duration: float, step: float) -> Rows:
    """Return the motion that follows a trajectory's path from a moment on, slower and slower.

    Parameters
    ----------
    trajectory : SplineTrajectory
    moment : float
        s of its time, at which this motion has its position, velocity and acceleration.
    duration : float
        s until rest.
    step : float
        s between rows at most.

    Notes
    -----
    Its time s(t) runs at the rate 1 - S(t / T), with the quintic step S, and is T / 2 at rest. So
    no joint is faster than on the trajectory, and q'' = q_ss s'^2 + q_s s''.
    """
    count = max(LEAST, int(np.ceil(duration / step - 1e-9))) + 1
    u = np.linspace(0.0, 1.0, count)
    rate = (1.0 - u**3 * (10.0 - 15.0 * u + 6.0 * u * u))[:, None]
    change = (-30.0 / duration * (u * (1.0 - u)) ** 2)[:, None]
    passed = duration * (u - u**4 * (2.5 - 3.0 * u + u * u))
    q, qd, qdd = trajectory.rows(moment + passed)
    return duration * u, q, qd * rate, qdd * rate**2 + qd * change


def brake(
    trajectory: SplineTrajectory,
    moment: float,
    shortest: float,
    step: float,
    allows: Callable[[Array, Array, Array], bool],
) -> Rows | None:
    """Return the shortest braking from a moment of a trajectory on that is allowed.

    Parameters
    ----------
    trajectory, moment, step
        As of :func:`slowed`.
    shortest : float
        s that it takes at least.
    allows : callable
        Says of q, qd, qdd (k, joints) whether the joints can do it.

    Returns
    -------
    tuple or None
        Times from 0, q, qd, qdd; None if the trajectory is at rest before.
    """
    left = trajectory.duration - moment
    duration = shortest
    while 0.5 * duration < left:
        rows = slowed(trajectory, moment, duration, step)
        if allows(*rows[1:]):
            return rows
        duration *= LONGER
    return None
