"""What topics said last, as moments: by name, the first that is fresh, and no garbage."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geared_arm import arm_text
from hypothesis import given, settings
from hypothesis import strategies as st
from node_robots import GRAVITY, gripper, two_links
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.runtime.inputs.input_monitor import InputError
from denoc_ros.viewer.live_snapshots import FARTHEST, LiveSnapshots, LiveState

pytestmark = pytest.mark.ros
STATES = ('predictor/modal_state', 'plant/true_modal_state', 'joint_states')
EFFORT, RESIDUAL = 'feedforward/effort', 'predictor/sensor_residual'
FIVE_BAR = Path(__file__).resolve().parents[2] / 'config' / 'robots' / 'five_bar_ffff.urdf'


def raw(names: Any, position: Any = (), velocity: Any = (), effort: Any = ()) -> bytes:
    columns = {'position': position, 'velocity': velocity, 'effort': effort}
    message = JointState(name=list(names), **{key: list(v) for key, v in columns.items()})
    return bytes(serialize_message(message))


def admit(stamp_ns: int) -> None:
    """Take any stamp."""


@pytest.fixture(scope='module')
def robot() -> Robot:
    return load_robot(two_links(), gravity=(GRAVITY[0], GRAVITY[1], GRAVITY[2]))


@pytest.fixture
def moments(robot: Robot) -> LiveSnapshots:
    return LiveSnapshots(robot, np.zeros(robot.n), STATES, EFFORT, RESIDUAL, timeout=0.5)


def modal(robot: Robot, seed: int) -> tuple[np.ndarray[Any, Any], bytes]:
    """Return coordinates and the message that says them in another order."""
    rng = np.random.default_rng(seed)
    q, order = rng.uniform(-0.1, 0.1, robot.n), rng.permutation(robot.n)
    names = [robot.coordinate_names[k] for k in order]
    return q, raw(names, q[order], q[order])


def test_coordinates_are_matched_by_name(robot: Robot, moments: LiveSnapshots) -> None:
    q, message = modal(robot, 1)
    moments.take(STATES[0], message, admit)
    moment = moments.newest(time.perf_counter())
    assert moment is not None
    np.testing.assert_array_equal(moment.q, q)


def test_the_first_fresh_topic_is_drawn_and_none_when_all_are_silent(
    robot: Robot, moments: LiveSnapshots
) -> None:
    now = time.perf_counter()
    assert moments.newest(now) is None
    moments.take(STATES[2], raw(robot.joint_names, [0.5, 0.6]), admit)
    assert moments.newest(now) is not None
    assert moments.source == STATES[2]
    moments.take(STATES[1], modal(robot, 2)[1], admit)
    moments.newest(now)
    assert moments.source == STATES[1]
    moments.take(STATES[0], modal(robot, 3)[1], admit)
    moments.newest(now)
    assert moments.source == STATES[0]
    assert moments.newest(time.perf_counter() + 0.6) is None
    assert moments.source == ''


def test_charts_have_the_deflection_of_every_topic_that_has_amplitudes(
    robot: Robot, moments: LiveSnapshots
) -> None:
    q, message = modal(robot, 4)
    other, true = modal(robot, 5)
    for topic, said in zip(STATES, (message, true, raw(robot.joint_names, [0, 0])), strict=True):
        moments.take(topic, said, admit)
    moment = moments.newest(time.perf_counter())
    assert moment is not None
    assert set(moment.channels) == {
        f'deflection [m]/{word} {link} uy'
        for word in ('predicted', 'true')
        for link in ('one', 'two')
    }
    for word, coordinates in (('predicted', q), ('true', other)):
        for link in ('one', 'two'):
            # the same sums in another order
            assert moment.channels[f'deflection [m]/{word} {link} uy'] == pytest.approx(
                robot.tip_deflection(link, coordinates)[1], rel=1e-12
            )


def test_commanded_torque_is_drawn_rather_than_measured(
    robot: Robot, moments: LiveSnapshots
) -> None:
    moments.take(STATES[2], raw(robot.joint_names, [0.1, 0.2], effort=[3.0, 4.0]), admit)
    moment = moments.newest(time.perf_counter())
    assert moment is not None
    assert moment.torque == {'j1': 3.0, 'j2': 4.0}
    moments.take(EFFORT, raw(['j2', 'j1', 'other'], [0, 0, 0], effort=[7, 8, 9]), admit)
    moments.take(RESIDUAL, raw(['gauge'], [1e-5]), admit)
    moment = moments.newest(time.perf_counter())
    assert moment is not None
    assert moment.torque == {'j1': 8.0, 'j2': 7.0}
    assert moment.channels['torque [N m]/j2'] == 7.0
    assert moment.channels['residual/gauge'] == 1e-5


def test_measured_torque_is_drawn_where_none_is_commanded(
    robot: Robot, moments: LiveSnapshots
) -> None:
    moments.take(STATES[0], modal(robot, 6)[1], admit)
    moments.take(STATES[2], raw(robot.joint_names, [0.1, 0.2], effort=[3.0, 4.0]), admit)
    moment = moments.newest(time.perf_counter())
    assert moments.source == STATES[0]
    assert moment is not None
    assert moment.torque == {'j1': 3.0, 'j2': 4.0}


def test_joints_alone_are_not_listened_to_where_they_say_nothing_new(
    robot: Robot, moments: LiveSnapshots
) -> None:
    now = time.perf_counter()
    joints = raw(robot.joint_names, [0.1, 0.2], effort=[3.0, 4.0])
    moments.take(STATES[0], modal(robot, 7)[1], admit)
    moments.take(STATES[2], joints, admit)
    assert moments.wanted(now) == list(moments.topics)  # their effort
    moments.take(EFFORT, raw(['j1', 'j2'], [0, 0], effort=[7, 8]), admit)
    assert moments.wanted(now) == [each for each in moments.topics if each != STATES[2]]
    # silence brings them back
    assert moments.wanted(time.perf_counter() + 0.6) == list(moments.topics)


def test_a_mimic_joint_follows_its_leader() -> None:
    robot = load_robot(gripper())
    state = LiveState(robot, np.zeros(robot.n))
    state.read(raw(['left', 'j1', 'j2', 'stranger'], [0.3, 0.1, 0.2, 9.0]), admit)
    assert not state.bent
    found = dict(zip(robot.coordinate_names, state.q, strict=True))
    # the file: right = -left + 0.1
    assert found['right'] == pytest.approx(-0.2, abs=1e-15)
    assert (found['j1'], found['j2'], found['left']) == (0.1, 0.2, 0.3)


def test_the_loop_gives_the_joints_that_are_not_measured() -> None:
    robot = load_robot(FIVE_BAR, gravity=(0.0, -9.81, 0.0))
    posture = np.zeros(robot.n)
    posture[robot.joint_indices] = np.radians([108.0, -72.0, 72.0, 72.0])
    state = LiveState(robot, posture)
    drawn = []
    for angle in (108.0, 112.0, 118.0):
        driven = np.radians([angle, 72.0])
        state.read(raw(['joint_1', 'joint_3'], driven, [0.0, 0.0]), admit)
        drawn.append(state.q[list(robot.coordinate_names).index('joint_2')])
        # Newton's last step squares what is left (1e-8)
        assert np.abs(robot.closure(state.q)).max() < 1e-8
    assert np.ptp(drawn) > 0.01
    before = state.q.copy()
    with pytest.raises(InputError, match='loops close'):
        state.read(raw(['joint_1', 'joint_3'], [6.0, -4.0]), admit)
    np.testing.assert_array_equal(state.q, before)


@pytest.mark.parametrize(
    ('cause', 'message'),
    [
        ('non_finite', raw(['j1', 'j2'], [math.nan, 0.0])),
        ('out_of_reach', raw(['j1', 'j2'], [2.0 * FARTHEST, 0.0])),
        ('wrong_length', raw(['j1', 'j2'], [0.0])),
        ('unknown_joint', raw(['x', 'y'], [0.0, 0.0])),
        ('repeated_joint', raw(['j1', 'j1'], [0.0, 0.0])),
        ('malformed', b'\x00\x01\x00\x00'),
    ],
    ids=lambda value: value if isinstance(value, str) else '',
)
def test_a_bad_message_is_refused_and_the_last_good_one_stays(
    robot: Robot, cause: str, message: bytes
) -> None:
    state = LiveState(robot, np.zeros(robot.n))
    state.read(raw(['j1', 'j2'], [0.1, 0.2]), admit)
    with pytest.raises(InputError) as refused:
        state.read(message, admit)
    assert refused.value.cause == cause
    assert state.q[robot.joint_indices].tolist() == [0.1, 0.2]
    state.read(raw(['j1', 'j2'], [0.3, 0.4]), admit)
    assert state.q[robot.joint_indices].tolist() == [0.3, 0.4]


def test_a_first_message_without_names_is_refused(robot: Robot) -> None:
    state = LiveState(robot, np.zeros(robot.n))
    with pytest.raises(InputError) as refused:
        state.read(raw([], []), admit)
    assert refused.value.cause == 'unknown_joint'


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_no_bytes_are_more_than_refused(robot: Robot, data: st.DataObject) -> None:
    good = raw(robot.coordinate_names, np.zeros(robot.n), np.zeros(robot.n))
    spoiled = bytearray(good[: data.draw(st.integers(0, len(good)))])
    for _ in range(data.draw(st.integers(0, 4))):
        if spoiled:
            spoiled[data.draw(st.integers(0, len(spoiled) - 1))] = data.draw(st.integers(0, 255))
    moments = LiveSnapshots(robot, np.zeros(robot.n), STATES, EFFORT, RESIDUAL)
    for topic in moments.topics:
        try:
            moments.take(topic, bytes(spoiled), admit)
        except InputError:
            continue
    moment = moments.newest(time.perf_counter())
    assert moment is None or np.isfinite(moment.q).all()


def test_a_state_without_springs_behind_measured_links_is_drawn() -> None:
    robot = load_robot(arm_text('link'))
    state = LiveState(robot, np.zeros(robot.n))
    # as the predictor says it, whose robot has no springs
    state.read(raw(['shoulder', 'elbow'], [0.3, -0.2], [1.0, 2.0]), admit)
    assert state.bent
    np.testing.assert_array_equal(state.q[robot.joint_indices], [0.3, -0.2])
    np.testing.assert_array_equal(state.qd[robot.joint_indices], [1.0, 2.0])
    assert not state.q[robot.flexible_indices].any()
