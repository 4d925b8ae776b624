"""The way of derivatives of constrained dynamics from work to the results' arrays."""

import numpy as np

from denoc_ros.kernels import constrained_derivative_layout as cdiff_
from denoc_ros.kernels.compiled import inlined, merged
from denoc_ros.kernels.constrained_rooms import room
from denoc_ros.kernels.constraint_layout import ROWS
from denoc_ros.kernels.constraint_rates import places_of
from denoc_ros.kernels.handle import GOOD, NOT_FINITE, at, coordinates, model_arrays
from denoc_ros.kernels.pointers import beyond, span
from denoc_ros.kernels.vector import all_finite


@inlined
def deliver(work, source, rows, n, target, row):
    """Copy a matrix (rows, n) to row `row` of an array at an address; say if it is finite."""
    size = rows * n
    out = span(target + 8 * size * row, size, np.float64)
    for k in range(size):
        out[k] = work[source + k]
    return all_finite(out, size)


@inlined
def deliver_split(work, source, rows, n, joints, targets, row):
    """Copy columns of actuated coordinates to one array and the others to another.

    joints: the actuated coordinates, how many they are and their flags; targets: two addresses.
    """
    actuated, count, flags = joints
    size = rows * count
    out = span(targets[0] + 8 * size * row, size, np.float64)
    for i in range(rows):
        for c in range(count):
            out[count * i + c] = work[source + n * i + actuated[c]]
    rest = span(targets[1] + 8 * rows * n * row, rows * n, np.float64)
    for i in range(rows):
        for j in range(n):
            rest[n * i + j] = work[source + n * i + j] if flags[j] == 0.0 else 0.0
    return all_finite(out, size) and all_finite(rest, rows * n)


@inlined
def deliver_three(work, source, block, rows, n, joints, verb, targets, row):
    """Copy three matrices (rows, n), `block` apart, to arrays; say if they are finite."""
    good = deliver(work, source, rows, n, targets[0], row)
    good = deliver(work, source + block, rows, n, targets[1], row) and good
    source += 2 * block
    if verb == cdiff_.HYBRID:
        rest = beyond(targets, 2)
        return good and deliver_split(work, source, rows, n, joints, rest, row)
    return good and deliver(work, source, rows, n, targets[2], row)


@merged
def deliver_all(handle, verb, actuated, count, targets, row):
    """Copy the results to row `row` of the arrays at some addresses; return the status."""
    topology, _constants, work, _diagonals, _bodies = model_arrays(handle)
    n = coordinates(handle)
    places, hard = places_of(topology, n), at(topology, 0, ROWS)
    joints = actuated, count, room(topology, work, places, n, cdiff_.FLAGS)
    good, step = True, 4 if verb == cdiff_.HYBRID else 3
    if verb != cdiff_.FORWARD:
        good = deliver_three(work, places.torques, n * n, count, n, joints, verb, targets, row)
        targets = beyond(targets, step)
    if verb != cdiff_.INVERSE:
        good = deliver_three(work, places.motion, n * n, n, n, joints, verb, targets, row) and good
        targets = beyond(targets, step)
    good = (
        deliver_three(work, places.pushes, hard * n, hard, n, joints, verb, targets, row) and good
    )
    return GOOD if good else NOT_FINITE
