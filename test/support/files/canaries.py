"""Arrays with guard values before and after them: what writes beside an array is found out."""

from __future__ import annotations

from typing import Any

import numpy as np

from denoc_ros.dynamics.robot_model import Workspace
from denoc_ros.kernels.jit import handle
from denoc_ros.model.arrays import ModelArrays
from denoc_ros.types import Array

ROOM = 64  # elements on each side
# not a number, with a content of its own: what reads it gives no finite result
CANARY = np.uint64(0x7FF8_0BAD_CAFE_0001).view(np.float64)


class Canaries:
    """Makes guarded arrays, and says whether the guards are as they were."""

    def __init__(self) -> None:
        self._buffers: list[tuple[str, Array, int]] = []

    def array(self, what: str, shape: int | tuple[int, ...], values: Any = np.nan) -> Array:
        """Return an array of a shape with values, between guards."""
        size = int(np.prod(shape))
        buffer = np.full(size + 2 * ROOM, CANARY)
        self._buffers.append((what, buffer, size))
        inner = buffer[ROOM : ROOM + size].reshape(shape)
        inner[...] = values
        return inner

    def of(self, what: str, values: Any) -> Array:
        """Return a guarded copy of an array."""
        return self.array(what, np.shape(values), values)

    def check(self) -> None:
        """Assert that nobody has written beside an array."""
        for what, buffer, size in self._buffers:
            for side, guard in (('before', buffer[:ROOM]), ('after', buffer[ROOM + size :])):
                spoiled = np.flatnonzero(guard.view(np.uint64) != CANARY.view(np.uint64))
                assert not len(spoiled), f'{what}: {len(spoiled)} elements {side} it were written'


def guarded_workspace(canaries: Canaries) -> type[Workspace]:
    """Return a workspace whose arrays stand between guards."""

    class Guarded(Workspace):
        def __init__(
            self, arrays: ModelArrays, constants: Array, link_side: Array | None = None
        ) -> None:
            super().__init__(arrays, constants, link_side)
            self.work = canaries.of('workspace', self.work)
            self._diagonals = canaries.of('diagonals', self._diagonals)
            self._record[handle.WORK_ADDRESS] = self.work.ctypes.data
            self._record[handle.DIAGONALS_ADDRESS] = self._diagonals.ctypes.data
            if arrays.link_side is not None:
                self._states = canaries.of('states of the links', self._states)
                self._record[handle.LINK_STATES] = self._states.ctypes.data

    return Guarded
