"""How accelerations in loops change, and with them the multipliers.

I dq'' - J^T dlambda = -dF, J dq'' = -d(J q'' + J' q'): by the articulated factors of the open tree
and the factors of J I^-1 J^T that constrained dynamics left.
"""

import numpy as np

from denoc_ros.kernels import constrained_derivative_layout as cdiff_
from denoc_ros.kernels import constraint_layout as loop_
from denoc_ros.kernels.closure import all_rows
from denoc_ros.kernels.compiled import merged, shared
from denoc_ros.kernels.constrained_rooms import add_products, room
from denoc_ros.kernels.constraint_rates import constraint_rates
from denoc_ros.kernels.forward_derivatives import drive_columns
from denoc_ros.kernels.handle import at, coordinates, model_arrays
from denoc_ros.kernels.multipliers import keep_consistent, solve_rows, vector
from denoc_ros.kernels.pointers import part
from denoc_ros.kernels.right_hand_sides import factors_to_base, solve_columns


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
