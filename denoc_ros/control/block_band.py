"""Linear equations whose matrix is a band of square blocks."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import as_strided
from scipy.linalg import lapack

from denoc_ros.types import Array


class BlockBand:
    """A square matrix of count x count blocks that couple `reach` neighbours on either side.

    It stands in LAPACK's band storage, so memory and time grow linearly with count.

    Parameters
    ----------
    count, size : int
        Blocks along the diagonal, and rows of a block.
    reach : int
    """

    def __init__(self, count: int, size: int, reach: int) -> None:
        self._count, self._size = count, size
        self._width = (reach + 1) * size - 1
        self._rows = 3 * self._width + 1
        # column by column, as Fortran has it; the first `width` rows take what pivoting fills in
        self._band = np.zeros((count * size, self._rows))

    def blocks(self, offset: int, row: int, column: int, rows: int, columns: int) -> Array:
        """Return a view (count - |offset|, rows, columns) of parts of blocks, to write into.

        Entry k is of the block in block column k + max(0, -offset) and `offset` blocks below the
        diagonal, from its row `row` and column `column`.
        """
        size = self._size
        first = max(0, -offset) * size + column
        start = self._band[first:, 2 * self._width + offset * size + row - column :]
        stride = self._band.itemsize
        along = (size * self._rows * stride, stride, (self._rows - 1) * stride)
        return as_strided(start, (self._count - abs(offset), rows, columns), along)

    def solve(self, right: Array) -> Array | None:
        """Return x (count, size) of matrix x = right, or None where the matrix is singular.

        Several right sides (count, size, m) are solved together. The matrix is lost: its factors
        take its place.
        """
        columns = right.reshape(self._count * self._size, *right.shape[2:])
        _, _, x, info = lapack.dgbsv(
            self._width, self._width, self._band.T, columns, overwrite_ab=1
        )
        return None if info else np.asarray(x).reshape(right.shape)
