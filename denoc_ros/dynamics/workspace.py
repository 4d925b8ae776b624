"""What a kernel writes into, and the record by which the model is handed to it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from denoc_ros.kernels import handle, layout
from denoc_ros.kernels.array_object import FLOAT64, array_type
from denoc_ros.model.lowering import Lowered

Array = NDArray[np.float64]
Int = NDArray[np.int64]
ARRAY_TYPE = array_type()


class Workspace:
    """One caller's workspace over a lowered model.

    Parameters
    ----------
    lowered : Lowered
    reals : (reals,)
        The model's constants; shared, so that a payload set live is seen by all.

    Attributes
    ----------
    handle : int
        What kernels take for the model; valid as long as this object lives.
    work : (work_size,)
    """

    def __init__(self, lowered: Lowered, reals: Array) -> None:
        self.work: Array = np.zeros(lowered.work_size)
        gravity = reals[layout.GRAVITY : layout.GRAVITY + 3]
        self.work[layout.ACCELERATION : layout.ACCELERATION + 3] = -gravity
        self.work[layout.WORLD_ROTATION : layout.WORLD_ROTATION + 9] = np.eye(3).ravel()
        self._diagonals = np.zeros((handle.DIAGONALS, lowered.n))
        self._diagonals[: len(lowered.diagonals)] = lowered.diagonals
        self._alive = (lowered.ints, reals)
        record = np.zeros(handle.RECORD, dtype=np.int64)
        record[handle.INTS_ADDRESS] = lowered.ints.ctypes.data
        record[handle.REALS_ADDRESS] = reals.ctypes.data
        record[handle.WORK_ADDRESS] = self.work.ctypes.data
        record[handle.DIAGONALS_ADDRESS] = self._diagonals.ctypes.data
        record[handle.COORDINATES] = lowered.n
        record[handle.BODIES] = lowered.bodies
        record[handle.INTS_LENGTH] = lowered.ints.size
        record[handle.REALS_LENGTH] = reals.size
        record[handle.WORK_LENGTH] = self.work.size
        record[handle.ARRAY_TYPE] = ARRAY_TYPE
        record[handle.ELEMENT_TYPE] = id(FLOAT64)
        self._record = record
        self.handle = int(record.ctypes.data)
        self._hybrid: tuple[Array, Array] | None = None
        self._splits: dict[tuple[int, ...], Split] = {}

    def hybrid(self) -> tuple[Array, Array]:
        """Return where hybrid derivatives take one state (1, 4, n) and leave their matrices."""
        if self._hybrid is None:
            n = self._diagonals.shape[1]
            self._hybrid = np.empty((1, 4, n)), np.empty((1, n * (4 * n + 1)))
        return self._hybrid

    def split(self, index: Int) -> Split:
        """Return how prescribed joints, index (h,), split the coordinates; kept for next time."""
        key = tuple(index.tolist())
        if key not in self._splits:
            n = self._diagonals.shape[1]
            free = np.setdiff1d(np.arange(n), index)
            flags = np.zeros(n)
            flags[index] = 1.0
            every, by = np.arange(n), (0, 1, 2, 2)
            places = tuple(
                (n * n * matrix + n * rows[:, None] + columns[None, :]).ravel()
                for rows in (index, free)
                for matrix, columns in zip(by, (every, every, index, free), strict=True)
            )
            self._splits[key] = Split(free, flags, places)
        return self._splits[key]


class Split(NamedTuple):
    """Coordinates split into h prescribed joints and the f others."""

    free: Int  # (f,)
    flags: Array  # (n,) 1 at the joints
    places: tuple[Int, ...]  # where the parts of HybridDerivatives stand in the kernel's matrices
