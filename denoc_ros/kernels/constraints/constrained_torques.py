"""Torques and multipliers of least norm for a motion in loops, and how they change.

v = S v and lambda solve the saddle S v + J^T lambda = I q'' + h - tau, J v = 0, S the actuated
coordinates. What it leaves open are multipliers with J^T lambda = 0: these turn with d(J x), where
J x = lambda.
Solutions of least norm of equations of any rank are those of a complete orthogonal decomposition
M P = Q [T 0; 0 0] Z^T with permutation P, orthogonal Q, Z and T triangular (rank): M x = b has
P Z [T^-1 (Q^T b)_1; 0], and P Z [0; y] is what M leaves open. Q and Z are products of reflections
1 - s v v^T, whose v take the place of the zeros they make.
"""

import numpy as np

from denoc_ros.kernels.algebra.vector import all_finite
from denoc_ros.kernels.constraints.closure import all_rows, constraints
from denoc_ros.kernels.constraints.constrained import axis_resistance
from denoc_ros.kernels.constraints.constraint_rates import (
    add_products,
    constraint_rates,
    places_of,
    room,
)
from denoc_ros.kernels.dynamics.inverse import find_torque
from denoc_ros.kernels.dynamics.states import over_rows
from denoc_ros.kernels.jit.compiled import inlined, merged, shared
from denoc_ros.kernels.jit.handle import GOOD, NOT_FINITE, at, coordinates, model_arrays
from denoc_ros.kernels.layout import constrained_derivative_layout as cdiff_
from denoc_ros.kernels.layout import constraint_layout as loop_


@inlined
def add_row(work, target, factor, source, count):
    """Add a factor times so many numbers to others."""
    for j in range(count):
        work[target + j] += factor * work[source + j]


@inlined
def longest_column(work, a, m, c):
    """Return which column from c on is the longest in the rows from c on, and its square."""
    best, greatest = c, -1.0
    for k in range(c, m):
        total = 0.0
        for r in range(c, m):
            total += work[a + m * r + k] * work[a + m * r + k]
        if total > greatest:
            best, greatest = k, total
    return best, greatest


@inlined
def swap_columns(work, a, m, order, c, k):
    """Swap columns c and k, and their places in the order."""
    for r in range(m):
        x = work[a + m * r + c]
        work[a + m * r + c] = work[a + m * r + k]
        work[a + m * r + k] = x
    x = work[order + c]
    work[order + c] = work[order + k]
    work[order + k] = x


@inlined
def reflection(head, square):
    """Head of the reflected vector, the head of v before scaling, and s for v_0 = 1.

    square: the square of the vector's length.
    """
    length = np.sqrt(square)
    image = -length if head >= 0.0 else length
    start = head - image
    return image, start, (0.0 if length == 0.0 else -start / image)


@inlined
def reflect_columns(work, a, m, c, scales):
    """Make zeros below the diagonal in column c; the reflection turns the columns after it."""
    d = a + (m + 1) * c
    square = 0.0
    for r in range(m - c):
        square += work[d + m * r] * work[d + m * r]
    image, start, s = reflection(work[d], square)
    work[scales + c] = s
    work[d] = image
    for r in range(1, m - c):
        work[d + m * r] /= start
    for k in range(1, m - c):
        total = work[d + k]
        for r in range(1, m - c):
            total += work[d + m * r] * work[d + m * r + k]
        work[d + k] -= s * total
        for r in range(1, m - c):
            work[d + m * r + k] -= s * total * work[d + m * r]


@inlined
def reflect_rows(work, a, m, i, rank, scales):
    """Make zeros after column rank - 1 in row i; the reflection turns the rows before it."""
    d = a + (m + 1) * i
    tail = a + m * i + rank
    square = work[d] * work[d]
    for k in range(m - rank):
        square += work[tail + k] * work[tail + k]
    image, start, s = reflection(work[d], square)
    work[scales + i] = s
    work[d] = image
    for k in range(m - rank):
        work[tail + k] /= start
    for r in range(i):
        total = work[a + m * r + i]
        for k in range(m - rank):
            total += work[a + m * r + rank + k] * work[tail + k]
        work[a + m * r + i] -= s * total
        for k in range(m - rank):
            work[a + m * r + rank + k] -= s * total * work[tail + k]


@shared
def decompose(work, a, m, order, least):
    """Replace the (m, m) matrix at a by its decomposition; return the rank.

    order: (m) of the columns. Scales of the reflections (2, m) stand after the matrix. Columns
    shorter than `least` times the longest count as nothing.
    """
    scales = a + m * m
    for k in range(m):
        work[order + k] = k
    rank, longest = m, 0.0
    for c in range(m):
        k, square = longest_column(work, a, m, c)
        if c == 0:
            longest = square
        if not square > least * least * longest:
            rank = c
            break
        if k != c:
            swap_columns(work, a, m, order, c, k)
        reflect_columns(work, a, m, c, scales)
    if rank < m:
        for i in range(rank - 1, -1, -1):
            reflect_rows(work, a, m, i, rank, scales + m)
    return rank


@inlined
def turn_rows(work, a, m, i, rank, x, count, s):
    """Apply reflection i of Z to the columns of x (m, count)."""
    tail = a + m * i + rank
    for j in range(count):
        total = work[x + count * i + j]
        for k in range(m - rank):
            total += work[tail + k] * work[x + count * (rank + k) + j]
        total *= s
        work[x + count * i + j] -= total
        for k in range(m - rank):
            work[x + count * (rank + k) + j] -= total * work[tail + k]


@shared
def solve_least(work, a, m, rank, b, count):
    """Replace right-hand sides b (m, count) by T^-1 (Q^T b)_1, and zeros."""
    scales = a + m * m
    for c in range(rank):
        d = a + (m + 1) * c
        for j in range(count):
            total = work[b + count * c + j]
            for r in range(1, m - c):
                total += work[d + m * r] * work[b + count * (c + r) + j]
            total *= work[scales + c]
            work[b + count * c + j] -= total
            for r in range(1, m - c):
                work[b + count * (c + r) + j] -= total * work[d + m * r]
    for c in range(rank - 1, -1, -1):
        for r in range(c + 1, rank):
            add_row(work, b + count * c, -work[a + m * c + r], b + count * r, count)
        for j in range(count):
            work[b + count * c + j] /= work[a + (m + 1) * c]
    for k in range(count * rank, count * m):
        work[b + k] = 0.0


@shared
def spread_solution(work, a, m, order, rank, b, count, x):
    """Write x = P Z b (m, count)."""
    if rank < m:
        for i in range(rank):
            turn_rows(work, a, m, i, rank, b, count, work[a + m * m + m + i])
    for r in range(m):
        o = x + count * np.int64(work[order + r])
        for j in range(count):
            work[o + j] = work[b + count * r + j]


@shared
def add_open(work, a, m, order, rank, x, count, room, b):
    """Add to b, which solve_least has left, the part of x (m, count) that M leaves open.

    room: (m, count) scratch.
    """
    for r in range(m):
        o = x + count * np.int64(work[order + r])
        for j in range(count):
            work[room + count * r + j] = work[o + j]
    for i in range(rank - 1, -1, -1):
        turn_rows(work, a, m, i, rank, room, count, work[a + m * m + m + i])
    for k in range(count * rank, count * m):
        work[b + k] += work[room + k]


LEAST_COLUMN = 1e-6
# Equations that cannot all be met contradict each other by more than this part of their terms:
# a closed state is closed to 1e-9, torques and accelerations come from files and trajectories.
AGREEMENT = 1e-6

# statuses: accelerations open the rows; they are none that the actuated joints can give
OPENING = 6
BEYOND_REACH = 7


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


@inlined
def note_worst(topology, work, residual, index, found):
    """Keep the greatest residual and its index, if it is greater than the one found before."""
    if abs(residual) <= abs(found):
        return found
    t = at(topology, 0, loop_.CONSTRAINTS_WORK)
    work[t + loop_.WORST] = index
    work[t + loop_.RESIDUAL] = residual
    return residual


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
        worst = note_worst(topology, work, total, k, worst)
        greatest = max(greatest, terms)
    return abs(worst) <= AGREEMENT * (1.0 + greatest)


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
        worst = note_worst(topology, work, left, j, worst)
    for j in range(m):
        work[places.sides + j] = weights[j - n] if j >= n else 0.0
    solve_saddle(work, places, m, rank, 1)
    for j in range(n):
        turning[j] = work[places.solution + j]
    return abs(worst) <= AGREEMENT * (1.0 + greatest)


@shared
def find_least_torques(handle, q, qd, qdd, flags, force, places):
    """Find the torques of joints with flags, and multipliers, of a motion; both stay in work.

    Forces (n) act beside these torques. Returns the status, and the rank of the saddle, which
    stays decomposed. The constraints' workspace has the worst row or coordinate of a bad one.
    """
    topology, _constants, work, _diagonals, _bodies = model_arrays(handle)
    n = coordinates(handle)
    need = room(topology, work, places, n, cdiff_.NEED)
    constraint_rates(handle, q, qd, qdd, places.rates)
    find_need(handle, q, qd, qdd, places, force, need)
    if not all_finite(need, n):
        return NOT_FINITE, 0
    if not keeps_closed(topology, work, qd, qdd, places, n):
        return OPENING, 0
    rank = factor_saddle(topology, work, places, flags, n)
    if not find_reactions(topology, work, places, rank, flags, need, n):
        return BEYOND_REACH, rank
    return GOOD, rank


@shared
def find_constrained_torques(handle, held, q, qd, qdd, force, torque, multipliers):
    """Write torques (n) of held joints and multipliers (rows) of least norm for a motion."""
    topology, _constants, work, _diagonals, _bodies = model_arrays(handle)
    n = coordinates(handle)
    places = places_of(topology, n)
    status, _rank = find_least_torques(handle, q, qd, qdd, held, force, places)
    torques = room(topology, work, places, n, cdiff_.TORQUES)
    weights = room(topology, work, places, n, cdiff_.WEIGHTS)
    for j in range(n):
        torque[j] = held[j] * torques[j]
    for k in range(at(topology, 0, loop_.ROWS)):
        multipliers[k] = weights[k]
    return status


constrained_torques_rows = over_rows('constrained_torques_rows', find_constrained_torques, 7)


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
