"""Inward pass of the multipliers' unit wrenches: rows of J, and columns y of U^-1 J^T.

With the factors that articulated dynamics leaves in the workspace, a load w (wrenches on bodies,
forces along joints) has y = L^-1 P^T w on every body, whose carrier gets w less W D^-1 y. A
wrench only visits the bodies that carry it: the two sides of a loop propagate separately to the
body where they meet, and their reduced wrenches propagate together from there.
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
from denoc_ros.kernels.dynamics.articulated import free_joint
from denoc_ros.kernels.dynamics.elimination import along_joint
from denoc_ros.kernels.jit.compiled import inlined, shared
from denoc_ros.kernels.jit.handle import at
from denoc_ros.kernels.layout import constraint_layout as loop_
from denoc_ros.kernels.layout import layout as at_

SIDE = 42  # elements of one side's wrenches


@inlined
def carry(topology, work, i, loads, rows, out, o, n):
    """Take wrenches on row i (its axes, about its origin) to its carrier and its modes."""
    p = at(topology, i, at_.PARENT)
    turn = at(topology, i, at_.WORK)
    arm = load(work, turn + at_.ARM)
    modes = 0
    section = 0
    place = (0.0, 0.0, 0.0)
    if at(topology, i, at_.SECTION) > 0:
        modes = at(topology, p, at_.MODES)
        section = at(topology, i, at_.SECTION_WORK)
        place = load(work, section + at_.SECTION_POSITION)
    j = at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT)
    for k in range(rows):
        w = loads + 6 * k
        force = rotate(work, turn, load(work, w))
        torque = add(rotate(work, turn, load(work, w + 3)), cross(arm, force))
        c = section + at_.COLUMNS
        for m in range(o + n * k + j, o + n * k + j + modes):
            out[m] += dot(load(work, c), force) + dot(load(work, c + 3), torque)
            c += 6
        store(work, w, force)
        store(work, w + 3, add(torque, cross(place, force)))


@inlined
def project(topology, constants, work, p, loads, rows, out, o, n):
    """Add the share of wrenches on body p along its joint."""
    if at(topology, p, at_.JOINT) == 0:
        return
    j = o + at(topology, p, at_.COORDINATE)
    for k in range(rows):
        w = loads + 6 * k
        out[j + n * k] += along_joint(topology, constants, p, load(work, w), load(work, w + 3))


@inlined
def parts(topology, constraint):
    """Return 2 for a constraint whose free axis has a row too, else 1."""
    return (
        2
        if at(topology, constraint, loop_.KIND) != loop_.MIMIC
        and at(topology, constraint, loop_.AXIS_ROW) > 0
        else 1
    )


@inlined
def rows_of(topology, constraint, part):
    """Return first and number of a constraint's rows, or of its free axis (part 1)."""
    if part == 1:
        return at(topology, constraint, loop_.AXIS_ROW), 1
    if at(topology, constraint, loop_.KIND) == loop_.MIMIC:
        return at(topology, constraint, loop_.ROW), 1
    return at(topology, constraint, loop_.ROW), at(topology, constraint, loop_.LINEAR) + at(
        topology, constraint, loop_.ANGULAR
    )


@inlined
def load_sides(topology, work, constraint, t, rows, first, count):
    """Write the unit wrenches of rows first .. first + count - 1 on both sides of a loop."""
    reach = load(work, t + loop_.RELATIVE_POSITION)
    for k in range(count):
        wrench = t + loop_.VECTORS + loop_.CONSTRAINT_VECTORS * rows + 6 * (first + k)
        force = load(work, wrench)
        torque = load(work, wrench + 3)
        w = t + loop_.LOADS + 6 * k
        store(work, w, unrotate(work, t + loop_.RELATIVE, force))
        store(work, w + 3, unrotate(work, t + loop_.RELATIVE, torque))
        w += SIDE
        store(work, w, scale(-1.0, force))
        store(work, w + 3, scale(-1.0, add(torque, cross(reach, force))))


@shared
def project_loop(topology, constants, work, constraint, t, rows, out, n):
    """Add the rows of a loop, and of its free axis, to a Jacobian (rows, n)."""
    for part in range(parts(topology, constraint)):
        first, count = rows_of(topology, constraint, part)
        load_sides(topology, work, constraint, t, rows, first, count)
        for side in range(2):
            i = at(topology, constraint, loop_.CHILD if side == 0 else loop_.OTHER)
            loads = t + loop_.LOADS + SIDE * side
            while at(topology, i, at_.PARENT) > 0:
                carry(topology, work, i, loads, count, out, n * first, n)
                i = at(topology, i, at_.PARENT)
                if i == at(topology, constraint, loop_.COMMON_ANCESTOR):
                    break
                project(topology, constants, work, i, loads, count, out, n * first, n)


@inlined
def eliminate_rigid(topology, constants, work, p, loads, rows, j, n):
    """Eliminate a rigid body with a free joint, whose y is at j, as :func:`eliminate` does."""
    w = at(topology, p, at_.ELIMINATED)
    force, torque, inverse = load(work, w), load(work, w + 3), work[w + 7]
    for k in range(rows):
        c = loads + 6 * k
        f, t = load(work, c), load(work, c + 3)
        y = work[j + n * k] + along_joint(topology, constants, p, f, t)
        work[j + n * k] = y
        store(work, c, subtract(f, scale(inverse * y, force)))
        store(work, c + 3, subtract(t, scale(inverse * y, torque)))


@inlined
def eliminate_flexible(topology, constants, work, p, loads, rows, j, n, free):
    """Eliminate a flexible body, whose y starts at j, as :func:`eliminate` does."""
    size = free + at(topology, p, at_.MODES)
    w = at(topology, p, at_.ELIMINATED)
    d = w + 6 * size
    for k in range(rows):
        c = loads + 6 * k
        y = j + n * k
        f, t = load(work, c), load(work, c + 3)
        if free == 1:
            work[y] += along_joint(topology, constants, p, f, t)
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
def eliminate(topology, constants, work, held, p, loads, rows, o, n):
    """Write the columns y of body p for loads on it, and take W D^-1 y from the loads."""
    free = free_joint(topology, held, p)
    j = o + at(topology, p, at_.COORDINATE)
    if at(topology, p, at_.MODES) > 0:
        j += at(topology, p, at_.JOINT) - free
        eliminate_flexible(topology, constants, work, p, loads, rows, j, n, free)
    elif free == 1:
        eliminate_rigid(topology, constants, work, p, loads, rows, j, n)


@inlined
def load_mimic(topology, constants, work, constraint, t, o):
    """Write the forces along both joints of a mimic row, which has no wrenches."""
    for k in range(6):
        work[t + loop_.LOADS + k] = 0.0
        work[t + loop_.LOADS + SIDE + k] = 0.0
    factor = constants[at(topology, constraint, loop_.CONSTANTS) + loop_.MULTIPLIER]
    work[o + at(topology, at(topology, constraint, loop_.CHILD), at_.COORDINATE)] += 1.0
    work[o + at(topology, at(topology, constraint, loop_.OTHER), at_.COORDINATE)] -= factor


@shared
def constraint_columns(topology, constants, work, held, constraint, t, rows, columns, n):
    """Write a constraint's columns, zero before; its rows stand in the workspace."""
    for part in range(parts(topology, constraint)):
        first, count = rows_of(topology, constraint, part)
        o = columns + n * first
        if at(topology, constraint, loop_.KIND) == loop_.MIMIC:
            load_mimic(topology, constants, work, constraint, t, o)
        else:
            load_sides(topology, work, constraint, t, rows, first, count)
        # up both sides to where they meet, and from there together; a frame eliminates nothing
        for way in range(3):
            i = at(topology, constraint, loop_.SUPPORT_PATHS + way)
            stop = at(topology, constraint, loop_.COMMON_ANCESTOR) if way < 2 else 0
            loads = t + loop_.LOADS + (SIDE if way == 1 else 0)
            if way == 2:
                for k in range(6 * count):
                    work[loads + k] += work[loads + SIDE + k]
            while i != stop:
                eliminate(topology, constants, work, held, i, loads, count, o, n)
                if at(topology, i, at_.PARENT) > 0:
                    carry(topology, work, i, loads, count, work, o, n)
                i = at(topology, i, at_.PARENT)
