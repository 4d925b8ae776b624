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
    WAYS,
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
def parts(ints, tie):
    """Return 2 for a tie whose free axis has a row too, else 1."""
    return 2 if at(ints, tie, KIND) != MIMIC and at(ints, tie, AXIS_ROW) > 0 else 1


@inlined
def rows_of(ints, tie, part):
    """Return first and number of a tie's rows, or of its free axis (part 1)."""
    if part == 1:
        return at(ints, tie, AXIS_ROW), 1
    if at(ints, tie, KIND) == MIMIC:
        return at(ints, tie, ROW), 1
    return at(ints, tie, ROW), at(ints, tie, LINEAR) + at(ints, tie, ANGULAR)


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
def project_loop(ints, reals, work, tie, t, rows, out, n):
    """Add the rows of a loop, and of its free axis, to a Jacobian (rows, n)."""
    for part in range(parts(ints, tie)):
        first, count = rows_of(ints, tie, part)
        load_sides(ints, work, tie, t, rows, first, count)
        for side in range(2):
            i = at(ints, tie, CHILD if side == 0 else OTHER)
            loads = t + LOADS + SIDE * side
            while at(ints, i, PARENT) > 0:
                carry(ints, work, i, loads, count, out, n * first, n)
                i = at(ints, i, PARENT)
                if i == at(ints, tie, MEETING):
                    break
                project(ints, reals, work, i, loads, count, out, n * first, n)


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


@inlined
def load_mimic(ints, reals, work, tie, t, o):
    """Write the forces along both joints of a mimic row, which has no wrenches."""
    for k in range(6):
        work[t + LOADS + k] = 0.0
        work[t + LOADS + SIDE + k] = 0.0
    factor = reals[at(ints, tie, CONSTANTS) + MULTIPLIER]
    work[o + at(ints, at(ints, tie, CHILD), COORDINATE)] += 1.0
    work[o + at(ints, at(ints, tie, OTHER), COORDINATE)] -= factor


@shared
def tie_columns(ints, reals, work, held, tie, t, rows, columns, n):
    """Write the columns of a tie whose rows stand in the workspace; they must be zero before."""
    for part in range(parts(ints, tie)):
        first, count = rows_of(ints, tie, part)
        o = columns + n * first
        if at(ints, tie, KIND) == MIMIC:
            load_mimic(ints, reals, work, tie, t, o)
        else:
            load_sides(ints, work, tie, t, rows, first, count)
        # up both sides to where they meet, and from there together; a frame eliminates nothing
        for way in range(3):
            i = at(ints, tie, WAYS + way)
            stop = at(ints, tie, MEETING) if way < 2 else 0
            loads = t + LOADS + (SIDE if way == 1 else 0)
            if way == 2:
                for k in range(6 * count):
                    work[loads + k] += work[loads + SIDE + k]
            while i != stop:
                eliminate(ints, reals, work, held, i, loads, count, o, n)
                if at(ints, i, PARENT) > 0:
                    carry(ints, work, i, loads, count, work, o, n)
                i = at(ints, i, PARENT)
