"""Closure of loops and mimic joints: errors, Jacobian and acceleration bias."""

from denoc_ros.kernels.compiled import inlined, kernel, shared
from denoc_ros.kernels.handle import (
    GOOD,
    MISFIT,
    NOT_FINITE,
    ZERO,
    at,
    coordinates,
    elements,
    model_arrays,
)
from denoc_ros.kernels.layout import COORDINATE
from denoc_ros.kernels.loop_motion import loop_rows
from denoc_ros.kernels.motion import linear_velocity, move_body
from denoc_ros.kernels.placement import place_body
from denoc_ros.kernels.tie_columns import project_loop
from denoc_ros.kernels.tie_layout import (
    AXIS_ROWS,
    BIAS,
    CHILD,
    CONSTANTS,
    ERROR,
    FIRST_TIE,
    KIND,
    MIMIC,
    MULTIPLIER,
    OFFSET,
    OTHER,
    RATE,
    ROW,
    ROWS,
    TIES,
    TIES_WORK,
    VECTORS,
)
from denoc_ros.kernels.vector import all_finite


@inlined
def ties(ints):
    """Return the rows of ints that are ties."""
    first = at(ints, 0, FIRST_TIE)
    return range(first, first + at(ints, 0, TIES))


@inlined
def all_rows(ints):
    """Return the number of rows, those of free axes included."""
    return at(ints, 0, ROWS) + at(ints, 0, AXIS_ROWS)


@inlined
def mimic_row(ints, reals, work, q, qd, given, tie, t, rows):
    """Write the row q_mimic - multiplier q_leader - offset of a mimic joint."""
    j = at(ints, at(ints, tie, CHILD), COORDINATE)
    leader = at(ints, at(ints, tie, OTHER), COORDINATE)
    c = at(ints, tie, CONSTANTS)
    k = t + VECTORS + at(ints, tie, ROW)
    factor = reals[c + MULTIPLIER]
    work[k + ERROR * rows] = q[j] - factor * q[leader] - reals[c + OFFSET]
    work[k + RATE * rows] = qd[j] - factor * qd[leader]
    work[k + BIAS * rows] = given[j] - factor * given[leader]


@shared
def tie_rows(ints, reals, work, q, qd, given, zero, tie, t, rows):
    """Write the rows of one tie, for bodies placed and moved with the accelerations given.

    zero stands for the amplitudes' accelerations, which the frames on sections do not have yet.
    """
    if at(ints, tie, KIND) == MIMIC:
        mimic_row(ints, reals, work, q, qd, given, tie, t, rows)
        return
    for side in range(2):
        i = at(ints, tie, CHILD if side == 0 else OTHER)
        place_body(ints, reals, work, q, i)
        move_body(ints, reals, work, qd, zero, i)
        linear_velocity(ints, reals, work, qd, i)
    loop_rows(ints, reals, work, tie, t, rows)


@shared
def move_bodies(ints, reals, work, bodies, q, qd, zero):
    """Place and move all bodies, accelerations of coordinates zero."""
    for i in range(1, bodies + 1):
        place_body(ints, reals, work, q, i)
        move_body(ints, reals, work, qd, zero, i)
        linear_velocity(ints, reals, work, qd, i)


@inlined
def tie_jacobian(ints, reals, work, tie, t, rows, out, n):
    """Add the rows of a tie, which stand in the workspace, to the Jacobian out (rows * n)."""
    first = at(ints, tie, ROW)
    if at(ints, tie, KIND) == MIMIC:
        out[n * first + at(ints, at(ints, tie, CHILD), COORDINATE)] += 1.0
        factor = reals[at(ints, tie, CONSTANTS) + MULTIPLIER]
        out[n * first + at(ints, at(ints, tie, OTHER), COORDINATE)] -= factor
        return
    project_loop(ints, reals, work, tie, t, rows, out, n)


@kernel('int64(int64, float64[::1], float64[::1], float64[:, ::1])')
def closure(handle, q, qd, out):
    """Write errors, their rates and the acceleration bias J' q' (3, rows)."""
    ints, reals, work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    rows = at(ints, 0, ROWS)
    if q.shape[0] != n or qd.shape[0] != n or out.shape[0] != 3 or out.shape[1] != rows:
        return MISFIT
    zero = diagonals[ZERO]
    here, rates, result = elements(q), elements(qd), elements(out)
    move_bodies(ints, reals, work, bodies, here, rates, zero)
    t = at(ints, 0, TIES_WORK)
    for tie in ties(ints):
        tie_rows(ints, reals, work, here, rates, zero, zero, tie, t, all_rows(ints))
    o = t + VECTORS
    for k in range(rows):
        result[k] = work[o + ERROR * all_rows(ints) + k]
        result[rows + k] = work[o + RATE * all_rows(ints) + k]
        result[2 * rows + k] = work[o + BIAS * all_rows(ints) + k]
    return GOOD if all_finite(result, 3 * rows) else NOT_FINITE


@kernel('int64(int64, float64[::1], float64[:, ::1])')
def closure_jacobian(handle, q, out):
    """Write J (all rows, n): rates of the errors, then of the free axes, by those of q."""
    ints, reals, work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    rows = all_rows(ints)
    if q.shape[0] != n or out.shape[0] != rows or out.shape[1] != n:
        return MISFIT
    zero = diagonals[ZERO]
    here, result = elements(q), elements(out)
    move_bodies(ints, reals, work, bodies, here, zero, zero)
    for k in range(rows * n):
        result[k] = 0.0
    t = at(ints, 0, TIES_WORK)
    for tie in ties(ints):
        tie_rows(ints, reals, work, here, zero, zero, zero, tie, t, rows)
        tie_jacobian(ints, reals, work, tie, t, rows, result, n)
    return GOOD if all_finite(result, rows * n) else NOT_FINITE
