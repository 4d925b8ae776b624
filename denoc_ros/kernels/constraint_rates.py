"""Rows J of the constraints and their two time derivatives along a motion.

A row's error g is a function of positions alone, so that dg''/dq = J'' and dg''/dq' = 2 J'; with
q' = 0 and q'' = v, d(J v)/dq = J''. A multiplier's unit wrench in the parent's axes, at the
child's origin, has a constant force f and a torque t that turns with the relative rotation: with
the relative columns [l; u] of :mod:`denoc_ros.kernels.relative_columns`, J = f . l + t . u.

Directions r that must agree on both sides (see loop_motion) give along a direction a

    t = (2 h sum R r x (a x r) + (a . e) w) / (1 + c).

Free axes with damping or friction have rows too; their rates are not derivatives of an error, and
in the place of J' stands how the rate changes with q.
"""

from denoc_ros.kernels import constrained_derivative_layout as cdiff_
from denoc_ros.kernels import constraint_layout as loop_
from denoc_ros.kernels.closure import all_rows, constraints
from denoc_ros.kernels.compiled import inlined, merged, shared
from denoc_ros.kernels.constrained_derivative_layout import lay_out
from denoc_ros.kernels.frame_motion import move_world
from denoc_ros.kernels.handle import at, coordinates, model_arrays
from denoc_ros.kernels.layout import COORDINATE
from denoc_ros.kernels.multipliers import columns_of
from denoc_ros.kernels.relative_columns import loop_columns
from denoc_ros.kernels.spatial import dot_pair, pair
from denoc_ros.kernels.vector import add, cross, dot, load, rotate, scale, subtract

NONE = (0.0, 0.0, 0.0)
_lay_out = inlined(lay_out)


@inlined
def places_of(topology, n):
    """Return where the derivatives stand in work."""
    rows = all_rows(topology)
    start = columns_of(at(topology, 0, loop_.CONSTRAINTS_WORK), rows, n) + rows * (n + 3 * rows)
    return _lay_out(
        start,
        at(topology, 0, loop_.ROWS),
        at(topology, 0, loop_.AXIS_ROWS),
        at(topology, 0, loop_.CONSTRAINTS),
        n,
    )


@inlined
def loop_place(topology, places, constraint, n):
    """Return where a loop's relative motion stands."""
    number = constraint - at(topology, 0, loop_.FIRST_CONSTRAINT)
    return places.loops + number * (cdiff_.LOOP_COLUMNS + cdiff_.LOOP_COLUMN * n)


@inlined
def quotient(m, c, dc, ddc):
    """Return m / c of a vector and its two rates by those of both."""
    s = 1.0 / c
    x = scale(s, m[0])
    first = scale(s, subtract(m[1], scale(dc, x)))
    second = subtract(m[2], add(scale(2.0 * dc, first), scale(ddc, x)))
    return x, first, scale(s, second)


@inlined
def direction_rates(constants, work, turn, r, w, al):
    """Return a direction of the child in the parent's axes and its two rates."""
    there = rotate(work, turn, load(constants, r))
    rate = cross(w, there)
    return there, rate, add(cross(al, there), cross(w, rate))


@inlined
def aligned_torque(topology, constants, work, constraint, turn, along, w, al):
    """Return the torque t of directions that must agree, and its two rates.

    turn: where the relative rotation stands, which changes with w and al; along: (3).
    """
    first = at(topology, constraint, loop_.CONSTANTS) + loop_.DIRECTIONS
    first += 3 * (at(topology, constraint, loop_.LINEAR) + at(topology, constraint, loop_.ANGULAR))
    last = first + 3 * at(topology, constraint, loop_.REFERENCES)
    h = 0.5 if at(topology, constraint, loop_.KIND) == loop_.ORIENTED else 1.0
    c, dc, ddc = 0.5 if h == 0.5 else 1.0, 0.0, 0.0
    v, dv, ddv = NONE, NONE, NONE
    m, dm, ddm = NONE, NONE, NONE
    for r in range(first, last, 3):
        here = load(constants, r)
        there, rate, up = direction_rates(constants, work, turn, r, w, al)
        lever = scale(2.0 * h, cross(along, here))
        here = scale(h, here)
        c, dc, ddc = c + dot(here, there), dc + dot(here, rate), ddc + dot(here, up)
        v, dv, ddv = (
            add(v, cross(here, there)),
            add(dv, cross(here, rate)),
            add(ddv, cross(here, up)),
        )
        m, dm, ddm = (
            add(m, cross(there, lever)),
            add(dm, cross(rate, lever)),
            add(ddm, cross(up, lever)),
        )
    e = quotient((scale(2.0, v), scale(2.0, dv), scale(2.0, ddv)), c, dc, ddc)
    s, ds, dds = dot(along, e[0]), dot(along, e[1]), dot(along, e[2])
    m = add(m, scale(s, v))
    dm = add(dm, add(scale(ds, v), scale(s, dv)))
    ddm = add(ddm, add(scale(dds, v), add(scale(2.0 * ds, dv), scale(s, ddv))))
    return quotient((m, dm, ddm), c, dc, ddc)


@inlined
def universal_torque(topology, constants, work, constraint, turn, factor, w, al):
    """Return the torque of a universal joint's row times a factor, and its two rates."""
    c = at(topology, constraint, loop_.CONSTANTS)
    axis = scale(factor, load(constants, c + loop_.FREE_AXIS))
    there, rate, up = direction_rates(constants, work, turn, c + loop_.SECOND_AXIS, w, al)
    return cross(axis, there), cross(axis, rate), cross(axis, up)


@inlined
def put_row(work, columns, o, size, n, force, torque):
    """Write a row and its two rates at o; rows of each stand `size` numbers apart."""
    for j in range(n):
        c = columns + cdiff_.LOOP_COLUMN * j
        column, rate, up = pair(work, c), pair(work, c + 6), pair(work, c + 12)
        t, dt, ddt = torque
        work[o + j] = dot(force, column[0]) + dot(t, column[1])
        work[o + size + j] = dot(force, rate[0]) + dot(t, rate[1]) + dot(dt, column[1])
        total = dot(force, up[0]) + dot(t, up[1]) + 2.0 * dot(dt, rate[1])
        work[o + 2 * size + j] = total + dot(ddt, column[1])


@inlined
def put_axis_row(constants, work, c, loop, o, size, n):
    """Write the row of a free axis, and how its rate changes with q."""
    axis = load(constants, c + loop_.FREE_AXIS)
    slides = constants[c + loop_.SLIDES] == 1.0
    unit = (axis, NONE) if slides else (NONE, axis)
    w = load(work, loop + cdiff_.ANGULAR_VELOCITY)
    for j in range(n):
        k = loop + cdiff_.LOOP_COLUMNS + cdiff_.LOOP_COLUMN * j
        column, rate = pair(work, k), pair(work, k + 6)
        work[o + j] = dot_pair(unit, column)
        # of an angular velocity, whose columns do not commute
        work[o + size + j] = dot_pair(unit, rate) + dot(unit[1], cross(column[1], w))
        work[o + 2 * size + j] = 0.0


@inlined
def put_mimic_row(topology, constants, work, constraint, o, size, n):
    """Write the row of a mimic joint, which is constant."""
    for j in range(n):
        work[o + j] = 0.0
        work[o + size + j] = 0.0
        work[o + 2 * size + j] = 0.0
    factor = constants[at(topology, constraint, loop_.CONSTANTS) + loop_.MULTIPLIER]
    work[o + at(topology, at(topology, constraint, loop_.CHILD), COORDINATE)] += 1.0
    work[o + at(topology, at(topology, constraint, loop_.OTHER), COORDINATE)] -= factor


@merged
def put_loop_rows(topology, constants, work, constraint, loop, out, size, n):
    """Write the rows of a loop, whose relative motion stands at `loop`."""
    c = at(topology, constraint, loop_.CONSTANTS)
    linear, angular = (
        at(topology, constraint, loop_.LINEAR),
        at(topology, constraint, loop_.ANGULAR),
    )
    o = out + n * at(topology, constraint, loop_.ROW)
    columns = loop + cdiff_.LOOP_COLUMNS
    turn = loop + cdiff_.RELATIVE_ROTATION
    w, al = (
        load(work, loop + cdiff_.ANGULAR_VELOCITY),
        load(work, loop + cdiff_.ANGULAR_ACCELERATION),
    )
    still = (NONE, NONE, NONE)
    for k in range(linear):
        along = load(constants, c + loop_.DIRECTIONS + 3 * k)
        put_row(work, columns, o + n * k, size, n, along, still)
    o += n * linear
    kind = at(topology, constraint, loop_.KIND)
    if kind == loop_.UNIVERSAL:
        torque = universal_torque(topology, constants, work, constraint, turn, 1.0, w, al)
        put_row(work, columns, o, size, n, NONE, torque)
    elif kind != loop_.POINT:
        for k in range(angular):
            along = load(constants, c + loop_.DIRECTIONS + 3 * (linear + k))
            torque = aligned_torque(topology, constants, work, constraint, turn, along, w, al)
            put_row(work, columns, o + n * k, size, n, NONE, torque)
    if at(topology, constraint, loop_.AXIS_ROW) > 0:
        o = out + n * at(topology, constraint, loop_.AXIS_ROW)
        put_axis_row(constants, work, c, loop, o, size, n)


@shared
def constraint_rates(handle, q, qd, qdd, out):
    """Write J, J' and J'' (R, n) of all rows at offset `out` of work."""
    topology, constants, work, _diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    places = places_of(topology, n)
    size = all_rows(topology) * n
    move_world(topology, constants, work, bodies, q, qd, qdd, 0)
    for constraint in constraints(topology):
        if at(topology, constraint, loop_.KIND) == loop_.MIMIC:
            o = out + n * at(topology, constraint, loop_.ROW)
            put_mimic_row(topology, constants, work, constraint, o, size, n)
            continue
        loop = loop_place(topology, places, constraint, n)
        loop_columns(topology, constants, work, (q, qd, qdd), constraint, places.frames, loop, n)
        put_loop_rows(topology, constants, work, constraint, loop, out, size, n)
