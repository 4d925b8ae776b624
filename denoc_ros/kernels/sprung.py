"""Inverse and forward dynamics of robots with elastic joints, by way of their link side.

Each joint with a spring has two rows of bodies, on which all other kernels work. These two need
one: see link_side.
"""

from numba import types

from denoc_ros.kernels.array_object import READABLE, WRITABLE, array_object, content, is_vector
from denoc_ros.kernels.articulated import find_acceleration
from denoc_ros.kernels.compiled import kernel, rows_kernel, shared
from denoc_ros.kernels.handle import GOOD, MISFIT, beyond, coordinates, elements, link_side
from denoc_ros.kernels.inverse import find_torque
from denoc_ros.kernels.link_side import (
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


@kernel(types.int64(types.int64, array_object, array_object, array_object, array_object))
def inverse_dynamics(handle, q, qd, qdd, out):
    """Write I q'' + h(q, q') (n)."""
    n = coordinates(handle)
    if not (
        is_vector(handle, q, n, READABLE)
        and is_vector(handle, qd, n, READABLE)
        and is_vector(handle, qdd, n, READABLE)
        and is_vector(handle, out, n, WRITABLE)
    ):
        return MISFIT
    return find_sprung_torque(handle, content(q), content(qd), content(qdd), content(out))


@kernel(types.int64(types.int64, array_object, array_object, array_object, array_object))
def forward_dynamics(handle, q, qd, tau, qdd):
    """Write the accelerations (n) under generalized forces tau (n)."""
    n = coordinates(handle)
    if not (
        is_vector(handle, q, n, READABLE)
        and is_vector(handle, qd, n, READABLE)
        and is_vector(handle, tau, n, READABLE)
        and is_vector(handle, qdd, n, WRITABLE)
    ):
        return MISFIT
    return find_sprung_acceleration(handle, content(q), content(qd), content(tau), content(qdd))


ROWS = (
    'int64(int64, float64[:, ::1], float64[:, ::1], float64[:, ::1], int64, int64, '
    'float64[:, ::1])'
)


@rows_kernel(ROWS)
def inverse_dynamics_rows(handle, q, qd, qdd, first, last, out):
    """Do the same for rows first .. last - 1 of (k, n) states; return the worst status."""
    n = coordinates(handle)
    a, b, c, d = elements(q), elements(qd), elements(qdd), elements(out)
    worst = GOOD
    for row in range(first, last):
        k = n * row
        status = find_sprung_torque(handle, beyond(a, k), beyond(b, k), beyond(c, k), beyond(d, k))
        worst = max(worst, status)
    return worst


@rows_kernel(ROWS)
def forward_dynamics_rows(handle, q, qd, tau, first, last, qdd):
    """Do the same for rows first .. last - 1 of (k, n) states; return the worst status."""
    n = coordinates(handle)
    a, b, c, d = elements(q), elements(qd), elements(tau), elements(qdd)
    worst = GOOD
    for row in range(first, last):
        k = n * row
        status = find_sprung_acceleration(
            handle, beyond(a, k), beyond(b, k), beyond(c, k), beyond(d, k)
        )
        worst = max(worst, status)
    return worst
