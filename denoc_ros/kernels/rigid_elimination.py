"""Elimination of a rigid body's joint (see articulated)."""

from denoc_ros.kernels.block import block_at, reduced, wrench_of
from denoc_ros.kernels.body_inertia import transmit_inertia
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
def projected(ints, reals, block, i):
    """Return force and torque of rigid body i's block for a unit acceleration of its joint."""
    if at(ints, i, MOTION) == TURN:
        _, b, d = block
        return (b[0][2], b[1][2], b[2][2]), (d[2], d[4], d[5])
    s = at(ints, i, REAL) + AXIS
    return wrench_of(block, load(reals, s), load(reals, s + 3))


@inlined
def along_joint(ints, reals, i, f, n):
    """Return S^T of a wrench on body i."""
    if at(ints, i, MOTION) == TURN:
        return n[2]
    s = at(ints, i, REAL) + AXIS
    return dot(load(reals, s), f) + dot(load(reals, s + 3), n)


@inlined
def inward_rigid(ints, reals, work, shift, drive, i, free):
    """Eliminate rigid body i and pass on what is left; say whether it was possible."""
    o = at(ints, i, WORK)
    block = block_at(work, at(ints, i, INERTIA_WORK))
    force = load(work, o + FORCE)
    torque = load(work, o + TORQUE)
    if free == 1:
        j = at(ints, i, COORDINATE)
        w = at(ints, i, ELIMINATED)
        f, n = projected(ints, reals, block, i)
        pivot = along_joint(ints, reals, i, f, n) + shift[j]
        if not pivot > 0.0:
            return False
        inverse = 1.0 / pivot
        u = (drive[j] - along_joint(ints, reals, i, force, torque)) * inverse
        store(work, w, f)
        store(work, w + 3, n)
        work[w + 6] = u
        work[w + 7] = inverse
        block = reduced(block, f, n, inverse)
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
