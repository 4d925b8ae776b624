"""The way of multipliers' unit wrenches inward: columns of J^T, and of U^-1 J^T (see articulated).

A wrench only visits the bodies that carry it: both sides of a loop go their own way to the body
where they meet, and what the elimination leaves of them goes on from there together.
"""

from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.layout import (
    ARM,
    COLUMNS,
    COORDINATE,
    JOINT,
    MODES,
    PARENT,
    PLACE,
    SECTION,
    SECTION_WORK,
    WORK,
)
from denoc_ros.kernels.rigid_elimination import along_joint
from denoc_ros.kernels.tie_layout import (
    LOADS,
    REACH,
    RELATIVE,
    TIE_VECTORS,
    VECTORS,
)
from denoc_ros.kernels.vector import add, cross, dot, load, rotate, scale, store, unrotate

SIDE = 42  # elements of one side's wrenches


@inlined
def carry(ints, work, i, loads, rows, out, o, n):
    """Take wrenches on row i (its axes, about its origin) to its carrier and its modes."""
    p = at(ints, i, PARENT)
    turn = at(ints, i, WORK)
    arm = load(work, turn + ARM)
    modes = 0
    section = 0
    place = (0.0, 0.0, 0.0)
    if at(ints, i, SECTION) > 0:
        modes = at(ints, p, MODES)
        section = at(ints, i, SECTION_WORK)
        place = load(work, section + PLACE)
    j = at(ints, p, COORDINATE) + at(ints, p, JOINT)
    for k in range(rows):
        w = loads + 6 * k
        force = rotate(work, turn, load(work, w))
        torque = add(rotate(work, turn, load(work, w + 3)), cross(arm, force))
        c = section + COLUMNS
        for m in range(o + n * k + j, o + n * k + j + modes):
            out[m] += dot(load(work, c), force) + dot(load(work, c + 3), torque)
            c += 6
        store(work, w, force)
        store(work, w + 3, add(torque, cross(place, force)))


@inlined
def project(ints, reals, work, p, loads, rows, out, o, n):
    """Add the share of wrenches on body p along its joint."""
    if at(ints, p, JOINT) == 0:
        return
    j = o + at(ints, p, COORDINATE)
    for k in range(rows):
        w = loads + 6 * k
        out[j + n * k] += along_joint(ints, reals, p, load(work, w), load(work, w + 3))


@inlined
def load_sides(ints, work, tie, t, rows, first, count):
    """Write the unit wrenches of rows first .. first + count - 1 on both sides of a loop."""
    reach = load(work, t + REACH)
    for k in range(count):
        wrench = t + VECTORS + TIE_VECTORS * rows + 6 * (first + k)
        force = load(work, wrench)
        torque = load(work, wrench + 3)
        w = t + LOADS + 6 * k
        store(work, w, unrotate(work, t + RELATIVE, force))
        store(work, w + 3, unrotate(work, t + RELATIVE, torque))
        w += SIDE
        store(work, w, scale(-1.0, force))
        store(work, w + 3, scale(-1.0, add(torque, cross(reach, force))))


@inlined
def project_side(ints, reals, work, i, meeting, loads, rows, out, o, n):
    """Add what wrenches on frame i do along the coordinates up to the meeting body."""
    while at(ints, i, PARENT) != 0:
        carry(ints, work, i, loads, rows, out, o, n)
        i = at(ints, i, PARENT)
        if i == meeting:
            return
        project(ints, reals, work, i, loads, rows, out, o, n)
