"""What a beam's own wrench and modal forces become of its amplitudes and their rates.

acc = a + al x p + B d'' + w x (w x p + 2 B d') + B' d' of a point p = p(d), with dB/dd_j = -H_j:
d acc/d d_j = (al x + w x w x) B_j - (H d'')_j e_x - 2 (H d')_j w x e_x,
d acc/d d'_j = 2 w x B_j - 2 (H d')_j e_x.
"""

from denoc_ros.kernels.compiled import inlined, shared
from denoc_ros.kernels.derivative_layout import (
    BY_ACCELERATION,
    BY_POSITION,
    BY_RATE,
    BY_TURNING,
    MOMENTUM,
    OWN_SIZE,
    TURNING,
)
from denoc_ros.kernels.handle import at
from denoc_ros.kernels.layout import (
    ACCELERATION,
    BEAM,
    BEAM_WORK,
    COORDINATE,
    DERIVED,
    FORCE,
    INERTIA_WORK,
    JOINT,
    MODES,
    NT,
    NY,
    NZ,
    OWN,
    POINTS,
    SPEED,
    SPIN_UP,
    TORQUE,
    VELOCITY,
    WORK,
)
from denoc_ros.kernels.vector import accumulate, add, cross, dot, load, scale, store
from denoc_ros.kernels.wrench import rigid_wrench, torsion_wrench


@inlined
def mode_column(reals, work, c, k, ny, j):
    """Return B_j of a beam's point, whose constants stand at c and positions at k."""
    s = reals[c + 2 + j]
    if j < ny:
        return -work[k + 3 + j], s, 0.0
    return -work[k + 3 + j], 0.0, s


@inlined
def shortened(reals, h, count, rates, d, j):
    """Return row j of H (count x count, at offset h of reals) times rates from d on."""
    total = 0.0
    for k in range(count):
        total += reals[h + count * j + k] * rates[d + k]
    return total


@shared
def point_derivatives(ints, reals, work, qd, qdd, i, c, k):
    """Add the share of one point of body i's beam; its constants are at c, its place at k.

    Adds the wrench that it needs, too.
    """
    ny, nz, m = at(ints, i, NY), at(ints, i, NZ), at(ints, i, MODES)
    bending = ny + nz
    o = at(ints, i, WORK)
    e = at(ints, i, DERIVED)
    d = at(ints, i, COORDINATE) + at(ints, i, JOINT)
    one = reals[c]
    p = load(work, k)
    w, al = load(work, o + SPEED), load(work, o + SPIN_UP)
    slip, slip_up = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    h = c + 2 + bending
    for j in range(bending):
        column = mode_column(reals, work, c, k, ny, j)
        slip = add(slip, scale(qd[d + j], column))
        slip_up = add(slip_up, scale(qdd[d + j], column))
        if j < ny:
            bend = shortened(reals, h, ny, qd, d, j)
        else:
            bend = shortened(reals, h + ny * ny, nz, qd, d + ny, j - ny)
        slip_up = (slip_up[0] - bend * qd[d + j], slip_up[1], slip_up[2])
    relative = add(cross(w, p), slip)
    velocity = add(scale(one, load(work, o + VELOCITY)), relative)
    acc = add(add(scale(one, load(work, o + ACCELERATION)), cross(al, p)), slip_up)
    acc = add(acc, cross(w, add(relative, slip)))
    accumulate(work, o + FORCE, scale(one, acc))
    accumulate(work, o + TORQUE, cross(p, acc))
    accumulate(work, e + MOMENTUM, scale(one, slip))
    outward = 2.0 * dot(slip, p)
    for r in range(3):
        work[e + TURNING + 4 * r] += outward
        for n in range(3):
            work[e + TURNING + 3 * r + n] -= 2.0 * slip[r] * p[n]
    own = at(ints, i, OWN)
    forces = own + OWN_SIZE * m
    for j in range(bending):
        column = mode_column(reals, work, c, k, ny, j)
        if j < ny:
            bend = shortened(reals, h, ny, qd, d, j)
            lift = shortened(reals, h, ny, qdd, d, j)
        else:
            bend = shortened(reals, h + ny * ny, nz, qd, d + ny, j - ny)
            lift = shortened(reals, h + ny * ny, nz, qdd, d + ny, j - ny)
        across = cross(w, column)
        by_rate = add(scale(2.0, across), (-2.0 * bend, 0.0, 0.0))
        by_position = add(cross(al, column), cross(w, across))
        by_position = add(by_position, (-lift, -2.0 * bend * w[2], 2.0 * bend * w[1]))
        u = own + OWN_SIZE * j
        accumulate(work, u + BY_TURNING, cross(velocity, column))
        accumulate(work, u + BY_POSITION, scale(one, by_position))
        accumulate(work, u + BY_POSITION + 3, add(cross(p, by_position), cross(column, acc)))
        accumulate(work, u + BY_RATE, scale(one, by_rate))
        accumulate(work, u + BY_RATE + 3, cross(p, by_rate))
        for n in range(bending):
            other = mode_column(reals, work, c, k, ny, n)
            total = dot(other, by_position)
            if n < ny and j < ny:
                total -= reals[h + ny * n + j] * acc[0]
            elif n >= ny and j >= ny:
                total -= reals[h + ny * ny + nz * (n - ny) + j - ny] * acc[0]
            work[forces + m * n + j] += total
            work[forces + m * (m + n) + j] += dot(other, by_rate)


@inlined
def torsion_derivatives(ints, reals, work, qd, i):
    """Add the share of body i's twisting sections: torque e_x L' + w x e_x L, L = int rho J y."""
    m, nt = at(ints, i, MODES), at(ints, i, NT)
    own = at(ints, i, OWN)
    e = at(ints, i, DERIVED)
    d = at(ints, i, COORDINATE) + at(ints, i, JOINT) + m - nt
    w = load(work, at(ints, i, WORK) + SPEED)
    b = at(ints, i, BEAM)
    spin = 0.0
    for j in range(nt):
        s = reals[b + 1 + j]
        spin += s * qd[d + j]
        u = own + OWN_SIZE * (m - nt + j)
        store(work, u + BY_TURNING, (0.0, 0.5 * s * w[2], -0.5 * s * w[1]))
        store(work, u + BY_RATE + 3, (0.0, s * w[2], -s * w[1]))
    work[e + TURNING + 5] += spin
    work[e + TURNING + 7] -= spin


@inlined
def beam_derivatives(ints, reals, work, qd, qdd, i):
    """Write what stands at OWN of body i and its wrench; add to MOMENTUM and TURNING.

    All in body axes about the body's origin; needs the body's inertia and its motion there.
    """
    m = at(ints, i, MODES)
    own = at(ints, i, OWN)
    rigid_wrench(ints, reals, work, i)
    for k in range(m * (OWN_SIZE + 3 * m)):
        work[own + k] = 0.0
    bending = at(ints, i, NY) + at(ints, i, NZ)
    nt = at(ints, i, NT)
    c = at(ints, i, BEAM) + 1 + nt + nt * nt
    k = at(ints, i, BEAM_WORK) + m
    ny, nz = at(ints, i, NY), at(ints, i, NZ)
    for _ in range(at(ints, i, POINTS)):
        point_derivatives(ints, reals, work, qd, qdd, i, c, k)
        c += 2 + bending + ny * ny + nz * nz
        k += 3 + bending
    if nt > 0:
        torsion_wrench(ints, reals, work, qd, qdd, i)
        torsion_derivatives(ints, reals, work, qd, i)
    size = 6 + m
    o = at(ints, i, INERTIA_WORK)
    forces = own + OWN_SIZE * m + 2 * m * m
    for j in range(m):
        for r in range(6):
            work[own + OWN_SIZE * j + BY_ACCELERATION + r] = work[o + size * r + 6 + j]
        for r in range(j + 1):
            both = work[o + size * (6 + r) + 6 + j]
            work[forces + m * r + j] = both
            work[forces + m * j + r] = both
