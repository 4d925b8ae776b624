"""Columns of the motion of a loop's child frame as its parent's frame sees it, and their rates.

With L, T the columns of both frames' Jacobians (p: parent), d the way from the parent's to the
child's origin and R the parent's rotation, the relative column of a coordinate is [R^T l; R^T u]
with l = L - L_p - T_p x d, u = T - T_p. Its rates are those in the parent's frame, which turns:
x' - w x x, and x'' - 2 w x x' - al x x + w x (w x x).
"""

from denoc_ros.kernels import constrained_derivative_layout as cdiff_
from denoc_ros.kernels.compiled import inlined, merged
from denoc_ros.kernels.constraint_layout import CHILD, OTHER
from denoc_ros.kernels.frame_motion import body_state, carried, write_columns
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.layout import WORK, WORLD_ROTATION
from denoc_ros.kernels.motion import linear_velocity, move_body
from denoc_ros.kernels.placement import place_body
from denoc_ros.kernels.pointers import part
from denoc_ros.kernels.vector import add, cross, load, scale, store, subtract, unrotate
from denoc_ros.kernels.world import world_pose


@inlined
def write_frame_column(out, _n, j, linear, turn, _w, _al):
    """Write a column of a frame's Jacobian and its rates."""
    o = cdiff_.FRAME_COLUMN * j
    for k in range(3):
        store(out, o + 3 * k, linear[k])
        store(out, o + 9 + 3 * k, turn[k])


@merged
def frame_columns(topology, constants, work, q, qd, qdd, i, out, n):
    """Place and move frame i on bodies that are, and write its columns."""
    place_body(topology, constants, work, q, i)
    world_pose(topology, work, i)
    move_body(topology, constants, work, qd, qdd, i)
    linear_velocity(topology, constants, work, qd, i)
    frame = body_state(work, at(topology, i, WORK))
    for k in range(cdiff_.FRAME_COLUMN * n):
        out[k] = 0.0
    write_columns(write_frame_column, topology, constants, work, qd, qdd, i, frame, out, n)


@inlined
def three(a, o):
    """Return three vectors that follow each other from offset o of a."""
    return load(a, o), load(a, o + 3), load(a, o + 6)


@inlined
def difference(x, y):
    """Return x - y of a vector and its two rates."""
    return subtract(x[0], y[0]), subtract(x[1], y[1]), subtract(x[2], y[2])


@inlined
def as_seen(work, turn, x, w, al):
    """Return a vector in base axes and its rates as a frame sees them that turns with w, al."""
    turned = cross(w, x[0])
    second = subtract(x[2], add(scale(2.0, cross(w, x[1])), cross(al, x[0])))
    second = add(second, cross(w, turned))
    return (
        unrotate(work, turn, x[0]),
        unrotate(work, turn, subtract(x[1], turned)),
        unrotate(work, turn, second),
    )


@inlined
def relative_pose(topology, work, constraint, o):
    """Write the rotation of a loop's child frame as the parent's sees it."""
    parent = at(topology, at(topology, constraint, OTHER), WORK) + WORLD_ROTATION
    child = at(topology, at(topology, constraint, CHILD), WORK) + WORLD_ROTATION
    for k in range(3):
        column = unrotate(
            work, parent, (work[child + k], work[child + 3 + k], work[child + 6 + k])
        )
        work[o + cdiff_.RELATIVE_ROTATION + k] = column[0]
        work[o + cdiff_.RELATIVE_ROTATION + 3 + k] = column[1]
        work[o + cdiff_.RELATIVE_ROTATION + 6 + k] = column[2]


@merged
def loop_columns(topology, constants, work, motion, constraint, frames, o, n):
    """Write at o the columns of a loop's relative motion by every coordinate.

    motion: q, q' and q'', of which bodies are placed and moved; frames: room for two frames.
    """
    q, qd, qdd = motion
    size = cdiff_.FRAME_COLUMN * n
    i, p = at(topology, constraint, CHILD), at(topology, constraint, OTHER)
    for side in range(2):
        frame_columns(
            topology, constants, work, q, qd, qdd, p if side else i,
            part(work, frames + size * side, size), n,
        )  # fmt: skip
    child, parent = part(work, frames, size), part(work, frames + size, size)
    c = body_state(work, at(topology, i, WORK))
    base = body_state(work, at(topology, p, WORK))
    w, al = base[3], base[4]
    turn = at(topology, p, WORK) + WORLD_ROTATION
    arm = (subtract(c[0], base[0]), subtract(c[1], base[1]), subtract(c[2], base[2]))
    relative_pose(topology, work, constraint, o)
    store(work, o + cdiff_.RELATIVE_POSITION, unrotate(work, turn, arm[0]))
    faster = subtract(c[3], w)
    store(work, o + cdiff_.ANGULAR_VELOCITY, unrotate(work, turn, faster))
    gained = subtract(subtract(c[4], al), cross(w, faster))
    store(work, o + cdiff_.ANGULAR_ACCELERATION, unrotate(work, turn, gained))
    for j in range(n):
        k = cdiff_.FRAME_COLUMN * j
        slide, spin = three(parent, k), three(parent, k + 9)
        linear = difference(three(child, k), carried(slide, spin, arm))
        linear = as_seen(work, turn, linear, w, al)
        angular = as_seen(work, turn, difference(three(child, k + 9), spin), w, al)
        k = o + cdiff_.LOOP_COLUMNS + cdiff_.LOOP_COLUMN * j
        for order in range(3):
            store(work, k + 6 * order, linear[order])
            store(work, k + 6 * order + 3, angular[order])
        store(work, k + cdiff_.PARENT_TURN, unrotate(work, turn, spin[0]))
