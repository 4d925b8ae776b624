"""Poses, Jacobians and twists of frames in the base frame."""

from denoc_ros.kernels.compiled import inlined, kernel
from denoc_ros.kernels.layout import (
    ARM,
    AXIS,
    COLUMNS,
    COORDINATE,
    JOINT,
    MODES,
    PARENT,
    PLACE,
    REAL,
    SECTION,
    SECTION_WORK,
    WORK,
    WORLD_POSITION,
    WORLD_ROTATION,
)
from denoc_ros.kernels.placement import multiply, place_body
from denoc_ros.kernels.vector import add, cross, load, rotate, scale, store


@inlined
def section_place(ints, work, i):
    """Return the position, in the base frame, of what row i hangs on."""
    p = ints[i, PARENT]
    if p < 0:
        return 0.0, 0.0, 0.0
    u = ints[p, WORK]
    position = load(work, u + WORLD_POSITION)
    if ints[i, SECTION] >= 0:
        place = load(work, ints[i, SECTION_WORK] + PLACE)
        position = add(position, rotate(work, u + WORLD_ROTATION, place))
    return position


@inlined
def world_pose(ints, work, i):
    """Write the pose of row i in the base frame; its carrier's must stand there already."""
    o = ints[i, WORK]
    p = ints[i, PARENT]
    if p < 0:
        for k in range(9):
            work[o + WORLD_ROTATION + k] = work[o + k]
        store(work, o + WORLD_POSITION, load(work, o + ARM))
        return
    u = ints[p, WORK] + WORLD_ROTATION
    multiply(work, u, work, o, work, o + WORLD_ROTATION)
    arm = rotate(work, u, load(work, o + ARM))
    store(work, o + WORLD_POSITION, add(section_place(ints, work, i), arm))


@inlined
def place_world(ints, reals, work, bodies, q):
    """Place every body in the base frame."""
    for i in range(bodies):
        place_body(ints, reals, work, q, i)
        world_pose(ints, work, i)


@kernel
def frame_pose(ints, reals, work, bodies, q, i, out):
    """Write the (4, 4) pose of row i in the base frame."""
    place_world(ints, reals, work, bodies, q)
    if i >= bodies:
        place_body(ints, reals, work, q, i)
        world_pose(ints, work, i)
    o = ints[i, WORK]
    for r in range(3):
        for c in range(3):
            out[r, c] = work[o + WORLD_ROTATION + 3 * r + c]
        out[r, 3] = work[o + WORLD_POSITION + r]
        out[3, r] = 0.0
    out[3, 3] = 1.0


@inlined
def write_column(out, j, linear, angular):
    """Write column j of a (6, n) Jacobian."""
    for k in range(3):
        out[k, j] = linear[k]
        out[3 + k, j] = angular[k]


@kernel
def frame_jacobian(ints, reals, work, bodies, q, i, out):
    """Write the (6, n) Jacobian of row i, linear first, base axes, at its origin."""
    place_world(ints, reals, work, bodies, q)
    if i >= bodies:
        place_body(ints, reals, work, q, i)
        world_pose(ints, work, i)
    out[:, :] = 0.0
    point = load(work, ints[i, WORK] + WORLD_POSITION)
    while i >= 0:
        o = ints[i, WORK]
        j = ints[i, COORDINATE]
        if ints[i, JOINT] == 1:
            s = ints[i, REAL] + AXIS
            arm = add(point, scale(-1.0, load(work, o + WORLD_POSITION)))
            turn = rotate(work, o + WORLD_ROTATION, load(reals, s + 3))
            slide = rotate(work, o + WORLD_ROTATION, load(reals, s))
            write_column(out, j, add(slide, cross(turn, arm)), turn)
        p = ints[i, PARENT]
        if ints[i, SECTION] >= 0:
            u = ints[p, WORK] + WORLD_ROTATION
            c = ints[i, SECTION_WORK] + COLUMNS
            arm = add(point, scale(-1.0, section_place(ints, work, i)))
            j = ints[p, COORDINATE] + ints[p, JOINT]
            for k in range(j, j + ints[p, MODES]):
                turn = rotate(work, u, load(work, c + 3))
                slide = rotate(work, u, load(work, c))
                write_column(out, k, add(slide, cross(turn, arm)), turn)
                c += 6
        i = p
