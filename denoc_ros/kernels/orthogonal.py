"""Complete orthogonal decomposition: solutions of least norm of equations of any rank.

M P = Q [T 0; 0 0] Z^T with permutation P, orthogonal Q, Z and T triangular (rank): M x = b has the
least-squares solution of least norm P Z [T^-1 (Q^T b)_1; 0], and P Z [0; y] is what M leaves open.
Q and Z are products of reflections 1 - s v v^T, whose v take the place of the zeros they make.
"""

import numpy as np

from denoc_ros.kernels.compiled import inlined, shared


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
