"""The way of multipliers' unit wrenches inward: rows of J, and columns y of U^-1 J^T.

With the factors that articulated dynamics leaves in the workspace, a load w (wrenches on bodies,
forces along joints) has y = L^-1 P^T w on every body, whose carrier gets w less W D^-1 y. A
wrench only visits the bodies that carry it: both sides of a loop go their own way to the body
where they meet, and what the elimination leaves of them goes on from there together.
"""

from denoc_ros.kernels.articulated import free_joint
from denoc_ros.kernels.compiled import inlined, shared
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.layout import (
    ARM,
    COLUMNS,
    COORDINATE,
    ELIMINATED,
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
    ANGULAR,
    AXIS_ROW,
    CHILD,
    CONSTANTS,
    KIND,
    LINEAR,
    LOADS,
    MEETING,
    MIMIC,
    MULTIPLIER,
    OTHER,
    REACH,
    RELATIVE,
    ROW,
    TIE_VECTORS,
    VECTORS,
)
from denoc_ros.kernels.vector import (
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

SIDE = 42  # elements of one side's wrenches


@shared
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


@shared
def project_side(ints, reals, work, i, meeting, loads, rows, out, o, n):
    """Add what wrenches on frame i do along the coordinates up to the meeting body."""
    while at(ints, i, PARENT) != 0:
        carry(ints, work, i, loads, rows, out, o, n)
        i = at(ints, i, PARENT)
        if i == meeting:
            return
        project(ints, reals, work, i, loads, rows, out, o, n)


@inlined
def eliminate_rigid(ints, reals, work, p, loads, rows, j, n):
    """Do what :func:`eliminate` does for a rigid body with a free joint, whose y is at j."""
    w = at(ints, p, ELIMINATED)
    force, torque, inverse = load(work, w), load(work, w + 3), work[w + 7]
    for k in range(rows):
        c = loads + 6 * k
        f, t = load(work, c), load(work, c + 3)
        y = work[j + n * k] + along_joint(ints, reals, p, f, t)
        work[j + n * k] = y
        store(work, c, subtract(f, scale(inverse * y, force)))
        store(work, c + 3, subtract(t, scale(inverse * y, torque)))


@inlined
def eliminate_flexible(ints, reals, work, p, loads, rows, j, n, free):
    """Do what :func:`eliminate` does for a flexible body, whose y starts at j."""
    size = free + at(ints, p, MODES)
    w = at(ints, p, ELIMINATED)
    d = w + 6 * size
    for k in range(rows):
        c = loads + 6 * k
        y = j + n * k
        f, t = load(work, c), load(work, c + 3)
        if free == 1:
            work[y] += along_joint(ints, reals, p, f, t)
        for i in range(size):
            u = work[y + i]
            for r in range(i):
                u -= work[d + size * i + r] * work[y + r]
            work[y + i] = u
            u *= work[d + (size + 1) * i]
            f = subtract(f, scale(u, load(work, w + 6 * i)))
            t = subtract(t, scale(u, load(work, w + 6 * i + 3)))
        store(work, c, f)
        store(work, c + 3, t)


@inlined
def eliminate(ints, reals, work, held, p, loads, rows, o, n):
    """Write the columns y of body p for loads on it, and take W D^-1 y from the loads."""
    free = free_joint(ints, held, p)
    j = o + at(ints, p, COORDINATE)
    if at(ints, p, MODES) > 0:
        j += at(ints, p, JOINT) - free
        eliminate_flexible(ints, reals, work, p, loads, rows, j, n, free)
    elif free == 1:
        eliminate_rigid(ints, reals, work, p, loads, rows, j, n)


@shared
def climb(ints, reals, work, held, i, stop, loads, rows, o, n):
    """Take loads on body i inward, eliminating, until they act on the body `stop`."""
    while i != stop:
        eliminate(ints, reals, work, held, i, loads, rows, o, n)
        if at(ints, i, PARENT) > 0:
            carry(ints, work, i, loads, rows, work, o, n)
        i = at(ints, i, PARENT)


@shared
def climb_together(ints, reals, work, held, tie, t, child, other, rows, o, n):
    """Take the loads of both sides of a tie from their bodies to the base."""
    meeting = at(ints, tie, MEETING)
    loads = t + LOADS
    climb(ints, reals, work, held, child, meeting, loads, rows, o, n)
    climb(ints, reals, work, held, other, meeting, loads + SIDE, rows, o, n)
    for k in range(6 * rows):
        work[loads + k] += work[loads + SIDE + k]
    climb(ints, reals, work, held, meeting, 0, loads, rows, o, n)


@shared
def loop_columns(ints, reals, work, held, tie, t, rows, first, count, columns, n):
    """Write the columns of rows first .. first + count - 1 of a loop."""
    load_sides(ints, work, tie, t, rows, first, count)
    o = columns + n * first
    child = at(ints, tie, CHILD)
    other = at(ints, tie, OTHER)
    if at(ints, child, PARENT) > 0:
        carry(ints, work, child, t + LOADS, count, work, o, n)
    if at(ints, other, PARENT) > 0:
        carry(ints, work, other, t + LOADS + SIDE, count, work, o, n)
    child = at(ints, child, PARENT)
    other = at(ints, other, PARENT)
    climb_together(ints, reals, work, held, tie, t, child, other, count, o, n)


@inlined
def mimic_column(ints, reals, work, held, tie, t, columns, n):
    """Write the column of a mimic joint's row."""
    o = columns + n * at(ints, tie, ROW)
    child = at(ints, tie, CHILD)
    leader = at(ints, tie, OTHER)
    for k in range(6):
        work[t + LOADS + k] = 0.0
        work[t + LOADS + SIDE + k] = 0.0
    work[o + at(ints, child, COORDINATE)] = 1.0
    factor = reals[at(ints, tie, CONSTANTS) + MULTIPLIER]
    work[o + at(ints, leader, COORDINATE)] -= factor
    climb_together(ints, reals, work, held, tie, t, child, leader, 1, o, n)


@inlined
def tie_columns(ints, reals, work, held, tie, t, rows, columns, n):
    """Write the columns of a tie whose rows stand in the workspace; they must be zero before."""
    if at(ints, tie, KIND) == MIMIC:
        mimic_column(ints, reals, work, held, tie, t, columns, n)
        return
    first = at(ints, tie, ROW)
    count = at(ints, tie, LINEAR) + at(ints, tie, ANGULAR)
    loop_columns(ints, reals, work, held, tie, t, rows, first, count, columns, n)
    if at(ints, tie, AXIS_ROW) > 0:
        first = at(ints, tie, AXIS_ROW)
        loop_columns(ints, reals, work, held, tie, t, rows, first, 1, columns, n)
