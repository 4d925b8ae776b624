"""Deflections of the tips of beams, and their rates, from rows of the model."""

from denoc_ros.kernels.compiled import kernel

COMPONENTS = 6  # displacement and rotation


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
