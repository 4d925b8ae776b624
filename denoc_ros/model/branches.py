"""Branches of a tree and the ranges of their rows, for passes over many coordinates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from denoc_ros.kernels import layout

Row = NDArray[np.int64]


def _end(row: Row) -> int:
    """Return the index after a body's own coordinates."""
    return int(row[layout.COORDINATE] + row[layout.JOINT] + row[layout.MODES])


def mark_branches(rows: Sequence[Row]) -> int:
    """Fill in the branches in the rows of the base and the bodies.

    Parameters
    ----------
    rows : (1 + bodies) rows, depth first
        Rows so far; BRANCH_END, RUN, SIBLING and SLOT are written.

    Returns
    -------
    slots : int
        How many right-hand sides are under way at once where branches meet.
    """
    latest: dict[int, int] = {}  # the last child so far of each carrier
    for i, row in enumerate(rows[1:], start=1):
        parent = int(row[layout.PARENT])
        row[layout.BRANCH_END] = _end(row)
        row[layout.RUN] = rows[i - 1][layout.RUN] if parent == i - 1 and i > 1 else i
        row[layout.SIBLING] = latest.get(parent, 0)
        latest[parent] = i
    for row in reversed(rows[1:]):
        carrier = rows[int(row[layout.PARENT])]
        carrier[layout.BRANCH_END] = max(carrier[layout.BRANCH_END], row[layout.BRANCH_END])
    for i, row in enumerate(rows[1:], start=1):
        parent = int(row[layout.PARENT])
        apart = parent > 0 and latest[parent] != i
        row[layout.SLOT] = rows[parent][layout.SLOT] + int(apart)
    return 1 + max((int(row[layout.SLOT]) for row in rows[1:]), default=0)
