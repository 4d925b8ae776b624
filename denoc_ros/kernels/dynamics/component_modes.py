"""Links with component modes: points, wrench, inertia and sections of three-component columns.

A point stands at p = r + 1/2 sum_j (Phi_j + B_j) d_j with the columns B_j = Phi_j + sum_k Gamma_jk
d_k, so that dB_j/dd_k = Gamma_jk. The points are the rows of a factor of the functions' Gram
matrix: e is the value of 1 at a point, r those of x, y and z. Component by component, the points'
numbers stand side by side in whole lanes; only the first BENT of them have a Gamma.
"""

from denoc_ros.kernels.algebra.lanes import (
    plus_product,
    put_all,
    put_vector,
    spread,
    take,
    take_vector,
    total,
)
from denoc_ros.kernels.algebra.rotation import exponential_coefficients, square_plus
from denoc_ros.kernels.algebra.vector import (
    accumulate,
    add,
    cross,
    dot,
    load,
    rotate,
    scale,
    store,
)
from denoc_ros.kernels.jit.compiled import short_inlined, short_shared
from denoc_ros.kernels.jit.handle import at
from denoc_ros.kernels.layout import layout as at_
from denoc_ros.kernels.layout.derivative_layout import LANES


@short_inlined
def first_mode(topology, i):
    """Return the index of body i's first amplitude."""
    return at(topology, i, at_.COORDINATE) + at(topology, i, at_.JOINT)


@short_inlined
def constants_of(topology, i):
    """Return the offsets of e, r, Phi and Gamma of body i's points in constants."""
    e = at(topology, i, at_.BEAM)
    r = e + at(topology, i, at_.POINTS)
    phi = r + 3 * at(topology, i, at_.POINTS)
    return e, r, phi, phi + 3 * at(topology, i, at_.POINTS) * at(topology, i, at_.MODES)


@short_inlined
def none():
    """Return a vector of lanes of zeros."""
    zero = spread(0.0)
    return zero, zero, zero


@short_inlined
def work_of(topology, i):
    """Return the offsets of p, B, the acceleration and the slip of body i's points in work."""
    width = 3 * at(topology, i, at_.POINTS)
    p = at(topology, i, at_.BEAM_WORK) + at(topology, i, at_.MODES)
    columns = p + width
    accelerated = columns + width * at(topology, i, at_.MODES)
    return p, columns, accelerated, accelerated + width


@short_inlined
def bent(constants, gamma, size, m, j, x, y, first):
    """Return sum_k Gamma_jk x_k and sum_k Gamma_jk y_k of some of the points' numbers.

    Gamma is symmetric: the pairs j >= k stand one after the other, each of so many numbers.
    """
    a, b = none(), none()
    o = gamma + size * (j * (j + 1) // 2)
    for k in range(m):
        curve = take_vector(constants, o, LANES)
        a, b = add(a, scale(x[first + k], curve)), add(b, scale(y[first + k], curve))
        o += size if k < j else size * (k + 1)
    return a, b


@short_inlined
def product_sum(a, o, b, p, size):
    """Return the sum of the products of so many numbers at offset o of a and p of b."""
    found = spread(0.0)
    for k in range(0, size, LANES):
        found = plus_product(found, take(a, o + k), take(b, p + k))
    return total(found)


@short_inlined
def set_points(topology, constants, work, q, qd, qdd, i, moving):
    """Place the points of body i and their columns B; if moving, write B d' and B d'' + B' d'."""
    m, width = at(topology, i, at_.MODES), 3 * at(topology, i, at_.POINTS)
    drawn, first = at(topology, i, at_.BENT), first_mode(topology, i)
    _, r, phi, gamma = constants_of(topology, i)
    p, columns, accelerated, slipping = work_of(topology, i)
    for o in range(0, width, 3 * LANES):
        place, slip, up = take_vector(constants, r + o, LANES), none(), none()
        for j in range(m):
            column, bend = take_vector(constants, phi + width * j + o, LANES), none()
            half = column
            if o < drawn:
                more, bend = bent(constants, gamma + o, drawn, m, j, q, qd, first)
                half, column = add(column, scale(0.5, more)), add(column, more)
            put_vector(work, columns + width * j + o, LANES, column)
            place = add(place, scale(q[first + j], half))
            slip = add(slip, scale(qd[first + j], column))
            up = add(up, add(scale(qdd[first + j], column), scale(qd[first + j], bend)))
        put_vector(work, p + o, LANES, place)
        if moving:
            put_vector(work, slipping + o, LANES, slip)
            put_vector(work, accelerated + o, LANES, up)


@short_shared
def place_components(topology, constants, work, q, i):
    """Place the points of body i and their columns B."""
    set_points(topology, constants, work, q, q, q, i, False)


@short_shared
def move_components(topology, constants, work, q, qd, qdd, i):
    """Place the points of body i, and write what the modes alone move them."""
    set_points(topology, constants, work, q, qd, qdd, i, True)


@short_inlined
def take_points(a, o, points):
    """Return a vector of some points, whose components stand so many points apart."""
    return take(a, o), take(a, o + points), take(a, o + 2 * points)


@short_inlined
def put_points(a, o, points, v):
    """Write such a vector."""
    put_all(a, o, v[0])
    put_all(a, o + points, v[1])
    put_all(a, o + 2 * points, v[2])


@short_inlined
def totals(v):
    """Return the sums over the lanes of a vector."""
    return total(v[0]), total(v[1]), total(v[2])


@short_shared
def component_wrench(topology, constants, work, q, qd, qdd, i):
    """Place the points of body i, add their wrench and write modal forces: sum [1; p x; B^T] acc.

    In one call, so that beams keep the registers.
    """
    set_points(topology, constants, work, q, qd, qdd, i, True)
    m, points = at(topology, i, at_.MODES), at(topology, i, at_.POINTS)
    o = at(topology, i, at_.WORK)
    w = load(work, o + at_.ANGULAR_VELOCITY)
    a = load(work, o + at_.ACCELERATION)
    al = load(work, o + at_.ANGULAR_ACCELERATION)
    e, _, _, _ = constants_of(topology, i)
    p, columns, accelerated, slipping = work_of(topology, i)
    force, torque = none(), none()
    for k in range(0, points, LANES):
        one, place = take(constants, e + k), take_points(work, p + k, points)
        slip = take_points(work, slipping + k, points)
        up = take_points(work, accelerated + k, points)
        acc = add(add(scale(one, a), cross(al, place)), up)
        acc = add(acc, cross(w, add(cross(w, place), scale(2.0, slip))))
        put_points(work, accelerated + k, points, acc)
        force = add(force, scale(one, acc))
        torque = add(torque, cross(place, acc))
    accumulate(work, o + at_.FORCE, totals(force))
    accumulate(work, o + at_.TORQUE, totals(torque))
    for j in range(m):
        work[at(topology, i, at_.BEAM_WORK) + j] = product_sum(
            work, columns + 3 * points * j, work, accelerated, 3 * points
        )


@short_inlined
def point_moments(topology, constants, work, i):
    """Return mass, first moment and rotational inertia (6) of body i's points."""
    points = at(topology, i, at_.POINTS)
    e, _, _, _ = constants_of(topology, i)
    p, _, _, _ = work_of(topology, i)
    y, z = p + points, p + 2 * points
    mass = product_sum(constants, e, constants, e, points)
    moment = (
        product_sum(constants, e, work, p, points),
        product_sum(constants, e, work, y, points),
        product_sum(constants, e, work, z, points),
    )
    xx = product_sum(work, p, work, p, points)
    yy = product_sum(work, y, work, y, points)
    zz = product_sum(work, z, work, z, points)
    xy = product_sum(work, p, work, y, points)
    xz = product_sum(work, p, work, z, points)
    yz = product_sum(work, y, work, z, points)
    return mass, moment, (yy + zz, -xy, -xz, xx + zz, -yz, xx + yy)


@short_inlined
def column_wrench(constants, e, a, p, b, column, points):
    """Return sum [1; p x] v over the points of a vector v at offset column of b; p is in a."""
    force, torque = none(), none()
    for k in range(0, points, LANES):
        v = take_points(b, column + k, points)
        force = add(force, scale(take(constants, e + k), v))
        torque = add(torque, cross(take_points(a, p + k, points), v))
    return totals(force), totals(torque)


@short_shared
def component_inertia(topology, constants, work, i):
    """Add sum C^T C with C = [1, -p x, B] of body i's points to its inertia."""
    m, points = at(topology, i, at_.MODES), at(topology, i, at_.POINTS)
    size, width = 6 + m, 3 * points
    o = at(topology, i, at_.INERTIA_WORK)
    e, _, _, _ = constants_of(topology, i)
    p, columns, _, _ = work_of(topology, i)
    mass, moment, spin = point_moments(topology, constants, work, i)
    for n in range(3):
        work[o + (size + 1) * n] += mass
    x, y, z = moment
    work[o + 4] += z
    work[o + 5] -= y
    work[o + size + 3] -= z
    work[o + size + 5] += x
    work[o + 2 * size + 3] += y
    work[o + 2 * size + 4] -= x
    k = o + 3 * size + 3
    accumulate(work, k, (spin[0], spin[1], spin[2]))
    work[k + size + 1] += spin[3]
    work[k + size + 2] += spin[4]
    work[k + 2 * size + 2] += spin[5]
    for j in range(m):
        column = columns + width * j
        force, torque = column_wrench(constants, e, work, p, work, column, points)
        for n in range(3):
            work[o + size * n + 6 + j] += force[n]
            work[o + size * (3 + n) + 6 + j] += torque[n]
        for n in range(j + 1):
            both = product_sum(work, columns + width * n, work, column, width)
            work[o + (6 + n) * size + 6 + j] += both


# sections: r (3), Phi (3 m), Theta (3 m), Gamma (3 m m), mode by mode


@short_inlined
def section_turn(topology, constants, i, j):
    """Return the turn Theta_j at row i's section of mode j of its carrier."""
    m = at(topology, at(topology, i, at_.PARENT), at_.MODES)
    return load(constants, at(topology, i, at_.SECTION) + 3 + 3 * m + 3 * j)


@short_inlined
def section_bend(topology, constants, i, j, x):
    """Return sum_k Gamma_jk x_k at row i's section, x in order of all coordinates."""
    p = at(topology, i, at_.PARENT)
    m, first = at(topology, p, at_.MODES), first_mode(topology, p)
    gamma = at(topology, i, at_.SECTION) + 3 + 6 * m + 3 * m * j
    found = (0.0, 0.0, 0.0)
    for k in range(m):
        found = add(found, scale(x[first + k], load(constants, gamma + 3 * k)))
    return found


@short_shared
def component_section_rates(topology, constants, qd, i):
    """Return phi' and B' d' of the section that carries row i."""
    p = at(topology, i, at_.PARENT)
    first = first_mode(topology, p)
    rate, up = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for j in range(at(topology, p, at_.MODES)):
        rate = add(rate, scale(qd[first + j], section_turn(topology, constants, i, j)))
        up = add(up, scale(qd[first + j], section_bend(topology, constants, i, j, qd)))
    return rate, up


@short_shared
def place_component_section(topology, constants, work, q, i):
    """Place the section that carries row i: position, rotation and the columns [B; J Theta]."""
    p = at(topology, i, at_.PARENT)
    m, first = at(topology, p, at_.MODES), first_mode(topology, p)
    c, o = at(topology, i, at_.SECTION), at(topology, i, at_.SECTION_WORK)
    place, phi = load(constants, c), (0.0, 0.0, 0.0)
    for j in range(m):
        column, d = load(constants, c + 3 + 3 * j), q[first + j]
        more = section_bend(topology, constants, i, j, q)
        place = add(place, scale(d, add(column, scale(0.5, more))))
        phi = add(phi, scale(d, section_turn(topology, constants, i, j)))
        store(work, o + at_.COLUMNS + 6 * j, add(column, more))
    a, b, e, db, de = exponential_coefficients(dot(phi, phi))
    store(work, o + at_.SECTION_POSITION, place)
    store(work, o + at_.ROTATION_VECTOR, phi)
    k = o + at_.COEFFICIENTS
    work[k], work[k + 1], work[k + 2], work[k + 3] = b, e, db, de
    turn = o + at_.SECTION_ROTATION
    square_plus(b, e, phi, work, turn)
    for j in range(m):
        theta = section_turn(topology, constants, i, j)
        store(work, o + at_.COLUMNS + 6 * j + 3, rotate(work, turn, theta))
    square_plus(a, b, phi, work, turn)
