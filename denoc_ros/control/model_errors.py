"""Relative errors of the model along a plan: their effect, and the torque against it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from denoc_ros.control.feedback_design import Regulator
from denoc_ros.control.feedback_settings import FeedbackSettings
from denoc_ros.control.planned_states import Row
from denoc_ros.dynamics.robot import Robot
from denoc_ros.model.arrays import is_flexible
from denoc_ros.types import Array

CHANGE = 0.01  # of the load, in the difference that is its derivative
MOST = 6  # stiffnesses that are told apart; more count as one


@dataclass(frozen=True)
class ModelErrors:
    """Effect of model errors along a plan: of each beam's stiffness, then of the load.

    Attributes
    ----------
    step : float
        Time between rows [s]; the first is at the plan's start, the last one holds afterwards.
    accelerations : (k, m, errors) array
        Of the minimal coordinates, by unit errors.
    ahead : (k, joints, errors) array
        Torque to add = -ahead @ errors [N m, N]: it knows what is still to come.
    noise : (measured,) array
        Standard deviations of the measurements by which the errors are found; (0,) where the
        design has all modes that are allowed for.
    """

    step: float
    accelerations: Array
    ahead: Array
    noise: Array

    def between(self, rows: Array, time: float, out: Array) -> Array:
        """Write rows of one of the arrays, interpolated at a time of the plan [s], to `out`."""
        along = min(max(time / self.step, 0.0), len(rows) - 1.0)
        before = min(int(along), len(rows) - 2)
        share = along - before
        np.multiply(rows[before], 1.0 - share, out=out)
        out += share * rows[before + 1]
        return out


def knows_errors(robot: Robot) -> bool:
    """Say whether a robot's errors can be told apart: loops and mimic joints hide forces."""
    return not (robot.tree.loops or robot.tree.mimics)


def stiffnesses(robot: Robot) -> list[NDArray[np.intp]]:
    """Return the coordinates of each flexible link and of each elastic joint."""
    left = set(robot.flexible_indices.tolist())
    groups = []
    for body in robot.tree.bodies:
        if is_flexible(body):
            of_link = robot.amplitudes(body.name)
            groups.append(np.arange(of_link.start, of_link.stop, dtype=np.intp))
            left -= set(groups[-1].tolist())
    groups += [np.array([index], dtype=np.intp) for index in sorted(left)]
    if len(groups) > MOST:
        groups = [np.asarray(robot.flexible_indices, dtype=np.intp)]
    return groups


def error_accelerations(
    robot: Robot, tip: str, coordinates: NDArray[np.intp], rows: Sequence[Row]
) -> Array:
    """Return the accelerations (k, m, errors) that unit errors of the model add along a motion.

    Parameters
    ----------
    robot : Robot
        Without loops or mimic joints.
    tip : str
        The frame whose load may be wrong.
    coordinates : (m,) int array
        The minimal ones.
    rows : sequence of (q, qd, qdd), (n,) arrays each
        The motion.
    """
    heavier, groups = robot.with_scaled_load(tip, 1.0 + CHANGE), stiffnesses(robot)
    found = np.zeros((len(rows), len(coordinates), len(groups) + 1))
    for row, (q, qd, qdd) in enumerate(rows):
        forces = np.zeros((robot.n, len(groups) + 1))
        for column, group in enumerate(groups):
            forces[group, column] = -robot.stiffness[group] * q[group]
        more = heavier.inverse_dynamics(q, qd, qdd) - robot.inverse_dynamics(q, qd, qdd)
        forces[:, -1] = -more / CHANGE
        inertia = robot.inertia_matrix(q)[np.ix_(coordinates, coordinates)]
        found[row] = np.linalg.solve(inertia, forces[coordinates])
    return found


def drive(accelerations: Array, period: float, size: int) -> Array:
    """Change of a state (size, errors) by accelerations (m, errors) over a period [s]."""
    m = len(accelerations)
    added = np.zeros((size, accelerations.shape[1]))
    added[:m] = 0.5 * period**2 * accelerations
    added[m : 2 * m] = period * accelerations
    return added


def preview(
    problems: Sequence[Regulator], costs: Sequence[Array], accelerations: Array, step: float,
    limits: Array, settings: FeedbackSettings,
) -> Array:  # fmt: skip
    """Return the torques (k, joints, errors) that undo unit errors at least cost.

    Parameters
    ----------
    problems, costs : sequences
        Of the regulator at the nodes of the plan, the cost one period later.
    accelerations : (k, m, errors) array
        As :func:`error_accelerations` returns them, evenly spaced from the first node to the last.
    step : float
        Time between them: 2^j periods [s].
    limits : (joints,) array
        Effort limits [N m, N].
    settings : FeedbackSettings

    Notes
    -----
    The cost of the regulator x+ = a x + b v + e is x^T P x + 2 x^T r; backwards in time
    r <- (a - b K)^T (r + P e), and v = -K x - (1 + b^T P b)^-1 b^T (r + P e). From the last row
    on e is constant.
    """
    per_node = (len(accelerations) - 1) // (len(problems) - 1)
    periods = round(step / settings.period)
    scale = (settings.effort_share * limits)[:, None]
    found = np.zeros((len(accelerations), len(limits), accelerations.shape[2]))
    rest: Array | None = None
    for row in range(len(accelerations) - 1, -1, -1):
        node = round(row / per_node)
        a, b, cost = problems[node].a, problems[node].b, costs[node]
        inner = np.linalg.solve(np.eye(b.shape[1]) + b.T @ cost @ b, b.T)
        closed = (a - b @ (inner @ cost @ a)).T
        push = cost @ drive(accelerations[row], settings.period, len(a))
        if rest is None:
            rest = np.linalg.solve(np.eye(len(a)) - closed, closed @ push)
        else:
            power, total = _powers(closed, periods)
            rest = power @ rest + total @ (closed @ push)
        found[row] = scale * (inner @ (rest + push))
    return found


def _powers(closed: Array, count: int) -> tuple[Array, Array]:
    """Return closed^count and the sum of all lower powers; count is a power of two."""
    power, total = closed, np.eye(len(closed))
    while count > 1:
        power, total, count = power @ power, total + power @ total, count // 2
    return power, total
