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

from denoc_ros.kernels import constrained_derivative_layout as cdiff_
from denoc_ros.kernels import constraint_layout as loop_
from denoc_ros.kernels.closure import all_rows, constraints
from denoc_ros.kernels.compiled import kernel, merged, rows_kernel, shared
from denoc_ros.kernels.constrained import EXPLICIT, axis_resistance, find_constrained
from denoc_ros.kernels.constrained_accelerations import (
    push_motion,
    solve_pushes,
    solve_tree,
    turn_multipliers,
    want_rows,
)
from denoc_ros.kernels.constrained_results import deliver_all
from denoc_ros.kernels.constrained_rooms import room, room_place
from denoc_ros.kernels.constrained_torques import (
    factor_saddle,
    find_need,
    find_reactions,
    find_torques,
    keeps_closed,
    row_rate,
)
from denoc_ros.kernels.constraint_forces import subtract_force_change, subtract_wrench
from denoc_ros.kernels.constraint_rates import constraint_rates, places_of
from denoc_ros.kernels.handle import (
    ARMATURE,
    GOOD,
    NOT_FINITE,
    ZERO,
    at,
    coordinates,
    elements,
    model_arrays,
)
from denoc_ros.kernels.inverse_derivatives import find_derivatives
from denoc_ros.kernels.multipliers import vector
from denoc_ros.kernels.pointers import beyond, part, span
from denoc_ros.kernels.vector import all_finite
from denoc_ros.kernels.world import find_jacobian

# statuses: accelerations open the rows; they are none that the actuated joints can give
OPENING = 6
BEYOND_REACH = 7

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
    constraint_rates(handle, q, qd, qdd, places.rates)
    rank = 0
    if verb != cdiff_.FORWARD:
        need = room(topology, work, places, n, cdiff_.NEED)
        find_need(handle, q, qd, qdd, places, force, need)
        if not all_finite(need, n):
            return NOT_FINITE
        if not keeps_closed(topology, work, qd, qdd, places, n):
            return OPENING
        rank = factor_saddle(topology, work, places, flags, n)
        if not find_reactions(topology, work, places, rank, flags, need, n):
            return BEYOND_REACH
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
