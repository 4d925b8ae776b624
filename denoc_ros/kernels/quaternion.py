"""The unit quaternion of a rotation."""

import numpy as np

from denoc_ros.kernels.compiled import kernel


@kernel('void(float64[:, ::1], float64[::1])')
def write_quaternion(pose, out):
    """Write x, y, z, w (w >= 0, or the first other > 0) of the rotation in a pose (3 or 4 rows).

    Of the columns of 4 q q^T that with the largest norm, which never divides by a small number.
    """
    a, e, i = pose[0, 0], pose[1, 1], pose[2, 2]
    w = 1.0 + a + e + i
    x, y, z = 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i
    xy, xz, yz = pose[0, 1] + pose[1, 0], pose[0, 2] + pose[2, 0], pose[1, 2] + pose[2, 1]
    xw, yw, zw = pose[2, 1] - pose[1, 2], pose[0, 2] - pose[2, 0], pose[1, 0] - pose[0, 1]
    if x >= y and x >= z and x >= w:
        column = x, xy, xz, xw
    elif y >= z and y >= w:
        column = xy, y, yz, yw
    elif z >= w:
        column = xz, yz, z, zw
    else:
        column = xw, yw, zw, w
    norm = np.sqrt(column[0] ** 2 + column[1] ** 2 + column[2] ** 2 + column[3] ** 2)
    scale = -1.0 / norm if column[3] < 0.0 else 1.0 / norm
    out[0], out[1], out[2], out[3] = (
        scale * column[0], scale * column[1], scale * column[2], scale * column[3]
    )  # fmt: skip
