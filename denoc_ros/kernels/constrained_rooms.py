"""Vectors and products of the derivatives of constrained dynamics."""

from denoc_ros.kernels.closure import all_rows
from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.constraint_layout import ROWS
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.pointers import part


@inlined
def room(topology, work, places, n, which):
    """Return one of the vectors of the derivatives."""
    m = max(n + at(topology, 0, ROWS), all_rows(topology))
    return part(work, places.vectors + which * m, m)


@inlined
def room_place(topology, places, n, which):
    """Return where it begins in work."""
    return places.vectors + which * max(n + at(topology, 0, ROWS), all_rows(topology))


@inlined
def add_products(work, left, right, rows, inner, columns, out):
    """Add a product of matrices (rows, inner) (inner, columns) to another at `out`."""
    for i in range(rows):
        for k in range(inner):
            factor = work[left + inner * i + k]
            for j in range(columns):
                work[out + columns * i + j] += factor * work[right + columns * k + j]
