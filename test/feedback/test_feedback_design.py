"""Laws of the state feedback's gains, and that its closed loop does what it predicts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from feedback_runs import CANADARM, DELAY, PERIOD, START, canadarm
from imu_arms import imu_text

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import StateError
from denoc_ros.feedback.closed_loop import closed_loop
from denoc_ros.feedback.deviation_model import DeviationModel, deviation_model
from denoc_ros.feedback.feedback_design import (
    earlier_cost,
    gain_of,
    regulator,
    settled_cost,
)
from denoc_ros.feedback.feedback_settings import FeedbackSettings
from denoc_ros.feedback.gain_schedule import GainSchedule, design
from denoc_ros.feedback.planned_states import spacing, state_at
from denoc_ros.feedback.read_values import chosen_values, read_sensors
from denoc_ros.feedback.state_feedback import RAMP, StateFeedback

LIMITS = np.full(3, 5000.0)
NO_JOINTS = np.zeros((3, 6))  # no feedback of the joints beside
SETTINGS = FeedbackSettings(period=PERIOD, tip='tool', delay=DELAY * PERIOD)
STATE = state_at(canadarm(), canadarm().joint_names, START, 0.1 * LIMITS)


def model(robot: Robot) -> DeviationModel:
    values = chosen_values(robot.tree, read_sensors(robot.tree))
    rows = [value.place for value in values]
    return deviation_model(robot, robot.joint_names, rows, 'tool', STATE)


def posture(settings: FeedbackSettings = SETTINGS, source: str = str(CANADARM)) -> GainSchedule:
    robot = canadarm(source=source)
    return design(robot, robot.joint_names, LIMITS, np.zeros(1), [STATE], settings)


def test_settled_cost_solves_the_riccati_equation_as_scipy_does() -> None:
    problem = regulator(model(canadarm()), LIMITS, SETTINGS, NO_JOINTS)
    cost = settled_cost(problem)
    a, b = problem.a, problem.b
    gain = np.linalg.solve(np.eye(3) + b.T @ cost @ b, b.T @ cost @ a)
    residual = problem.weight + a.T @ cost @ (a - b @ gain) - cost
    # processors round differently: 4e-10 on one, 1.2e-9 on another
    assert np.abs(residual).max() < 1e-7 * np.abs(cost).max()
    oracle = scipy.linalg.solve_discrete_are(a, b, problem.weight, np.eye(3))
    np.testing.assert_allclose(cost, oracle, rtol=1e-5, atol=1e-7 * np.abs(oracle).max())


def test_doubling_is_the_riccati_recursion_step_by_step() -> None:
    problem = regulator(model(canadarm()), LIMITS, SETTINGS, NO_JOINTS)
    a, b = problem.a, problem.b
    stepped = problem.weight
    for _ in range(16):
        gain = np.linalg.solve(np.eye(3) + b.T @ stepped @ b, b.T @ stepped @ a)
        stepped = problem.weight + a.T @ stepped @ (a - b @ gain)
    doubled = earlier_cost(problem, problem.weight, 4)
    np.testing.assert_allclose(doubled, stepped, rtol=1e-9, atol=1e-9 * np.abs(stepped).max())


@pytest.mark.parametrize('integral_time', [0.0, 0.1])
def test_poles_of_the_regulator_are_those_of_plant_and_gain(integral_time: float) -> None:
    settings = replace(SETTINGS, integral_time=integral_time)
    plant = model(canadarm())
    problem = regulator(plant, LIMITS, settings, NO_JOINTS)
    gain = gain_of(problem, settled_cost(problem), LIMITS, settings)
    sampled = plant.sampled(PERIOD, DELAY * PERIOD)
    count, s = len(problem.a), len(sampled.a)
    a, b = np.eye(count), np.zeros((count, 3))
    a[:s, :s], b[:s] = sampled.a, sampled.b
    if integral_time:
        a[s:, : plant.size] = PERIOD * problem.virtual
    assert np.abs(np.linalg.eigvals(a - b @ gain[:, :count])).max() < 1.0


@pytest.mark.parametrize(
    ('sensor_delay', 'source'),
    [(0.0, str(CANADARM)), (2.0 * PERIOD, str(CANADARM)), (0.0, imu_text('root'))],
    ids=['gauges', 'late gauges', 'imus'],
)
def test_loop_does_what_its_closed_form_predicts(sensor_delay: float, source: str) -> None:
    # the linear plant under the very code that runs in the loop, beside the powers of a matrix
    settings = replace(SETTINGS, sensor_delay=sensor_delay, sensor_timeout=1.0)
    robot, schedule = canadarm(source=source), posture(settings, source)
    gains, plant = schedule.gains[0], model(canadarm(0.9, source=source))
    still = robot.sensor_values(STATE.q, STATE.qd)
    rows = [value.place for value in chosen_values(robot.tree, schedule.sensors)]
    step = closed_loop(plant, gains, settings)
    sampled = plant.sampled(PERIOD, settings.delay)
    feedback = StateFeedback(robot, schedule)
    count = round((RAMP + 0.4) / PERIOD)
    k, s = 3, 2 * plant.size
    x, late = np.zeros(len(sampled.a)), round(sensor_delay / PERIOD)
    seen = []
    predicted = np.zeros(len(step))
    for index in range(count + 40):
        now = index * PERIOD
        feedback.follow(now, STATE.q, STATE.qd)
        if index == count:
            # a kick so small that no gate opens, and the full share of the feedback
            assert feedback.share == 1.0
            x[:k] = 1e-9
            predicted[:s] = x[:s]
        values = plant.measured @ x[:s]
        seen.append(values)
        feedback.filter.take_joints(now, STATE.q[schedule.joints] + values[:k], values[k : 2 * k])
        if index >= late:
            bent = still[rows] + seen[index - late][2 * k :]
            for place, value in zip(schedule.sensors.tolist(), bent, strict=True):
                feedback.filter.take_sensor(place, now - sensor_delay, value)
        torque = feedback.torque(now).copy()
        feedback.applied(torque)
        x = sampled.a @ x + sampled.b @ torque
        if index >= count:
            predicted = step @ predicted
            scale = np.abs(predicted[:s]).max()
            np.testing.assert_allclose(x[:s], predicted[:s], atol=1e-6 * scale)
    assert np.abs(x[:s]).max() > 0.0


def test_loop_that_a_soft_model_would_drive_unstable_is_refused_with_numbers() -> None:
    told = (
        r'stable for 0\.8 to 1\.2 of the stiffness and of the load at the tip, got modulus '
        r'1\.\d+ at \S+ Hz with (0\.8|1|1\.2) of the stiffness and (0\.8|1|1\.2) of the load, '
        r'joints at \[0\.175, 0\.698, 0\.524\]'
    )
    with pytest.raises(StateError, match=told):
        posture(replace(SETTINGS, tip_error=1e-4, tip_turn=1e-3))
    with pytest.raises(StateError, match=told):
        posture(replace(SETTINGS, integral_time=0.01))
    assert posture().slowest.modulus < 1.0


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'tip': 'nose'}, "tip must be one of base, .*, got 'nose'"),
        ({'tip_error': 0.0}, 'tip_error must be > 0 m, got 0.0'),
        ({'delay': -1.0}, 'delay must be >= 0 s, got -1.0'),
        ({'limit': 2.0}, 'limit must be > 0, <= 1, got 2.0'),
    ],
)
def test_wrong_settings_are_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(StateError, match=message):
        posture(replace(SETTINGS, **change))  # type: ignore[arg-type]


def test_robot_without_limits_or_sensors_is_refused() -> None:
    robot = canadarm()
    with pytest.raises(StateError, match='effort limits must be finite and > 0'):
        design(robot, robot.joint_names, np.full(3, np.inf), np.zeros(1), [STATE], SETTINGS)


def test_gains_stand_a_power_of_two_of_periods_apart() -> None:
    for duration in (0.5, 10.0, 120.0):
        apart = spacing(duration, PERIOD) / PERIOD
        assert np.log2(apart) % 1.0 == 0.0
        assert duration / (apart * PERIOD) <= 200.0
