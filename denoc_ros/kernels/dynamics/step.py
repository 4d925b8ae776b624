"""A fixed step for real time: linearly implicit in elasticity, damping and friction.

Rosenbrock W-method of order 2 (Verwer's ROS2, gamma = 1 - 1/sqrt 2, L-stable) for
y = (q, v)' = (v, I^-1 (tau - h)), with the approximate Jacobian [0 1; -I^-1 K, -I^-1 C], K and C
the constant diagonals (and the slope of Coulomb friction). Order 2 holds for any such matrix.
Eliminating positions leaves, per stage, I + gamma dt C + (gamma dt)^2 K: the recursion with a
shift on its diagonal, so a mode much faster than the step costs nothing and stays stable. With
constraints (loops, mimic joints) both stages are constrained dynamics, and the new state is
brought back onto the constraints (see closing).
`advance_along` takes all steps along a motion of the joints in one call.
"""

import numpy as np

from denoc_ros.kernels.dynamics.articulated import find_articulated
from denoc_ros.kernels.jit import handle as rec_
from denoc_ros.kernels.jit.compiled import inlined, rows_kernel
from denoc_ros.kernels.jit.handle import (
    GOOD,
    MISFIT,
    NOT_FINITE,
    ZERO,
    at,
    beyond,
    coordinates,
    elements,
    model_arrays,
)
from denoc_ros.kernels.layout import layout as at_
from denoc_ros.kernels.springs.spring_torque import step_stiffness

GAMMA = 1.0 - np.sqrt(0.5)
FIRST_STAGE = 1
SECOND_STAGE = 2

# rows of the step workspace, n elements each
SHIFT = 0
DRIVE = 1
RATE = 2  # k1 of the rates
STAGE_Q = 3
STAGE_QD = 4
STAGE_RATE = 5
GIVEN = 6
START_Q = 7  # the state and the given accelerations with mimic joints on their leaders
START_QD = 8
START_GIVEN = 9
STEP_ROWS = 10


@inlined
def hold(topology, bodies, held, source, target):
    """Copy the elements of held joints."""
    for i in range(1, bodies + 1):
        j = at(topology, i, at_.COORDINATE)
        if at(topology, i, at_.JOINT) == 1 and held[j] != 0.0:
            target[j] = source[j]


@inlined
def open_stage(handle, _stage, _g, shift, held, q, qd, given, tau, qdd):
    """Write the accelerations of a stage without constraints."""
    torque = model_arrays(handle)[3][rec_.SCRATCH]
    return find_articulated(handle, shift, held, q, qd, given, tau, qdd, torque)


@inlined
def take_step(accelerate, handle, steps, held, dt, q, qd, given, tau):
    """Write the state after dt to the stage's rows of steps; return the dynamics' status.

    Held joints have the acceleration given throughout; accelerate writes those of a stage.
    """
    topology, constants, _work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    g = GAMMA * dt
    shift = beyond(steps, SHIFT * n)
    drive = beyond(steps, DRIVE * n)
    k1 = beyond(steps, RATE * n)
    w = beyond(steps, STAGE_RATE * n)
    stage_q = beyond(steps, STAGE_Q * n)
    stage_qd = beyond(steps, STAGE_QD * n)
    wanted = beyond(steps, GIVEN * n)
    for j in range(n):
        c = diagonals[rec_.DAMPING][j]
        if diagonals[rec_.FRICTION][j] != 0.0:
            t = np.tanh(qd[j] / constants[at_.SLIP_RATE])
            c += diagonals[rec_.FRICTION][j] / constants[at_.SLIP_RATE] * (1.0 - t * t)
        shift[j] = diagonals[rec_.ARMATURE][j] + g * c + g * g * step_stiffness(diagonals, q, j)
        wanted[j] = 0.0
        drive[j] = tau[j] - g * step_stiffness(diagonals, q, j) * qd[j]
    hold(topology, bodies, held, given, wanted)
    status = accelerate(handle, FIRST_STAGE, g, shift, held, q, qd, wanted, drive, k1)
    if status != GOOD:
        return status
    for j in range(n):
        k1q = qd[j] + g * k1[j]
        stage_q[j] = q[j] + dt * k1q
        stage_qd[j] = qd[j] + dt * k1[j]
        if held[j] != 0.0:
            stage_q[j] = q[j] + dt * (qd[j] + 0.5 * dt * given[j])
        residual = stage_qd[j] - 2.0 * k1q
        implicit = shift[j] - diagonals[rec_.ARMATURE][j]
        elastic = g * step_stiffness(diagonals, q, j) * residual
        drive[j] = tau[j] - elastic + 2.0 * implicit * k1[j]
    status = accelerate(handle, SECOND_STAGE, g, shift, held, stage_q, stage_qd, wanted, drive, w)
    if status != GOOD:
        return status
    for j in range(n):
        if held[j] != 0.0:
            continue
        k1q = qd[j] + g * k1[j]
        k2 = w[j] - 2.0 * k1[j]
        k2q = stage_qd[j] - 2.0 * k1q + g * k2
        stage_q[j] = q[j] + dt * (1.5 * k1q + 0.5 * k2q)
        stage_qd[j] = qd[j] + dt * (1.5 * k1[j] + 0.5 * k2)
    return GOOD


@inlined
def copy(n, source, target):
    """Copy n elements."""
    for j in range(n):
        target[j] = source[j]


@inlined
def adopt(n, steps, q, qd):
    """Take over the state that a step has written."""
    copy(n, beyond(steps, STAGE_Q * n), q)
    copy(n, beyond(steps, STAGE_QD * n), qd)


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
