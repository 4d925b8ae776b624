"""Gains of the state feedback along a plan, and the proof of their stability."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.driven.measured_side import MeasuredStates, whole_robot
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.feedback.closed_loop import (
    Settling,
    closed_loop,
    joint_loop,
    plants,
    slow_modes,
    slowest_mode,
)
from denoc_ros.feedback.deviation_model import (
    DeviationModel,
    PlannedState,
    deviation_model,
    require_same_coordinates,
)
from denoc_ros.feedback.feedback_design import (
    CORRELATION,
    KNOWN,
    STRAINING,
    Noise,
    PostureGains,
    by_terms,
    earlier_cost,
    estimator,
    gain_of,
    joint_gains,
    noise_of,
    reach_of,
    regulator,
    settled_cost,
    terms,
    whole_rows,
)
from denoc_ros.feedback.feedback_settings import FeedbackSettings
from denoc_ros.feedback.model_errors import (
    LAST_MOVING,
    ModelErrors,
    compliances,
    extreme_errors,
    knows_errors,
    model_errors,
    state_with_errors,
    stiffnesses,
    tried_errors,
    with_errors,
)
from denoc_ros.feedback.planned_states import PlannedMotion, state_at
from denoc_ros.feedback.read_values import chosen_values, read_sensors
from denoc_ros.feedback.residual_modes import is_hardened, other_robots
from denoc_ros.model.arrays import is_flexible
from denoc_ros.model.link_side import motors_behind
from denoc_ros.types import Array

Int = NDArray[np.intp]

POSTURES = 17  # postures of a plan at which stability is shown, at most
# factors of the errors, and of the time of integrals, until the loop is stable
LOWER = ((1.0, 1.0), (1.0, 4.0), (2.0, 4.0), (4.0, 4.0), (8.0, 8.0))
LOWERED = ('tip_error', 'tip_turn', 'joint_error', 'integral_time')  # times these factors
OTHERS = ', and with other modes of the links'
# Hz: modes that are faster count as damped by so much more, so that no gain is spent on them
LEFT_ALONE, MORE_DAMPED = 6.0, 0.3
HALVINGS = 5  # of the joints' bandwidth
NEUTRAL = 1e-9  # what rounding makes of a modulus of 1
# the estimate that learns: factors of the noise of sensors on beams and of the least forces, and
# share of the model's error that is left where stiffness and load are estimated
FINE, FINE_LEAST, KNOWN_FINE = 1.5, 0.2, 0.01
# factors of the rates' noise, until no filter takes back more than a share of what it assumed a
# period before: one of a robot with errors would ring, where periods are long
CALMER, TAKEN_BACK = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0), 0.7
TRUST = 0.3  # without modes beyond the design's: the filter allows for more than is true
TRIED = 3  # postures at which robots with other modes are tried, at most
PARTS = (1.0, 0.5)  # of the feedback: it comes in and goes
Plant = tuple[DeviationModel, float, float, str]


class Proof:
    """Linear models of all the robots that feedback along a plan must hold.

    Parameters
    ----------
    robot : Robot
        Of the design.
    joints : sequence of str
        That are driven.
    sensors : sequence of int
        As of :func:`denoc_ros.feedback.deviation_model.deviation_model`.
    states : sequence of PlannedState
        Moments of the plan.
    settings : FeedbackSettings
    hard : bool
        Whether to try robots with other modes, too.

    Notes
    -----
    At every posture the robot of the design, its stiffness and the load at its tip off by 20 %
    either way, which the filter knows or not; at some also robots with other shape functions and
    with beams in segments.
    """

    def __init__(
        self, robot: Robot, joints: Sequence[str], sensors: Sequence[int],
        states: Sequence[PlannedState], settings: FeedbackSettings, hard: bool,
    ) -> None:  # fmt: skip
        seen = MeasuredStates(robot, joints)
        self._settings, self.hard = settings, hard
        self._compliances, self._errors = len(stiffnesses(robot)), len(compliances(robot)) + 1
        self._postures = [seen.posture(state.q) for state in states]
        self._plants: list[list[Plant]] = [
            [(*plant, '') for plant in plants(robot, joints, sensors, state, settings)]
            for state in states
        ]
        others = other_robots(robot) if hard else {}
        for place in np.unique(np.linspace(0, len(states) - 1, TRIED).astype(int)):
            for name, other in others.items():
                self._plants[place][:0] = self._others(
                    robot, other, name, joints, sensors, states[place], self._postures[place]
                )

    def _others(
        self, robot: Robot, other: Robot, name: str, joints: Sequence[str],
        sensors: Sequence[int], state: PlannedState, position: Array,
    ) -> Iterator[Plant]:  # fmt: skip
        posture = np.zeros(other.n)
        posture[other.joint_indices] = state.q[robot.joint_indices]
        there = state_at(other, joints, position, state.torque, posture)
        for model, stiffness, load in plants(other, joints, sensors, there, self._settings):
            yield slow_modes(model), stiffness, load, name

    def slowest(self, gains: Sequence[PostureGains]) -> Settling:
        """Return the slowest mode over all postures and robots, or the first unstable one.

        Parameters
        ----------
        gains : sequence of PostureGains
            Of the loop at each of the states.
        """
        settings, found = self._settings, []
        for posture, here, gain in zip(self._postures, self._plants, gains, strict=True):
            for model, stiffness, load, name in here:
                tried = [(gain, part) for part in (PARTS if self.hard else PARTS[:1])]
                if gain.by_errors.any() and (stiffness, load) != (1.0, 1.0):
                    errors = np.zeros(self._errors)
                    errors[: self._compliances], errors[-1] = 1.0 / stiffness - 1.0, load - 1.0
                    transition, push = gain.with_errors(errors)
                    tried.append((replace(gain, transition=transition, push=push), PARTS[0]))
                for used, part in tried:
                    step = closed_loop(model, used, settings, part)
                    modulus, hertz = slowest_mode(step, settings.period)
                    found.append(Settling(modulus, posture, stiffness, load, hertz, name, part))
                    if not modulus < 1.0 and self.hard:
                        return found[-1]
        return max(found, key=lambda one: one.modulus)

    def slowest_of_joints(self, gains: Sequence[Array]) -> Settling:
        """Return the slowest mode that vibrates with the joints' own feedback alone.

        Parameters
        ----------
        gains : sequence of (joints, 2 joints) arrays
            Of the joints at each of the states.
        """
        settings, found = self._settings, []
        for posture, here, gain in zip(self._postures, self._plants, gains, strict=True):
            for model, stiffness, load, name in here:
                modulus, hertz = slowest_mode(joint_loop(model, gain, settings), settings.period)
                found.append(Settling(modulus, posture, stiffness, load, hertz, name, 0.0))
        return max(found, key=lambda one: one.modulus)


@dataclass(frozen=True)
class GainSchedule:
    """Gains of the loop along a plan.

    Attributes
    ----------
    times : (k,) array
        [s], ascending, evenly spaced; before and after them the first and the last hold.
    gains : tuple of PostureGains
    postures : (k, driven) array
        Of the driven joints [rad, m], as joint states have them.
    coordinates : (m,) int array
        Where the minimal coordinates stand among those of the robot with all its springs.
    names : tuple of str
        The driven joints.
    joints, sensors : (driven,) and (read,) int arrays
        Coordinates of the driven joints, of the robot of the design; places of the values that
        are read among those of :func:`denoc_ros.feedback.read_values.numbered_values`.
    limits : (driven,) array
        Effort limits [N m, N].
    settings : FeedbackSettings
        With a bandwidth of the joints and errors of tip and joints for which the loop is stable:
        lower and larger ones than those asked for, where these were not.
    slowest : Settling
        The proof: the slowest mode over the postures tried, stiffness and load off by 20 % either
        way, and other modes of the links.
    errors : ModelErrors or None
        Errors of the model that are estimated on the way.
    """

    times: Array
    gains: tuple[PostureGains, ...]
    postures: Array
    coordinates: Int
    names: tuple[str, ...]
    joints: Int
    sensors: Int
    limits: Array
    settings: FeedbackSettings
    slowest: Settling
    errors: ModelErrors | None = None

    def place(self, time: float) -> tuple[int, float]:
        """Return the gains before a time [s] and the share of the way to the next ones."""
        if len(self.times) == 1:
            return 0, 0.0
        along = (time - self.times[0]) / (self.times[1] - self.times[0])
        along = min(max(along, 0.0), len(self.times) - 1.0)
        before = min(int(along), len(self.times) - 2)
        return before, along - before


def design(
    robot: Robot,
    joints: Sequence[str],
    limits: Array,
    times: Array,
    states: Sequence[PlannedState],
    settings: FeedbackSettings,
) -> GainSchedule:
    """Return the gains along a plan, shown to be stable for robots that are not the model.

    Parameters
    ----------
    robot : Robot
        Its workspace is used: do not share it with another thread.
    joints : sequence of str
        That are driven.
    limits : (joints,) array
        Effort limits [N m, N], finite.
    times : (k,) array
        Of the states [s]: one, or 2^j periods apart
        (see :func:`denoc_ros.feedback.planned_states.spacing`).
    states : sequence of PlannedState
    settings : FeedbackSettings

    Raises
    ------
    StateError
        The closed loop is not stable everywhere, with where and for which model; limits that are
        not finite; no such frame; no sensor.
    SolverError
        A deviation that the joints cannot stop or nothing shows.

    Notes
    -----
    On the way the gains are those of the Riccati difference equation backwards from the last
    state's infinite horizon; after it they are that one's.
    """
    robot = whole_robot(robot)
    sensors = require_sensors(robot, joints, limits, settings)
    doublings = _doublings(times, settings)
    values = chosen_values(robot.tree, sensors)
    rows = [value.place for value in values]
    models = [deviation_model(robot, joints, rows, settings.tip, state) for state in states]
    require_same_coordinates(models)
    hard = is_hardened(robot, joints)
    noise = noise_of(robot, len(joints), values, limits, settings, STRAINING if hard else 1.0)
    chosen = np.unique(np.linspace(0, len(states) - 1, min(POSTURES, len(states))).astype(int))
    proof = Proof(robot, joints, rows, [states[k] for k in chosen], settings, hard)
    settings = _with_stable_joints(settings, proof, [models[k] for k in chosen])
    knows = knows_errors(robot)
    share = (KNOWN if hard and knows else 1.0) * settings.model_error
    tried = tried_errors(robot) if knows else np.zeros((0, 0))
    fine, others = None, [[model] * len(tried) for model in models]  # with errors of the model
    if hard and knows:
        fine = noise_of(robot, len(joints), values, limits, settings, FINE, FINE_LEAST)
        for place, errors in enumerate(tried):
            other = with_errors(robot, settings.tip, errors, LAST_MOVING)
            for some, state in zip(others, states, strict=True):
                there = state_with_errors(robot, state, errors)
                some[place] = deviation_model(other, joints, rows, settings.tip, there)
    if hard:  # what moves faster is left to the joints' own feedback
        models, *others = (
            [model.damped(LEFT_ALONE, MORE_DAMPED) for model in some] for some in (models, *others)
        )
    made = by_terms(tried) if knows else tried
    by_errors = [_by_errors(*pair, made, settings) for pair in zip(models, others, strict=True)]
    if fine is not None:
        places = [(models[k], states[k], by_errors[k]) for k in chosen]
        noise = _calm(noise, robot, places, share, settings)
        fine = _calm(fine, robot, places, KNOWN_FINE * settings.model_error, settings)
    for factor, slower in LOWER if hard else LOWER[:1]:
        factors = dict.fromkeys(LOWERED, factor) | {'integral_time': slower}
        lower = replace(settings, **{n: by * getattr(settings, n) for n, by in factors.items()})
        gains = _gains(
            robot, models, states, limits, lower, noise, doublings, share, fine, by_errors
        )
        slowest = proof.slowest([gains[k] for k in chosen])
        if slowest.modulus < 1.0:
            break
    else:
        raise StateError(
            'state feedback: the sampled closed loop must be stable for 0.8 to 1.2 of the '
            f'stiffness and of the load at the tip{OTHERS if hard else ""}, got '
            f'{slowest}; a larger tip_error, joint_error or integral_time, or a smaller '
            'effort_share, joint_bandwidth, model_error or delay may help'
        )
    names = models[0].linear.state_names[: models[0].size]
    coordinates = np.array([robot.coordinate_names.index(name) for name in names], dtype=np.intp)
    index = np.asarray(robot.indices(joints), dtype=np.intp)
    seen = MeasuredStates(robot, joints)
    postures = np.array([seen.posture(state.q) for state in states])
    return GainSchedule(
        np.asarray(times), tuple(gains), postures, coordinates, tuple(joints), index, sensors,
        limits, lower, slowest,
    )  # fmt: skip


def _gains(
    robot: Robot, models: Sequence[DeviationModel], states: Sequence[PlannedState],
    limits: Array, settings: FeedbackSettings, noise: Noise, doublings: int, share: float,
    fine: Noise | None, by_errors: Sequence[Array],
) -> list[PostureGains]:  # fmt: skip
    """Return the gains at each state."""
    cost: Array | None = None
    gains: list[PostureGains] = []
    stiff = robot.stiffness[robot.flexible_indices]
    for model, state, changes in zip(*map(reversed, (models, states, by_errors)), strict=True):
        inner = joint_gains(model, settings.joint_bandwidth)
        problem = regulator(model, limits, settings, inner)
        cost = settled_cost(problem) if cost is None else earlier_cost(problem, cost, doublings)
        forces = noise.forces(state, stiff, share)
        transition, measured = _ahead(model, noise, settings), whole_rows(model, noise)
        correction, covariance = estimator(measured, transition, noise, forces, len(measured))
        spread = np.sqrt(np.diag(covariance))
        learner, surprise = correction, np.diag((TRUST * spread) ** 2)
        if fine is not None:
            forces = fine.forces(state, stiff, KNOWN_FINE * settings.model_error)
            learner, surprise = estimator(measured, transition, fine, forces, len(measured))
            forces = noise.forces(state, stiff, share)
        blind, _ = estimator(measured, transition, noise, forces, 2 * model.joints)
        s = 2 * model.size
        push = _response(model, settings)[:, s:]
        gains.append(PostureGains(*map(np.ascontiguousarray, (
            gain_of(problem, cost, limits, settings), transition, push, correction,
            measured, spread, blind, reach_of(model, noise), problem.virtual, inner, learner,
            surprise, changes, np.tile(model.softness, 2),
        ))))  # fmt: skip
    gains.reverse()
    return gains


def _ahead(model: DeviationModel, noise: Noise, settings: FeedbackSettings) -> Array:
    """Return the transition (e, e) of an estimate over a period."""
    moved = model.disturbed(settings.period, CORRELATION)
    return noise.with_biases(moved, settings.period)


def _calm(
    noise: Noise, robot: Robot, places: Sequence[tuple[DeviationModel, PlannedState, Array]],
    share: float, settings: FeedbackSettings,
) -> Noise:  # fmt: skip
    """Return the noise with that of rates so large that estimates with errors are calm."""
    stiff, errors = robot.stiffness[robot.flexible_indices], extreme_errors(robot)
    estimates = []
    for model, state, by_errors in places:
        transition, s = _ahead(model, noise, settings), 2 * model.size
        moved = np.tile(transition, (len(errors), 1, 1))
        for one, each in zip(moved, errors, strict=True):
            one[:s, :s] += np.tensordot(terms(each), by_errors[..., :s], 1)
        forces = noise.forces(state, stiff, share)
        estimates.append((whole_rows(model, noise), transition, forces, moved))
    for factor in CALMER:
        calmer, taken = noise.with_rates(factor, places[0][0].joints), 0.0
        for measured, transition, forces, moved in estimates:
            correction, _ = estimator(measured, transition, calmer, forces, len(measured))
            left = np.eye(len(transition)) - correction @ measured
            taken = max(taken, -np.linalg.eigvals(moved @ left).real.min())
        if taken <= TAKEN_BACK:
            break
    return calmer


def _response(model: DeviationModel, settings: FeedbackSettings) -> Array:
    """Return y (2 m, 2 m + past + joints) after a period, by y, torques on their way, the new."""
    sampled, s = model.sampled(settings.period, settings.delay), 2 * model.size
    return np.hstack([sampled.a[:s], sampled.b[:s]])


def _by_errors(
    model: DeviationModel, others: Sequence[DeviationModel], made: Array,
    settings: FeedbackSettings,
) -> Array:  # fmt: skip
    """Return the change (terms, ...) of the response by errors, from robots that have some.

    `made` (terms, others) is that of :func:`by_terms`. All are zero for robots that are the model
    itself: a design without other modes is not stable with a filter that follows the errors.
    """
    exact = _response(model, settings)
    changed = np.array([_response(other, settings) - exact for other in others])
    return np.tensordot(made, changed.reshape(-1, *exact.shape), 1)


def _with_stable_joints(
    settings: FeedbackSettings, proof: Proof, models: Sequence[DeviationModel]
) -> FeedbackSettings:
    """Return settings with a bandwidth of the joints with which they are stable by themselves."""
    bandwidth = settings.joint_bandwidth if proof.hard else 0.0
    for _ in range(HALVINGS):
        slowest = proof.slowest_of_joints([joint_gains(model, bandwidth) for model in models])
        if slowest.modulus <= 1.0 + NEUTRAL:
            return replace(settings, joint_bandwidth=bandwidth)
        bandwidth *= 0.5
    return replace(settings, joint_bandwidth=0.0)


def design_along(
    robot: Robot,
    joints: Sequence[str],
    limits: Array,
    motion: PlannedMotion,
    settings: FeedbackSettings,
) -> GainSchedule:
    """Design the gains along a motion, with the effect of model errors.

    Arguments and errors as of :func:`design`. Of robots with loops or mimic joints, and of plans
    that no other robot can follow with its tip, no errors are estimated.
    """
    robot = whole_robot(robot)
    found = design(robot, joints, limits, motion.times, motion.states, settings)
    if not knows_errors(robot):
        return found
    try:
        errors = model_errors(robot, joints, settings.tip, found.coordinates, motion)
    except SolverError:
        return found
    return replace(found, errors=errors)


def _doublings(times: Array, settings: FeedbackSettings) -> int:
    if len(times) == 1:
        return 0
    return round(math.log2((times[1] - times[0]) / settings.period))


def require_sensors(
    robot: Robot, joints: Sequence[str], limits: Array, settings: FeedbackSettings
) -> Int:
    """Select the sensors to read, if robot and limits fit feedback."""
    if settings.tip not in robot.tree.frames:
        known = ', '.join(robot.tree.frames)
        raise StateError(f'state feedback: tip must be one of {known}, got {settings.tip!r}')
    if not (np.isfinite(limits).all() and (limits > 0.0).all()):
        raise StateError(
            f'state feedback: effort limits must be finite and > 0, got {limits.tolist()}'
        )
    standing = [name for name in motors_behind(robot.tree) if name not in joints]
    if standing:
        raise StateError(
            'state feedback: every joint that is measured behind its spring must be driven, got '
            f'{", ".join(standing)} that {"is" if len(standing) == 1 else "are"} not'
        )
    sensors = read_sensors(robot.tree)
    if not len(sensors) and any(map(is_flexible, robot.tree.bodies)):
        raise StateError(
            'state feedback: a robot with flexible links must have gauges, load cells, '
            'deflection sensors or gyroscopes with a topic and noise > 0, got none'
        )
    return sensors
