"""Inverse dynamics: outward motion, inward wrenches, O(n) (book, section 3.2)."""

from denoc_ros.kernels.algebra.rotation import write_sines
from denoc_ros.kernels.algebra.vector import all_finite, dot, load
from denoc_ros.kernels.dynamics.link_motion import move_body
from denoc_ros.kernels.dynamics.placement import place_beam, place_by_sines
from denoc_ros.kernels.dynamics.states import over_rows, vector_of_state
from denoc_ros.kernels.dynamics.wrench import body_wrench, transmit_wrench
from denoc_ros.kernels.jit import handle as rec_
from denoc_ros.kernels.jit.compiled import inlined, shared
from denoc_ros.kernels.jit.handle import (
    GOOD,
    NOT_FINITE,
    at,
    coordinates,
    model_arrays,
)
from denoc_ros.kernels.layout import layout as at_
from denoc_ros.kernels.springs.spring_torque import internal_force


@inlined
def outward_motion(n, topology, constants, work, diagonals, bodies, q, qd, qdd):
    """Place and move every body and write the wrench it needs for its own motion."""
    sines, cosines = diagonals[rec_.SINE], diagonals[rec_.COSINE]
    write_sines(q, n, sines, cosines)
    for i in range(1, bodies + 1):
        place_by_sines(topology, constants, work, q, sines, cosines, i)
        if at(topology, i, at_.POINTS) > 0 and at(topology, i, at_.COMPONENTS) == 0:
            place_beam(topology, constants, work, q, i)
        move_body(topology, constants, work, qd, qdd, i)
        body_wrench(topology, constants, work, q, qd, qdd, i)


@inlined
def joint_force(topology, constants, work, i):
    """Return S^T of the wrench on body i."""
    o = at(topology, i, at_.WORK)
    if at(topology, i, at_.MOTION) == at_.REVOLUTE_Z:
        return work[o + at_.TORQUE + 2]
    c = at(topology, i, at_.BODY_CONSTANTS)
    return dot(load(constants, c + at_.AXIS), load(work, o + at_.FORCE)) + dot(
        load(constants, c + at_.AXIS + 3), load(work, o + at_.TORQUE)
    )


@inlined
def inward_wrenches(topology, constants, work, bodies, out):
    """Sum wrenches towards the base and add their share along every coordinate to out."""
    for i in range(bodies, 0, -1):
        j = at(topology, i, at_.COORDINATE)
        if at(topology, i, at_.JOINT) == 1:
            out[j] += joint_force(topology, constants, work, i)
            j += 1
        for k in range(at(topology, i, at_.MODES)):
            out[j + k] += work[at(topology, i, at_.BEAM_WORK) + k]
        o = at(topology, i, at_.WORK)
        transmit_wrench(topology, work, i, load(work, o + at_.FORCE), load(work, o + at_.TORQUE))


@shared
def find_torque(handle, q, qd, qdd, out):
    """Write I q'' + h(q, q') (n)."""
    topology, constants, work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    outward_motion(n, topology, constants, work, diagonals, bodies, q, qd, qdd)
    # element by element before out is summed up: out may be one of the arguments
    for j in range(n):
        out[j] = diagonals[rec_.ARMATURE][j] * qdd[j] + internal_force(
            constants, diagonals, q, qd, j
        )
    inward_wrenches(topology, constants, work, bodies, out)
    return GOOD if all_finite(out, n) else NOT_FINITE


inverse_dynamics = vector_of_state('inverse_dynamics', find_torque)


inverse_dynamics_rows = over_rows('inverse_dynamics_rows', find_torque, 4)
