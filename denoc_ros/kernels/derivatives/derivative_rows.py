"""Entries between coordinates of different bodies, and of a beam's own: products of six numbers.

A column j inboard of a row i gives the row's bodies J'_j and J''_j of twist and its derivative by
q_j, J_j and 2 J'_j by q'_j, nothing and J_j by q''_j; they answer with their composite inertia and
turning. A column outboard sends its wrench inward, where every row's own J takes its power.
"""

from denoc_ros.kernels.algebra.lanes import plus, plus_product, product, put, spread, take
from denoc_ros.kernels.algebra.spatial import (
    carried_wrench,
    pair,
    scale_pair,
    store_strided,
    sum_pair,
)
from denoc_ros.kernels.algebra.vector import add, cross, load, rotate, scale, unrotate
from denoc_ros.kernels.dynamics.composite import rigid_wrench
from denoc_ros.kernels.jit.compiled import short_inlined, short_shared
from denoc_ros.kernels.jit.handle import at
from denoc_ros.kernels.layout import derivative_layout as diff_
from denoc_ros.kernels.layout import layout as at_


@short_inlined
def columns_of(topology):
    """Return where the rows over the coordinates begin in work, and how long they are."""
    return at(topology, 0, at_.DERIVED) + diff_.COLUMNS, at(topology, 0, diff_.ROW_LENGTH)


@short_inlined
def own_of(topology, i):
    """Return where the rows over body i's modes begin, their length, and the modal forces'."""
    own = at(topology, i, at_.OWN)
    length = (at(topology, i, at_.MODES) + diff_.LANES - 1) // diff_.LANES * diff_.LANES
    return own, length, own + diff_.OWN_SIZE * length


@short_inlined
def turned_wrench(work, e, w):
    """Return the wrench that a composite body needs for an added angular velocity."""
    return scale(2.0, cross(w, load(work, e + diff_.MOMENTUM))), rotate(work, e + diff_.TURNING, w)


@short_inlined
def half_turning(work, e, x):
    """Return half the power on a twist x of that wrench, per angular velocity."""
    return add(
        cross(load(work, e + diff_.MOMENTUM), x[0]),
        scale(0.5, unrotate(work, e + diff_.TURNING, x[1])),
    )


@short_inlined
def inertial_wrench(work, e, x):
    """Return the wrench that a composite body needs for an acceleration."""
    return rigid_wrench(work, e + diff_.BODY_MASS, x[0], x[1])


@short_inlined
def wrenches_by(work, e, column, rate, bend):
    """Return the wrenches on a composite body by a coordinate, its rate and its acceleration.

    That by the coordinate lacks what is only carried along.
    """
    by_q = sum_pair(inertial_wrench(work, e, bend), turned_wrench(work, e, rate[1]))
    by_rate = scale_pair(2.0, inertial_wrench(work, e, rate))
    by_rate = sum_pair(by_rate, turned_wrench(work, e, column[1]))
    return by_q, by_rate, inertial_wrench(work, e, column)


@short_inlined
def with_carried(work, e, column, by_q):
    """Wrench by a coordinate, with the transport of the wrench there."""
    return sum_pair(by_q, carried_wrench(column, pair(work, e + diff_.WRENCH)))


@short_inlined
def store_wrenches(work, c, length, j, by_q, by_rate, by_acceleration):
    """Write the wrenches that come inward from coordinate j."""
    store_strided(work, c + length * diff_.WRENCH_Q + j, length, by_q)
    store_strided(work, c + length * diff_.WRENCH_QD + j, length, by_rate)
    store_strided(work, c + length * diff_.WRENCH_QDD + j, length, by_acceleration)


@short_inlined
def spread_pair(x):
    """Return the six numbers of a pair, each in every lane."""
    (a, b, c), (d, e, f) = x
    return spread(a), spread(b), spread(c), spread(d), spread(e), spread(f)


@short_inlined
def sixfold(x, work, o, length):
    """Return the product of six numbers with six rows, some columns at once."""
    a = product(x[0], take(work, o))
    b = product(x[1], take(work, o + length))
    a = plus_product(a, x[2], take(work, o + 2 * length))
    b = plus_product(b, x[3], take(work, o + 3 * length))
    a = plus_product(a, x[4], take(work, o + 4 * length))
    b = plus_product(b, x[5], take(work, o + 5 * length))
    return plus(a, b)


@short_inlined
def threefold(x, work, o, length):
    """Return the product of three numbers with three rows, some columns at once."""
    a = product(x[0], take(work, o))
    a = plus_product(a, x[1], take(work, o + length))
    return plus_product(a, x[2], take(work, o + 2 * length))


@short_inlined
def inboard_span(work, c, length, first, last, force, half, o, out):
    """Write a row's entries in columns first .. last - 1, all inboard of it.

    force: the row's wrench per acceleration, half: half that per angular velocity, both spread; o:
    where the row begins in the three results `out`.
    """
    by_q, by_rate, inertia = out
    for j in range(first, last, diff_.LANES):
        k = c + j
        count = last - j
        turning = threefold(half, work, k + length * (diff_.COLUMN_RATE + 3), length)
        total = sixfold(force, work, k + length * diff_.COLUMN_BEND, length)
        put(by_q, o + j, plus(total, plus(turning, turning)), count)
        total = sixfold(force, work, k + length * diff_.COLUMN_RATE, length)
        total = plus(total, threefold(half, work, k + length * (diff_.COLUMN + 3), length))
        put(by_rate, o + j, plus(total, total), count)
        put(inertia, o + j, sixfold(force, work, k + length * diff_.COLUMN, length), count)


@short_inlined
def zero_span(first, last, o, by_q, by_rate, inertia):
    """Write zeros in columns first .. last - 1 of a row."""
    zero = spread(0.0)
    for j in range(first, last, diff_.LANES):
        put(by_q, o + j, zero, last - j)
        put(by_rate, o + j, zero, last - j)
        put(inertia, o + j, zero, last - j)


@short_shared
def inboard_entries(topology, work, n, i, row, last, share, by_q, by_rate, inertia):
    """Write the entries of a row of body i in all columns before `last`.

    share: the row's wrench per acceleration, and half that per angular velocity. A joint's own
    column counts as inboard of it, and so it is of the modes of the same body.
    """
    c, length = columns_of(topology)
    force = spread_pair(share[0])
    half = (spread(share[1][0]), spread(share[1][1]), spread(share[1][2]))
    o = n * row
    run = at(topology, i, at_.RUN)
    while True:
        start = at(topology, run, at_.COORDINATE)
        inboard_span(work, c, length, start, last, force, half, o, (by_q, by_rate, inertia))
        run = at(topology, run, at_.PARENT)
        end = 0
        if run > 0:
            end = (
                at(topology, run, at_.COORDINATE)
                + at(topology, run, at_.JOINT)
                + at(topology, run, at_.MODES)
            )
        zero_span(end, start, o, by_q, by_rate, inertia)
        if run == 0:
            return
        last = end
        run = at(topology, run, at_.RUN)


@short_shared
def outboard_entries(topology, work, n, row, first, last, column, by_q, by_rate, inertia):
    """Write a row's entries in columns first .. last - 1, all outboard of it."""
    c, length = columns_of(topology)
    x = spread_pair(column)
    for j in range(first, last, diff_.LANES):
        k = c + j
        count = last - j
        o = n * row + j
        put(by_q, o, sixfold(x, work, k + length * diff_.WRENCH_Q, length), count)
        put(by_rate, o, sixfold(x, work, k + length * diff_.WRENCH_QD, length), count)
        put(inertia, o, sixfold(x, work, k + length * diff_.WRENCH_QDD, length), count)
