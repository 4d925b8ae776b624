"""Derivatives of the constraints: of their rows J along a motion, of J^T lambda by q.

A row's error g is a function of positions alone, so that dg''/dq = J'' and dg''/dq' = 2 J'; with
q' = 0 and q'' = v, d(J v)/dq = J''. A multiplier's unit wrench in the parent's axes, at the
child's origin, has a constant force f and a torque t (see loop_motion) that turns with the
relative rotation: J = f . l + t . u with the columns [l; u] of the motion of the loop's child
frame as its parent's frame sees it.

With L, T the columns of both frames' Jacobians (p: parent), d the way from the parent's to the
child's origin and R the parent's rotation, l = R^T (L - L_p - T_p x d) and u = R^T (T - T_p).
Their rates are those in the parent's frame, which turns: x' - w x x, and
x'' - 2 w x x' - al x x + w x (w x x).

Free axes with damping or friction have rows too; their rates are not derivatives of an error, and
in the place of J' stands how the rate changes with q.

A loop's multipliers are a wrench on its child, force f and torque t in the parent's axes, and the
opposite one on its parent. The forces of wrenches that keep their direction change as
load_derivatives says; beside that the wrench turns with the parent, and its torque changes with
the relative rotation: with D u that change, with s = l + T x d the way of the child's origin and T
the parent's angular column, all in the parent's axes, row i, column j of the change is

    l_i . (T_j x f) + u_i . (T_j x t + D u_j) - T_i . (s_j x f).
"""

from denoc_ros.kernels.algebra.spatial import dot_pair, pair
from denoc_ros.kernels.algebra.vector import (
    add,
    cross,
    dot,
    load,
    rotate,
    scale,
    store,
    subtract,
    unrotate,
)
from denoc_ros.kernels.constraints.closure import all_rows, constraints
from denoc_ros.kernels.constraints.loop_motion import (
    NONE,
    aligned_error,
    aligned_torque,
    crossed_directions,
)
from denoc_ros.kernels.constraints.multipliers import columns_of
from denoc_ros.kernels.derivatives.load_derivatives import subtract_load
from denoc_ros.kernels.dynamics.frame_motion import body_state, carried, move_world, write_columns
from denoc_ros.kernels.dynamics.link_motion import linear_velocity, move_body
from denoc_ros.kernels.dynamics.placement import place_body
from denoc_ros.kernels.dynamics.world import world_pose
from denoc_ros.kernels.jit.compiled import inlined, merged, shared
from denoc_ros.kernels.jit.handle import at, coordinates, model_arrays
from denoc_ros.kernels.jit.pointers import part
from denoc_ros.kernels.layout import constrained_derivative_layout as cdiff_
from denoc_ros.kernels.layout import constraint_layout as loop_
from denoc_ros.kernels.layout.constrained_derivative_layout import lay_out
from denoc_ros.kernels.layout.constraint_layout import CHILD, OTHER
from denoc_ros.kernels.layout.layout import COORDINATE, WORK, WORLD_ROTATION


@inlined
def write_frame_column(out, _n, j, linear, turn, _w, _al):
    """Write a column of a frame's Jacobian and its rates."""
    o = cdiff_.FRAME_COLUMN * j
    for k in range(3):
        store(out, o + 3 * k, linear[k])
        store(out, o + 9 + 3 * k, turn[k])


@merged
def frame_columns(topology, constants, work, q, qd, qdd, i, out, n):
    """Place and move frame i on bodies that are, and write its columns."""
    place_body(topology, constants, work, q, i)
    world_pose(topology, work, i)
    move_body(topology, constants, work, qd, qdd, i)
    linear_velocity(topology, constants, work, qd, i)
    frame = body_state(work, at(topology, i, WORK))
    for k in range(cdiff_.FRAME_COLUMN * n):
        out[k] = 0.0
    write_columns(write_frame_column, topology, constants, work, qd, qdd, i, frame, out, n)


@inlined
def three(a, o):
    """Return three vectors that follow each other from offset o of a."""
    return load(a, o), load(a, o + 3), load(a, o + 6)


@inlined
def difference(x, y):
    """Return x - y of a vector and its two rates."""
    return subtract(x[0], y[0]), subtract(x[1], y[1]), subtract(x[2], y[2])


@inlined
def as_seen(work, turn, x, w, al):
    """Return a vector in base axes and its rates as a frame sees them that turns with w, al."""
    turned = cross(w, x[0])
    second = subtract(x[2], add(scale(2.0, cross(w, x[1])), cross(al, x[0])))
    second = add(second, cross(w, turned))
    return (
        unrotate(work, turn, x[0]),
        unrotate(work, turn, subtract(x[1], turned)),
        unrotate(work, turn, second),
    )


@inlined
def relative_pose(topology, work, constraint, o):
    """Write the rotation of a loop's child frame as the parent's sees it."""
    parent = at(topology, at(topology, constraint, OTHER), WORK) + WORLD_ROTATION
    child = at(topology, at(topology, constraint, CHILD), WORK) + WORLD_ROTATION
    for k in range(3):
        column = unrotate(
            work, parent, (work[child + k], work[child + 3 + k], work[child + 6 + k])
        )
        work[o + cdiff_.RELATIVE_ROTATION + k] = column[0]
        work[o + cdiff_.RELATIVE_ROTATION + 3 + k] = column[1]
        work[o + cdiff_.RELATIVE_ROTATION + 6 + k] = column[2]


@merged
def loop_columns(topology, constants, work, motion, constraint, frames, o, n):
    """Write at o the columns of a loop's relative motion by every coordinate.

    motion: q, q' and q'', of which bodies are placed and moved; frames: room for two frames.
    """
    q, qd, qdd = motion
    size = cdiff_.FRAME_COLUMN * n
    i, p = at(topology, constraint, CHILD), at(topology, constraint, OTHER)
    for side in range(2):
        frame_columns(
            topology, constants, work, q, qd, qdd, p if side else i,
            part(work, frames + size * side, size), n,
        )  # fmt: skip
    child, parent = part(work, frames, size), part(work, frames + size, size)
    c = body_state(work, at(topology, i, WORK))
    base = body_state(work, at(topology, p, WORK))
    w, al = base[3], base[4]
    turn = at(topology, p, WORK) + WORLD_ROTATION
    arm = (subtract(c[0], base[0]), subtract(c[1], base[1]), subtract(c[2], base[2]))
    relative_pose(topology, work, constraint, o)
    store(work, o + cdiff_.RELATIVE_POSITION, unrotate(work, turn, arm[0]))
    faster = subtract(c[3], w)
    store(work, o + cdiff_.ANGULAR_VELOCITY, unrotate(work, turn, faster))
    gained = subtract(subtract(c[4], al), cross(w, faster))
    store(work, o + cdiff_.ANGULAR_ACCELERATION, unrotate(work, turn, gained))
    for j in range(n):
        k = cdiff_.FRAME_COLUMN * j
        slide, spin = three(parent, k), three(parent, k + 9)
        linear = difference(three(child, k), carried(slide, spin, arm))
        linear = as_seen(work, turn, linear, w, al)
        angular = as_seen(work, turn, difference(three(child, k + 9), spin), w, al)
        k = o + cdiff_.LOOP_COLUMNS + cdiff_.LOOP_COLUMN * j
        for order in range(3):
            store(work, k + 6 * order, linear[order])
            store(work, k + 6 * order + 3, angular[order])
        store(work, k + cdiff_.PARENT_TURN, unrotate(work, turn, spin[0]))


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
def room(topology, work, places, n, which):
    """Return one of the vectors of the derivatives."""
    m = max(n + at(topology, 0, loop_.ROWS), all_rows(topology))
    return part(work, places.vectors + which * m, m)


@inlined
def room_place(topology, places, n, which):
    """Return where it begins in work."""
    return places.vectors + which * max(n + at(topology, 0, loop_.ROWS), all_rows(topology))


@inlined
def add_products(work, left, right, rows, inner, columns, out):
    """Add a product of matrices (rows, inner) (inner, columns) to another at `out`."""
    for i in range(rows):
        for k in range(inner):
            factor = work[left + inner * i + k]
            for j in range(columns):
                work[out + columns * i + j] += factor * work[right + columns * k + j]


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


@shared
def subtract_wrench(handle, q, i, wrench, out):
    """Wrap load_derivatives.subtract_load."""
    return subtract_load(handle, q, i, wrench, out)


@inlined
def weighted(constants, work, o, first, count):
    """Return the sum of directions at o of constants times weights at `first` of work."""
    total = NONE
    for k in range(count):
        total = add(total, scale(work[first + k], load(constants, o + 3 * k)))
    return total


@inlined
def torque_of(topology, constants, work, constraint, turn, first, w):
    """Return the torque of a loop's angular rows, and its rate as the child turns with w.

    first: where the weights of these rows stand in work.
    """
    kind = at(topology, constraint, loop_.KIND)
    if kind == loop_.UNIVERSAL:
        found = universal_torque(topology, constants, work, constraint, turn, work[first], w, NONE)
        return found[0], found[1]
    if kind == loop_.POINT:
        return NONE, NONE
    o = (
        at(topology, constraint, loop_.CONSTANTS)
        + loop_.DIRECTIONS
        + 3 * at(topology, constraint, loop_.LINEAR)
    )
    along = weighted(constants, work, o, first, at(topology, constraint, loop_.ANGULAR))
    error = aligned_error(topology, constants, work, constraint, turn, w, NONE)
    found = aligned_torque(topology, constants, work, constraint, turn, along, error, w, NONE)
    return found[0], found[1]


@inlined
def axis_wrench(topology, constants, work, constraint, weights):
    """Return the wrench along a loop's free axis."""
    row = at(topology, constraint, loop_.AXIS_ROW)
    if row == 0:
        return NONE, NONE
    c = at(topology, constraint, loop_.CONSTANTS)
    along = scale(work[weights + row], load(constants, c + loop_.FREE_AXIS))
    return (along, NONE) if constants[c + loop_.SLIDES] == 1.0 else (NONE, along)


@merged
def subtract_turning(work, loop, n, force, torque, change, out):
    """Subtract the parts that turn with the parent and with the relative rotation.

    change: where D^T stands in work.
    """
    apart = load(work, loop + cdiff_.RELATIVE_POSITION)
    for j in range(n):
        k = loop + cdiff_.LOOP_COLUMNS + cdiff_.LOOP_COLUMN * j
        linear, angular = pair(work, k)
        turn = load(work, k + cdiff_.PARENT_TURN)
        pull = cross(turn, force)
        twist = add(unrotate(work, change, angular), cross(turn, torque))
        lever = cross(add(linear, cross(turn, apart)), force)
        for i in range(n):
            k = loop + cdiff_.LOOP_COLUMNS + cdiff_.LOOP_COLUMN * i
            own = pair(work, k)
            total = dot(own[0], pull) + dot(own[1], twist)
            out[n * i + j] -= total - dot(load(work, k + cdiff_.PARENT_TURN), lever)


@merged
def write_change(topology, constants, work, constraint, turn, first, o):
    """Write D^T (3, 3) to o; return the torque."""
    torque = NONE
    for k in range(3):
        axis = (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)
        torque, change = torque_of(topology, constants, work, constraint, turn, first, axis)
        store(work, o + 3 * k, change)
    return torque


@merged
def subtract_sides(handle, q, constraint, loop, force, torque, out):
    """Subtract the change by q of the wrench on the child and its opposite on the parent."""
    topology, _constants, work, _diagonals, _bodies = model_arrays(handle)
    places = places_of(topology, coordinates(handle))
    wrench = part(work, places.wrench, 6)
    base = at(topology, at(topology, constraint, loop_.OTHER), WORK) + WORLD_ROTATION
    lever = rotate(work, base, cross(load(work, loop + cdiff_.RELATIVE_POSITION), force))
    force, torque = rotate(work, base, force), rotate(work, base, torque)
    for side in range(2):
        store(wrench, 0, force)
        store(wrench, 3, torque)
        frame = at(topology, constraint, loop_.CHILD if side == 0 else loop_.OTHER)
        subtract_wrench(handle, q, frame, wrench, out)
        force, torque = scale(-1.0, force), subtract(scale(-1.0, torque), lever)


@merged
def subtract_force_change(handle, q, weights, out):
    """Subtract d(J^T weights)/dq from out (n, n); the loops' relative motion must stand in work.

    weights: offset in work of those of all rows, free axes included.
    """
    topology, constants, work, _diagonals, _bodies = model_arrays(handle)
    n = coordinates(handle)
    places = places_of(topology, n)
    for constraint in constraints(topology):
        if at(topology, constraint, loop_.KIND) == loop_.MIMIC:
            continue
        loop = loop_place(topology, places, constraint, n)
        turn, linear = loop + cdiff_.RELATIVE_ROTATION, at(topology, constraint, loop_.LINEAR)
        first = weights + at(topology, constraint, loop_.ROW)
        o = at(topology, constraint, loop_.CONSTANTS) + loop_.DIRECTIONS
        force = weighted(constants, work, o, first, linear)
        change = places.wrench + 6
        torque = write_change(topology, constants, work, constraint, turn, first + linear, change)
        along, about = axis_wrench(topology, constants, work, constraint, weights)
        force, torque = add(force, along), add(torque, about)
        subtract_turning(work, loop, n, force, torque, change, out)
        subtract_sides(handle, q, constraint, loop, force, torque, out)
