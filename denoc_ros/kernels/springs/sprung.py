"""Inverse and forward dynamics of robots with elastic joints, by way of their link side.

Each joint with a spring has two rows of bodies, on which all other kernels work. These two need
one: see link_side.
"""

from denoc_ros.kernels.dynamics.articulated import find_acceleration
from denoc_ros.kernels.dynamics.inverse import find_torque
from denoc_ros.kernels.dynamics.states import over_rows, vector_of_state
from denoc_ros.kernels.jit.compiled import shared
from denoc_ros.kernels.jit.handle import GOOD, coordinates, link_side
from denoc_ros.kernels.springs.link_side_dynamics import (
    copy_base,
    gather,
    gather_force,
    link_map,
    link_state,
    scatter_acceleration,
    scatter_torque,
)


@shared
def find_sprung_torque(handle, q, qd, qdd, out):
    """Write I q'' + h(q, q') (n)."""
    chain = link_side(handle)
    m = coordinates(chain)
    places = link_map(handle, m)
    x, xd = link_state(handle, m, 0), link_state(handle, m, 1)
    xdd, row = link_state(handle, m, 2), link_state(handle, m, 3)
    gather(places, m, q, x)
    gather(places, m, qd, xd)
    gather(places, m, qdd, xdd)
    copy_base(handle, chain)
    find_torque(chain, x, xd, xdd, row)
    return scatter_torque(handle, places, m, row, q, qd, qdd, out)


@shared
def find_sprung_acceleration(handle, q, qd, tau, qdd):
    """Write the accelerations (n) under generalized forces tau (n)."""
    chain = link_side(handle)
    m = coordinates(chain)
    places = link_map(handle, m)
    x, xd = link_state(handle, m, 0), link_state(handle, m, 1)
    force, xdd = link_state(handle, m, 2), link_state(handle, m, 3)
    gather(places, m, q, x)
    gather(places, m, qd, xd)
    gather_force(handle, places, m, q, qd, tau, force)
    copy_base(handle, chain)
    status = find_acceleration(chain, x, xd, force, xdd)
    if status != GOOD:
        return status
    return scatter_acceleration(handle, places, m, xdd, force, q, qd, tau, qdd)


inverse_dynamics = vector_of_state('inverse_dynamics', find_sprung_torque)


forward_dynamics = vector_of_state('forward_dynamics', find_sprung_acceleration)


inverse_dynamics_rows = over_rows('inverse_dynamics_rows', find_sprung_torque, 4)


forward_dynamics_rows = over_rows('forward_dynamics_rows', find_sprung_acceleration, 4)
