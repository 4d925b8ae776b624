"""Motion of a loop's child frame relative to its parent's, and the rows that must not move.

With R the rotation of the child seen from the parent, d the way from the parent's to the child's
origin and omega the relative angular velocity, all in the parent's axes, linear rows are l . d.
Directions r that must be the same on both sides give w = h sum r x R r and c = cos of the angle
between the sides (one axis: h = 1; three: h = 1/2); the angular rows are components of
e = 2 w / (1 + c), which is 2 tan(angle / 2) about the axis of the error: it vanishes at angle 0
only, and its derivatives follow from (1 + c) e = 2 w.
"""

from denoc_ros.kernels import constraint_layout as loop_
from denoc_ros.kernels import layout as at_
from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.vector import add, cross, dot, load, rotate, scale, store, unrotate


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
def angular_rows(topology, constants, work, constraint, t, rows, spin, spin_up):
    """Write the rows of directions that must be the same on both sides."""
    none = (0.0, 0.0, 0.0)
    first = at(topology, constraint, loop_.ROW) + at(topology, constraint, loop_.LINEAR)
    angular = (
        at(topology, constraint, loop_.CONSTANTS)
        + loop_.DIRECTIONS
        + 3 * at(topology, constraint, loop_.LINEAR)
    )
    reference = angular + 3 * at(topology, constraint, loop_.ANGULAR)
    last = reference + 3 * at(topology, constraint, loop_.REFERENCES)
    h = 1.0
    c = 1.0  # 1 + c
    if at(topology, constraint, loop_.KIND) == loop_.ORIENTED:
        h = 0.5
        c = 0.5
    dc = 0.0
    ddc = 0.0
    w = none
    dw = none
    ddw = none
    for o in range(reference, last, 3):
        here = load(constants, o)
        there = rotate(work, t + loop_.RELATIVE, here)
        rate = cross(spin, there)
        up = add(cross(spin_up, there), cross(spin, rate))
        w = add(w, scale(h, cross(here, there)))
        dw = add(dw, scale(h, cross(here, rate)))
        ddw = add(ddw, scale(h, cross(here, up)))
        c += h * dot(here, there)
        dc += h * dot(here, rate)
        ddc += h * dot(here, up)
    s = 1.0 / c
    e = scale(2.0 * s, w)
    de = scale(s, add(scale(2.0, dw), scale(-dc, e)))
    dde = scale(s, add(scale(2.0, ddw), add(scale(-2.0 * dc, de), scale(-ddc, e))))
    for k in range(at(topology, constraint, loop_.ANGULAR)):
        along = load(constants, angular + 3 * k)
        torque = scale(dot(e, along), w)
        for o in range(reference, last, 3):
            here = load(constants, o)
            there = rotate(work, t + loop_.RELATIVE, here)
            torque = add(torque, scale(2.0 * h, cross(there, cross(along, here))))
        write_row(
            work, t, rows, first + k, dot(along, e), dot(along, de), dot(along, dde),
            none, scale(s, torque),
        )  # fmt: skip


@inlined
def crossed_row(topology, constants, work, constraint, t, rows, spin, spin_up):
    """Write the row -axis . axis2 of a universal joint; its wrench is about axis x axis2."""
    none = (0.0, 0.0, 0.0)
    here = load(constants, at(topology, constraint, loop_.CONSTANTS) + loop_.FREE_AXIS)
    there = rotate(
        work,
        t + loop_.RELATIVE,
        load(constants, at(topology, constraint, loop_.CONSTANTS) + loop_.SECOND_AXIS),
    )
    rate = cross(spin, there)
    up = add(cross(spin_up, there), cross(spin, rate))
    write_row(
        work, t, rows,
        at(topology, constraint, loop_.ROW) + at(topology, constraint, loop_.LINEAR),
        -dot(here, there), -dot(here, rate), -dot(here, up), none, cross(here, there),
    )  # fmt: skip


@inlined
def axis_row(topology, constants, work, constraint, t, rows, slip, slip_up, spin, spin_up):
    """Write the row of a free axis that has damping or friction; it has no error."""
    none = (0.0, 0.0, 0.0)
    c = at(topology, constraint, loop_.CONSTANTS)
    k = at(topology, constraint, loop_.AXIS_ROW)
    axis = load(constants, c + loop_.FREE_AXIS)
    if constants[c + loop_.SLIDES] == 1.0:
        write_row(work, t, rows, k, 0.0, dot(axis, slip), dot(axis, slip_up), axis, none)
    else:
        write_row(work, t, rows, k, 0.0, dot(axis, spin), dot(axis, spin_up), none, axis)


@inlined
def loop_rows(topology, constants, work, constraint, t, rows):
    """Write errors, rates, biases and unit wrenches of a loop's rows.

    Its frames must be placed and moved; rows counts all rows, t is the constraints' workspace.
    """
    none = (0.0, 0.0, 0.0)
    place_relative(topology, work, constraint, t)
    slip, slip_up, spin, spin_up = move_relative(topology, work, constraint, t)
    c = at(topology, constraint, loop_.CONSTANTS) + loop_.DIRECTIONS
    for k in range(at(topology, constraint, loop_.LINEAR)):
        along = load(constants, c + 3 * k)
        write_row(
            work, t, rows, at(topology, constraint, loop_.ROW) + k,
            dot(along, load(work, t + loop_.RELATIVE_POSITION)),
            dot(along, slip), dot(along, slip_up), along, none,
        )  # fmt: skip
    if at(topology, constraint, loop_.KIND) == loop_.UNIVERSAL:
        crossed_row(topology, constants, work, constraint, t, rows, spin, spin_up)
    elif at(topology, constraint, loop_.KIND) != loop_.POINT:
        angular_rows(topology, constants, work, constraint, t, rows, spin, spin_up)
    if at(topology, constraint, loop_.AXIS_ROW) > 0:
        axis_row(topology, constants, work, constraint, t, rows, slip, slip_up, spin, spin_up)
