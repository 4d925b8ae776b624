"""Derivatives of inverse dynamics by coordinates, rates, accelerations: docs/derivatives.md."""

from numba import types

from denoc_ros.kernels.algebra.joint_block import six
from denoc_ros.kernels.algebra.lanes import (
    add_pair,
    add_vector,
    put,
    put_all,
    put_pair,
    put_vector,
    take,
    take_pair,
    take_vector,
)
from denoc_ros.kernels.algebra.rotation import write_sines
from denoc_ros.kernels.algebra.spatial import (
    carried,
    dot_pair,
    pair,
    scale_pair,
    store_pair,
    store_strided,
    strided,
    strided_vector,
    sum_pair,
    twist_about_origin,
    wrench_about_origin,
)
from denoc_ros.kernels.algebra.vector import (
    add,
    all_finite,
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
from denoc_ros.kernels.derivatives.beam_derivatives import beam_derivatives
from denoc_ros.kernels.derivatives.component_derivatives import component_derivatives
from denoc_ros.kernels.derivatives.derivative_rows import (
    columns_of,
    half_turning,
    inboard_entries,
    outboard_entries,
    own_of,
    store_wrenches,
    with_carried,
    wrenches_by,
    zero_span,
)
from denoc_ros.kernels.dynamics.composite import shifted_spin
from denoc_ros.kernels.dynamics.placement import move_modes, place_by_sines
from denoc_ros.kernels.dynamics.section_columns import geometric_terms, show_columns, write_seen
from denoc_ros.kernels.dynamics.states import matrices_of_state, over_rows
from denoc_ros.kernels.dynamics.world import section_place, world_pose
from denoc_ros.kernels.jit import handle as rec_
from denoc_ros.kernels.jit.compiled import (
    NUMBERS,
    apart,
    merged,
    short_inlined,
    short_shared,
)
from denoc_ros.kernels.jit.handle import (
    GOOD,
    NOT_FINITE,
    at,
    coordinates,
    model_arrays,
)
from denoc_ros.kernels.layout import derivative_layout as diff_
from denoc_ros.kernels.layout import layout as at_
from denoc_ros.kernels.springs.spring_torque import internal_slope


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


@merged
def outward_derivatives(n, topology, constants, work, diagonals, bodies, q, qd, qdd):
    """Place and move every body in base axes and write its own share."""
    sines, cosines = diagonals[rec_.SINE], diagonals[rec_.COSINE]
    write_sines(q, n, sines, cosines)
    base = at(topology, 0, at_.DERIVED)
    motion = at(topology, 0, at_.WORK)
    # seen from axes that move along with the base's origin, with a constant velocity: there its
    # spatial acceleration is the classical one
    store(work, base + diff_.TWIST, (0.0, 0.0, 0.0))
    store(work, base + diff_.TWIST + 3, load(work, motion + at_.ANGULAR_VELOCITY))
    store(work, base + diff_.ACCELERATED, load(work, motion + at_.ACCELERATION))
    store(work, base + diff_.ACCELERATED + 3, load(work, motion + at_.ANGULAR_ACCELERATION))
    for i in range(1, bodies + 1):
        place_by_sines(topology, constants, work, q, sines, cosines, i)
        move_modes(topology, constants, work, q, qd, qdd, i)
        world_pose(topology, work, i)
        move_world(topology, constants, work, qd, qdd, i)
        own_share(topology, constants, work, qd, qdd, i)


@short_inlined
def joint_entries(topology, work, n, i, by_q, by_rate, inertia):
    """Write the row of body i's joint, and the wrenches that it sends inward."""
    j = at(topology, i, at_.COORDINATE)
    e = at(topology, i, at_.DERIVED)
    c, length = columns_of(topology)
    column = strided(work, c + length * diff_.COLUMN + j, length)
    rate = strided(work, c + length * diff_.COLUMN_RATE + j, length)
    bend = strided(work, c + length * diff_.COLUMN_BEND + j, length)
    wrenches = wrenches_by(work, e, column, rate, bend)
    carried = with_carried(work, e, column, wrenches[0])
    store_wrenches(work, c, length, j, carried, wrenches[1], wrenches[2])
    half = half_turning(work, e, column)
    # its own column among those inboard: nothing of a joint's column changes by its own angle
    inboard_entries(topology, work, n, i, j, j + 1, (wrenches[2], half), by_q, by_rate, inertia)
    outboard_entries(
        topology,
        work,
        n,
        j,
        j + 1,
        at(topology, i, at_.BRANCH_END),
        column,
        by_q,
        by_rate,
        inertia,
    )
    end = at(topology, i, at_.BRANCH_END)
    zero_span(end, n, n * j, by_q, by_rate, inertia)


@short_inlined
def hand_wrenches(work, rows, own, step, length, m):
    """Let the wrenches of a beam's m modes come inward: from OWN to the rows from `rows` on."""
    for j in range(0, m, diff_.LANES):
        for k in range(6):
            by = own + step * k + j
            o = rows + length * k + j
            put(
                work, o + length * diff_.WRENCH_Q, take(work, by + step * diff_.BY_POSITION), m - j
            )
            put(work, o + length * diff_.WRENCH_QD, take(work, by + step * diff_.BY_RATE), m - j)
            put(
                work,
                o + length * diff_.WRENCH_QDD,
                take(work, by + step * diff_.BY_ACCELERATION),
                m - j,
            )


@short_inlined
def modal_entries(topology, work, n, i, by_q, by_rate, inertia):
    """Write the rows of body i's modes, inboard and among themselves, and their wrenches."""
    m = at(topology, i, at_.MODES)
    j = at(topology, i, at_.COORDINATE) + at(topology, i, at_.JOINT)
    own, step, forces = own_of(topology, i)
    c, length = columns_of(topology)
    end = at(topology, i, at_.BRANCH_END)
    hand_wrenches(work, c + j, own, step, length, m)
    for k in range(m):
        half = strided_vector(work, own + step * diff_.BY_TURNING + k, step)
        share = (strided(work, own + step * diff_.BY_ACCELERATION + k, step), half)
        inboard_entries(topology, work, n, i, j + k, j, share, by_q, by_rate, inertia)
        o = n * (j + k) + j
        for r in range(0, m, diff_.LANES):
            u = forces + step * k + r
            put(by_q, o + r, take(work, u), m - r)
            put(by_rate, o + r, take(work, u + step * m), m - r)
            put(inertia, o + r, take(work, u + 2 * step * m), m - r)
        zero_span(end, n, n * (j + k), by_q, by_rate, inertia)


@short_inlined
def own_to_base(topology, work, i):
    """Turn OWN of body i from body axes to base axes."""
    o = at(topology, i, at_.WORK)
    turn = o + at_.WORLD_ROTATION
    x = load(work, o + at_.WORLD_POSITION)
    own, step, _ = own_of(topology, i)
    for u in range(own, own + at(topology, i, at_.MODES), diff_.LANES):
        half = u + step * diff_.BY_TURNING
        put_vector(work, half, step, rotate(work, turn, take_vector(work, half, step)))
        for part in (diff_.BY_ACCELERATION, diff_.BY_POSITION, diff_.BY_RATE):
            f, t = take_pair(work, u + step * part, step)
            put_pair(work, u + step * part, step, wrench_about_origin(work, turn, x, f, t))


@short_inlined
def transmit_modes(topology, work, i, j):
    """Add the part of body i and all it carries in modes of their carrier, from j on."""
    p = at(topology, i, at_.PARENT)
    m = at(topology, p, at_.MODES)
    e = at(topology, i, at_.DERIVED)
    own, step, forces = own_of(topology, p)
    c, length = columns_of(topology)
    c += at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT) + j
    column = take_pair(work, c + length * diff_.COLUMN, length)
    rate = take_pair(work, c + length * diff_.COLUMN_RATE, length)
    bend = take_pair(work, c + length * diff_.COLUMN_BEND, length)
    by_q, by_rate, by_acceleration = wrenches_by(work, e, column, rate, bend)
    u = own + j
    add_vector(work, u + step * diff_.BY_TURNING, step, half_turning(work, e, column))
    add_pair(work, u + step * diff_.BY_POSITION, step, with_carried(work, e, column, by_q))
    add_pair(work, u + step * diff_.BY_RATE, step, by_rate)
    add_pair(work, u + step * diff_.BY_ACCELERATION, step, by_acceleration)
    for k in range(m):
        other = pair(work, e + diff_.SEEN + diff_.SEEN_SIZE * k)
        u = forces + step * k + j
        put_all(work, u, take(work, u) + dot_pair(by_q, other))
        u += step * m
        put_all(work, u, take(work, u) + dot_pair(by_rate, other))
        u += step * m
        put_all(work, u, take(work, u) + dot_pair(by_acceleration, other))


@short_shared
def transmit_to_own(topology, constants, work, i):
    """Add the part of body i and all it carries in their carrier's modal forces."""
    p = at(topology, i, at_.PARENT)
    for j in range(0, at(topology, p, at_.MODES), diff_.LANES):
        transmit_modes(topology, work, i, j)
    turn = at(topology, p, at_.WORK) + at_.WORLD_ROTATION
    f, t = pair(work, at(topology, i, at_.DERIVED) + diff_.WRENCH)
    t = add(t, cross(f, section_place(topology, work, i)))
    _, step, forces = own_of(topology, p)
    geometric_terms(
        topology, constants, work, i, unrotate(work, turn, f), unrotate(work, turn, t), forces,
        step,
    )  # fmt: skip


@short_inlined
def carrier_entries(topology, constants, work, n, i, by_q, by_rate, inertia):
    """Write the entries of the modes of body i's carrier in the columns of body i's branch."""
    p = at(topology, i, at_.PARENT)
    j = at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT)
    first, last = at(topology, i, at_.COORDINATE), at(topology, i, at_.BRANCH_END)
    for k in range(at(topology, p, at_.MODES)):
        if at(topology, i, at_.SECTION) > 0:
            column = pair(work, at(topology, i, at_.DERIVED) + diff_.SEEN + diff_.SEEN_SIZE * k)
            outboard_entries(topology, work, n, j + k, first, last, column, by_q, by_rate, inertia)
        else:
            zero_span(first, last, n * (j + k), by_q, by_rate, inertia)
    if at(topology, i, at_.SECTION) > 0:
        transmit_to_own(topology, constants, work, i)
    if at(topology, i, at_.SIBLING) > 0:
        show_columns(topology, work, at(topology, i, at_.SIBLING))


@short_inlined
def transmit_share(topology, work, i):
    """Add body i's composite to its carrier's."""
    e = at(topology, i, at_.DERIVED) + diff_.BODY_MASS
    u = at(topology, at(topology, i, at_.PARENT), at_.DERIVED) + diff_.BODY_MASS
    for k in range(diff_.COMPOSITE_SIZE):
        work[u + k] += work[e + k]


@merged
def inward_derivatives(n, topology, constants, work, bodies, by_q, by_rate, inertia):
    """Write all entries, from the tips to the base."""
    for i in range(bodies, 0, -1):
        if at(topology, i, at_.MODES) > 0:
            modal_entries(topology, work, n, i, by_q, by_rate, inertia)
        if at(topology, i, at_.JOINT) == 1:
            joint_entries(topology, work, n, i, by_q, by_rate, inertia)
        p = at(topology, i, at_.PARENT)
        if at(topology, p, at_.MODES) > 0:
            carrier_entries(topology, constants, work, n, i, by_q, by_rate, inertia)
        if p > 0:
            transmit_share(topology, work, i)


@apart(types.int64(types.int64, *[NUMBERS] * 6), short_loops=True)
def find_derivatives(handle, q, qd, qdd, by_q, by_rate, inertia):
    """Write d tau / dq, d tau / dq' and I (n, n each)."""
    topology, constants, work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    outward_derivatives(n, topology, constants, work, diagonals, bodies, q, qd, qdd)
    for i in range(1, bodies + 1):
        if at(topology, i, at_.MODES) > 0:
            own_to_base(topology, work, i)
    inward_derivatives(n, topology, constants, work, bodies, by_q, by_rate, inertia)
    for j in range(n):
        stiffness, damping = internal_slope(constants, diagonals, q, qd, j)
        by_q[(n + 1) * j] += stiffness
        by_rate[(n + 1) * j] += damping
        inertia[(n + 1) * j] += diagonals[rec_.ARMATURE][j]
    finite = all_finite(by_q, n * n) and all_finite(by_rate, n * n)
    return GOOD if finite and all_finite(inertia, n * n) else NOT_FINITE


inverse_dynamics_derivatives = matrices_of_state('inverse_dynamics_derivatives', find_derivatives)


inverse_dynamics_derivatives_rows = over_rows(
    'inverse_dynamics_derivatives_rows', find_derivatives, 6
)
