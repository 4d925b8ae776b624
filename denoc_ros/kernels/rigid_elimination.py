"""Elimination of a rigid body's joint (see articulated)."""

from denoc_ros.kernels.body_inertia import block_wrench, transmit_inertia
from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.inherited import carried_change
from denoc_ros.kernels.layout import (
    AXIS,
    CHANGE,
    COORDINATE,
    ELIMINATED,
    FORCE,
    INERTIA_WORK,
    JOINT,
    MOTION,
    PARENT,
    REAL,
    TORQUE,
    TURN,
    WORK,
)
from denoc_ros.kernels.vector import add, dot, load, scale, store
from denoc_ros.kernels.wrench import transmit_wrench


@inlined
def project_block(ints, reals, work, i):
    """Return force and torque of rigid body i's block for a unit acceleration of its joint."""
    b = at(ints, i, INERTIA_WORK)
    if at(ints, i, MOTION) == TURN:
        return (
            (work[b + 11], work[b + 14], work[b + 17]),
            (work[b + 20], work[b + 23], work[b + 26]),
        )
    s = at(ints, i, REAL) + AXIS
    return block_wrench(work, b, load(reals, s), load(reals, s + 3))


@inlined
def along_joint(ints, reals, i, f, n):
    """Return S^T of a wrench on body i."""
    if at(ints, i, MOTION) == TURN:
        return n[2]
    s = at(ints, i, REAL) + AXIS
    return dot(load(reals, s), f) + dot(load(reals, s + 3), n)


@inlined
def inward_rigid(ints, reals, work, shift, drive, i, free, block):
    """Eliminate rigid body i and pass on what is left; say whether it was possible."""
    o = at(ints, i, WORK)
    b = at(ints, i, INERTIA_WORK)
    force = load(work, o + FORCE)
    torque = load(work, o + TORQUE)
    for k in range(27):
        work[block + k] = work[b + k]
    if free == 1:
        j = at(ints, i, COORDINATE)
        w = at(ints, i, ELIMINATED)
        f, n = project_block(ints, reals, work, i)
        pivot = along_joint(ints, reals, i, f, n) + shift[j]
        if not pivot > 0.0:
            return False
        inverse = 1.0 / pivot
        u = (drive[j] - along_joint(ints, reals, i, force, torque)) * inverse
        store(work, w, f)
        store(work, w + 3, n)
        work[w + 6] = u
        work[w + 7] = inverse
        for r in range(3):
            g = inverse * f[r]
            h = inverse * n[r]
            for c in range(3):
                work[block + 3 * r + c] -= g * f[c]
                work[block + 9 + 3 * r + c] -= g * n[c]
                work[block + 18 + 3 * r + c] -= h * n[c]
        force = add(force, scale(u, f))
        torque = add(torque, scale(u, n))
    if at(ints, i, PARENT) > 0:
        transmit_wrench(ints, work, i, force, torque)
        transmit_inertia(ints, work, i, block)
    return True


@inlined
def outward_rigid(ints, reals, work, given, qdd, i, free):
    """Write the acceleration of rigid body i's coordinate."""
    o = at(ints, i, WORK)
    a, al = carried_change(ints, work, qdd, i)
    j = at(ints, i, COORDINATE)
    if free == 1:
        w = at(ints, i, ELIMINATED)
        x = work[w + 6] - work[w + 7] * (dot(load(work, w), a) + dot(load(work, w + 3), al))
        qdd[j] = x
        if at(ints, i, MOTION) == TURN:
            al = (al[0], al[1], al[2] + x)
        else:
            s = at(ints, i, REAL) + AXIS
            a = add(a, scale(x, load(reals, s)))
            al = add(al, scale(x, load(reals, s + 3)))
    elif at(ints, i, JOINT) == 1:
        qdd[j] = given[j]
    store(work, o + CHANGE, a)
    store(work, o + CHANGE + 3, al)
