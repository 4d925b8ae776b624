"""Momentum, mass and first moment of all bodies together, in base axes about the base's origin."""

from denoc_ros.kernels import layout as at_
from denoc_ros.kernels.compiled import inlined, shared
from denoc_ros.kernels.composite import own_composite, rigid_wrench
from denoc_ros.kernels.handle import (
    GOOD,
    NOT_FINITE,
    ZERO,
    at,
    coordinates,
    model_arrays,
)
from denoc_ros.kernels.inverse import outward_motion
from denoc_ros.kernels.motion import linear_velocity
from denoc_ros.kernels.states import over_rows
from denoc_ros.kernels.vector import accumulate, add, all_finite, cross, load, rotate, scale
from denoc_ros.kernels.world import world_pose

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
