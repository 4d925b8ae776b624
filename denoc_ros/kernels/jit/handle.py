"""A model passed to a kernel as one number, the address of a record of addresses.

Kernels see arrays as bare pointers: numba's reference counting and its handling of negative
indices cost more than the arithmetic. The owner of the record keeps it and its arrays alive.
"""

import numpy as np

from denoc_ros.kernels.jit.compiled import inlined
from denoc_ros.kernels.jit.pointers import beyond, part, pointer, span
from denoc_ros.kernels.layout.layout import TOPOLOGY_COLUMNS

__all__ = ['beyond', 'pointer']  # kernels import what they need of pointers from here

# elements of the record
TOPOLOGY_ADDRESS = 0
CONSTANTS_ADDRESS = 1
WORK_ADDRESS = 2
DIAGONALS_ADDRESS = 3
COORDINATES = 4
BODIES = 5
ARRAY_TYPE = 6  # addresses of numpy's array type and of its float64 (see array_object)
ELEMENT_TYPE = 7
TOPOLOGY_LENGTH = 8  # numbers of elements, for pointers that check offsets (see pointers)
CONSTANTS_LENGTH = 9
WORK_LENGTH = 10
LINK_SIDE = 11  # handle of the robot without springs, this one's own where there are none
LINK_MAP = 12  # addresses: which coordinates make its own, and where they are gathered
LINK_STATES = 13
RECORD = 14

# rows of the (10, n) array of diagonals and scratch
STIFFNESS = 0
DAMPING = 1
FRICTION = 2
ARMATURE = 3
STIFFNESS3 = 4  # of a spring with s^3
PLAY = 5  # half the backlash of a spring
ZERO = 6
SCRATCH = 7
SINE = 8
COSINE = 9
DIAGONALS = 10

# what a kernel returns
GOOD = 0
NOT_FINITE = 1
SINGULAR = 2
MISFIT = 3


@inlined
def elements(array):
    """Return a pointer to the elements of a C-contiguous float64 array."""
    return span(array.ctypes.data, array.size, np.float64)


@inlined
def record_of(handle):
    """Return the record of a model."""
    return span(handle, RECORD, np.int64)


@inlined
def link_side(handle):
    """Return the handle of the robot without springs, the same where there are none."""
    return record_of(handle)[LINK_SIDE]


@inlined
def coordinates(handle):
    """Return the number of coordinates of a model."""
    return record_of(handle)[COORDINATES]


@inlined
def model_arrays(handle):
    """Return topology, constants, work, the rows of the diagonals and the number of bodies."""
    record = record_of(handle)
    n = record[COORDINATES]
    rows = span(record[DIAGONALS_ADDRESS], DIAGONALS * n, np.float64)
    return (
        span(record[TOPOLOGY_ADDRESS], record[TOPOLOGY_LENGTH], np.uint32),
        span(record[CONSTANTS_ADDRESS], record[CONSTANTS_LENGTH], np.float64),
        span(record[WORK_ADDRESS], record[WORK_LENGTH], np.float64),
        (
            part(rows, STIFFNESS * n, n),
            part(rows, DAMPING * n, n),
            part(rows, FRICTION * n, n),
            part(rows, ARMATURE * n, n),
            part(rows, STIFFNESS3 * n, n),
            part(rows, PLAY * n, n),
            part(rows, ZERO * n, n),
            part(rows, SCRATCH * n, n),
            part(rows, SINE * n, n),
            part(rows, COSINE * n, n),
        ),
        record[BODIES],
    )


@inlined
def at(topology, row, column):
    """Return an element of the unsigned table as a number the compiler knows is not negative."""
    return np.int64(topology[TOPOLOGY_COLUMNS * row + column])
