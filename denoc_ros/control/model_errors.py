"""Relative errors of the model along a plan, and the plans of robots that have them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from denoc_ros.control.grid import differences
from denoc_ros.control.planned_states import PlannedMotion
from denoc_ros.control.rest import rest_posture
from denoc_ros.control.targets import Target
from denoc_ros.control.tip_grid import DRAW, LONGEST_STEP, NODES, SMOOTH, TURN
from denoc_ros.control.tip_problem import TipProblem
from denoc_ros.control.tip_solver import settle
from denoc_ros.dynamics.robot import Robot
from denoc_ros.model.arrays import is_flexible
from denoc_ros.types import Array

MOST = 6  # compliances that are told apart; more count as one
REACH = 0.2  # errors at which plans of other robots are made
AFTER = 2.0  # s after the end of the motion that such a plan may use
PAIRED = 4  # errors of which all pairs are tried; of more each alone


@dataclass(frozen=True)
class ModelErrors:
    """Plans of robots with other compliances of their beams, and another load, tip as planned.

    Errors: of each beam's (or spring's) compliance, then of the load. What they change is a
    polynomial in them, of the terms of :func:`terms`.

    Attributes
    ----------
    step : float
        Time between rows [s]; the first is at the plan's start, the last one holds afterwards.
    states : (k, 2 m, terms) array
        What the plan's minimal coordinates and their rates change by.
    torques : (k, joints, terms) array
        What its torque changes by [N m, N].
    noise : (measured,) array
        Standard deviations of the measurements by which the errors are found.
    """

    step: float
    states: Array
    torques: Array
    noise: Array

    @property
    def count(self) -> int:
        """How many errors there are: of e, e (e + 3) / 2 terms."""
        return round(math.sqrt(2.0 * self.states.shape[2] + 2.25) - 1.5)

    def between(self, rows: Array, time: float, out: Array) -> Array:
        """Write rows of one of the arrays, interpolated at a time of the plan [s], to `out`."""
        along = min(max(time / self.step, 0.0), len(rows) - 1.0)
        before = min(int(along), len(rows) - 2)
        share = along - before
        np.multiply(rows[before], 1.0 - share, out=out)
        out += share * rows[before + 1]
        return out


def terms(errors: Array) -> Array:
    """Return all that a polynomial of second degree without a constant has of errors (e,)."""
    first, second = np.triu_indices(len(errors))
    return np.concatenate([errors, errors[first] * errors[second]])


def terms_rate(errors: Array) -> Array:
    """Return the derivative (terms, e) of the terms by the errors."""
    first, second = np.triu_indices(len(errors))
    unit = np.eye(len(errors))
    pairs = errors[second, None] * unit[first] + errors[first, None] * unit[second]
    return np.concatenate([unit, pairs])


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


def with_errors(robot: Robot, tip: str, errors: Array) -> Robot:
    """Return a robot with errors of its compliances, and of the load at a frame."""
    other = robot.with_scaled_load(tip, 1.0 + errors[-1])
    diagonals = other.diagonals()
    for group, error in zip(stiffnesses(robot), errors[:-1], strict=True):
        diagonals[0, group] /= 1.0 + error
    other.set_diagonals(diagonals)
    return other


def model_errors(
    robot: Robot, joints: Sequence[str], tip: str, coordinates: NDArray[np.intp],
    motion: PlannedMotion, noise: Array,
) -> ModelErrors:  # fmt: skip
    """Return what errors of the model change of a plan whose tip is to stay where it is.

    Parameters
    ----------
    robot : Robot
        With all its springs, without loops or mimic joints.
    joints : sequence of str
        That are driven.
    tip : str
    coordinates : (m,) int array
        The minimal ones.
    motion : PlannedMotion
        Of the robot, as planned.
    noise : (measured,) array

    Raises
    ------
    SolverError
        There is no such plan.
    """
    step, asked = _nodes(motion)
    poses, driven = robot.frame_pose(tip, asked), robot.indices(joints)
    size = float(np.linalg.norm(poses[:, :3, 3], axis=1).max())
    target = Target(tip, poses, 1.0, TURN * size)

    def planned(errors: Array) -> tuple[Array, Array, Array]:
        """Return q, qd (k, n) and torque (k, joints) of a robot with errors."""
        problem = TipProblem(
            with_errors(robot, tip, errors), driven, [target], asked, DRAW * size, SMOOTH * size,
            step * len(asked),
        )  # fmt: skip
        first, last = (rest_posture(problem, k, asked[k])[0] - asked[k] for k in (0, -1))
        share = np.linspace(0.0, 1.0, len(asked))[:, None]
        guess = asked + (1.0 - share) * first + share * last
        none = np.zeros((len(asked), 0))
        q = settle(problem, (guess, none), step, size, lambda *_: None).q
        qd, qdd = differences(q, step)
        return q, qd, problem.torque(q, qd, qdd, none)

    count = len(stiffnesses(robot)) + 1
    unit = REACH * np.eye(count)
    tried = [*unit, *-unit]
    if count <= PAIRED:
        tried += [unit[a] + unit[b] for a, b in zip(*np.triu_indices(count, 1), strict=True)]
    exact, plans = planned(np.zeros(count)), [planned(errors) for errors in tried]
    by_terms = np.linalg.pinv(np.array([terms(errors) for errors in tried]))
    changed = [np.array([one[part] - exact[part] for one in plans]) for part in range(3)]
    q, qd, torques = (np.einsum('tp,pkn->knt', by_terms, part) for part in changed)
    states = np.concatenate([q[:, coordinates], qd[:, coordinates]], axis=1)
    return ModelErrors(step, states, torques, noise)


def _nodes(motion: PlannedMotion) -> tuple[float, Array]:
    """Return the step [s] and coordinates (k, n) at nodes of plans like a motion."""
    rows = np.array(motion.rows)[:, 0]
    usual = min(motion.step * (len(rows) - 1) / NODES, LONGEST_STEP)
    fewer = max(1, round(usual / motion.step))
    step = fewer * motion.step
    count = math.ceil((len(rows) - 1) / fewer) + 1 + math.ceil(AFTER / step)
    return step, rows[np.minimum(fewer * np.arange(count), len(rows) - 1)]
