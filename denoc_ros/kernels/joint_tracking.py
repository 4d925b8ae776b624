"""The fading-memory filter of joints' motion: one measurement."""

from denoc_ros.kernels.compiled import kernel
from denoc_ros.kernels.handle import GOOD, MISFIT

# rows of the state
POSITION, RATE, ACCELERATION, MEAN, UNSTEADY = range(5)
ROWS = 5


@kernel('int64(float64[:, ::1], float64[::1], float64[::1], boolean, float64, float64, float64)')
def track_joints(state, q, qd, has_rate, interval, pole, share):
    """Bring the state (5, joints) of a tracking filter to the next measurement.

    The equations are those of :class:`denoc_ros.estimation.tracking.TrackingFilter`.

    Parameters
    ----------
    state : (5, joints) array
        Position, rate, acceleration, mean acceleration, its variance; in place.
    q, qd : (joints,) arrays
        Measured positions and, if `has_rate`, rates.
    interval : float
        Since the last measurement [s].
    pole : float
        exp(-2 pi cutoff interval).
    share : float
        Weight of this interval in the variance.

    Returns
    -------
    int
        GOOD, or MISFIT: the measurement is not of as many joints.
    """
    if q.shape[0] != state.shape[1] or qd.shape[0] != state.shape[1]:
        return MISFIT
    rest = 1.0 - pole
    for k in range(state.shape[1]):
        before, acceleration = state[RATE, k], state[ACCELERATION, k]
        position = state[POSITION, k] + interval * before
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
        state[POSITION, k], state[RATE, k], state[ACCELERATION, k] = position, rate, acceleration
        state[MEAN, k] = mean
        state[UNSTEADY, k] += share * (gap * gap - state[UNSTEADY, k])
    return GOOD
