"""Derivatives of the generalized forces of a wrench on a frame by the coordinates.

A wrench F keeps its direction and acts at the frame's origin x: F = [f; n + x x f]. A row i takes
J_i . F; with u_j = b_j + w_j x x the frame's velocity by q'_j, J_j = [b_j; w_j], its derivative is
w_i . (u_j x f), and (J_j x J_i) . F where column j moves the row's own.
"""

import numpy as np

from denoc_ros.kernels.algebra.spatial import (
    carried,
    dot_pair,
    pair,
    store_strided,
    strided,
    twist_about_origin,
)
from denoc_ros.kernels.algebra.vector import add, all_finite, cross, dot, load, unrotate
from denoc_ros.kernels.derivatives.derivative_rows import columns_of
from denoc_ros.kernels.dynamics.placement import place_body
from denoc_ros.kernels.dynamics.section_columns import geometric_terms
from denoc_ros.kernels.dynamics.states import over_rows
from denoc_ros.kernels.dynamics.world import place_world, section_place, world_pose
from denoc_ros.kernels.jit.compiled import inlined, merged, shared
from denoc_ros.kernels.jit.handle import (
    GOOD,
    NOT_FINITE,
    at,
    beyond,
    coordinates,
    model_arrays,
)
from denoc_ros.kernels.layout import layout as at_
from denoc_ros.kernels.layout.derivative_layout import COLUMN, WRENCH_Q


@inlined
def write_path(topology, constants, work, n, i):
    """Write the columns of all coordinates that move row i, and which of them move each.

    COLUMNS_END, in the row WRENCH_Q, is the index after the last column that moves a row's own;
    0 for a coordinate that does not move row i.
    """
    c, length = columns_of(topology)
    reach = c + length * WRENCH_Q
    for j in range(n):
        work[reach + j] = 0.0
    while i > 0:
        j = at(topology, i, at_.COORDINATE)
        if at(topology, i, at_.JOINT) == 1:
            s = at(topology, i, at_.BODY_CONSTANTS) + at_.AXIS
            o = at(topology, i, at_.WORK)
            x = load(work, o + at_.WORLD_POSITION)
            turn = o + at_.WORLD_ROTATION
            column = twist_about_origin(work, turn, x, load(constants, s), load(constants, s + 3))
            store_strided(work, c + length * COLUMN + j, length, column)
            work[reach + j] = j + 1
        p = at(topology, i, at_.PARENT)
        if at(topology, i, at_.SECTION) > 0:
            turn = at(topology, p, at_.WORK) + at_.WORLD_ROTATION
            place = section_place(topology, work, i)
            j = at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT)
            for k in range(at(topology, p, at_.MODES)):
                linear, angular = pair(
                    work, at(topology, i, at_.SECTION_WORK) + at_.COLUMNS + 6 * k
                )
                column = twist_about_origin(work, turn, place, linear, angular)
                store_strided(work, c + length * COLUMN + j + k, length, column)
                work[reach + j + k] = j + at(topology, p, at_.MODES)
        i = p


@inlined
def subtract_geometric(topology, constants, work, n, i, wrench, out):
    """Subtract the effect of turning sections, from row i to the base, on their modal forces."""
    while i > 0:
        p = at(topology, i, at_.PARENT)
        if at(topology, i, at_.SECTION) > 0:
            m = at(topology, p, at_.MODES)
            block = at(topology, p, at_.OWN)  # has room for m x m
            j = at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT)
            turn = at(topology, p, at_.WORK) + at_.WORLD_ROTATION
            torque = add(wrench[1], cross(wrench[0], section_place(topology, work, i)))
            f, t = unrotate(work, turn, wrench[0]), unrotate(work, turn, torque)
            for k in range(m * m):
                work[block + k] = 0.0
            geometric_terms(topology, constants, work, i, f, t, block, m)
            for k in range(m):
                for r in range(m):
                    out[n * (j + k) + j + r] -= work[block + m * k + r]
        i = p


@merged
def subtract_load(handle, q, i, wrench, out):
    """Subtract from out (n, n) the derivative by q of the generalized forces of a wrench (6)."""
    topology, constants, work, _diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    place_world(topology, constants, work, bodies, q)
    if i > bodies:
        place_body(topology, constants, work, q, i)
        world_pose(topology, work, i)
    write_path(topology, constants, work, n, i)
    c, length = columns_of(topology)
    x = load(work, at(topology, i, at_.WORK) + at_.WORLD_POSITION)
    force = load(wrench, 0)
    about = force, add(load(wrench, 3), cross(x, force))
    for row in range(n):
        reach = work[c + length * WRENCH_Q + row]
        if reach == 0.0:
            continue
        own = strided(work, c + length * COLUMN + row, length)
        for j in range(n):
            if work[c + length * WRENCH_Q + j] == 0.0:
                continue
            column = strided(work, c + length * COLUMN + j, length)
            change = dot(own[1], cross(add(column[0], cross(column[1], x)), force))
            if j < reach:
                change += dot_pair(carried(column, own), about)
            out[n * row + j] -= change
    subtract_geometric(topology, constants, work, n, i, about, out)
    return GOOD if all_finite(out, n * n) else NOT_FINITE


@shared
def subtract_frame_load(handle, q, loaded, out):
    """Subtract the derivative of a wrench on a frame: its row, then the wrench."""
    return subtract_load(handle, q, np.int64(loaded[0]), beyond(loaded, 1), out)


subtract_load_rows = over_rows('subtract_load_rows', subtract_frame_load, 3)
