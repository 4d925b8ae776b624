"""Poses, Jacobians and twists of frames in the base frame."""

import numpy as np

from denoc_ros.kernels.algebra.vector import add, cross, load, rotate, scale, store
from denoc_ros.kernels.dynamics.placement import multiply, place_body
from denoc_ros.kernels.dynamics.states import over_rows
from denoc_ros.kernels.jit.compiled import inlined, kernel, shared
from denoc_ros.kernels.jit.handle import GOOD, at, coordinates, elements, model_arrays
from denoc_ros.kernels.layout import layout as at_


@inlined
def section_place(topology, work, i):
    """Position, in the base frame, of the section that row i hangs on."""
    p = at(topology, i, at_.PARENT)
    u = at(topology, p, at_.WORK)
    position = load(work, u + at_.WORLD_POSITION)
    if at(topology, i, at_.SECTION) > 0:
        place = load(work, at(topology, i, at_.SECTION_WORK) + at_.SECTION_POSITION)
        position = add(position, rotate(work, u + at_.WORLD_ROTATION, place))
    return position


@inlined
def world_pose(topology, work, i):
    """Write the pose of row i in the base frame; its carrier's must stand there already."""
    o = at(topology, i, at_.WORK)
    p = at(topology, i, at_.PARENT)
    u = at(topology, p, at_.WORK) + at_.WORLD_ROTATION
    multiply(work, u, work, o, work, o + at_.WORLD_ROTATION)
    arm = rotate(work, u, load(work, o + at_.ARM))
    store(work, o + at_.WORLD_POSITION, add(section_place(topology, work, i), arm))


@inlined
def place_world(topology, constants, work, bodies, q):
    """Place every body in the base frame."""
    for i in range(1, bodies + 1):
        place_body(topology, constants, work, q, i)
        world_pose(topology, work, i)


@shared
def find_pose(handle, q, i, out):
    """Write the (4, 4) pose of row i in the base frame."""
    topology, constants, work, _diagonals, bodies = model_arrays(handle)
    place_world(topology, constants, work, bodies, q)
    if i > bodies:
        place_body(topology, constants, work, q, i)
        world_pose(topology, work, i)
    o = at(topology, i, at_.WORK)
    for r in range(3):
        for c in range(3):
            out[4 * r + c] = work[o + at_.WORLD_ROTATION + 3 * r + c]
        out[4 * r + 3] = work[o + at_.WORLD_POSITION + r]
        out[12 + r] = 0.0
    out[15] = 1.0
    return GOOD


@kernel('int64(int64, float64[::1], int64, float64[:, ::1])')
def frame_pose(handle, q, i, out):
    """Write the (4, 4) pose of row i in the base frame."""
    return find_pose(handle, elements(q), i, elements(out))


@shared
def find_frame_pose(handle, q, frame, out):
    """Do the same for a frame as a number, its row of the model."""
    return find_pose(handle, q, np.int64(frame[0]), out)


frame_pose_rows = over_rows('frame_pose_rows', find_frame_pose, 3)


@kernel('int64(int64, float64[::1])')
def place_bodies(handle, q):
    """Place every body in the base frame, all in the workspace."""
    topology, constants, work, _diagonals, bodies = model_arrays(handle)
    place_world(topology, constants, work, bodies, elements(q))
    return GOOD


@inlined
def write_column(out, n, j, linear, angular):
    """Write column j of a (6, n) Jacobian."""
    for k in range(3):
        out[n * k + j] = linear[k]
        out[n * (3 + k) + j] = angular[k]


@shared
def find_jacobian(handle, q, i, out):
    """Write the (6, n) Jacobian of row i, linear first, base axes, at its origin."""
    topology, constants, work, _diagonals, bodies = model_arrays(handle)
    place_world(topology, constants, work, bodies, q)
    if i > bodies:
        place_body(topology, constants, work, q, i)
        world_pose(topology, work, i)
    n = coordinates(handle)
    for k in range(6 * n):
        out[k] = 0.0
    point = load(work, at(topology, i, at_.WORK) + at_.WORLD_POSITION)
    while i > 0:
        o = at(topology, i, at_.WORK)
        j = at(topology, i, at_.COORDINATE)
        if at(topology, i, at_.JOINT) == 1:
            s = at(topology, i, at_.BODY_CONSTANTS) + at_.AXIS
            arm = add(point, scale(-1.0, load(work, o + at_.WORLD_POSITION)))
            turn = rotate(work, o + at_.WORLD_ROTATION, load(constants, s + 3))
            slide = rotate(work, o + at_.WORLD_ROTATION, load(constants, s))
            write_column(out, n, j, add(slide, cross(turn, arm)), turn)
        p = at(topology, i, at_.PARENT)
        if at(topology, i, at_.SECTION) > 0:
            u = at(topology, p, at_.WORK) + at_.WORLD_ROTATION
            c = at(topology, i, at_.SECTION_WORK) + at_.COLUMNS
            arm = add(point, scale(-1.0, section_place(topology, work, i)))
            j = at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT)
            for k in range(j, j + at(topology, p, at_.MODES)):
                turn = rotate(work, u, load(work, c + 3))
                slide = rotate(work, u, load(work, c))
                write_column(out, n, k, add(slide, cross(turn, arm)), turn)
                c += 6
        i = p
    return GOOD


@kernel('int64(int64, float64[::1], int64, float64[:, ::1])')
def frame_jacobian(handle, q, i, out):
    """Write the (6, n) Jacobian of row i, linear first, base axes, at its origin."""
    return find_jacobian(handle, elements(q), i, elements(out))


@shared
def find_frame_jacobian(handle, q, frame, out):
    """Do the same for a frame as a number, its row of the model."""
    return find_jacobian(handle, q, np.int64(frame[0]), out)


frame_jacobian_rows = over_rows('frame_jacobian_rows', find_frame_jacobian, 3)
