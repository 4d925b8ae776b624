"""Elimination of a flexible body's joint and amplitudes (see articulated)."""

import numpy as np

from denoc_ros.kernels.body_inertia import transmit_inertia
from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.inherited import carried_change
from denoc_ros.kernels.inverse import joint_force
from denoc_ros.kernels.layout import (
    AXIS,
    BEAM_WORK,
    CHANGE,
    COORDINATE,
    ELIMINATED,
    FORCE,
    INERTIA_WORK,
    JOINT,
    PARENT,
    REAL,
    TORQUE,
    WORK,
)
from denoc_ros.kernels.vector import add, load, scale, store
from denoc_ros.kernels.wrench import transmit_wrench


@inlined
def project_inertia(ints, reals, work, shift, i, free, m):
    """Write six rows of M P and the lower half of D = P^T M P + shift of body i."""
    size = 6 + m
    k = free + m
    o = at(ints, i, INERTIA_WORK)
    w = at(ints, i, ELIMINATED)
    d = w + 6 * k
    j = at(ints, i, COORDINATE) + at(ints, i, JOINT)
    for n in range(m):
        for r in range(6):
            work[w + k * r + free + n] = work[o + size * r + 6 + n]
        for r in range(n + 1):
            work[d + k * (free + n) + free + r] = work[o + size * (6 + n) + 6 + r]
        work[d + (k + 1) * (free + n)] += shift[j + n]
    if free == 1:
        s = at(ints, i, REAL) + AXIS
        pivot = shift[j - 1]
        for r in range(6):
            u = 0.0
            for n in range(6):
                u += work[o + size * r + n] * reals[s + n]
            work[w + k * r] = u
            pivot += reals[s + r] * u
        work[d] = pivot
        for n in range(m):
            u = 0.0
            for r in range(6):
                u += work[o + size * (6 + n) + r] * reals[s + r]
            work[d + k * (1 + n)] = u


@inlined
def factor(work, d, k):
    """Replace the lower half of a k x k matrix by its Cholesky factor; say whether it has one."""
    for c in range(k):
        pivot = work[d + (k + 1) * c]
        for n in range(c):
            pivot -= work[d + k * c + n] ** 2
        if not pivot > 0.0:
            return False
        pivot = np.sqrt(pivot)
        work[d + (k + 1) * c] = pivot
        for r in range(c + 1, k):
            u = work[d + k * r + c]
            for n in range(c):
                u -= work[d + k * r + n] * work[d + k * c + n]
            work[d + k * r + c] = u / pivot
    return True


@inlined
def solve_lower(work, d, k, x):
    """Replace the k elements at offset x by L^-1 of them."""
    for r in range(k):
        u = work[x + r]
        for n in range(r):
            u -= work[d + k * r + n] * work[x + n]
        work[x + r] = u / work[d + (k + 1) * r]


@inlined
def solve_upper(work, d, k, x):
    """Replace the k elements at offset x by L^-T of them."""
    for r in range(k - 1, -1, -1):
        u = work[x + r]
        for n in range(r + 1, k):
            u -= work[d + k * n + r] * work[x + n]
        work[x + r] = u / work[d + (k + 1) * r]


@inlined
def eliminate(ints, reals, work, shift, drive, i, free, m, block):
    """Eliminate body i's free coordinates; write its six-row block; say whether it was possible.

    drive[j] is the generalized force less elasticity, damping and friction.
    """
    size = 6 + m
    k = free + m
    o = at(ints, i, INERTIA_WORK)
    w = at(ints, i, ELIMINATED)
    d = w + 6 * k
    y = d + k * k
    j = at(ints, i, COORDINATE)
    project_inertia(ints, reals, work, shift, i, free, m)
    if not factor(work, d, k):
        return False
    if free == 1:
        work[y] = drive[j] - joint_force(ints, reals, work, i)
    j += at(ints, i, JOINT)
    modal = at(ints, i, BEAM_WORK)
    for n in range(m):
        work[y + free + n] = drive[j + n] - work[modal + n]
    solve_lower(work, d, k, y)
    for r in range(6):
        solve_lower(work, d, k, w + k * r)
    for r in range(3):
        for c in range(3):
            a = work[o + size * r + c]
            b = work[o + size * r + 3 + c]
            e = work[o + size * (3 + r) + 3 + c]
            for n in range(k):
                left = work[w + k * r + n]
                right = work[w + k * (3 + c) + n]
                a -= left * work[w + k * c + n]
                b -= left * right
                e -= work[w + k * (3 + r) + n] * right
            work[block + 3 * r + c] = a
            work[block + 9 + 3 * r + c] = b
            work[block + 18 + 3 * r + c] = e
    return True


@inlined
def pass_inward(ints, work, i, k, block):
    """Give body i's carrier the wrench p + W y and the inertia in block."""
    o = at(ints, i, WORK)
    w = at(ints, i, ELIMINATED)
    y = w + 6 * k + k * k
    force = load(work, o + FORCE)
    torque = load(work, o + TORQUE)
    for n in range(k):
        u = work[y + n]
        force = add(force, (u * work[w + n], u * work[w + k + n], u * work[w + 2 * k + n]))
        c = w + 3 * k + n
        torque = add(torque, (u * work[c], u * work[c + k], u * work[c + 2 * k]))
    transmit_wrench(ints, work, i, force, torque)
    transmit_inertia(ints, work, i, block)


@inlined
def inward_flexible(ints, reals, work, shift, drive, i, free, m, block):
    """Eliminate flexible body i and pass on what is left; say whether it was possible."""
    if not eliminate(ints, reals, work, shift, drive, i, free, m, block):
        return False
    if at(ints, i, PARENT) > 0:
        pass_inward(ints, work, i, free + m, block)
    return True


@inlined
def outward_flexible(ints, reals, work, given, qdd, i, free, m):
    """Write the accelerations of flexible body i's coordinates."""
    o = at(ints, i, WORK)
    a, al = carried_change(ints, work, qdd, i)
    k = free + m
    w = at(ints, i, ELIMINATED)
    d = w + 6 * k
    y = d + k * k
    for n in range(k):
        c = w + n
        work[y + n] -= (
            work[c] * a[0]
            + work[c + k] * a[1]
            + work[c + 2 * k] * a[2]
            + work[c + 3 * k] * al[0]
            + work[c + 4 * k] * al[1]
            + work[c + 5 * k] * al[2]
        )
    solve_upper(work, d, k, y)
    j = at(ints, i, COORDINATE)
    if free == 1:
        s = at(ints, i, REAL) + AXIS
        qdd[j] = work[y]
        a = add(a, scale(work[y], load(reals, s)))
        al = add(al, scale(work[y], load(reals, s + 3)))
    elif at(ints, i, JOINT) == 1:
        qdd[j] = given[j]
    j += at(ints, i, JOINT)
    for n in range(m):
        qdd[j + n] = work[y + free + n]
    store(work, o + CHANGE, a)
    store(work, o + CHANGE + 3, al)
