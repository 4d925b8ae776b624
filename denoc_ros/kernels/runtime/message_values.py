"""Numbers of messages of a known layout, taken or put in one call.

Most bytes are the same in all messages of a publisher: names, and how many numbers there are.
Of a message that comes these are compared, stamp and numbers are taken and checked; what is wrong
with one that does not pass is for the caller to find. Of messages that leave, only stamps and
numbers are written.
"""

import ctypes

import numpy as np
from numba import types

from denoc_ros.kernels.jit.array_object import NOWHERE, address_of, array_object
from denoc_ros.kernels.jit.compiled import inlined, kernel
from denoc_ros.kernels.jit.pointers import pointer, span

OTHER = -(1 << 62)  # instead of a stamp: another layout, or a number that is refused
POSITION, VELOCITY, EFFORT = range(3)
# rows of the bounds of a state
LOWER, UPPER, BACKWARDS, FORWARDS = range(4)
STAMP = 4  # first byte of seconds and nanoseconds
SECOND = 1_000_000_000  # ns
# elements of a record: addresses and lengths of what a message is compared with and taken to
PATTERN, LENGTH, FIXED, PARTS, PLACES, JOINTS, BOUNDS, VALUES, GIVEN, BYTES_TYPE = range(10)
RECORD = 10
# elements of a record: how many numbers go from where to where, which messages have a stamp, and
# the most seconds that it can say
COPIES, SOURCES, TARGETS, MESSAGES, STAMPED, MOST_SECONDS = range(6)
OUTGOING = 6
# where things stand in a bytes object, of a 64-bit CPython
TYPE, SIZE, CONTENT = 8, 16, 32


def bytes_type() -> int:
    """Return the address by which kernels know bytes, NOWHERE if they cannot look into them."""
    if bytes.__basicsize__ != CONTENT + 1 or object.__basicsize__ != SIZE:
        return NOWHERE
    for raw in (b'', b'some bytes'):
        start = id(raw)
        kind, size = (ctypes.c_int64.from_address(start + at).value for at in (TYPE, SIZE))
        if (kind, size, ctypes.string_at(start + CONTENT, len(raw))) != (id(bytes), len(raw), raw):
            return NOWHERE
    return id(bytes)


@inlined
def is_alike(raw, pattern, fixed, parts):
    """Say whether a message of the pattern's length is the same in its fixed parts."""
    for part in range(parts):
        for place in range(fixed[2 * part], fixed[2 * part + 1]):
            if raw[place] != pattern[place]:
                return False
    return True


@inlined
def is_within(values, joints, row, bounds, low, high):
    """Say whether all numbers of a row are within two rows of bounds: NaN is not."""
    found = True
    for k in range(joints):
        value = values[row * joints + k]
        found &= bounds[low * joints + k] <= value <= bounds[high * joints + k]
    return found


@inlined
def kind_of(values, joints, row):
    """Return 0 if all numbers of a row are finite, 1 if one is NaN, else 2."""
    kind = 0
    for k in range(row * joints, (row + 1) * joints):
        if values[k] != values[k]:
            return 1
        if abs(values[k]) == np.inf:
            kind = 2
    return kind


@kernel(types.int64(types.int64, array_object))
def take_numbers(record, message):
    """Take up to three rows of numbers of a little-endian message; return its stamp [ns].

    Parameters
    ----------
    record : int
        Address of RECORD integers, most of them addresses of what follows.
    message : object
        Bytes.
    pattern : (bytes,) array of uint8
        A message of the layout.
    fixed : (k, 2) array of int64
        First byte of each part that must be as in the pattern, and the byte after its last.
    places : (3, n) array of int64
        First bytes of the numbers of position, velocity and effort; -1 where there are none.
    bounds : (4, n) array
        Least and largest position, least and largest velocity.
    values : (3, n) array
        Output; zeros where nothing is given.
    given : (3,) array of int64
        Output: 1 where position, velocity and effort are given. With a NaN they are not.

    Returns
    -------
    int
        OTHER if the layout is another one, a position NaN, a number infinite or out of bounds.
    """
    known = span(record, RECORD, np.int64)
    start = address_of(message)
    if pointer(start + TYPE, np.int64)[0] != known[BYTES_TYPE]:
        return OTHER
    length, parts, joints = known[LENGTH], known[PARTS], known[JOINTS]
    if pointer(start + SIZE, np.int64)[0] != length:
        return OTHER
    start += CONTENT
    if not is_alike(
        span(start, length, np.uint8), span(known[PATTERN], length, np.uint8),
        span(known[FIXED], 2 * parts, np.int64), parts,
    ):  # fmt: skip
        return OTHER
    places = span(known[PLACES], 3 * joints, np.int64)
    bounds = span(known[BOUNDS], 4 * joints, np.float64)
    values = span(known[VALUES], 3 * joints, np.float64)
    given = span(known[GIVEN], 3, np.int64)
    for row in range(3):
        given[row] = 0
        if places[row * joints] >= 0:
            for k in range(row * joints, (row + 1) * joints):
                values[k] = pointer(start + places[k], np.float64)[0]
            kind = kind_of(values, joints, row)
            if kind == 2 or (kind == 1 and row == POSITION):
                return OTHER
            given[row] = 1 - kind
        if given[row] == 0:
            for k in range(row * joints, (row + 1) * joints):
                values[k] = 0.0
    if given[POSITION] == 0 or not is_within(values, joints, POSITION, bounds, LOWER, UPPER):
        return OTHER
    if given[VELOCITY] == 1 and not is_within(
        values, joints, VELOCITY, bounds, BACKWARDS, FORWARDS
    ):
        return OTHER
    seconds = np.int64(pointer(start + STAMP, np.int32)[0])
    return SECOND * seconds + np.int64(pointer(start + STAMP + 4, np.uint32)[0])


@kernel(types.void(types.int64, types.int64))
def put_numbers(record, stamp_ns):
    """Copy numbers into little-endian messages, and write a stamp [ns] into their headers.

    A stamp that a message cannot say becomes the nearest that it can.

    Parameters
    ----------
    record : int
        Address of OUTGOING integers: COPIES and the addresses of SOURCES and TARGETS (so many
        addresses of doubles each), MESSAGES and the address of STAMPED (so many addresses of
        messages), MOST_SECONDS.
    """
    known = span(record, OUTGOING, np.int64)
    copies, messages = known[COPIES], known[MESSAGES]
    sources = span(known[SOURCES], copies, np.int64)
    targets = span(known[TARGETS], copies, np.int64)
    for k in range(copies):
        pointer(targets[k], np.float64)[0] = pointer(sources[k], np.float64)[0]
    seconds = stamp_ns // SECOND
    rest = stamp_ns - seconds * SECOND
    seconds = min(max(seconds, -known[MOST_SECONDS]), known[MOST_SECONDS])
    stamped = span(known[STAMPED], messages, np.int64)
    for k in range(messages):
        pointer(stamped[k] + STAMP, np.int32)[0] = np.int32(seconds)
        pointer(stamped[k] + STAMP + 4, np.uint32)[0] = np.uint32(rest)
