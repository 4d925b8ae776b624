"""Restoring force of one coordinate: a linear spring, or a stiffening one with play.

With the wind-up e(s) the force is (k e + k3 e^3) de/ds, the gradient of k e^2 / 2 + k3 e^4 / 4.
Without play e = s. With a free play of +- p,
e = w (ln(1 + exp((s - p) / w)) - ln(1 + exp((-s - p) / w))), w = p / 10:
s + p or s - p outside, next to nothing inside, smooth in between.
Damping and Coulomb friction act along the coordinates too; all are diagonal.
"""

import numpy as np

from denoc_ros.kernels.jit import handle as rec_
from denoc_ros.kernels.jit.compiled import inlined
from denoc_ros.kernels.jit.handle import DAMPING, FRICTION
from denoc_ros.kernels.layout.layout import SLIP_RATE

SOFTNESS = 0.1  # of the corners, as a share of the play


@inlined
def soft_step(x):
    """Return ln(1 + exp x) and its derivative."""
    z = np.exp(-abs(x))
    rest = np.log1p(z)
    if x >= 0.0:
        return x + rest, 1.0 / (1.0 + z)
    return rest, z / (1.0 + z)


@inlined
def wind_up(s, play):
    """Return e(s) and its first two derivatives."""
    if play == 0.0:
        return s, 1.0, 0.0
    w = SOFTNESS * play
    above, rising = soft_step((s - play) / w)
    below, falling = soft_step((-s - play) / w)
    bend = (rising * (1.0 - rising) - falling * (1.0 - falling)) / w
    return w * (above - below), rising + falling, bend


@inlined
def is_linear(diagonals, j):
    """Say whether the force is a constant times the coordinate."""
    return diagonals[rec_.STIFFNESS3][j] == 0.0 and diagonals[rec_.PLAY][j] == 0.0


@inlined
def spring_force(diagonals, q, j):
    """Return the force by which coordinate j resists."""
    k = diagonals[rec_.STIFFNESS][j]
    if is_linear(diagonals, j):
        return k * q[j]
    e, slope, _ = wind_up(q[j], diagonals[rec_.PLAY][j])
    return (k + diagonals[rec_.STIFFNESS3][j] * e * e) * e * slope


@inlined
def spring_slope(diagonals, q, j):
    """Return the derivative of :func:`spring_force`."""
    k = diagonals[rec_.STIFFNESS][j]
    if is_linear(diagonals, j):
        return k
    k3 = diagonals[rec_.STIFFNESS3][j]
    e, slope, bend = wind_up(q[j], diagonals[rec_.PLAY][j])
    return (k + 3.0 * k3 * e * e) * slope * slope + (k + k3 * e * e) * e * bend


@inlined
def spring_energy(diagonals, q, j):
    """Return the energy that coordinate j stores."""
    e, _, _ = wind_up(q[j], diagonals[rec_.PLAY][j])
    return (
        (0.5 * diagonals[rec_.STIFFNESS][j] + 0.25 * diagonals[rec_.STIFFNESS3][j] * e * e) * e * e
    )


@inlined
def step_stiffness(diagonals, q, j):
    """Return the stiffness that a time step takes as constant, wherever in the play it begins."""
    return diagonals[rec_.STIFFNESS][j] + 3.0 * diagonals[rec_.STIFFNESS3][j] * q[j] * q[j]


@inlined
def internal_force(constants, diagonals, q, qd, j):
    """Return k q + c q' + f tanh(q' / v_s) of coordinate j (springs: see spring)."""
    force = spring_force(diagonals, q, j) + diagonals[DAMPING][j] * qd[j]
    if diagonals[FRICTION][j] != 0.0:
        force += diagonals[FRICTION][j] * np.tanh(qd[j] / constants[SLIP_RATE])
    return force


@inlined
def internal_slope(constants, diagonals, q, qd, j):
    """Return the derivatives by q_j and q'_j of :func:`internal_force`."""
    damping = diagonals[DAMPING][j]
    if diagonals[FRICTION][j] != 0.0:
        slip = np.tanh(qd[j] / constants[SLIP_RATE])
        damping += diagonals[FRICTION][j] / constants[SLIP_RATE] * (1.0 - slip * slip)
    return spring_slope(diagonals, q, j), damping
