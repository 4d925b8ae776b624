"""Outward pass of velocities and accelerations (dynamics.md: displacements, section, joint)."""

from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.layout import (
    ACCELERATION,
    ARM,
    AXIS,
    COEFFICIENTS,
    COLUMNS,
    COORDINATE,
    JOINT,
    MODES,
    MOTION,
    NT,
    NY,
    NZ,
    PARENT,
    PLACE,
    REAL,
    SECTION,
    SECTION_WORK,
    SPEED,
    SPIN_UP,
    TURN,
    VECTOR,
    VELOCITY,
    WORK,
)
from denoc_ros.kernels.vector import add, cross, dot, load, scale, store, unrotate


@inlined
def section_rates(ints, reals, qd, i):
    """Return phi' and the axial entry of B' d' of the section that carries row i."""
    p = at(ints, i, PARENT)
    ny = at(ints, p, NY)
    nz = at(ints, p, NZ)
    nt = at(ints, p, NT)
    d = at(ints, p, COORDINATE) + at(ints, p, JOINT)
    slope = at(ints, i, SECTION) + 1 + ny + nz
    h = slope + ny + nz + nt
    turn_y = 0.0
    turn_z = 0.0
    twist = 0.0
    shortening = 0.0
    for j in range(ny):
        x = qd[d + j]
        turn_y += reals[slope + j] * x
        for k in range(ny):
            shortening -= x * reals[h + ny * j + k] * qd[d + k]
    h += ny * ny
    for j in range(nz):
        x = qd[d + ny + j]
        turn_z += reals[slope + ny + j] * x
        for k in range(nz):
            shortening -= x * reals[h + nz * j + k] * qd[d + ny + k]
    for j in range(nt):
        twist += reals[slope + ny + nz + j] * qd[d + ny + nz + j]
    return (twist, -turn_z, turn_y), shortening


@inlined
def section_motion(ints, reals, work, qd, qdd, i, w, a, al):
    """Return angular velocity, acceleration and angular acceleration of a section.

    It carries row i; w, a, al are those of its beam's body frame.
    """
    p = at(ints, i, PARENT)
    o = at(ints, i, SECTION_WORK)
    d = at(ints, p, COORDINATE) + at(ints, p, JOINT)
    place = load(work, o + PLACE)
    phi = load(work, o + VECTOR)
    rate, shortening = section_rates(ints, reals, qd, i)
    slip = (0.0, 0.0, 0.0)  # B d'
    spin = (0.0, 0.0, 0.0)  # J Theta d'
    slip_up = (shortening, 0.0, 0.0)  # B d'' + B' d'
    k = o + COEFFICIENTS
    c = work[k + 1]
    r = dot(phi, rate)
    turned = cross(phi, rate)
    doubly = cross(phi, turned)
    spin_up = add(  # J Theta d'' + J' phi'
        add(scale(r * work[k + 2], turned), scale(r * work[k + 3], doubly)),
        scale(c, cross(rate, turned)),
    )
    k = o + COLUMNS
    for j in range(d, d + at(ints, p, MODES)):
        linear = load(work, k)
        angular = load(work, k + 3)
        slip = add(slip, scale(qd[j], linear))
        spin = add(spin, scale(qd[j], angular))
        slip_up = add(slip_up, scale(qdd[j], linear))
        spin_up = add(spin_up, scale(qdd[j], angular))
        k += 6
    carried = cross(w, place)
    a = add(add(a, cross(al, place)), slip_up)
    a = add(a, cross(w, add(carried, scale(2.0, slip))))
    al = add(add(al, spin_up), cross(w, spin))
    return add(w, spin), a, al


@inlined
def move_body(ints, reals, work, qd, qdd, i):
    """Write angular velocity and acceleration of body i, joint included, in body axes."""
    o = at(ints, i, WORK)
    u = at(ints, at(ints, i, PARENT), WORK)
    w = load(work, u + SPEED)
    a = load(work, u + ACCELERATION)
    al = load(work, u + SPIN_UP)
    if at(ints, i, SECTION) > 0:
        w, a, al = section_motion(ints, reals, work, qd, qdd, i, w, a, al)
    arm = load(work, o + ARM)
    a = unrotate(work, o, add(a, add(cross(al, arm), cross(w, cross(w, arm)))))
    w = unrotate(work, o, w)
    al = unrotate(work, o, al)
    j = at(ints, i, COORDINATE)
    if at(ints, i, MOTION) == TURN:
        rate = qd[j]
        al = (al[0] + w[1] * rate, al[1] - w[0] * rate, al[2] + qdd[j])
        w = (w[0], w[1], w[2] + rate)
    elif at(ints, i, JOINT) == 1:
        c = at(ints, i, REAL) + AXIS
        slide = load(reals, c)
        turn = load(reals, c + 3)
        slip = scale(qd[j], slide)
        spin = scale(qd[j], turn)
        a = add(a, add(scale(qdd[j], slide), add(scale(2.0, cross(w, slip)), cross(spin, slip))))
        al = add(al, add(scale(qdd[j], turn), cross(w, spin)))
        w = add(w, spin)
    store(work, o + SPEED, w)
    store(work, o + ACCELERATION, a)
    store(work, o + SPIN_UP, al)


@inlined
def linear_velocity(ints, reals, work, qd, i):
    """Write the velocity of body i's origin; its carrier's must stand there already."""
    o = at(ints, i, WORK)
    p = at(ints, i, PARENT)
    u = at(ints, p, WORK)
    v = load(work, u + VELOCITY)
    w = load(work, u + SPEED)
    if at(ints, i, SECTION) > 0:
        k = at(ints, i, SECTION_WORK)
        v = add(v, cross(w, load(work, k + PLACE)))
        k += COLUMNS
        d = at(ints, p, COORDINATE) + at(ints, p, JOINT)
        for j in range(d, d + at(ints, p, MODES)):
            v = add(v, scale(qd[j], load(work, k)))
            w = add(w, scale(qd[j], load(work, k + 3)))
            k += 6
    v = unrotate(work, o, add(v, cross(w, load(work, o + ARM))))
    if at(ints, i, JOINT) == 1:
        slide = load(reals, at(ints, i, REAL) + AXIS)
        v = add(v, scale(qd[at(ints, i, COORDINATE)], slide))
    store(work, o + VELOCITY, v)
