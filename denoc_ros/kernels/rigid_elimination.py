"""Elimination of a rigid body's joint (see articulated)."""

from denoc_ros.kernels import layout as at_
from denoc_ros.kernels.block import block_at, reduced, wrench_of
from denoc_ros.kernels.body_inertia import transmit_inertia
from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.inherited import carried_change
from denoc_ros.kernels.vector import add, dot, load, scale, store
from denoc_ros.kernels.wrench import transmit_wrench


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
