"""Derivatives of inverse dynamics by coordinates, rates, accelerations: docs/derivatives.md."""

from numba import types

from denoc_ros.kernels.array_object import (
    READABLE,
    WRITABLE,
    array_object,
    content,
    is_matrix,
    is_vector,
)
from denoc_ros.kernels.compiled import inlined, kernel, merged, rows_kernel, shared
from denoc_ros.kernels.derivative_layout import (
    ACCELERATED,
    BODY_MASS,
    BY_ACCELERATION,
    BY_POSITION,
    BY_RATE,
    BY_TURNING,
    COLUMN,
    COLUMN_BEND,
    COLUMN_RATE,
    COMPOSITE_SIZE,
    OWN_SIZE,
    SEEN,
    SEEN_SIZE,
    TWIST,
    WRENCH,
)
from denoc_ros.kernels.derivative_rows import (
    columns_of,
    half_turning,
    inboard_entries,
    outboard_entries,
    store_wrenches,
    with_carried,
    wrenches_by,
    zero_span,
)
from denoc_ros.kernels.handle import (
    ARMATURE,
    COSINE,
    GOOD,
    MISFIT,
    NOT_FINITE,
    SINE,
    at,
    beyond,
    coordinates,
    elements,
    model_arrays,
)
from denoc_ros.kernels.internal import internal_slope
from denoc_ros.kernels.layout import (
    ACCELERATION,
    ANGULAR_ACCELERATION,
    ANGULAR_VELOCITY,
    BRANCH_END,
    COORDINATE,
    DERIVED,
    JOINT,
    MODES,
    OWN,
    PARENT,
    POINTS,
    SECTION,
    SIBLING,
    WORK,
    WORLD_POSITION,
    WORLD_ROTATION,
)
from denoc_ros.kernels.placement import place_beam, place_by_sines
from denoc_ros.kernels.section_columns import geometric_terms, show_columns
from denoc_ros.kernels.sine_cosine import write_sines
from denoc_ros.kernels.spatial import (
    dot_pair,
    pair,
    store_pair,
    strided,
    sum_pair,
    wrench_about_origin,
)
from denoc_ros.kernels.vector import (
    add,
    all_finite,
    cross,
    load,
    rotate,
    store,
    unrotate,
)
from denoc_ros.kernels.world import section_place, world_pose
from denoc_ros.kernels.world_motion import move_world, own_share


@merged
def outward_derivatives(n, topology, constants, work, diagonals, bodies, q, qd, qdd):
    """Place and move every body in base axes and write its own share."""
    sines, cosines = diagonals[SINE], diagonals[COSINE]
    write_sines(q, n, sines, cosines)
    base = at(topology, 0, DERIVED)
    motion = at(topology, 0, WORK)
    # seen from axes that move along with the base's origin, with a constant velocity: there its
    # spatial acceleration is the classical one
    store(work, base + TWIST, (0.0, 0.0, 0.0))
    store(work, base + TWIST + 3, load(work, motion + ANGULAR_VELOCITY))
    store(work, base + ACCELERATED, load(work, motion + ACCELERATION))
    store(work, base + ACCELERATED + 3, load(work, motion + ANGULAR_ACCELERATION))
    for i in range(1, bodies + 1):
        place_by_sines(topology, constants, work, q, sines, cosines, i)
        if at(topology, i, POINTS) > 0:
            place_beam(topology, constants, work, q, i)
        world_pose(topology, work, i)
        move_world(topology, constants, work, qd, qdd, i)
        own_share(topology, constants, work, qd, qdd, i)


@inlined
def joint_entries(topology, work, n, i, by_q, by_rate, inertia):
    """Write the row of body i's joint, and the wrenches that it sends inward."""
    j = at(topology, i, COORDINATE)
    e = at(topology, i, DERIVED)
    c, length = columns_of(topology)
    column = strided(work, c + length * COLUMN + j, length)
    rate = strided(work, c + length * COLUMN_RATE + j, length)
    bend = strided(work, c + length * COLUMN_BEND + j, length)
    wrenches = wrenches_by(work, e, column, rate, bend)
    carried = with_carried(work, e, column, wrenches[0])
    store_wrenches(work, c, length, j, carried, wrenches[1], wrenches[2])
    half = half_turning(work, e, column)
    # its own column among those inboard: nothing of a joint's column changes by its own angle
    inboard_entries(topology, work, n, i, j, j + 1, (wrenches[2], half), by_q, by_rate, inertia)
    outboard_entries(
        topology, work, n, j, j + 1, at(topology, i, BRANCH_END), column, by_q, by_rate, inertia
    )
    end = at(topology, i, BRANCH_END)
    zero_span(end, n, n * j, by_q, by_rate, inertia)


@inlined
def modal_entries(topology, work, n, i, by_q, by_rate, inertia):
    """Write the rows of body i's modes, inboard and among themselves, and their wrenches."""
    m = at(topology, i, MODES)
    j = at(topology, i, COORDINATE) + at(topology, i, JOINT)
    own = at(topology, i, OWN)
    forces = own + OWN_SIZE * m
    c, length = columns_of(topology)
    end = at(topology, i, BRANCH_END)
    for k in range(m):
        u = own + OWN_SIZE * k
        by_acceleration = pair(work, u + BY_ACCELERATION)
        store_wrenches(
            work, c, length, j + k, pair(work, u + BY_POSITION), pair(work, u + BY_RATE),
            by_acceleration,
        )  # fmt: skip
        half = load(work, u + BY_TURNING)
        share = (by_acceleration, half)
        inboard_entries(topology, work, n, i, j + k, j, share, by_q, by_rate, inertia)
        o = n * (j + k) + j
        for r in range(m):
            by_q[o + r] = work[forces + m * k + r]
            by_rate[o + r] = work[forces + m * (m + k) + r]
            inertia[o + r] = work[forces + m * (2 * m + k) + r]
        zero_span(end, n, n * (j + k), by_q, by_rate, inertia)


@inlined
def own_to_base(topology, work, i):
    """Turn what stands at OWN of body i from body axes to base axes."""
    o = at(topology, i, WORK)
    turn = o + WORLD_ROTATION
    x = load(work, o + WORLD_POSITION)
    for k in range(at(topology, i, MODES)):
        u = at(topology, i, OWN) + OWN_SIZE * k
        store(work, u + BY_TURNING, rotate(work, turn, load(work, u + BY_TURNING)))
        for part in (BY_ACCELERATION, BY_POSITION, BY_RATE):
            f, t = pair(work, u + part)
            store_pair(work, u + part, wrench_about_origin(work, turn, x, f, t))


@shared
def transmit_to_own(topology, constants, work, i):
    """Add what body i and all it carries take part in their carrier's modal forces."""
    p = at(topology, i, PARENT)
    m = at(topology, p, MODES)
    e = at(topology, i, DERIVED)
    own = at(topology, p, OWN)
    forces = own + OWN_SIZE * m
    for j in range(m):
        s = e + SEEN + SEEN_SIZE * j
        column, rate, bend = pair(work, s), pair(work, s + 6), pair(work, s + 12)
        by_q, by_rate, by_acceleration = wrenches_by(work, e, column, rate, bend)
        u = own + OWN_SIZE * j
        half = half_turning(work, e, column)
        store(work, u + BY_TURNING, add(load(work, u + BY_TURNING), half))
        carried = with_carried(work, e, column, by_q)
        store_pair(work, u + BY_POSITION, sum_pair(pair(work, u + BY_POSITION), carried))
        store_pair(work, u + BY_RATE, sum_pair(pair(work, u + BY_RATE), by_rate))
        by = u + BY_ACCELERATION
        store_pair(work, by, sum_pair(pair(work, by), by_acceleration))
        for k in range(m):
            other = pair(work, e + SEEN + SEEN_SIZE * k)
            work[forces + m * k + j] += dot_pair(by_q, other)
            work[forces + m * (m + k) + j] += dot_pair(by_rate, other)
            work[forces + m * (2 * m + k) + j] += dot_pair(by_acceleration, other)
    turn = at(topology, p, WORK) + WORLD_ROTATION
    f, t = pair(work, e + WRENCH)
    t = add(t, cross(f, section_place(topology, work, i)))
    geometric_terms(
        topology, constants, work, i, unrotate(work, turn, f), unrotate(work, turn, t), forces
    )


@inlined
def carrier_entries(topology, constants, work, n, i, by_q, by_rate, inertia):
    """Write the entries of the modes of body i's carrier in the columns of body i's branch."""
    p = at(topology, i, PARENT)
    j = at(topology, p, COORDINATE) + at(topology, p, JOINT)
    first, last = at(topology, i, COORDINATE), at(topology, i, BRANCH_END)
    for k in range(at(topology, p, MODES)):
        if at(topology, i, SECTION) > 0:
            column = pair(work, at(topology, i, DERIVED) + SEEN + SEEN_SIZE * k)
            outboard_entries(topology, work, n, j + k, first, last, column, by_q, by_rate, inertia)
        else:
            zero_span(first, last, n * (j + k), by_q, by_rate, inertia)
    if at(topology, i, SECTION) > 0:
        transmit_to_own(topology, constants, work, i)
    if at(topology, i, SIBLING) > 0:
        show_columns(topology, work, at(topology, i, SIBLING))


@inlined
def transmit_share(topology, work, i):
    """Add body i's composite to its carrier's."""
    e = at(topology, i, DERIVED) + BODY_MASS
    u = at(topology, at(topology, i, PARENT), DERIVED) + BODY_MASS
    for k in range(COMPOSITE_SIZE):
        work[u + k] += work[e + k]


@merged
def inward_derivatives(n, topology, constants, work, bodies, by_q, by_rate, inertia):
    """Write all entries, from the tips to the base."""
    for i in range(bodies, 0, -1):
        if at(topology, i, MODES) > 0:
            modal_entries(topology, work, n, i, by_q, by_rate, inertia)
        if at(topology, i, JOINT) == 1:
            joint_entries(topology, work, n, i, by_q, by_rate, inertia)
        p = at(topology, i, PARENT)
        if at(topology, p, MODES) > 0:
            carrier_entries(topology, constants, work, n, i, by_q, by_rate, inertia)
        if p > 0:
            transmit_share(topology, work, i)


@merged
def find_derivatives(handle, q, qd, qdd, by_q, by_rate, inertia):
    """Write d tau / dq, d tau / dq' and I (n, n each)."""
    topology, constants, work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    outward_derivatives(n, topology, constants, work, diagonals, bodies, q, qd, qdd)
    for i in range(1, bodies + 1):
        if at(topology, i, MODES) > 0:
            own_to_base(topology, work, i)
    inward_derivatives(n, topology, constants, work, bodies, by_q, by_rate, inertia)
    for j in range(n):
        stiffness, damping = internal_slope(constants, diagonals, q, qd, j)
        by_q[(n + 1) * j] += stiffness
        by_rate[(n + 1) * j] += damping
        inertia[(n + 1) * j] += diagonals[ARMATURE][j]
    finite = all_finite(by_q, n * n) and all_finite(by_rate, n * n)
    return GOOD if finite and all_finite(inertia, n * n) else NOT_FINITE


@inlined
def fit(handle, states, matrices):
    """Say whether three objects are states (n,), and three more writable matrices (n, n)."""
    n = coordinates(handle)
    return (
        is_vector(handle, states[0], n, READABLE)
        and is_vector(handle, states[1], n, READABLE)
        and is_vector(handle, states[2], n, READABLE)
        and is_matrix(handle, matrices[0], n, WRITABLE)
        and is_matrix(handle, matrices[1], n, WRITABLE)
        and is_matrix(handle, matrices[2], n, WRITABLE)
    )


@kernel(types.int64(types.int64, *[array_object] * 6))
def inverse_dynamics_derivatives(handle, q, qd, qdd, by_q, by_rate, inertia):
    """Write d tau / dq, d tau / dq' and I (n, n each)."""
    if not fit(handle, (q, qd, qdd), (by_q, by_rate, inertia)):
        return MISFIT
    return find_derivatives(
        handle, content(q), content(qd), content(qdd), content(by_q), content(by_rate),
        content(inertia),
    )  # fmt: skip


@rows_kernel(
    'int64(int64, float64[:, ::1], float64[:, ::1], float64[:, ::1], int64, int64, '
    'float64[:, :, ::1], float64[:, :, ::1], float64[:, :, ::1])'
)
def inverse_dynamics_derivatives_rows(handle, q, qd, qdd, first, last, by_q, by_rate, inertia):
    """Do the same for rows first .. last - 1 of (k, n) states; return the worst status."""
    n = coordinates(handle)
    a, b, c = elements(q), elements(qd), elements(qdd)
    d, e, f = elements(by_q), elements(by_rate), elements(inertia)
    worst = GOOD
    for row in range(first, last):
        k, m = n * row, n * n * row
        status = find_derivatives(
            handle, beyond(a, k), beyond(b, k), beyond(c, k), beyond(d, m), beyond(e, m),
            beyond(f, m),
        )  # fmt: skip
        worst = max(worst, status)
    return worst
