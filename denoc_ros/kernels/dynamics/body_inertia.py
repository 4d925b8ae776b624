"""The inertia of one body, and the transport of a child's six rows to its carrier.

The inertia of a flexible body stands in work as a (6 + m) x (6 + m) row-major matrix over
[v; omega; d'; c'] of which only the upper half counts; that of a rigid one as a block.
"""

from denoc_ros.kernels.algebra.joint_block import (
    accumulate_block,
    rotated,
    shifted,
    six,
    wrench_of,
    write_block,
)
from denoc_ros.kernels.algebra.vector import accumulate, add, cross, dot, load
from denoc_ros.kernels.dynamics.component_modes import component_inertia
from denoc_ros.kernels.jit.compiled import inlined
from denoc_ros.kernels.jit.handle import at
from denoc_ros.kernels.layout import layout as at_


@inlined
def add_moment(work, o, size, m):
    """Add -(m x) to the linear-angular block of an inertia."""
    x, y, z = m
    work[o + 4] += z
    work[o + 5] -= y
    work[o + size + 3] -= z
    work[o + size + 5] += x
    work[o + 2 * size + 3] += y
    work[o + 2 * size + 4] -= x


@inlined
def add_spin(work, o, size, spin):
    """Add a symmetric rotational inertia to the angular block of an inertia."""
    xx, xy, xz, yy, yz, zz = spin
    k = o + 3 * size + 3
    work[k] += xx
    work[k + 1] += xy
    work[k + 2] += xz
    work[k + size + 1] += yy
    work[k + size + 2] += yz
    work[k + 2 * size + 2] += zz


@inlined
def rigid_part(topology, constants, work, i, size):
    """Write the inertia of the rigid part of flexible body i, with zeros for its modes."""
    c = at(topology, i, at_.BODY_CONSTANTS)
    o = at(topology, i, at_.INERTIA_WORK)
    for k in range(size * size):
        work[o + k] = 0.0
    mass = constants[c + at_.MASS]
    for k in range(3):
        work[o + (size + 1) * k] = mass
    add_moment(work, o, size, load(constants, c + at_.FIRST_MOMENT))
    add_spin(work, o, size, six(constants, c + at_.ROTATIONAL_INERTIA))


@inlined
def beam_inertia(topology, constants, work, i):
    """Add int rho C^T C with C = [1, -p x, B] of body i's beam."""
    ny = at(topology, i, at_.NY)
    nz = at(topology, i, at_.NZ)
    nt = at(topology, i, at_.NT)
    bending = ny + nz
    size = 6 + at(topology, i, at_.MODES)
    o = at(topology, i, at_.INERTIA_WORK)
    c = at(topology, i, at_.BEAM) + 1 + nt + nt * nt
    k = at(topology, i, at_.BEAM_WORK) + at(topology, i, at_.MODES)
    mass = 0.0
    mx = my = mz = 0.0
    xx = xy = xz = yy = yz = zz = 0.0
    for _ in range(at(topology, i, at_.POINTS)):
        e = constants[c]
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
            s = constants[c + 2 + j]
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
                    both += s * constants[c + 2 + n]
                work[o + (6 + n) * size + 6 + j] += both
        c += 2 + bending + ny * ny + nz * nz
        k += 3 + bending
    for n in range(3):
        work[o + (size + 1) * n] += mass
    add_moment(work, o, size, (mx, my, mz))
    add_spin(work, o, size, (xx, xy, xz, yy, yz, zz))


@inlined
def torsion_inertia(topology, constants, work, i):
    """Add int rho J (omega_x + beta')^2 of body i's beam."""
    nt = at(topology, i, at_.NT)
    size = 6 + at(topology, i, at_.MODES)
    o = at(topology, i, at_.INERTIA_WORK)
    b = at(topology, i, at_.BEAM)
    work[o + 3 * size + 3] += constants[b]
    first = 6 + at(topology, i, at_.NY) + at(topology, i, at_.NZ)
    for j in range(nt):
        s = constants[b + 1 + j]
        work[o + 3 * size + first + j] += s
        for k in range(j, nt):
            work[o + (first + j) * size + first + k] += constants[b + 1 + nt + nt * j + k]


@inlined
def flexible_inertia(topology, constants, work, i):
    """Write the (6 + m) inertia of flexible body i."""
    rigid_part(topology, constants, work, i, 6 + at(topology, i, at_.MODES))
    if at(topology, i, at_.COMPONENTS) > 0:
        component_inertia(topology, constants, work, i)
        return
    beam_inertia(topology, constants, work, i)
    if at(topology, i, at_.NT) > 0:
        torsion_inertia(topology, constants, work, i)


@inlined
def body_inertia(topology, constants, work, i):
    """Write the inertia of body i: its upper half where flexible, else a block."""
    if at(topology, i, at_.MODES) > 0:
        flexible_inertia(topology, constants, work, i)
        return
    c = at(topology, i, at_.BODY_CONSTANTS)
    o = at(topology, i, at_.INERTIA_WORK)
    mass = constants[c + at_.MASS]
    x, y, z = load(constants, c + at_.FIRST_MOMENT)
    across = ((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0))
    write_block(
        work,
        o,
        ((mass, 0.0, 0.0, mass, 0.0, mass), across, six(constants, c + at_.ROTATIONAL_INERTIA)),
    )


@inlined
def flexible_block(work, o, size):
    """Return the block of a flexible body, whose inertia stands at offset o."""
    return (
        (
            work[o], work[o + 1], work[o + 2], work[o + size + 1], work[o + size + 2],
            work[o + 2 * size + 2],
        ),
        (load(work, o + 3), load(work, o + size + 3), load(work, o + 2 * size + 3)),
        (
            work[o + 3 * size + 3], work[o + 3 * size + 4], work[o + 3 * size + 5],
            work[o + 4 * size + 4], work[o + 4 * size + 5], work[o + 5 * size + 5],
        ),
    )  # fmt: skip


@inlined
def add_block(work, o, size, block):
    """Add a block to the inertia of a flexible body at offset o."""
    a, b, d = block
    accumulate(work, o, a[:3])
    accumulate(work, o + 3, b[0])
    work[o + size + 1] += a[3]
    work[o + size + 2] += a[4]
    accumulate(work, o + size + 3, b[1])
    work[o + 2 * size + 2] += a[5]
    accumulate(work, o + 2 * size + 3, b[2])
    accumulate(work, o + 3 * size + 3, d[:3])
    work[o + 4 * size + 4] += d[3]
    work[o + 4 * size + 5] += d[4]
    work[o + 5 * size + 5] += d[5]


@inlined
def transmit_to_modes(topology, work, i, block):
    """Add to the modes of row i's carrier the block on its section, in the carrier's axes."""
    p = at(topology, i, at_.PARENT)
    modes = at(topology, p, at_.MODES)
    size = 6 + modes
    m = at(topology, p, at_.INERTIA_WORK)
    place = load(work, at(topology, i, at_.SECTION_WORK) + at_.SECTION_POSITION)
    columns = at(topology, i, at_.SECTION_WORK) + at_.COLUMNS
    for j in range(modes):
        u = columns + 6 * j
        f, n = wrench_of(block, load(work, u), load(work, u + 3))
        for k in range(j, modes):
            u = columns + 6 * k
            s = dot(load(work, u), f) + dot(load(work, u + 3), n)
            work[m + (6 + j) * size + 6 + k] += s
        n = add(n, cross(place, f))
        for k in range(3):
            work[m + k * size + 6 + j] += f[k]
            work[m + (3 + k) * size + 6 + j] += n[k]


@inlined
def transmit_inertia(topology, work, i, block):
    """Add row i's block (body axes, at its origin) to its carrier's inertia."""
    p = at(topology, i, at_.PARENT)
    o = at(topology, i, at_.WORK)
    m = at(topology, p, at_.INERTIA_WORK)
    block = shifted(rotated(block, work, o), load(work, o + at_.ARM))
    if at(topology, i, at_.SECTION) > 0:
        transmit_to_modes(topology, work, i, block)
        block = shifted(
            block, load(work, at(topology, i, at_.SECTION_WORK) + at_.SECTION_POSITION)
        )
    if at(topology, p, at_.MODES) == 0:
        accumulate_block(work, m, block)
    else:
        add_block(work, m, 6 + at(topology, p, at_.MODES), block)
