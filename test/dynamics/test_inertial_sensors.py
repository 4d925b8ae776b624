"""IMUs and accelerometers against differences of the pose of a frame where they are clipped."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from segmented_robots import spatial_text
from strategies import random_state

import denoc_ros as dn
from denoc_ros.errors import StateError
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]

GRAVITY = np.array([0.7, -1.3, -9.6])
RPY = '0.3 -0.5 1.1'
AT = np.array([0.1, 0.2, -0.05])  # m, of the sensors' origins from section or link frame
STEP = 1e-3  # s, of differences; two steps cancel their leading error


def sensors() -> str:
    """Return a gauge between an IMU on a bent link, one on a rigid link and an accelerometer."""
    xyz = ' '.join(map(str, AT))
    where = f'xyz="{xyz}" rpy="{RPY}"'
    return (
        f'<sensor name="first" type="imu" link="upper" station="0.6" {where} gyro_noise="1e-3"/>'
        '<sensor name="gauge" type="strain_gauge" link="upper" station="0.1" direction="y"'
        ' surface="0.01"/>'
        f'<sensor name="second" type="accelerometer" link="hand" {where} accel_bias="0.1"/>'
        '<sensor name="third" type="imu" link="base"/>'
    )


def arm(segments: int = 1) -> dn.Robot:
    """Return the arm with marks: links that are fixed where the sensors are."""
    text = spatial_text(segments, sensors())
    frame = np.eye(4)
    frame[:3, :3] = Rotation.from_euler('z', 0.1).as_matrix()
    frame[:3, 3] = [0.05, 0.1, 0.02]
    # a mark must hang at the sensor's station, whatever its own place: by a link between
    at = frame @ [0.6, 0.0, 0.0, 1.0]
    where = f'xyz="{" ".join(map(str, AT.tolist()))}" rpy="{RPY}"'
    marks = (
        '<link name="between"/><link name="first_mark"/><link name="second_mark"/>'
        '<joint name="m0" type="fixed"><parent link="upper"/><child link="between"/>'
        f'<origin xyz="{" ".join(map(str, at[:3].tolist()))}" rpy="0 0 0.1"/></joint>'
        '<joint name="m1" type="fixed"><parent link="between"/><child link="first_mark"/>'
        f'<origin {where}/></joint>'
        '<joint name="m2" type="fixed"><parent link="hand"/><child link="second_mark"/>'
        f'<origin {where}/></joint>'
    )
    return dn.load_robot(text.replace('<flexibility>', f'{marks}<flexibility>'), gravity=GRAVITY)


def seen(robot: dn.Robot, frame: str, q: Array, qd: Array, qdd: Array) -> Array:
    """Return angular rate and specific force in a frame's axes, by differences of its pose."""

    def pose(t: float) -> Array:
        return robot.frame_pose(frame, q + t * qd + 0.5 * t * t * qdd)

    here, rates, accelerations = pose(0.0), [], []
    for h in (STEP, 2.0 * STEP):
        ahead, behind = pose(h), pose(-h)
        turn = Rotation.from_matrix(behind[:3, :3].T @ ahead[:3, :3]).as_rotvec()
        rates.append(turn / (2.0 * h))  # in axes half way between, which are those here
        accelerations.append((ahead[:3, 3] - 2.0 * here[:3, 3] + behind[:3, 3]) / h**2)
    rate, force = ((4.0 * a - b) / 3.0 for a, b in (rates, accelerations))
    return np.concatenate([rate, here[:3, :3].T @ (force - GRAVITY)])


@pytest.mark.parametrize('segments', [1, 3])
def test_values_are_those_of_a_frame_that_moves(close: Close, segments: int) -> None:
    robot = arm(segments)
    assert robot.sensor_names == (
        'first/gyro_x', 'first/gyro_y', 'first/gyro_z',
        'first/accel_x', 'first/accel_y', 'first/accel_z',
        'gauge', 'second/accel_x', 'second/accel_y', 'second/accel_z',
        'third/gyro_x', 'third/gyro_y', 'third/gyro_z',
        'third/accel_x', 'third/accel_y', 'third/accel_z',
    )  # fmt: skip
    s = random_state(robot.coordinate_names, 1)
    values = robot.sensor_values(s.q, s.qd, s.qdd)
    # of fourth-order differences of motions of up to a thousand m/s^2
    first = seen(robot, 'first_mark', s.q, s.qd, s.qdd)
    close(values[:3], first[:3], 1e-5)
    close(values[3:6], first[3:], 1e-5)
    close(values[7:10], seen(robot, 'second_mark', s.q, s.qd, s.qdd)[3:], 1e-5)
    np.testing.assert_allclose(values[10:], [0, 0, 0, *-GRAVITY], atol=1e-12)
    assert values[6] == robot.beam_sensor_values(s.q, s.qd, s.qdd)[0]


def test_a_still_robot_feels_gravity_alone(close: Close) -> None:
    robot = arm()
    q = random_state(robot.coordinate_names, 2).q
    values = robot.sensor_values(q)
    turn = robot.frame_pose('first_mark', q)[:3, :3]
    close(values[:6], np.concatenate([np.zeros(3), turn.T @ -GRAVITY]), 1e-12)


def test_rows_are_those_of_single_states(close: Close) -> None:
    robot = arm(3)
    q, qd, qdd = np.random.default_rng(3).uniform(-0.2, 0.2, (3, 5, robot.n))
    values = robot.sensor_values(q, qd, qdd)
    derivatives = robot.sensor_derivatives(q, qd, qdd)
    for k in (0, 4):
        close(values[k], robot.sensor_values(q[k], qd[k], qdd[k]), 1e-12)
        for many, one in zip(
            derivatives, robot.sensor_derivatives(q[k], qd[k], qdd[k]), strict=True
        ):
            close(many[k], one, 1e-12)


@pytest.mark.parametrize('segments', [1, 3])
def test_derivatives_are_those_of_differences(close: Close, segments: int) -> None:
    robot = arm(segments)
    s = random_state(robot.coordinate_names, 4)
    states, step = [s.q, s.qd, s.qdd], 1e-6
    for k, found in enumerate(robot.sensor_derivatives(states[0], states[1], states[2])):
        columns = []
        for shift in step * np.eye(robot.n):
            values = []
            for sign in (1.0, -1.0):
                q, qd, qdd = (x + sign * shift * (j == k) for j, x in enumerate(states))
                values.append(robot.sensor_values(q, qd, qdd))
            columns.append((values[0] - values[1]) / (2.0 * step))
        close(found, np.array(columns).T, 1e-7)  # of central differences


def test_a_base_that_moves_is_felt(close: Close) -> None:
    robot = arm()
    s = random_state(robot.coordinate_names, 5)
    rng = np.random.default_rng(5)
    twist, acceleration = rng.uniform(-1, 1, (2, 6))
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.4, -0.3, 0.9]).as_matrix()
    values = robot.sensor_values(s.q, s.qd, s.qdd, base=(twist, acceleration, pose))
    gravity = pose[:3, :3].T @ GRAVITY
    close(values[10:], np.concatenate([twist[3:], acceleration[:3] - gravity]), 1e-12)
    turn = robot.frame_pose('first_mark', s.q)[:3, :3]
    motion = robot.frame_motion('first_mark', s.q, s.qd, s.qdd, base=(twist, acceleration, pose))
    expected = [turn.T @ motion[0, 3:], turn.T @ (motion[1, :3] - gravity)]
    close(values[:6], np.concatenate(expected), 1e-12)
    # and it is as it was before
    close(robot.sensor_values(s.q)[10:], np.array([0, 0, 0, *-GRAVITY]), 1e-12)


def test_a_sensor_s_frame_carries_no_payload() -> None:
    robot = arm()
    assert 'sensor:first' not in robot.frame_names
    with pytest.raises(StateError, match="frame 'sensor:first' must be a link that moves"):
        robot.set_payload('sensor:first', 1.0)
    with pytest.raises(StateError, match=r'frame must be one of base, upper.*, got .sensor:none'):
        robot.frame_pose('sensor:none', np.zeros(robot.n))


def test_outputs_of_a_linear_model_have_their_names() -> None:
    robot = arm()
    model = robot.linearize(np.zeros(robot.n), outputs=('sensors', 'third/accel_x'))
    assert model.output_names == (*robot.sensor_names, 'third/accel_x')
