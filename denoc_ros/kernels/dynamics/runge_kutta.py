"""Explicit Runge-Kutta steps with error control, as many as are needed to pass a time.

For motions under constant forces. The pair of formulas and the control are those of Hairer's
DOP853 as scipy has them, which gives the coefficients too: stages a (s, s), weights b (s), errors
e3 and e5 (s + 1). With loops, every new state is brought back onto them.
"""

import numpy as np

from denoc_ros.kernels.constraints.closing import close_constraints
from denoc_ros.kernels.constraints.constrained import EXPLICIT, find_constrained
from denoc_ros.kernels.dynamics.articulated import find_acceleration
from denoc_ros.kernels.jit import handle as rec_
from denoc_ros.kernels.jit.compiled import inlined, kernel
from denoc_ros.kernels.jit.handle import (
    GOOD,
    MISFIT,
    NOT_FINITE,
    at,
    beyond,
    coordinates,
    elements,
    link_side,
    model_arrays,
)
from denoc_ros.kernels.layout.constraint_layout import CONSTRAINTS
from denoc_ros.kernels.springs.sprung import find_sprung_acceleration

# elements of `control`
TIME = 0  # s
STEP = 1  # s, of the step to be tried next
UNTIL = 2  # s: a step that ends there or later is the last
END = 3  # s: none goes beyond
RELATIVE = 4  # tolerances per step
ABSOLUTE = 5
TAKEN = 6  # s, the last step
EVALUATIONS = 7
CONTROLS = 8

SAFETY = 0.9
LEAST_FACTOR = 0.2
GREATEST_FACTOR = 10.0
EXPONENT = -0.125  # the error estimate is of order 7
ROUNDING = 10.0 * 2.2e-16  # of the time: no step is shorter


@inlined
def find_rate(handle, y, tau, out):
    """Write d(y)/dt (2 n) at a state y (2 n) under forces tau (n); return the status."""
    topology, _reals, _work, diagonals, _bodies = model_arrays(handle)
    n = coordinates(handle)
    for j in range(n):
        out[j] = y[n + j]
    if at(topology, 0, CONSTRAINTS) == 0:
        if link_side(handle) != handle:
            return find_sprung_acceleration(handle, y, beyond(y, n), tau, beyond(out, n))
        return find_acceleration(handle, y, beyond(y, n), tau, beyond(out, n))
    zero = diagonals[rec_.ZERO]
    return find_constrained(
        handle, EXPLICIT, 0.0, diagonals[rec_.ARMATURE], zero, y, beyond(y, n), zero, tau,
        beyond(out, n),
    )  # fmt: skip


@inlined
def combine(y, h, weights, k, stages, size, out):
    """Write y + h sum of weights[i] k[i] over the first stages."""
    for j in range(size):
        u = 0.0
        for i in range(stages):
            u += weights[i] * k[size * i + j]
        out[j] = y[j] + h * u


@inlined
def error_norm(y, new, h, errors, k, stages, size, relative, absolute):
    """Return the error of a step over its tolerance; errors has the weights of order 3 and 5."""
    five = 0.0
    three = 0.0
    for j in range(size):
        scale = absolute + relative * max(abs(y[j]), abs(new[j]))
        u = 0.0
        v = 0.0
        for i in range(stages):
            u += errors[stages + 1 + i] * k[size * i + j]
            v += errors[i] * k[size * i + j]
        five += (u / scale) ** 2
        three += (v / scale) ** 2
    if five == 0.0 and three == 0.0:
        return 0.0
    return h * five / np.sqrt((five + 0.01 * three) * size)


@inlined
def try_step(handle, a, b, stages, h, tau, y, k, new):
    """Write the state after a step, whose first stage is there already; return the status."""
    size = 2 * coordinates(handle)
    for i in range(1, stages):
        combine(y, h, beyond(a, stages * i), k, i, size, new)
        status = find_rate(handle, new, tau, beyond(k, size * i))
        if status != GOOD:
            return status
    combine(y, h, b, k, stages, size, new)
    return GOOD


@kernel(
    'int64(int64, float64[:, ::1], float64[::1], float64[:, ::1], float64[::1], float64[::1], '
    'float64[::1], float64[::1], float64[:, ::1], float64[::1])'
)
def explicit_steps(handle, a, b, errors, control, tau, state, before, k, new):
    """Advance a state (2 n) by steps until one ends at control[UNTIL] or later.

    The state before the last step goes to `before`, its stages to k (s + 1, 2 n), of which the
    last row is the rate at the state, on entry too. The time stands still where no step is good.
    """
    n = coordinates(handle)
    size, stages = 2 * n, a.shape[0]
    if state.shape[0] != size or tau.shape[0] != n or k.shape[0] != stages + 1:
        return MISFIT
    diagonals = model_arrays(handle)[3]
    y, old, trial, loads = elements(state), elements(before), elements(new), elements(tau)
    rates, weights, table = elements(k), elements(b), elements(a)
    constraints = at(model_arrays(handle)[0], 0, CONSTRAINTS)
    while control[TIME] < control[UNTIL]:
        for j in range(size):
            rates[j] = rates[size * stages + j]
            old[j] = y[j]
        rejected = False
        while True:
            h = min(control[STEP], control[END] - control[TIME])
            if h < ROUNDING * max(1.0, abs(control[TIME])):
                return NOT_FINITE
            status = try_step(handle, table, weights, stages, h, loads, old, rates, trial)
            control[EVALUATIONS] += stages - 1
            error = np.inf
            if status == GOOD:
                error = error_norm(
                    old, trial, h, elements(errors), rates, stages, size, control[RELATIVE],
                    control[ABSOLUTE],
                )  # fmt: skip
            if error < 1.0:
                break
            factor = SAFETY * error**EXPONENT if error < np.inf else 0.0
            control[STEP] = h * max(LEAST_FACTOR, factor)
            rejected = True
        if constraints > 0:
            status = close_constraints(
                handle, diagonals[rec_.ZERO], trial, beyond(trial, n), diagonals[rec_.SCRATCH]
            )
            if status != GOOD:
                return status
        status = find_rate(handle, trial, loads, beyond(rates, size * stages))
        control[EVALUATIONS] += 1
        if status != GOOD:
            return status
        for j in range(size):
            y[j] = trial[j]
        factor = GREATEST_FACTOR if error == 0.0 else SAFETY * error**EXPONENT
        factor = min(GREATEST_FACTOR, factor)
        last = h >= control[END] - control[TIME]
        control[TIME] = control[END] if last else control[TIME] + h
        control[TAKEN] = h
        control[STEP] = h * (min(1.0, factor) if rejected else factor)
    return GOOD
