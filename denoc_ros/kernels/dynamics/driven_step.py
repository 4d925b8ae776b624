"""Steps of a robot whose joints move as given: along a change of their accelerations, up to a
measurement, and the torque that the motion takes. One call each, for what ticks a thousand times a
second.
"""

import numpy as np
from numba import types

from denoc_ros.kernels.dynamics.articulated import find_articulated
from denoc_ros.kernels.dynamics.step import STEP_ROWS, adopt, open_stage, take_step
from denoc_ros.kernels.jit import handle as rec_
from denoc_ros.kernels.jit.array_object import (
    READABLE,
    WRITABLE,
    array_object,
    content,
    element_count,
    is_array,
    is_vector,
    length,
)
from denoc_ros.kernels.jit.compiled import inlined, kernel
from denoc_ros.kernels.jit.handle import GOOD, MISFIT, beyond, coordinates, model_arrays
from denoc_ros.kernels.runtime.joint_tracking import POSITION, RATE, ROWS, track

# numbers that a measurement comes with
INTERVAL, BANDWIDTH, SHORTEST, STEP, MOST_STEPS = range(5)
MEASURED = 5


@inlined
def is_workspace(handle, steps, n):
    """Say whether an object is the workspace of a step."""
    return (
        is_array(handle, steps, 2, WRITABLE)
        and length(steps, 0) == STEP_ROWS
        and length(steps, 1) == n
    )


@inlined
def is_room(handle, room, n):
    """Say whether an object is a workspace of three rows."""
    return is_array(handle, room, 2, WRITABLE) and length(room, 0) == 3 and length(room, 1) == n


@inlined
def go_along(handle, steps, held, places, joints, first, change, tau, q, qd, given, dt, count):
    """Take steps; the joints' acceleration goes from `first` on by `change` over all of them."""
    n = coordinates(handle)
    for j in range(n):
        given[j] = 0.0
    for k in range(count):
        share = (k + 0.5) / count
        for i in range(joints):
            given[np.int64(places[i])] = first[i] + share * change[i]
        status = take_step(open_stage, handle, steps, held, dt, q, qd, given, tau)
        if status != GOOD:
            return status
        adopt(n, steps, q, qd)
    return GOOD


@kernel(types.int64(types.int64, *[array_object] * 11, types.float64, types.int64))
def advance_driven(
    handle, steps, held, places, first, change, tau, given, q_before, qd_before, q, qd, duration,
    count,
):  # fmt: skip
    """Advance q and q' (n,) by a duration [s] in `count` steps.

    Parameters
    ----------
    handle : int
    steps : (STEP_ROWS, n) array
        Workspace.
    held : (n,) array
        1 where a joint's acceleration is given.
    places : (joints,) array
        Coordinates of these joints.
    first, change : (joints,) arrays
        Their accelerations at the beginning, and by how much these change to the end; each step
        has that of its middle.
    tau : (n,) array
        Generalized forces.
    given : (n,) array
        Workspace.
    q_before, qd_before : (n,) arrays
        State at the beginning, which may be the same arrays.
    q, qd : (n,) arrays
        Output.
    """
    n = coordinates(handle)
    if not (is_workspace(handle, steps, n) and is_array(handle, places, 1, READABLE)):
        return MISFIT
    joints = element_count(places)
    if not (
        is_vector(handle, held, n, READABLE)
        and is_vector(handle, first, joints, READABLE)
        and is_vector(handle, change, joints, READABLE)
        and is_vector(handle, tau, n, READABLE)
        and is_vector(handle, given, n, WRITABLE)
        and is_vector(handle, q_before, n, READABLE)
        and is_vector(handle, qd_before, n, READABLE)
        and is_vector(handle, q, n, WRITABLE)
        and is_vector(handle, qd, n, WRITABLE)
    ):
        return MISFIT
    x, v, x_before, v_before = content(q), content(qd), content(q_before), content(qd_before)
    for j in range(n):
        x[j], v[j] = x_before[j], v_before[j]
    return go_along(
        handle, content(steps), content(held), content(places), joints, content(first),
        content(change), content(tau), x, v, content(given), duration / count, count,
    )  # fmt: skip


@inlined
def mean_acceleration(before, after, gain, duration):
    """Return a joint's mean acceleration in a step that changes its rate by what its motion gains.

    Half the accelerations' sum would leave amplitudes with momentum that no torque gives. A jump
    of the rate, of which no acceleration tells, is none of it.
    """
    middle, most = 0.5 * (before + after), abs(before) + abs(after)
    return min(max(gain / duration, middle - most), middle + most)


@kernel(types.int64(types.int64, *[array_object] * 13, types.float64, types.int64))
def driven_torque(
    handle, steps, held, places, first, position, rate, acceleration, tau, room, q, qd, qdd,
    torque, duration, count,
):  # fmt: skip
    """Advance to a motion of joints; find its torque, and all other accelerations.

    Parameters
    ----------
    handle : int
    steps : (STEP_ROWS, n) array
        Workspace.
    held : (n,) array
        1 where a joint's acceleration is given.
    places : (joints,) array
        Coordinates of these joints.
    first : (joints,) array
        Their accelerations at the beginning; output: those of the motion.
    position, rate, acceleration : (joints,) arrays
        Their motion.
    tau : (n,) array
        Generalized forces during the steps.
    room : (3, n) array
        Workspace.
    q, qd, qdd : (n,) arrays
        State and accelerations: in place.
    torque : (joints,) array
        Output [N m or N].
    duration, count : float, int
        Of all steps to the motion [s], and how many; 0: the state is there.
    """
    n = coordinates(handle)
    if not (is_workspace(handle, steps, n) and is_array(handle, places, 1, READABLE)):
        return MISFIT
    joints = element_count(places)
    if not (
        is_vector(handle, held, n, READABLE)
        and is_vector(handle, first, joints, WRITABLE)
        and is_vector(handle, position, joints, READABLE)
        and is_vector(handle, rate, joints, READABLE)
        and is_vector(handle, acceleration, joints, READABLE)
        and is_vector(handle, tau, n, READABLE)
        and is_room(handle, room, n)
        and is_vector(handle, q, n, WRITABLE)
        and is_vector(handle, qd, n, WRITABLE)
        and is_vector(handle, qdd, n, WRITABLE)
        and is_vector(handle, torque, joints, WRITABLE)
    ):
        return MISFIT
    wanted, x, v, a = content(room), content(q), content(qd), content(qdd)
    index, needed, asked = content(places), content(torque), content(acceleration)
    before, start, change = content(first), beyond(wanted, n), beyond(wanted, 2 * n)
    if count > 0:
        for i in range(joints):
            gain = content(rate)[i] - v[np.int64(index[i])]
            mean = mean_acceleration(before[i], asked[i], gain, duration)
            change[i] = asked[i] - before[i]
            start[i] = mean - 0.5 * change[i]
        status = go_along(
            handle, content(steps), content(held), index, joints, start, change, content(tau),
            x, v, wanted, duration / count, count,
        )  # fmt: skip
        if status != GOOD:
            return status
    for i in range(joints):
        before[i] = asked[i]
    for j in range(n):
        wanted[j] = 0.0
    for i in range(joints):
        j = np.int64(index[i])
        x[j], v[j], wanted[j] = content(position)[i], content(rate)[i], asked[i]
    diagonals = model_arrays(handle)[3]
    force = diagonals[rec_.SCRATCH]
    status = find_articulated(
        handle,
        diagonals[rec_.ARMATURE],
        content(held),
        x,
        v,
        wanted,
        diagonals[rec_.ZERO],
        a,
        force,
    )
    if status != GOOD:
        return status
    for i in range(joints):
        j = np.int64(index[i])
        a[j], needed[i] = asked[i], force[j]
    return GOOD


@kernel(types.int64(types.int64, *[array_object] * 11, types.boolean))
def take_measurement(
    handle, steps, held, places, numbers, state, position, rate, tau, room, q, qd, has_rate
):
    """Bring a tracking filter, and a robot's state with it, to the next measurement of joints.

    The joints go there as :func:`denoc_ros.estimation.joint_tracker.joining_acceleration` says.

    Parameters
    ----------
    handle : int
    steps : (STEP_ROWS, n) array
        Workspace.
    held : (n,) array
        1 where a joint is measured.
    places : (joints,) array
        Coordinates of the measured joints.
    numbers : (MEASURED,) array
        Interval since the last measurement [s]; bandwidth of :func:`track_joints` [rad/s]; the
        shortest interval [s] over which accelerations change; the step [s], and how many at most.
    state : (ROWS, joints) array
        Of the filter; in place.
    position, rate : (joints,) arrays
        Measured.
    tau : (n,) array
        Generalized forces.
    room : (3, n) array
        Workspace.
    q, qd : (n,) arrays
        The robot's state; in place.
    has_rate : bool
        Whether rates are measured.
    """
    n = coordinates(handle)
    if not (is_workspace(handle, steps, n) and is_array(handle, places, 1, READABLE)):
        return MISFIT
    joints = element_count(places)
    if not (
        is_vector(handle, held, n, READABLE)
        and is_vector(handle, numbers, MEASURED, READABLE)
        and is_array(handle, state, 2, WRITABLE)
        and length(state, 0) == ROWS
        and length(state, 1) == joints
        and is_vector(handle, position, joints, READABLE)
        and is_vector(handle, rate, joints, READABLE)
        and is_vector(handle, tau, n, READABLE)
        and is_room(handle, room, n)
        and is_vector(handle, q, n, WRITABLE)
        and is_vector(handle, qd, n, WRITABLE)
    ):
        return MISFIT
    number, tracked, index = content(numbers), content(state), content(places)
    x, v = content(q), content(qd)
    interval = number[INTERVAL]
    track(tracked, joints, content(position), content(rate), has_rate, interval, number[BANDWIDTH])
    after, rate_after = beyond(tracked, POSITION * joints), beyond(tracked, RATE * joints)
    given = content(room)
    first, change = beyond(given, n), beyond(given, 2 * n)
    for i in range(joints):
        j = np.int64(index[i])
        mean = (rate_after[i] - v[j]) / interval
        slope = 0.0
        if interval >= number[SHORTEST]:
            missed = after[i] - x[j] - interval * v[j] - 0.5 * interval * interval * mean
            slope = -12.0 / interval**3 * missed
        first[i], change[i] = mean - 0.5 * interval * slope, interval * slope
    count = np.int64(np.ceil(interval / number[STEP] - 1e-6))
    count = min(max(count, 1), np.int64(number[MOST_STEPS]))
    status = go_along(
        handle, content(steps), content(held), index, joints, first, change, content(tau), x, v,
        given, interval / count, count,
    )  # fmt: skip
    if status != GOOD:
        return status
    for i in range(joints):
        j = np.int64(index[i])
        x[j], v[j] = after[i], rate_after[i]
    return GOOD
