"""State feedback of the Canadarm with IMUs at its links' ends, alone or beside gauges."""

from __future__ import annotations

import re

import numpy as np
import pytest
from feedback_runs import PERIOD, START, Loop, canadarm, closed, tip_exact
from imu_arms import FILE, GYRO, imu_text

from denoc_ros.errors import StateError
from denoc_ros.feedback.feedback_settings import FeedbackSettings
from denoc_ros.feedback.gain_schedule import GainSchedule, design
from denoc_ros.feedback.planned_states import state_at
from denoc_ros.feedback.read_values import chosen_values, read_sensors
from denoc_ros.feedback.state_feedback import FADE

LIMITS = np.full(3, 5000.0)
# angular rates show a deflection by what it was before: a slower loop, a model that counts more
SLOW = {'tip_error': 0.02, 'model_error': 0.2}


def loop_of(gauges: str, duration: float = 10.0, share: float = 1.0, **settings: float) -> Loop:
    """Return the loop of the arm with IMUs and some gauges on a wrong model."""
    text = imu_text(gauges)
    return closed(tip_exact(duration, share, text), canadarm(0.9, 1.2, text), **settings)


@pytest.mark.parametrize(
    ('gauges', 'settings', 'moving', 'after'),
    [
        # 9.1 mm, 0.7 mm; the plan alone misses by metres
        pytest.param('', SLOW, 0.025, 0.003, marks=pytest.mark.long),
        # 6.7 mm, 0.5 mm; the gauges at the roots alone are refused
        pytest.param('root', SLOW, 0.015, 0.003, marks=pytest.mark.long),
        # 1.4 mm, 0.4 mm; without IMUs 2.1 and 0.5 mm
        ('_', {}, 0.0025, 0.001),
    ],
)
def test_gyroscopes_keep_the_tip_of_a_wrong_model_with_its_plan(
    gauges: str, settings: dict[str, float], moving: float, after: float
) -> None:
    run = loop_of(gauges, **settings).run()
    assert (run.share[1000:] == 1.0).all()
    assert run.rms < moving
    assert run.after(3.0) < after


@pytest.mark.long
def test_lost_values_cost_little() -> None:
    loop = loop_of('', **SLOW)
    loop.lost = 0.3
    run = loop.run()
    assert (run.share[1000:] == 1.0).all()
    # 9.3 mm, 0.7 mm. The first value of an IMU comes later than that of the joints here: when no
    # bias was taken from it, 97 mm
    assert run.rms < 0.025
    assert run.after(3.0) < 0.003


def test_gauges_at_the_roots_alone_are_refused() -> None:
    text = re.sub(r'<sensor [^>]*type="imu"[^>]*/>', '', imu_text('root'))
    with pytest.raises(StateError, match=r'must be stable for .*, got modulus 1\.00'):
        tip_exact(source=text).schedule()


def test_biases_are_found() -> None:
    loop = loop_of('_', 4.0, 0.3)
    loop.run(4.0)
    assert loop.feedback is not None
    deviations = [value.bias for value in loop.values if '/gyro_' in value.name]
    biases = [bias for value, bias in zip(loop.values, loop.biases, strict=True)
              if '/gyro_' in value.name]  # fmt: skip
    found = loop.feedback.filter.state[-6:]
    # 0.02 deviations of a bias
    assert np.abs((found - biases) / deviations).max() < 0.1
    assert np.abs(np.array(biases) / deviations).max() > 1.0


@pytest.mark.long
def test_dying_imu_leaves_the_plan_alone_and_comes_back() -> None:
    loop = loop_of('', 4.0, 0.1, **SLOW)
    begin, end = 2.0, 2.4
    loop.silent = (begin, end)
    run = loop.run(4.0)
    planned, feedback = loop.planned, loop.feedback
    assert feedback is not None
    fell = round((begin + feedback.schedule.settings.sensor_timeout) / PERIOD)
    assert run.share[fell - 2] == 1.0
    quiet = slice(fell + 1, round(end / PERIOD))
    assert not run.share[quiet].any()
    gone = slice(quiet.start + round(FADE / PERIOD), quiet.stop)  # the last torque fades
    np.testing.assert_array_equal(run.torque[gone], planned.torque[gone])
    assert run.share[-1] == 1.0


def test_dead_imu_is_named() -> None:
    loop = loop_of('', 4.0, 0.1, **SLOW)
    loop.silent = (1.0, np.inf)
    loop.run(1.2)
    assert loop.feedback is not None
    assert loop.feedback.filter.cause == 'no good values of link_1_imu/gyro_x'


@pytest.mark.long
def test_pauses_do_not_lose_the_robot() -> None:
    loop = loop_of('_', 4.0, 0.3)
    loop.stall = 0.004
    run = loop.run()
    assert (run.share[1000:] == 1.0).all()
    # 16 mm; with the gate of gauges for angular rates a robot was lost after the stop
    assert run.error.max() < 0.1
    assert run.after(3.0) < 0.005


@pytest.mark.long
def test_a_pause_with_imus_alone_does_not_lose_the_robot() -> None:
    loop = loop_of('', 4.0, 0.1, **SLOW)
    loop.away = {1.5: 0.02, 2.5: 0.1}
    loop.backlog = 5
    run = loop.run()
    assert (run.share[1000:] == 1.0).all()
    # 35 mm, 3 mm; with the gains of every period alone after the first pause a robot was lost
    assert run.error.max() < 0.1
    assert run.after(3.0) < 0.01


def test_bias_that_nothing_tells_from_a_deviation_fades() -> None:
    gains = posture(imu_text('')).gains[0]
    fading = np.diag(gains.transition)[-6:]
    assert (fading < 1.0).all()
    # the biases are among the states of the loop that was shown stable
    assert posture(imu_text('')).slowest.modulus < 1.0


def posture(text: str) -> GainSchedule:
    """Return the gains about a posture."""
    robot = canadarm(source=text)
    settings = FeedbackSettings(period=PERIOD, tip='tool', delay=1.5 * PERIOD)
    state = state_at(robot, robot.joint_names, START, 0.1 * LIMITS)
    return design(robot, robot.joint_names, LIMITS, np.zeros(1), [state], settings)


def test_gauges_have_their_own_rows_wherever_the_imus_stand_in_the_file() -> None:
    gauges = FILE.read_text(encoding='utf-8')
    imu = f'<sensor name="first" type="imu" link="link_1" station="6" {GYRO}/>'
    before = gauges.replace('<sensor ', f'{imu}<sensor ', 1)
    assert before.index('type="imu"') < before.index('strain_gauge')
    # an IMU without a topic is not read
    alone, beside = posture(gauges), posture(before)
    np.testing.assert_allclose(beside.gains[0].measured, alone.gains[0].measured, atol=1e-12)
    np.testing.assert_array_equal(beside.sensors, alone.sensors)


def test_angular_rates_are_read_and_specific_forces_are_not() -> None:
    tree = canadarm(source=imu_text('root')).tree
    names = [value.name for value in chosen_values(tree, read_sensors(tree))]
    rates = [f'{link}_imu/gyro_{axis}' for link in ('link_1', 'link_2') for axis in 'xyz']
    assert names == ['link_1_y_root', 'link_2_y_root', *rates]
    forces = canadarm(source=imu_text('', 'accel_noise="2e-3"'))
    with pytest.raises(StateError, match=r'gauges, .* or gyroscopes with a topic and noise'):
        posture(forces.tree.source)
