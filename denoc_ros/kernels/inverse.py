"""Inverse dynamics: outward motion, inward wrenches, O(n) (book, section 3.2)."""

from denoc_ros.kernels.compiled import inlined, kernel
from denoc_ros.kernels.internal import ARMATURE, internal_force
from denoc_ros.kernels.layout import (
    AXIS,
    BEAM_WORK,
    COORDINATE,
    FORCE,
    JOINT,
    MODES,
    POINTS,
    REAL,
    TORQUE,
    WORK,
)
from denoc_ros.kernels.motion import move_body
from denoc_ros.kernels.placement import place_beam, place_body
from denoc_ros.kernels.vector import all_finite, dot, load
from denoc_ros.kernels.wrench import body_wrench, transmit_wrench


@inlined
def outward_motion(ints, reals, work, bodies, q, qd, qdd):
    """Place and move every body and write the wrench it needs for its own motion."""
    for i in range(bodies):
        place_body(ints, reals, work, q, i)
        if ints[i, POINTS] > 0:
            place_beam(ints, reals, work, q, i)
        move_body(ints, reals, work, qd, qdd, i)
        body_wrench(ints, reals, work, qd, qdd, i)


@inlined
def joint_force(ints, reals, work, i):
    """Return S^T of the wrench on body i."""
    c = ints[i, REAL]
    o = ints[i, WORK]
    return dot(load(reals, c + AXIS), load(work, o + FORCE)) + dot(
        load(reals, c + AXIS + 3), load(work, o + TORQUE)
    )


@inlined
def inward_wrenches(ints, reals, work, bodies, out):
    """Sum wrenches towards the base and add their share along every coordinate to out."""
    for i in range(bodies - 1, -1, -1):
        j = ints[i, COORDINATE]
        if ints[i, JOINT] == 1:
            out[j] += joint_force(ints, reals, work, i)
            j += 1
        modal = ints[i, BEAM_WORK]
        for k in range(ints[i, MODES]):
            out[j + k] += work[modal + k]
        o = ints[i, WORK]
        transmit_wrench(ints, work, i, load(work, o + FORCE), load(work, o + TORQUE))


@kernel
def inverse_dynamics(ints, reals, work, diagonals, bodies, slip_rate, q, qd, qdd, out):
    """Write I q'' + h(q, q'); return whether it is finite."""
    outward_motion(ints, reals, work, bodies, q, qd, qdd)
    # element by element before out is summed up: out may be one of the arguments
    for j in range(out.shape[0]):
        out[j] = diagonals[ARMATURE, j] * qdd[j] + internal_force(diagonals, slip_rate, q, qd, j)
    inward_wrenches(ints, reals, work, bodies, out)
    return all_finite(out)


@kernel
def inverse_dynamics_rows(
    ints, reals, work, diagonals, bodies, slip_rate, q, qd, qdd, first, last, out
):
    """Do the same for rows first .. last - 1 of (k, n) states."""
    finite = True
    for k in range(first, last):
        finite &= inverse_dynamics(
            ints, reals, work, diagonals, bodies, slip_rate, q[k], qd[k], qdd[k], out[k]
        )
    return finite
