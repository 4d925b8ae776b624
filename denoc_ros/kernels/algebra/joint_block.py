"""A 6 x 6 inertia as a tuple of numbers, which the compiler keeps in registers.

A block is (A, B, D): A (force by linear acceleration) and D (torque by angular acceleration) are
symmetric and so have six elements, xx xy xz yy yz zz; B (force by angular acceleration) has its
rows one after another. In work it takes 21 numbers, in this order.
"""

from denoc_ros.kernels.algebra.vector import (
    accumulate,
    add,
    cross,
    dot,
    load,
    store,
    subtract,
    times,
    turned,
)
from denoc_ros.kernels.jit.compiled import inlined


@inlined
def six(a, o):
    """Return the six numbers at offset o of a."""
    return a[o], a[o + 1], a[o + 2], a[o + 3], a[o + 4], a[o + 5]


@inlined
def block_at(work, o):
    """Return the block at offset o of work."""
    b = (load(work, o + 6), load(work, o + 9), load(work, o + 12))
    return six(work, o), b, six(work, o + 15)


@inlined
def write_block(work, o, block):
    """Write a block at offset o of work."""
    a, b, d = block
    store(work, o, a[:3])
    store(work, o + 3, a[3:])
    store(work, o + 6, b[0])
    store(work, o + 9, b[1])
    store(work, o + 12, b[2])
    store(work, o + 15, d[:3])
    store(work, o + 18, d[3:])


@inlined
def accumulate_block(work, o, block):
    """Add a block to the one at offset o of work."""
    a, b, d = block
    accumulate(work, o, a[:3])
    accumulate(work, o + 3, a[3:])
    accumulate(work, o + 6, b[0])
    accumulate(work, o + 9, b[1])
    accumulate(work, o + 12, b[2])
    accumulate(work, o + 15, d[:3])
    accumulate(work, o + 18, d[3:])


@inlined
def wrench_of(block, linear, angular):
    """Return the force and torque that go with an acceleration."""
    a, b, d = block
    force = add(times(a, linear), (dot(b[0], angular), dot(b[1], angular), dot(b[2], angular)))
    across = (
        b[0][0] * linear[0] + b[1][0] * linear[1] + b[2][0] * linear[2],
        b[0][1] * linear[0] + b[1][1] * linear[1] + b[2][1] * linear[2],
        b[0][2] * linear[0] + b[1][2] * linear[1] + b[2][2] * linear[2],
    )
    return force, add(across, times(d, angular))


@inlined
def less_square(s, g, f):
    """Return the six elements of S - g f^T, g a multiple of f."""
    return (
        s[0] - g[0] * f[0],
        s[1] - g[0] * f[1],
        s[2] - g[0] * f[2],
        s[3] - g[1] * f[1],
        s[4] - g[1] * f[2],
        s[5] - g[2] * f[2],
    )


@inlined
def less_row(row, g, n):
    """Return row - g n."""
    return row[0] - g * n[0], row[1] - g * n[1], row[2] - g * n[2]


@inlined
def reduced(block, f, n, inverse):
    """Return a block less [f; n] [f; n]^T times a number."""
    a, b, d = block
    g = (inverse * f[0], inverse * f[1], inverse * f[2])
    h = (inverse * n[0], inverse * n[1], inverse * n[2])
    b = (less_row(b[0], g[0], n), less_row(b[1], g[1], n), less_row(b[2], g[2], n))
    return less_square(a, g, f), b, less_square(d, h, n)


@inlined
def rotated(block, work, rotation):
    """Return a block in the axes to which the rotation at an offset of work takes."""
    a, b, d = block
    x, y, z = load(work, rotation), load(work, rotation + 3), load(work, rotation + 6)
    u = (dot(b[0], x), dot(b[1], x), dot(b[2], x))
    v = (dot(b[0], y), dot(b[1], y), dot(b[2], y))
    w = (dot(b[0], z), dot(b[1], z), dot(b[2], z))
    b = (
        (dot(x, u), dot(x, v), dot(x, w)),
        (dot(y, u), dot(y, v), dot(y, w)),
        (dot(z, u), dot(z, v), dot(z, w)),
    )
    return turned(a, x, y, z), b, turned(d, x, y, z)


@inlined
def columns(b):
    """Return the columns of a 3 x 3 matrix of rows."""
    return (
        (b[0][0], b[1][0], b[2][0]),
        (b[0][1], b[1][1], b[2][1]),
        (b[0][2], b[1][2], b[2][2]),
    )


@inlined
def shifted(block, r):
    """Return a block about a point that lies -r from its own (same axes).

    B -> B - A r x, D -> D - B^T r x + r x B_new.
    """
    a, b, d = block
    # each row of X r x is (row of X) x r
    moved = (
        subtract(b[0], cross((a[0], a[1], a[2]), r)),
        subtract(b[1], cross((a[1], a[3], a[4]), r)),
        subtract(b[2], cross((a[2], a[4], a[5]), r)),
    )
    x, y, z = columns(b)
    p, q, s = columns(moved)
    # only what stands on and above the diagonal of the symmetric D
    u = cross(x, r)
    v = cross(s, r)
    return (
        a,
        moved,
        (
            d[0] - u[0] - (p[1] * r[2] - p[2] * r[1]),
            d[1] - u[1] - (q[1] * r[2] - q[2] * r[1]),
            d[2] - u[2] - v[0],
            d[3] - (y[2] * r[0] - y[0] * r[2]) - (q[2] * r[0] - q[0] * r[2]),
            d[4] - (y[0] * r[1] - y[1] * r[0]) - v[1],
            d[5] - (z[0] * r[1] - z[1] * r[0]) - v[2],
        ),
    )
