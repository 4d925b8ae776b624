"""Derivatives of a beam's own wrench and modal forces by its amplitudes and their rates.

acc = a + al x p + B d'' + w x (w x p + 2 B d') + B' d' of a point p = p(d), with dB/dd_j = -H_j:
d acc/d d_j = A B_j - (H d'')_j e_x - 2 (H d')_j w x e_x,  A = al x + w x w x,
d acc/d d'_j = 2 w x B_j - 2 (H d')_j e_x.
They are formed from sums of products over a beam's points. A point's record in work has weight e
and position p, slip B d', u = B d'' + B' d' + 2 w x slip, velocity and acceleration, then per
bending mode rows of lanes: h = (H d)_j, the shape s, (H d')_j and (H d'')_j. A column is
B_j = (-h, s, 0) or (-h, 0, s), and dB_j/dd_k = -H_jk e_x.
"""

from denoc_ros.kernels.algebra.lanes import (
    ones_before,
    plus_product,
    put_all,
    put_pair,
    put_vector,
    spread,
    take,
    take_some,
)
from denoc_ros.kernels.algebra.vector import add, cross, load, scale, store, subtract
from denoc_ros.kernels.derivatives.derivative_rows import own_of
from denoc_ros.kernels.jit.compiled import short_inlined, short_shared
from denoc_ros.kernels.jit.handle import at
from denoc_ros.kernels.layout import derivative_layout as diff_
from denoc_ros.kernels.layout import layout as at_


@short_inlined
def sums_of(topology, i):
    """Return where the records and the sums of body i's beam begin, and their rows' length."""
    record = at(topology, 0, diff_.BEAM_SCRATCH)
    length = (
        (at(topology, i, at_.NY) + at(topology, i, at_.NZ) + diff_.LANES - 1)
        // diff_.LANES
        * diff_.LANES
    )
    return record, record + (diff_.POINT_MODES + 4 * length) * at(topology, i, at_.POINTS), length


@short_inlined
def mode_sums(topology, i):
    """Return where the sums begin that have a row of four times the lanes for each factor."""
    _, sums, _ = sums_of(topology, i)
    return sums + diff_.BODY_SUMS_SIZE


@short_inlined
def write_plane(constants, work, qd, qdd, first, count, places, k, row, length):
    """Write one plane's modes of a record; return B d' and B d'' + B' d'.

    first: index of the plane's first amplitude, places: offsets of its shapes and of H, k: of H d.
    """
    s, h = places
    slip, slip_up, across, across_up = 0.0, 0.0, 0.0, 0.0
    for j in range(count):
        bend, lift = 0.0, 0.0
        for n in range(count):
            bend += constants[h + count * j + n] * qd[first + n]
            lift += constants[h + count * j + n] * qdd[first + n]
        hd, shape = work[k + j], constants[s + j]
        rate, up = qd[first + j], qdd[first + j]
        slip -= hd * rate
        slip_up -= hd * up + bend * rate
        across += shape * rate
        across_up += shape * up
        work[row + j] = hd
        work[row + length + j] = shape
        work[row + 2 * length + j] = bend
        work[row + 3 * length + j] = lift
    return slip, slip_up, across, across_up


@short_inlined
def write_points(topology, constants, work, qd, qdd, i):
    """Write the records of body i's beam."""
    ny, nz, nt = at(topology, i, at_.NY), at(topology, i, at_.NZ), at(topology, i, at_.NT)
    o = at(topology, i, at_.WORK)
    d = at(topology, i, at_.COORDINATE) + at(topology, i, at_.JOINT)
    w, al = load(work, o + at_.ANGULAR_VELOCITY), load(work, o + at_.ANGULAR_ACCELERATION)
    v, a = load(work, o + at_.VELOCITY), load(work, o + at_.ACCELERATION)
    record, _, length = sums_of(topology, i)
    c = at(topology, i, at_.BEAM) + 1 + nt + nt * nt
    k = at(topology, i, at_.BEAM_WORK) + at(topology, i, at_.MODES)
    for _ in range(at(topology, i, at_.POINTS)):
        row = record + diff_.POINT_MODES
        for n in range(4):  # lanes beyond the last mode
            put_all(work, row + length * (n + 1) - diff_.LANES, spread(0.0))
        s = c + 2
        h = s + ny + nz
        x, x_up, y, y_up = write_plane(constants, work, qd, qdd, d, ny, (s, h), k + 3, row, length)
        h += ny * ny
        places = (s + ny, h)
        other = write_plane(
            constants, work, qd, qdd, d + ny, nz, places, k + 3 + ny, row + ny, length
        )
        slip = (x + other[0], y, other[2])
        along = (x_up + other[1], y_up, other[3])
        one, p = constants[c], load(work, k)
        along = add(along, scale(2.0, cross(w, slip)))
        turning = cross(w, p)
        acc = add(add(scale(one, a), cross(al, p)), add(cross(w, turning), along))
        work[record] = one
        store(work, record + 1, p)
        store(work, record + 4, slip)
        store(work, record + 8, along)
        store(work, record + 12, add(add(scale(one, v), turning), slip))
        store(work, record + 16, acc)
        c = h + nz * nz
        k += 3 + ny + nz
        record = row + 4 * length


@short_inlined
def four_products(work, o, x, a):
    """Return four sums, to each of which another of four numbers times x is added."""
    return (
        plus_product(a[0], x, spread(work[o])),
        plus_product(a[1], x, spread(work[o + 1])),
        plus_product(a[2], x, spread(work[o + 2])),
        plus_product(a[3], x, spread(work[o + 3])),
    )


@short_inlined
def three_products(work, o, x, a):
    """Return three sums, to each of which another of three numbers times x is added."""
    return (
        plus_product(a[0], x, spread(work[o])),
        plus_product(a[1], x, spread(work[o + 1])),
        plus_product(a[2], x, spread(work[o + 2])),
    )


@short_inlined
def body_sums(work, record, stride, points, out):
    """Write the sums of weight and position with themselves, with the slip and with u (4 x 12)."""
    zero = spread(0.0)
    for part in range(3):
        a = (zero, zero, zero, zero)
        o = record
        for _ in range(points):
            a = four_products(work, o, take(work, o + 4 * part), a)
            o += stride
        for r in range(4):
            put_all(work, out + 12 * r + 4 * part, a[r])


@short_inlined
def column_sums(work, record, stride, points, length, out):
    """Write the sums of weight, position, velocity and acceleration with the modes (10 rows)."""
    zero = spread(0.0)
    for j in range(diff_.POINT_MODES, diff_.POINT_MODES + 2 * length, diff_.LANES):
        a, b, c = (zero, zero, zero, zero), (zero, zero, zero), (zero, zero, zero)
        o = record
        for _ in range(points):
            x = take(work, o + j)
            a = four_products(work, o, x, a)
            b = three_products(work, o + 12, x, b)
            c = three_products(work, o + 16, x, c)
            o += stride
        u = out + j - diff_.POINT_MODES
        for r in range(4):
            put_all(work, u + 4 * length * r, a[r])
        for r in range(3):
            put_all(work, u + 4 * length * (4 + r), b[r])
            put_all(work, u + 4 * length * (7 + r), c[r])
    for j in range(diff_.POINT_MODES + 2 * length, diff_.POINT_MODES + 4 * length, diff_.LANES):
        a = (zero, zero, zero, zero)
        o = record
        for _ in range(points):
            a = four_products(work, o, take(work, o + j), a)
            o += stride
        for r in range(4):
            put_all(work, out + j - diff_.POINT_MODES + 4 * length * r, a[r])


@short_inlined
def pair_sums(work, record, stride, points, length, count, out):
    """Write the sums of h and s of each mode with the modes: rows h_1, s_1, h_2, ... .

    s not of the last of the four, for which nobody asks.
    """
    zero = spread(0.0)
    for n in range(count):
        for j in range(0, length, diff_.LANES):
            a, b = (zero, zero, zero, zero), (zero, zero, zero)
            o = record + diff_.POINT_MODES
            for _ in range(points):
                h, s = spread(work[o + n]), spread(work[o + length + n])
                other, shape = take(work, o + j), take(work, o + length + j)
                bend = take(work, o + 2 * length + j)
                a = (
                    plus_product(a[0], h, other),
                    plus_product(a[1], h, shape),
                    plus_product(a[2], h, bend),
                    plus_product(a[3], h, take(work, o + 3 * length + j)),
                )
                b = (
                    plus_product(b[0], s, other),
                    plus_product(b[1], s, shape),
                    plus_product(b[2], s, bend),
                )
                o += stride
            u = out + 8 * length * n + j
            for r in range(4):
                put_all(work, u + length * r, a[r])
            for r in range(3):
                put_all(work, u + length * (4 + r), b[r])


@short_inlined
def shortening_sums(topology, constants, work, i, record, stride, out):
    """Write the sums of H times the axial acceleration: H_y, then H_z."""
    ny, nz, nt = at(topology, i, at_.NY), at(topology, i, at_.NZ), at(topology, i, at_.NT)
    entries = ny * ny + nz * nz
    step = 2 + ny + nz + entries
    for j in range(0, entries, diff_.LANES):
        total = spread(0.0)
        c = at(topology, i, at_.BEAM) + 3 + nt + nt * nt + ny + nz + j
        o = record
        for _ in range(at(topology, i, at_.POINTS)):
            total = plus_product(total, spread(work[o + 16]), take_some(constants, c, entries - j))
            c += step
            o += stride
        put_all(work, out + j, total)


@short_shared
def beam_sums(topology, constants, work, qd, qdd, i):
    """Write all sums over the points of body i's beam; the body's motion stands at WORK."""
    record, sums, length = sums_of(topology, i)
    points = at(topology, i, at_.POINTS)
    count = at(topology, i, at_.NY) + at(topology, i, at_.NZ)
    stride = diff_.POINT_MODES + 4 * length
    write_points(topology, constants, work, qd, qdd, i)
    body_sums(work, record, stride, points, sums + diff_.BODY_SUMS)
    modes = sums + diff_.BODY_SUMS_SIZE
    column_sums(work, record, stride, points, length, modes)
    pair_sums(work, record, stride, points, length, count, modes + 40 * length)
    shortening_sums(
        topology, constants, work, i, record, stride, modes + (40 + 8 * count) * length
    )


@short_inlined
def acceleration_matrix(w, al):
    """Return the columns of A = al x + w x w x."""
    x, y, z = w
    return (
        (-(y * y + z * z), x * y + al[2], x * z - al[1]),
        (x * y - al[2], -(x * x + z * z), y * z + al[0]),
        (x * z + al[1], y * z - al[0], -(x * x + y * y)),
    )


@short_inlined
def twice_turning(w):
    """Return the columns of 2 w x."""
    x, y, z = scale(2.0, w)
    return (0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0)


@short_inlined
def across(x, y, z):
    """Return the sum of u x B, given those of u_x B, u_y B and u_z B."""
    return y[2] - z[1], z[0] - x[2], x[1] - y[0]


@short_inlined
def planes_of(ny, j):
    """Return lanes of 1 for the modes from j on that bend along y, and of 1 for the others."""
    in_y = ones_before(ny - j)
    return in_y, 1.0 - in_y


@short_inlined
def column_sum(work, u, length, planes):
    """Sum of B_j times the factor of the row of sums at u, for modes from u on."""
    s = take(work, u + length)
    return -take(work, u), s * planes[0], s * planes[1]


@short_inlined
def changed_sum(work, u, length, planes, by_q, by_rate):
    """Products of B_j, d acc/d d_j and d acc/d d'_j with the factor of the row of sums at u."""
    bend, lift = take(work, u + 2 * length), take(work, u + 3 * length)
    column = column_sum(work, u, length, planes)
    turned = matrix_column(by_q, column)
    swept = matrix_column(by_rate, column)
    # 2 w x e_x
    position = (
        turned[0] - lift,
        turned[1] - bend * by_rate[0][1],
        turned[2] - bend * by_rate[0][2],
    )
    return column, position, (swept[0] - 2.0 * bend, swept[1], swept[2])


@short_inlined
def matrix_column(matrix, v):
    """Return a matrix, given as columns, times a vector."""
    x, y, z = matrix
    return add(add(scale(v[0], x), scale(v[1], y)), scale(v[2], z))


@short_inlined
def bending_modes(work, own, step, g, length, planes, by_q, by_rate):
    """Write the rows at OWN of some bending modes at once, from `own` on; their sums begin at g.

    step, length: of the rows at OWN and of the sums.
    """
    row = 4 * length
    e = changed_sum(work, g, length, planes, by_q, by_rate)
    x = changed_sum(work, g + row, length, planes, by_q, by_rate)
    y = changed_sum(work, g + 2 * row, length, planes, by_q, by_rate)
    z = changed_sum(work, g + 3 * row, length, planes, by_q, by_rate)
    velocity = across(
        column_sum(work, g + 4 * row, length, planes),
        column_sum(work, g + 5 * row, length, planes),
        column_sum(work, g + 6 * row, length, planes),
    )
    acceleration = across(
        column_sum(work, g + 7 * row, length, planes),
        column_sum(work, g + 8 * row, length, planes),
        column_sum(work, g + 9 * row, length, planes),
    )
    position = e[1], subtract(across(x[1], y[1], z[1]), acceleration)
    put_pair(work, own + step * diff_.BY_ACCELERATION, step, (e[0], across(x[0], y[0], z[0])))
    put_vector(work, own + step * diff_.BY_TURNING, step, velocity)
    put_pair(work, own + step * diff_.BY_POSITION, step, position)
    put_pair(work, own + step * diff_.BY_RATE, step, (e[2], across(x[2], y[2], z[2])))


@short_inlined
def modes_along(planes, matrix):
    """Return the column of a matrix in whose plane each mode bends."""
    return add(scale(planes[0], matrix[1]), scale(planes[1], matrix[2]))


@short_inlined
def modal_forces(topology, work, i, j, planes, by_q, by_rate):
    """Write how the forces of body i's bending modes change with some amplitudes, from j on."""
    ny = at(topology, i, at_.NY)
    count = ny + at(topology, i, at_.NZ)
    _, _, length = sums_of(topology, i)
    _, step, forces = own_of(topology, i)
    m = at(topology, i, at_.MODES)
    row = 4 * length
    pairs = mode_sums(topology, i) + diff_.COLUMN_SUMS * row
    shortening = pairs + 2 * count * row + j
    own_q, own_rate = modes_along(planes, by_q), modes_along(planes, by_rate)
    for n in range(count):
        of_h = pairs + 2 * row * n + j
        of_s = of_h + row
        hh, hs = take(work, of_h), take(work, of_h + length)
        sh, ss = take(work, of_s), take(work, of_s + length)
        h_bend, s_bend = take(work, of_h + 2 * length), take(work, of_s + 2 * length)
        if n < ny:
            same = planes[0]
            across_q, across_rate, both_q, both_rate = (
                by_q[0][1], by_rate[0][1], own_q[1], own_rate[1],
            )  # fmt: skip
            shorter = take(work, shortening + ny * n)
        else:
            same = planes[1]
            across_q, across_rate, both_q, both_rate = (
                by_q[0][2], by_rate[0][2], own_q[2], own_rate[2],
            )  # fmt: skip
            shorter = take(work, shortening + ny * ny + (count - ny) * (n - ny) - ny)
        lift = take(work, of_h + 3 * length)
        q = by_q[0][0] * hh - own_q[0] * hs - across_q * sh + both_q * ss
        q = q + lift - across_rate * s_bend - same * shorter
        rate = both_rate * ss - own_rate[0] * hs - across_rate * sh + 2.0 * h_bend
        put_all(work, forces + step * n + j, q)
        put_all(work, forces + step * (m + n) + j, rate)
        put_all(work, forces + step * (2 * m + n) + j, hh + same * ss)


@short_inlined
def beam_body(topology, constants, work, i):
    """Write COMPOSITE of body i alone, its beam's part of FORCE, TORQUE, MOMENTUM, TURNING."""
    _, sums, _ = sums_of(topology, i)
    g = sums + diff_.BODY_SUMS
    o, e, c = (
        at(topology, i, at_.WORK),
        at(topology, i, at_.DERIVED),
        at(topology, i, at_.BODY_CONSTANTS) + at_.MASS,
    )
    xx, yy, zz = work[g + 13], work[g + 26], work[g + 39]
    k = o + at_.COMPOSITE
    work[k] = constants[c] + work[g]
    store(work, k + 1, add(load(constants, c + 1), load(work, g + 1)))
    work[k + 4] = constants[c + 4] + yy + zz
    work[k + 5] = constants[c + 5] - work[g + 14]
    work[k + 6] = constants[c + 6] - work[g + 15]
    work[k + 7] = constants[c + 7] + xx + zz
    work[k + 8] = constants[c + 8] - work[g + 27]
    work[k + 9] = constants[c + 9] + xx + yy
    store(work, e + diff_.MOMENTUM, load(work, g + 4))
    outward = 2.0 * (work[g + 16] + work[g + 29] + work[g + 42])
    for r in range(3):
        for n in range(3):
            work[e + diff_.TURNING + 3 * r + n] = -2.0 * work[g + 12 * (n + 1) + 4 + r]
        work[e + diff_.TURNING + 4 * r] += outward
    store(work, o + at_.FORCE, load(work, g + 8))
    x, y, z = load(work, g + 20), load(work, g + 32), load(work, g + 44)
    store(work, o + at_.TORQUE, across(x, y, z))


@short_inlined
def torsion_derivatives(topology, constants, work, qd, qdd, i):
    """Add the share of body i's twisting sections: torque e_x L' + w x e_x L, L = int rho J y."""
    m, nt = at(topology, i, at_.MODES), at(topology, i, at_.NT)
    own, step, forces = own_of(topology, i)
    o, e = at(topology, i, at_.WORK), at(topology, i, at_.DERIVED)
    first = m - nt
    d = at(topology, i, at_.COORDINATE) + at(topology, i, at_.JOINT) + first
    w = load(work, o + at_.ANGULAR_VELOCITY)
    b = at(topology, i, at_.BEAM)
    work[o + at_.COMPOSITE + 4] += constants[b]
    spin, spin_up = 0.0, 0.0
    for j in range(nt):
        s = constants[b + 1 + j]
        spin += s * qd[d + j]
        spin_up += s * qdd[d + j]
        u = own + first + j
        for row in range(diff_.OWN_SIZE):
            work[u + step * row] = 0.0
        work[u + step * (diff_.BY_ACCELERATION + 3)] = s
        turned = (0.0, 0.5 * s * w[2], -0.5 * s * w[1])
        for k in range(3):
            work[u + step * (diff_.BY_TURNING + k)] = turned[k]
            work[u + step * (diff_.BY_RATE + 3 + k)] = 2.0 * turned[k]
        for k in range(m):
            for part in range(3):
                work[forces + step * (m * part + first + j) + k] = 0.0
                work[forces + step * (m * part + k) + first + j] = 0.0
    for j in range(nt):
        for k in range(nt):
            both = constants[b + 1 + nt + nt * j + k]
            work[forces + step * (2 * m + first + j) + first + k] = both
    work[e + diff_.TURNING + 5] += spin
    work[e + diff_.TURNING + 7] -= spin
    work[o + at_.TORQUE] += spin_up
    work[o + at_.TORQUE + 1] += w[2] * spin
    work[o + at_.TORQUE + 2] -= w[1] * spin


@short_shared
def beam_derivatives(topology, constants, work, qd, qdd, i):
    """Write OWN and COMPOSITE of body i, and MOMENTUM and TURNING of its beam.

    FORCE and TORQUE take what is due to motion along the modes. All in body axes about the body's
    origin, whose motion stands at WORK.
    """
    beam_sums(topology, constants, work, qd, qdd, i)
    beam_body(topology, constants, work, i)
    w, al = (
        load(work, at(topology, i, at_.WORK) + at_.ANGULAR_VELOCITY),
        load(work, at(topology, i, at_.WORK) + at_.ANGULAR_ACCELERATION),
    )
    by_q, by_rate = acceleration_matrix(w, al), twice_turning(w)
    _, _, length = sums_of(topology, i)
    g = mode_sums(topology, i)
    own, step, _ = own_of(topology, i)
    ny = at(topology, i, at_.NY)
    for j in range(0, ny + at(topology, i, at_.NZ), diff_.LANES):
        planes = planes_of(ny, j)
        bending_modes(work, own + j, step, g + j, length, planes, by_q, by_rate)
        modal_forces(topology, work, i, j, planes, by_q, by_rate)
    if at(topology, i, at_.NT) > 0:
        torsion_derivatives(topology, constants, work, qd, qdd, i)
