"""Gains of the state feedback along a plan, and the proof of their stability."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from denoc_ros.control.closed_loop import Settling, settling
from denoc_ros.control.deviation_model import (
    PlannedState,
    deviation_model,
    require_same_coordinates,
)
from denoc_ros.control.feedback_design import (
    CORRELATION,
    PostureGains,
    Regulator,
    earlier_cost,
    estimator,
    gain_of,
    noise_of,
    reach_of,
    regulator,
    settled_cost,
    whole_rows,
)
from denoc_ros.control.feedback_settings import FeedbackSettings
from denoc_ros.control.model_errors import (
    ModelErrors,
    error_accelerations,
    knows_errors,
    preview,
)
from denoc_ros.control.planned_states import PlannedMotion
from denoc_ros.control.read_values import chosen_values, read_sensors
from denoc_ros.dynamics.measured_side import MeasuredStates, whole_robot
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import StateError
from denoc_ros.model.arrays import is_flexible
from denoc_ros.model.link_side import motors_behind
from denoc_ros.types import Array

Int = NDArray[np.intp]

TRIED = 17  # postures of a plan at which stability is shown, at most


@dataclass(frozen=True)
class GainSchedule:
    """What the loop needs along a plan.

    Attributes
    ----------
    times : (k,) array
        [s], ascending, evenly spaced; before and after them the first and the last hold.
    gains : tuple of PostureGains
    postures : (k, driven) array
        Of the driven joints [rad, m], as joint states have them.
    coordinates : (m,) int array
        Where the minimal coordinates stand among those of the robot with all its springs.
    joints, sensors : (driven,) and (read,) int arrays
        Coordinates of the driven joints; places of the values that are read among those of
        :func:`denoc_ros.control.read_values.numbered_values`.
    limits : (driven,) array
        Effort limits [N m, N].
    settings : FeedbackSettings
    slowest : Settling
        The proof: the slowest mode over the postures tried, the model's stiffness and load off
        by 20 % either way.
    errors : ModelErrors or None
        Errors of the model that are estimated on the way.
    """

    times: Array
    gains: tuple[PostureGains, ...]
    postures: Array
    coordinates: Int
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
    solved: list[tuple[Regulator, Array]] | None = None,
) -> GainSchedule:
    """Return the gains along a plan, shown to be stable for models that are 20 % off.

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
        (see :func:`denoc_ros.control.planned_states.spacing`).
    states : sequence of PlannedState
    settings : FeedbackSettings
    solved : list, optional
        Gets the problem of each state and the cost one period later, the last state first.

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
    noise = noise_of(robot, len(joints), values, limits, settings)
    stiff = robot.stiffness[robot.flexible_indices]
    cost: Array | None = None
    gains: list[PostureGains] = []
    for model, state in zip(reversed(models), reversed(states), strict=True):
        problem = regulator(model, limits, settings)
        cost = settled_cost(problem) if cost is None else earlier_cost(problem, cost, doublings)
        if solved is not None:
            solved.append((problem, cost))
        forces = noise.forces(state, stiff, settings.model_error)
        transition = noise.with_biases(
            model.disturbed(settings.period, CORRELATION), settings.period
        )
        measured = whole_rows(model, noise)
        correction, spread = estimator(measured, transition, noise, forces, len(measured))
        blind, _ = estimator(measured, transition, noise, forces, 2 * len(joints))
        sampled = model.sampled(settings.period, settings.delay)
        s = 2 * model.size
        push = np.hstack([sampled.a[:s, s:], sampled.b[:s]])
        gains.append(PostureGains(
            gain_of(problem, cost, limits, settings), transition, push, correction,
            measured, spread, blind, reach_of(model, noise), problem.virtual,
        ))  # fmt: skip
    gains.reverse()
    chosen = np.unique(np.linspace(0, len(states) - 1, min(TRIED, len(states))).astype(int))
    slowest = settling(
        robot, joints, rows, [states[k] for k in chosen],
        [gains[k] for k in chosen], settings,
    )  # fmt: skip
    if not slowest.modulus < 1.0:
        raise StateError(
            'state feedback: the sampled closed loop must be stable for 0.8 to 1.2 of the '
            f'stiffness and of the load at the tip, got {slowest}; a larger tip_error, '
            'joint_error or integral_time, or a smaller effort_share, model_error or delay '
            'may help'
        )
    names = models[0].linear.state_names[: models[0].size]
    coordinates = np.array([robot.coordinate_names.index(name) for name in names], dtype=np.intp)
    index = np.asarray(robot.indices(joints), dtype=np.intp)
    seen = MeasuredStates(robot, joints)
    postures = np.array([seen.posture(state.q) for state in states])
    return GainSchedule(
        np.asarray(times), tuple(gains), postures, coordinates, index, sensors, limits, settings,
        slowest,
    )  # fmt: skip


def design_along(
    robot: Robot,
    joints: Sequence[str],
    limits: Array,
    motion: PlannedMotion,
    settings: FeedbackSettings,
) -> GainSchedule:
    """Return the gains along a motion, and what errors of the model do to it.

    Arguments and errors as of :func:`design`; of robots with loops or mimic joints no errors are
    estimated.
    """
    robot = whole_robot(robot)
    solved: list[tuple[Regulator, Array]] = []
    found = design(robot, joints, limits, motion.times, motion.states, settings, solved)
    if not knows_errors(robot):
        return found
    accelerations = error_accelerations(robot, settings.tip, found.coordinates, motion.rows)
    problems, costs = zip(*reversed(solved), strict=True)
    ahead = preview(problems, costs, accelerations, motion.step, limits, settings)
    return replace(found, errors=ModelErrors(motion.step, accelerations, ahead))


def _doublings(times: Array, settings: FeedbackSettings) -> int:
    if len(times) == 1:
        return 0
    return round(math.log2((times[1] - times[0]) / settings.period))


def require_sensors(
    robot: Robot, joints: Sequence[str], limits: Array, settings: FeedbackSettings
) -> Int:
    """Return the sensors to read, if robot and limits are what feedback needs."""
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
