"""The workspace of the kernels, and the record that passes the model to them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from denoc_ros.kernels import handle, layout
from denoc_ros.kernels.array_object import FLOAT64, array_type
from denoc_ros.kernels.link_side import STATES as LINK_STATES
from denoc_ros.model.arrays import ModelArrays
from denoc_ros.types import Array

Int = NDArray[np.int64]
ARRAY_TYPE = array_type()


class Workspace:
    """One caller's workspace over a arrays model.

    Parameters
    ----------
    arrays : ModelArrays
    constants : (constants,)
        The model's constants; shared, so that a payload set live is seen by all.
    link_side : ndarray, optional
        Those of the robot without springs, where joints are elastic.

    Attributes
    ----------
    handle : int
        What kernels take for the model; valid as long as this object lives.
    work : (work_size,)
    """

    def __init__(
        self, arrays: ModelArrays, constants: Array, link_side: Array | None = None
    ) -> None:
        self.work: Array = np.zeros(arrays.work_size)
        self._gravity = constants[layout.GRAVITY : layout.GRAVITY + 3]
        self.work[layout.BASE_GRAVITY : layout.BASE_GRAVITY + 3] = self._gravity
        self.work[layout.ACCELERATION : layout.ACCELERATION + 3] = -self._gravity
        self.work[layout.WORLD_ROTATION : layout.WORLD_ROTATION + 9] = np.eye(3).ravel()
        self._diagonals = np.zeros((handle.DIAGONALS, arrays.n))
        self._diagonals[: len(arrays.diagonals)] = arrays.diagonals
        self._alive: tuple[object, ...] = (arrays.topology, constants)
        record = np.zeros(handle.RECORD, dtype=np.int64)
        record[handle.TOPOLOGY_ADDRESS] = arrays.topology.ctypes.data
        record[handle.CONSTANTS_ADDRESS] = constants.ctypes.data
        record[handle.WORK_ADDRESS] = self.work.ctypes.data
        record[handle.DIAGONALS_ADDRESS] = self._diagonals.ctypes.data
        record[handle.COORDINATES] = arrays.n
        record[handle.BODIES] = arrays.bodies
        record[handle.TOPOLOGY_LENGTH] = arrays.topology.size
        record[handle.CONSTANTS_LENGTH] = constants.size
        record[handle.WORK_LENGTH] = self.work.size
        record[handle.ARRAY_TYPE] = ARRAY_TYPE
        record[handle.ELEMENT_TYPE] = id(FLOAT64)
        self._record = record
        self.handle = int(record.ctypes.data)
        self._see_link_side(arrays, link_side)
        self._hybrid: tuple[Array, Array] | None = None
        self._splits: dict[tuple[int, ...], Split] = {}

    def move_base(self, twist: Array, acceleration: Array, rotation: Array | None) -> None:
        """Let the base move: twist and acceleration (6,) in its axes, rotation (3, 3) to world."""
        work = self.work
        gravity = self._gravity if rotation is None else self._gravity @ rotation
        work[layout.BASE_GRAVITY : layout.BASE_GRAVITY + 3] = gravity
        work[layout.VELOCITY : layout.VELOCITY + 3] = twist[:3]
        work[layout.ANGULAR_VELOCITY : layout.ANGULAR_VELOCITY + 3] = twist[3:]
        work[layout.ACCELERATION : layout.ACCELERATION + 3] = acceleration[:3] - gravity
        work[layout.ANGULAR_ACCELERATION : layout.ANGULAR_ACCELERATION + 3] = acceleration[3:]
        if self._chain is not None:
            self._chain.move_base(twist, acceleration, rotation)

    def take_diagonals(self, arrays: ModelArrays) -> None:
        """Go on with other terms along the coordinates, of a model that is the same otherwise."""
        self._diagonals[: len(arrays.diagonals)] = arrays.diagonals
        if self._chain is not None and arrays.link_side is not None:
            self._chain.take_diagonals(arrays.link_side)

    def _see_link_side(self, arrays: ModelArrays, constants: Array | None) -> None:
        """Name the robot without springs in the record: this one where there are none."""
        self._record[handle.LINK_SIDE] = self.handle
        self._chain: Workspace | None = None
        if arrays.link_side is None or arrays.link_map is None or constants is None:
            return
        self._chain = type(self)(arrays.link_side, constants)
        self._states: Array = np.zeros((LINK_STATES, arrays.link_side.n))
        self._record[handle.LINK_SIDE] = self._chain.handle
        self._record[handle.LINK_MAP] = arrays.link_map.ctypes.data
        self._record[handle.LINK_STATES] = self._states.ctypes.data
        self._alive = (*self._alive, arrays.link_map)

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
