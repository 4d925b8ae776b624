"""The unit quaternion of a rotation."""

import numpy as np

from denoc_ros.kernels.compiled import inlined, kernel
from denoc_ros.kernels.vector import load


@inlined
def quaternion_of(first, second, third):
    """Return x, y, z, w (w >= 0, or the first other > 0) of a rotation with these three rows.

    Of the columns of 4 q q^T that with the largest norm, which never divides by a small number.
    """
    a, e, i = first[0], second[1], third[2]
    w = 1.0 + a + e + i
    x, y, z = 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i
    xy, xz, yz = first[1] + second[0], first[2] + third[0], second[2] + third[1]
    xw, yw, zw = third[1] - second[2], first[2] - third[0], second[0] - first[1]
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
    return scale * column[0], scale * column[1], scale * column[2], scale * column[3]


@inlined
def rotation_vector(turn, o):
    """Return the rotation vector, at most pi long, of the rotation row-major at offset o."""
    x, y, z, w = quaternion_of(load(turn, o), load(turn, o + 3), load(turn, o + 6))
    sine = np.sqrt(x * x + y * y + z * z)
    stretch = 2.0 * np.arctan2(sine, w) / sine if sine > 0.0 else 2.0
    return stretch * x, stretch * y, stretch * z


@kernel('void(float64[:, ::1], float64[::1])')
def write_quaternion(pose, out):
    """Write x, y, z, w of :func:`quaternion_of` of the rotation in a pose (3 or 4 rows)."""
    out[0], out[1], out[2], out[3] = quaternion_of(pose[0], pose[1], pose[2])
