"""Outward pass of the derivatives: twists, columns and each body's own share, in base axes."""

from denoc_ros.kernels import derivative_layout as diff_
from denoc_ros.kernels import layout as at_
from denoc_ros.kernels.beam_derivatives import beam_derivatives
from denoc_ros.kernels.block import six
from denoc_ros.kernels.compiled import short_inlined, short_shared
from denoc_ros.kernels.component_derivatives import component_derivatives
from denoc_ros.kernels.composite import shifted_spin
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.section_columns import show_columns, write_seen
from denoc_ros.kernels.spatial import (
    carried,
    pair,
    scale_pair,
    store_pair,
    store_strided,
    sum_pair,
    twist_about_origin,
    wrench_about_origin,
)
from denoc_ros.kernels.vector import (
    add,
    cross,
    dot,
    load,
    rotate,
    scale,
    store,
    times,
    turned,
    unrotate,
)


@short_inlined
def joint_column(topology, constants, work, i):
    """Return the column of body i's joint: its motion subspace in base axes."""
    turn = at(topology, i, at_.WORK) + at_.WORLD_ROTATION
    x = load(work, at(topology, i, at_.WORK) + at_.WORLD_POSITION)
    if at(topology, i, at_.MOTION) == at_.REVOLUTE_Z:
        w = (work[turn + 2], work[turn + 5], work[turn + 8])
        return cross(x, w), w
    s = at(topology, i, at_.BODY_CONSTANTS) + at_.AXIS
    return twist_about_origin(work, turn, x, load(constants, s), load(constants, s + 3))


@short_inlined
def move_world(topology, constants, work, qd, qdd, i):
    """Write body i's twist and its derivative and the columns that its motion adds."""
    p = at(topology, i, at_.PARENT)
    e, u = at(topology, i, at_.DERIVED), at(topology, p, at_.DERIVED)
    for k in range(12):
        work[e + diff_.TWIST + k] = work[u + diff_.TWIST + k]
    if at(topology, i, at_.SECTION) > 0:
        write_seen(topology, constants, work, qd, qdd, i)
    if at(topology, p, at_.MODES) > 0:
        show_columns(topology, work, i)
    if at(topology, i, at_.JOINT) == 0:
        return
    j = at(topology, i, at_.COORDINATE)
    v, a = pair(work, e + diff_.TWIST), pair(work, e + diff_.ACCELERATED)
    column = joint_column(topology, constants, work, i)
    rate = carried(v, column)
    v = sum_pair(v, scale_pair(qd[j], column))
    a = sum_pair(a, sum_pair(scale_pair(qdd[j], column), scale_pair(qd[j], rate)))
    store_pair(work, e + diff_.TWIST, v)
    store_pair(work, e + diff_.ACCELERATED, a)
    length = at(topology, 0, diff_.ROW_LENGTH)
    c = at(topology, 0, at_.DERIVED) + diff_.COLUMNS + j
    store_strided(work, c + length * diff_.COLUMN, length, column)
    store_strided(work, c + length * diff_.COLUMN_RATE, length, rate)
    bend = sum_pair(carried(a, column), carried(v, rate))
    store_strided(work, c + length * diff_.COLUMN_BEND, length, bend)


@short_inlined
def turning_of_rigid(mass_velocity, v, w, moment, spin, work, o):
    """Add to the 3 x 3 at offset o of work 2 int (v . p - v p^T) dm of a rigid body.

    2 (v . c) 1 - 2 v c^T - tr(I) w x + 2 w x I, with the first moment c and the inertia I.
    """
    xx, xy, xz, yy, yz, zz = spin
    trace = xx + yy + zz
    outward = 2.0 * mass_velocity
    x, y, z = cross(w, (xx, xy, xz)), cross(w, (xy, yy, yz)), cross(w, (xz, yz, zz))
    for r in range(3):
        work[o + 3 * r] += 2.0 * (x[r] - v[r] * moment[0])
        work[o + 3 * r + 1] += 2.0 * (y[r] - v[r] * moment[1])
        work[o + 3 * r + 2] += 2.0 * (z[r] - v[r] * moment[2])
        work[o + 4 * r] += outward
    work[o + 1] += trace * w[2]
    work[o + 2] -= trace * w[1]
    work[o + 3] -= trace * w[2]
    work[o + 5] += trace * w[0]
    work[o + 6] += trace * w[1]
    work[o + 7] -= trace * w[0]


@short_inlined
def turn_matrix(work, turn, o):
    """Turn the 3 x 3 at offset o of work from body axes to base axes: R K R^T."""
    x, y, z = load(work, o), load(work, o + 3), load(work, o + 6)
    x, y, z = rotate(work, turn, x), rotate(work, turn, y), rotate(work, turn, z)
    for k in range(3):
        column = rotate(work, turn, (x[k], y[k], z[k]))
        work[o + k], work[o + 3 + k], work[o + 6 + k] = column


@short_inlined
def own_beam(topology, constants, work, qd, qdd, i):
    """Write body i's beam, in body axes; momentum and turning in base axes."""
    o, e = at(topology, i, at_.WORK), at(topology, i, at_.DERIVED)
    turn = o + at_.WORLD_ROTATION
    x = load(work, o + at_.WORLD_POSITION)
    (v, w), (a, al) = pair(work, e + diff_.TWIST), pair(work, e + diff_.ACCELERATED)
    velocity = add(v, cross(w, x))
    acceleration = add(add(a, cross(al, x)), cross(w, velocity))
    store(work, o + at_.VELOCITY, unrotate(work, turn, velocity))
    store(work, o + at_.ANGULAR_VELOCITY, unrotate(work, turn, w))
    store(work, o + at_.ACCELERATION, unrotate(work, turn, acceleration))
    store(work, o + at_.ANGULAR_ACCELERATION, unrotate(work, turn, al))
    if at(topology, i, at_.COMPONENTS) > 0:
        component_derivatives(topology, constants, work, qd, qdd, i)
    else:
        beam_derivatives(topology, constants, work, qd, qdd, i)
    momentum = rotate(work, turn, load(work, e + diff_.MOMENTUM))
    store(work, e + diff_.MOMENTUM, momentum)
    turn_matrix(work, turn, e + diff_.TURNING)
    outward = 2.0 * dot(momentum, x)
    for r in range(3):
        work[e + diff_.TURNING + 4 * r] += outward
        for k in range(3):
            work[e + diff_.TURNING + 3 * r + k] -= 2.0 * momentum[r] * x[k]


@short_shared
def own_share(topology, constants, work, qd, qdd, i):
    """Write inertia, momentum, turning and wrench of body i alone, in base axes."""
    o, e = at(topology, i, at_.WORK), at(topology, i, at_.DERIVED)
    turn = o + at_.WORLD_ROTATION
    x = load(work, o + at_.WORLD_POSITION)
    f, t = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    if at(topology, i, at_.MODES) > 0:
        own_beam(topology, constants, work, qd, qdd, i)
        f, t = wrench_about_origin(
            work, turn, x, load(work, o + at_.FORCE), load(work, o + at_.TORQUE)
        )
        c, source = o + at_.COMPOSITE, work
    else:
        for k in range(diff_.MOMENTUM, diff_.TURNING + 9):
            work[e + k] = 0.0
        c, source = at(topology, i, at_.BODY_CONSTANTS) + at_.MASS, constants
    mass = source[c]
    moment = rotate(work, turn, load(source, c + 1))
    rotated = turned(
        six(source, c + 4), load(work, turn), load(work, turn + 3), load(work, turn + 6)
    )
    spin = shifted_spin(rotated, mass, moment, x)
    moment = add(moment, scale(mass, x))
    work[e + diff_.BODY_MASS] = mass
    store(work, e + diff_.BODY_FIRST_MOMENT, moment)
    store(work, e + diff_.BODY_ROTATIONAL_INERTIA, (spin[0], spin[1], spin[2]))
    store(work, e + diff_.BODY_ROTATIONAL_INERTIA + 3, (spin[3], spin[4], spin[5]))
    (v, w), (a, al) = pair(work, e + diff_.TWIST), pair(work, e + diff_.ACCELERATED)
    momentum = add(scale(mass, v), cross(w, moment))
    turning_of_rigid(dot(v, moment), v, w, moment, spin, work, e + diff_.TURNING)
    angular = add(cross(moment, v), times(spin, w))
    f = add(f, add(add(scale(mass, a), cross(al, moment)), cross(w, momentum)))
    t = add(t, add(cross(moment, a), times(spin, al)))
    t = add(t, add(cross(w, angular), cross(v, momentum)))
    store(work, e + diff_.MOMENTUM, add(load(work, e + diff_.MOMENTUM), momentum))
    store(work, e + diff_.WRENCH, f)
    store(work, e + diff_.WRENCH + 3, t)
