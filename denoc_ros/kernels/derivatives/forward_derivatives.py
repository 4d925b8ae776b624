"""Derivatives of forward and hybrid dynamics: those of inverse dynamics through the factors.

I q'' + h = tau holds for every state: d q'' = -I_ff^-1 d(I q'' + h)_f at the accelerations that
belong to it, and forces of held joints follow them. Right-hand sides take O(n) each.
"""

from denoc_ros.kernels.derivatives.inverse_derivatives import find_derivatives
from denoc_ros.kernels.derivatives.right_hand_sides import factors_to_base, solve_columns
from denoc_ros.kernels.dynamics.articulated import find_articulated
from denoc_ros.kernels.dynamics.states import matrices_of_state, over_rows
from denoc_ros.kernels.jit import handle as rec_
from denoc_ros.kernels.jit.compiled import inlined, shared
from denoc_ros.kernels.jit.handle import GOOD, beyond, coordinates, model_arrays


@shared
def find_forward_derivatives(handle, q, qd, tau, by_q, by_rate, inverse):
    """Write d q'' / dq, d q'' / dq' and I^-1 (n, n each)."""
    topology, _reals, work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    held = diagonals[rec_.ZERO]
    # the accelerations stand in the result's first row until the derivatives there take its place
    status = find_articulated(
        handle, diagonals[rec_.ARMATURE], held, q, qd, held, tau, inverse, diagonals[rec_.SCRATCH]
    )
    if status == GOOD:
        status = find_derivatives(handle, q, qd, inverse, by_q, by_rate, inverse)
    if status != GOOD:
        return status
    factors_to_base(topology, work, held, bodies)
    for k in range(n * n):
        by_q[k] = -by_q[k]
        by_rate[k] = -by_rate[k]
        inverse[k] = 0.0
    for j in range(n):
        inverse[(n + 1) * j] = 1.0
    solve_columns(n, topology, work, bodies, held, (by_q, by_rate, inverse))
    for r in range(n):  # symmetric to the last bit
        for j in range(r):
            inverse[n * r + j] = inverse[n * j + r]
    return GOOD


forward_dynamics_derivatives = matrices_of_state(
    'forward_dynamics_derivatives', find_forward_derivatives
)


forward_dynamics_derivatives_rows = over_rows(
    'forward_dynamics_derivatives_rows', find_forward_derivatives, 6
)


@inlined
def held_rows(n, held, inertia, x):
    """Turn the rows of held joints from -d tau to d tau + I_hf X_f."""
    for r in range(n):
        if held[r] == 0.0:
            continue
        for j in range(n):
            x[n * r + j] = -x[n * r + j]
        for k in range(n):
            if held[k] != 0.0:
                continue
            factor = inertia[n * r + k]
            for j in range(n):
                x[n * r + j] += factor * x[n * k + j]


@inlined
def drive_columns(n, held, inertia, x):
    """Write -d(I q'' + h - tau) by the inputs: q''_j of held joints, tau_j of the others."""
    for r in range(n):
        for j in range(n):
            x[n * r + j] = -inertia[n * r + j] if held[j] != 0.0 else 0.0
        if held[r] == 0.0:
            x[(n + 1) * r] = 1.0


@shared
def find_hybrid_derivatives(handle, held, states, found):
    """Write the derivatives of hybrid dynamics: tau of held joints, q'' of the others.

    states: q, q', given q'' and tau, (4, n). found: by q, by q' and by what drives, q'' of held
    joints and tau of the others, then the inertia, (n, n) each, and last q'' (n).
    """
    topology, _reals, work, diagonals, bodies = model_arrays(handle)
    n = coordinates(handle)
    m = n * n
    q, qd, given, tau = states, beyond(states, n), beyond(states, 2 * n), beyond(states, 3 * n)
    by_rate, by_drive, inertia = beyond(found, m), beyond(found, 2 * m), beyond(found, 3 * m)
    qdd = beyond(found, 4 * m)
    # the torques stand where the derivatives by what drives take their place
    status = find_articulated(
        handle, diagonals[rec_.ARMATURE], held, q, qd, given, tau, qdd, by_drive
    )
    if status == GOOD:
        status = find_derivatives(handle, q, qd, qdd, found, by_rate, inertia)
    if status != GOOD:
        return status
    factors_to_base(topology, work, held, bodies)
    for k in range(2 * m):
        found[k] = -found[k]
    drive_columns(n, held, inertia, by_drive)
    solve_columns(n, topology, work, bodies, held, (found, by_rate, by_drive))
    for x in (found, by_rate, by_drive):
        held_rows(n, held, inertia, x)
    return GOOD


hybrid_dynamics_derivatives_rows = over_rows(
    'hybrid_dynamics_derivatives_rows', find_hybrid_derivatives, 3
)
