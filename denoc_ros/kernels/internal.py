"""Forces that act along the coordinates: elasticity, damping and friction, all diagonal."""

import numpy as np

from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.handle import DAMPING, FRICTION
from denoc_ros.kernels.layout import SLIP_RATE
from denoc_ros.kernels.spring import spring_force, spring_slope


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
