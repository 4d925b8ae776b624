"""A model handed to a kernel as one number, the address of a record of addresses.

An array argument costs a call from Python about 0.1 us; a number costs nothing to speak of. The
record and the arrays it names are kept alive by who made it.
"""

import numpy as np
from numba import carray, types
from numba.extending import intrinsic

from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.layout import INTS

# elements of the record
INTS_ADDRESS = 0
REALS_ADDRESS = 1
WORK_ADDRESS = 2
DIAGONALS_ADDRESS = 3
ROWS = 4
REALS_SIZE = 5
WORK_SIZE = 6
COORDINATES = 7
BODIES = 8
RECORD = 9

# rows of the (6, n) array of diagonals and scratch
STIFFNESS = 0
DAMPING = 1
FRICTION = 2
ARMATURE = 3
ZERO = 4
SCRATCH = 5
DIAGONALS = 6

# what a kernel returns
GOOD = 0
NOT_FINITE = 1
SINGULAR = 2
MISFIT = 3


@intrinsic
def pointer(_typing, address):
    """Return an address as a pointer."""

    def generate(context, builder, _signature, args):
        return builder.inttoptr(args[0], context.get_value_type(types.voidptr))

    return types.voidptr(address), generate


@inlined
def model_arrays(handle):
    """Return ints, reals, work, diagonals and the number of bodies of a model."""
    record = carray(pointer(handle), (RECORD,), np.int64)
    return (
        carray(pointer(record[INTS_ADDRESS]), (record[ROWS], INTS), np.uint32),
        carray(pointer(record[REALS_ADDRESS]), (record[REALS_SIZE],), np.float64),
        carray(pointer(record[WORK_ADDRESS]), (record[WORK_SIZE],), np.float64),
        carray(pointer(record[DIAGONALS_ADDRESS]), (DIAGONALS, record[COORDINATES]), np.float64),
        record[BODIES],
    )


@inlined
def at(ints, row, column):
    """Return an element of the unsigned table as a number the compiler knows is not negative."""
    return np.int64(ints[row, column])
