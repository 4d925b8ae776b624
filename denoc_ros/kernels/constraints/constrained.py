"""Dynamics of robots with loops and mimic joints (section 5.1), by the open tree's UDU^T.

I q'' = tau - h + J^T lambda with J q'' = -J' q'. With y = L^-1 U^-1 (tau - h) (see articulated)
and Y = L^-1 U^-1 J^T, J I^-1 J^T = Y^T D^-1 Y and J I^-1 (tau - h) = Y^T D^-1 y: one factorization
and one way outward with y + Y lambda serve everything; no inertia matrix, no J.
"""

import numpy as np
from numba import types

from denoc_ros.kernels.algebra.vector import all_finite
from denoc_ros.kernels.constraints.closure import all_rows, constraint_rows, constraints
from denoc_ros.kernels.constraints.constraint_columns import constraint_columns
from denoc_ros.kernels.constraints.multipliers import (
    columns_of,
    factor_products,
    product,
    solve_rows,
    vector,
    write_products,
)
from denoc_ros.kernels.dynamics.articulated import (
    free_joint,
    inward_articulated,
    outward_accelerations,
)
from denoc_ros.kernels.dynamics.inverse import outward_motion
from denoc_ros.kernels.dynamics.link_motion import linear_velocity
from denoc_ros.kernels.dynamics.states import over_rows
from denoc_ros.kernels.dynamics.step import FIRST_STAGE, SECOND_STAGE
from denoc_ros.kernels.jit import handle as rec_
from denoc_ros.kernels.jit.array_object import READABLE, WRITABLE, array_object, content, is_vector
from denoc_ros.kernels.jit.compiled import NUMBERS, apart, inlined, kernel, shared
from denoc_ros.kernels.jit.handle import (
    GOOD,
    MISFIT,
    NOT_FINITE,
    SINGULAR,
    at,
    coordinates,
    model_arrays,
)
from denoc_ros.kernels.layout import constraint_layout as loop_
from denoc_ros.kernels.layout import layout as at_
from denoc_ros.kernels.springs.link_side_dynamics import lacks_rotor
from denoc_ros.kernels.springs.spring_torque import internal_force

CONTRADICTED = 4  # a status: no accelerations obey all rows

# Free axes with damping or friction are taken as forces, or in the stages of a step (FIRST_STAGE,
# SECOND_STAGE) implicitly: with the slope of the first.
EXPLICIT = 0


@inlined
def take_loads(topology, work, held, bodies, y, weight):
    """Copy the loads after the inward pass to y (n), and D^-1 to weight (n).

    A held joint has none.
    """
    for i in range(1, bodies + 1):
        free = free_joint(topology, held, i)
        m = at(topology, i, at_.MODES)
        j = at(topology, i, at_.COORDINATE)
        w = at(topology, i, at_.ELIMINATED)
        if at(topology, i, at_.JOINT) > free:
            work[y + j] = 0.0
            work[weight + j] = 0.0
            j += 1
        if m > 0:
            size = free + m
            d = w + 6 * size
            for k in range(size):
                work[y + j + k] = work[d + size * size + k]
                work[weight + j + k] = work[d + (size + 1) * k]
        elif free == 1:
            work[y + j] = work[w + 6] / work[w + 7]
            work[weight + j] = work[w + 7]


@inlined
def give_loads(topology, work, held, bodies, y):
    """Copy y (n) to where the outward pass looks for it."""
    for i in range(1, bodies + 1):
        free = free_joint(topology, held, i)
        m = at(topology, i, at_.MODES)
        j = y + at(topology, i, at_.COORDINATE) + at(topology, i, at_.JOINT) - free
        w = at(topology, i, at_.ELIMINATED)
        if m > 0:
            size = free + m
            for k in range(size):
                work[w + 6 * size + size * size + k] = work[j + k]
        elif free == 1:
            work[w + 6] = work[j] * work[w + 7]


@inlined
def add_rows(work, t, rows, first, last, n, y):
    """Add the multipliers' columns of rows first .. last - 1 to y (n)."""
    columns = columns_of(t, rows, n)
    for k in range(first, last):
        u = work[vector(t, rows, loop_.MULTIPLIERS) + k]
        for j in range(n):
            work[y + j] += u * work[columns + n * k + j]


@inlined
def axis_resistance(constants, c, rate):
    """Return force and slope of damping and friction along a free axis."""
    slip = np.tanh(rate / constants[at_.SLIP_RATE])
    force = constants[c + loop_.DAMPING] * rate + constants[c + loop_.FRICTION] * slip
    slope = constants[c + loop_.FRICTION] / constants[at_.SLIP_RATE] * (1.0 - slip * slip)
    return force, constants[c + loop_.DAMPING] + slope


@inlined
def resist(topology, constants, work, t, rows, stage):
    """Write the forces of damping and friction along free axes as multipliers, and their slope."""
    for constraint in constraints(topology):
        k = at(topology, constraint, loop_.AXIS_ROW)
        if at(topology, constraint, loop_.KIND) == loop_.MIMIC or k == 0:
            continue
        c = at(topology, constraint, loop_.CONSTANTS)
        force, slope = axis_resistance(constants, c, work[vector(t, rows, loop_.RATE) + k])
        push = work[vector(t, rows, loop_.AXIS_FORCE) + k] if stage == SECOND_STAGE else 0.0
        work[vector(t, rows, loop_.MULTIPLIERS) + k] = push - force
        if stage == FIRST_STAGE:
            work[vector(t, rows, loop_.SLOPE) + k] = slope


@inlined
def write_columns(handle, held, q, qd, given, t, rows):
    """Write all rows and their columns after an inward pass at this state."""
    topology, constants, work, diagonals, bodies = model_arrays(handle)
    n, zero = coordinates(handle), diagonals[rec_.ZERO]
    columns = columns_of(t, rows, n)
    for k in range(rows * n):
        work[columns + k] = 0.0
    for i in range(1, bodies + 1):
        linear_velocity(topology, constants, work, qd, i)
    for constraint in constraints(topology):
        constraint_rows(topology, constants, work, q, qd, given, zero, constraint, t, rows)
        constraint_columns(topology, constants, work, held, constraint, t, rows, columns, n)


@inlined
def soften(work, t, rows, hard, n, g):
    """Add to the products the compliance of free axes, by g times their damping."""
    products = columns_of(t, rows, n) + rows * n
    for k in range(hard, rows):
        slope = work[vector(t, rows, loop_.SLOPE) + k]
        # an axis that slips freely is left to itself: its multiplier is nothing to speak of
        work[products + (rows + 1) * k] += 1.0 / max(g * slope, 1e-300)


@inlined
def find_multipliers(topology, constants, work, t, rows, n, y, stage, g):
    """Write the multipliers for loads y, and add their effect to y; say whether rows agree."""
    hard = at(topology, 0, loop_.ROWS)
    count = hard if stage == EXPLICIT else rows
    columns = columns_of(t, rows, n)
    resist(topology, constants, work, t, rows, stage)
    add_rows(work, t, rows, hard, rows, n, y)
    write_products(work, t, rows, count, n)
    if stage != EXPLICIT:
        soften(work, t, rows, hard, n, g)
    factor_products(work, t, rows, count, hard, n)
    for k in range(count):
        bias = work[vector(t, rows, loop_.BIAS) + k] if k < hard else 0.0
        done = product(work, y, columns + n * k, columns - n, n)
        work[vector(t, rows, loop_.WANTED) + k] = -bias - done
    good = solve_rows(work, t, rows, count, n)
    add_rows(work, t, rows, 0, count, n, y)
    if stage == FIRST_STAGE:
        for k in range(hard, rows):
            multiplier = work[vector(t, rows, loop_.MULTIPLIERS) + k]
            work[vector(t, rows, loop_.AXIS_FORCE) + k] = -2.0 * multiplier
    return good


@apart(types.int64(types.int64, types.int64, types.float64, *[NUMBERS] * 7))
def find_constrained(handle, stage, g, shift, held, q, qd, given, tau, qdd):
    """Write q'' (n) with all constraints kept; their multipliers stay in the workspace.

    As articulated.find_articulated, without torques. In a time step's stages g times the damping
    of free axes stands beside the inertia, as shift does.
    """
    if lacks_rotor(handle, held):
        return SINGULAR
    topology, constants, work, diagonals, bodies = model_arrays(handle)
    n, drive = coordinates(handle), diagonals[rec_.SCRATCH]
    for j in range(n):
        drive[j] = tau[j] - internal_force(constants, diagonals, q, qd, j)
    outward_motion(n, topology, constants, work, diagonals, bodies, q, qd, given)
    if not inward_articulated(topology, constants, work, shift, held, bodies, drive):
        return SINGULAR
    t = at(topology, 0, loop_.CONSTRAINTS_WORK)
    rows = all_rows(topology)
    y = columns_of(t, rows, n) - 2 * n
    write_columns(handle, held, q, qd, given, t, rows)
    take_loads(topology, work, held, bodies, y, y + n)
    good = find_multipliers(topology, constants, work, t, rows, n, y, stage, g)
    give_loads(topology, work, held, bodies, y)
    outward_accelerations(topology, constants, work, held, bodies, given, qdd)
    if not all_finite(qdd, n):
        return NOT_FINITE
    return GOOD if good else CONTRADICTED


@shared
def find_constrained_motion(handle, held, q, qd, given, tau, qdd, multipliers):
    """Write q'' (n) and multipliers (rows) under forces tau (n), some joints' q'' given."""
    topology, _reals, work, diagonals, _bodies = model_arrays(handle)
    status = find_constrained(
        handle, EXPLICIT, 0.0, diagonals[rec_.ARMATURE], held, q, qd, given, tau, qdd
    )
    found = vector(at(topology, 0, loop_.CONSTRAINTS_WORK), all_rows(topology), loop_.MULTIPLIERS)
    for k in range(at(topology, 0, loop_.ROWS)):
        multipliers[k] = work[found + k]
    return status


@kernel(types.int64(types.int64, *([array_object] * 7)))
def constrained_dynamics(handle, held, q, qd, given, tau, qdd, multipliers):
    """Write q'' (n) and multipliers (rows) under forces tau (n), some joints' q'' given."""
    topology = model_arrays(handle)[0]
    n = coordinates(handle)
    if not (
        is_vector(handle, held, n, READABLE)
        and is_vector(handle, q, n, READABLE)
        and is_vector(handle, qd, n, READABLE)
        and is_vector(handle, given, n, READABLE)
        and is_vector(handle, tau, n, READABLE)
        and is_vector(handle, qdd, n, WRITABLE)
        and is_vector(handle, multipliers, at(topology, 0, loop_.ROWS), WRITABLE)
    ):
        return MISFIT
    return find_constrained_motion(
        handle, content(held), content(q), content(qd), content(given), content(tau),
        content(qdd), content(multipliers),
    )  # fmt: skip


constrained_dynamics_rows = over_rows('constrained_dynamics_rows', find_constrained_motion, 7)
