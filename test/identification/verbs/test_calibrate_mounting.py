"""`denoc calibrate` of an IMU: a bag in, its mounting and biases out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from node_robots import two_links
from scipy.spatial.transform import Rotation

from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.main import main
from denoc_ros.dynamics.driven.measured_side import measured_equilibrium
from denoc_ros.dynamics.robot import load_robot

GRAVITY = (0.0, -9.81, 0.0)
IMU = '<sensor name="box" type="imu" link="two" station="0.5" rpy="{rpy}" topic="{topic}"/>'
TURN = Rotation.from_rotvec([0.02, -0.05, 0.03])
BIAS = np.array([0.02, -0.01, 0.03, 0.2, 0.1, -0.3])


def arm(rpy: str = '0 0 0', topic: str = 'imu') -> str:
    sensor = IMU.format(rpy=rpy, topic=topic)
    return two_links().replace('</flexibility>', f'{sensor}</flexibility>')


def bag(folder: Path, moves: bool = True, more: str = '') -> Path:
    """Still for a second, then slow sines of both joints; the links bend as in equilibrium."""
    text = arm(' '.join(map(str, TURN.as_euler('xyz')))).replace('</flex', f'{more}</flex')
    true = load_robot(text, gravity=GRAVITY)
    first = true.sensor_names.index('box/gyro_x')
    rate = np.array([1.1, 1.7])
    with BagWriter(folder / 'bag') as writer:
        writer.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
        writer.add_topic('/imu', 'sensor_msgs/msg/Imu')
        for k in range(1000):
            t = max(0.01 * k - 1.0, 0.0) * moves
            position = 0.8 * (1.0 - np.cos(rate * t))
            velocity = 0.8 * rate * np.sin(rate * t)
            q, qd, qdd = measured_equilibrium(true, position), np.zeros(true.n), np.zeros(true.n)
            qd[true.joint_indices] = velocity
            qdd[true.joint_indices] = 0.8 * rate**2 * np.cos(rate * t) * (t > 0.0)
            values = true.sensor_values(q, qd, qdd)[first : first + 6] + BIAS
            stamp = 10**9 + k * 10**7
            writer.write_message(
                '/joint_states', stamp, name=['j2', 'j1'], position=position[::-1],
                velocity=velocity[::-1],
            )  # fmt: skip
            rates, forces = (dict(zip('xyz', part, strict=True)) for part in np.split(values, 2))
            writer.write_message('/imu', stamp, angular_velocity=rates, linear_acceleration=forces)
    return folder / 'bag'


def arguments(recorded: Path, robot: Path) -> list[str]:
    return [
        'calibrate', str(recorded), '--robot', str(robot), '--sensor', 'box',
        '--gravity', *map(str, GRAVITY),
    ]  # fmt: skip


def test_mounting_and_biases_of_an_imu_are_found_and_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot, new = tmp_path / 'arm.urdf', tmp_path / 'new.urdf'
    robot.write_text(arm())
    recorded = bag(tmp_path)
    assert main([*arguments(recorded, robot), '--json', '-o', str(new)]) == 0
    found = json.loads(capsys.readouterr().out)
    # smoothing turns the moment in which motion begins a little
    off = Rotation.from_matrix(found['rotation']).inv() * TURN
    assert off.magnitude() < 0.005
    np.testing.assert_allclose(found['gyro_bias'], BIAS[:3], atol=0.005)
    np.testing.assert_allclose(found['accel_bias'], BIAS[3:], atol=0.05)
    mended = load_robot(new, gravity=GRAVITY)
    assert mended.tree.inertial_sensors[0].name == 'box'
    assert main(arguments(recorded, new)) == 0
    text = capsys.readouterr().out
    assert text.startswith('box: turned by 0.000 +- ')
    assert 'gyro_bias' in text
    assert 'rad/s, residual' in text


@pytest.mark.long
def test_an_imu_is_calibrated_by_joints_that_are_measured_behind_springs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The gear of joint 2 winds up; where its link stands is what was measured."""
    spring = '<spring joint="j2" stiffness="60" measured="{}"/><actuator joint="j2" armature="1"/>'
    recorded = bag(tmp_path, more=spring.format('link'))
    off = {}
    for side in ('link', 'motor'):
        robot = tmp_path / f'{side}.urdf'
        robot.write_text(arm().replace('</flex', f'{spring.format(side)}</flex'))
        main([*arguments(recorded, robot), '--json'])
        found = json.loads(capsys.readouterr().out)
        off[side] = (Rotation.from_matrix(found['rotation']).inv() * TURN).magnitude()
    assert off['link'] < 0.005  # rad
    assert off['motor'] > 2.0 * off['link'], off  # read as of the motors


@pytest.mark.long
def test_what_is_missing_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot, silent = tmp_path / 'arm.urdf', tmp_path / 'silent.urdf'
    robot.write_text(arm())
    silent.write_text(arm().replace(' topic="imu"', ''))
    recorded = bag(tmp_path, moves=False)
    assert main(arguments(recorded, robot)) == 3
    assert 'must turn the sensor about two axes at least' in capsys.readouterr().err
    assert main(arguments(recorded, silent)) == 1
    assert "sensor 'box' must have a topic, got none" in capsys.readouterr().err
    robot.write_text(arm(topic='joint_states'))
    assert main(arguments(recorded, robot)) == 1
    assert 'topic /joint_states must be sensor_msgs/msg/Imu, got' in capsys.readouterr().err
