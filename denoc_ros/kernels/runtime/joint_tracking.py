"""The fading-memory filter of joints' motion: one measurement."""

import math

from denoc_ros.kernels.jit.compiled import inlined, kernel
from denoc_ros.kernels.jit.handle import GOOD, MISFIT, beyond, elements

# rows of the state
POSITION, RATE, ACCELERATION, MEAN, UNSTEADY = range(5)
ROWS = 5
MEMORY = 0.1  # s, of the variance of the accelerations


@inlined
def track(state, joints, q, qd, has_rate, interval, bandwidth):
    """Track joints as :func:`track_joints` does, with pointers."""
    position_row = beyond(state, POSITION * joints)
    rate_row = beyond(state, RATE * joints)
    acceleration_row = beyond(state, ACCELERATION * joints)
    mean_row = beyond(state, MEAN * joints)
    unsteady = beyond(state, UNSTEADY * joints)
    pole = math.exp(-bandwidth * interval)
    share = -math.expm1(-interval / MEMORY)
    rest = 1.0 - pole
    for k in range(joints):
        before, acceleration = rate_row[k], acceleration_row[k]
        position = position_row[k] + interval * before
        position += 0.5 * interval * interval * acceleration
        rate = before + interval * acceleration
        error = q[k] - position
        if has_rate:
            slip = qd[k] - rate
            position += rest * error
            rate += (1.0 - pole * pole) * slip
            acceleration += rest * rest / interval * slip
        else:
            position += (1.0 - pole**3) * error
            rate += 1.5 * rest * rest * (1.0 + pole) / interval * error
            acceleration += rest**3 / (interval * interval) * error
        mean = (rate - before) / interval
        gap = mean - acceleration
        position_row[k], rate_row[k], acceleration_row[k] = position, rate, acceleration
        mean_row[k] = mean
        unsteady[k] += share * (gap * gap - unsteady[k])


@kernel('int64(float64[:, ::1], float64[::1], float64[::1], boolean, float64, float64)')
def track_joints(state, q, qd, has_rate, interval, bandwidth):
    """Bring the state (5, joints) of a tracking filter to the next measurement.

    The equations are those of :class:`denoc_ros.estimation.joint_tracker.TrackingFilter`.

    Parameters
    ----------
    state : (5, joints) array
        Position, rate, acceleration, mean acceleration, its variance; in place.
    q, qd : (joints,) arrays
        Measured positions and, if `has_rate`, rates.
    interval : float
        Since the last measurement [s].
    bandwidth : float
        2 pi cutoff [rad/s].

    Returns
    -------
    int
        GOOD, or MISFIT: the measurement is not of as many joints.
    """
    if q.shape[0] != state.shape[1] or qd.shape[0] != state.shape[1]:
        return MISFIT
    track(
        elements(state), state.shape[1], elements(q), elements(qd), has_rate, interval, bandwidth
    )
    return GOOD
