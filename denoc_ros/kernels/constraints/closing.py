"""The fixed step of robots with loops and mimic joints, with projection onto the constraints.

The projection is the least change in the metric of the step's own inertia, with the factors and
columns of the second stage: dq = -I^-1 J^T (J I^-1 J^T)^-1 e, and the same for rates. These belong
to a state that is off by dt^2, so every pass reduces the error by this factor.
"""

from denoc_ros.kernels.algebra.vector import all_finite
from denoc_ros.kernels.constraints.closure import (
    all_rows,
    constraint_rows,
    constraints,
    move_bodies,
)
from denoc_ros.kernels.constraints.constrained import add_rows, find_constrained, give_loads
from denoc_ros.kernels.constraints.multipliers import columns_of, solve_rows, vector
from denoc_ros.kernels.dynamics.articulated import outward_accelerations
from denoc_ros.kernels.dynamics.step import (
    DRIVE,
    STAGE_Q,
    STAGE_QD,
    START_GIVEN,
    START_Q,
    START_QD,
    adopt,
    copy,
    take_step,
)
from denoc_ros.kernels.jit.compiled import inlined, kernel
from denoc_ros.kernels.jit.handle import (
    GOOD,
    MISFIT,
    ZERO,
    at,
    beyond,
    coordinates,
    elements,
    model_arrays,
)
from denoc_ros.kernels.layout import constraint_layout as loop_
from denoc_ros.kernels.layout.layout import COORDINATE

OPENED = 5  # a status: the loops cannot be brought together again
PASSES = 6  # two do it, unless the step is far too long
CLOSED = 1e-12  # m, rad and per second: what ends the passes
OPEN = 1e-6  # m, rad: what is no closed loop


@inlined
def follow(topology, constants, values, shifted):
    """Put mimic joints on their leaders; shifted is 1 for positions, 0 for their rates."""
    # as often as there are constraints: a leader may itself be a mimic joint that stands later
    for _ in range(at(topology, 0, loop_.CONSTRAINTS)):
        for constraint in constraints(topology):
            if at(topology, constraint, loop_.KIND) == loop_.MIMIC:
                j = at(topology, at(topology, constraint, loop_.CHILD), COORDINATE)
                leader = at(topology, at(topology, constraint, loop_.OTHER), COORDINATE)
                c = at(topology, constraint, loop_.CONSTANTS)
                values[j] = (
                    constants[c + loop_.MULTIPLIER] * values[leader]
                    + shifted * constants[c + loop_.OFFSET]
                )


@inlined
def correct(handle, held, t, rows, which, values, change):
    """Take the least change from values that undoes a vector of errors over the rows."""
    topology, constants, work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    hard = at(topology, 0, loop_.ROWS)
    y = columns_of(t, rows, n) - 2 * n
    for k in range(rows):
        error = work[vector(t, rows, which) + k]
        work[vector(t, rows, loop_.WANTED) + k] = -error if k < hard else 0.0
    solve_rows(work, t, rows, rows, n)
    for j in range(n):
        work[y + j] = 0.0
    add_rows(work, t, rows, 0, rows, n, y)
    give_loads(topology, work, held, bodies, y)
    outward_accelerations(topology, constants, work, held, bodies, diagonals[ZERO], change)
    for j in range(n):
        values[j] += change[j]


@inlined
def worst_of(work, t, rows, hard, which):
    """Write the greatest of a vector of errors over the rows and its row; return it."""
    worst = 0.0
    for k in range(hard):
        error = abs(work[vector(t, rows, which) + k])
        if not error <= worst:
            worst = error
            work[t + loop_.WORST] = k
    work[t + loop_.RESIDUAL] = worst
    return worst


@inlined
def close_constraints(handle, held, q, qd, change):
    """Bring q and q' (n) back onto the constraints with the factors of the last stage."""
    topology, constants, work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    zero = diagonals[ZERO]
    t = at(topology, 0, loop_.CONSTRAINTS_WORK)
    rows = all_rows(topology)
    hard = at(topology, 0, loop_.ROWS)
    for _ in range(PASSES):
        move_bodies(topology, constants, work, bodies, q, qd, zero)
        for constraint in constraints(topology):
            constraint_rows(topology, constants, work, q, qd, zero, zero, constraint, t, rows)
        rate = worst_of(work, t, rows, hard, loop_.RATE)
        error = worst_of(work, t, rows, hard, loop_.ERROR)
        if error <= CLOSED and rate <= CLOSED:
            return GOOD
        for which in range(loop_.ERROR, loop_.RATE + 1):
            values = q if which == loop_.ERROR else qd
            correct(handle, held, t, rows, which, values, change)
    return GOOD if error <= OPEN and all_finite(q, n) and all_finite(qd, n) else OPENED


@kernel(
    'int64(int64, float64[:, ::1], float64[::1], float64, float64[::1], float64[::1], '
    'float64[::1], float64[::1])'
)
def advance_tied(handle, steps, held, dt, q, qd, given, tau):
    """Advance q and q' by dt in place, on the constraints of a robot that has some.

    Mimic joints are placed by their leaders, whatever q, q' and given say of them.
    """
    n = coordinates(handle)
    if q.shape[0] != n or qd.shape[0] != n or given.shape[0] != n or tau.shape[0] != n:
        return MISFIT
    topology, constants, _work, _diagonals, _bodies = model_arrays(handle)
    rows, flags = elements(steps), elements(held)
    start_q, start_qd = beyond(rows, START_Q * n), beyond(rows, START_QD * n)
    start_given = beyond(rows, START_GIVEN * n)
    copy(n, elements(q), start_q)
    copy(n, elements(qd), start_qd)
    copy(n, elements(given), start_given)
    follow(topology, constants, start_q, 1.0)
    follow(topology, constants, start_qd, 0.0)
    follow(topology, constants, start_given, 0.0)
    status = take_step(
        find_constrained, handle, rows, flags, dt, start_q, start_qd, start_given, elements(tau)
    )
    if status != GOOD:
        return status
    new_q, new_qd = beyond(rows, STAGE_Q * n), beyond(rows, STAGE_QD * n)
    status = close_constraints(handle, flags, new_q, new_qd, beyond(rows, DRIVE * n))
    if status == GOOD:
        follow(topology, constants, new_q, 1.0)
        follow(topology, constants, new_qd, 0.0)
        adopt(n, rows, elements(q), elements(qd))
    return status
