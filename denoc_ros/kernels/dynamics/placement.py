"""Outward pass of positions of sections, bodies and beam points (dynamics.md)."""

from denoc_ros.kernels.algebra.rotation import exponential_coefficients, sine_cosine, square_plus
from denoc_ros.kernels.algebra.vector import add, load, rotate, scale, store
from denoc_ros.kernels.dynamics.component_modes import (
    move_components,
    place_component_section,
    place_components,
)
from denoc_ros.kernels.jit.compiled import inlined
from denoc_ros.kernels.jit.handle import at
from denoc_ros.kernels.layout import layout as at_


@inlined
def place_plane(constants, s, h, slope, q, coordinate, count, work, column):
    """Return deflection, slope and foreshortening of one bending plane at a section.

    Writes the axial entry -(H d)_j of each mode's linear column; s, h and slope are offsets of
    the section's constants in constants, column that of the first mode's columns in work.
    """
    deflection = 0.0
    turn = 0.0
    shortening = 0.0
    for j in range(count):
        d = q[coordinate + j]
        deflection += constants[s + j] * d
        turn += constants[slope + j] * d
        hd = 0.0
        for k in range(count):
            hd += constants[h + count * j + k] * q[coordinate + k]
        shortening += d * hd
        work[column + 6 * j] = -hd
    return deflection, turn, 0.5 * shortening


@inlined
def place_section(topology, constants, work, q, i):
    """Place the section that carries row i: position, rotation and the columns [B; J Theta]."""
    p = at(topology, i, at_.PARENT)
    if at(topology, p, at_.COMPONENTS) > 0:
        place_component_section(topology, constants, work, q, i)
        return
    ny = at(topology, p, at_.NY)
    nz = at(topology, p, at_.NZ)
    nt = at(topology, p, at_.NT)
    c = at(topology, i, at_.SECTION)
    o = at(topology, i, at_.SECTION_WORK)
    d = at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT)
    y = c + 1
    slope = y + ny + nz
    twist = slope + ny + nz
    h = twist + nt
    columns = o + at_.COLUMNS
    u, du, short_y = place_plane(constants, y, h, slope, q, d, ny, work, columns)
    w, dw, short_z = place_plane(
        constants, y + ny, h + ny * ny, slope + ny, q, d + ny, nz, work, columns + 6 * ny
    )
    beta = 0.0
    for j in range(nt):
        beta += constants[twist + j] * q[d + ny + nz + j]
    phi = (beta, -dw, du)
    a, b, e, db, de = exponential_coefficients(beta * beta + dw * dw + du * du)
    store(work, o + at_.SECTION_POSITION, (constants[c] - short_y - short_z, u, w))
    store(work, o + at_.ROTATION_VECTOR, phi)
    k = o + at_.COEFFICIENTS
    work[k] = b
    work[k + 1] = e
    work[k + 2] = db
    work[k + 3] = de
    turn = o + at_.SECTION_ROTATION
    square_plus(b, e, phi, work, turn)
    for j in range(ny):
        s = constants[slope + j]
        k = columns + 6 * j
        work[k + 1] = constants[y + j]
        work[k + 2] = 0.0
        store(work, k + 3, (s * work[turn + 2], s * work[turn + 5], s * work[turn + 8]))
    for j in range(ny, ny + nz):
        s = -constants[slope + j]
        k = columns + 6 * j
        work[k + 1] = 0.0
        work[k + 2] = constants[y + j]
        store(work, k + 3, (s * work[turn + 1], s * work[turn + 4], s * work[turn + 7]))
    for j in range(nt):
        s = constants[twist + j]
        k = columns + 6 * (ny + nz + j)
        store(work, k, (0.0, 0.0, 0.0))
        store(work, k + 3, (s * work[turn], s * work[turn + 3], s * work[turn + 6]))
    square_plus(a, b, phi, work, turn)


@inlined
def multiply(a, o, b, p, out, r):
    """Write A B, all 3 x 3 row-major at offsets o, p, r."""
    for i in range(3):
        for j in range(3):
            out[r + 3 * i + j] = (
                a[o + 3 * i] * b[p + j]
                + a[o + 3 * i + 1] * b[p + 3 + j]
                + a[o + 3 * i + 2] * b[p + 6 + j]
            )


@inlined
def turned_row(row, sine, cosine):
    """Return a row of R R_z."""
    x, y, z = row
    return cosine * x + sine * y, cosine * y - sine * x, z


@inlined
def swept(constants, o, sine, rest):
    """Factors of sin q and 1 - cos q of three elements at offset o of a pose."""
    first, second = load(constants, o + at_.POSE_SINE), load(constants, o + at_.POSE_VERSINE)
    return add(load(constants, o), add(scale(sine, first), scale(rest, second)))


@inlined
def combined(work, o, x, y, z):
    """Return the sum of three rows times the elements at offset o of work."""
    return add(scale(work[o], x), add(scale(work[o + 1], y), scale(work[o + 2], z)))


@inlined
def place_turned(topology, constants, work, q, sine, cosine, i):
    """Place row i on its carrier, given the sine and cosine of its joint."""
    c = at(topology, i, at_.BODY_CONSTANTS) + at_.POSE_CONSTANT
    o = at(topology, i, at_.WORK)
    motion = at(topology, i, at_.MOTION)
    x, y, z = load(constants, c), load(constants, c + 3), load(constants, c + 6)
    arm = load(constants, c + at_.ARM)
    if motion == at_.REVOLUTE_Z:
        x = turned_row(x, sine, cosine)
        y = turned_row(y, sine, cosine)
        z = turned_row(z, sine, cosine)
    elif motion == at_.REVOLUTE:
        rest = 1.0 - cosine
        x, y = swept(constants, c, sine, rest), swept(constants, c + 3, sine, rest)
        z, arm = swept(constants, c + 6, sine, rest), swept(constants, c + 9, sine, rest)
    elif motion == at_.PRISMATIC:
        arm = add(
            arm,
            scale(
                q[at(topology, i, at_.COORDINATE)], load(constants, c + at_.POSE_SINE + at_.ARM)
            ),
        )
    if at(topology, i, at_.SECTION) > 0:
        place_section(topology, constants, work, q, i)
        turn = at(topology, i, at_.SECTION_WORK) + at_.SECTION_ROTATION
        x, y, z = (
            combined(work, turn, x, y, z),
            combined(work, turn + 3, x, y, z),
            combined(work, turn + 6, x, y, z),
        )
        arm = rotate(work, turn, arm)
    store(work, o, x)
    store(work, o + 3, y)
    store(work, o + 6, z)
    store(work, o + at_.ARM, arm)


@inlined
def turns(topology, i):
    """Say whether row i turns about an axis."""
    return (
        at(topology, i, at_.MOTION) == at_.REVOLUTE_Z
        or at(topology, i, at_.MOTION) == at_.REVOLUTE
    )


@inlined
def place_body(topology, constants, work, q, i):
    """Place row i on its carrier: rotation, and arm from the section to the body origin."""
    sine, cosine = 0.0, 1.0
    if turns(topology, i):
        sine, cosine = sine_cosine(q[at(topology, i, at_.COORDINATE)])
    place_turned(topology, constants, work, q, sine, cosine, i)


@inlined
def place_by_sines(topology, constants, work, q, sines, cosines, i):
    """Place row i as :func:`place_body` does, given the sines and cosines of all coordinates."""
    sine, cosine = 0.0, 1.0
    if turns(topology, i):
        sine, cosine = (
            sines[at(topology, i, at_.COORDINATE)],
            cosines[at(topology, i, at_.COORDINATE)],
        )
    place_turned(topology, constants, work, q, sine, cosine, i)


@inlined
def place_beam(topology, constants, work, q, i):
    """Place the integration points of body i's beam and their products H d."""
    ny = at(topology, i, at_.NY)
    nz = at(topology, i, at_.NZ)
    nt = at(topology, i, at_.NT)
    d = at(topology, i, at_.COORDINATE) + at(topology, i, at_.JOINT)
    c = at(topology, i, at_.BEAM) + 1 + nt + nt * nt
    o = at(topology, i, at_.BEAM_WORK) + at(topology, i, at_.MODES)
    for _ in range(at(topology, i, at_.POINTS)):
        x = constants[c + 1]
        y = 0.0
        z = 0.0
        s = c + 2
        h = s + ny + nz
        for j in range(ny):
            y += constants[s + j] * q[d + j]
            hd = 0.0
            for k in range(ny):
                hd += constants[h + ny * j + k] * q[d + k]
            work[o + 3 + j] = hd
            x -= 0.5 * hd * q[d + j]
        s += ny
        h += ny * ny
        for j in range(nz):
            z += constants[s + j] * q[d + ny + j]
            hd = 0.0
            for k in range(nz):
                hd += constants[h + nz * j + k] * q[d + ny + k]
            work[o + 3 + ny + j] = hd
            x -= 0.5 * hd * q[d + ny + j]
        store(work, o, (x, y, z))
        c = h + nz * nz
        o += 3 + ny + nz


@inlined
def place_modes(topology, constants, work, q, i):
    """Place the integration points of body i, where it has modes."""
    if at(topology, i, at_.POINTS) > 0:
        if at(topology, i, at_.COMPONENTS) > 0:
            place_components(topology, constants, work, q, i)
        else:
            place_beam(topology, constants, work, q, i)


@inlined
def move_modes(topology, constants, work, q, qd, qdd, i):
    """Place the points of body i, with what component modes alone move them."""
    if at(topology, i, at_.COMPONENTS) > 0:
        move_components(topology, constants, work, q, qd, qdd, i)
    else:
        place_modes(topology, constants, work, q, i)
