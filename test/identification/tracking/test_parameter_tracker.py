"""Tracked payload and stiffness: found in motion, still at rest, never beyond their bounds."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tracked_runs import TrackedRun, follow, resting, simulated, swinging, with_noise

import denoc_ros as dn
from denoc_ros.types import Array

ROBOTS = Path(__file__).resolve().parents[3] / 'config' / 'robots'
TOOL = 'payload.tool.mass'
KNOWN = 100.0  # kg, as the tracker's model has it
TRUE = 120.0
GRAVITY = (0.0, -0.5, 0.0)  # on Earth the arm would bend by metres


def arm(gravity: tuple[float, float, float] = GRAVITY, mass: float = KNOWN) -> dn.Robot:
    robot = dn.load_robot(ROBOTS / 'canadarm_gauges.urdf', gravity=gravity)
    robot.set_payload('tool', mass)
    return robot


@cache
def swing(gravity: tuple[float, float, float]) -> TrackedRun:
    return with_noise(simulated(arm(gravity, TRUE), swinging(3), 5.0, 2e-3))


def samples(run: TrackedRun, time: float) -> int:
    return int(np.searchsorted(run.t, time))


def within(values: Array, share: float) -> bool:
    return bool(np.all(np.abs(values - TRUE) <= share * TRUE))


@pytest.mark.parametrize('gravity', [(0.0, 0.0, 0.0), GRAVITY])
@pytest.mark.parametrize('sensors', [False, True])
def test_payload_is_found_within_two_seconds(
    gravity: tuple[float, float, float], sensors: bool
) -> None:
    run = swing(gravity)
    tracker = dn.ParameterTracker(arm(gravity), [TOOL])
    values = follow(tracker, run, sensors=sensors)[:, 0]
    # noise of 0.5 % in effort and 1 % in gauges leaves 0.7 % at most, with four seeds
    assert within(values[samples(run, 2.0)], 0.02)
    assert within(values[samples(run, 2.0) :], 0.05)  # 3.2 % at most, where the motion turns
    # with a weight to carry, the effort of the last second alone leaves 14 kg
    assert tracker.supported.all() or (gravity[1] and not sensors)
    assert abs(values[-1] - TRUE) < 2.0 * tracker.deviations[0]


@pytest.mark.parametrize('ways', [{'sensors': True, 'effort': False}, {'rates': False}])
def test_payload_is_found_by_gauges_alone_and_without_rates(ways: dict[str, bool]) -> None:
    run = swing(GRAVITY)
    values = follow(dn.ParameterTracker(arm(), [TOOL]), run, **ways)[:, 0]
    assert within(values[samples(run, 3.8) :], 0.06)  # 2.6 % from 4 s on


def test_a_step_of_the_payload_is_followed() -> None:
    def change(t: float, robot: dn.Robot) -> None:
        if abs(t - 3.0) < 1e-9:
            robot.set_payload('tool', 90.0)

    zero = (0.0, 0.0, 0.0)
    run = with_noise(simulated(arm(zero, KNOWN), swinging(3), 7.0, 2e-3, change))
    values = follow(dn.ParameterTracker(arm(zero), [TOOL]), run, sensors=True)[:, 0]
    assert abs(values[samples(run, 3.0)] - KNOWN) < 3.0
    assert abs(values[-1] - 90.0) < 3.0


def test_stiffness_is_found_beside_the_payload() -> None:
    soft = {'beam.link_1.y.ei': 0.9e5, 'beam.link_2.y.ei': 1.8e5}
    true = arm().with_overrides(soft)
    true.set_payload('tool', TRUE)
    run = with_noise(simulated(true, swinging(3), 4.0, 2e-3))
    tracker = dn.ParameterTracker(arm(), [TOOL, 'beam.*.y.ei'], dn.TrackerSettings(memory=2.0))
    assert tracker.paths == (TOOL, *soft)
    found = follow(tracker, run, sensors=True)[-1]
    assert np.allclose(found, [TRUE, *soft.values()], rtol=0.04)  # 1.5 % with this noise


@pytest.mark.long
def test_nothing_drifts_at_rest() -> None:
    """Two minutes of joint states at 33 Hz: noise and an offset of every channel move nothing."""
    few = simulated(arm(), resting(3), 1.0, 3e-2)
    count = 4000
    rest = TrackedRun(
        3e-2 * np.arange(count, dtype=np.float64),
        *(np.repeat(part[:1], count, axis=0) for part in (few.q, few.qd, few.effort, few.sensors)),
    )
    run = with_noise(rest)
    run.effort[:] += 50.0
    run.sensors[:] += 2e-5
    tracker = dn.ParameterTracker(arm(), [TOOL])
    values = follow(tracker, run, sensors=True)[:, 0]
    assert np.all(values == KNOWN)
    assert not tracker.moving.any()
    assert not tracker.supported.any()
    assert tracker.cause == 'nothing moves that shows the parameters'


@pytest.mark.long
def test_a_found_payload_stays_at_rest() -> None:
    swung = swinging(3)

    def motion(t: float) -> Any:
        # the motion slows down to a stop within the last half second
        if t < 2.0:
            return swung(t)
        s = min(t - 2.0, 0.5)
        q, qd, _ = swung(2.0)
        return q + qd * (s - s * s), qd * (1.0 - 2.0 * s), -2.0 * qd * (t < 2.5)

    run = with_noise(simulated(arm(mass=TRUE), motion, 20.0, 5e-3))
    tracker = dn.ParameterTracker(arm(), [TOOL])
    values = follow(tracker, run)[:, 0]
    # its vibration, which lasts for minutes, still shows it: to 2.7 % with this noise
    assert within(values[samples(run, 3.0) :], 0.06)


def test_parameters_that_do_not_show_stay() -> None:
    """Two payloads on one body in one place: only their sum shows, and a static joint nothing."""
    run = swing(GRAVITY)
    tracker = dn.ParameterTracker(
        arm(),
        [TOOL, 'payload.link_3.mass', 'joint.joint_3.friction'],
        bounds={'payload.link_3.mass': (0.0, 40.0), 'joint.joint_3.friction': (0.0, 1e-3)},
    )
    values = follow(tracker, run)
    assert np.all(values[:, 2] < 1e-6)  # of the 1e-3 that bounds allow
    assert not tracker.supported[2]


def test_a_wrong_model_stays_within_the_bounds_and_says_so() -> None:
    true = arm().with_overrides({'beam.link_1.y.ei': 0.7e5, 'beam.link_2.y.ei': 1.4e5})
    true.set_payload('tool', TRUE)
    run = with_noise(simulated(true, swinging(3), 5.0, 2e-3))
    tracker = dn.ParameterTracker(arm(), [TOOL], bounds={TOOL: (80.0, 130.0)})
    values = follow(tracker, run, sensors=True)
    assert np.all((values >= 80.0) & (values <= 130.0))
    assert tracker.model_error > 2.0 * tracker.settings.model_error


@pytest.mark.parametrize('kind', ['jumps', 'spikes', 'gaps', 'shuffled', 'silent', 'wild'])
def test_bad_measurements_never_leave_the_bounds(kind: str) -> None:
    run = swing(GRAVITY)
    draw = np.random.default_rng(3)
    tracker = dn.ParameterTracker(arm(), [TOOL])
    order = np.arange(1250)
    if kind == 'shuffled':
        order = draw.permutation(order)
    for k in order.tolist():
        q, effort, sensors = run.q[k].copy(), run.effort[k].copy(), run.sensors[k].copy()
        strange = draw.random() < 0.05
        if kind == 'jumps' and strange:
            q += 0.5
        if kind == 'spikes' and strange:
            effort *= draw.uniform(-1e6, 1e6)
            sensors *= draw.uniform(-1e6, 1e6)
        if kind == 'wild':
            effort, sensors = draw.normal(0.0, 1e4, 3), draw.normal(0.0, 1.0, len(sensors))
        if kind == 'gaps' and 400 < k < 700:
            continue
        for place, value in enumerate(sensors.tolist()):
            tracker.sense(place, run.t[k], np.nan if kind == 'silent' else value)
        tracker.measure(run.t[k], q, run.qd[k], None if kind == 'silent' else effort)
        low, high = tracker.bounds[0]
        assert low <= tracker.values[0] <= high
        assert np.isfinite(tracker.values).all()
    if kind == 'silent':
        assert tracker.values[0] == KNOWN
        assert tracker.cause == 'no effort and no values of sensors'
    if kind == 'gaps':
        assert tracker.restarts == 1


def test_the_tracked_model_is_the_one_that_is_built() -> None:
    """What is changed live gives the forces of the robot made with overrides."""
    from denoc_ros.dynamics.parameter_columns import LiveNumbers

    robot = arm()
    ei = 'beam.link_2.y.ei'
    numbers = LiveNumbers(robot, [TOOL, ei, 'joint.joint_1.damping'])
    numbers.set(robot, np.array([20.0, -1e4, 3.0]))
    built = dn.load_robot(ROBOTS / 'canadarm_gauges.urdf', gravity=GRAVITY).with_overrides(
        {ei: 1.9e5, 'joint.joint_1.damping': 3.0}
    )
    # a damping ratio is one of the stiffness it was given with: compare without damping there
    built.set_payload('tool', 120.0)
    q, qdd = np.random.default_rng(0).normal(0.0, 0.1, (2, robot.n))
    qd = np.zeros(robot.n)
    qd[robot.joint_indices] = 0.3
    for robot_now in (robot, robot.copy()):
        # rounding of torques of 1e4 N m
        assert np.allclose(
            robot_now.inverse_dynamics(q, qd, qdd), built.inverse_dynamics(q, qd, qdd), atol=1e-8
        )


def test_going_on_with_another_tracker() -> None:
    run = swing(GRAVITY)
    first = dn.ParameterTracker(arm(), [TOOL])
    follow(first, run)
    second = dn.ParameterTracker(arm(), [TOOL])
    assert second.adopt(first)
    assert np.array_equal(second.values, first.values)
    assert not dn.ParameterTracker(arm(mass=110.0), [TOOL]).adopt(first)


def refused(make: Callable[[], Any], match: str) -> None:
    with pytest.raises(dn.ConfigError, match=match):
        make()


def test_refusals() -> None:
    def tracker(*paths: str, **how: Any) -> Callable[[], Any]:
        return lambda: dn.ParameterTracker(arm(), paths, **how)

    refused(tracker(), 'must name what is tracked')
    refused(tracker('payload.nothing.mass'), 'payload.nothing.mass.* must be of one of payload')
    refused(tracker('beam.link_1.y.modes'), 'must be of one of beam.link_1.y.ei')
    refused(tracker('payload.link_1'), r'it is 0: give its bounds')
    refused(tracker(TOOL, bounds={TOOL: (150.0, 200.0)}), 'must have its value 100 within')
    refused(tracker(TOOL, bounds={TOOL: (120.0, 80.0)}), '0 <= low < high')
    refused(tracker(TOOL, bounds={'a': (0.0, 1.0)}), 'bounds must be of')
    loop = dn.load_robot(ROBOTS / 'four_bar_fff.urdf')
    refused(lambda: dn.ParameterTracker(loop, ['beam.*.ei']), 'must have no loops')
    free = dn.load_robot(ROBOTS / 'canadarm_10t.urdf')
    refused(lambda: dn.ParameterTracker(free, ['beam.*.ei']), 'must be fixed or its motion')
    with pytest.raises(dn.StateError, match='memory must be > 0'):
        dn.TrackerSettings(memory=0.0)
    with pytest.raises(dn.StateError, match='lag must be >= 0'):
        dn.TrackerSettings(lag=-1.0)


FINGERS = """<robot name="fingers"><link name="base"/>
  <link name="arm"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>
    <inertia ixx="0" ixy="0" ixz="0" iyy="0.17" iyz="0" izz="0.17"/></inertial></link>
  <link name="follower"><inertial><origin xyz="0.2 0 0"/><mass value="0.5"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
  <joint name="lead" type="revolute"><parent link="base"/><child link="arm"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="99" velocity="9"/></joint>
  <joint name="mimic" type="revolute"><parent link="arm"/><child link="follower"/>
    <origin xyz="1 0 0"/><axis xyz="0 0 1"/><limit lower="-6" upper="6" effort="9" velocity="9"/>
    <mimic joint="lead" multiplier="-2" offset="0.3"/></joint>
  <flexibility><beam link="arm" length="1"><bending direction="y" ei="400" modes="1"
    damping_ratio="0.02"/></beam></flexibility></robot>"""


def test_a_payload_on_a_mimic_joint_is_found() -> None:
    def fingers(mass: float) -> dn.Robot:
        robot = dn.load_robot(FINGERS, gravity=(0.0, -9.81, 0.0))
        robot.set_payload('follower', mass, (0.4, 0.0, 0.0))
        return robot

    swung = swinging(1, size=0.4, rate=4.0)

    def both(t: float) -> Any:
        q, qd, qdd = (part[0] for part in swung(t))
        return np.array([q, 0.3 - 2.0 * q]), np.array([qd, -2.0 * qd]), np.array([qdd, -2.0 * qdd])

    run = simulated(fingers(1.2), both, 4.0, 2e-3)
    # the motor of the leader moves both: virtual work
    effort = run.effort[:, :1] - 2.0 * run.effort[:, 1:]
    led = with_noise(TrackedRun(run.t, run.q[:, :1], run.qd[:, :1], effort, run.sensors))
    tracker = dn.ParameterTracker(fingers(1.0), ['payload.follower'])
    values = follow(tracker, led)[:, 0]
    assert np.all(np.abs(values[samples(led, 2.0) :] - 1.2) < 0.05)
    assert tracker.supported.all()


@pytest.mark.parametrize('huge', [1e40, 1e155, 1e308])
@pytest.mark.parametrize('of', ['sensors', 'effort'])
def test_numbers_that_no_robot_shows_leave_all_finite(of: str, huge: float) -> None:
    """Sensors or efforts that say such numbers now and then, whose squares are not finite."""
    run = with_noise(simulated(arm(), swinging(3), 2.0, 5e-3))
    draw = np.random.default_rng(0)
    values = getattr(run, of)
    lies = draw.random(values.shape) < 0.1
    values[lies] = huge * draw.choice([-1.0, 1.0], int(lies.sum()))
    tracker = dn.ParameterTracker(arm(), [TOOL])
    found = np.empty(len(run.t))
    for k, t in enumerate(run.t.tolist()):
        for place, value in enumerate(run.sensors[k].tolist()):
            tracker.sense(place, t, value)
        tracker.measure(t, run.q[k], run.qd[k], run.effort[k])
        found[k] = tracker.values[0]
        assert np.isfinite(tracker.deviations).all()
    assert np.all((found >= 0.5 * KNOWN) & (found <= 1.5 * KNOWN))
    assert np.isfinite(tracker.model_error)


def test_a_filter_that_is_lost_begins_anew_with_the_value_that_was_found() -> None:
    run = swing((0.0, 0.0, 0.0))
    tracker = dn.ParameterTracker(arm((0.0, 0.0, 0.0)), [TOOL])
    values = follow(tracker, run)
    found = tracker.values.copy()
    tracker._filter.covariance[:] = np.nan
    more = TrackedRun(run.t + run.t[-1] + 2e-3, run.q, run.qd, run.effort, run.sensors)
    values = follow(tracker, more)[: samples(run, 0.3)]
    assert tracker.failures == 1
    assert np.all(values == found)
    assert np.isfinite(tracker.deviations).all()
