"""Forward and hybrid dynamics by UDU^T: inward elimination, outward accelerations (section 3.4).

With all velocities as they are and only the given accelerations, every body needs a wrench p. Free
coordinates x add accelerations on top, which obey the linear, bias-free part of the equations: so
bias terms appear in the outward motion only. Per body, with P = [S 0; 0 1],
P^T M P + shift = L D L^T, W = (rows 1..6 of M P) L^-T and y = L^-1 (tau - P^T p); its carrier sees
the inertia M - W D^-1 W^T and the wrench p + W D^-1 y; on the way out x = L^-T D^-1 (y - W^T a).
"""

from numba import types

from denoc_ros.kernels.algebra.joint_block import block_at, wrench_of
from denoc_ros.kernels.algebra.vector import add, all_finite, load, scale
from denoc_ros.kernels.dynamics.body_inertia import body_inertia, flexible_block
from denoc_ros.kernels.dynamics.elimination import (
    along_joint,
    inward_flexible,
    inward_rigid,
    outward_flexible,
    outward_rigid,
)
from denoc_ros.kernels.dynamics.inverse import joint_force, outward_motion
from denoc_ros.kernels.dynamics.states import over_rows, vector_of_state
from denoc_ros.kernels.jit import handle as rec_
from denoc_ros.kernels.jit.compiled import NUMBERS, apart, inlined, kernel
from denoc_ros.kernels.jit.handle import (
    GOOD,
    NOT_FINITE,
    SINGULAR,
    at,
    coordinates,
    elements,
    model_arrays,
)
from denoc_ros.kernels.layout import layout as at_
from denoc_ros.kernels.springs.link_side_dynamics import lacks_rotor
from denoc_ros.kernels.springs.spring_torque import internal_force


@inlined
def free_joint(topology, held, i):
    """Return 1 where body i has a joint that is not held, else 0."""
    if at(topology, i, at_.JOINT) == 0 or held[at(topology, i, at_.COORDINATE)] != 0.0:
        return 0
    return 1


@inlined
def inward_articulated(topology, constants, work, shift, held, bodies, drive):
    """Eliminate every body's free coordinates, from the tips to the base."""
    for i in range(1, bodies + 1):
        body_inertia(topology, constants, work, i)
    for i in range(bodies, 0, -1):
        free = free_joint(topology, held, i)
        m = at(topology, i, at_.MODES)
        if m == 0:
            good = inward_rigid(topology, constants, work, shift, drive, i, free)
        else:
            good = inward_flexible(topology, constants, work, shift, drive, i, free, m)
        if not good:
            return False
    return True


@inlined
def outward_accelerations(topology, constants, work, held, bodies, given, qdd):
    """Write the accelerations of all coordinates, from the base to the tips."""
    for i in range(1, bodies + 1):
        free = free_joint(topology, held, i)
        m = at(topology, i, at_.MODES)
        if m == 0:
            outward_rigid(topology, constants, work, given, qdd, i, free)
        else:
            outward_flexible(topology, constants, work, given, qdd, i, free, m)


@inlined
def held_force(topology, constants, work, qdd, i):
    """Return S^T of the wrench on body i when every acceleration is known."""
    o = at(topology, i, at_.WORK)
    m = at(topology, i, at_.MODES)
    inertia = at(topology, i, at_.INERTIA_WORK)
    change, turn = load(work, o + at_.FREE_ACCELERATION), load(work, o + at_.FREE_ACCELERATION + 3)
    if m == 0:
        f, n = wrench_of(block_at(work, inertia), change, turn)
        return joint_force(topology, constants, work, i) + along_joint(
            topology, constants, i, f, n
        )
    size = 6 + m
    f, n = wrench_of(flexible_block(work, inertia, size), change, turn)
    j = at(topology, i, at_.COORDINATE) + 1
    for k in range(m):
        c = inertia + 6 + k
        f = add(f, scale(qdd[j + k], (work[c], work[c + size], work[c + 2 * size])))
        c += 3 * size
        n = add(n, scale(qdd[j + k], (work[c], work[c + size], work[c + 2 * size])))
    return joint_force(topology, constants, work, i) + along_joint(topology, constants, i, f, n)


@inlined
def solve(handle, shift, held, q, qd, given, tau, qdd, torque):
    """Write accelerations and torques as :func:`articulated_dynamics` does; return its status."""
    topology, constants, work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    for j in range(n):
        torque[j] = tau[j] - internal_force(constants, diagonals, q, qd, j)
    outward_motion(n, topology, constants, work, diagonals, bodies, q, qd, given)
    if not inward_articulated(topology, constants, work, shift, held, bodies, torque):
        return SINGULAR
    outward_accelerations(topology, constants, work, held, bodies, given, qdd)
    return GOOD if all_finite(qdd, n) else NOT_FINITE


@apart(types.int64(types.int64, *[NUMBERS] * 4))
def find_acceleration(handle, q, qd, tau, qdd):
    """Write the accelerations (n) under generalized forces tau (n)."""
    diagonals = model_arrays(handle)[3]
    zero = diagonals[rec_.ZERO]
    return solve(
        handle, diagonals[rec_.ARMATURE], zero, q, qd, zero, tau, qdd, diagonals[rec_.SCRATCH]
    )


forward_dynamics = vector_of_state('forward_dynamics', find_acceleration)


forward_dynamics_rows = over_rows('forward_dynamics_rows', find_acceleration, 4)


@apart(types.int64(types.int64, *[NUMBERS] * 8))
def find_articulated(handle, shift, held, q, qd, given, tau, qdd, torque):
    """Write q'' (n) of the free coordinates and the torque (n) of the held joints.

    held[j] != 0: joint j has the acceleration given; given is zero elsewhere. shift is what stands
    on the diagonal beside the bodies' inertia: the armature, and more in a time step.
    """
    if lacks_rotor(handle, held):
        return SINGULAR
    topology, constants, work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    status = solve(handle, shift, held, q, qd, given, tau, qdd, torque)
    if status != GOOD:
        return status
    for i in range(1, bodies + 1):
        j = at(topology, i, at_.COORDINATE)
        if at(topology, i, at_.JOINT) == 1 and held[j] != 0.0:
            torque[j] = (
                held_force(topology, constants, work, qdd, i)
                + diagonals[rec_.ARMATURE][j] * given[j]
                + internal_force(constants, diagonals, q, qd, j)
            )
    return GOOD if all_finite(torque, n) else NOT_FINITE


@kernel(
    'int64(int64, float64[::1], float64[::1], float64[::1], float64[::1], float64[::1], '
    'float64[::1], float64[::1], float64[::1])'
)
def articulated_dynamics(handle, shift, held, q, qd, given, tau, qdd, torque):
    """Wrap :func:`find_articulated` for arrays."""
    return find_articulated(
        handle, elements(shift), elements(held), elements(q), elements(qd), elements(given),
        elements(tau), elements(qdd), elements(torque),
    )  # fmt: skip


articulated_dynamics_rows = over_rows('articulated_dynamics_rows', find_articulated, 8)
