"""Readings of an IMU: angular velocity and specific force of frames, along their own axes."""

import numpy as np

from denoc_ros.kernels import layout as at_
from denoc_ros.kernels.compiled import inlined, shared
from denoc_ros.kernels.handle import (
    GOOD,
    NOT_FINITE,
    at,
    model_arrays,
)
from denoc_ros.kernels.motion import move_body
from denoc_ros.kernels.placement import place_body
from denoc_ros.kernels.states import over_rows
from denoc_ros.kernels.vector import all_finite, load, store


@inlined
def place_and_move(topology, constants, work, q, qd, qdd, i):
    """Place row i and write its motion; its carrier's must stand there already."""
    place_body(topology, constants, work, q, i)
    move_body(topology, constants, work, qd, qdd, i)


@shared
def find_inertial_values(handle, q, qd, qdd, frames, out):
    """Write the readings (frames, 6): angular velocity, then acceleration less gravity.

    frames: how many there are, then their rows of the model.
    """
    topology, constants, work, _diagonals, bodies = model_arrays(handle)
    count = np.int64(frames[0])
    for i in range(1, bodies + 1):
        place_and_move(topology, constants, work, q, qd, qdd, i)
    for k in range(count):
        i = np.int64(frames[1 + k])
        if i > bodies:
            place_and_move(topology, constants, work, q, qd, qdd, i)
        o = at(topology, i, at_.WORK)
        # gravity is an acceleration of the base, upwards
        store(out, 6 * k, load(work, o + at_.ANGULAR_VELOCITY))
        store(out, 6 * k + 3, load(work, o + at_.ACCELERATION))
    return GOOD if all_finite(out, 6 * count) else NOT_FINITE


inertial_values_rows = over_rows('inertial_values_rows', find_inertial_values, 5)
