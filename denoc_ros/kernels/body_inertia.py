"""The inertia of one body and the way a child's six rows take to its carrier.

The inertia of a flexible body stands in work as a full (6 + m) x (6 + m) row-major matrix over
[v; omega; d'; c'], that of a rigid one as a six-row block: three 3 x 3 matrices one after another,
A (force by linear acceleration), B (force by angular acceleration), D (torque by angular
acceleration).
"""

from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.layout import (
    ARM,
    BEAM,
    BEAM_WORK,
    COLUMNS,
    INERTIA_WORK,
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
    SPIN,
    WORK,
)
from denoc_ros.kernels.vector import add, cross, dot, load, rotate, store


@inlined
def add_moment(work, o, size, m):
    """Add -(m x) to the linear-angular block of an inertia and its transpose below."""
    x, y, z = m
    work[o + 4] += z
    work[o + 5] -= y
    work[o + size + 3] -= z
    work[o + size + 5] += x
    work[o + 2 * size + 3] += y
    work[o + 2 * size + 4] -= x
    work[o + 3 * size + 1] -= z
    work[o + 3 * size + 2] += y
    work[o + 4 * size] += z
    work[o + 4 * size + 2] -= x
    work[o + 5 * size] -= y
    work[o + 5 * size + 1] += x


@inlined
def spin_of(a, o):
    """Return the six elements of a symmetric rotational inertia at offset o of a."""
    return a[o], a[o + 1], a[o + 2], a[o + 3], a[o + 4], a[o + 5]


@inlined
def add_spin(work, o, size, spin):
    """Add a symmetric rotational inertia to the angular block of an inertia."""
    xx, xy, xz, yy, yz, zz = spin
    k = o + 3 * size + 3
    work[k] += xx
    work[k + 1] += xy
    work[k + 2] += xz
    work[k + size] += xy
    work[k + size + 1] += yy
    work[k + size + 2] += yz
    work[k + 2 * size] += xz
    work[k + 2 * size + 1] += yz
    work[k + 2 * size + 2] += zz


@inlined
def rigid_part(ints, reals, work, i, size):
    """Write the inertia of the rigid part of flexible body i, with zeros for its modes."""
    c = at(ints, i, REAL)
    o = at(ints, i, INERTIA_WORK)
    for k in range(size * size):
        work[o + k] = 0.0
    mass = reals[c + MASS]
    for k in range(3):
        work[o + (size + 1) * k] = mass
    add_moment(work, o, size, load(reals, c + MOMENT))
    add_spin(work, o, size, spin_of(reals, c + SPIN))


@inlined
def beam_inertia(ints, reals, work, i):
    """Add int rho C^T C with C = [1, -p x, B] of body i's beam."""
    ny = at(ints, i, NY)
    nz = at(ints, i, NZ)
    nt = at(ints, i, NT)
    bending = ny + nz
    size = 6 + at(ints, i, MODES)
    o = at(ints, i, INERTIA_WORK)
    c = at(ints, i, BEAM) + 1 + nt + nt * nt
    k = at(ints, i, BEAM_WORK) + at(ints, i, MODES)
    mass = 0.0
    mx = my = mz = 0.0
    xx = xy = xz = yy = yz = zz = 0.0
    for _ in range(at(ints, i, POINTS)):
        e = reals[c]
        x, y, z = load(work, k)
        mass += e * e
        mx += e * x
        my += e * y
        mz += e * z
        xx += y * y + z * z
        yy += x * x + z * z
        zz += x * x + y * y
        xy -= x * y
        xz -= x * z
        yz -= y * z
        for j in range(bending):
            b = -work[k + 3 + j]
            s = reals[c + 2 + j]
            u = o + 6 + j
            work[u] += e * b
            if j < ny:
                work[u + size] += e * s
                work[u + 3 * size] -= z * s
                work[u + 4 * size] += z * b
                work[u + 5 * size] += x * s - y * b
            else:
                work[u + 2 * size] += e * s
                work[u + 3 * size] += y * s
                work[u + 4 * size] += z * b - x * s
                work[u + 5 * size] -= y * b
            for n in range(j + 1):
                both = -b * work[k + 3 + n]
                if (n < ny) == (j < ny):
                    both += s * reals[c + 2 + n]
                work[o + (6 + n) * size + 6 + j] += both
        c += 2 + bending + ny * ny + nz * nz
        k += 3 + bending
    for n in range(3):
        work[o + (size + 1) * n] += mass
    add_moment(work, o, size, (mx, my, mz))
    add_spin(work, o, size, (xx, xy, xz, yy, yz, zz))
    for j in range(6, 6 + bending):
        for n in range(j):
            work[o + j * size + n] = work[o + n * size + j]


@inlined
def torsion_inertia(ints, reals, work, i):
    """Add int rho J (omega_x + beta')^2 of body i's beam."""
    nt = at(ints, i, NT)
    size = 6 + at(ints, i, MODES)
    o = at(ints, i, INERTIA_WORK)
    b = at(ints, i, BEAM)
    work[o + 3 * size + 3] += reals[b]
    first = 6 + at(ints, i, NY) + at(ints, i, NZ)
    for j in range(nt):
        s = reals[b + 1 + j]
        work[o + 3 * size + first + j] += s
        work[o + (first + j) * size + 3] += s
        for k in range(nt):
            work[o + (first + j) * size + first + k] += reals[b + 1 + nt + nt * j + k]


@inlined
def flexible_inertia(ints, reals, work, i):
    """Write the (6 + m) inertia of flexible body i."""
    rigid_part(ints, reals, work, i, 6 + at(ints, i, MODES))
    beam_inertia(ints, reals, work, i)
    if at(ints, i, NT) > 0:
        torsion_inertia(ints, reals, work, i)


@inlined
def rigid_block(work, mass, moment, spin, block):
    """Write the six-row block of a rigid body with a mass, moment (3) and spin (6)."""
    x, y, z = moment
    store(work, block, (mass, 0.0, 0.0))
    store(work, block + 3, (0.0, mass, 0.0))
    store(work, block + 6, (0.0, 0.0, mass))
    store(work, block + 9, (0.0, z, -y))
    store(work, block + 12, (-z, 0.0, x))
    store(work, block + 15, (y, -x, 0.0))
    xx, xy, xz, yy, yz, zz = spin
    store(work, block + 18, (xx, xy, xz))
    store(work, block + 21, (xy, yy, yz))
    store(work, block + 24, (xz, yz, zz))


@inlined
def body_inertia(ints, reals, work, i):
    """Write the inertia of body i: (6 + m) square where flexible, else a six-row block."""
    if at(ints, i, MODES) > 0:
        flexible_inertia(ints, reals, work, i)
        return
    c = at(ints, i, REAL)
    spin = spin_of(reals, c + SPIN)
    o = at(ints, i, INERTIA_WORK)
    rigid_block(work, reals[c + MASS], load(reals, c + MOMENT), spin, o)


@inlined
def rotate_block(work, rotation, block):
    """Replace a 3 x 3 block X by R X R^T."""
    for j in range(3):
        v = rotate(work, rotation, (work[block + j], work[block + 3 + j], work[block + 6 + j]))
        work[block + j] = v[0]
        work[block + 3 + j] = v[1]
        work[block + 6 + j] = v[2]
    for j in range(3):
        k = block + 3 * j
        store(work, k, rotate(work, rotation, load(work, k)))


@inlined
def shift_block(work, block, r):
    """Refer a six-row block to a point that lies -r from its own (same axes).

    B -> B - A r x, D -> D - B^T r x + r x B_new.
    """
    a = block
    b = block + 9
    d = block + 18
    # each row of X r x is (row of X) x r
    for j in range(3):
        col = (work[b + j], work[b + 3 + j], work[b + 6 + j])
        v = cross(col, r)
        work[d + 3 * j] -= v[0]
        work[d + 3 * j + 1] -= v[1]
        work[d + 3 * j + 2] -= v[2]
    for j in range(3):
        v = cross(load(work, a + 3 * j), r)
        work[b + 3 * j] -= v[0]
        work[b + 3 * j + 1] -= v[1]
        work[b + 3 * j + 2] -= v[2]
    for j in range(3):
        v = cross(r, (work[b + j], work[b + 3 + j], work[b + 6 + j]))
        work[d + j] += v[0]
        work[d + 3 + j] += v[1]
        work[d + 6 + j] += v[2]


@inlined
def block_wrench(work, block, linear, angular):
    """Return the force and torque of a six-row block for an acceleration."""
    force = add(rotate(work, block, linear), rotate(work, block + 9, angular))
    b = block + 9
    torque = (
        work[b] * linear[0] + work[b + 3] * linear[1] + work[b + 6] * linear[2],
        work[b + 1] * linear[0] + work[b + 4] * linear[1] + work[b + 7] * linear[2],
        work[b + 2] * linear[0] + work[b + 5] * linear[1] + work[b + 8] * linear[2],
    )
    return force, add(torque, rotate(work, block + 18, angular))


@inlined
def add_block(work, m, size, block):
    """Add a six-row block to an inertia."""
    for j in range(3):
        for k in range(3):
            work[m + size * j + k] += work[block + 3 * j + k]
            b = work[block + 9 + 3 * j + k]
            work[m + size * j + 3 + k] += b
            work[m + size * (3 + k) + j] += b
            work[m + size * (3 + j) + 3 + k] += work[block + 18 + 3 * j + k]


@inlined
def transmit_inertia(ints, work, i, block):
    """Add row i's six-row block (body axes, at its origin; overwritten) to its carrier's."""
    p = at(ints, i, PARENT)
    o = at(ints, i, WORK)
    for k in range(3):
        rotate_block(work, o, block + 9 * k)
    shift_block(work, block, load(work, o + ARM))
    size = 6 + at(ints, p, MODES)
    m = at(ints, p, INERTIA_WORK)
    if at(ints, i, SECTION) > 0:
        place = load(work, at(ints, i, SECTION_WORK) + PLACE)
        columns = at(ints, i, SECTION_WORK) + COLUMNS
        for j in range(at(ints, p, MODES)):
            f, n = block_wrench(
                work, block, load(work, columns + 6 * j), load(work, columns + 6 * j + 3)
            )
            for k in range(j, at(ints, p, MODES)):
                u = columns + 6 * k
                s = dot(load(work, u), f) + dot(load(work, u + 3), n)
                work[m + (6 + j) * size + 6 + k] += s
                if k > j:
                    work[m + (6 + k) * size + 6 + j] += s
            n = add(n, cross(place, f))
            for k in range(3):
                work[m + k * size + 6 + j] += f[k]
                work[m + (3 + k) * size + 6 + j] += n[k]
                work[m + (6 + j) * size + k] += f[k]
                work[m + (6 + j) * size + 3 + k] += n[k]
        shift_block(work, block, place)
    if size == 6:
        for k in range(27):
            work[m + k] += work[block + k]
    else:
        add_block(work, m, size, block)
