"""Deflections of the tips of beams, and their rates, from rows of the model."""

from denoc_ros.kernels.algebra.rotation import (
    exponential_coefficients,
    rotation_vector,
    square_plus,
)
from denoc_ros.kernels.algebra.vector import add, cross, load, rotate, store, subtract
from denoc_ros.kernels.dynamics.placement import multiply
from denoc_ros.kernels.jit.compiled import kernel

COMPONENTS = 6  # displacement and rotation
# rotations of a chain of segments: up to a segment, and its own
TURN, NEXT, BENT = 0, 9, 18
ROTATIONS = 27


@kernel(
    'void(float64[:, ::1], float64[:, ::1], float64[::1], float64[::1], float64[::1], '
    'float64[::1])'
)
def tip_deflections(rows, owner, q, qd, position, rate):
    """Write displacements and rotations (6 k,) of the tips of k links, and their rates.

    Parameters
    ----------
    rows : (6 k + n, n) array
        What is linear in the coordinates, then the matrix H of the shortening u_x.
    owner : (k, n) array
        Weights of q_j (H q)_j in each link's u_x: -1/2 at its own amplitudes.
    """
    size, n = position.shape[0], q.shape[0]
    for row in range(size):
        bent = moving = 0.0
        for j in range(n):
            bent += rows[row, j] * q[j]
            moving += rows[row, j] * qd[j]
        position[row], rate[row] = bent, moving
    for link in range(owner.shape[0]):
        bent = moving = 0.0
        for j in range(n):
            if owner[link, j] != 0.0:
                drawn = 0.0
                for k in range(n):
                    drawn += rows[size + j, k] * q[k]
                bent += owner[link, j] * drawn * q[j]
                moving += 2.0 * owner[link, j] * drawn * qd[j]
        position[COMPONENTS * link], rate[COMPONENTS * link] = bent, moving


@kernel(
    'void(float64[:, :, ::1], float64[:, :, ::1], float64[::1], float64[::1], float64[::1], '
    'float64[::1], float64[::1], float64[::1])'
)
def segmented_tip(linear, shortening, lengths, d, dd, turns, position, rate):
    """Write displacement and rotation (6,) of the tip of a beam of segments, and their rates.

    Parameters
    ----------
    linear : (s, 6, m) array
        Of the tip of each segment, per amplitude: as `rows` of :func:`tip_deflections`.
    shortening : (s, m, m) array
        H of each segment.
    lengths : (s,) array
        Of each segment [m].
    d, dd : (s m,) arrays
        Amplitudes and rates of the s segments, from the root on.
    turns : (ROTATIONS,) array
        Workspace.
    position, rate : (6,) arrays
        Output.

    Notes
    -----
    Outward over the segments, in the root's axes, with p and phi the displacement and the rotation
    vector of a segment's tip in its own frame: x += R p, v += w x R p + R p', w += R J(phi) phi',
    R <- R Exp(phi). The inverse left Jacobian of the whole turn gives the rate of its vector.
    """
    m = linear.shape[2]
    straight = 0.0
    x = v = w = (0.0, 0.0, 0.0)
    square_plus(0.0, 0.0, x, turns, TURN)
    for s in range(linear.shape[0]):
        for row in range(COMPONENTS):
            position[row] = rate[row] = 0.0
            for j in range(m):
                position[row] += linear[s, row, j] * d[s * m + j]
                rate[row] += linear[s, row, j] * dd[s * m + j]
        position[0] = lengths[s]
        straight += lengths[s]
        for j in range(m):
            drawn = 0.0
            for k in range(m):
                drawn += shortening[s, j, k] * d[s * m + k]
            position[0] -= 0.5 * drawn * d[s * m + j]
            rate[0] -= drawn * dd[s * m + j]
        arm = rotate(turns, TURN, load(position, 0))
        x = add(x, arm)
        v = add(v, add(cross(w, arm), rotate(turns, TURN, load(rate, 0))))
        phi, turning = load(position, 3), load(rate, 3)
        a, b, c, _, _ = exponential_coefficients(phi[0] ** 2 + phi[1] ** 2 + phi[2] ** 2)
        square_plus(b, c, phi, turns, BENT)
        w = add(w, rotate(turns, TURN, rotate(turns, BENT, turning)))
        square_plus(a, b, phi, turns, BENT)
        multiply(turns, TURN, turns, BENT, turns, NEXT)
        for k in range(9):
            turns[TURN + k] = turns[NEXT + k]
    phi = rotation_vector(turns, TURN)
    _, b, _, slope, _ = exponential_coefficients(phi[0] ** 2 + phi[1] ** 2 + phi[2] ** 2)
    square_plus(-0.5, -0.5 * slope / b, phi, turns, BENT)  # the inverse left Jacobian
    store(position, 0, subtract(x, (straight, 0.0, 0.0)))
    store(position, 3, phi)
    store(rate, 0, v)
    store(rate, 3, rotate(turns, BENT, w))
