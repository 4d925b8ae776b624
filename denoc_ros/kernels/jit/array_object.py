"""NumPy arrays passed to a kernel as Python objects, which the kernel unpacks itself.

numba spends 0.1 us to unpack each array of a call from Python, and reads the same few words of
memory. For any other object, or in an interpreter with another layout of these words (see
:func:`array_type`), the kernel returns a misfit, and the kernels for rows do the work.
"""

import ctypes
import sys
import sysconfig

import numpy as np
from numba import types
from numba.extending import NativeValue, intrinsic, models, register_model, unbox

from denoc_ros.kernels.jit.compiled import inlined
from denoc_ros.kernels.jit.handle import ARRAY_TYPE, ELEMENT_TYPE, record_of
from denoc_ros.kernels.jit.pointers import pointer, span

# where things stand in an array object [bytes], of a 64-bit CPython and its numpy
TYPE = 8
DATA = 16
DIMENSIONS = 24  # (32 bits)
SHAPE = 32
DESCRIPTION = 56
FLAGS = 64  # (32 bits)
SIZE = 72

READABLE = 0x101  # C-contiguous, aligned
WRITABLE = 0x501

FLOAT64 = np.dtype(np.float64)
NOWHERE = -1


class ArrayObject(types.Opaque):
    """Numba type of any Python object in the place of an array."""


array_object = ArrayObject('array_object')
register_model(ArrayObject)(models.OpaqueModel)


@unbox(ArrayObject)
def _as_it_is(_kind, value, _context):
    return NativeValue(value)


@intrinsic
def address_of(_typing, array):
    """Return the address of an array object."""

    def generate(context, builder, _signature, args):
        return builder.ptrtoint(args[0], context.get_value_type(types.int64))

    return types.int64(array), generate


@inlined
def is_array(handle, array, dimensions, flags):
    """Say whether an object is a float64 array of so many dimensions with these flags."""
    record = record_of(handle)
    start = address_of(array)
    if pointer(start + TYPE, np.int64)[0] != record[ARRAY_TYPE]:
        return False
    return (
        pointer(start + DESCRIPTION, np.int64)[0] == record[ELEMENT_TYPE]
        and pointer(start + DIMENSIONS, np.int32)[0] == dimensions
        and pointer(start + FLAGS, np.int32)[0] & flags == flags
    )


@inlined
def length(array, axis):
    """Return the length of an array along an axis."""
    return pointer(pointer(address_of(array) + SHAPE, np.int64)[0], np.int64)[axis]


@inlined
def is_vector(handle, array, n, flags):
    """Say whether an object is a float64 array (n,) with these flags."""
    return is_array(handle, array, 1, flags) and length(array, 0) == n


@inlined
def is_matrix(handle, array, n, flags):
    """Say whether an object is a float64 array (n, n) with these flags."""
    return is_array(handle, array, 2, flags) and length(array, 0) == n and length(array, 1) == n


@inlined
def element_count(array):
    """Return the number of elements of an array object of one or two dimensions."""
    if pointer(address_of(array) + DIMENSIONS, np.int32)[0] == 2:
        return length(array, 0) * length(array, 1)
    return length(array, 0)


@inlined
def content(array):
    """Return a pointer to the elements of an array object."""
    start = pointer(address_of(array) + DATA, np.int64)[0]
    return span(start, element_count(array), np.float64)


def _words(array: np.ndarray) -> tuple[int, ...]:
    """Words at the offsets where a kernel reads an array's properties."""
    raw = ctypes.string_at(id(array), SIZE)
    spans = ((TYPE, 8), (DATA, 8), (DIMENSIONS, 4), (SHAPE, 8), (DESCRIPTION, 8), (FLAGS, 4))
    return tuple(int.from_bytes(raw[at : at + size], sys.byteorder) for at, size in spans)


def array_type() -> int:
    """Return the address by which kernels know an array, NOWHERE if they cannot look into one."""
    if (
        sys.implementation.name != 'cpython'
        or sys.maxsize != 2**63 - 1
        or sysconfig.get_config_var('Py_GIL_DISABLED')
        or object.__basicsize__ != DATA
        or np.ndarray.__basicsize__ < SIZE
    ):
        return NOWHERE
    for array in (np.zeros(3), np.zeros((5, 2)), np.zeros((4, 3), order='F')):
        kind, data, dimensions, shape, description, flags = _words(array)
        if (
            (kind, data, description) != (id(np.ndarray), array.ctypes.data, id(array.dtype))
            or dimensions != array.ndim
            or tuple((ctypes.c_int64 * array.ndim).from_address(shape)) != array.shape
            or bool(flags & WRITABLE == WRITABLE) != array.flags.carray
        ):
            return NOWHERE
    return id(np.ndarray)
