"""Many right-hand sides of the articulated factors at once: X becomes I_ff^-1 X, O(n) a column.

What :mod:`denoc_ros.kernels.articulated` left at ELIMINATED of each body (P^T M P + shift =
L D L^T, W = six rows of M P times L^-T) serves every column. Inward y = L^-1 (x - P^T p), where
the carrier sees p + W D^-1 y; outward x = L^-T (D^-1 (y - W^T a)), where what is carried sees
a + P x. Rows of held joints stay as they are.
"""

from denoc_ros.kernels.articulated import free_joint
from denoc_ros.kernels.compiled import inlined, shared
from denoc_ros.kernels.derivative_layout import COLUMN, LANES, PASSING, SEEN, SEEN_SIZE
from denoc_ros.kernels.derivative_rows import columns_of, spread_pair
from denoc_ros.kernels.handle import at, beyond
from denoc_ros.kernels.lanes import (
    plus,
    plus_product,
    product,
    put,
    put_all,
    spread,
    take,
    take_some,
)
from denoc_ros.kernels.layout import (
    BRANCH_END,
    COORDINATE,
    DERIVED,
    ELIMINATED,
    JOINT,
    MODES,
    PARENT,
    SECTION,
    SLOT,
    WORK,
    WORLD_POSITION,
    WORLD_ROTATION,
)
from denoc_ros.kernels.spatial import pair, store_pair, strided, wrench_about_origin
from denoc_ros.kernels.vector import load


@inlined
def factor_place(ints, held, i):
    """Return the number of free coordinates of body i and where W and L of it stand."""
    k = free_joint(ints, held, i) + at(ints, i, MODES)
    w = at(ints, i, ELIMINATED)
    return k, w, w + 6 * k


@inlined
def pivot_inverse(ints, work, i, k, factor, r):
    """Return the inverse of pivot r of body i."""
    if at(ints, i, MODES) == 0:
        return work[factor + 1]  # a rigid body keeps y before it
    return work[factor + (k + 1) * r]


@shared
def factors_to_base(ints, work, held, bodies):
    """Turn every body's W from body axes to base axes about the base's origin."""
    for i in range(1, bodies + 1):
        k, w, _ = factor_place(ints, held, i)
        o = at(ints, i, WORK)
        x = load(work, o + WORLD_POSITION)
        for r in range(k):
            f, t = pair(work, w + 6 * r)
            store_pair(work, w + 6 * r, wrench_about_origin(work, o + WORLD_ROTATION, x, f, t))


@inlined
def less_sixfold(value, x, work, o, length):
    """Return a value less the product of six numbers, spread, with six rows."""
    minus = spread(-1.0)
    for_each = product(x[0], take(work, o))
    for_each = plus_product(for_each, x[1], take(work, o + length))
    for_each = plus_product(for_each, x[2], take(work, o + 2 * length))
    for_each = plus_product(for_each, x[3], take(work, o + 3 * length))
    for_each = plus_product(for_each, x[4], take(work, o + 4 * length))
    for_each = plus_product(for_each, x[5], take(work, o + 5 * length))
    return plus_product(value, minus, for_each)


@inlined
def add_sixfold(value, x, work, o, length):
    """Add a value times six numbers, spread, to six rows."""
    put_all(work, o, plus_product(take(work, o), x[0], value))
    o += length
    put_all(work, o, plus_product(take(work, o), x[1], value))
    o += length
    put_all(work, o, plus_product(take(work, o), x[2], value))
    o += length
    put_all(work, o, plus_product(take(work, o), x[3], value))
    o += length
    put_all(work, o, plus_product(take(work, o), x[4], value))
    o += length
    put_all(work, o, plus_product(take(work, o), x[5], value))


@inlined
def clear(work, o, length, first, last):
    """Write zeros in columns first .. last - 1, and lanes beyond, of six rows."""
    for r in range(6):
        for j in range(first, last, LANES):
            put_all(work, o + length * r + j, spread(0.0))


@shared
def take_power(work, o, length, column, x, first, last):
    """Subtract from a row of X the power of the wrenches at o on a column, first .. last - 1."""
    six = spread_pair(column)
    for j in range(first, last, LANES):
        count = last - j
        put(x, j, less_sixfold(take_some(x, j, count), six, work, o + j, length), count)


@shared
def add_rows(work, o, length, column, x, first, last):
    """Add to the six rows at o a column times a row of X, columns first .. last - 1."""
    six = spread_pair(column)
    for j in range(first, last, LANES):
        add_sixfold(take_some(x, j, last - j), six, work, o + j, length)


@shared
def eliminate_row(work, o, length, wrench, inverse, x, first, last):
    """Pass on what a row of y leaves to the carrier: W D^-1 y."""
    six = spread_pair(wrench)
    for j in range(first, last, LANES):
        value = product(spread(inverse), take_some(x, j, last - j))
        add_sixfold(value, six, work, o + j, length)


@shared
def substitute(x, target, source, factor, first, last):
    """Subtract a factor times a row of X, which begins at `source`, from another."""
    value = spread(-factor)
    for j in range(first, last, LANES):
        count = last - j
        row = plus_product(take_some(x, target + j, count), value, take_some(x, source + j, count))
        put(x, target + j, row, count)


@shared
def divide(x, row, inverse, first, last):
    """Multiply a row of X by a number."""
    for j in range(row + first, row + last):
        x[j] *= inverse


@inlined
def row_of(ints, n, i, free, r):
    """Return where the row of X of body i's r-th free coordinate begins."""
    return n * (at(ints, i, COORDINATE) + at(ints, i, JOINT) - free + r)


@inlined
def inward_body(ints, work, held, n, i, x, first, last):
    """Eliminate body i's free coordinates from columns first .. last - 1 of X."""
    c, length = columns_of(ints)
    passing = c + length * (PASSING + 6 * at(ints, i, SLOT))
    free = free_joint(ints, held, i)
    k, w, factor = factor_place(ints, held, i)
    for r in range(k):
        row = row_of(ints, n, i, free, r)
        if r < free:
            column = strided(work, c + length * COLUMN + at(ints, i, COORDINATE), length)
            take_power(work, passing, length, column, beyond(x, row), first, last)
        for s in range(r):
            entry = work[factor + k * r + s]
            substitute(x, row, row_of(ints, n, i, free, s), entry, first, last)
    for r in range(k):
        inverse = pivot_inverse(ints, work, i, k, factor, r)
        row = beyond(x, row_of(ints, n, i, free, r))
        eliminate_row(work, passing, length, pair(work, w + 6 * r), inverse, row, first, last)


@inlined
def inward_carrier(ints, work, n, i, x, first, last):
    """Take what body i passes on from its carrier's modal rows, and hand it on."""
    c, length = columns_of(ints)
    p = at(ints, i, PARENT)
    passing = c + length * (PASSING + 6 * at(ints, i, SLOT))
    if at(ints, i, SECTION) > 0:
        j = at(ints, p, COORDINATE) + at(ints, p, JOINT)
        for k in range(at(ints, p, MODES)):
            column = pair(work, at(ints, i, DERIVED) + SEEN + SEEN_SIZE * k)
            row = beyond(x, n * (j + k))
            take_power(work, passing, length, column, row, first, last)
    target = c + length * (PASSING + 6 * at(ints, p, SLOT))
    if p > 0 and target != passing:
        for r in range(6):
            for j in range(first, last, LANES):
                o = length * r + j
                put_all(work, target + o, plus(take(work, target + o), take(work, passing + o)))


@inlined
def outward_body(ints, work, held, n, i, x, first, last):
    """Write the solution's rows of body i, and the acceleration that it hands on."""
    c, length = columns_of(ints)
    p = at(ints, i, PARENT)
    passing = c + length * (PASSING + 6 * at(ints, i, SLOT))
    source = c + length * (PASSING + 6 * at(ints, p, SLOT))
    if p == 0:
        clear(work, passing, length, first, last)
    elif source != passing:
        for r in range(6):
            for j in range(first, last, LANES):
                put_all(work, passing + length * r + j, take(work, source + length * r + j))
    if at(ints, i, SECTION) > 0:
        j = at(ints, p, COORDINATE) + at(ints, p, JOINT)
        for k in range(at(ints, p, MODES)):
            column = pair(work, at(ints, i, DERIVED) + SEEN + SEEN_SIZE * k)
            add_rows(work, passing, length, column, beyond(x, n * (j + k)), first, last)
    free = free_joint(ints, held, i)
    k, w, factor = factor_place(ints, held, i)
    for r in range(k - 1, -1, -1):
        row = row_of(ints, n, i, free, r)
        take_power(work, passing, length, pair(work, w + 6 * r), beyond(x, row), first, last)
        divide(x, row, pivot_inverse(ints, work, i, k, factor, r), first, last)
        for s in range(r + 1, k):
            entry = work[factor + k * s + r]
            substitute(x, row, row_of(ints, n, i, free, s), entry, first, last)
    if free == 1:
        column = strided(work, c + length * COLUMN + at(ints, i, COORDINATE), length)
        row = beyond(x, row_of(ints, n, i, free, 0))
        add_rows(work, passing, length, column, row, first, last)


@shared
def solve_columns(n, ints, work, bodies, held, x, symmetric):
    """Replace X (n, n) by I_ff^-1 X in the rows of free coordinates.

    symmetric: X is the unit matrix, and the upper half of the result is enough to write.
    """
    c, length = columns_of(ints)
    for i in range(bodies, 0, -1):
        first = at(ints, i, COORDINATE) if symmetric else 0
        last = at(ints, i, BRANCH_END) if symmetric else n
        if i == bodies or at(ints, i + 1, PARENT) != i:
            clear(work, c + length * (PASSING + 6 * at(ints, i, SLOT)), length, 0, n)
        inward_body(ints, work, held, n, i, x, first, last)
        inward_carrier(ints, work, n, i, x, first, last)
    for i in range(1, bodies + 1):
        outward_body(ints, work, held, n, i, x, at(ints, i, COORDINATE) if symmetric else 0, n)
    if symmetric:
        for r in range(n):
            for j in range(r):
                x[n * r + j] = x[n * j + r]
