"""A fixed step for real time: linearly implicit in elasticity, damping and friction.

Rosenbrock W-method of order 2 (Verwer's ROS2, gamma = 1 - 1/sqrt 2, L-stable) for
y = (q, v)' = (v, I^-1 (tau - h)), with the approximate Jacobian [0 1; -I^-1 K, -I^-1 C], K and C
the constant diagonals (and the slope of Coulomb friction). Order 2 holds for any such matrix.
Eliminating positions leaves, per stage, I + gamma dt C + (gamma dt)^2 K: the recursion with a
shift on its diagonal, so a mode much faster than the step costs nothing and stays stable.
"""

import numpy as np

from denoc_ros.kernels.articulated import find_articulated
from denoc_ros.kernels.compiled import inlined, kernel
from denoc_ros.kernels.handle import (
    ARMATURE,
    DAMPING,
    FRICTION,
    GOOD,
    MISFIT,
    STIFFNESS,
    at,
    beyond,
    coordinates,
    elements,
    model_arrays,
)
from denoc_ros.kernels.layout import COORDINATE, JOINT, SLIP_RATE

GAMMA = 1.0 - np.sqrt(0.5)

# rows of the (8, n) step workspace
SHIFT = 0
DRIVE = 1
RATE = 2  # k1 of the rates
STAGE_Q = 3
STAGE_QD = 4
STAGE_RATE = 5
TORQUE = 6
GIVEN = 7
STEP_ROWS = 8


@inlined
def hold(ints, bodies, held, source, target):
    """Copy the elements of held joints."""
    for i in range(1, bodies + 1):
        j = at(ints, i, COORDINATE)
        if at(ints, i, JOINT) == 1 and held[j] != 0.0:
            target[j] = source[j]


@inlined
def take_step(handle, steps, held, dt, q, qd, given, tau):
    """Advance q and q' by dt in place; held joints have the acceleration given throughout.

    Returns the status of the forward dynamics; the state is left as it was unless that is good.
    """
    ints, reals, _work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    g = GAMMA * dt
    shift = beyond(steps, SHIFT * n)
    drive = beyond(steps, DRIVE * n)
    k1 = beyond(steps, RATE * n)
    w = beyond(steps, STAGE_RATE * n)
    stage_q = beyond(steps, STAGE_Q * n)
    stage_qd = beyond(steps, STAGE_QD * n)
    torque = beyond(steps, TORQUE * n)
    wanted = beyond(steps, GIVEN * n)
    for j in range(n):
        c = diagonals[DAMPING][j]
        if diagonals[FRICTION][j] != 0.0:
            t = np.tanh(qd[j] / reals[SLIP_RATE])
            c += diagonals[FRICTION][j] / reals[SLIP_RATE] * (1.0 - t * t)
        shift[j] = diagonals[ARMATURE][j] + g * c + g * g * diagonals[STIFFNESS][j]
        wanted[j] = 0.0
        drive[j] = tau[j] - g * diagonals[STIFFNESS][j] * qd[j]
    hold(ints, bodies, held, given, wanted)
    status = find_articulated(handle, shift, held, q, qd, wanted, drive, k1, torque)
    if status != GOOD:
        return status
    for j in range(n):
        k1q = qd[j] + g * k1[j]
        stage_q[j] = q[j] + dt * k1q
        stage_qd[j] = qd[j] + dt * k1[j]
        if held[j] != 0.0:
            stage_q[j] = q[j] + dt * (qd[j] + 0.5 * dt * given[j])
        residual = stage_qd[j] - 2.0 * k1q
        implicit = shift[j] - diagonals[ARMATURE][j]
        drive[j] = tau[j] - g * diagonals[STIFFNESS][j] * residual + 2.0 * implicit * k1[j]
    status = find_articulated(handle, shift, held, stage_q, stage_qd, wanted, drive, w, torque)
    if status != GOOD:
        return status
    for j in range(n):
        k1q = qd[j] + g * k1[j]
        k2 = w[j] - 2.0 * k1[j]
        k2q = stage_qd[j] - 2.0 * k1q + g * k2
        q[j] += dt * (1.5 * k1q + 0.5 * k2q)
        qd[j] += dt * (1.5 * k1[j] + 0.5 * k2)
    hold(ints, bodies, held, stage_q, q)
    hold(ints, bodies, held, stage_qd, qd)
    return GOOD


@kernel(
    'int64(int64, float64[:, ::1], float64[::1], float64, float64[::1], float64[::1], '
    'float64[::1], float64[::1])'
)
def advance(handle, steps, held, dt, q, qd, given, tau):
    """Do what :func:`take_step` does, with arrays of fitting sizes."""
    n = coordinates(handle)
    if q.shape[0] != n or qd.shape[0] != n or given.shape[0] != n or tau.shape[0] != n:
        return MISFIT
    return take_step(
        handle, elements(steps), elements(held), dt, elements(q), elements(qd),
        elements(given), elements(tau),
    )  # fmt: skip
