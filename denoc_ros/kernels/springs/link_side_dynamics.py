"""Elastic joints: dynamics of the robot without springs, seen from its links.

A joint with a spring has two coordinates, its motor side q and after it s = link side - motor
side. A chain of links sees x = q + s alone. With the row t of the robot without springs, whose
joint is x, the rows of inverse dynamics are tau_q = t + armature q'' + friction(q') and
tau_s = t + spring(s, s'). So forward dynamics give x'' under tau_s - spring(s, s'), and the motor
its own q'' = (tau_q - friction(q') - (tau_s - spring(s, s'))) / armature.
"""

import numpy as np

from denoc_ros.kernels.algebra.vector import all_finite
from denoc_ros.kernels.jit import handle as rec_
from denoc_ros.kernels.jit.compiled import inlined, kernel
from denoc_ros.kernels.jit.handle import (
    GOOD,
    NOT_FINITE,
    SINGULAR,
    beyond,
    coordinates,
    elements,
    link_side,
    model_arrays,
    record_of,
)
from denoc_ros.kernels.jit.pointers import span
from denoc_ros.kernels.layout.layout import VELOCITY, WORLD_ROTATION
from denoc_ros.kernels.springs.spring_torque import internal_force, spring_force, spring_slope

STATES = 4  # rows of n elements that a call takes


@inlined
def link_map(handle, n):
    """Return, for n coordinates x, where theirs stand among all, and if they are of a spring."""
    return span(record_of(handle)[rec_.LINK_MAP], 2 * n, np.uint32)


@inlined
def link_state(handle, n, row):
    """Return one of the rows where coordinates x are gathered."""
    return beyond(span(record_of(handle)[rec_.LINK_STATES], STATES * n, np.float64), row * n)


@inlined
def gather(places, n, q, x):
    """Write x: q + s of elastic joints, the coordinate itself of others."""
    for k in range(n):
        j = np.int64(places[k])
        x[k] = q[j]
        if places[n + k] != 0:
            x[k] += q[j - 1]


@inlined
def copy_base(handle, chain):
    """Give the robot without springs the motion of the base."""
    _, _, source, _, _ = model_arrays(handle)
    _, _, target, _, _ = model_arrays(chain)
    for k in range(VELOCITY, WORLD_ROTATION):
        target[k] = source[k]


@inlined
def scatter_torque(handle, places, m, row, q, qd, qdd, out):
    """Write the rows (n) of all coordinates from those of the robot without springs (m)."""
    _, constants, _, diagonals, _ = model_arrays(handle)
    n = coordinates(handle)
    for k in range(m):
        s = np.int64(places[k])
        if places[m + k] == 0:
            out[s] = row[k]
            continue
        motor = s - 1
        driven = row[k] + diagonals[rec_.ARMATURE][motor] * qdd[motor]
        driven += internal_force(constants, diagonals, q, qd, motor)
        out[s] = row[k] + internal_force(constants, diagonals, q, qd, s)
        out[motor] = driven
    return GOOD if all_finite(out, n) else NOT_FINITE


@inlined
def gather_force(handle, places, m, q, qd, tau, force):
    """Write the forces (m) along x under generalized forces tau (n)."""
    _, constants, _, diagonals, _ = model_arrays(handle)
    for k in range(m):
        s = np.int64(places[k])
        force[k] = tau[s]
        if places[m + k] != 0:
            force[k] -= internal_force(constants, diagonals, q, qd, s)


@inlined
def scatter_acceleration(handle, places, m, xdd, force, q, qd, tau, qdd):
    """Write all accelerations (n) from those (m) along x, under the forces along x."""
    _, constants, _, diagonals, _ = model_arrays(handle)
    n = coordinates(handle)
    for k in range(m):
        s = np.int64(places[k])
        if places[m + k] == 0:
            qdd[s] = xdd[k]
            continue
        motor = s - 1
        armature = diagonals[rec_.ARMATURE][motor]
        if not armature > 0.0:
            return SINGULAR
        moved = tau[motor] - internal_force(constants, diagonals, q, qd, motor) - force[k]
        qdd[motor] = moved / armature
        qdd[s] = xdd[k] - qdd[motor]
    return GOOD if all_finite(qdd, n) else NOT_FINITE


@inlined
def lacks_rotor(handle, held):
    """Say whether the motor side of an elastic joint is free and has no inertia."""
    chain = link_side(handle)
    if chain == handle:
        return False
    m = coordinates(chain)
    places = link_map(handle, m)
    _, _, _, diagonals, _ = model_arrays(handle)
    for k in range(m):
        motor = np.int64(places[k]) - 1
        if places[m + k] != 0 and held[motor] == 0.0 and not diagonals[rec_.ARMATURE][motor] > 0.0:
            return True
    return False


@kernel('void(int64, float64[::1], float64[::1], float64[::1])')
def elastic_terms(handle, q, force, slope):
    """Write the elastic forces (n) along the coordinates q (n), and their derivatives (n)."""
    _, _, _, diagonals, _ = model_arrays(handle)
    x = elements(q)
    for j in range(coordinates(handle)):
        force[j] = spring_force(diagonals, x, j)
        slope[j] = spring_slope(diagonals, x, j)
