"""Multipliers of rows that may be redundant: A lambda = b with A = Y^T D^-1 Y, least norm.

Pivoted Cholesky on A, scaled to a unit diagonal, finds independent rows p. The others are
combinations C of these, J = C J_p, so that lambda = C (C^T C)^-1 mu with A_pp mu = b_p is the
solution of least norm; their b must be C b_p, else the rows contradict each other.
"""

import numpy as np

from denoc_ros.kernels.dynamics.elimination import factor
from denoc_ros.kernels.jit.compiled import inlined, shared
from denoc_ros.kernels.layout import constraint_layout as loop_

# Pivots of A are squares. Rounding leaves 1e-16 of a redundant one, axes printed with seven digits
# 1e-14: below the square of 1e-6 nothing is meant.
LEAST_PIVOT = 1e-12
# A row of this part of the greatest does not constrain at all: closure drifts by 1e-9, and a row
# must not be blown up from that.
LEAST_ROW = 1e-16
# Rows contradict each other by more than this part of their terms, or of 1 m/s^2 (1 rad/s^2).
AGREEMENT = 1e-6


@inlined
def vector(t, rows, which):
    """Return the offset of one of the vectors over the rows."""
    return t + loop_.VECTORS + which * rows


@inlined
def columns_of(t, rows, n):
    """Return the offset of the columns; before them stand y (n) of the loads and D^-1 (n)."""
    return t + loop_.VECTORS + rows * (loop_.CONSTRAINT_VECTORS + 6) + 2 * n


@inlined
def product(work, y, column, weight, n):
    """Return y . D^-1 column of two vectors (n)."""
    total = 0.0
    for j in range(n):
        total += work[y + j] * work[weight + j] * work[column + j]
    return total


@inlined
def write_products(work, t, rows, count, n):
    """Write A = Y^T D^-1 Y (count, count), a row of `rows` elements each."""
    columns = columns_of(t, rows, n)
    products = columns + rows * n
    for i in range(count):
        for k in range(i + 1):
            total = product(work, columns + n * i, columns + n * k, columns - n, n)
            work[products + rows * i + k] = total
            work[products + rows * k + i] = total


@inlined
def scale_rows(work, t, products, rows, count, hard):
    """Write the scale of every row, zero for one that constrains nothing.

    Only the first `hard` rows constrain; the others give way and so always have a multiplier.
    """
    scale = vector(t, rows, loop_.SCALE)
    greatest = 0.0
    for k in range(hard):
        greatest = max(greatest, work[products + (rows + 1) * k])
    for k in range(count):
        size = work[products + (rows + 1) * k]
        counts = k >= hard or size > LEAST_ROW * greatest
        work[scale + k] = np.sqrt(size) if counts else 0.0
        work[vector(t, rows, loop_.LEFT) + k] = 1.0 if counts else 0.0
        work[vector(t, rows, loop_.ORDER) + k] = k


@inlined
def choose(work, order, left, c, count):
    """Bring the row with the greatest pivot left to place c of the order; return that pivot."""
    best = c
    for k in range(c + 1, count):
        if work[left + np.int64(work[order + k])] > work[left + np.int64(work[order + best])]:
            best = k
    chosen = work[order + best]
    work[order + best] = work[order + c]
    work[order + c] = chosen
    return work[left + np.int64(chosen)]


@inlined
def factor_rows(work, t, products, lower, rows, count, hard):
    """Factor the scaled products of independent rows, chosen one by one; return the rank."""
    scale_rows(work, t, products, rows, count, hard)
    scale = vector(t, rows, loop_.SCALE)
    order = vector(t, rows, loop_.ORDER)
    left = vector(t, rows, loop_.LEFT)
    for c in range(count):
        pivot = choose(work, order, left, c, count)
        if not pivot > LEAST_PIVOT:
            return c
        p = np.int64(work[order + c])
        root = np.sqrt(pivot)
        work[lower + rows * p + c] = root
        for k in range(c + 1, count):
            i = np.int64(work[order + k])
            if work[scale + i] == 0.0:
                continue
            u = work[products + rows * p + i] / (work[scale + p] * work[scale + i])
            for r in range(c):
                u -= work[lower + rows * i + r] * work[lower + rows * p + r]
            u /= root
            work[lower + rows * i + c] = u
            work[left + i] -= u * u
    return count


@inlined
def combine_rows(work, t, lower, combined, gram, rows, count, rank):
    """Write C of the dependent rows and the factors of C^T C over all rows."""
    scale = vector(t, rows, loop_.SCALE)
    order = vector(t, rows, loop_.ORDER)
    for r in range(rank):
        for c in range(rank):
            work[gram + rank * r + c] = 1.0 if r == c else 0.0
    for k in range(rank, count):
        i = np.int64(work[order + k])
        for c in range(rank - 1, -1, -1):
            p = np.int64(work[order + c])
            u = 0.0
            if work[scale + i] != 0.0:
                u = work[lower + rows * i + c]
                for r in range(c + 1, rank):
                    above = np.int64(work[order + r])
                    u -= work[combined + rows * i + r] * work[lower + rows * above + c]
                u /= work[lower + rows * p + c]
            work[combined + rows * i + c] = u
        for c in range(rank):
            p = np.int64(work[order + c])
            work[combined + rows * i + c] *= work[scale + i] / work[scale + p]
        for r in range(rank):
            for c in range(r + 1):
                share = work[combined + rows * i + r] * work[combined + rows * i + c]
                work[gram + rank * r + c] += share
    factor(work, gram, rank)


@shared
def factor_products(work, t, rows, count, hard, n):
    """Factor A of the first `count` rows, all that a solve needs; keep the rank."""
    columns = columns_of(t, rows, n)
    products = columns + rows * n
    lower = products + rows * rows
    rank = factor_rows(work, t, products, lower, rows, count, hard)
    work[t + loop_.RANK] = rank
    if rank < count:
        # the products have served: the factor of C^T C takes their place
        combine_rows(work, t, lower, lower + rows * rows, products, rows, count, rank)


@inlined
def solve_factored(work, d, k, x):
    """Multiply the k elements at offset x by the inverse of the matrix factored by `factor`."""
    for r in range(k):
        for c in range(r):
            work[x + r] -= work[d + k * r + c] * work[x + c]
    for r in range(k - 1, -1, -1):
        u = work[x + r] * work[d + (k + 1) * r]
        for c in range(r + 1, k):
            u -= work[d + k * c + r] * work[x + c]
        work[x + r] = u


@inlined
def solve_forward(work, t, rows, lower, rank):
    """Write L^-1 of the independent rows' right-hand sides, scaled."""
    wanted = vector(t, rows, loop_.WANTED)
    scale = vector(t, rows, loop_.SCALE)
    order = vector(t, rows, loop_.ORDER)
    part = vector(t, rows, loop_.PART)
    for c in range(rank):
        p = np.int64(work[order + c])
        u = work[wanted + p] / work[scale + p]
        for r in range(c):
            u -= work[lower + rows * p + r] * work[part + r]
        work[part + c] = u / work[lower + rows * p + c]


@inlined
def find_excess(work, t, rows, lower, count, rank):
    """Write how much dependent rows want that the others do not give; say if that is rounding."""
    wanted = vector(t, rows, loop_.WANTED)
    scale = vector(t, rows, loop_.SCALE)
    size = 1.0
    for k in range(count):
        size = max(size, abs(work[wanted + k]) + abs(work[vector(t, rows, loop_.BIAS) + k]))
    excess = 0.0
    for k in range(rank, count):
        i = np.int64(work[vector(t, rows, loop_.ORDER) + k])
        u = work[wanted + i]
        if work[scale + i] != 0.0:
            for r in range(rank):
                share = work[lower + rows * i + r] * work[vector(t, rows, loop_.PART) + r]
                u -= work[scale + i] * share
        if abs(u) > excess:
            excess = abs(u)
            work[t + loop_.WORST] = i
    work[t + loop_.RESIDUAL] = excess
    return excess <= AGREEMENT * size


@inlined
def solve_backward(work, t, rows, lower, rank):
    """Replace the result of solve_forward by the multipliers of the independent rows alone."""
    scale = vector(t, rows, loop_.SCALE)
    order = vector(t, rows, loop_.ORDER)
    part = vector(t, rows, loop_.PART)
    for c in range(rank - 1, -1, -1):
        p = np.int64(work[order + c])
        u = work[part + c]
        for r in range(c + 1, rank):
            u -= work[lower + rows * np.int64(work[order + r]) + c] * work[part + r]
        work[part + c] = u / work[lower + rows * p + c]
    for c in range(rank):
        work[part + c] /= work[scale + np.int64(work[order + c])]


@shared
def keep_consistent(work, t, rows, count, n, which):
    """Replace a vector over the rows by C (C^T C)^-1 C^T of it: its consistent part."""
    rank = np.int64(work[t + loop_.RANK])
    if rank == count:
        return
    gram = columns_of(t, rows, n) + rows * n
    combined = gram + 2 * rows * rows
    order, part = vector(t, rows, loop_.ORDER), vector(t, rows, loop_.PART)
    given = vector(t, rows, which)
    for r in range(rank):
        total = work[given + np.int64(work[order + r])]
        for k in range(rank, count):
            i = np.int64(work[order + k])
            total += work[combined + rows * i + r] * work[given + i]
        work[part + r] = total
    solve_factored(work, gram, rank, part)
    for k in range(count):
        i = np.int64(work[order + k])
        total = work[part + k] if k < rank else 0.0
        if k >= rank:
            for r in range(rank):
                total += work[combined + rows * i + r] * work[part + r]
        work[given + i] = total


@shared
def solve_rows(work, t, rows, count, n):
    """Write the multipliers of least norm for WANTED; say whether the rows agree."""
    gram = columns_of(t, rows, n) + rows * n
    lower = gram + rows * rows
    combined = lower + rows * rows
    rank = np.int64(work[t + loop_.RANK])
    part = vector(t, rows, loop_.PART)
    solve_forward(work, t, rows, lower, rank)
    good = find_excess(work, t, rows, lower, count, rank)
    solve_backward(work, t, rows, lower, rank)
    if rank < count:
        solve_factored(work, gram, rank, part)
    for k in range(count):
        i = np.int64(work[vector(t, rows, loop_.ORDER) + k])
        if k < rank:
            work[vector(t, rows, loop_.MULTIPLIERS) + i] = work[part + k]
            continue
        u = 0.0
        for r in range(rank):
            u += work[combined + rows * i + r] * work[part + r]
        work[vector(t, rows, loop_.MULTIPLIERS) + i] = u
    return good
