"""Many right-hand sides of the articulated factors at once: X becomes I_ff^-1 X, O(n) a column.

Three matrices X go together, so that a body's factors are looked up once.

What :mod:`denoc_ros.kernels.dynamics.articulated` left at ELIMINATED of each body (P^T M P +
shift = L D L^T, W = six rows of M P times L^-T) serves every column. Inward y = L^-1 (x - P^T p),
where the carrier sees p + W D^-1 y; outward x = L^-T (D^-1 (y - W^T a)), where what is carried
sees a + P x. Rows of held joints stay as they are.
"""

from denoc_ros.kernels.algebra.lanes import (
    plus,
    plus_product,
    product,
    put,
    put_all,
    spread,
    take,
    take_some,
)
from denoc_ros.kernels.algebra.spatial import (
    pair,
    scale_pair,
    store_pair,
    strided,
    wrench_about_origin,
)
from denoc_ros.kernels.algebra.vector import load
from denoc_ros.kernels.derivatives.derivative_rows import columns_of, sixfold, spread_pair
from denoc_ros.kernels.dynamics.articulated import free_joint
from denoc_ros.kernels.jit.compiled import inlined, shared
from denoc_ros.kernels.jit.handle import at
from denoc_ros.kernels.layout import derivative_layout as diff_
from denoc_ros.kernels.layout import layout as at_


@inlined
def factor_place(topology, held, i):
    """Return the number of free coordinates of body i and where W and L of it stand."""
    k = free_joint(topology, held, i) + at(topology, i, at_.MODES)
    w = at(topology, i, at_.ELIMINATED)
    return k, w, w + 6 * k


@inlined
def pivot_inverse(topology, work, i, k, factor, r):
    """Return the inverse of pivot r of body i."""
    if at(topology, i, at_.MODES) == 0:
        return work[factor + 1]  # a rigid body keeps y before it
    return work[factor + (k + 1) * r]


@shared
def factors_to_base(topology, work, held, bodies):
    """Turn every body's W from body axes to base axes about the base's origin."""
    for i in range(1, bodies + 1):
        k, w, _ = factor_place(topology, held, i)
        o = at(topology, i, at_.WORK)
        x = load(work, o + at_.WORLD_POSITION)
        for r in range(k):
            f, t = pair(work, w + 6 * r)
            store_pair(work, w + 6 * r, wrench_about_origin(work, o + at_.WORLD_ROTATION, x, f, t))


@inlined
def less_sixfold(value, x, work, o, length):
    """Return a value less the product of six numbers, spread, with six rows."""
    return plus_product(value, spread(-1.0), sixfold(x, work, o, length))


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
def take_three(x, o, count):
    """Return the first `count` numbers from an offset of three matrices."""
    return take_some(x[0], o, count), take_some(x[1], o, count), take_some(x[2], o, count)


@inlined
def put_three(x, o, values, count):
    """Write the first `count` numbers from an offset of three matrices."""
    put(x[0], o, values[0], count)
    put(x[1], o, values[1], count)
    put(x[2], o, values[2], count)


@inlined
def passing_place(topology, i):
    """Offset of body i's passing loads; the second and third matrix come after."""
    c, length = columns_of(topology)
    return c + length * (diff_.PASSING + diff_.PASSING_ROWS * at(topology, i, at_.SLOT))


@shared
def clear(work, o, length, n):
    """Write zeros to all that passes through a body."""
    for row in range(o, o + diff_.PASSING_ROWS * length, length):
        for j in range(0, n, diff_.LANES):
            put_all(work, row + j, spread(0.0))


@shared
def copy_passing(work, target, source, length, n):
    """Let the same pass through one body as through another."""
    for row in range(0, diff_.PASSING_ROWS * length, length):
        for j in range(row, row + n, diff_.LANES):
            put_all(work, target + j, take(work, source + j))


@shared
def add_passing(work, target, source, length, n):
    """Add one body's passing loads to another's."""
    for row in range(0, diff_.PASSING_ROWS * length, length):
        for j in range(row, row + n, diff_.LANES):
            put_all(work, target + j, plus(take(work, target + j), take(work, source + j)))


@shared
def take_power(work, o, length, column, n, x, row):
    """Subtract from a row of each X the power of the wrenches at o on a column."""
    six = spread_pair(column)
    for j in range(0, n, diff_.LANES):
        values = take_three(x, row + j, n - j)
        values = (
            less_sixfold(values[0], six, work, o + j, length),
            less_sixfold(values[1], six, work, o + 6 * length + j, length),
            less_sixfold(values[2], six, work, o + 12 * length + j, length),
        )
        put_three(x, row + j, values, n - j)


@shared
def pass_on(work, o, length, column, factor, n, x, row):
    """Add a column times a row of each X and a factor to the elements at o."""
    six = spread_pair(scale_pair(factor, column))
    for j in range(0, n, diff_.LANES):
        values = take_three(x, row + j, n - j)
        add_sixfold(values[0], six, work, o + j, length)
        add_sixfold(values[1], six, work, o + 6 * length + j, length)
        add_sixfold(values[2], six, work, o + 12 * length + j, length)


@shared
def combine(own, factor, n, x, target, source):
    """Replace a row of each X by `own` times itself and a factor times another row."""
    a, b = spread(own), spread(factor)
    for j in range(0, n, diff_.LANES):
        count = n - j
        here, there = take_three(x, target + j, count), take_three(x, source + j, count)
        values = (
            plus_product(product(a, here[0]), b, there[0]),
            plus_product(product(a, here[1]), b, there[1]),
            plus_product(product(a, here[2]), b, there[2]),
        )
        put_three(x, target + j, values, count)


@inlined
def row_of(topology, n, i, free, r):
    """Return where the row of X of body i's r-th free coordinate begins."""
    return n * (at(topology, i, at_.COORDINATE) + at(topology, i, at_.JOINT) - free + r)


@inlined
def inward_body(topology, work, held, n, i, x):
    """Eliminate body i's free coordinates from each X."""
    c, length = columns_of(topology)
    passing = passing_place(topology, i)
    free = free_joint(topology, held, i)
    k, w, factor = factor_place(topology, held, i)
    for r in range(k):
        row = row_of(topology, n, i, free, r)
        if r < free:
            column = strided(
                work, c + length * diff_.COLUMN + at(topology, i, at_.COORDINATE), length
            )
            take_power(work, passing, length, column, n, x, row)
        for s in range(r):
            entry = work[factor + k * r + s]
            combine(1.0, -entry, n, x, row, row_of(topology, n, i, free, s))
    for r in range(k):
        inverse = pivot_inverse(topology, work, i, k, factor, r)
        row = row_of(topology, n, i, free, r)
        pass_on(work, passing, length, pair(work, w + 6 * r), inverse, n, x, row)


@inlined
def inward_carrier(topology, work, n, i, x):
    """Pass body i's loads through its carrier's modal rows."""
    _, length = columns_of(topology)
    p = at(topology, i, at_.PARENT)
    passing, target = passing_place(topology, i), passing_place(topology, p)
    if at(topology, i, at_.SECTION) > 0:
        j = at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT)
        for k in range(at(topology, p, at_.MODES)):
            column = pair(work, at(topology, i, at_.DERIVED) + diff_.SEEN + diff_.SEEN_SIZE * k)
            take_power(work, passing, length, column, n, x, n * (j + k))
    if p > 0 and target != passing:
        add_passing(work, target, passing, length, n)


@inlined
def outward_body(topology, work, held, n, i, x):
    """Write each solution's rows of body i, and the acceleration that it hands on."""
    c, length = columns_of(topology)
    p = at(topology, i, at_.PARENT)
    passing, source = passing_place(topology, i), passing_place(topology, p)
    if p == 0:
        clear(work, passing, length, n)
    elif source != passing:
        copy_passing(work, passing, source, length, n)
    if at(topology, i, at_.SECTION) > 0:
        j = at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT)
        for k in range(at(topology, p, at_.MODES)):
            column = pair(work, at(topology, i, at_.DERIVED) + diff_.SEEN + diff_.SEEN_SIZE * k)
            pass_on(work, passing, length, column, 1.0, n, x, n * (j + k))
    free = free_joint(topology, held, i)
    k, w, factor = factor_place(topology, held, i)
    for r in range(k - 1, -1, -1):
        row = row_of(topology, n, i, free, r)
        inverse = pivot_inverse(topology, work, i, k, factor, r)
        turned = scale_pair(inverse, pair(work, w + 6 * r))
        combine(inverse, 0.0, n, x, row, row)
        take_power(work, passing, length, turned, n, x, row)
        for s in range(r + 1, k):
            entry = work[factor + k * s + r]
            combine(1.0, -entry, n, x, row, row_of(topology, n, i, free, s))
    if free == 1:
        column = strided(work, c + length * diff_.COLUMN + at(topology, i, at_.COORDINATE), length)
        pass_on(work, passing, length, column, 1.0, n, x, row_of(topology, n, i, free, 0))


@shared
def solve_columns(n, topology, work, bodies, held, x):
    """Replace each of three X (n, n) by I_ff^-1 X in the rows of free coordinates."""
    _, length = columns_of(topology)
    for i in range(bodies, 0, -1):
        if i == bodies or at(topology, i + 1, at_.PARENT) != i:
            clear(work, passing_place(topology, i), length, n)
        inward_body(topology, work, held, n, i, x)
        inward_carrier(topology, work, n, i, x)
    for i in range(1, bodies + 1):
        outward_body(topology, work, held, n, i, x)
