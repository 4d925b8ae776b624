"""Columns of a beam section's twist by its amplitudes, and their time derivatives.

With the left Jacobian J = 1 + b K + c K^2 of the section's rotation vector phi, K = phi x, the
angular column of a mode of slope s about axis e is J s e; K^2 = phi phi^T - |phi|^2.
"""

from denoc_ros.kernels.algebra.rotation import SERIES_DB, SERIES_DC, six_terms
from denoc_ros.kernels.algebra.spatial import (
    pair,
    scale_pair,
    store_pair,
    sum_pair,
)
from denoc_ros.kernels.algebra.vector import add, cross, dot, load, rotate, scale, store, subtract
from denoc_ros.kernels.dynamics.component_modes import section_bend, section_turn
from denoc_ros.kernels.dynamics.link_motion import section_rates
from denoc_ros.kernels.jit.compiled import short_inlined, short_shared
from denoc_ros.kernels.jit.handle import at
from denoc_ros.kernels.layout import derivative_layout as diff_
from denoc_ros.kernels.layout import layout as at_

# Taylor series in |phi|^2 of the rates per phi . phi' of what COEFFICIENTS has of b and c
SERIES_DDB = tuple(2 * (k + 1) * SERIES_DB[k + 1] for k in range(5)) + (0.0,)
SERIES_DDC = tuple(2 * (k + 1) * SERIES_DC[k + 1] for k in range(5)) + (0.0,)


ZERO = (0.0, 0.0, 0.0)


@short_inlined
def second_coefficients(s, b, c, db, dc):
    """Return the rates per phi . phi' of db and dc, for s = |phi|^2."""
    if s < 0.25:
        return six_terms(SERIES_DDB, s), six_terms(SERIES_DDC, s)
    return (c - b - 4.0 * db) / s, (db - 5.0 * dc) / s


@short_inlined
def unit(axis):
    """Return the unit vector along an axis."""
    return 1.0 * (axis == 0), 1.0 * (axis == 1), 1.0 * (axis == 2)


@short_inlined
def symmetric_rates(phi, rate, bend, x):
    """Return K^2 x and its first and second derivative at a constant x."""
    r = dot(phi, rate)
    zero = add(scale(dot(phi, x), phi), scale(-dot(phi, phi), x))
    first = add(add(scale(dot(phi, x), rate), scale(dot(rate, x), phi)), scale(-2.0 * r, x))
    second = add(
        add(scale(dot(phi, x), bend), scale(dot(bend, x), phi)),
        add(scale(2.0 * dot(rate, x), rate), scale(-2.0 * (dot(rate, rate) + dot(phi, bend)), x)),
    )
    return zero, first, second


@short_inlined
def turning_rates(work, k, phi, rate, bend, x):
    """Return J x and its first and second derivative along a motion of phi, x constant.

    k is the offset of the left Jacobian's coefficients.
    """
    b, c, db, dc = work[k], work[k + 1], work[k + 2], work[k + 3]
    ddb, ddc = second_coefficients(dot(phi, phi), b, c, db, dc)
    r = dot(phi, rate)
    rr = dot(rate, rate) + dot(phi, bend)
    zero, first, second = symmetric_rates(phi, rate, bend, x)
    turned, turned_rate, turned_bend = cross(phi, x), cross(rate, x), cross(bend, x)
    up = add(
        add(scale(db * r, turned), scale(b, turned_rate)),
        add(scale(dc * r, zero), scale(c, first)),
    )
    upper = add(
        add(scale(db * rr + ddb * r * r, turned), scale(2.0 * db * r, turned_rate)),
        add(scale(b, turned_bend), scale(dc * rr + ddc * r * r, zero)),
    )
    upper = add(upper, add(scale(2.0 * dc * r, first), scale(c, second)))
    return add(x, add(scale(b, turned), scale(c, zero))), up, upper


@short_inlined
def mode_turn(topology, constants, i, j):
    """Return dphi/dd_j of mode j of row i's carrier, at row i's section."""
    if at(topology, at(topology, i, at_.PARENT), at_.COMPONENTS) > 0:
        return section_turn(topology, constants, i, j)
    slope, axis = mode_slope(topology, constants, i, j)
    return scale(slope, unit(axis))


@short_inlined
def column_change(topology, constants, i, j, x):
    """Return sum_k dB_j/dd_k x_k at row i's section, x in order of all coordinates."""
    if at(topology, at(topology, i, at_.PARENT), at_.COMPONENTS) > 0:
        return section_bend(topology, constants, i, j, x)
    return -shortening_rate(topology, constants, i, j, x), 0.0, 0.0


@short_inlined
def mode_slope(topology, constants, i, j):
    """Return slope and axis of the turn of mode j of row i's carrier, at row i's section."""
    p = at(topology, i, at_.PARENT)
    ny, nz = at(topology, p, at_.NY), at(topology, p, at_.NZ)
    slope = constants[at(topology, i, at_.SECTION) + 1 + ny + nz + j]
    if j < ny:
        return slope, 2
    if j < ny + nz:
        return -slope, 1
    return slope, 0


@short_inlined
def shortening_rate(topology, constants, i, j, qd):
    """Return (H d')_j of mode j of row i's carrier, at row i's section: 0 for torsion."""
    p = at(topology, i, at_.PARENT)
    ny, nz = at(topology, p, at_.NY), at(topology, p, at_.NZ)
    h = at(topology, i, at_.SECTION) + 1 + 2 * (ny + nz) + at(topology, p, at_.NT)
    d = at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT)
    total = 0.0
    if j < ny:
        for k in range(ny):
            total += constants[h + ny * j + k] * qd[d + k]
    elif j < ny + nz:
        h += ny * ny + nz * (j - ny)
        for k in range(nz):
            total += constants[h + k] * qd[d + ny + k]
    return total


@short_inlined
def slides(work, turn, k, w, al):
    """Return axis k of a body in base axes and its two rates."""
    u = (work[turn + k], work[turn + 3 + k], work[turn + 6 + k])
    up = cross(w, u)
    return u, up, add(cross(al, u), cross(w, up))


@short_inlined
def turns(work, turn, x, w, al, unturned):
    """Return a twist about a moving point, and its two rates: a turn given in a body's axes.

    x: the point's position, velocity and acceleration; w, al: the body's; unturned: the turn and
    its two rates as the body sees them.
    """
    z, up = rotate(work, turn, unturned[0]), rotate(work, turn, unturned[1])
    z_up = add(cross(w, z), up)
    z_upper = add(add(cross(al, z), cross(w, add(z_up, up))), rotate(work, turn, unturned[2]))
    first = add(cross(x[1], z), cross(x[0], z_up))
    second = add(add(cross(x[2], z), scale(2.0, cross(x[1], z_up))), cross(x[0], z_upper))
    return (cross(x[0], z), z), (first, z_up), (second, z_upper)


@short_inlined
def section_slip(topology, constants, work, qd, qdd, i):
    """Return B d' and B d'' + B' d' of row i's section, base axes, phi' and phi''."""
    p = at(topology, i, at_.PARENT)
    columns = at(topology, i, at_.SECTION_WORK) + at_.COLUMNS
    turn = at(topology, p, at_.WORK) + at_.WORLD_ROTATION
    d = at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT)
    rate, slip_up = section_rates(topology, constants, qd, i)
    bend, _ = section_rates(topology, constants, qdd, i)
    slip = (0.0, 0.0, 0.0)
    for j in range(at(topology, p, at_.MODES)):
        linear = load(work, columns + 6 * j)
        slip = add(slip, scale(qd[d + j], linear))
        slip_up = add(slip_up, scale(qdd[d + j], linear))
    return rotate(work, turn, slip), rotate(work, turn, slip_up), rate, bend


@short_inlined
def write_mode(topology, constants, work, qd, qdd, i, j, along, across, turning):
    """Write the part of mode j of its carrier in row i: a sum of slides and a turn.

    The column is -h e_x + s e + slope z, of which only h = (H d)_j changes beside the axes.
    """
    place = at(topology, i, at_.SECTION_WORK) + at_.COLUMNS + 6 * j
    h, s = work[place], work[place + 1] + work[place + 2]
    slope, _ = mode_slope(topology, constants, i, j)
    up = shortening_rate(topology, constants, i, j, qd)
    upper = shortening_rate(topology, constants, i, j, qdd)
    k = at(topology, i, at_.DERIVED) + diff_.SEEN + diff_.SEEN_SIZE * j
    column = add(scale(h, along[0]), scale(s, across[0]))
    first = add(scale(h, along[1]), scale(s, across[1]))
    second = add(scale(h, along[2]), scale(s, across[2]))
    first = subtract(first, scale(up, along[0]))
    second = subtract(second, add(scale(2.0 * up, along[1]), scale(upper, along[0])))
    store_pair(work, k, sum_pair((column, (0.0, 0.0, 0.0)), scale_pair(slope, turning[0])))
    store_pair(work, k + 6, sum_pair((first, (0.0, 0.0, 0.0)), scale_pair(slope, turning[1])))
    store_pair(work, k + 12, sum_pair((second, (0.0, 0.0, 0.0)), scale_pair(slope, turning[2])))


@short_inlined
def weighted(v, x, y, z):
    """Return the sum of three pairs times the elements of a vector."""
    return sum_pair(scale_pair(v[0], x), sum_pair(scale_pair(v[1], y), scale_pair(v[2], z)))


@short_inlined
def slide(v, along):
    """Return the slide of a vector in a body's axes, given those of its axes."""
    return add(add(scale(v[0], along[0]), scale(v[1], along[1])), scale(v[2], along[2])), ZERO


@short_inlined
def write_component_modes(topology, constants, work, qd, qdd, i, moves, rates, seen):
    """Write what row i shows of its carrier's component modes; return its twist and its rate.

    moves: the section's position with its two rates, the carrier's w and al; rates: phi' and
    phi''; seen: the twist and its rate that the carrier's turn lacks.
    """
    p = at(topology, i, at_.PARENT)
    turn = at(topology, p, at_.WORK) + at_.WORLD_ROTATION
    o = at(topology, i, at_.SECTION_WORK)
    k, phi = o + at_.COEFFICIENTS, load(work, o + at_.ROTATION_VECTOR)
    (x, w, al), (rate, bend), (twist, up) = moves, rates, seen
    about_x = turns(work, turn, x, w, al, turning_rates(work, k, phi, rate, bend, unit(0)))
    about_y = turns(work, turn, x, w, al, turning_rates(work, k, phi, rate, bend, unit(1)))
    about_z = turns(work, turn, x, w, al, turning_rates(work, k, phi, rate, bend, unit(2)))
    (x, x1, x2), (y, y1, y2), (z, z1, z2) = (
        slides(work, turn, 0, w, al),
        slides(work, turn, 1, w, al),
        slides(work, turn, 2, w, al),
    )
    for j in range(at(topology, p, at_.MODES)):
        column = load(work, o + at_.COLUMNS + 6 * j)
        theta = section_turn(topology, constants, i, j)
        first = section_bend(topology, constants, i, j, qd)
        second = section_bend(topology, constants, i, j, qdd)
        seen_at = at(topology, i, at_.DERIVED) + diff_.SEEN + diff_.SEEN_SIZE * j
        turning = weighted(theta, about_x[0], about_y[0], about_z[0])
        store_pair(work, seen_at, sum_pair(slide(column, (x, y, z)), turning))
        turning = weighted(theta, about_x[1], about_y[1], about_z[1])
        sliding = sum_pair(slide(column, (x1, y1, z1)), slide(first, (x, y, z)))
        store_pair(work, seen_at + 6, sum_pair(sliding, turning))
        turning = weighted(theta, about_x[2], about_y[2], about_z[2])
        sliding = sum_pair(slide(column, (x2, y2, z2)), slide(second, (x, y, z)))
        sliding = sum_pair(sliding, scale_pair(2.0, slide(first, (x1, y1, z1))))
        store_pair(work, seen_at + 12, sum_pair(sliding, turning))
    turning = weighted(rate, about_x[0], about_y[0], about_z[0])
    up = sum_pair(up, weighted(bend, about_x[0], about_y[0], about_z[0]))
    up = sum_pair(up, weighted(rate, about_x[1], about_y[1], about_z[1]))
    return sum_pair(twist, turning), up


@short_shared
def write_seen(topology, constants, work, qd, qdd, i):
    """Write the parts of the carrier's amplitudes in row i's section; move its twist on.

    The twist and its derivative at DERIVED of row i are to be the carrier's.
    """
    p = at(topology, i, at_.PARENT)
    o = at(topology, i, at_.SECTION_WORK)
    e = at(topology, i, at_.DERIVED)
    turn = at(topology, p, at_.WORK) + at_.WORLD_ROTATION
    phi = load(work, o + at_.ROTATION_VECTOR)
    (v, w), (a, al) = pair(work, e + diff_.TWIST), pair(work, e + diff_.ACCELERATED)
    slip, slip_up, rate, bend = section_slip(topology, constants, work, qd, qdd, i)
    place = add(
        load(work, at(topology, p, at_.WORK) + at_.WORLD_POSITION),
        rotate(work, turn, load(work, o + at_.SECTION_POSITION)),
    )
    velocity = add(v, cross(w, place))
    accelerated = add(add(a, cross(al, place)), cross(w, add(velocity, scale(2.0, slip))))
    x = place, add(velocity, slip), add(accelerated, slip_up)
    along = slides(work, turn, 0, w, al)
    v, a = add(v, slip), add(a, add(slip_up, cross(w, slip)))
    twist, up = (v, w), (a, al)
    if at(topology, p, at_.COMPONENTS) > 0:
        twist, up = write_component_modes(
            topology, constants, work, qd, qdd, i, (x, w, al), (rate, bend), (twist, up)
        )
    first = 0
    for plane in range(3):
        axis = unit(2 - plane)
        last = first + at(topology, p, at_.NY + plane)
        if last > first:
            unturned = turning_rates(work, o + at_.COEFFICIENTS, phi, rate, bend, axis)
            turning = turns(work, turn, x, w, al, unturned)
            across = slides(work, turn, (plane + 1) % 3, w, al)
            for j in range(first, last):
                write_mode(topology, constants, work, qd, qdd, i, j, along, across, turning)
            r, s = dot(axis, rate), dot(axis, bend)
            twist = sum_pair(twist, scale_pair(r, turning[0]))
            up = sum_pair(up, sum_pair(scale_pair(s, turning[0]), scale_pair(r, turning[1])))
        first = last
    store_pair(work, e + diff_.TWIST, twist)
    store_pair(work, e + diff_.ACCELERATED, up)


@short_inlined
def show_columns(topology, work, i):
    """Write the carrier's amplitudes in row i among the columns."""
    p = at(topology, i, at_.PARENT)
    length = at(topology, 0, diff_.ROW_LENGTH)
    c = (
        at(topology, 0, at_.DERIVED)
        + diff_.COLUMNS
        + at(topology, p, at_.COORDINATE)
        + at(topology, p, at_.JOINT)
    )
    e = at(topology, i, at_.DERIVED) + diff_.SEEN
    for j in range(at(topology, p, at_.MODES)):
        for k in range(diff_.SEEN_SIZE):
            seen = work[e + diff_.SEEN_SIZE * j + k] if at(topology, i, at_.SECTION) > 0 else 0.0
            work[c + length * k + j] = seen


@short_inlined
def turning_power(work, k, phi, n, o):
    """Write T at offset o of work: T_ba is the power of a torque n on dJ/dphi_b e_a.

    k is the offset of the left Jacobian's coefficients.
    """
    b, c, db, dc = work[k], work[k + 1], work[k + 2], work[k + 3]
    along = dot(phi, n)
    z = add(scale(db, cross(n, phi)), scale(dc * along, phi))
    z = add(z, scale(-dc * dot(phi, phi) - 2.0 * c, n))
    for r in range(3):
        row = add(scale(phi[r], z), scale(c * n[r], phi))
        row = add(row, scale(b, cross(n, unit(r))))
        store(work, o + 3 * r, row)
        work[o + 4 * r] += c * along


@short_inlined
def combined(work, o, v):
    """Return the sum of the three rows at offset o of work times the elements of a vector."""
    first = add(scale(v[0], load(work, o)), scale(v[1], load(work, o + 3)))
    return add(first, scale(v[2], load(work, o + 6)))


@short_inlined
def turned_back(work, k, phi, x):
    """Return J^T x of a section: the left Jacobian's coefficients stand at offset k."""
    turned = cross(phi, x)
    return add(x, add(scale(-work[k], turned), scale(work[k + 1], cross(phi, turned))))


@short_inlined
def geometric_row(constants, slope, h, counts, power, force, k, work, o):
    """Add the share of all modes' turns to row k of the modal forces, at offset o of work.

    slope, h: offsets of the section's slopes and of H; power: by a turn about each axis.
    """
    ny, nz, nt = counts
    for j in range(ny):
        work[o + j] += constants[slope + j] * power[2]
    for j in range(ny, ny + nz):
        work[o + j] -= constants[slope + j] * power[1]
    for j in range(ny + nz, ny + nz + nt):
        work[o + j] += constants[slope + j] * power[0]
    if k < ny:
        for j in range(ny):
            work[o + j] -= force * constants[h + ny * k + j]
    elif k < ny + nz:
        h += ny * ny + nz * (k - ny)
        for j in range(nz):
            work[o + ny + j] -= force * constants[h + j]


@short_inlined
def component_geometric_terms(topology, constants, work, i, force, torque, out, step):
    """Do what :func:`geometric_terms` does for a carrier with component modes."""
    m = at(topology, at(topology, i, at_.PARENT), at_.MODES)
    o = at(topology, i, at_.SECTION_WORK)
    k, phi = o + at_.COEFFICIENTS, load(work, o + at_.ROTATION_VECTOR)
    turning = at(topology, 0, at_.DERIVED) + diff_.SCRATCH
    turning_power(work, k, phi, torque, turning)
    gamma = at(topology, i, at_.SECTION) + 3 + 6 * m
    for r in range(m):
        pushed = cross(force, load(work, o + at_.COLUMNS + 6 * r))
        theta = section_turn(topology, constants, i, r)
        power = add(turned_back(work, k, phi, pushed), combined(work, turning, theta))
        for j in range(m):
            by = dot(power, section_turn(topology, constants, i, j))
            by += dot(force, load(constants, gamma + 3 * (m * r + j)))
            work[out + step * r + j] += by


@short_inlined
def geometric_terms(topology, constants, work, i, force, torque, out, step):
    """Write the modal forces of the wrench on a section through its turning by the amplitudes.

    force and torque are about the section, in the carrier's axes. Added at offset out (a row for
    each force, `step` apart) is f . dB_k/dd_j + B_k . (theta_j x f) + n . dtheta_j/dd_k.
    """
    p = at(topology, i, at_.PARENT)
    if at(topology, p, at_.COMPONENTS) > 0:
        component_geometric_terms(topology, constants, work, i, force, torque, out, step)
        return
    counts = at(topology, p, at_.NY), at(topology, p, at_.NZ), at(topology, p, at_.NT)
    o = at(topology, i, at_.SECTION_WORK)
    phi = load(work, o + at_.ROTATION_VECTOR)
    turning = at(topology, 0, at_.DERIVED) + diff_.SCRATCH
    turning_power(work, o + at_.COEFFICIENTS, phi, torque, turning)
    slope = at(topology, i, at_.SECTION) + 1 + counts[0] + counts[1]
    h = slope + counts[0] + counts[1] + counts[2]
    for k in range(at(topology, p, at_.MODES)):
        # theta_j = s_j J e: the power of both on a turn about each axis e
        pushed = cross(force, load(work, o + at_.COLUMNS + 6 * k))
        power = turned_back(work, o + at_.COEFFICIENTS, phi, pushed)
        own, axis = mode_slope(topology, constants, i, k)
        power = add(power, scale(own, load(work, turning + 3 * axis)))
        geometric_row(constants, slope, h, counts, power, force[0], k, work, out + step * k)
