"""Torques and multipliers of least norm for a motion in loops, and how they change.

v = S v and lambda solve the saddle S v + J^T lambda = I q'' + h - tau, J v = 0, S the actuated
coordinates. What it leaves open are multipliers with J^T lambda = 0: these turn with d(J x), where
J x = lambda.
"""

from denoc_ros.kernels import constrained_derivative_layout as cdiff_
from denoc_ros.kernels import constraint_layout as loop_
from denoc_ros.kernels.closure import all_rows, constraints
from denoc_ros.kernels.compiled import inlined, merged, shared
from denoc_ros.kernels.constrained import axis_resistance
from denoc_ros.kernels.constrained_rooms import add_products, room
from denoc_ros.kernels.constraint_rates import constraint_rates
from denoc_ros.kernels.handle import at, coordinates, model_arrays
from denoc_ros.kernels.inverse import find_torque
from denoc_ros.kernels.orthogonal import add_open, decompose, solve_least, spread_solution

# As in dynamics.constraints. The verbs themselves say what is wrong, and their sums round
# differently: what they let pass must pass here.
LEAST_COLUMN = 1e-6
AGREEMENT = 2e-6


@inlined
def row_rate(work, o, qd, n):
    """Return a row at o of work times q'."""
    rate = 0.0
    for j in range(n):
        rate += work[o + j] * qd[j]
    return rate


@merged
def find_need(handle, q, qd, qdd, places, force, need):
    """Write I q'' + h less the forces given, with damping and friction of free axes."""
    topology, constants, work, _diagonals, _bodies = model_arrays(handle)
    n = coordinates(handle)
    find_torque(handle, q, qd, qdd, need)
    for j in range(n):
        need[j] -= force[j]
    for constraint in constraints(topology):
        k = at(topology, constraint, loop_.AXIS_ROW)
        if at(topology, constraint, loop_.KIND) == loop_.MIMIC or k == 0:
            continue
        row = places.rates + n * k
        c = at(topology, constraint, loop_.CONSTANTS)
        resistance, _slope = axis_resistance(constants, c, row_rate(work, row, qd, n))
        for j in range(n):
            need[j] += resistance * work[row + j]


@merged
def keeps_closed(topology, work, qd, qdd, places, n):
    """Say whether accelerations keep the rows closed, whose rates along the motion stand."""
    worst, greatest = 0.0, 0.0
    size = all_rows(topology) * n
    for k in range(at(topology, 0, loop_.ROWS)):
        row = places.rates + n * k
        bias = row_rate(work, row + size, qd, n)
        total, terms = bias, abs(bias)
        for j in range(n):
            total += work[row + j] * qdd[j]
            terms += abs(work[row + j] * qdd[j])
        worst, greatest = max(worst, abs(total)), max(greatest, terms)
    return worst <= AGREEMENT * (1.0 + greatest)


@merged
def factor_saddle(topology, work, places, flags, n):
    """Decompose the saddle [S J^T; J 0] of torques and multipliers; return its rank."""
    hard = at(topology, 0, loop_.ROWS)
    m = n + hard
    for k in range(m * m):
        work[places.saddle + k] = 0.0
    for j in range(n):
        work[places.saddle + (m + 1) * j] = flags[j]
    for k in range(hard):
        for j in range(n):
            x = work[places.rates + n * k + j]
            work[places.saddle + m * j + n + k] = x
            work[places.saddle + m * (n + k) + j] = x
    return decompose(work, places.saddle, m, places.order, LEAST_COLUMN)


@inlined
def solve_saddle(work, places, m, rank, count):
    """Turn right-hand sides (m, count) into solutions of least norm."""
    solve_least(work, places.saddle, m, rank, places.sides, count)
    spread_solution(
        work, places.saddle, m, places.order, rank, places.sides, count, places.solution
    )


@shared
def find_reactions(topology, work, places, rank, flags, need, n):
    """Write the torques' v, the multipliers, and x with J x = multipliers; say if they suffice."""
    hard = at(topology, 0, loop_.ROWS)
    m = n + hard
    torques = room(topology, work, places, n, cdiff_.TORQUES)
    weights = room(topology, work, places, n, cdiff_.WEIGHTS)
    turning = room(topology, work, places, n, cdiff_.TURNING)
    for j in range(m):
        work[places.sides + j] = need[j] if j < n else 0.0
    solve_saddle(work, places, m, rank, 1)
    greatest = 0.0
    for j in range(n):
        torques[j] = work[places.solution + j]
        greatest = max(greatest, abs(need[j]))
    for k in range(hard):
        weights[k] = work[places.solution + n + k]
    worst = 0.0
    for j in range(n):
        left = need[j] - flags[j] * torques[j]
        for k in range(hard):
            left -= work[places.rates + n * k + j] * weights[k]
        worst = max(worst, abs(left))
    for j in range(m):
        work[places.sides + j] = weights[j - n] if j >= n else 0.0
    solve_saddle(work, places, m, rank, 1)
    for j in range(n):
        turning[j] = work[places.solution + j]
    return worst <= AGREEMENT * (1.0 + greatest)


@merged
def ask_forces(work, places, flags, verb, which, n):
    """Write to the first rows of the right-hand sides the change of the forces asked for."""
    asked = places.by_q + which * n * n
    if verb == cdiff_.INVERSE:
        for k in range(n * n):
            work[places.sides + k] = work[asked + k]
        return
    for k in range(n * n):
        work[places.sides + k] = work[asked + k] if which < 2 else 0.0
    if which == 2:
        for j in range(n):
            work[places.sides + (n + 1) * j] = flags[j] - 1.0
    motion = places.motion + which * n * n
    add_products(work, places.inertia, motion, n, n, n, places.sides)


@shared
def find_torques(handle, q, verb, actuated, count, rank, places):
    """Write changes of torques (count, n) and multipliers by q, q' and the inputs."""
    topology, _constants, work, _diagonals, _bodies = model_arrays(handle)
    n = coordinates(handle)
    rows, hard = all_rows(topology), at(topology, 0, loop_.ROWS)
    m = n + hard
    flags = room(topology, work, places, n, cdiff_.FLAGS)
    still = room(topology, work, places, n, cdiff_.STILL)
    change = places.applied + 2 * rows * n
    for which in range(3):
        ask_forces(work, places, flags, verb, which, n)
        for k in range(n * n, m * n):
            work[places.sides + k] = 0.0
        if which == 0:
            torques = room(topology, work, places, n, cdiff_.TORQUES)
            constraint_rates(handle, q, still, torques, places.applied)
            for k in range(hard * n):
                work[places.sides + n * n + k] = -work[change + k]
        solve_least(work, places.saddle, m, rank, places.sides, n)
        if which == 0 and rank < m:
            turning = room(topology, work, places, n, cdiff_.TURNING)
            constraint_rates(handle, q, still, turning, places.applied)
            for k in range(m * n):
                work[places.open + k] = work[change + k - n * n] if k >= n * n else 0.0
            add_open(
                work, places.saddle, m, places.order, rank, places.open, n, places.solution,
                places.sides,
            )  # fmt: skip
        spread_solution(
            work, places.saddle, m, places.order, rank, places.sides, n, places.solution
        )
        for k in range(count):
            for j in range(n):
                found = work[places.solution + n * actuated[k] + j]
                work[places.torques + which * n * n + n * k + j] = found
        for k in range(hard * n):
            work[places.pushes + which * hard * n + k] = work[places.solution + n * n + k]
