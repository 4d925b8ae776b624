"""Derivatives of the wrench and modal forces of a link with component modes.

acc = a + al x p + w x (w x p + 2 B d') + B d'' + B' d' of a point p = p(d), with dB_j/dd_k =
Gamma_jk: d acc/dd_j = A B_j + sum_k Gamma_jk d''_k + 2 w x sum_k Gamma_jk d'_k,
A = al x + w x w x, and d acc/d d'_j = 2 w x B_j + 2 sum_k Gamma_jk d'_k.
"""

from denoc_ros.kernels.algebra.lanes import put_all, put_vector, spread, take
from denoc_ros.kernels.algebra.spatial import store_strided
from denoc_ros.kernels.algebra.vector import add, cross, load, scale, store, subtract
from denoc_ros.kernels.derivatives.derivative_rows import own_of
from denoc_ros.kernels.dynamics.component_modes import (
    bent,
    column_wrench,
    constants_of,
    first_mode,
    none,
    point_moments,
    product_sum,
    put_points,
    take_points,
    totals,
    work_of,
)
from denoc_ros.kernels.jit.compiled import short_inlined, short_shared
from denoc_ros.kernels.jit.handle import at
from denoc_ros.kernels.layout import derivative_layout as diff_
from denoc_ros.kernels.layout import layout as at_


@short_inlined
def move_points(topology, constants, work, i, scratch):
    """Write velocity and acceleration of body i's points; what moving modes alone take part.

    Body axes. FORCE, TORQUE, MOMENTUM and TURNING take the slip's share.
    """
    points = at(topology, i, at_.POINTS)
    o, d = at(topology, i, at_.WORK), at(topology, i, at_.DERIVED)
    w, al = load(work, o + at_.ANGULAR_VELOCITY), load(work, o + at_.ANGULAR_ACCELERATION)
    v, a = load(work, o + at_.VELOCITY), load(work, o + at_.ACCELERATION)
    e, _, _, _ = constants_of(topology, i)
    p, _, accelerated, slipping = work_of(topology, i)
    momentum, force, torque = none(), none(), none()
    x, y, z = none(), none(), none()  # sums of slip times p_x, p_y and p_z
    for k in range(0, points, diff_.LANES):
        one, place = take(constants, e + k), take_points(work, p + k, points)
        slip = take_points(work, slipping + k, points)
        up = add(take_points(work, accelerated + k, points), scale(2.0, cross(w, slip)))
        turning = cross(w, place)
        put_points(work, scratch + k, points, add(add(scale(one, v), turning), slip))
        acc = add(add(scale(one, a), cross(al, place)), add(cross(w, turning), up))
        put_points(work, accelerated + k, points, acc)
        momentum, force = add(momentum, scale(one, slip)), add(force, scale(one, up))
        torque = add(torque, cross(place, up))
        x, y, z = (
            add(x, scale(place[0], slip)),
            add(y, scale(place[1], slip)),
            add(z, scale(place[2], slip)),
        )
    store(work, d + diff_.MOMENTUM, totals(momentum))
    x, y, z = totals(x), totals(y), totals(z)
    outward = 2.0 * (x[0] + y[1] + z[2])
    for r in range(3):
        store(work, d + diff_.TURNING + 3 * r, (-2.0 * x[r], -2.0 * y[r], -2.0 * z[r]))
        work[d + diff_.TURNING + 4 * r] += outward
    store(work, o + at_.FORCE, totals(force))
    store(work, o + at_.TORQUE, totals(torque))


@short_inlined
def own_composite(topology, constants, work, i):
    """Write COMPOSITE of body i alone."""
    mass, moment, spin = point_moments(topology, constants, work, i)
    c = at(topology, i, at_.BODY_CONSTANTS) + at_.MASS
    k = at(topology, i, at_.WORK) + at_.COMPOSITE
    work[k] = constants[c] + mass
    store(work, k + 1, add(load(constants, c + 1), moment))
    store(work, k + 4, add(load(constants, c + 4), (spin[0], spin[1], spin[2])))
    store(work, k + 7, add(load(constants, c + 7), (spin[3], spin[4], spin[5])))


@short_inlined
def write_changes(topology, constants, work, qd, qdd, i, j, by):
    """Write d acc/dd_j and d acc/d d'_j of body i's points at offset by of work."""
    points, drawn = at(topology, i, at_.POINTS), at(topology, i, at_.BENT)
    m, first, width = at(topology, i, at_.MODES), first_mode(topology, i), 3 * points
    _, _, _, gamma = constants_of(topology, i)
    for k in range(0, width, 3 * diff_.LANES):
        bend, lift = none(), none()
        if k < drawn:
            bend, lift = bent(constants, gamma + k, drawn, m, j, qd, qdd, first)
        put_vector(work, by + k, diff_.LANES, lift)
        put_vector(work, by + width + k, diff_.LANES, bend)
    o = at(topology, i, at_.WORK)
    w, al = load(work, o + at_.ANGULAR_VELOCITY), load(work, o + at_.ANGULAR_ACCELERATION)
    _, columns, _, _ = work_of(topology, i)
    columns += width * j
    for k in range(0, points, diff_.LANES):
        column = take_points(work, columns + k, points)
        turned = cross(w, column)
        lift, bend = take_points(work, by + k, points), take_points(work, by + width + k, points)
        by_q = add(add(cross(al, column), cross(w, turned)), lift)
        by_q = add(by_q, scale(2.0, cross(w, bend)))
        put_points(work, by + k, points, by_q)
        put_points(work, by + width + k, points, scale(2.0, add(turned, bend)))


@short_inlined
def lever(work, a, b, points):
    """Return the sum over the points of the cross products of vectors at offsets a and b."""
    found = none()
    for k in range(0, points, diff_.LANES):
        u, v = take_points(work, a + k, points), take_points(work, b + k, points)
        found = add(found, cross(u, v))
    return totals(found)


@short_inlined
def curvature_force(topology, constants, work, i, j, k):
    """Return sum Gamma_jk . acc over body i's points, j >= k."""
    drawn = at(topology, i, at_.BENT)
    _, _, _, gamma = constants_of(topology, i)
    _, _, accelerated, _ = work_of(topology, i)
    pair = gamma + drawn * (j * (j + 1) // 2 + k)
    return product_sum(constants, pair, work, accelerated, drawn)


@short_shared
def component_derivatives(topology, constants, work, qd, qdd, i):
    """Write what stands at OWN and COMPOSITE of body i, and MOMENTUM and TURNING of its points.

    FORCE and TORQUE take what is due to motion along the modes. All in body axes about the body's
    origin, whose motion stands at WORK.
    """
    m, points = at(topology, i, at_.MODES), at(topology, i, at_.POINTS)
    width = 3 * points
    velocity = at(topology, 0, diff_.BEAM_SCRATCH)
    by = velocity + width
    move_points(topology, constants, work, i, velocity)
    own_composite(topology, constants, work, i)
    own, step, forces = own_of(topology, i)
    for k in range(own, forces + 3 * step * m, diff_.LANES):  # lanes beyond the last mode
        put_all(work, k, spread(0.0))
    e, _, _, _ = constants_of(topology, i)
    p, columns, accelerated, _ = work_of(topology, i)
    for j in range(m):
        column = columns + width * j
        write_changes(topology, constants, work, qd, qdd, i, j, by)
        share = column_wrench(constants, e, work, p, work, column, points)
        store_strided(work, own + step * diff_.BY_ACCELERATION + j, step, share)
        turned = lever(work, velocity, column, points)
        for k in range(3):
            work[own + step * (diff_.BY_TURNING + k) + j] = turned[k]
        force, torque = column_wrench(constants, e, work, p, work, by, points)
        torque = subtract(torque, lever(work, accelerated, column, points))
        store_strided(work, own + step * diff_.BY_POSITION + j, step, (force, torque))
        share = column_wrench(constants, e, work, p, work, by + width, points)
        store_strided(work, own + step * diff_.BY_RATE + j, step, share)
        for r in range(m):
            other = columns + width * r
            o = forces + step * r + j
            work[o] += product_sum(work, other, work, by, width)
            work[o + step * m] = product_sum(work, other, work, by + width, width)
            work[o + 2 * step * m] = product_sum(work, other, work, column, width)
        for r in range(j + 1):
            force = curvature_force(topology, constants, work, i, j, r)
            work[forces + step * r + j] += force
            if r < j:
                work[forces + step * j + r] += force
