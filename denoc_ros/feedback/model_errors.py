"""Errors of the model along a plan: plans of robots that have them, and their estimate."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.driven.motion_grid import differences
from denoc_ros.dynamics.elastic.state_history import StateHistory
from denoc_ros.dynamics.robot import Robot
from denoc_ros.feedback.deviation_model import PlannedState
from denoc_ros.feedback.feedback_design import PostureGains, by_terms, terms
from denoc_ros.feedback.kernels.deviation_kernels import (
    estimates_ahead,
    learn_errors,
    plan_changes,
)
from denoc_ros.feedback.planned_states import PlannedMotion
from denoc_ros.feedback.residual_modes import MORE, is_hardened
from denoc_ros.kernels.jit.compiled import entry
from denoc_ros.model.arrays import is_flexible
from denoc_ros.planning.tip.targets import Target
from denoc_ros.planning.tip.tip_at_rest import rest_posture
from denoc_ros.planning.tip.tip_grid import DRAW, LONGEST_STEP, NODES, SMOOTH, TURN
from denoc_ros.planning.tip.tip_problem import TipProblem
from denoc_ros.planning.tip.tip_solver import settle
from denoc_ros.types import Array

ERROR_KERNELS = (estimates_ahead, plan_changes, learn_errors)
MOST = 6  # compliances that are told apart; more count as one
REACH = 0.2  # errors at which plans of other robots are made
AFTER = 2.0  # s after the end of the motion that such a plan may use
PAIRED = 5  # errors of which all pairs are tried; of more each alone
LIKELY = 0.2  # standard deviation of an error before anything is measured
LIKELY_LAST = 0.15  # of that of the last modes, which is rare
# how much likelier than errors of that size none is, before anything is measured; and than the
# rare one
NONE, RARELY = 10.0, 10.0
UNSURE = 0.01  # standard deviation of what other modes of beams show as the rare error
# of the last modes' compliance, by a unit error: they turn a beam by a seventh, under a moment
LAST_MODES = 4.0
# of the same in the model of deviations, whose polynomial follows no stiffness that is five times
# itself; modes as fast as these hardly move by themselves
LAST_MOVING = 2.6
LARGEST = 0.4  # error that is believed
# of the innovations' spread: beyond it something else was at work; where sensors are checked, an
# offset is found otherwise, and ten channels pass 4 too often
GATE, CHECKED_GATE = 4.0, 5.0
QUIET = 0.3  # s after a pause of the loop in which its trace is not taken for an error's
ENTERS = 0.07  # s, each of two lags by which errors come in
HISTORY = 256  # periods over which values may be late
KEPT, APART = 3, 0.1  # estimates of the past that are kept, and the time between them [s]
# s over which a sensor's normalized innovations are averaged, and the average beyond which it
# contradicts the estimate. Healthy gauges reach 0.45 with EI and load 20 % off and beams of other
# shapes; a gauge that reads 1.3 times the strain reaches 1.5 after two periods of 1 ms.
CONTRADICTION_WINDOW_S, CONTRADICTION_SIGMAS = 0.02, 1.2
# s over which deviations are averaged, twice, that show errors by what the robot makes of them:
# else their noise, which the feedback's torque shares, would show errors of last modes at rest
AVERAGED = 0.03
# standard deviation of what an error changes within a second: with more, seconds later it is
# forgotten by how much beams of other shapes turn, and they swing after the stop
WALK = 0.003


@dataclass(frozen=True)
class ModelErrors:
    """Plans of robots with other compliances of their beams, and another load, tip as planned.

    Errors: of each beam's (or spring's) compliance, of that of the last modes (`LAST_MODES` times
    it), then of the load. What they change is a polynomial in them, of the terms of :func:`terms`.

    Attributes
    ----------
    step : float
        Time between rows [s]; the first is at the plan's start, the last one holds afterwards.
    states : (k, 2 m, terms) array
        What the plan's minimal coordinates and their rates change by.
    torques : (k, joints, terms) array
        What its torque changes by [N m, N].
    likely : (e,) array
        Standard deviation of each error before anything is measured.
    """

    step: float
    states: Array
    torques: Array
    likely: Array

    @property
    def count(self) -> int:
        """How many errors there are: of e, e (e + 3) / 2 terms."""
        return len(self.likely)


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


def last_modes(robot: Robot) -> NDArray[np.intp]:
    """Return the coordinate of the last mode of each bending, of beams with residual modes.

    It stands for all modes that a beam's shapes leave out: these turn the tip under a moment,
    which neither the curvature at gauges nor the deflection under a force shows.
    """
    found: list[int] = []
    if is_hardened(robot, robot.joint_names):
        for body in robot.tree.bodies:
            if body.beam is not None and is_flexible(body) and body.beam.segments == 1:
                modes = body.beam.modes[:2]
                ends = robot.amplitudes(body.name).start + np.cumsum(modes)
                found += [end - 1 for end, count in zip(ends, modes, strict=True) if count > MORE]
    return np.array(found, dtype=np.intp)


def compliances(robot: Robot, last: float = LAST_MODES) -> list[tuple[NDArray[np.intp], float]]:
    """Return the coordinates whose compliance is off together, and its change by a unit error.

    `last` is that of the last modes.
    """
    groups, modes = [(group, 1.0) for group in stiffnesses(robot)], last_modes(robot)
    return [*groups, (modes, last)] if len(modes) else groups


def tried_errors(robot: Robot) -> Array:
    """Return the errors (k, e) of other robots, from which a polynomial of the errors is made.

    Each one way, then each the other way, then pairs, unless there are too many: the last modes
    stiffer, as those of beams are that have modes left out.
    """
    count = len(compliances(robot)) + 1
    unit = REACH * np.eye(count)
    tried = [*unit, *-unit]
    if count <= PAIRED:
        if len(last_modes(robot)):
            unit[-2] *= -1.0
        tried += [unit[a] + unit[b] for a, b in zip(*np.triu_indices(count, 1), strict=True)]
    return np.array(tried)


def extreme_errors(robot: Robot) -> Array:
    """Return the errors (k, e) of robots whose beams are all off by `REACH`, and last modes."""
    count, rare = len(stiffnesses(robot)), len(last_modes(robot)) > 0
    ways = itertools.product((-REACH, REACH), repeat=1 + rare)
    return np.array([[way[0]] * count + [*way[1:], 0.0] for way in ways])


def with_errors(robot: Robot, tip: str, errors: Array, last: float = LAST_MODES) -> Robot:
    """Return a robot with errors of its compliances, and of the load at a frame."""
    other = robot.with_scaled_load(tip, 1.0 + errors[-1])
    diagonals = other.diagonals()
    for (group, change), error in zip(compliances(robot, last), errors[:-1], strict=True):
        diagonals[0, group] /= 1.0 + change * error
    other.set_diagonals(diagonals)
    return other


def state_with_errors(robot: Robot, state: PlannedState, errors: Array) -> PlannedState:
    """Return a moment of the plan of a robot with errors of its compliances, `LAST_MOVING`.

    Its beams bend otherwise under the same forces. A linear model about a moment at which they
    are not in balance has accelerations that no robot has.
    """
    q = state.q.copy()
    for (group, change), error in zip(compliances(robot, LAST_MOVING), errors[:-1], strict=True):
        q[group] *= 1.0 + change * error
    return replace(state, q=q)


def model_errors(
    robot: Robot, joints: Sequence[str], tip: str, coordinates: NDArray[np.intp],
    motion: PlannedMotion,
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

    tried = tried_errors(robot)
    count = tried.shape[1]
    exact, plans = planned(np.zeros(count)), [planned(errors) for errors in tried]
    made = by_terms(tried)
    changed = [np.array([one[part] - exact[part] for one in plans]) for part in range(3)]
    q, qd, torques = (np.einsum('tp,pkn->knt', made, part) for part in changed)
    likely = np.full(count, LIKELY)
    if len(last_modes(robot)):
        likely[-2] = LIKELY_LAST
        # gauges read the moment, which stays: these errors turn the joints, and bend no beam
        bends = terms(np.where(np.arange(count) == count - 2, 0.0, 1.0))
        q[:, robot.flexible_indices] *= bends
        qd[:, robot.flexible_indices] *= bends
    states = np.concatenate([q[:, coordinates], qd[:, coordinates]], axis=1)
    return ModelErrors(step, np.ascontiguousarray(states), np.ascontiguousarray(torques), likely)


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
    by `seen` @ (errors - used). The gains stay as they are.

    Errors z (e,) with covariance P count by their posterior probability beside none at all,
    1 / (1 + n exp(-z' P^-1 z / 2) prod(s) / sqrt(det P)), with n the constant `NONE` and s how
    large they are `likely` to be; each alone if that is larger. That of the last modes is first
    weighed against its being none. They enter through two lags, which leave out the modes that
    the design takes for damped: these would ring, and what rings would be learned for an error.

    A second estimate of the deviations, which nothing feeds back, shows the errors by its
    innovations: it allows for less that nobody knows than the filter of a loop must. It is a
    polynomial of second degree in the errors beside those used: of what came before the errors
    were used, a linear one would show soft beams for a light load.

    The mean of a sensor's normalized innovations shows within milliseconds that the sensor
    contradicts this estimate, long before the detection of faults finds the faulty one.

    Parameters
    ----------
    errors : ModelErrors
    period : float
        Of the loop [s].
    gains : PostureGains
        Any of the plan's.
    sensors : int
        How many of the measurements, the last ones, are of sensors that may be faulty.

    Attributes
    ----------
    values : (errors,) array
        As estimated: of each beam's (spring's) compliance, then of the load.
    used : (errors,) array
        On which plan and filter rely: the values by how likely they are beside none, followed
        smoothly.
    seen : (e, errors) array
        How far the filter's estimate is from the truth, by unit errors.
    expected : StateHistory
        Measurements (measured,) beyond the plan's, by the second estimate.

    Notes
    -----
    Two-stage estimation of a constant bias: B. Friedland, Treatment of bias in recursive
    filtering, IEEE Transactions on Automatic Control 14 (1969).
    """

    def __init__(
        self, errors: ModelErrors, period: float, gains: PostureGains, sensors: int
    ) -> None:
        self._errors, self._period = errors, period
        measured, size = gains.measured.shape
        count = errors.count
        self.values, self.used, self._entering = np.zeros((3, count))
        self.seen: Array = np.zeros((size, count))
        self._covariance: Array = np.diag(errors.likely**2)
        self._quiet = self._looked = -np.inf
        # at rest errors do not show: what is seen before the motion and long after it is noise
        self._end = (len(self._errors.states) - 1) * self._errors.step
        # changes of the plan's deviations and torque by the errors used, at the time looked at
        self._state = np.zeros(self._errors.states.shape[1])
        self._torque = np.zeros(self._errors.torques.shape[1])
        # of robots with errors, as linear functions of them: deviations from their own plan, and
        # torques beyond its own
        self._away = np.zeros((2, gains.by_errors.shape[2], 1 + count))
        self._past: deque[tuple[Array, Array]] = deque(maxlen=KEPT)
        self._since = 0.0
        # the second estimate: a polynomial in errors beside those used
        self._second: Array = np.zeros((size, 1 + len(terms(self.used))))
        self._first = measured - sensors
        self.expected = StateHistory(HISTORY, measured)
        self._mean = np.zeros(sensors)
        rare = int(np.argmin(errors.likely)) if np.ptp(errors.likely) > 0.0 else -1
        self._numbers = np.array([
            errors.step, period, period / (period + AVERAGED), period / (period + ENTERS),
            WALK**2 * period, NONE if sensors else 0.0, rare, RARELY, UNSURE, *errors.likely,
        ])  # fmt: skip
        self._pushed = np.zeros(len(gains.push))
        self._ahead, self._changes, self._correct = map(entry, ERROR_KERNELS)

    @property
    def estimate(self) -> Array:
        """The second estimate (e,)."""
        return self._second[:, 0]

    def reset(self) -> None:
        """Forget the errors."""
        self.values[:] = self.used[:] = self._entering[:] = 0.0
        self._covariance[:] = np.diag(self._errors.likely**2)
        self._past.clear()
        self._looked = -np.inf
        self._second[:], self._away[:], self._mean[:] = 0.0, 0.0, 0.0
        self.expected.clear()
        self.forget_deviations()

    def forget_deviations(self) -> None:
        """Take note that the filter has started anew from measurements."""
        self.seen[:] = 0.0

    def restart(self, gains: PostureGains, state: Array) -> None:
        """Let the second estimate go on from that of the filter."""
        count = len(self.used)
        self._second[:, 0], self._second[:, 1 + count :] = state, 0.0
        self._second[:, 1 : 1 + count] = self.seen
        self.expected.since(-np.inf)[1][:] = gains.measured @ state
        self._mean[:] = 0.0

    def adopt(self, other: ErrorEstimate | None, state: Array) -> None:
        """Go on with the values of another estimate of the same errors, if there is one.

        `state` (e,) is that of the filter.
        """
        self._second[:, 0] = state
        if other is not None and other._second.shape == self._second.shape:
            self.values[:], self.used[:], self.seen[:] = other.values, other.used, other.seen
            self._entering[:], self._looked = other._entering, -np.inf
            self._covariance, self._past = other._covariance, other._past
            self._away = other._away
            self._second, self.expected, self._mean = other._second, other.expected, other._mean

    def show(self, time: float) -> bool:
        """Say whether a time of the plan [s] is one of its motion, in which the errors show."""
        return 0.0 < time < self._end - AFTER

    def doubt(self, time: float, seconds: float = QUIET) -> None:
        """Learn nothing for a while from a time of the plan [s] on: not all was as told."""
        self._quiet = max(self._quiet, time + seconds)

    def forget_recent(self) -> None:
        """Go back to the errors of the oldest estimate kept: a sensor was faulty meanwhile."""
        if self._past:
            self.values[:], self._covariance[:] = self._past[0]
            self._past.clear()

    def contradictions(
        self, gains: PostureGains, innovation: Array, new: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Say which sensors contradict the estimate (sensors,), by its new innovations.

        The errors as they are estimated explain a part of an innovation, and their covariance
        adds to its variance.
        """
        first, count = self._first, len(self.used)
        shown = gains.measured[first:] @ self._second[:, 1 : 1 + count]
        missed = innovation[first:] - shown @ (self.values - self.used)
        variance = gains.surprise.diagonal()[first:] + ((shown @ self._covariance) * shown).sum(1)
        share = self._period / (self._period + CONTRADICTION_WINDOW_S) * new[first:]
        self._mean += share * (missed / np.sqrt(variance) - self._mean)
        return np.abs(self._mean) > CONTRADICTION_SIGMAS

    def push(self, now: float, gains: PostureGains) -> None:
        """Take note of the second estimate's expected values at a time [s]."""
        self.expected.push(now)[:] = gains.measured @ self.estimate

    def take(
        self, gains: PostureGains, innovation: Array, at: NDArray[np.intp], since: float,
        time: float | None,
    ) -> None:  # fmt: skip
        """Correct the second estimate, and learn from its innovations.

        Parameters
        ----------
        gains : PostureGains
        innovation : (measured,) array
            Of the second estimate.
        at : (k,) int array
            Which of them are new and may correct the estimate.
        since : float
            When they were measured [s]: what was expected later is corrected as well.
        time : float or None
            Of the plan [s]; None: nothing is to be learned of the errors.
        """
        history = self.expected
        learns = time is not None and max(self._quiet, 0.0) <= time <= self._end
        far = self._correct(
            gains.measured, gains.surprise, gains.spread, gains.learner, innovation, at,
            CHECKED_GATE if len(self._mean) else GATE, LARGEST, learns, self._second, self.values,
            self.used, self._covariance, history.times, history.states, len(history), since,
        )  # fmt: skip
        if far:
            assert time is not None
            self._quiet = time + QUIET

    def go_on(self, gains: PostureGains, state: Array, time: float, pushes: Array) -> Array:
        """Go on by a period from a time of the plan [s].

        A robot with the errors `used` stays on its own plan under its own torque, and moves away
        from it by its own model.

        Parameters
        ----------
        gains : PostureGains
        state : (e,) array
            Of the filter: in place.
        time : float
        pushes : (past + joints,) array
            All torques on their way and the new one, beyond the plan's [N m, N].

        Returns
        -------
        (2 m,) array
            What the torques beyond those of that robot's plan did to its deviations; the same
            array each time.
        """
        self._ahead(
            self._errors.states, self._errors.torques, self._numbers, time, gains.transition,
            gains.push, gains.by_errors, pushes, state, self.seen, self._second, self._covariance,
            self._away, self.values, self.used, self._entering, self._pushed,
        )  # fmt: skip
        self._looked = -np.inf
        self._since += self._period
        if self._since >= APART:
            self._since = 0.0
            self._past.append((self.values.copy(), self._covariance.copy()))
        return self._pushed

    def state(self, time: float) -> Array:
        """Change of the plan's deviations (2 m,) by the errors used; the same array each time."""
        self._look(time)
        return self._state

    def torque(self, time: float) -> Array:
        """Change of the plan's torque (joints,) by the errors used; the same array each time."""
        self._look(time)
        return self._torque

    def _look(self, time: float) -> None:
        """Find the changes of the plan at a time."""
        if time != self._looked:
            errors, self._looked = self._errors, time
            self._changes(
                errors.states, errors.torques, time / errors.step, self.used, self._state,
                self._torque,
            )  # fmt: skip
