"""Motion of a loop's child frame relative to its parent's, and the rows that must not move.

With R the rotation of the child seen from the parent, d the way from the parent's to the child's
origin and omega the relative angular velocity, all in the parent's axes, linear rows are l . d.
Directions r that must be the same on both sides give w = h sum r x R r and c = cos of the angle
between the sides (one axis: h = 1; three: h = 1/2); the angular rows are components of
e = 2 w / (1 + c), which is 2 tan(angle / 2) about the axis of the error: it vanishes at angle 0
only, and its derivatives follow from (1 + c) e = 2 w. The row along a direction a has the unit
torque

    t = (2 h sum R r x (a x r) + (a . e) w) / (1 + c).
"""

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
from denoc_ros.kernels.jit.compiled import inlined
from denoc_ros.kernels.jit.handle import at
from denoc_ros.kernels.layout import constraint_layout as loop_
from denoc_ros.kernels.layout import layout as at_

NONE = (0.0, 0.0, 0.0)


@inlined
def arm_of(topology, work, i):
    """Return the position of row i's origin on its carrier, carrier axes."""
    arm = load(work, at(topology, i, at_.WORK) + at_.ARM)
    if at(topology, i, at_.SECTION) > 0:
        arm = add(arm, load(work, at(topology, i, at_.SECTION_WORK) + at_.SECTION_POSITION))
    return arm


@inlined
def place_side(topology, work, i, meeting, o):
    """Write rotation and position (12) of frame i on the body where the loop's sides meet."""
    for k in range(9):
        work[o + k] = work[at(topology, i, at_.WORK) + k]
    position = arm_of(topology, work, i)
    p = at(topology, i, at_.PARENT)
    while p != meeting:
        turn = at(topology, p, at_.WORK)
        for k in range(o, o + 3):
            column = rotate(work, turn, (work[k], work[k + 3], work[k + 6]))
            work[k] = column[0]
            work[k + 3] = column[1]
            work[k + 6] = column[2]
        position = add(rotate(work, turn, position), arm_of(topology, work, p))
        p = at(topology, p, at_.PARENT)
    store(work, o + 9, position)


@inlined
def place_relative(topology, work, constraint, t):
    """Write rotation and way of a loop's child frame seen from its parent's."""
    child = t + loop_.SIDES
    parent = child + 12
    meeting = at(topology, constraint, loop_.COMMON_ANCESTOR)
    place_side(topology, work, at(topology, constraint, loop_.CHILD), meeting, child)
    place_side(topology, work, at(topology, constraint, loop_.OTHER), meeting, parent)
    apart = add(load(work, child + 9), scale(-1.0, load(work, parent + 9)))
    store(work, t + loop_.RELATIVE_POSITION, unrotate(work, parent, apart))
    for k in range(3):
        column = (work[child + k], work[child + 3 + k], work[child + 6 + k])
        column = unrotate(work, parent, column)
        work[t + loop_.RELATIVE + k] = column[0]
        work[t + loop_.RELATIVE + 3 + k] = column[1]
        work[t + loop_.RELATIVE + 6 + k] = column[2]


@inlined
def move_relative(topology, work, constraint, t):
    """Return d', d'', omega and alpha of a loop, as the parent's frame sees them."""
    u = at(topology, at(topology, constraint, loop_.CHILD), at_.WORK)
    o = at(topology, at(topology, constraint, loop_.OTHER), at_.WORK)
    turn = t + loop_.RELATIVE
    reach = load(work, t + loop_.RELATIVE_POSITION)
    base = load(work, o + at_.ANGULAR_VELOCITY)
    spin = add(rotate(work, turn, load(work, u + at_.ANGULAR_VELOCITY)), scale(-1.0, base))
    spin_up = add(
        rotate(work, turn, load(work, u + at_.ANGULAR_ACCELERATION)),
        scale(-1.0, load(work, o + at_.ANGULAR_ACCELERATION)),
    )
    spin_up = add(spin_up, cross(spin, base))
    slip = add(
        rotate(work, turn, load(work, u + at_.VELOCITY)), scale(-1.0, load(work, o + at_.VELOCITY))
    )
    carried = cross(base, reach)
    slip = add(slip, scale(-1.0, carried))
    slip_up = add(
        rotate(work, turn, load(work, u + at_.ACCELERATION)),
        scale(-1.0, load(work, o + at_.ACCELERATION)),
    )
    dragged = add(cross(load(work, o + at_.ANGULAR_ACCELERATION), reach), cross(base, carried))
    slip_up = add(slip_up, scale(-1.0, add(dragged, scale(2.0, cross(base, slip)))))
    return slip, slip_up, spin, spin_up


@inlined
def write_row(work, t, rows, k, error, rate, bias, force, torque):
    """Write one row and the unit wrench of its multiplier."""
    vectors = t + loop_.VECTORS + k
    work[vectors + loop_.ERROR * rows] = error
    work[vectors + loop_.RATE * rows] = rate
    work[vectors + loop_.BIAS * rows] = bias
    wrench = t + loop_.VECTORS + loop_.CONSTRAINT_VECTORS * rows + 6 * k
    store(work, wrench, force)
    store(work, wrench + 3, torque)


@inlined
def quotient(m, c):
    """Return m / c of a vector and its two rates by those of both."""
    s = 1.0 / c[0]
    x = scale(s, m[0])
    first = scale(s, subtract(m[1], scale(c[1], x)))
    second = subtract(m[2], add(scale(2.0 * c[1], first), scale(c[2], x)))
    return x, first, scale(s, second)


@inlined
def direction_rates(constants, work, turn, r, w, al):
    """Return a direction of the child in the parent's axes and its two rates."""
    there = rotate(work, turn, load(constants, r))
    rate = cross(w, there)
    return there, rate, add(cross(al, there), cross(w, rate))


@inlined
def references(topology, constraint):
    """Return the offsets of the directions that must agree, and their weight h."""
    first = at(topology, constraint, loop_.CONSTANTS) + loop_.DIRECTIONS
    first += 3 * (at(topology, constraint, loop_.LINEAR) + at(topology, constraint, loop_.ANGULAR))
    last = first + 3 * at(topology, constraint, loop_.REFERENCES)
    h = 0.5 if at(topology, constraint, loop_.KIND) == loop_.ORIENTED else 1.0
    return range(first, last, 3), h


@inlined
def aligned_error(topology, constants, work, constraint, turn, spin, spin_up):
    """Return e of directions that must agree, w and 1 + c, each with its two rates.

    turn: where the relative rotation stands, which changes with spin and spin_up.
    """
    offsets, h = references(topology, constraint)
    c, dc, ddc = 0.5 if h == 0.5 else 1.0, 0.0, 0.0
    w, dw, ddw = NONE, NONE, NONE
    for r in offsets:
        here = scale(h, load(constants, r))
        there, rate, up = direction_rates(constants, work, turn, r, spin, spin_up)
        w, dw, ddw = (
            add(w, cross(here, there)),
            add(dw, cross(here, rate)),
            add(ddw, cross(here, up)),
        )
        c, dc, ddc = c + dot(here, there), dc + dot(here, rate), ddc + dot(here, up)
    e = quotient((scale(2.0, w), scale(2.0, dw), scale(2.0, ddw)), (c, dc, ddc))
    return e, (w, dw, ddw), (c, dc, ddc)


@inlined
def aligned_torque(topology, constants, work, constraint, turn, along, error, spin, spin_up):
    """Return the torque t of directions that must agree, and its two rates.

    along: (3); error: as `aligned_error` returns it.
    """
    offsets, h = references(topology, constraint)
    e, w, c = error
    m, dm, ddm = NONE, NONE, NONE
    for r in offsets:
        there, rate, up = direction_rates(constants, work, turn, r, spin, spin_up)
        lever = scale(2.0 * h, cross(along, load(constants, r)))
        m, dm, ddm = (
            add(m, cross(there, lever)),
            add(dm, cross(rate, lever)),
            add(ddm, cross(up, lever)),
        )
    s, ds, dds = dot(along, e[0]), dot(along, e[1]), dot(along, e[2])
    m = add(m, scale(s, w[0]))
    dm = add(dm, add(scale(ds, w[0]), scale(s, w[1])))
    ddm = add(ddm, add(scale(dds, w[0]), add(scale(2.0 * ds, w[1]), scale(s, w[2]))))
    return quotient((m, dm, ddm), c)


@inlined
def angular_rows(topology, constants, work, constraint, t, rows, spin, spin_up):
    """Write the rows of directions that must be the same on both sides."""
    linear = at(topology, constraint, loop_.LINEAR)
    first = at(topology, constraint, loop_.ROW) + linear
    directions = at(topology, constraint, loop_.CONSTANTS) + loop_.DIRECTIONS + 3 * linear
    turn = t + loop_.RELATIVE
    error = aligned_error(topology, constants, work, constraint, turn, spin, spin_up)
    e, de, dde = error[0]
    for k in range(at(topology, constraint, loop_.ANGULAR)):
        along = load(constants, directions + 3 * k)
        torque, _rate, _up = aligned_torque(
            topology, constants, work, constraint, turn, along, error, NONE, NONE
        )
        write_row(
            work, t, rows, first + k, dot(along, e), dot(along, de), dot(along, dde),
            NONE, torque,
        )  # fmt: skip


@inlined
def crossed_directions(topology, constants, work, constraint, turn, spin, spin_up):
    """Return the axis of a universal joint and axis2 in the parent's axes, with its two rates."""
    c = at(topology, constraint, loop_.CONSTANTS)
    there = direction_rates(constants, work, turn, c + loop_.SECOND_AXIS, spin, spin_up)
    return load(constants, c + loop_.FREE_AXIS), there


@inlined
def crossed_row(topology, constants, work, constraint, t, rows, spin, spin_up):
    """Write the row -axis . axis2 of a universal joint; its wrench is about axis x axis2."""
    turn = t + loop_.RELATIVE
    here, (there, rate, up) = crossed_directions(
        topology, constants, work, constraint, turn, spin, spin_up
    )
    write_row(
        work, t, rows,
        at(topology, constraint, loop_.ROW) + at(topology, constraint, loop_.LINEAR),
        -dot(here, there), -dot(here, rate), -dot(here, up), NONE, cross(here, there),
    )  # fmt: skip


@inlined
def axis_row(topology, constants, work, constraint, t, rows, slip, slip_up, spin, spin_up):
    """Write the row of a free axis that has damping or friction; it has no error."""
    c = at(topology, constraint, loop_.CONSTANTS)
    k = at(topology, constraint, loop_.AXIS_ROW)
    axis = load(constants, c + loop_.FREE_AXIS)
    if constants[c + loop_.SLIDES] == 1.0:
        write_row(work, t, rows, k, 0.0, dot(axis, slip), dot(axis, slip_up), axis, NONE)
    else:
        write_row(work, t, rows, k, 0.0, dot(axis, spin), dot(axis, spin_up), NONE, axis)


@inlined
def loop_rows(topology, constants, work, constraint, t, rows):
    """Write errors, rates, biases and unit wrenches of a loop's rows.

    Its frames must be placed and moved; rows counts all rows, t is the constraints' workspace.
    """
    place_relative(topology, work, constraint, t)
    slip, slip_up, spin, spin_up = move_relative(topology, work, constraint, t)
    c = at(topology, constraint, loop_.CONSTANTS) + loop_.DIRECTIONS
    for k in range(at(topology, constraint, loop_.LINEAR)):
        along = load(constants, c + 3 * k)
        write_row(
            work, t, rows, at(topology, constraint, loop_.ROW) + k,
            dot(along, load(work, t + loop_.RELATIVE_POSITION)),
            dot(along, slip), dot(along, slip_up), along, NONE,
        )  # fmt: skip
    if at(topology, constraint, loop_.KIND) == loop_.UNIVERSAL:
        crossed_row(topology, constants, work, constraint, t, rows, spin, spin_up)
    elif at(topology, constraint, loop_.KIND) != loop_.POINT:
        angular_rows(topology, constants, work, constraint, t, rows, spin, spin_up)
    if at(topology, constraint, loop_.AXIS_ROW) > 0:
        axis_row(topology, constants, work, constraint, t, rows, slip, slip_up, spin, spin_up)
