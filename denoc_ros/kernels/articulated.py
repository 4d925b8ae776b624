"""Forward and hybrid dynamics by UDU^T: inward elimination, outward accelerations (section 3.4).

With all velocities as they are and only the given accelerations, every body needs a wrench p. Free
coordinates x add accelerations on top, which obey the linear, bias-free part of the equations: so
bias terms appear in the outward motion only. Per body, with P = [S 0; 0 1],
D = P^T M P + shift = L L^T, W = (rows 1..6 of M P) L^-T and y = L^-1 (tau - P^T p); its carrier
sees the inertia M - W W^T and the wrench p + W y; on the way out x = L^-T (y - W^T a).
"""

import numpy as np

from denoc_ros.kernels.body_inertia import body_inertia, transmit_inertia
from denoc_ros.kernels.compiled import inlined, kernel, rows_kernel
from denoc_ros.kernels.handle import (
    ARMATURE,
    GOOD,
    MISFIT,
    NOT_FINITE,
    SCRATCH,
    SINGULAR,
    ZERO,
    at,
    model_arrays,
)
from denoc_ros.kernels.internal import internal_force
from denoc_ros.kernels.inverse import joint_force, outward_motion
from denoc_ros.kernels.layout import (
    ARM,
    AXIS,
    BEAM_WORK,
    BLOCK,
    CHANGE,
    COLUMNS,
    COORDINATE,
    ELIMINATED,
    FORCE,
    INERTIA_WORK,
    JOINT,
    MODES,
    PARENT,
    PLACE,
    REAL,
    SECTION,
    SECTION_WORK,
    TORQUE,
    WORK,
)
from denoc_ros.kernels.vector import (
    add,
    all_finite,
    cross,
    load,
    scale,
    store,
    unrotate,
)
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
def inward_body(ints, reals, work, shift, drive, i, free, m, block):
    """Eliminate body i and pass on what is left; say whether it was possible."""
    if not eliminate(ints, reals, work, shift, drive, i, free, m, block):
        return False
    if at(ints, i, PARENT) > 0:
        pass_inward(ints, work, i, free + m, block)
    return True


@inlined
def free_joint(ints, held, i):
    """Return 1 where body i has a joint that is not held, else 0."""
    if at(ints, i, JOINT) == 0 or held[at(ints, i, COORDINATE)] != 0.0:
        return 0
    return 1


@inlined
def inward_articulated(ints, reals, work, shift, held, bodies, drive):
    """Eliminate every body's free coordinates, from the tips to the base."""
    block = work.shape[0] - BLOCK
    for i in range(1, bodies + 1):
        body_inertia(ints, reals, work, i)
    for i in range(bodies, 0, -1):
        free = free_joint(ints, held, i)
        m = at(ints, i, MODES)
        # the commonest body again with its sizes as constants, so that loops unroll
        if m == 0 and free == 1:
            good = inward_body(ints, reals, work, shift, drive, i, 1, 0, block)
        else:
            good = inward_body(ints, reals, work, shift, drive, i, free, m, block)
        if not good:
            return False
    return True


@inlined
def carried_change(ints, work, qdd, i):
    """Return the acceleration that row i inherits from free coordinates before its joint."""
    p = at(ints, i, PARENT)
    o = at(ints, i, WORK)
    u = at(ints, p, WORK)
    a = load(work, u + CHANGE)
    al = load(work, u + CHANGE + 3)
    if at(ints, i, SECTION) > 0:
        s = at(ints, i, SECTION_WORK)
        a = add(a, cross(al, load(work, s + PLACE)))
        c = s + COLUMNS
        j = at(ints, p, COORDINATE) + at(ints, p, JOINT)
        for n in range(j, j + at(ints, p, MODES)):
            a = add(a, scale(qdd[n], load(work, c)))
            al = add(al, scale(qdd[n], load(work, c + 3)))
            c += 6
    a = add(a, cross(al, load(work, o + ARM)))
    return unrotate(work, o, a), unrotate(work, o, al)


@inlined
def outward_body(ints, reals, work, given, qdd, i, free, m):
    """Write the accelerations of body i's coordinates."""
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


@inlined
def outward_accelerations(ints, reals, work, held, bodies, given, qdd):
    """Write the accelerations of all coordinates, from the base to the tips."""
    for i in range(1, bodies + 1):
        free = free_joint(ints, held, i)
        m = at(ints, i, MODES)
        if m == 0 and free == 1:
            outward_body(ints, reals, work, given, qdd, i, 1, 0)
        else:
            outward_body(ints, reals, work, given, qdd, i, free, m)


@inlined
def held_force(ints, reals, work, qdd, i):
    """Return S^T of the wrench on body i when every acceleration is known."""
    o = at(ints, i, WORK)
    s = at(ints, i, REAL) + AXIS
    m = at(ints, i, MODES)
    inertia = at(ints, i, INERTIA_WORK)
    j = at(ints, i, COORDINATE) + 1
    force = joint_force(ints, reals, work, i)
    for r in range(6):
        u = 0.0
        for n in range(6):
            u += work[inertia + (6 + m) * r + n] * work[o + CHANGE + n]
        for n in range(m):
            u += work[inertia + (6 + m) * r + 6 + n] * qdd[j + n]
        force += reals[s + r] * u
    return force


@inlined
def solve(ints, reals, work, diagonals, bodies, shift, held, q, qd, given, tau, qdd, torque):
    """Write accelerations and torques as :func:`articulated_dynamics` does; return its status."""
    n = diagonals.shape[1]
    for j in range(n):
        torque[j] = tau[j] - internal_force(reals, diagonals, q, qd, j)
    outward_motion(ints, reals, work, bodies, q, qd, given)
    if not inward_articulated(ints, reals, work, shift, held, bodies, torque):
        return SINGULAR
    outward_accelerations(ints, reals, work, held, bodies, given, qdd)
    return GOOD if all_finite(qdd) else NOT_FINITE


@kernel('int64(int64, float64[::1], float64[::1], float64[::1], float64[::1])')
def forward_dynamics(handle, q, qd, tau, qdd):
    """Write the accelerations (n) under generalized forces tau (n)."""
    ints, reals, work, diagonals, bodies = model_arrays(handle)
    n = diagonals.shape[1]
    if q.shape[0] != n or qd.shape[0] != n or tau.shape[0] != n or qdd.shape[0] != n:
        return MISFIT
    zero = diagonals[ZERO]
    return solve(
        ints, reals, work, diagonals, bodies, diagonals[ARMATURE],
        zero, q, qd, zero, tau, qdd, diagonals[SCRATCH],
    )  # fmt: skip


@rows_kernel(
    'int64(int64, float64[:, ::1], float64[:, ::1], float64[:, ::1], int64, int64, '
    'float64[:, ::1])'
)
def forward_dynamics_rows(handle, q, qd, tau, first, last, qdd):
    """Do the same for rows first .. last - 1 of (k, n) states; return the worst status."""
    worst = GOOD
    for k in range(first, last):
        worst = max(worst, forward_dynamics(handle, q[k], qd[k], tau[k], qdd[k]))
    return worst


@kernel(
    'int64(int64, float64[::1], float64[::1], float64[::1], float64[::1], float64[::1], '
    'float64[::1], float64[::1], float64[::1])'
)
def articulated_dynamics(handle, shift, held, q, qd, given, tau, qdd, torque):
    """Write q'' (n) of the free coordinates and the torque (n) of the held joints.

    held[j] != 0: joint j has the acceleration given; given is zero elsewhere. shift is what stands
    on the diagonal beside the bodies' inertia: the armature, and more in a time step.
    """
    ints, reals, work, diagonals, bodies = model_arrays(handle)
    status = solve(
        ints, reals, work, diagonals, bodies, shift, held, q, qd, given, tau, qdd, torque
    )
    if status != GOOD:
        return status
    for i in range(1, bodies + 1):
        j = at(ints, i, COORDINATE)
        if at(ints, i, JOINT) == 1 and held[j] != 0.0:
            torque[j] = (
                held_force(ints, reals, work, qdd, i)
                + diagonals[ARMATURE, j] * given[j]
                + internal_force(reals, diagonals, q, qd, j)
            )
    return GOOD if all_finite(torque) else NOT_FINITE


@rows_kernel(
    'int64(int64, float64[::1], float64[:, ::1], float64[:, ::1], float64[:, ::1], '
    'float64[:, ::1], int64, int64, float64[:, ::1], float64[:, ::1])'
)
def articulated_dynamics_rows(handle, held, q, qd, given, tau, first, last, qdd, torque):
    """Do the same for rows first .. last - 1 of (k, n) states; return the worst status."""
    shift = model_arrays(handle)[3][ARMATURE]
    worst = GOOD
    for k in range(first, last):
        status = articulated_dynamics(
            handle, shift, held, q[k], qd[k], given[k], tau[k], qdd[k], torque[k]
        )
        worst = max(worst, status)
    return worst
