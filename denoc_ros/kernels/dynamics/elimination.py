"""Elimination of a body's joint and amplitudes, rigid or flexible (see articulated)."""

from denoc_ros.kernels.algebra.joint_block import block_at, reduced, wrench_of
from denoc_ros.kernels.algebra.vector import (
    add,
    cross,
    dot,
    load,
    scale,
    store,
    subtract,
    unrotate,
)
from denoc_ros.kernels.dynamics.body_inertia import flexible_block, transmit_inertia
from denoc_ros.kernels.dynamics.inverse import joint_force
from denoc_ros.kernels.dynamics.wrench import transmit_wrench
from denoc_ros.kernels.jit.compiled import inlined, shared
from denoc_ros.kernels.jit.handle import at
from denoc_ros.kernels.layout import layout as at_


@inlined
def carried_change(topology, work, qdd, i):
    """Return the acceleration that row i inherits from free coordinates before its joint."""
    p = at(topology, i, at_.PARENT)
    o = at(topology, i, at_.WORK)
    u = at(topology, p, at_.WORK)
    a = load(work, u + at_.FREE_ACCELERATION)
    al = load(work, u + at_.FREE_ACCELERATION + 3)
    if at(topology, i, at_.SECTION) > 0:
        s = at(topology, i, at_.SECTION_WORK)
        a = add(a, cross(al, load(work, s + at_.SECTION_POSITION)))
        c = s + at_.COLUMNS
        j = at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT)
        for n in range(j, j + at(topology, p, at_.MODES)):
            a = add(a, scale(qdd[n], load(work, c)))
            al = add(al, scale(qdd[n], load(work, c + 3)))
            c += 6
    a = add(a, cross(al, load(work, o + at_.ARM)))
    return unrotate(work, o, a), unrotate(work, o, al)


@inlined
def projected(topology, constants, block, i):
    """Return force and torque of rigid body i's block for a unit acceleration of its joint."""
    if at(topology, i, at_.MOTION) == at_.REVOLUTE_Z:
        _, b, d = block
        return (b[0][2], b[1][2], b[2][2]), (d[2], d[4], d[5])
    s = at(topology, i, at_.BODY_CONSTANTS) + at_.AXIS
    return wrench_of(block, load(constants, s), load(constants, s + 3))


@inlined
def along_joint(topology, constants, i, f, n):
    """Return S^T of a wrench on body i."""
    if at(topology, i, at_.MOTION) == at_.REVOLUTE_Z:
        return n[2]
    s = at(topology, i, at_.BODY_CONSTANTS) + at_.AXIS
    return dot(load(constants, s), f) + dot(load(constants, s + 3), n)


@inlined
def inward_rigid(topology, constants, work, shift, drive, i, free):
    """Eliminate rigid body i and pass on the remainder; say whether it was possible."""
    o = at(topology, i, at_.WORK)
    block = block_at(work, at(topology, i, at_.INERTIA_WORK))
    force = load(work, o + at_.FORCE)
    torque = load(work, o + at_.TORQUE)
    if free == 1:
        j = at(topology, i, at_.COORDINATE)
        w = at(topology, i, at_.ELIMINATED)
        f, n = projected(topology, constants, block, i)
        pivot = along_joint(topology, constants, i, f, n) + shift[j]
        if not pivot > 0.0:
            return False
        inverse = 1.0 / pivot
        u = (drive[j] - along_joint(topology, constants, i, force, torque)) * inverse
        store(work, w, f)
        store(work, w + 3, n)
        work[w + 6] = u
        work[w + 7] = inverse
        block = reduced(block, f, n, inverse)
        force = add(force, scale(u, f))
        torque = add(torque, scale(u, n))
    if at(topology, i, at_.PARENT) > 0:
        transmit_wrench(topology, work, i, force, torque)
        transmit_inertia(topology, work, i, block)
    return True


@inlined
def outward_rigid(topology, constants, work, given, qdd, i, free):
    """Write the acceleration of rigid body i's coordinate."""
    o = at(topology, i, at_.WORK)
    a, al = carried_change(topology, work, qdd, i)
    j = at(topology, i, at_.COORDINATE)
    if free == 1:
        w = at(topology, i, at_.ELIMINATED)
        x = work[w + 6] - work[w + 7] * (dot(load(work, w), a) + dot(load(work, w + 3), al))
        qdd[j] = x
        if at(topology, i, at_.MOTION) == at_.REVOLUTE_Z:
            al = (al[0], al[1], al[2] + x)
        else:
            s = at(topology, i, at_.BODY_CONSTANTS) + at_.AXIS
            a = add(a, scale(x, load(constants, s)))
            al = add(al, scale(x, load(constants, s + 3)))
    elif at(topology, i, at_.JOINT) == 1:
        qdd[j] = given[j]
    store(work, o + at_.FREE_ACCELERATION, a)
    store(work, o + at_.FREE_ACCELERATION + 3, al)


@inlined
def project_inertia(topology, constants, work, shift, i, free, m):
    """Write M P (six rows) and the lower half of D = P^T M P + shift of body i."""
    size = 6 + m
    k = free + m
    o = at(topology, i, at_.INERTIA_WORK)
    w = at(topology, i, at_.ELIMINATED)
    d = w + 6 * k
    j = at(topology, i, at_.COORDINATE) + at(topology, i, at_.JOINT)
    for n in range(m):
        c = o + 6 + n
        for r in range(6):
            work[w + 6 * (free + n) + r] = work[c + size * r]
        for r in range(n + 1):
            work[d + k * (free + n) + free + r] = work[c + size * (6 + r)]
        work[d + (k + 1) * (free + n)] += shift[j + n]
    if free == 1:
        s = at(topology, i, at_.BODY_CONSTANTS) + at_.AXIS
        slide, turn = load(constants, s), load(constants, s + 3)
        f, t = wrench_of(flexible_block(work, o, size), slide, turn)
        store(work, w, f)
        store(work, w + 3, t)
        work[d] = dot(slide, f) + dot(turn, t) + shift[j - 1]
        for n in range(1, k):
            c = w + 6 * n
            work[d + k * n] = dot(slide, load(work, c)) + dot(turn, load(work, c + 3))


@inlined
def factor(work, d, k):
    """Replace the lower half of a symmetric k x k matrix by L and, on the diagonal, 1 / pivots.

    The matrix is L D L^T, D diagonal, L with ones on its diagonal; says whether D is positive.
    """
    for r in range(k):
        row = d + k * r
        pivot = work[row + r]
        for c in range(r):
            u = work[row + c]
            for n in range(c):
                u -= work[row + n] * work[d + k * c + n]
            work[row + c] = u  # of L D, until the row is complete
        for c in range(r):
            u = work[row + c]
            work[row + c] = u * work[d + (k + 1) * c]
            pivot -= u * work[row + c]
        if not pivot > 0.0:
            return False
        work[row + r] = 1.0 / pivot
    return True


@inlined
def eliminate(topology, constants, work, shift, drive, i, free, m):
    """Eliminate body i's free coordinates; return if it was possible, and the remainder.

    drive[j] is the generalized force less elasticity, damping and friction. Left are the block,
    the force and the torque that the carrier sees.
    """
    k = free + m
    o = at(topology, i, at_.WORK)
    w = at(topology, i, at_.ELIMINATED)
    d = w + 6 * k
    y = d + k * k
    j = at(topology, i, at_.COORDINATE) + at(topology, i, at_.JOINT)
    modal = at(topology, i, at_.BEAM_WORK)
    project_inertia(topology, constants, work, shift, i, free, m)
    good = factor(work, d, k)
    if free == 1:
        work[y] = drive[j - 1] - joint_force(topology, constants, work, i)
    for n in range(m):
        work[y + free + n] = drive[j + n] - work[modal + n]
    block = flexible_block(work, at(topology, i, at_.INERTIA_WORK), 6 + m)
    force = load(work, o + at_.FORCE)
    torque = load(work, o + at_.TORQUE)
    for n in range(k):
        c = w + 6 * n
        f, t, u = load(work, c), load(work, c + 3), work[y + n]
        for r in range(n):
            e = work[d + k * n + r]
            f = subtract(f, scale(e, load(work, w + 6 * r)))
            t = subtract(t, scale(e, load(work, w + 6 * r + 3)))
            u -= e * work[y + r]
        store(work, c, f)
        store(work, c + 3, t)
        work[y + n] = u
        inverse = work[d + (k + 1) * n]
        block = reduced(block, f, t, inverse)
        force = add(force, scale(u * inverse, f))
        torque = add(torque, scale(u * inverse, t))
    return good, block, force, torque


@shared
def inward_flexible(topology, constants, work, shift, drive, i, free, m):
    """Eliminate flexible body i and pass on the remainder; say whether it was possible.

    A function of its own: within a loop that has :func:`inward_rigid` too, the compiler joins the
    ends of both, and all that they pass on goes over the stack.
    """
    good, block, force, torque = eliminate(topology, constants, work, shift, drive, i, free, m)
    if good and at(topology, i, at_.PARENT) > 0:
        transmit_wrench(topology, work, i, force, torque)
        transmit_inertia(topology, work, i, block)
    return good


@inlined
def outward_flexible(topology, constants, work, given, qdd, i, free, m):
    """Write the accelerations of flexible body i's coordinates."""
    o = at(topology, i, at_.WORK)
    a, al = carried_change(topology, work, qdd, i)
    k = free + m
    w = at(topology, i, at_.ELIMINATED)
    d = w + 6 * k
    y = d + k * k
    for r in range(k - 1, -1, -1):
        c = w + 6 * r
        u = work[y + r] - dot(load(work, c), a) - dot(load(work, c + 3), al)
        u *= work[d + (k + 1) * r]
        for n in range(r + 1, k):
            u -= work[d + k * n + r] * work[y + n]
        work[y + r] = u
    j = at(topology, i, at_.COORDINATE)
    if free == 1:
        s = at(topology, i, at_.BODY_CONSTANTS) + at_.AXIS
        qdd[j] = work[y]
        a = add(a, scale(work[y], load(constants, s)))
        al = add(al, scale(work[y], load(constants, s + 3)))
    elif at(topology, i, at_.JOINT) == 1:
        qdd[j] = given[j]
    j += at(topology, i, at_.JOINT)
    for n in range(m):
        qdd[j + n] = work[y + free + n]
    store(work, o + at_.FREE_ACCELERATION, a)
    store(work, o + at_.FREE_ACCELERATION + 3, al)
