"""Numbers of a message of a known layout: compared with the layout, taken and checked in one call.

Most bytes are the same in all messages of a publisher: names, and how many numbers there are.
Those are compared; stamp and numbers are taken. What is wrong with a message that does not pass
is for the caller to find.
"""

import numpy as np
from numba import types

from denoc_ros.kernels.compiled import inlined, kernel
from denoc_ros.kernels.pointers import pointer

OTHER = -(1 << 62)  # instead of a stamp: another layout, or a number that is refused
POSITION, VELOCITY, EFFORT = range(3)
# rows of the bounds of a state
LOWER, UPPER, BACKWARDS, FORWARDS = range(4)
STAMP = 4  # first byte of seconds and nanoseconds
BYTES = types.Array(types.uint8, 1, 'C', readonly=True)


@inlined
def is_alike(raw, pattern, fixed):
    """Say whether a message is as long as the pattern, and the same in its fixed parts."""
    if raw.shape[0] != pattern.shape[0]:
        return False
    for part in range(fixed.shape[0]):
        for place in range(fixed[part, 0], fixed[part, 1]):
            if raw[place] != pattern[place]:
                return False
    return True


@inlined
def is_within(values, row, bounds, low, high):
    """Say whether all numbers of a row are within two rows of bounds: NaN is not."""
    found = True
    for k in range(values.shape[1]):
        found &= bounds[low, k] <= values[row, k] <= bounds[high, k]
    return found


@inlined
def kind_of(values, row):
    """Return 0 if all numbers of a row are finite, 1 if one is NaN, else 2."""
    kind = 0
    for k in range(values.shape[1]):
        if values[row, k] != values[row, k]:
            return 1
        if abs(values[row, k]) == np.inf:
            kind = 2
    return kind


@kernel(
    types.int64(
        BYTES, BYTES, types.int64[:, ::1], types.int64[:, ::1], types.float64[:, ::1],
        types.float64[:, ::1], types.int64[::1],
    )
)  # fmt: skip
def take_joint_state(raw, pattern, fixed, places, bounds, values, given):
    """Take positions, velocities and efforts of a little-endian JointState; return its stamp [ns].

    Parameters
    ----------
    raw, pattern : (bytes,) arrays of uint8
        The message, and one of its layout.
    fixed : (k, 2) array
        First byte of each part that must be as in the pattern, and the byte after its last.
    places : (3, n) array
        First bytes of the numbers of position, velocity and effort; -1 where there are none.
    bounds : (4, n) array
        Least and largest position, least and largest velocity.
    values : (3, n) array
        Output; zeros where nothing is given.
    given : (3,) array
        Output: 1 where position, velocity and effort are given. With a NaN they are not.

    Returns
    -------
    int
        OTHER if the layout is another one, a position NaN, a number infinite or out of bounds.
    """
    if not is_alike(raw, pattern, fixed):
        return OTHER
    start = raw.ctypes.data
    for row in range(3):
        given[row] = 0
        if places[row, 0] >= 0:
            for k in range(values.shape[1]):
                values[row, k] = pointer(start + places[row, k], np.float64)[0]
            kind = kind_of(values, row)
            if kind == 2 or (kind == 1 and row == POSITION):
                return OTHER
            given[row] = 1 - kind
        if given[row] == 0:
            for k in range(values.shape[1]):
                values[row, k] = 0.0
    if given[POSITION] == 0 or not is_within(values, POSITION, bounds, LOWER, UPPER):
        return OTHER
    if given[VELOCITY] == 1 and not is_within(values, VELOCITY, bounds, BACKWARDS, FORWARDS):
        return OTHER
    seconds = np.int64(pointer(start + STAMP, np.int32)[0])
    return 1_000_000_000 * seconds + np.int64(pointer(start + STAMP + 4, np.uint32)[0])
