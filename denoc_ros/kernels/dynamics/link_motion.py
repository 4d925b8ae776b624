"""Outward pass of velocities and accelerations (dynamics.md: displacements, section, joint)."""

from denoc_ros.kernels.algebra.vector import add, cross, dot, load, scale, store, unrotate
from denoc_ros.kernels.dynamics.component_modes import component_section_rates
from denoc_ros.kernels.jit.compiled import inlined, shared
from denoc_ros.kernels.jit.handle import at
from denoc_ros.kernels.layout import layout as at_


@inlined
def beam_section_rates(topology, constants, qd, i):
    """Return phi' and B' d' of the section of a beam that carries row i."""
    p = at(topology, i, at_.PARENT)
    ny = at(topology, p, at_.NY)
    nz = at(topology, p, at_.NZ)
    nt = at(topology, p, at_.NT)
    d = at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT)
    slope = at(topology, i, at_.SECTION) + 1 + ny + nz
    h = slope + ny + nz + nt
    turn_y = 0.0
    turn_z = 0.0
    twist = 0.0
    shortening = 0.0
    for j in range(ny):
        x = qd[d + j]
        turn_y += constants[slope + j] * x
        for k in range(ny):
            shortening -= x * constants[h + ny * j + k] * qd[d + k]
    h += ny * ny
    for j in range(nz):
        x = qd[d + ny + j]
        turn_z += constants[slope + ny + j] * x
        for k in range(nz):
            shortening -= x * constants[h + nz * j + k] * qd[d + ny + k]
    for j in range(nt):
        twist += constants[slope + ny + nz + j] * qd[d + ny + nz + j]
    return (twist, -turn_z, turn_y), (shortening, 0.0, 0.0)


@inlined
def section_rates(topology, constants, qd, i):
    """Return phi' and B' d' of the section that carries row i."""
    if at(topology, at(topology, i, at_.PARENT), at_.COMPONENTS) > 0:
        return component_section_rates(topology, constants, qd, i)
    return beam_section_rates(topology, constants, qd, i)


@inlined
def section_motion(topology, constants, work, qd, qdd, i, w, a, al):
    """Return angular velocity, acceleration and angular acceleration of a section.

    It carries row i; w, a, al are those of its carrier's body frame.
    """
    rates = section_rates(topology, constants, qd, i)
    return moved_section(topology, work, qd, qdd, i, (w, a, al), rates)


@inlined
def moved_section(topology, work, qd, qdd, i, carrier, rates):
    """Return a section's motion from its carrier's and its phi' and B' d'."""
    w, a, al = carrier
    p = at(topology, i, at_.PARENT)
    o = at(topology, i, at_.SECTION_WORK)
    d = at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT)
    place = load(work, o + at_.SECTION_POSITION)
    phi = load(work, o + at_.ROTATION_VECTOR)
    rate, slip_up = rates  # B' d', to which B d'' comes
    slip = (0.0, 0.0, 0.0)  # B d'
    spin = (0.0, 0.0, 0.0)  # J Theta d'
    k = o + at_.COEFFICIENTS
    c = work[k + 1]
    r = dot(phi, rate)
    turned = cross(phi, rate)
    doubly = cross(phi, turned)
    spin_up = add(  # J Theta d'' + J' phi'
        add(scale(r * work[k + 2], turned), scale(r * work[k + 3], doubly)),
        scale(c, cross(rate, turned)),
    )
    k = o + at_.COLUMNS
    for j in range(d, d + at(topology, p, at_.MODES)):
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
def carrier_motion(topology, work, i):
    """Return angular velocity, acceleration and angular acceleration of row i's carrier."""
    u = at(topology, at(topology, i, at_.PARENT), at_.WORK)
    return (
        load(work, u + at_.ANGULAR_VELOCITY),
        load(work, u + at_.ACCELERATION),
        load(work, u + at_.ANGULAR_ACCELERATION),
    )


@inlined
def move_joint(topology, constants, work, qd, qdd, i, w, a, al):
    """Write the motion of body i, from that of the section or body that carries it."""
    o = at(topology, i, at_.WORK)
    arm = load(work, o + at_.ARM)
    a = unrotate(work, o, add(a, add(cross(al, arm), cross(w, cross(w, arm)))))
    w = unrotate(work, o, w)
    al = unrotate(work, o, al)
    j = at(topology, i, at_.COORDINATE)
    if at(topology, i, at_.MOTION) == at_.REVOLUTE_Z:
        rate = qd[j]
        al = (al[0] + w[1] * rate, al[1] - w[0] * rate, al[2] + qdd[j])
        w = (w[0], w[1], w[2] + rate)
    elif at(topology, i, at_.JOINT) == 1:
        c = at(topology, i, at_.BODY_CONSTANTS) + at_.AXIS
        slide = load(constants, c)
        turn = load(constants, c + 3)
        slip = scale(qd[j], slide)
        spin = scale(qd[j], turn)
        a = add(a, add(scale(qdd[j], slide), add(scale(2.0, cross(w, slip)), cross(spin, slip))))
        al = add(al, add(scale(qdd[j], turn), cross(w, spin)))
        w = add(w, spin)
    store(work, o + at_.ANGULAR_VELOCITY, w)
    store(work, o + at_.ACCELERATION, a)
    store(work, o + at_.ANGULAR_ACCELERATION, al)


@shared
def move_on_components(topology, constants, work, qd, qdd, i):
    """Do what :func:`move_body` does for a body on component modes.

    Called, not inlined: beams keep the registers.
    """
    rates = component_section_rates(topology, constants, qd, i)
    carrier = carrier_motion(topology, work, i)
    w, a, al = moved_section(topology, work, qd, qdd, i, carrier, rates)
    move_joint(topology, constants, work, qd, qdd, i, w, a, al)


@inlined
def move_body(topology, constants, work, qd, qdd, i):
    """Write angular velocity and acceleration of body i, joint included, in body axes."""
    w, a, al = carrier_motion(topology, work, i)
    if at(topology, i, at_.SECTION) > 0:
        if at(topology, at(topology, i, at_.PARENT), at_.COMPONENTS) > 0:
            move_on_components(topology, constants, work, qd, qdd, i)
            return
        rates = beam_section_rates(topology, constants, qd, i)
        w, a, al = moved_section(topology, work, qd, qdd, i, (w, a, al), rates)
    move_joint(topology, constants, work, qd, qdd, i, w, a, al)


@inlined
def linear_velocity(topology, constants, work, qd, i):
    """Write the velocity of body i's origin; its carrier's must stand there already."""
    o = at(topology, i, at_.WORK)
    p = at(topology, i, at_.PARENT)
    u = at(topology, p, at_.WORK)
    v = load(work, u + at_.VELOCITY)
    w = load(work, u + at_.ANGULAR_VELOCITY)
    if at(topology, i, at_.SECTION) > 0:
        k = at(topology, i, at_.SECTION_WORK)
        v = add(v, cross(w, load(work, k + at_.SECTION_POSITION)))
        k += at_.COLUMNS
        d = at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT)
        for j in range(d, d + at(topology, p, at_.MODES)):
            v = add(v, scale(qd[j], load(work, k)))
            w = add(w, scale(qd[j], load(work, k + 3)))
            k += 6
    v = unrotate(work, o, add(v, cross(w, load(work, o + at_.ARM))))
    if at(topology, i, at_.JOINT) == 1:
        slide = load(constants, at(topology, i, at_.BODY_CONSTANTS) + at_.AXIS)
        v = add(v, scale(qd[at(topology, i, at_.COORDINATE)], slide))
    store(work, o + at_.VELOCITY, v)
