"""Validation of users' arrays before the kernels: the only place that checks arguments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from denoc_ros.errors import SolverError, StateError
from denoc_ros.model.tree import Tree
from denoc_ros.types import Array


def as_rows(name: str, value: ArrayLike, n: int) -> Array:
    """Return a C-contiguous float64 array of shape (n,) or (k, n).

    Raises
    ------
    StateError
        For another shape, or numbers that are not real.
    """
    if type(value) is np.ndarray and value.dtype == np.float64 and value.flags.carray:
        array: Array = value
    else:
        array = _converted(name, value)
    if array.shape == (n,) or (array.ndim == 2 and array.shape[1] == n):
        return array
    raise StateError(f'{name} must have shape ({n},) or (k, {n}), got {array.shape}')


def as_states(name: str, value: ArrayLike, n: int) -> Array:
    """Return finite states (n,) or (k, n) as :func:`as_rows` does."""
    array = as_rows(name, value, n)
    # a look at all elements at once; an overflow of their squares is looked into
    if not np.vdot(array, array) < np.inf:
        require_finite({name: array})
    return array


def as_vector(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return a finite C-contiguous float64 array of just this shape, or raise StateError."""
    array = _converted(name, value)
    if array.shape != shape:
        raise StateError(f'{name} must have shape {shape}, got {array.shape}')
    require_finite({name: array})
    return array


def _converted(name: str, value: ArrayLike) -> Array:
    try:
        array: NDArray[Any] = np.asarray(value)
    except ValueError as error:
        raise StateError(f'{name} must be an array of real numbers, got {value!r}') from error
    if array.dtype.kind not in 'iuf':
        raise StateError(f'{name} must be real numbers (float64), got dtype {array.dtype}')
    # a read-only or strided array would make numba compile another signature
    return np.require(array, dtype=np.float64, requirements=['C', 'A', 'W'])


def as_output(out: Array | None, shape: tuple[int, ...]) -> Array:
    """Return the caller's output array after a check, or a new one."""
    if out is None:
        return np.empty(shape)
    if (
        type(out) is np.ndarray
        and out.dtype == np.float64
        and out.shape == shape
        and out.flags.carray
    ):
        return out
    raise StateError(
        f'out must be a writable C-contiguous float64 array of shape {shape}, '
        f'got {getattr(out, "dtype", type(out))} of shape {getattr(out, "shape", None)}'
    )


def as_outputs(out: Sequence[Array] | None, shapes: Sequence[tuple[int, ...]]) -> list[Array]:
    """Return the caller's output arrays after a check, or new ones."""
    if out is None:
        return [np.empty(shape) for shape in shapes]
    if len(out) != len(shapes):
        raise StateError(f'out must be {len(shapes)} arrays, got {len(out)}')
    return [as_output(one, shape) for one, shape in zip(out, shapes, strict=True)]


def require_finite(arguments: dict[str, Array]) -> None:
    """Raise StateError naming the first argument, and its element, that is not finite."""
    for name, array in arguments.items():
        if not np.isfinite(array).all():
            where = tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])
            raise StateError(f'{name} must be finite, got {array[where]} at index {where}')


def same_rows(arrays: Sequence[Array]) -> list[Array]:
    """Return the arrays all as (k, n), single states repeated; raise StateError if k differs.

    Where all are single states, k is 1.
    """
    counts = {len(array) for array in arrays if array.ndim == 2}
    if len(counts) > 1:
        raise StateError(f'states must have the same number of rows, got {sorted(counts)}')
    k = counts.pop() if counts else 1
    if k == 1:
        return [array if array.ndim == 2 else array[None] for array in arrays]
    return [array if array.ndim == 2 else np.tile(array, (k, 1)) for array in arrays]


def require_rotors(tree: Tree) -> None:
    """Raise SolverError where the motor side of an elastic joint has no inertia."""
    joints = tree.joints.values()
    without = [j.name for j in joints if j.spring is not None and not j.armature > 0.0]
    if without:
        raise SolverError(
            f'{tree.name}: joint {without[0]!r} has a <spring>: the armature of '
            f'<actuator joint="{without[0]}" armature="…"/> must be > 0 where its motor side is '
            'not held, got none'
        )
