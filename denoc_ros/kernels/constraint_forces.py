"""How the generalized forces J^T lambda of the constraints change with q, lambda constant.

A loop's multipliers are a wrench on its child, force f and torque t in the parent's axes, and the
opposite one on its parent. The forces of wrenches that keep their direction change as
load_derivatives says; beside that the wrench turns with the parent, and its torque changes with
the relative rotation: with D u that change, with s = l + T x d the way of the child's origin and T
the parent's angular column, all in the parent's axes (see relative_columns), row i, column j is

    l_i . (T_j x f) + u_i . (T_j x t + D u_j) - T_i . (s_j x f).
"""

from denoc_ros.kernels import constrained_derivative_layout as cdiff_
from denoc_ros.kernels import constraint_layout as loop_
from denoc_ros.kernels.closure import constraints
from denoc_ros.kernels.compiled import inlined, merged, shared
from denoc_ros.kernels.constraint_rates import loop_place, places_of, universal_torque
from denoc_ros.kernels.handle import at, coordinates, model_arrays
from denoc_ros.kernels.layout import WORK, WORLD_ROTATION
from denoc_ros.kernels.load_derivatives import subtract_load
from denoc_ros.kernels.loop_motion import NONE, aligned_error, aligned_torque
from denoc_ros.kernels.pointers import part
from denoc_ros.kernels.spatial import pair
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


@shared
def subtract_wrench(handle, q, i, wrench, out):
    """Wrap load_derivatives.subtract_load."""
    return subtract_load(handle, q, i, wrench, out)


@inlined
def weighted(constants, work, o, first, count):
    """Return the sum of directions at o of constants times weights at `first` of work."""
    total = NONE
    for k in range(count):
        total = add(total, scale(work[first + k], load(constants, o + 3 * k)))
    return total


@inlined
def torque_of(topology, constants, work, constraint, turn, first, w):
    """Return the torque of a loop's angular rows, and its rate as the child turns with w.

    first: where the weights of these rows stand in work.
    """
    kind = at(topology, constraint, loop_.KIND)
    if kind == loop_.UNIVERSAL:
        found = universal_torque(topology, constants, work, constraint, turn, work[first], w, NONE)
        return found[0], found[1]
    if kind == loop_.POINT:
        return NONE, NONE
    o = (
        at(topology, constraint, loop_.CONSTANTS)
        + loop_.DIRECTIONS
        + 3 * at(topology, constraint, loop_.LINEAR)
    )
    along = weighted(constants, work, o, first, at(topology, constraint, loop_.ANGULAR))
    error = aligned_error(topology, constants, work, constraint, turn, w, NONE)
    found = aligned_torque(topology, constants, work, constraint, turn, along, error, w, NONE)
    return found[0], found[1]


@inlined
def axis_wrench(topology, constants, work, constraint, weights):
    """Return the wrench along a loop's free axis."""
    row = at(topology, constraint, loop_.AXIS_ROW)
    if row == 0:
        return NONE, NONE
    c = at(topology, constraint, loop_.CONSTANTS)
    along = scale(work[weights + row], load(constants, c + loop_.FREE_AXIS))
    return (along, NONE) if constants[c + loop_.SLIDES] == 1.0 else (NONE, along)


@merged
def subtract_turning(work, loop, n, force, torque, change, out):
    """Subtract the parts that turn with the parent and with the relative rotation.

    change: where D^T stands in work.
    """
    apart = load(work, loop + cdiff_.RELATIVE_POSITION)
    for j in range(n):
        k = loop + cdiff_.LOOP_COLUMNS + cdiff_.LOOP_COLUMN * j
        linear, angular = pair(work, k)
        turn = load(work, k + cdiff_.PARENT_TURN)
        pull = cross(turn, force)
        twist = add(unrotate(work, change, angular), cross(turn, torque))
        lever = cross(add(linear, cross(turn, apart)), force)
        for i in range(n):
            k = loop + cdiff_.LOOP_COLUMNS + cdiff_.LOOP_COLUMN * i
            own = pair(work, k)
            total = dot(own[0], pull) + dot(own[1], twist)
            out[n * i + j] -= total - dot(load(work, k + cdiff_.PARENT_TURN), lever)


@merged
def write_change(topology, constants, work, constraint, turn, first, o):
    """Write D^T (3, 3) to o; return the torque."""
    torque = NONE
    for k in range(3):
        axis = (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)
        torque, change = torque_of(topology, constants, work, constraint, turn, first, axis)
        store(work, o + 3 * k, change)
    return torque


@merged
def subtract_sides(handle, q, constraint, loop, force, torque, out):
    """Subtract the change by q of the wrench on the child and its opposite on the parent."""
    topology, _constants, work, _diagonals, _bodies = model_arrays(handle)
    places = places_of(topology, coordinates(handle))
    wrench = part(work, places.wrench, 6)
    base = at(topology, at(topology, constraint, loop_.OTHER), WORK) + WORLD_ROTATION
    lever = rotate(work, base, cross(load(work, loop + cdiff_.RELATIVE_POSITION), force))
    force, torque = rotate(work, base, force), rotate(work, base, torque)
    for side in range(2):
        store(wrench, 0, force)
        store(wrench, 3, torque)
        frame = at(topology, constraint, loop_.CHILD if side == 0 else loop_.OTHER)
        subtract_wrench(handle, q, frame, wrench, out)
        force, torque = scale(-1.0, force), subtract(scale(-1.0, torque), lever)


@merged
def subtract_force_change(handle, q, weights, out):
    """Subtract d(J^T weights)/dq from out (n, n); the loops' relative motion must stand in work.

    weights: offset in work of those of all rows, free axes included.
    """
    topology, constants, work, _diagonals, _bodies = model_arrays(handle)
    n = coordinates(handle)
    places = places_of(topology, n)
    for constraint in constraints(topology):
        if at(topology, constraint, loop_.KIND) == loop_.MIMIC:
            continue
        loop = loop_place(topology, places, constraint, n)
        turn, linear = loop + cdiff_.RELATIVE_ROTATION, at(topology, constraint, loop_.LINEAR)
        first = weights + at(topology, constraint, loop_.ROW)
        o = at(topology, constraint, loop_.CONSTANTS) + loop_.DIRECTIONS
        force = weighted(constants, work, o, first, linear)
        change = places.wrench + 6
        torque = write_change(topology, constants, work, constraint, turn, first + linear, change)
        along, about = axis_wrench(topology, constants, work, constraint, weights)
        force, torque = add(force, along), add(torque, about)
        subtract_turning(work, loop, n, force, torque, change, out)
        subtract_sides(handle, q, constraint, loop, force, torque, out)
