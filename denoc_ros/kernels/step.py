"""A fixed step for real time: linearly implicit in elasticity, damping and friction.

Rosenbrock W-method of order 2 (Verwer's ROS2, gamma = 1 - 1/sqrt 2, L-stable) for
y = (q, v)' = (v, I^-1 (tau - h)), with the approximate Jacobian [0 1; -I^-1 K, -I^-1 C], K and C
the constant diagonals (and the slope of Coulomb friction). Order 2 holds for any such matrix.
Eliminating positions leaves, per stage, I + gamma dt C + (gamma dt)^2 K: the recursion with a
shift on its diagonal, so a mode much faster than the step costs nothing and stays stable.
"""

import numpy as np

from denoc_ros.kernels.articulated import articulated_dynamics
from denoc_ros.kernels.compiled import kernel
from denoc_ros.kernels.internal import ARMATURE, DAMPING, FRICTION, STIFFNESS
from denoc_ros.kernels.layout import COORDINATE, JOINT

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


@kernel
def advance(ints, reals, work, diagonals, steps, held, bodies, slip_rate, dt, q, qd, given, tau):
    """Advance q and q' by dt in place; held joints have the acceleration given throughout.

    Returns the status of the forward dynamics; the state is left as it was unless that is good.
    """
    n = q.shape[0]
    g = GAMMA * dt
    shift = steps[SHIFT]
    drive = steps[DRIVE]
    k1 = steps[RATE]
    w = steps[STAGE_RATE]
    for j in range(n):
        c = diagonals[DAMPING, j]
        if diagonals[FRICTION, j] != 0.0:
            t = np.tanh(qd[j] / slip_rate)
            c += diagonals[FRICTION, j] / slip_rate * (1.0 - t * t)
        implicit = g * c + g * g * diagonals[STIFFNESS, j]
        shift[j] = diagonals[ARMATURE, j] + implicit
        steps[GIVEN, j] = 0.0
        drive[j] = tau[j] - g * diagonals[STIFFNESS, j] * qd[j]
    for i in range(bodies):
        if ints[i, JOINT] == 1 and held[i] == 1:
            steps[GIVEN, ints[i, COORDINATE]] = given[ints[i, COORDINATE]]
    status = articulated_dynamics(
        ints, reals, work, diagonals, shift, held, bodies, slip_rate,
        q, qd, steps[GIVEN], drive, k1, steps[TORQUE],
    )  # fmt: skip
    if status != 0:
        return status
    for j in range(n):
        k1q = qd[j] + g * k1[j]
        steps[STAGE_Q, j] = q[j] + dt * k1q
        steps[STAGE_QD, j] = qd[j] + dt * k1[j]
        residual = steps[STAGE_QD, j] - 2.0 * k1q
        implicit = shift[j] - diagonals[ARMATURE, j]
        drive[j] = tau[j] - g * diagonals[STIFFNESS, j] * residual + 2.0 * implicit * k1[j]
    for i in range(bodies):
        if ints[i, JOINT] == 1 and held[i] == 1:
            j = ints[i, COORDINATE]
            steps[STAGE_Q, j] = q[j] + dt * (qd[j] + 0.5 * dt * given[j])
    status = articulated_dynamics(
        ints, reals, work, diagonals, shift, held, bodies, slip_rate,
        steps[STAGE_Q], steps[STAGE_QD], steps[GIVEN], drive, w, steps[TORQUE],
    )  # fmt: skip
    if status != 0:
        return status
    for j in range(n):
        k1q = qd[j] + g * k1[j]
        k2 = w[j] - 2.0 * k1[j]
        k2q = steps[STAGE_QD, j] - 2.0 * k1q + g * k2
        q[j] += dt * (1.5 * k1q + 0.5 * k2q)
        qd[j] += dt * (1.5 * k1[j] + 0.5 * k2)
    for i in range(bodies):
        if ints[i, JOINT] == 1 and held[i] == 1:
            j = ints[i, COORDINATE]
            q[j] = steps[STAGE_Q, j]
            qd[j] = steps[STAGE_QD, j]
    return status
