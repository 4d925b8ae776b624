"""Twists and accelerations of frames, with their and the Jacobian's derivatives by the state.

Column j of the Jacobian of a frame is [L; T], its rates along a motion are L', T', L'', T'' and
the frame turns by w with the angular acceleration al. As positions are functions of q alone,
partial derivatives are time derivatives of columns; of rotations they differ by a Lie bracket:

    dv/dq_j = L'     dw/dq_j = T' + T x w     da/dq_j = L''    dal/dq_j = T'' + T' x w + T x al
    da/dq'_j = 2 L'  dal/dq'_j = 2 T' + T x w

An IMU reads angular velocity and specific force of its frame, along its own axes.
"""

import numpy as np

from denoc_ros.kernels.algebra.vector import (
    add,
    all_finite,
    cross,
    load,
    rotate,
    scale,
    store,
    subtract,
)
from denoc_ros.kernels.dynamics.link_motion import (
    linear_velocity,
    move_body,
    section_motion,
    section_rates,
)
from denoc_ros.kernels.dynamics.placement import place_body
from denoc_ros.kernels.dynamics.section_columns import (
    column_change,
    mode_turn,
    turning_rates,
    unit,
)
from denoc_ros.kernels.dynamics.states import over_rows
from denoc_ros.kernels.dynamics.world import section_place, world_pose
from denoc_ros.kernels.jit.compiled import inlined, shared
from denoc_ros.kernels.jit.handle import (
    GOOD,
    NOT_FINITE,
    at,
    coordinates,
    model_arrays,
)
from denoc_ros.kernels.layout import layout as at_

ZERO = (0.0, 0.0, 0.0)


@inlined
def seen(work, u, v, v1, v2, w, al):
    """Return a vector given in a body's axes, and its two rates, in base axes."""
    v = rotate(work, u, v)
    v1 = rotate(work, u, v1)
    turning = cross(w, v)
    second = add(rotate(work, u, v2), add(scale(2.0, cross(w, v1)), cross(al, v)))
    return v, add(v1, turning), add(second, cross(w, turning))


@inlined
def weighted(v, x, y, z):
    """Return the sum of three vectors times the elements of one."""
    return add(add(scale(v[0], x), scale(v[1], y)), scale(v[2], z))


@inlined
def carried(slide, turn, arm):
    """Return the linear column at a point, and its rates, from those at another and the arm."""
    first = add(slide[1], add(cross(turn[1], arm[0]), cross(turn[0], arm[1])))
    second = add(cross(turn[2], arm[0]), cross(turn[0], arm[2]))
    second = add(slide[2], add(second, scale(2.0, cross(turn[1], arm[1]))))
    return add(slide[0], cross(turn[0], arm[0])), first, second


@inlined
def body_state(work, o):
    """Return position, velocity, acceleration, w and al of a row, base axes, gravity included."""
    r = o + at_.WORLD_ROTATION
    return (
        load(work, o + at_.WORLD_POSITION),
        rotate(work, r, load(work, o + at_.VELOCITY)),
        rotate(work, r, load(work, o + at_.ACCELERATION)),
        rotate(work, r, load(work, o + at_.ANGULAR_VELOCITY)),
        rotate(work, r, load(work, o + at_.ANGULAR_ACCELERATION)),
    )


@inlined
def section_state(topology, constants, work, qd, qdd, i):
    """Return position, velocity and acceleration of the section that carries row i, base axes."""
    p = at(topology, i, at_.PARENT)
    u = at(topology, p, at_.WORK)
    k = at(topology, i, at_.SECTION_WORK)
    w = load(work, u + at_.ANGULAR_VELOCITY)
    v = add(load(work, u + at_.VELOCITY), cross(w, load(work, k + at_.SECTION_POSITION)))
    _w, a, _al = section_motion(
        topology,
        constants,
        work,
        qd,
        qdd,
        i,
        w,
        load(work, u + at_.ACCELERATION),
        load(work, u + at_.ANGULAR_ACCELERATION),
    )
    c = k + at_.COLUMNS
    d = at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT)
    for j in range(d, d + at(topology, p, at_.MODES)):
        v = add(v, scale(qd[j], load(work, c)))
        c += 6
    r = u + at_.WORLD_ROTATION
    return section_place(topology, work, i), rotate(work, r, v), rotate(work, r, a)


@inlined
def joint_columns(write, topology, constants, work, i, frame, out, n):
    """Write the columns of a frame by the joint of body i."""
    o = at(topology, i, at_.WORK)
    position, v, a, w, al = body_state(work, o)
    arm = (subtract(frame[0], position), subtract(frame[1], v), subtract(frame[2], a))
    s = at(topology, i, at_.BODY_CONSTANTS) + at_.AXIS
    r = o + at_.WORLD_ROTATION
    slide = seen(work, r, load(constants, s), ZERO, ZERO, w, al)
    turn = seen(work, r, load(constants, s + 3), ZERO, ZERO, w, al)
    write(
        out,
        n,
        at(topology, i, at_.COORDINATE),
        carried(slide, turn, arm),
        turn,
        frame[3],
        frame[4],
    )


@inlined
def section_columns(write, topology, constants, work, qd, qdd, i, frame, out, n):
    """Write the columns of a frame by the amplitudes of the beam that carries row i."""
    p = at(topology, i, at_.PARENT)
    u = at(topology, p, at_.WORK)
    position, v, a = section_state(topology, constants, work, qd, qdd, i)
    arm = (subtract(frame[0], position), subtract(frame[1], v), subtract(frame[2], a))
    _position, _v, _a, w, al = body_state(work, u)
    rate, _bend = section_rates(topology, constants, qd, i)
    rate_up, _bend = section_rates(topology, constants, qdd, i)
    o = at(topology, i, at_.SECTION_WORK)
    k, phi = o + at_.COEFFICIENTS, load(work, o + at_.ROTATION_VECTOR)
    turn_x = turning_rates(work, k, phi, rate, rate_up, unit(0))
    turn_y = turning_rates(work, k, phi, rate, rate_up, unit(1))
    turn_z = turning_rates(work, k, phi, rate, rate_up, unit(2))
    d = at(topology, p, at_.COORDINATE) + at(topology, p, at_.JOINT)
    c = o + at_.COLUMNS
    r = u + at_.WORLD_ROTATION
    for j in range(at(topology, p, at_.MODES)):
        theta = mode_turn(topology, constants, i, j)
        slide = seen(
            work, r, load(work, c),
            column_change(topology, constants, i, j, qd),
            column_change(topology, constants, i, j, qdd), w, al,
        )  # fmt: skip
        turn = seen(
            work, r,
            weighted(theta, turn_x[0], turn_y[0], turn_z[0]),
            weighted(theta, turn_x[1], turn_y[1], turn_z[1]),
            weighted(theta, turn_x[2], turn_y[2], turn_z[2]), w, al,
        )  # fmt: skip
        write(out, n, d + j, carried(slide, turn, arm), turn, frame[3], frame[4])
        c += 6


@inlined
def move_world(topology, constants, work, bodies, q, qd, qdd, i):
    """Place and move every body, and row i if it is a frame; return the motion of row i."""
    for k in range(1, bodies + 1):
        place_body(topology, constants, work, q, k)
        world_pose(topology, work, k)
        move_body(topology, constants, work, qd, qdd, k)
        linear_velocity(topology, constants, work, qd, k)
    if i > bodies:
        place_body(topology, constants, work, q, i)
        world_pose(topology, work, i)
        move_body(topology, constants, work, qd, qdd, i)
        linear_velocity(topology, constants, work, qd, i)
    return body_state(work, at(topology, i, at_.WORK))


@inlined
def write_columns(write, topology, constants, work, qd, qdd, i, frame, out, n):
    """Let `write` write every coordinate's columns of frame i, which moves as `frame` says."""
    while i > 0:
        if at(topology, i, at_.JOINT) == 1:
            joint_columns(write, topology, constants, work, i, frame, out, n)
        if at(topology, i, at_.SECTION) > 0:
            section_columns(write, topology, constants, work, qd, qdd, i, frame, out, n)
        i = at(topology, i, at_.PARENT)


@inlined
def walk(write, blocks, handle, q, qd, qdd, frame, out):
    """Write the blocks (6, n) that `write` makes of every column of a frame's Jacobian."""
    i = np.int64(frame[0])
    topology, constants, work, _diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    motion = move_world(topology, constants, work, bodies, q, qd, qdd, i)
    for k in range(6 * n * blocks):
        out[k] = 0.0
    write_columns(write, topology, constants, work, qd, qdd, i, motion, out, n)
    return GOOD


@inlined
def put(out, n, block, j, linear, angular):
    """Write column j of a block (6, n)."""
    o = 6 * n * block + j
    for k in range(3):
        out[o + n * k] = linear[k]
        out[o + n * (3 + k)] = angular[k]


@inlined
def write_rate(out, n, j, linear, turn, _w, _al):
    """Write a column of the Jacobian's rate."""
    put(out, n, 0, j, linear[1], turn[1])


@inlined
def write_velocity(out, n, j, linear, turn, w, _al):
    """Write a column of the twist's derivatives by q and q'."""
    put(out, n, 0, j, linear[1], add(turn[1], cross(turn[0], w)))
    put(out, n, 1, j, linear[0], turn[0])


@inlined
def write_acceleration(out, n, j, linear, turn, w, al):
    """Write a column of the acceleration's derivatives by q, q' and q''."""
    angular = add(turn[2], add(cross(turn[1], w), cross(turn[0], al)))
    put(out, n, 0, j, linear[2], angular)
    angular = add(scale(2.0, turn[1]), cross(turn[0], w))
    put(out, n, 1, j, scale(2.0, linear[1]), angular)
    put(out, n, 2, j, linear[0], turn[0])


# each takes a frame as a number, its row of the model


@shared
def find_motion(handle, q, qd, qdd, frame, out):
    """Write twist and classical acceleration (2, 6) of a frame: linear first, base axes."""
    topology, constants, work, _diagonals, bodies = model_arrays(handle)
    i = np.int64(frame[0])
    _position, v, a, w, al = move_world(topology, constants, work, bodies, q, qd, qdd, i)
    a = add(a, load(work, at_.BASE_GRAVITY))
    for k in range(3):
        out[k], out[3 + k], out[6 + k], out[9 + k] = v[k], w[k], a[k], al[k]
    return GOOD


@shared
def find_jacobian_rate(handle, q, qd, qdd, frame, out):
    """Write the rate (6, n) of a frame's Jacobian along q'."""
    return walk(write_rate, 1, handle, q, qd, qdd, frame, out)


@shared
def find_velocity(handle, q, qd, qdd, frame, out):
    """Write the derivatives (2, 6, n) of a frame's twist by q and q'."""
    return walk(write_velocity, 2, handle, q, qd, qdd, frame, out)


@shared
def find_acceleration(handle, q, qd, qdd, frame, out):
    """Write the derivatives (3, 6, n) of a frame's acceleration by q, q' and q''."""
    return walk(write_acceleration, 3, handle, q, qd, qdd, frame, out)


frame_motion_rows = over_rows('frame_motion_rows', find_motion, 5)


frame_jacobian_rate_rows = over_rows('frame_jacobian_rate_rows', find_jacobian_rate, 5)


frame_velocity_derivatives_rows = over_rows('frame_velocity_derivatives_rows', find_velocity, 5)


frame_acceleration_derivatives_rows = over_rows(
    'frame_acceleration_derivatives_rows', find_acceleration, 5
)


@inlined
def place_and_move(topology, constants, work, q, qd, qdd, i):
    """Place row i and write its motion; its carrier's must stand there already."""
    place_body(topology, constants, work, q, i)
    move_body(topology, constants, work, qd, qdd, i)


@shared
def find_inertial_values(handle, q, qd, qdd, frames, out):
    """Write the readings (frames, 6): angular velocity, then acceleration less gravity.

    frames: how many there are, then their rows of the model.
    """
    topology, constants, work, _diagonals, bodies = model_arrays(handle)
    count = np.int64(frames[0])
    for i in range(1, bodies + 1):
        place_and_move(topology, constants, work, q, qd, qdd, i)
    for k in range(count):
        i = np.int64(frames[1 + k])
        if i > bodies:
            place_and_move(topology, constants, work, q, qd, qdd, i)
        o = at(topology, i, at_.WORK)
        # gravity is an acceleration of the base, upwards
        store(out, 6 * k, load(work, o + at_.ANGULAR_VELOCITY))
        store(out, 6 * k + 3, load(work, o + at_.ACCELERATION))
    return GOOD if all_finite(out, 6 * count) else NOT_FINITE


inertial_values_rows = over_rows('inertial_values_rows', find_inertial_values, 5)
