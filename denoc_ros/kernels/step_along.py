"""The fixed step of `step` along a motion of the joints: all intervals of it in one call."""

import numpy as np

from denoc_ros.kernels.compiled import inlined, rows_kernel
from denoc_ros.kernels.handle import (
    GOOD,
    MISFIT,
    NOT_FINITE,
    ZERO,
    beyond,
    coordinates,
    elements,
    model_arrays,
)
from denoc_ros.kernels.step import STEP_ROWS, adopt, copy, open_stage, take_step

# rows of the workspace behind those of a step, n elements each
STATE_Q = STEP_ROWS
STATE_QD = STEP_ROWS + 1
ACCELERATION = STEP_ROWS + 2
ALONG_ROWS = STEP_ROWS + 3

SHORTEST = 1e-6  # of the longest step: an interval so little longer takes no step more


@inlined
def cross(handle, steps, held, longest, interval, mean, slope):
    """Take steps of equal length over an interval; the joints' accelerations are linear in it."""
    n = coordinates(handle)
    tau = model_arrays(handle)[3][ZERO]
    q, qd = beyond(steps, STATE_Q * n), beyond(steps, STATE_QD * n)
    given = beyond(steps, ACCELERATION * n)
    if not interval > 0.0:
        return NOT_FINITE
    count = max(1, int(np.ceil(interval / longest - SHORTEST)))
    step = interval / count
    for k in range(count):
        middle = (k + 0.5) * step - 0.5 * interval
        for j in range(n):
            given[j] = mean[j] + middle * slope[j]
        status = take_step(open_stage, handle, steps, held, step, q, qd, given, tau)
        if status != GOOD:
            return status
        adopt(n, steps, q, qd)
    return GOOD


@rows_kernel(
    'int64(int64, float64[:, ::1], float64[::1], float64, float64[::1], float64[:, :, ::1], '
    'float64[:, :, ::1], int64, int64)'
)
def advance_along(handle, steps, held, longest, intervals, accelerations, states, first, last):
    """Write the free coordinates of the states (2, k, n) in rows first .. last - 1.

    Row first - 1 is given, and what is held in all rows. Row k comes intervals[k] after the one
    before; accelerations (2, k, n) are mean and slope of the held joints' over that interval.

    Returns the status of the first step that is not good, else that.
    """
    n, k = coordinates(handle), intervals.shape[0]
    if steps.shape != (ALONG_ROWS, n) or held.shape[0] != n or first < 1 or last > k:
        return MISFIT
    if accelerations.shape != (2, k, n) or states.shape != (2, k, n):
        return MISFIT
    work, flags = elements(steps), elements(held)
    a, x = elements(accelerations), elements(states)
    for row in range(first, last):
        before, now = n * (row - 1), n * row
        copy(n, beyond(x, before), beyond(work, STATE_Q * n))
        copy(n, beyond(x, n * k + before), beyond(work, STATE_QD * n))
        status = cross(
            handle, work, flags, longest, intervals[row], beyond(a, now), beyond(a, n * k + now)
        )
        if status != GOOD:
            return status
        for j in range(n):
            if flags[j] == 0.0:
                x[now + j] = work[STATE_Q * n + j]
                x[n * k + now + j] = work[STATE_QD * n + j]
    return GOOD
