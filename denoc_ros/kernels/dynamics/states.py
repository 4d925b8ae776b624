"""Kernels of a computation at one state, and of the same over rows of states.

A computation find(handle, *arrays) reads and writes the numbers of one state behind pointers and
returns a status.
"""

from numba import types
from numba.extending import intrinsic

from denoc_ros.kernels import CHECKED
from denoc_ros.kernels.jit.array_object import (
    READABLE,
    WRITABLE,
    array_object,
    content,
    is_matrix,
    is_vector,
)
from denoc_ros.kernels.jit.compiled import NUMBERS, inlined, kernel, rows_kernel
from denoc_ros.kernels.jit.handle import GOOD, MISFIT, coordinates, elements
from denoc_ros.kernels.jit.pointers import CheckedPointer, part

ROWS = types.Array(types.float64, 2, 'C')
POINTER = CheckedPointer(types.float64) if CHECKED else NUMBERS


@inlined
def row_of(array, row):
    """Return a pointer to a row of an array (k, size); a single row is the same for all states."""
    size = array.shape[1]
    return part(elements(array), size * row if array.shape[0] > 1 else 0, size)


@intrinsic
def rows_of(_typing, arrays, row):
    """Return pointers to a row of each of several arrays."""
    kind = types.UniTuple(POINTER, len(arrays))

    def generate(context, builder, sig, args):
        found = [
            context.compile_internal(
                builder, lambda array, row: row_of(array, row), POINTER(ROWS, sig.args[1]),
                [builder.extract_value(args[0], k), args[1]],
            )
            for k in range(len(arrays))
        ]  # fmt: skip
        return context.make_tuple(builder, kind, found)

    return kind(arrays, row), generate


def over_rows(name, find, count):
    """Declare the kernel of a computation on `count` arrays over rows of states.

    It takes a handle, the arrays (k, size), those that are the same for all states as (1, size),
    and the first row and the one after the last; it returns the worst status.
    """

    def over(handle, arrays, first, last):
        worst = GOOD
        for row in range(first, last):
            worst = max(worst, find(handle, *rows_of(arrays, row)))
        return worst

    signature = types.int64(types.int64, types.UniTuple(ROWS, count), types.int64, types.int64)
    return rows_kernel(signature)(_named(over, name, find))


@inlined
def are_states(handle, a, b, c):
    """Say whether three objects are states (n,)."""
    n = coordinates(handle)
    return (
        is_vector(handle, a, n, READABLE)
        and is_vector(handle, b, n, READABLE)
        and is_vector(handle, c, n, READABLE)
    )


def vector_of_state(name, find):
    """Declare the kernel of a computation that writes a vector (n) from three of a state."""

    def at_state(handle, q, qd, third, out):
        if not (
            are_states(handle, q, qd, third)
            and is_vector(handle, out, coordinates(handle), WRITABLE)
        ):
            return MISFIT
        return find(handle, content(q), content(qd), content(third), content(out))

    signature = types.int64(types.int64, *[array_object] * 4)
    return kernel(signature)(_named(at_state, name, find))


def matrices_of_state(name, find):
    """Declare the kernel of a computation that writes three matrices (n, n) from a state."""

    def at_state(handle, q, qd, third, a, b, c):
        n = coordinates(handle)
        if not (
            are_states(handle, q, qd, third)
            and is_matrix(handle, a, n, WRITABLE)
            and is_matrix(handle, b, n, WRITABLE)
            and is_matrix(handle, c, n, WRITABLE)
        ):
            return MISFIT
        return find(
            handle, content(q), content(qd), content(third), content(a), content(b), content(c)
        )

    signature = types.int64(types.int64, *[array_object] * 6)
    return kernel(signature)(_named(at_state, name, find))


def _named(function, name, find):
    """Name a function and place it where its computation is: it is kept and reported by that."""
    symbol = getattr(find, 'symbol', None) or f'{find.__module__}.{find.__qualname__}'
    function.__module__ = symbol.rpartition('.')[0]
    function.__name__ = function.__qualname__ = name
    return function
