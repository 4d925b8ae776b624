"""Forces that act along the coordinates: elasticity, damping and friction, all diagonal."""

import numpy as np

from denoc_ros.kernels.compiled import inlined

STIFFNESS = 0  # rows of the (4, n) array of diagonals
DAMPING = 1
FRICTION = 2
ARMATURE = 3


@inlined
def internal_force(diagonals, slip_rate, q, qd, j):
    """Return k q + c q' + f tanh(q' / v_s) of coordinate j."""
    force = diagonals[STIFFNESS, j] * q[j] + diagonals[DAMPING, j] * qd[j]
    if diagonals[FRICTION, j] != 0.0:
        force += diagonals[FRICTION, j] * np.tanh(qd[j] / slip_rate)
    return force
