"""The wrench and modal forces a body needs for its own motion, and their way inward."""

from denoc_ros.kernels.algebra.vector import (
    accumulate,
    add,
    cross,
    dot,
    load,
    rotate,
    scale,
    store,
    symmetric,
)
from denoc_ros.kernels.dynamics.component_modes import component_wrench
from denoc_ros.kernels.jit.compiled import inlined
from denoc_ros.kernels.jit.handle import at
from denoc_ros.kernels.layout import layout as at_


@inlined
def rigid_wrench(topology, constants, work, i):
    """Write the wrench of the rigid part of body i about the body origin."""
    c = at(topology, i, at_.BODY_CONSTANTS)
    o = at(topology, i, at_.WORK)
    w = load(work, o + at_.ANGULAR_VELOCITY)
    a = load(work, o + at_.ACCELERATION)
    al = load(work, o + at_.ANGULAR_ACCELERATION)
    moment = load(constants, c + at_.FIRST_MOMENT)
    force = add(
        scale(constants[c + at_.MASS], a), add(cross(al, moment), cross(w, cross(w, moment)))
    )
    torque = add(
        add(cross(moment, a), symmetric(constants, c + at_.ROTATIONAL_INERTIA, al)),
        cross(w, symmetric(constants, c + at_.ROTATIONAL_INERTIA, w)),
    )
    store(work, o + at_.FORCE, force)
    store(work, o + at_.TORQUE, torque)


@inlined
def bending_wrench(topology, constants, work, qd, qdd, i):
    """Add the wrench of body i's beam and write its modal forces: int [1; p x; B^T] acc."""
    ny = at(topology, i, at_.NY)
    nz = at(topology, i, at_.NZ)
    nt = at(topology, i, at_.NT)
    o = at(topology, i, at_.WORK)
    d = at(topology, i, at_.COORDINATE) + at(topology, i, at_.JOINT)
    w = load(work, o + at_.ANGULAR_VELOCITY)
    a = load(work, o + at_.ACCELERATION)
    al = load(work, o + at_.ANGULAR_ACCELERATION)
    force = (0.0, 0.0, 0.0)
    torque = (0.0, 0.0, 0.0)
    modal = at(topology, i, at_.BEAM_WORK)
    for j in range(modal, modal + ny + nz):
        work[j] = 0.0
    c = at(topology, i, at_.BEAM) + 1 + nt + nt * nt
    k = modal + at(topology, i, at_.MODES)
    for _ in range(at(topology, i, at_.POINTS)):
        p = load(work, k)
        sx = 0.0  # B d'
        sy = 0.0
        sz = 0.0
        ax = 0.0  # B d'' + B' d'
        ay = 0.0
        az = 0.0
        s = c + 2
        h = s + ny + nz
        for j in range(ny):
            rate = qd[d + j]
            hd = work[k + 3 + j]
            bend = 0.0
            for n in range(ny):
                bend += constants[h + ny * j + n] * qd[d + n]
            sx -= hd * rate
            sy += constants[s + j] * rate
            ax -= hd * qdd[d + j] + bend * rate
            ay += constants[s + j] * qdd[d + j]
        s += ny
        h += ny * ny
        for j in range(nz):
            rate = qd[d + ny + j]
            hd = work[k + 3 + ny + j]
            bend = 0.0
            for n in range(nz):
                bend += constants[h + nz * j + n] * qd[d + ny + n]
            sx -= hd * rate
            sz += constants[s + j] * rate
            ax -= hd * qdd[d + ny + j] + bend * rate
            az += constants[s + j] * qdd[d + ny + j]
        acc = add(add(scale(constants[c], a), cross(al, p)), (ax, ay, az))
        acc = add(acc, cross(w, add(cross(w, p), (2.0 * sx, 2.0 * sy, 2.0 * sz))))
        force = add(force, scale(constants[c], acc))
        torque = add(torque, cross(p, acc))
        s = c + 2
        for j in range(ny):
            work[modal + j] += constants[s + j] * acc[1] - work[k + 3 + j] * acc[0]
        for j in range(ny, ny + nz):
            work[modal + j] += constants[s + j] * acc[2] - work[k + 3 + j] * acc[0]
        c = h + nz * nz
        k += 3 + ny + nz
    accumulate(work, o + at_.FORCE, force)
    accumulate(work, o + at_.TORQUE, torque)


@inlined
def torsion_wrench(topology, constants, work, qd, qdd, i):
    """Add the torque of body i's twisting sections and write its torsional modal forces."""
    nt = at(topology, i, at_.NT)
    o = at(topology, i, at_.WORK)
    d = (
        at(topology, i, at_.COORDINATE)
        + at(topology, i, at_.JOINT)
        + at(topology, i, at_.NY)
        + at(topology, i, at_.NZ)
    )
    b = at(topology, i, at_.BEAM)
    modal = at(topology, i, at_.BEAM_WORK) + at(topology, i, at_.NY) + at(topology, i, at_.NZ)
    w = load(work, o + at_.ANGULAR_VELOCITY)
    spin_up = work[o + at_.ANGULAR_ACCELERATION]
    momentum = constants[b] * w[0]
    torque = constants[b] * spin_up
    for j in range(nt):
        momentum += constants[b + 1 + j] * qd[d + j]
        torque += constants[b + 1 + j] * qdd[d + j]
        force = constants[b + 1 + j] * spin_up
        for k in range(nt):
            force += constants[b + 1 + nt + nt * j + k] * qdd[d + k]
        work[modal + j] = force
    accumulate(work, o + at_.TORQUE, (torque, w[2] * momentum, -w[1] * momentum))


@inlined
def body_wrench(topology, constants, work, q, qd, qdd, i):
    """Write the wrench and the modal forces that body i needs for its motion (no elasticity).

    A beam's points must be placed before.
    """
    rigid_wrench(topology, constants, work, i)
    if at(topology, i, at_.POINTS) > 0:
        if at(topology, i, at_.COMPONENTS) > 0:
            component_wrench(topology, constants, work, q, qd, qdd, i)
        else:
            bending_wrench(topology, constants, work, qd, qdd, i)
    if at(topology, i, at_.NT) > 0:
        torsion_wrench(topology, constants, work, qd, qdd, i)


@inlined
def transmit_wrench(topology, work, i, force, torque):
    """Add a wrench on row i (its axes, about its origin) to its carrier and that one's modes."""
    p = at(topology, i, at_.PARENT)
    if p == 0:
        return
    o = at(topology, i, at_.WORK)
    u = at(topology, p, at_.WORK)
    f = rotate(work, o, force)
    n = add(rotate(work, o, torque), cross(load(work, o + at_.ARM), f))
    if at(topology, i, at_.SECTION) > 0:
        k = at(topology, i, at_.SECTION_WORK)
        modal = at(topology, p, at_.BEAM_WORK)
        columns = k + at_.COLUMNS
        for j in range(at(topology, p, at_.MODES)):
            work[modal + j] += dot(load(work, columns), f) + dot(load(work, columns + 3), n)
            columns += 6
        n = add(n, cross(load(work, k + at_.SECTION_POSITION), f))
    accumulate(work, u + at_.FORCE, f)
    accumulate(work, u + at_.TORQUE, n)
