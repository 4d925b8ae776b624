"""Constraint rows on the open tree: mimic joints (loops parse, but are not solved yet)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from denoc_ros.dynamics.borders import as_vector
from denoc_ros.errors import SolverError

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot

Array = NDArray[np.float64]


def mimic_rows(robot: Robot) -> tuple[Array, Array]:
    """Return J (rows, n) and offsets (rows,) of q_mimic - multiplier q_leader = offset."""
    rows: list[Array] = []
    offsets: list[float] = []
    place = dict(zip(robot.joint_names, robot.joint_indices, strict=True))
    for body in robot.tree.bodies:
        if body.joint is None or body.joint.mimic is None:
            continue
        row = np.zeros(robot.n)
        row[place[body.joint.name]] = 1.0
        row[place[body.joint.mimic.leader]] -= body.joint.mimic.multiplier
        rows.append(row)
        offsets.append(body.joint.mimic.offset)
    return np.array(rows).reshape(len(rows), robot.n), np.array(offsets)


def constrained_forward_dynamics(
    robot: Robot, q: ArrayLike, qd: ArrayLike, tau: ArrayLike
) -> tuple[Array, Array]:
    """Return accelerations and multipliers lambda of I q'' + h = tau + J^T lambda, J q'' = 0."""
    if robot.tree.loops:
        names = ', '.join(loop.name for loop in robot.tree.loops)
        raise SolverError(f'{robot.tree.name}: loops must be absent (not solved yet), got {names}')
    rows, _ = mimic_rows(robot)
    q = as_vector('q', q, (robot.n,))
    free = robot.forward_dynamics(q, qd, tau)
    if not len(rows):
        return free, np.zeros(0)
    factor = scipy.linalg.cho_factor(robot.inertia_matrix(q))
    spread = scipy.linalg.cho_solve(factor, rows.T)
    multipliers = -np.linalg.solve(rows @ spread, rows @ free)
    return free + spread @ multipliers, multipliers
