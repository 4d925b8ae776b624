"""Errors of the model along a plan: plans of robots that have them, and their estimate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from denoc_ros.control.feedback_design import PostureGains
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
LIKELY = 0.2  # standard deviation of an error before anything is measured
LARGEST = 0.4  # error that is believed
TRUST = 0.3  # the innovations' spread counts so much: the filter allows for more than is true
# in its place, where robots have modes beyond the design: what no error explains, and for how
# long [s] that stays alike, and over which time its size is averaged
ALIKE, AVERAGED = 0.075, 1.0
GATE = 4.0  # of the innovations' spread: beyond it something else was at work
QUIET = 0.3  # s after a pause of the loop in which its trace is not taken for an error's
DOUBT = 1.0  # standard deviations within which a combination of errors may well be none
ENTERS = 0.03  # s over which an error comes in
WALK = 0.01  # standard deviation of what an error changes within a second


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


@cache
def _pairs(count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return both errors of each product of two of so many."""
    return np.triu_indices(count)


def terms(errors: Array) -> Array:
    """Return all that a polynomial of second degree without a constant has of errors (e,)."""
    first, second = _pairs(len(errors))
    return np.concatenate([errors, errors[first] * errors[second]])


def terms_rate(errors: Array) -> Array:
    """Return the derivative (terms, e) of the terms by the errors."""
    first, second = _pairs(len(errors))
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
    """Return the changes of a plan by errors of the model, with the tip kept in place.

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


class ErrorEstimate:
    """Errors of the model along a plan, and the plan of the robot that has them.

    The filter of deviations takes the robot for one with the errors `used`, on that robot's plan,
    its tip where it was: deviations stay small however wrong the model is. The filter is then off
    by `seen` @ (errors - used), whatever the deviations are, and its innovations show the errors.
    Filter, gains and the proof of their stability stay as they are.

    What the innovations have beyond the errors' own uncertainty no error explains: noise, a gauge
    that sticks, a beam that bends otherwise. It counts as noise: nothing is learned of it.

    Parameters
    ----------
    errors : ModelErrors
    period : float
        Of the loop [s].
    size : int
        Of the filter's estimate.

    Attributes
    ----------
    values : (errors,) array
        As estimated: of each beam's (spring's) compliance, then of the load.
    used : (errors,) array
        On which plan and filter rely: their independent combinations that are beyond their
        standard deviations, followed smoothly.
    seen : (e, errors) array
        How far the filter's estimate is from the truth, by unit errors.

    Notes
    -----
    Two-stage estimation of a constant bias: B. Friedland, Treatment of bias in recursive
    filtering, IEEE Transactions on Automatic Control 14 (1969). Noise from the innovations: R. K.
    Mehra, On the identification of variances and adaptive Kalman filtering, same 15 (1970).
    """

    def __init__(self, errors: ModelErrors, period: float, size: int) -> None:
        self._errors, self._period = errors, period
        self.values, self.used = np.zeros((2, self._errors.count))
        self.seen: Array = np.zeros((size, self._errors.count))
        self._covariance: Array = LIKELY**2 * np.eye(self._errors.count)
        self._quiet = -np.inf
        self._unexplained = np.square(self._errors.noise)
        # at rest errors show no more: what is seen then is noise
        self._end = (len(self._errors.states) - 1) * self._errors.step
        self._states = np.zeros(self._errors.states.shape[1:])
        self._torques = np.zeros(self._errors.torques.shape[1:])

    def reset(self) -> None:
        """Forget the errors."""
        self.values[:] = self.used[:] = 0.0
        self._covariance = LIKELY**2 * np.eye(len(self.values))
        self._unexplained[:] = np.square(self._errors.noise)
        self.forget_deviations()

    def forget_deviations(self) -> None:
        """Take note that the filter has started anew from measurements."""
        self.seen[:] = 0.0

    def adopt(self, other: ErrorEstimate | None) -> None:
        """Go on with the values of another estimate of the same errors."""
        if other is not None and other.seen.shape == self.seen.shape:
            self.values[:], self.used[:], self.seen[:] = other.values, other.used, other.seen
            self._covariance, self._unexplained = other._covariance, other._unexplained

    def show(self, time: float) -> bool:
        """Say whether a time of the plan [s] is one of its motion, in which the errors show."""
        return 0.0 < time < self._end - AFTER

    def doubt(self, time: float) -> None:
        """Learn nothing for a while from a time of the plan [s] on: the torque was not as told."""
        self._quiet = time + QUIET

    def correct(
        self, gains: PostureGains, innovation: Array, at: NDArray[np.intp], time: float
    ) -> None:
        """Learn from the innovations of the filter at some places, at a time of the plan [s]."""
        if not self._quiet <= time <= self._end or not len(at):
            return
        expected = gains.measured[at] @ self.seen
        left = innovation[at] - expected @ (self.values - self.used)
        if (np.abs(left) > GATE * gains.spread[at]).any():
            self.doubt(time)
            return
        across = self._covariance @ expected.T
        known = expected @ across
        noise = np.square(TRUST * gains.spread[at])
        if len(self._unexplained):
            beyond = np.maximum(left**2 - np.diag(known), 0.0)
            self._unexplained[at] += self._period / AVERAGED * (beyond - self._unexplained[at])
            noise = ALIKE / self._period * self._unexplained[at]
        gain = np.linalg.solve(known + np.diag(noise), across.T).T
        self.values += gain @ left
        np.clip(self.values, -LARGEST, LARGEST, out=self.values)
        self._covariance = self._covariance - gain @ across.T

    def follow(self, gains: PostureGains, correction: Array, at: NDArray[np.intp]) -> None:
        """Take note that the filter has corrected its estimate by the innovations at places."""
        self.seen -= correction[:, at] @ (gains.measured[at] @ self.seen)

    def go_on(self, gains: PostureGains, state: Array, time: float) -> Array:
        """Go on by a period from a time of the plan [s].

        A robot with the errors stays on its own plan under its torque.

        Parameters
        ----------
        gains : PostureGains
        state : (e,) array
            Of the filter; changed to that under the plan's torque.
        time : float

        Returns
        -------
        (2 m,) array
            What the torque of the errors `used` does to the deviations.
        """
        held = gains.push.reshape(len(gains.push), -1, len(self._torques)).sum(axis=1)
        s, rates = len(held), terms_rate(self.used)
        states, torques = self._plan(time)
        pushed = held @ torques
        away = gains.transition[:, :s] @ states
        away[:s] += pushed
        self.seen = gains.transition @ self.seen - away @ rates
        state -= away @ terms(self.used)
        states, _ = self._plan(time + self._period)
        self.seen[:s] += states @ rates
        state[:s] += states @ terms(self.used)
        self._covariance += WALK**2 * self._period * np.eye(len(self.values))
        believed = self.values
        if len(self._unexplained):
            variances, ways = np.linalg.eigh(self._covariance)
            along, doubt = ways.T @ self.values, DOUBT**2 * variances
            believed = ways @ (along * (1.0 - doubt / np.maximum(along**2, doubt)))
        change = self._period / (self._period + ENTERS) * (believed - self.used)
        self.used += change
        state += self.seen @ change
        return np.asarray(pushed @ terms(self.used))

    def state(self, time: float) -> Array:
        """Return the change of the plan's deviations (2 m,) by the errors used, at a time."""
        return np.asarray(self._plan(time)[0] @ terms(self.used))

    def torque(self, time: float) -> Array:
        """Return the change of the plan's torque (joints,) by the errors used, at a time."""
        return np.asarray(self._plan(time)[1] @ terms(self.used))

    def _plan(self, time: float) -> tuple[Array, Array]:
        """Return the changes of the plan's states and torque by terms of errors, at a time."""
        errors = self._errors
        return (
            errors.between(errors.states, time, self._states),
            errors.between(errors.torques, time, self._torques),
        )
