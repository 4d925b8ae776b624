"""The generalized inertia matrix by composite bodies (section 3.2), and the energies."""

from denoc_ros.kernels.body_inertia import body_inertia, transmit_inertia
from denoc_ros.kernels.compiled import inlined, kernel, rows_kernel
from denoc_ros.kernels.handle import (
    ARMATURE,
    GOOD,
    MISFIT,
    NOT_FINITE,
    STIFFNESS,
    ZERO,
    at,
    model_arrays,
)
from denoc_ros.kernels.inverse import outward_motion
from denoc_ros.kernels.layout import (
    ARM,
    AXIS,
    BLOCK,
    COLUMNS,
    COORDINATE,
    GRAVITY,
    INERTIA_WORK,
    JOINT,
    MODES,
    PARENT,
    PLACE,
    POINTS,
    REAL,
    SECTION,
    SECTION_WORK,
    VELOCITY,
    WORK,
    WORLD_POSITION,
    WORLD_ROTATION,
)
from denoc_ros.kernels.placement import place_beam, place_body
from denoc_ros.kernels.vector import add, all_finite, cross, dot, load, rotate
from denoc_ros.kernels.world import world_pose


@inlined
def column_wrench(ints, reals, work, i, column):
    """Return force and torque of a unit acceleration of body i's coordinate, and write its own."""
    size = 6 + at(ints, i, MODES)
    o = at(ints, i, INERTIA_WORK)
    if column < at(ints, i, JOINT):
        s = at(ints, i, REAL) + AXIS
        f = (0.0, 0.0, 0.0)
        n = (0.0, 0.0, 0.0)
        for k in range(6):
            x = reals[s + k]
            f = add(f, (x * work[o + k], x * work[o + size + k], x * work[o + 2 * size + k]))
            u = o + 3 * size + k
            n = add(n, (x * work[u], x * work[u + size], x * work[u + 2 * size]))
        return f, n
    u = o + 6 + column - at(ints, i, JOINT)
    return (
        (work[u], work[u + size], work[u + 2 * size]),
        (work[u + 3 * size], work[u + 4 * size], work[u + 5 * size]),
    )


@inlined
def own_entries(ints, reals, work, i, f, n, column, out):
    """Write the entries between body i's coordinate and its joint and modes."""
    j = at(ints, i, COORDINATE)
    c = j + column
    size = 6 + at(ints, i, MODES)
    o = at(ints, i, INERTIA_WORK)
    if at(ints, i, JOINT) == 1:
        s = at(ints, i, REAL) + AXIS
        u = dot(load(reals, s), f) + dot(load(reals, s + 3), n)
        out[j, c] = u
        out[c, j] = u
        j += 1
    if column >= at(ints, i, JOINT):
        u = o + size * (6 + column - at(ints, i, JOINT)) + 6
        for k in range(at(ints, i, MODES)):
            out[j + k, c] = work[u + k]


@inlined
def carrier_entries(ints, reals, work, i, f, n, c, out):
    """Write the entries between coordinate c and those of all bodies that carry body i."""
    while at(ints, i, PARENT) > 0:
        o = at(ints, i, WORK)
        p = at(ints, i, PARENT)
        f = rotate(work, o, f)
        n = add(rotate(work, o, n), cross(load(work, o + ARM), f))
        j = at(ints, p, COORDINATE)
        if at(ints, i, SECTION) > 0:
            s = at(ints, i, SECTION_WORK)
            u = s + COLUMNS
            for k in range(j + at(ints, p, JOINT), j + at(ints, p, JOINT) + at(ints, p, MODES)):
                x = dot(load(work, u), f) + dot(load(work, u + 3), n)
                out[k, c] = x
                out[c, k] = x
                u += 6
            n = add(n, cross(load(work, s + PLACE), f))
        else:
            for k in range(j + at(ints, p, JOINT), j + at(ints, p, JOINT) + at(ints, p, MODES)):
                out[k, c] = 0.0
                out[c, k] = 0.0
        if at(ints, p, JOINT) == 1:
            s = at(ints, p, REAL) + AXIS
            x = dot(load(reals, s), f) + dot(load(reals, s + 3), n)
            out[j, c] = x
            out[c, j] = x
        i = p


@inlined
def copy_block(work, o, size, block):
    """Copy the six rows and columns of an inertia into a six-row block."""
    for r in range(3):
        for c in range(3):
            work[block + 3 * r + c] = work[o + size * r + c]
            work[block + 9 + 3 * r + c] = work[o + size * r + 3 + c]
            work[block + 18 + 3 * r + c] = work[o + size * (3 + r) + 3 + c]


@kernel('int64(int64, float64[::1], float64[:, ::1])')
def inertia_matrix(handle, q, out):
    """Write the (n, n) generalized inertia matrix."""
    ints, reals, work, diagonals, bodies = model_arrays(handle)
    n = diagonals.shape[1]
    if q.shape[0] != n or out.shape[0] != n or out.shape[1] != n:
        return MISFIT
    for i in range(1, bodies + 1):
        place_body(ints, reals, work, q, i)
        if at(ints, i, POINTS) > 0:
            place_beam(ints, reals, work, q, i)
        body_inertia(ints, reals, work, i)
    out[:, :] = 0.0
    block = work.shape[0] - BLOCK
    for i in range(bodies, 0, -1):
        for column in range(at(ints, i, JOINT) + at(ints, i, MODES)):
            f, moment = column_wrench(ints, reals, work, i, column)
            own_entries(ints, reals, work, i, f, moment, column, out)
            j = at(ints, i, COORDINATE) + column
            carrier_entries(ints, reals, work, i, f, moment, j, out)
        if at(ints, i, PARENT) > 0:
            copy_block(work, at(ints, i, INERTIA_WORK), 6 + at(ints, i, MODES), block)
            transmit_inertia(ints, work, i, block)
    finite = True
    for j in range(n):
        out[j, j] += diagonals[ARMATURE, j]
        finite &= all_finite(out[j])
    return GOOD if finite else NOT_FINITE


@rows_kernel('int64(int64, float64[:, ::1], int64, int64, float64[:, :, ::1])')
def inertia_matrix_rows(handle, q, first, last, out):
    """Do the same for rows first .. last - 1 of (k, n) states; return the worst status."""
    worst = GOOD
    for k in range(first, last):
        worst = max(worst, inertia_matrix(handle, q[k], out[k]))
    return worst


@inlined
def body_kinetic(ints, work, qd, i):
    """Return the kinetic energy of body i from its own inertia and twist."""
    m = at(ints, i, MODES)
    size = 6 + m
    o = at(ints, i, INERTIA_WORK)
    u = at(ints, i, WORK)
    d = at(ints, i, COORDINATE) + at(ints, i, JOINT)
    energy = 0.0
    for r in range(size):
        x = work[u + VELOCITY + r] if r < 6 else qd[d + r - 6]
        for c in range(size):
            y = work[u + VELOCITY + c] if c < 6 else qd[d + c - 6]
            energy += 0.5 * x * work[o + size * r + c] * y
    return energy


@inlined
def body_gravity(ints, reals, work, i):
    """Return the gravity potential of body i, zero at the base origin."""
    size = 6 + at(ints, i, MODES)
    o = at(ints, i, INERTIA_WORK)
    u = at(ints, i, WORK)
    moment = (work[o + size + 5], work[o + 2 * size + 3], work[o + 4])
    position = load(work, u + WORLD_POSITION)
    g = load(reals, GRAVITY)
    return -work[o] * dot(g, position) - dot(g, rotate(work, u + WORLD_ROTATION, moment))


@kernel('int64(int64, float64[::1], float64[::1], float64[::1])')
def energies(handle, q, qd, out):
    """Write kinetic and potential energy (gravity and strain)."""
    ints, reals, work, diagonals, bodies = model_arrays(handle)
    n = diagonals.shape[1]
    if q.shape[0] != n or qd.shape[0] != n or out.shape[0] != 2:
        return MISFIT
    outward_motion(ints, reals, work, bodies, q, qd, diagonals[ZERO])
    kinetic = 0.0
    potential = 0.0
    for i in range(1, bodies + 1):
        body_inertia(ints, reals, work, i)
        world_pose(ints, work, i)
        kinetic += body_kinetic(ints, work, qd, i)
        potential += body_gravity(ints, reals, work, i)
    for j in range(n):
        kinetic += 0.5 * diagonals[ARMATURE, j] * qd[j] * qd[j]
        potential += 0.5 * diagonals[STIFFNESS, j] * q[j] * q[j]
    out[0] = kinetic
    out[1] = potential
    return GOOD if all_finite(out) else NOT_FINITE


@rows_kernel('int64(int64, float64[:, ::1], float64[:, ::1], int64, int64, float64[:, ::1])')
def energies_rows(handle, q, qd, first, last, out):
    """Do the same for rows first .. last - 1 of (k, n) states; return the worst status."""
    worst = GOOD
    for k in range(first, last):
        worst = max(worst, energies(handle, q[k], qd[k], out[k]))
    return worst
