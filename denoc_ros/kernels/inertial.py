"""Readings of an IMU: angular velocity and specific force of frames, along their own axes."""

from denoc_ros.kernels import layout as at_
from denoc_ros.kernels.compiled import inlined, rows_kernel
from denoc_ros.kernels.handle import (
    GOOD,
    NOT_FINITE,
    at,
    beyond,
    coordinates,
    elements,
    model_arrays,
)
from denoc_ros.kernels.motion import move_body
from denoc_ros.kernels.placement import place_body
from denoc_ros.kernels.vector import all_finite, load, store


@inlined
def place_and_move(topology, constants, work, q, qd, qdd, i):
    """Place row i and write its motion; its carrier's must stand there already."""
    place_body(topology, constants, work, q, i)
    move_body(topology, constants, work, qd, qdd, i)


@rows_kernel(
    'int64(int64, float64[:, ::1], float64[:, ::1], float64[:, ::1], int64[::1], int64, int64, '
    'float64[:, :, ::1])'
)
def inertial_values_rows(handle, q, qd, qdd, frames, first, last, out):
    """Write the readings of frames (rows of the model) in states first .. last - 1 of (k, n).

    out (k, frames, 6): angular velocity, then acceleration less gravity.
    """
    topology, constants, work, _diagonals, bodies = model_arrays(handle)
    n, count = coordinates(handle), frames.shape[0]
    worst = GOOD
    for row in range(first, last):
        a, b, c = (
            beyond(elements(q), n * row),
            beyond(elements(qd), n * row),
            beyond(elements(qdd), n * row),
        )
        found = beyond(elements(out), 6 * count * row)
        for i in range(1, bodies + 1):
            place_and_move(topology, constants, work, a, b, c, i)
        for k in range(count):
            i = frames[k]
            if i > bodies:
                place_and_move(topology, constants, work, a, b, c, i)
            o = at(topology, i, at_.WORK)
            # gravity is an acceleration of the base, upwards
            store(found, 6 * k, load(work, o + at_.ANGULAR_VELOCITY))
            store(found, 6 * k + 3, load(work, o + at_.ACCELERATION))
        if not all_finite(found, 6 * count):
            worst = NOT_FINITE
    return worst
