"""The wrench and modal forces a body needs for its own motion, and their way inward."""

from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.layout import (
    ACCELERATION,
    ARM,
    BEAM,
    BEAM_WORK,
    COLUMNS,
    COORDINATE,
    FORCE,
    JOINT,
    MASS,
    MODES,
    MOMENT,
    NT,
    NY,
    NZ,
    PARENT,
    PLACE,
    POINTS,
    REAL,
    SECTION,
    SECTION_WORK,
    SPEED,
    SPIN,
    SPIN_UP,
    TORQUE,
    WORK,
)
from denoc_ros.kernels.vector import (
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


@inlined
def rigid_wrench(ints, reals, work, i):
    """Write the wrench of the rigid part of body i about the body origin."""
    c = at(ints, i, REAL)
    o = at(ints, i, WORK)
    w = load(work, o + SPEED)
    a = load(work, o + ACCELERATION)
    al = load(work, o + SPIN_UP)
    moment = load(reals, c + MOMENT)
    force = add(scale(reals[c + MASS], a), add(cross(al, moment), cross(w, cross(w, moment))))
    torque = add(
        add(cross(moment, a), symmetric(reals, c + SPIN, al)),
        cross(w, symmetric(reals, c + SPIN, w)),
    )
    store(work, o + FORCE, force)
    store(work, o + TORQUE, torque)


@inlined
def bending_wrench(ints, reals, work, qd, qdd, i):
    """Add the wrench of body i's beam and write its modal forces: int [1; p x; B^T] acc."""
    ny = at(ints, i, NY)
    nz = at(ints, i, NZ)
    nt = at(ints, i, NT)
    o = at(ints, i, WORK)
    d = at(ints, i, COORDINATE) + at(ints, i, JOINT)
    w = load(work, o + SPEED)
    a = load(work, o + ACCELERATION)
    al = load(work, o + SPIN_UP)
    force = (0.0, 0.0, 0.0)
    torque = (0.0, 0.0, 0.0)
    modal = at(ints, i, BEAM_WORK)
    for j in range(modal, modal + ny + nz):
        work[j] = 0.0
    c = at(ints, i, BEAM) + 1 + nt + nt * nt
    k = modal + at(ints, i, MODES)
    for _ in range(at(ints, i, POINTS)):
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
                bend += reals[h + ny * j + n] * qd[d + n]
            sx -= hd * rate
            sy += reals[s + j] * rate
            ax -= hd * qdd[d + j] + bend * rate
            ay += reals[s + j] * qdd[d + j]
        s += ny
        h += ny * ny
        for j in range(nz):
            rate = qd[d + ny + j]
            hd = work[k + 3 + ny + j]
            bend = 0.0
            for n in range(nz):
                bend += reals[h + nz * j + n] * qd[d + ny + n]
            sx -= hd * rate
            sz += reals[s + j] * rate
            ax -= hd * qdd[d + ny + j] + bend * rate
            az += reals[s + j] * qdd[d + ny + j]
        acc = add(add(scale(reals[c], a), cross(al, p)), (ax, ay, az))
        acc = add(acc, cross(w, add(cross(w, p), (2.0 * sx, 2.0 * sy, 2.0 * sz))))
        force = add(force, scale(reals[c], acc))
        torque = add(torque, cross(p, acc))
        s = c + 2
        for j in range(ny):
            work[modal + j] += reals[s + j] * acc[1] - work[k + 3 + j] * acc[0]
        for j in range(ny, ny + nz):
            work[modal + j] += reals[s + j] * acc[2] - work[k + 3 + j] * acc[0]
        c = h + nz * nz
        k += 3 + ny + nz
    accumulate(work, o + FORCE, force)
    accumulate(work, o + TORQUE, torque)


@inlined
def torsion_wrench(ints, reals, work, qd, qdd, i):
    """Add the torque of body i's twisting sections and write its torsional modal forces."""
    nt = at(ints, i, NT)
    o = at(ints, i, WORK)
    d = at(ints, i, COORDINATE) + at(ints, i, JOINT) + at(ints, i, NY) + at(ints, i, NZ)
    b = at(ints, i, BEAM)
    modal = at(ints, i, BEAM_WORK) + at(ints, i, NY) + at(ints, i, NZ)
    w = load(work, o + SPEED)
    spin_up = work[o + SPIN_UP]
    momentum = reals[b] * w[0]
    torque = reals[b] * spin_up
    for j in range(nt):
        momentum += reals[b + 1 + j] * qd[d + j]
        torque += reals[b + 1 + j] * qdd[d + j]
        force = reals[b + 1 + j] * spin_up
        for k in range(nt):
            force += reals[b + 1 + nt + nt * j + k] * qdd[d + k]
        work[modal + j] = force
    accumulate(work, o + TORQUE, (torque, w[2] * momentum, -w[1] * momentum))


@inlined
def body_wrench(ints, reals, work, qd, qdd, i):
    """Write the wrench and the modal forces that body i needs for its motion (no elasticity)."""
    rigid_wrench(ints, reals, work, i)
    if at(ints, i, POINTS) > 0:
        bending_wrench(ints, reals, work, qd, qdd, i)
    if at(ints, i, NT) > 0:
        torsion_wrench(ints, reals, work, qd, qdd, i)


@inlined
def transmit_wrench(ints, work, i, force, torque):
    """Add a wrench on row i (its axes, about its origin) to its carrier and that one's modes."""
    p = at(ints, i, PARENT)
    if p == 0:
        return
    o = at(ints, i, WORK)
    u = at(ints, p, WORK)
    f = rotate(work, o, force)
    n = add(rotate(work, o, torque), cross(load(work, o + ARM), f))
    if at(ints, i, SECTION) > 0:
        k = at(ints, i, SECTION_WORK)
        modal = at(ints, p, BEAM_WORK)
        columns = k + COLUMNS
        for j in range(at(ints, p, MODES)):
            work[modal + j] += dot(load(work, columns), f) + dot(load(work, columns + 3), n)
            columns += 6
        n = add(n, cross(load(work, k + PLACE), f))
    accumulate(work, u + FORCE, f)
    accumulate(work, u + TORQUE, n)
