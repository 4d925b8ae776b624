"""Sums of products over a beam's points, from which its derivatives are formed.

A point's record in work has weight e and position p, slip B d', u = B d'' + B' d' + 2 w x slip,
velocity and acceleration, then per bending mode rows of lanes: h = (H d)_j, the shape s, (H d')_j
and (H d'')_j. A column is B_j = (-h, s, 0) or (-h, 0, s), and dB_j/dd_k = -H_jk e_x.
"""

from denoc_ros.kernels import derivative_layout as diff_
from denoc_ros.kernels import layout as at_
from denoc_ros.kernels.compiled import short_inlined, short_shared
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.lanes import plus_product, put_all, spread, take, take_some
from denoc_ros.kernels.vector import add, cross, load, scale, store


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
