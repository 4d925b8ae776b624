"""A model handed to a kernel as one number, the address of a record of addresses.

Kernels see arrays as bare pointers: numba counts references to arrays by calls that cost more than
what stands between them, and takes negative indices into account. The record and the arrays it
names are kept alive by who made it.
"""

import numpy as np
from numba import types
from numba.extending import intrinsic

from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.layout import INTS

# elements of the record
INTS_ADDRESS = 0
REALS_ADDRESS = 1
WORK_ADDRESS = 2
DIAGONALS_ADDRESS = 3
COORDINATES = 4
BODIES = 5
ARRAY_TYPE = 6  # addresses of numpy's array type and of its float64 (see array_object)
ELEMENT_TYPE = 7
RECORD = 8

# rows of the (8, n) array of diagonals and scratch
STIFFNESS = 0
DAMPING = 1
FRICTION = 2
ARMATURE = 3
ZERO = 4
SCRATCH = 5
SINE = 6
COSINE = 7
DIAGONALS = 8

# what a kernel returns
GOOD = 0
NOT_FINITE = 1
SINGULAR = 2
MISFIT = 3


@intrinsic
def pointer(_typing, address, dtype):
    """Return an address as a pointer to numbers of a type."""
    kind = types.CPointer(dtype.dtype)

    def generate(context, builder, _signature, args):
        return builder.inttoptr(args[0], context.get_value_type(kind))

    return kind(address, dtype), generate


@intrinsic
def beyond(_typing, start, count):
    """Return the pointer to what stands `count` elements after the start of another."""

    def generate(_context, builder, _signature, args):
        return builder.gep(args[0], [args[1]])

    return start(start, count), generate


@inlined
def elements(array):
    """Return a pointer to the elements of a C-contiguous float64 array."""
    return pointer(array.ctypes.data, np.float64)


@inlined
def record_of(handle):
    """Return the record of a model."""
    return pointer(handle, np.int64)


@inlined
def coordinates(handle):
    """Return the number of coordinates of a model."""
    return record_of(handle)[COORDINATES]


@inlined
def model_arrays(handle):
    """Return ints, reals, work, the rows of the diagonals and the number of bodies of a model."""
    record = record_of(handle)
    n = record[COORDINATES]
    rows = pointer(record[DIAGONALS_ADDRESS], np.float64)
    return (
        pointer(record[INTS_ADDRESS], np.uint32),
        pointer(record[REALS_ADDRESS], np.float64),
        pointer(record[WORK_ADDRESS], np.float64),
        (
            beyond(rows, STIFFNESS * n),
            beyond(rows, DAMPING * n),
            beyond(rows, FRICTION * n),
            beyond(rows, ARMATURE * n),
            beyond(rows, ZERO * n),
            beyond(rows, SCRATCH * n),
            beyond(rows, SINE * n),
            beyond(rows, COSINE * n),
        ),
        record[BODIES],
    )


@inlined
def at(ints, row, column):
    """Return an element of the unsigned table as a number the compiler knows is not negative."""
    return np.int64(ints[INTS * row + column])
