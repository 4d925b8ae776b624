"""Derivatives of the dynamics with loops and mimic joints: docs/derivatives.md.

With F = I q'' + h - J^T lambda - tau, changes of a state that keep the rows J closed obey

    I dq'' - J^T dlambda = -dF,    J dq'' = -d(J q'' + J' q'),

dF at constant q'' and lambda. Accelerations take the articulated factors of the open tree and the
factors of J I^-1 J^T that constrained dynamics left. Torques of least norm are v = S v of the
saddle S v + J^T lambda = I q'' + h - tau, J v = 0, S the actuated coordinates. Where rows say the
same twice, multipliers turn with what these leave open: by the part of d(J x), J x = lambda, that
no other multipliers make.
"""

import numpy as np

from denoc_ros.kernels.algebra.vector import all_finite
from denoc_ros.kernels.constraints.closure import all_rows, constraints
from denoc_ros.kernels.constraints.constrained import EXPLICIT, axis_resistance, find_constrained
from denoc_ros.kernels.constraints.constrained_torques import (
    find_least_torques,
    find_torques,
    row_rate,
)
from denoc_ros.kernels.constraints.constraint_rates import (
    add_products,
    constraint_rates,
    places_of,
    room,
    room_place,
    subtract_force_change,
    subtract_wrench,
)
from denoc_ros.kernels.constraints.multipliers import keep_consistent, solve_rows, vector
from denoc_ros.kernels.derivatives.forward_derivatives import drive_columns
from denoc_ros.kernels.derivatives.inverse_derivatives import find_derivatives
from denoc_ros.kernels.derivatives.right_hand_sides import factors_to_base, solve_columns
from denoc_ros.kernels.dynamics.world import find_jacobian
from denoc_ros.kernels.jit.compiled import inlined, kernel, merged, rows_kernel, shared
from denoc_ros.kernels.jit.handle import (
    ARMATURE,
    GOOD,
    NOT_FINITE,
    ZERO,
    at,
    coordinates,
    elements,
    model_arrays,
)
from denoc_ros.kernels.jit.pointers import beyond, part, span
from denoc_ros.kernels.layout import constrained_derivative_layout as cdiff_
from denoc_ros.kernels.layout import constraint_layout as loop_
from denoc_ros.kernels.layout.constraint_layout import ROWS


@shared
def solve_tree(handle, flags, places):
    """Write changes of the free accelerations as if nothing closed the loops."""
    topology, _constants, work, _diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    size = n * n
    for k in range(2 * size):
        work[places.motion + k] = -work[places.by_q + k]
    x = part(work, places.motion, size)
    y = part(work, places.motion + size, size)
    z = part(work, places.motion + 2 * size, size)
    drive_columns(n, flags, part(work, places.inertia, size), z)
    factors_to_base(topology, work, flags, bodies)
    solve_columns(n, topology, work, bodies, flags, (x, y, z))
    for r in range(n):
        if flags[r] != 0.0:
            for j in range(n):
                x[n * r + j] = 0.0
                y[n * r + j] = 0.0
                z[n * r + j] = 1.0 if j == r else 0.0


@merged
def want_rows(topology, work, places, n):
    """Write to the pushes the residual of the rows under the tree's accelerations."""
    hard = at(topology, 0, loop_.ROWS)
    size, block = all_rows(topology) * n, hard * n
    for k in range(block):
        work[places.pushes + k] = -work[places.rates + 2 * size + k]
        work[places.pushes + block + k] = -2.0 * work[places.rates + size + k]
        work[places.pushes + 2 * block + k] = 0.0
    for which in range(3):
        for k in range(hard):
            for i in range(n):
                factor = -work[places.rates + n * k + i]
                source = places.motion + which * n * n + n * i
                target = places.pushes + which * block + n * k
                for j in range(n):
                    work[target + j] += factor * work[source + j]


@shared
def solve_pushes(topology, work, places, n):
    """Replace the residuals of the rows by the multipliers that remove them."""
    t = at(topology, 0, loop_.CONSTRAINTS_WORK)
    rows, hard = all_rows(topology), at(topology, 0, loop_.ROWS)
    wanted, found = vector(t, rows, loop_.WANTED), vector(t, rows, loop_.MULTIPLIERS)
    for which in range(3):
        for j in range(n):
            o = places.pushes + which * hard * n + j
            for k in range(hard):
                work[wanted + k] = work[o + n * k]
            keep_consistent(work, t, rows, hard, n, loop_.WANTED)
            solve_rows(work, t, rows, hard, n)
            for k in range(hard):
                work[o + n * k] = work[found + k]


@merged
def push_motion(topology, work, places, flags, n):
    """Add the multipliers' accelerations; I^-1 J^T (n, r) stays after these."""
    hard = at(topology, 0, loop_.ROWS)
    columns = places.pushes + 3 * hard * n
    inverse = places.motion + 2 * n * n
    for i in range(n):
        for k in range(hard):
            total = 0.0
            for j in range(n):
                if flags[j] == 0.0:
                    total += work[inverse + n * i + j] * work[places.rates + n * k + j]
            work[columns + hard * i + k] = total
    for which in range(3):
        pushes, target = places.pushes + which * hard * n, places.motion + which * n * n
        add_products(work, columns, pushes, n, hard, n, target)


@shared
def turn_multipliers(handle, q, places):
    """Add the turning of redundant rows to the multipliers' changes by q."""
    topology, _constants, work, _diagonals, _bodies = model_arrays(handle)
    n = coordinates(handle)
    t = at(topology, 0, loop_.CONSTRAINTS_WORK)
    rows, hard = all_rows(topology), at(topology, 0, loop_.ROWS)
    if np.int64(work[t + loop_.RANK]) == hard:
        return
    wanted, found = vector(t, rows, loop_.WANTED), vector(t, rows, loop_.MULTIPLIERS)
    weights = room(topology, work, places, n, cdiff_.WEIGHTS)
    turning = room(topology, work, places, n, cdiff_.TURNING)
    columns = places.pushes + 3 * hard * n
    for k in range(hard):
        work[wanted + k] = weights[k]
    solve_rows(work, t, rows, hard, n)
    for i in range(n):
        turning[i] = 0.0
        for k in range(hard):
            turning[i] += work[columns + hard * i + k] * work[found + k]
    still = room(topology, work, places, n, cdiff_.STILL)
    constraint_rates(handle, q, still, turning, places.applied)
    change = places.applied + 2 * rows * n
    for j in range(n):
        for k in range(hard):
            work[wanted + k] = work[change + n * k + j]
        keep_consistent(work, t, rows, hard, n, loop_.WANTED)
        for k in range(hard):
            turned = work[change + n * k + j] - work[wanted + k]
            work[places.pushes + n * k + j] += turned


@inlined
def deliver(work, source, rows, n, target, row):
    """Copy a matrix (rows, n) to row `row` of an array at an address; say if it is finite."""
    size = rows * n
    out = span(target + 8 * size * row, size, np.float64)
    for k in range(size):
        out[k] = work[source + k]
    return all_finite(out, size)


@inlined
def deliver_split(work, source, rows, n, joints, targets, row):
    """Copy columns of actuated coordinates to one array and the others to another.

    joints: the actuated coordinates, how many they are and their flags; targets: two addresses.
    """
    actuated, count, flags = joints
    size = rows * count
    out = span(targets[0] + 8 * size * row, size, np.float64)
    for i in range(rows):
        for c in range(count):
            out[count * i + c] = work[source + n * i + actuated[c]]
    rest = span(targets[1] + 8 * rows * n * row, rows * n, np.float64)
    for i in range(rows):
        for j in range(n):
            rest[n * i + j] = work[source + n * i + j] if flags[j] == 0.0 else 0.0
    return all_finite(out, size) and all_finite(rest, rows * n)


@inlined
def deliver_three(work, source, block, rows, n, joints, verb, targets, row):
    """Copy three matrices (rows, n), `block` apart, to arrays; say if they are finite."""
    good = deliver(work, source, rows, n, targets[0], row)
    good = deliver(work, source + block, rows, n, targets[1], row) and good
    source += 2 * block
    if verb == cdiff_.HYBRID:
        rest = beyond(targets, 2)
        return good and deliver_split(work, source, rows, n, joints, rest, row)
    return good and deliver(work, source, rows, n, targets[2], row)


@merged
def deliver_all(handle, verb, actuated, count, targets, row):
    """Copy the results to row `row` of the arrays at some addresses; return the status."""
    topology, _constants, work, _diagonals, _bodies = model_arrays(handle)
    n = coordinates(handle)
    places, hard = places_of(topology, n), at(topology, 0, ROWS)
    joints = actuated, count, room(topology, work, places, n, cdiff_.FLAGS)
    good, step = True, 4 if verb == cdiff_.HYBRID else 3
    if verb != cdiff_.FORWARD:
        good = deliver_three(work, places.torques, n * n, count, n, joints, verb, targets, row)
        targets = beyond(targets, step)
    if verb != cdiff_.INVERSE:
        good = deliver_three(work, places.motion, n * n, n, n, joints, verb, targets, row) and good
        targets = beyond(targets, step)
    good = (
        deliver_three(work, places.pushes, hard * n, hard, n, joints, verb, targets, row) and good
    )
    return GOOD if good else NOT_FINITE


LOAD = 7  # numbers of a wrench: row of its frame, force, torque


@merged
def add_wrench_forces(handle, q, loads, count, places, force):
    """Add to force (n) the generalized forces of wrenches (count, 7) on frames."""
    _topology, _constants, work, _diagonals, _bodies = model_arrays(handle)
    n = coordinates(handle)
    jacobian = part(work, places.jacobian, 6 * n)
    for k in range(count):
        find_jacobian(handle, q, np.int64(loads[LOAD * k]), jacobian)
        for r in range(6):
            for j in range(n):
                force[j] += jacobian[n * r + j] * loads[LOAD * k + 1 + r]


@merged
def resist_axes(topology, constants, work, qd, places, n):
    """Write forces along free axes after the multipliers; add their slopes to the matrices.

    The matrices' rows are those of the forces that the motion asks for.
    """
    weights = room(topology, work, places, n, cdiff_.WEIGHTS)
    size = all_rows(topology) * n
    for constraint in constraints(topology):
        k = at(topology, constraint, loop_.AXIS_ROW)
        if at(topology, constraint, loop_.KIND) == loop_.MIMIC or k == 0:
            continue
        row = places.rates + n * k
        c = at(topology, constraint, loop_.CONSTANTS)
        force, slope = axis_resistance(constants, c, row_rate(work, row, qd, n))
        weights[k] = -force
        for i in range(n):
            factor = slope * work[row + i]
            for j in range(n):
                work[places.by_q + n * i + j] += factor * work[row + size + j]
                work[places.by_rate + n * i + j] += factor * work[row + j]


@shared
def find_matrices(handle, q, qd, qdd, loads, count, places):
    """Write derivatives of the forces that the motion asks for, J^T multipliers subtracted."""
    topology, constants, work, _diagonals, _bodies = model_arrays(handle)
    n = coordinates(handle)
    by_q = part(work, places.by_q, n * n)
    status = find_derivatives(
        handle, q, qd, qdd, by_q, part(work, places.by_rate, n * n),
        part(work, places.inertia, n * n),
    )  # fmt: skip
    resist_axes(topology, constants, work, qd, places, n)
    weights = room_place(topology, places, n, cdiff_.WEIGHTS)
    subtract_force_change(handle, q, weights, by_q)
    for k in range(count):
        row = np.int64(loads[LOAD * k])
        subtract_wrench(handle, q, row, beyond(loads, LOAD * k + 1), by_q)
    return status


@shared
def find_accelerations(handle, verb, flags, q, qd, third, force, places):
    """Write q'', those of the rows' multipliers of forward dynamics; return the status."""
    topology, _constants, work, diagonals, _bodies = model_arrays(handle)
    n = coordinates(handle)
    qdd = room(topology, work, places, n, cdiff_.ACCELERATION)
    if verb == cdiff_.INVERSE:
        for j in range(n):
            qdd[j] = third[j]
        return GOOD
    given = room(topology, work, places, n, cdiff_.GIVEN)
    status = find_constrained(
        handle, EXPLICIT, 0.0, diagonals[ARMATURE], flags, q, qd, given, force, qdd
    )
    weights = room(topology, work, places, n, cdiff_.WEIGHTS)
    found = vector(at(topology, 0, loop_.CONSTRAINTS_WORK), all_rows(topology), loop_.MULTIPLIERS)
    for k in range(at(topology, 0, loop_.ROWS)):
        weights[k] = work[found + k]
    return status


@merged
def take_inputs(handle, verb, actuated, count, third, tau, places):
    """Write flags and accelerations of the actuated coordinates and the forces of the others."""
    topology, _constants, work, _diagonals, _bodies = model_arrays(handle)
    n = coordinates(handle)
    flags = room(topology, work, places, n, cdiff_.FLAGS)
    given = room(topology, work, places, n, cdiff_.GIVEN)
    force = room(topology, work, places, n, cdiff_.FORCE)
    still = room(topology, work, places, n, cdiff_.STILL)
    for j in range(n):
        flags[j], given[j], still[j] = 0.0, 0.0, 0.0
        force[j] = third[j] if verb == cdiff_.FORWARD else tau[j]
    for k in range(count):
        flags[actuated[k]] = 1.0
        force[actuated[k]] = 0.0
        if verb == cdiff_.HYBRID:
            given[actuated[k]] = third[k]


@merged
def find_constrained_derivatives(handle, verb, actuated, count, state, loads, wrenches):
    """Find the derivatives of a verb at one state; they stay in work. Return the status.

    actuated: (count) coordinates; state: q, q', q'' or forces (forward: n, inverse: n, hybrid:
    count), forces of the others (n); loads (wrenches, 7).
    """
    topology, _constants, work, _diagonals, _bodies = model_arrays(handle)
    n = coordinates(handle)
    places = places_of(topology, n)
    q, qd, third, tau = state
    flags = room(topology, work, places, n, cdiff_.FLAGS)
    force = room(topology, work, places, n, cdiff_.FORCE)
    qdd = room(topology, work, places, n, cdiff_.ACCELERATION)
    take_inputs(handle, verb, actuated, count, third, tau, places)
    add_wrench_forces(handle, q, loads, wrenches, places, force)
    status = find_accelerations(handle, verb, flags, q, qd, third, force, places)
    if status != GOOD:
        return status
    rank = 0
    if verb == cdiff_.FORWARD:
        constraint_rates(handle, q, qd, qdd, places.rates)
    else:
        status, rank = find_least_torques(handle, q, qd, qdd, flags, force, places)
        if status != GOOD:
            return status
    status = find_matrices(handle, q, qd, qdd, loads, wrenches, places)
    if verb != cdiff_.INVERSE:
        solve_tree(handle, flags, places)
        want_rows(topology, work, places, n)
        solve_pushes(topology, work, places, n)
        push_motion(topology, work, places, flags, n)
    if verb == cdiff_.FORWARD:
        turn_multipliers(handle, q, places)
    else:
        find_torques(handle, q, verb, actuated, count, rank, places)
    return status


@rows_kernel(
    'int64(int64, int64[::1], float64[:, ::1], float64[:, ::1], float64[:, ::1], '
    'float64[:, ::1], float64[:, ::1], int64, int64, int64[::1])'
)
def constrained_derivatives_rows(handle, choice, q, qd, third, tau, loads, first, last, targets):
    """Write the derivatives of a verb for rows first .. last - 1 of (k, ...) states.

    choice: the verb and the actuated coordinates; third: forces, q'' or actuated q''; loads: a
    frame's row and a wrench (7) each; targets: addresses of the results' arrays (k, ...). Returns
    the worst status, and stops at the first bad one.
    """
    n, width, wrenches = coordinates(handle), third.shape[1], loads.shape[0]
    verb, count = choice[0], choice.size - 1
    actuated = span(choice.ctypes.data + 8, count, np.int64)
    to = span(targets.ctypes.data, targets.size, np.int64)
    a, b, c, d = elements(q), elements(qd), elements(third), elements(tau)
    for row in range(first, last):
        k = n * row
        state = (beyond(a, k), beyond(b, k), beyond(c, width * row), beyond(d, k))
        status = find_constrained_derivatives(
            handle, verb, actuated, count, state, elements(loads), wrenches
        )
        if status == GOOD:
            status = deliver_all(handle, verb, actuated, count, to, row)
        if status != GOOD:
            return status
    return GOOD


@kernel('int64(int64, float64[::1], float64[::1], float64[::1], float64[:, :, ::1])')
def constraint_row_rates(handle, q, qd, qdd, out):
    """Write J, J' and J'' (3, R, n) of all rows along a motion (see constraint_rates)."""
    topology, _constants, work, _diagonals, _bodies = model_arrays(handle)
    n = coordinates(handle)
    places, result = places_of(topology, n), elements(out)
    constraint_rates(handle, elements(q), elements(qd), elements(qdd), places.rates)
    for k in range(3 * all_rows(topology) * n):
        result[k] = work[places.rates + k]
    return GOOD if all_finite(result, out.size) else NOT_FINITE


@kernel('int64(int64, float64[::1], float64[::1], float64[:, ::1])')
def constraint_force_change(handle, q, weights, out):
    """Subtract d(J^T weights)/dq from out (n, n); weights (R) of all rows."""
    topology, _constants, work, diagonals, _bodies = model_arrays(handle)
    n = coordinates(handle)
    places, given = places_of(topology, n), elements(weights)
    zero, result = diagonals[ZERO], elements(out)
    constraint_rates(handle, elements(q), zero, zero, places.rates)
    own = room(topology, work, places, n, cdiff_.WEIGHTS)
    for k in range(all_rows(topology)):
        own[k] = given[k]
    subtract_force_change(
        handle, elements(q), room_place(topology, places, n, cdiff_.WEIGHTS), result
    )
    return GOOD if all_finite(result, n * n) else NOT_FINITE
