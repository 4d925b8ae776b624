"""Rows J of the constraints and their two time derivatives along a motion.

A row's error g is a function of positions alone, so that dg''/dq = J'' and dg''/dq' = 2 J'; with
q' = 0 and q'' = v, d(J v)/dq = J''. A multiplier's unit wrench in the parent's axes, at the
child's origin, has a constant force f and a torque t that turns with the relative rotation: with
the relative columns [l; u] of :mod:`denoc_ros.kernels.relative_columns`, J = f . l + t . u.

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
from denoc_ros.kernels.loop_motion import NONE, aligned_error, aligned_torque, crossed_directions
from denoc_ros.kernels.multipliers import columns_of
from denoc_ros.kernels.relative_columns import loop_columns
from denoc_ros.kernels.spatial import dot_pair, pair
from denoc_ros.kernels.vector import cross, dot, load, scale

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
def universal_torque(topology, constants, work, constraint, turn, factor, w, al):
    """Return the torque of a universal joint's row times a factor, and its two rates."""
    axis, (there, rate, up) = crossed_directions(
        topology, constants, work, constraint, turn, w, al
    )
    axis = scale(factor, axis)
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
        error = aligned_error(topology, constants, work, constraint, turn, w, al)
        for k in range(angular):
            along = load(constants, c + loop_.DIRECTIONS + 3 * (linear + k))
            torque = aligned_torque(
                topology, constants, work, constraint, turn, along, error, w, al
            )
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
