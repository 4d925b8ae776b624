"""Minimal coordinates: small motions under locked joints, loops and mimic joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from denoc_ros.dynamics.constraint_derivatives import applied_change, row_derivatives
from denoc_ros.dynamics.constraints import RANK, closure_rows, jacobian
from denoc_ros.dynamics.derivatives import DifferentiableModel
from denoc_ros.dynamics.mechanism_modes import independent_joints
from denoc_ros.errors import StateError
from denoc_ros.kernels.closing import OPEN
from denoc_ros.types import Array

Int = NDArray[np.int64]

REGULAR = 1e-6  # least singular value of a choice of coordinates that determines the others


@dataclass(frozen=True)
class MinimalCoordinates:
    """Changes of state and acceleration in terms of those of independent coordinates.

    With x = [y; y']: dq = basis y, dq' = rates x, dq'' = basis y'' + accelerations x.
    """

    independent: Int  # (m,) where y stand among the coordinates
    basis: Array  # (n, m) null space of the closure Jacobian, the unit matrix at y
    rates: Array  # (n, 2 m)
    accelerations: Array  # (n, 2 m)


def minimal_coordinates(
    robot: DifferentiableModel, state: tuple[Array, Array, Array], locked: Int
) -> MinimalCoordinates:
    """Return the motions that are left about a state q, q', q'' (n,) with some joints locked.

    Raises
    ------
    StateError
        The loops are open there, or the rates open them.

    Notes
    -----
    J dq = 0; J dq' + d(J q')/dq dq = 0; J dq'' + d(J q'' + g)/dq dq + dg/dq' dq' = 0 with
    g = J' q', whose solutions by least squares are moved along the basis until y, y', y'' are
    those of the independent coordinates.
    """
    q, qd, qdd = state
    free = np.setdiff1d(np.arange(robot.n), locked)
    rows = jacobian(robot, q)[0][:, free]
    if not len(rows):
        basis = np.eye(robot.n)[:, free]
        m = len(free)
        rates = np.hstack([np.zeros((robot.n, m)), basis])
        return MinimalCoordinates(free, basis, rates, np.zeros((robot.n, 2 * m)))
    _require_closed(robot, q, qd)
    null = scipy.linalg.null_space(rows, rcond=RANK)
    chosen = _independent(robot, q, free, null)
    m = len(chosen)
    basis = np.zeros((robot.n, m))
    basis[free] = null @ np.linalg.inv(null[chosen])
    inverse = np.linalg.pinv(rows, rcond=RANK)

    def completed(wanted: Array) -> Array:
        """Return the changes (n, ...) that meet J change = wanted, y standing still."""
        change = np.zeros((robot.n, wanted.shape[1]))
        change[free] = inverse @ wanted
        return change - basis @ change[free[chosen]]

    rates = np.hstack([completed(-applied_change(robot, q, qd) @ basis), basis])
    change = row_derivatives(robot, q, qd, qdd)
    positions = np.hstack([basis, np.zeros((robot.n, m))])
    accelerations = completed(-change.by_q @ positions - change.by_rate @ rates)
    return MinimalCoordinates(free[chosen], basis, rates, accelerations)


def _require_closed(robot: DifferentiableModel, q: Array, qd: Array) -> None:
    errors, rates, _bias = closure_rows(robot, q, qd)
    for what, values, unit, verb in (
        ('q', errors, 'm (or rad)', 'assemble'),
        ('qd', rates, 'm/s (or rad/s)', 'assemble_rates'),
    ):
        worst = int(np.argmax(np.abs(values)))
        if abs(values[worst]) > OPEN:
            raise StateError(
                f'{robot.tree.name}: {what} must keep {robot.constraint_names[worst]!r} closed '
                f'to {OPEN:g} {unit} (see {verb}), got {values[worst]:.3g}'
            )


def _independent(robot: DifferentiableModel, q: Array, free: Int, null: Array) -> Int:
    """Return which rows of a null space (free, m) determine the others.

    Amplitudes, and the joints that hold the mechanism still, if they do; else those that come
    first by pivoting.
    """
    held = robot.indices(independent_joints(robot, q))
    wanted = np.flatnonzero(np.isin(free, np.union1d(robot.flexible_indices, held)))
    if len(wanted) == null.shape[1]:
        smallest = np.linalg.svd(null[wanted], compute_uv=False).min(initial=1.0)
        if smallest > REGULAR:
            return wanted
    order = scipy.linalg.qr(null.T, mode='r', pivoting=True)[1]
    return np.sort(order[: null.shape[1]]).astype(np.int64)
