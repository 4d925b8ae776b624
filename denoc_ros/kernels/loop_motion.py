"""Motion of a loop's child frame relative to its parent's, and the rows that must not move.

With R the rotation of the child seen from the parent, d the way from the parent's to the child's
origin and omega the relative angular velocity, all in the parent's axes, linear rows are l . d.
Directions r that must be the same on both sides give w = h sum r x R r and c = cos of the angle
between the sides (one axis: h = 1; three: h = 1/2); the angular rows are components of
e = 2 w / (1 + c), which is 2 tan(angle / 2) about the axis of the error: it vanishes at angle 0
only, and its derivatives follow from (1 + c) e = 2 w.
"""

from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.layout import (
    ACCELERATION,
    ARM,
    PARENT,
    PLACE,
    SECTION,
    SECTION_WORK,
    SPEED,
    SPIN_UP,
    VELOCITY,
    WORK,
)
from denoc_ros.kernels.tie_layout import (
    ANGULAR,
    AXIS_ROW,
    BIAS,
    CHILD,
    CONSTANTS,
    CROSSED,
    DIRECTIONS,
    ERROR,
    FREE_AXIS,
    KIND,
    LINEAR,
    MEETING,
    ORIENTED,
    OTHER,
    POINT,
    RATE,
    REACH,
    REFERENCES,
    RELATIVE,
    ROW,
    SECOND_AXIS,
    SIDES,
    SLIDES,
    TIE_VECTORS,
    VECTORS,
)
from denoc_ros.kernels.vector import add, cross, dot, load, rotate, scale, store, unrotate


@inlined
def arm_of(ints, work, i):
    """Return the position of row i's origin on its carrier, carrier axes."""
    arm = load(work, at(ints, i, WORK) + ARM)
    if at(ints, i, SECTION) > 0:
        arm = add(arm, load(work, at(ints, i, SECTION_WORK) + PLACE))
    return arm


@inlined
def place_side(ints, work, i, meeting, o):
    """Write rotation and position (12) of frame i on the body where the loop's sides meet."""
    for k in range(9):
        work[o + k] = work[at(ints, i, WORK) + k]
    position = arm_of(ints, work, i)
    p = at(ints, i, PARENT)
    while p != meeting:
        turn = at(ints, p, WORK)
        for k in range(o, o + 3):
            column = rotate(work, turn, (work[k], work[k + 3], work[k + 6]))
            work[k] = column[0]
            work[k + 3] = column[1]
            work[k + 6] = column[2]
        position = add(rotate(work, turn, position), arm_of(ints, work, p))
        p = at(ints, p, PARENT)
    store(work, o + 9, position)


@inlined
def place_relative(ints, work, tie, t):
    """Write rotation and way of a loop's child frame seen from its parent's."""
    child = t + SIDES
    parent = child + 12
    meeting = at(ints, tie, MEETING)
    place_side(ints, work, at(ints, tie, CHILD), meeting, child)
    place_side(ints, work, at(ints, tie, OTHER), meeting, parent)
    apart = add(load(work, child + 9), scale(-1.0, load(work, parent + 9)))
    store(work, t + REACH, unrotate(work, parent, apart))
    for k in range(3):
        column = (work[child + k], work[child + 3 + k], work[child + 6 + k])
        column = unrotate(work, parent, column)
        work[t + RELATIVE + k] = column[0]
        work[t + RELATIVE + 3 + k] = column[1]
        work[t + RELATIVE + 6 + k] = column[2]


@inlined
def move_relative(ints, work, tie, t):
    """Return d', d'', omega and alpha of a loop, as the parent's frame sees them."""
    u = at(ints, at(ints, tie, CHILD), WORK)
    o = at(ints, at(ints, tie, OTHER), WORK)
    turn = t + RELATIVE
    reach = load(work, t + REACH)
    base = load(work, o + SPEED)
    spin = add(rotate(work, turn, load(work, u + SPEED)), scale(-1.0, base))
    spin_up = add(
        rotate(work, turn, load(work, u + SPIN_UP)), scale(-1.0, load(work, o + SPIN_UP))
    )
    spin_up = add(spin_up, cross(spin, base))
    slip = add(rotate(work, turn, load(work, u + VELOCITY)), scale(-1.0, load(work, o + VELOCITY)))
    carried = cross(base, reach)
    slip = add(slip, scale(-1.0, carried))
    slip_up = add(
        rotate(work, turn, load(work, u + ACCELERATION)),
        scale(-1.0, load(work, o + ACCELERATION)),
    )
    dragged = add(cross(load(work, o + SPIN_UP), reach), cross(base, carried))
    slip_up = add(slip_up, scale(-1.0, add(dragged, scale(2.0, cross(base, slip)))))
    return slip, slip_up, spin, spin_up


@inlined
def write_row(work, t, rows, k, error, rate, bias, force, torque):
    """Write one row and the unit wrench of its multiplier."""
    vectors = t + VECTORS + k
    work[vectors + ERROR * rows] = error
    work[vectors + RATE * rows] = rate
    work[vectors + BIAS * rows] = bias
    wrench = t + VECTORS + TIE_VECTORS * rows + 6 * k
    store(work, wrench, force)
    store(work, wrench + 3, torque)


@inlined
def angular_rows(ints, reals, work, tie, t, rows, spin, spin_up):
    """Write the rows of directions that must be the same on both sides."""
    none = (0.0, 0.0, 0.0)
    first = at(ints, tie, ROW) + at(ints, tie, LINEAR)
    angular = at(ints, tie, CONSTANTS) + DIRECTIONS + 3 * at(ints, tie, LINEAR)
    reference = angular + 3 * at(ints, tie, ANGULAR)
    last = reference + 3 * at(ints, tie, REFERENCES)
    h = 1.0
    c = 1.0  # 1 + c
    if at(ints, tie, KIND) == ORIENTED:
        h = 0.5
        c = 0.5
    dc = 0.0
    ddc = 0.0
    w = none
    dw = none
    ddw = none
    for o in range(reference, last, 3):
        here = load(reals, o)
        there = rotate(work, t + RELATIVE, here)
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
    for k in range(at(ints, tie, ANGULAR)):
        along = load(reals, angular + 3 * k)
        torque = scale(dot(e, along), w)
        for o in range(reference, last, 3):
            here = load(reals, o)
            there = rotate(work, t + RELATIVE, here)
            torque = add(torque, scale(2.0 * h, cross(there, cross(along, here))))
        write_row(
            work, t, rows, first + k, dot(along, e), dot(along, de), dot(along, dde),
            none, scale(s, torque),
        )  # fmt: skip


@inlined
def crossed_row(ints, reals, work, tie, t, rows, spin, spin_up):
    """Write the row -axis . axis2 of a universal joint; its wrench is about axis x axis2."""
    none = (0.0, 0.0, 0.0)
    here = load(reals, at(ints, tie, CONSTANTS) + FREE_AXIS)
    there = rotate(work, t + RELATIVE, load(reals, at(ints, tie, CONSTANTS) + SECOND_AXIS))
    rate = cross(spin, there)
    up = add(cross(spin_up, there), cross(spin, rate))
    write_row(
        work, t, rows, at(ints, tie, ROW) + at(ints, tie, LINEAR),
        -dot(here, there), -dot(here, rate), -dot(here, up), none, cross(here, there),
    )  # fmt: skip


@inlined
def axis_row(ints, reals, work, tie, t, rows, slip, slip_up, spin, spin_up):
    """Write the row of a free axis that has damping or friction; it has no error."""
    none = (0.0, 0.0, 0.0)
    c = at(ints, tie, CONSTANTS)
    k = at(ints, tie, AXIS_ROW)
    axis = load(reals, c + FREE_AXIS)
    if reals[c + SLIDES] == 1.0:
        write_row(work, t, rows, k, 0.0, dot(axis, slip), dot(axis, slip_up), axis, none)
    else:
        write_row(work, t, rows, k, 0.0, dot(axis, spin), dot(axis, spin_up), none, axis)


@inlined
def loop_rows(ints, reals, work, tie, t, rows):
    """Write errors, rates, biases and unit wrenches of a loop's rows.

    Its frames must be placed and moved; rows counts all rows, t is the ties' workspace.
    """
    none = (0.0, 0.0, 0.0)
    place_relative(ints, work, tie, t)
    slip, slip_up, spin, spin_up = move_relative(ints, work, tie, t)
    c = at(ints, tie, CONSTANTS) + DIRECTIONS
    for k in range(at(ints, tie, LINEAR)):
        along = load(reals, c + 3 * k)
        write_row(
            work, t, rows, at(ints, tie, ROW) + k, dot(along, load(work, t + REACH)),
            dot(along, slip), dot(along, slip_up), along, none,
        )  # fmt: skip
    if at(ints, tie, KIND) == CROSSED:
        crossed_row(ints, reals, work, tie, t, rows, spin, spin_up)
    elif at(ints, tie, KIND) != POINT:
        angular_rows(ints, reals, work, tie, t, rows, spin, spin_up)
    if at(ints, tie, AXIS_ROW) > 0:
        axis_row(ints, reals, work, tie, t, rows, slip, slip_up, spin, spin_up)
