"""Closure of loops and mimic joints: errors, Jacobian and acceleration bias."""

from denoc_ros.kernels.algebra.vector import all_finite
from denoc_ros.kernels.constraints.constraint_columns import project_loop
from denoc_ros.kernels.constraints.loop_motion import loop_rows
from denoc_ros.kernels.dynamics.link_motion import linear_velocity, move_body
from denoc_ros.kernels.dynamics.placement import place_body
from denoc_ros.kernels.jit.compiled import inlined, kernel, shared
from denoc_ros.kernels.jit.handle import (
    GOOD,
    MISFIT,
    NOT_FINITE,
    ZERO,
    at,
    coordinates,
    elements,
    model_arrays,
)
from denoc_ros.kernels.layout import constraint_layout as loop_
from denoc_ros.kernels.layout.layout import COORDINATE


@inlined
def constraints(topology):
    """Return the rows of topology that are constraints."""
    first = at(topology, 0, loop_.FIRST_CONSTRAINT)
    return range(first, first + at(topology, 0, loop_.CONSTRAINTS))


@inlined
def all_rows(topology):
    """Return the number of rows, those of free axes included."""
    return at(topology, 0, loop_.ROWS) + at(topology, 0, loop_.AXIS_ROWS)


@inlined
def mimic_row(topology, constants, work, q, qd, given, constraint, t, rows):
    """Write the row q_mimic - multiplier q_leader - offset of a mimic joint."""
    j = at(topology, at(topology, constraint, loop_.CHILD), COORDINATE)
    leader = at(topology, at(topology, constraint, loop_.OTHER), COORDINATE)
    c = at(topology, constraint, loop_.CONSTANTS)
    k = t + loop_.VECTORS + at(topology, constraint, loop_.ROW)
    factor = constants[c + loop_.MULTIPLIER]
    work[k + loop_.ERROR * rows] = q[j] - factor * q[leader] - constants[c + loop_.OFFSET]
    work[k + loop_.RATE * rows] = qd[j] - factor * qd[leader]
    work[k + loop_.BIAS * rows] = given[j] - factor * given[leader]


@shared
def constraint_rows(topology, constants, work, q, qd, given, zero, constraint, t, rows):
    """Write the rows of one constraint, for bodies placed and moved with the accelerations given.

    zero stands for the amplitudes' accelerations, which the frames on sections do not have yet.
    """
    if at(topology, constraint, loop_.KIND) == loop_.MIMIC:
        mimic_row(topology, constants, work, q, qd, given, constraint, t, rows)
        return
    for side in range(2):
        i = at(topology, constraint, loop_.CHILD if side == 0 else loop_.OTHER)
        place_body(topology, constants, work, q, i)
        move_body(topology, constants, work, qd, zero, i)
        linear_velocity(topology, constants, work, qd, i)
    loop_rows(topology, constants, work, constraint, t, rows)


@shared
def move_bodies(topology, constants, work, bodies, q, qd, zero):
    """Place and move all bodies, accelerations of coordinates zero."""
    for i in range(1, bodies + 1):
        place_body(topology, constants, work, q, i)
        move_body(topology, constants, work, qd, zero, i)
        linear_velocity(topology, constants, work, qd, i)


@inlined
def constraint_jacobian(topology, constants, work, constraint, t, rows, out, n):
    """Add a constraint's rows, which stand in the workspace, to the Jacobian out (rows * n)."""
    first = at(topology, constraint, loop_.ROW)
    if at(topology, constraint, loop_.KIND) == loop_.MIMIC:
        out[n * first + at(topology, at(topology, constraint, loop_.CHILD), COORDINATE)] += 1.0
        factor = constants[at(topology, constraint, loop_.CONSTANTS) + loop_.MULTIPLIER]
        out[n * first + at(topology, at(topology, constraint, loop_.OTHER), COORDINATE)] -= factor
        return
    project_loop(topology, constants, work, constraint, t, rows, out, n)


@kernel('int64(int64, float64[::1], float64[::1], float64[:, ::1])')
def closure(handle, q, qd, out):
    """Write errors, their rates and the acceleration bias J' q' (3, rows)."""
    topology, constants, work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    rows = at(topology, 0, loop_.ROWS)
    if q.shape[0] != n or qd.shape[0] != n or out.shape[0] != 3 or out.shape[1] != rows:
        return MISFIT
    zero = diagonals[ZERO]
    here, rates, result = elements(q), elements(qd), elements(out)
    move_bodies(topology, constants, work, bodies, here, rates, zero)
    t = at(topology, 0, loop_.CONSTRAINTS_WORK)
    for constraint in constraints(topology):
        constraint_rows(
            topology, constants, work, here, rates, zero, zero, constraint, t, all_rows(topology)
        )
    o = t + loop_.VECTORS
    for k in range(rows):
        result[k] = work[o + loop_.ERROR * all_rows(topology) + k]
        result[rows + k] = work[o + loop_.RATE * all_rows(topology) + k]
        result[2 * rows + k] = work[o + loop_.BIAS * all_rows(topology) + k]
    return GOOD if all_finite(result, 3 * rows) else NOT_FINITE


@kernel('int64(int64, float64[::1], float64[:, ::1])')
def closure_jacobian(handle, q, out):
    """Write J (all rows, n): rates of the errors, then of the free axes, by those of q."""
    topology, constants, work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    rows = all_rows(topology)
    if q.shape[0] != n or out.shape[0] != rows or out.shape[1] != n:
        return MISFIT
    zero = diagonals[ZERO]
    here, result = elements(q), elements(out)
    move_bodies(topology, constants, work, bodies, here, zero, zero)
    for k in range(rows * n):
        result[k] = 0.0
    t = at(topology, 0, loop_.CONSTRAINTS_WORK)
    for constraint in constraints(topology):
        constraint_rows(topology, constants, work, here, zero, zero, zero, constraint, t, rows)
        constraint_jacobian(topology, constants, work, constraint, t, rows, result, n)
    return GOOD if all_finite(result, rows * n) else NOT_FINITE
