"""Sums over composite bodies: the generalized inertia matrix (section 3.2), energies, momentum.

Momentum, mass and first moment of all bodies together are in base axes about the base's origin.
"""

from numba import types

from denoc_ros.kernels.algebra.joint_block import six
from denoc_ros.kernels.algebra.rotation import write_sines
from denoc_ros.kernels.algebra.vector import (
    accumulate,
    add,
    all_finite,
    cross,
    dot,
    load,
    rotate,
    scale,
    store,
    symmetric,
    turned,
)
from denoc_ros.kernels.dynamics.body_inertia import flexible_inertia
from denoc_ros.kernels.dynamics.inverse import outward_motion
from denoc_ros.kernels.dynamics.link_motion import linear_velocity
from denoc_ros.kernels.dynamics.placement import place_by_sines, place_modes
from denoc_ros.kernels.dynamics.states import over_rows
from denoc_ros.kernels.dynamics.world import world_pose
from denoc_ros.kernels.jit import handle as rec_
from denoc_ros.kernels.jit.array_object import (
    READABLE,
    WRITABLE,
    array_object,
    content,
    is_matrix,
    is_vector,
)
from denoc_ros.kernels.jit.compiled import inlined, kernel, shared
from denoc_ros.kernels.jit.handle import (
    GOOD,
    MISFIT,
    NOT_FINITE,
    ZERO,
    at,
    coordinates,
    model_arrays,
)
from denoc_ros.kernels.layout import layout as at_
from denoc_ros.kernels.springs.spring_torque import spring_energy


@inlined
def own_composite(topology, constants, work, i):
    """Write mass, moment and spin of body i alone, and its (6 + m) inertia where flexible."""
    k = at(topology, i, at_.WORK) + at_.COMPOSITE
    if at(topology, i, at_.MODES) == 0:
        c = at(topology, i, at_.BODY_CONSTANTS) + at_.MASS
        for n in range(10):
            work[k + n] = constants[c + n]
        return
    flexible_inertia(topology, constants, work, i)
    size = 6 + at(topology, i, at_.MODES)
    o = at(topology, i, at_.INERTIA_WORK)
    work[k] = work[o]
    store(work, k + 1, (work[o + size + 5], work[o + 2 * size + 3], work[o + 4]))
    o += 3 * size + 3
    store(work, k + 4, load(work, o))
    store(work, k + 7, (work[o + size + 1], work[o + size + 2], work[o + 2 * size + 2]))


@inlined
def rigid_wrench(work, k, linear, angular):
    """Return force and torque of a composite body, at offset k, for an acceleration."""
    moment = load(work, k + 1)
    force = add(scale(work[k], linear), cross(angular, moment))
    return force, add(cross(moment, linear), symmetric(work, k + 4, angular))


@inlined
def shifted_spin(spin, mass, moment, r):
    """Return a spin (6) about a point that lies -r from its own; moment is about the old one."""
    hx, hy, hz = moment
    x, y, z = r
    d = 2.0 * dot(r, moment) + mass * dot(r, r)
    return (
        spin[0] + d - x * (2.0 * hx + mass * x),
        spin[1] - x * hy - hx * y - mass * x * y,
        spin[2] - x * hz - hx * z - mass * x * z,
        spin[3] + d - y * (2.0 * hy + mass * y),
        spin[4] - y * hz - hy * z - mass * y * z,
        spin[5] + d - z * (2.0 * hz + mass * z),
    )


@inlined
def modal_entries(topology, work, i, block):
    """Add to the modes of row i's carrier the composite at offset block, about the section."""
    p = at(topology, i, at_.PARENT)
    size = 6 + at(topology, p, at_.MODES)
    o = at(topology, p, at_.INERTIA_WORK)
    place = load(work, at(topology, i, at_.SECTION_WORK) + at_.SECTION_POSITION)
    columns = at(topology, i, at_.SECTION_WORK) + at_.COLUMNS
    for j in range(at(topology, p, at_.MODES)):
        u = columns + 6 * j
        f, n = rigid_wrench(work, block, load(work, u), load(work, u + 3))
        for k in range(j, at(topology, p, at_.MODES)):
            u = columns + 6 * k
            both = dot(load(work, u), f) + dot(load(work, u + 3), n)
            work[o + (6 + j) * size + 6 + k] += both
        n = add(n, cross(place, f))
        for k in range(3):
            work[o + k * size + 6 + j] += f[k]
            work[o + (3 + k) * size + 6 + j] += n[k]


@inlined
def transmit_composite(topology, work, i):
    """Add row i's composite body to its carrier's."""
    o = at(topology, i, at_.WORK)
    k = o + at_.COMPOSITE
    mass = work[k]
    r = load(work, o + at_.ARM)
    moment = rotate(work, o, load(work, k + 1))
    spin = shifted_spin(
        turned(six(work, k + 4), load(work, o), load(work, o + 3), load(work, o + 6)),
        mass,
        moment,
        r,
    )
    moment = add(moment, scale(mass, r))
    if at(topology, i, at_.SECTION) > 0:
        work[at_.BLOCK] = mass
        store(work, at_.BLOCK + 1, moment)
        store(work, at_.BLOCK + 4, (spin[0], spin[1], spin[2]))
        store(work, at_.BLOCK + 7, (spin[3], spin[4], spin[5]))
        modal_entries(topology, work, i, at_.BLOCK)
        r = load(work, at(topology, i, at_.SECTION_WORK) + at_.SECTION_POSITION)
        spin = shifted_spin(spin, mass, moment, r)
        moment = add(moment, scale(mass, r))
    k = at(topology, at(topology, i, at_.PARENT), at_.WORK) + at_.COMPOSITE
    work[k] += mass
    accumulate(work, k + 1, moment)
    accumulate(work, k + 4, (spin[0], spin[1], spin[2]))
    accumulate(work, k + 7, (spin[3], spin[4], spin[5]))


@inlined
def carrier_entries(topology, constants, work, i, f, n, c, size, out):
    """Write the entries between coordinate c and those of all bodies that carry body i.

    out is the (size, size) matrix, row by row.
    """
    p = at(topology, i, at_.PARENT)
    while p > 0:
        o = at(topology, i, at_.WORK)
        f = rotate(work, o, f)
        n = add(rotate(work, o, n), cross(load(work, o + at_.ARM), f))
        j = at(topology, p, at_.COORDINATE)
        if at(topology, i, at_.SECTION) > 0:
            s = at(topology, i, at_.SECTION_WORK)
            u = s + at_.COLUMNS
            d = j + at(topology, p, at_.JOINT)
            for k in range(d, d + at(topology, p, at_.MODES)):
                x = dot(load(work, u), f) + dot(load(work, u + 3), n)
                out[size * k + c] = x
                out[size * c + k] = x
                u += 6
            n = add(n, cross(load(work, s + at_.SECTION_POSITION), f))
        if at(topology, p, at_.MOTION) == at_.REVOLUTE_Z:
            out[size * j + c] = n[2]
            out[size * c + j] = n[2]
        elif at(topology, p, at_.JOINT) == 1:
            s = at(topology, p, at_.BODY_CONSTANTS) + at_.AXIS
            x = dot(load(constants, s), f) + dot(load(constants, s + 3), n)
            out[size * j + c] = x
            out[size * c + j] = x
        i = p
        p = at(topology, i, at_.PARENT)


@inlined
def joint_column(topology, constants, work, i, size, out):
    """Write the column of body i's joint."""
    k = at(topology, i, at_.WORK) + at_.COMPOSITE
    j = at(topology, i, at_.COORDINATE)
    if at(topology, i, at_.MOTION) == at_.REVOLUTE_Z:
        f = (-work[k + 2], work[k + 1], 0.0)
        n = (work[k + 6], work[k + 8], work[k + 9])
        out[(size + 1) * j] = n[2]
    else:
        s = at(topology, i, at_.BODY_CONSTANTS) + at_.AXIS
        slide = load(constants, s)
        turn = load(constants, s + 3)
        f, n = rigid_wrench(work, k, slide, turn)
        out[(size + 1) * j] = dot(slide, f) + dot(turn, n)
    carrier_entries(topology, constants, work, i, f, n, j, size, out)


@shared
def modal_column(topology, constants, work, i, column, size, out):
    """Write the column of one of body i's modes."""
    own = 6 + at(topology, i, at_.MODES)
    o = at(topology, i, at_.INERTIA_WORK)
    j = at(topology, i, at_.COORDINATE) + at(topology, i, at_.JOINT)
    c = j + column
    u = o + 6 + column
    f = (work[u], work[u + own], work[u + 2 * own])
    n = (work[u + 3 * own], work[u + 4 * own], work[u + 5 * own])
    if at(topology, i, at_.JOINT) == 1:
        s = at(topology, i, at_.BODY_CONSTANTS) + at_.AXIS
        x = dot(load(constants, s), f) + dot(load(constants, s + 3), n)
        out[size * (j - 1) + c] = x
        out[size * c + j - 1] = x
    for k in range(column + 1):
        x = work[o + own * (6 + k) + 6 + column]
        out[size * (j + k) + c] = x
        out[size * c + j + k] = x
    carrier_entries(topology, constants, work, i, f, n, c, size, out)


@shared
def find_inertia(handle, q, out):
    """Write the (n, n) generalized inertia matrix."""
    topology, constants, work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    sines, cosines = diagonals[rec_.SINE], diagonals[rec_.COSINE]
    write_sines(q, n, sines, cosines)
    for i in range(1, bodies + 1):
        place_by_sines(topology, constants, work, q, sines, cosines, i)
        place_modes(topology, constants, work, q, i)
        own_composite(topology, constants, work, i)
    for j in range(n * n):
        out[j] = 0.0
    for i in range(bodies, 0, -1):
        if at(topology, i, at_.JOINT) == 1:
            joint_column(topology, constants, work, i, n, out)
        for column in range(at(topology, i, at_.MODES)):
            modal_column(topology, constants, work, i, column, n, out)
        if at(topology, i, at_.PARENT) > 0:
            transmit_composite(topology, work, i)
    for j in range(n):
        out[(n + 1) * j] += diagonals[rec_.ARMATURE][j]
    return GOOD if all_finite(out, n * n) else NOT_FINITE


@kernel(types.int64(types.int64, array_object, array_object))
def inertia_matrix(handle, q, out):
    """Write the (n, n) generalized inertia matrix."""
    n = coordinates(handle)
    if not (is_vector(handle, q, n, READABLE) and is_matrix(handle, out, n, WRITABLE)):
        return MISFIT
    return find_inertia(handle, content(q), content(out))


inertia_matrix_rows = over_rows('inertia_matrix_rows', find_inertia, 2)


@inlined
def body_kinetic(topology, work, qd, i):
    """Return the kinetic energy of body i alone."""
    u = at(topology, i, at_.WORK)
    k = u + at_.COMPOSITE
    v = load(work, u + at_.VELOCITY)
    w = load(work, u + at_.ANGULAR_VELOCITY)
    f, n = rigid_wrench(work, k, v, w)
    energy = 0.5 * (dot(v, f) + dot(w, n))
    m = at(topology, i, at_.MODES)
    size = 6 + m
    o = at(topology, i, at_.INERTIA_WORK)
    d = at(topology, i, at_.COORDINATE) + at(topology, i, at_.JOINT)
    for r in range(m):
        momentum = 0.0
        for c in range(3):
            momentum += work[o + size * c + 6 + r] * v[c]
            momentum += work[o + size * (3 + c) + 6 + r] * w[c]
        momentum += 0.5 * work[o + (size + 1) * (6 + r)] * qd[d + r]
        for c in range(r + 1, m):
            momentum += work[o + size * (6 + r) + 6 + c] * qd[d + c]
        energy += qd[d + r] * momentum
    return energy


@inlined
def body_gravity(topology, constants, work, i):
    """Return the gravity potential of body i alone, zero at the base origin."""
    u = at(topology, i, at_.WORK)
    k = u + at_.COMPOSITE
    g = load(work, at_.BASE_GRAVITY)
    position = load(work, u + at_.WORLD_POSITION)
    moment = rotate(work, u + at_.WORLD_ROTATION, load(work, k + 1))
    return -work[k] * dot(g, position) - dot(g, moment)


@shared
def find_energies(handle, q, qd, out):
    """Write kinetic and potential energy (gravity and strain)."""
    topology, constants, work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    outward_motion(n, topology, constants, work, diagonals, bodies, q, qd, diagonals[rec_.ZERO])
    kinetic = 0.0
    potential = 0.0
    for i in range(1, bodies + 1):
        own_composite(topology, constants, work, i)
        linear_velocity(topology, constants, work, qd, i)
        world_pose(topology, work, i)
        kinetic += body_kinetic(topology, work, qd, i)
        potential += body_gravity(topology, constants, work, i)
    for j in range(n):
        kinetic += 0.5 * diagonals[rec_.ARMATURE][j] * qd[j] * qd[j]
        potential += spring_energy(diagonals, q, j)
    out[0] = kinetic
    out[1] = potential
    return GOOD if all_finite(out, 2) else NOT_FINITE


@kernel(types.int64(types.int64, array_object, array_object, array_object))
def energies(handle, q, qd, out):
    """Write kinetic and potential energy (gravity and strain)."""
    n = coordinates(handle)
    if not (
        is_vector(handle, q, n, READABLE)
        and is_vector(handle, qd, n, READABLE)
        and is_vector(handle, out, 2, WRITABLE)
    ):
        return MISFIT
    return find_energies(handle, content(q), content(qd), content(out))


energies_rows = over_rows('energies_rows', find_energies, 3)


LINEAR = 0  # (3) linear momentum
ANGULAR = 3  # (3) angular momentum
MASS = 6
FIRST_MOMENT = 7  # (3) mass times centre of mass
MOMENTUM_SIZE = 10


@inlined
def body_momentum(topology, work, qd, i):
    """Return linear and angular momentum of body i alone, body axes, about its origin."""
    u = at(topology, i, at_.WORK)
    p, turning = rigid_wrench(
        work, u + at_.COMPOSITE, load(work, u + at_.VELOCITY), load(work, u + at_.ANGULAR_VELOCITY)
    )
    m = at(topology, i, at_.MODES)
    size = 6 + m
    d = at(topology, i, at_.COORDINATE) + at(topology, i, at_.JOINT)
    for r in range(m):
        c = at(topology, i, at_.INERTIA_WORK) + 6 + r
        p = add(p, scale(qd[d + r], (work[c], work[c + size], work[c + 2 * size])))
        c += 3 * size
        turning = add(turning, scale(qd[d + r], (work[c], work[c + size], work[c + 2 * size])))
    return p, turning


@shared
def find_momentum(handle, q, qd, out):
    """Write momentum, mass and first moment (10)."""
    topology, constants, work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    outward_motion(n, topology, constants, work, diagonals, bodies, q, qd, diagonals[ZERO])
    for k in range(MOMENTUM_SIZE):
        out[k] = 0.0
    for i in range(1, bodies + 1):
        own_composite(topology, constants, work, i)
        linear_velocity(topology, constants, work, qd, i)
        world_pose(topology, work, i)
        u = at(topology, i, at_.WORK)
        turn, x = u + at_.WORLD_ROTATION, load(work, u + at_.WORLD_POSITION)
        p, turning = body_momentum(topology, work, qd, i)
        p = rotate(work, turn, p)
        accumulate(out, LINEAR, p)
        accumulate(out, ANGULAR, add(rotate(work, turn, turning), cross(x, p)))
        mass = work[u + at_.COMPOSITE]
        out[MASS] += mass
        moment = rotate(work, turn, load(work, u + at_.COMPOSITE + 1))
        accumulate(out, FIRST_MOMENT, add(moment, scale(mass, x)))
    return GOOD if all_finite(out, MOMENTUM_SIZE) else NOT_FINITE


momentum_rows = over_rows('momentum_rows', find_momentum, 3)
