"""Mounting and biases of an IMU or accelerometer: found again from readings that have them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ConfigError, IdentificationError
from denoc_ros.identification.calibration import calibrate_mounting
from denoc_ros.model.overrides import remounted_description
from denoc_ros.types import Array

SAID = '0.3 -0.2 0.5'
TURN = Rotation.from_rotvec([0.02, -0.05, 0.03])
TRUE = (Rotation.from_euler('xyz', [0.3, -0.2, 0.5]) * TURN).as_euler('xyz')
GYRO_BIAS, ACCEL_BIAS = np.array([0.02, -0.01, 0.03]), np.array([0.2, 0.1, -0.3])


def text(rpy: str, kind: str = 'imu', joints: str = 'zy') -> str:
    """A rigid arm whose joints turn about the named axes, a sensor on its last link."""
    links, parent = '<link name="base"/>', 'base'
    for k, axis in enumerate(joints):
        xyz = ' '.join('1' if each == axis else '0' for each in 'xyz')
        links += (
            f'<link name="l{k}"><inertial><mass value="1"/><inertia ixx="0.1" ixy="0" ixz="0" '
            f'iyy="0.1" iyz="0" izz="0.1"/></inertial></link><joint name="j{k}" '
            f'type="continuous"><parent link="{parent}"/><child link="l{k}"/>'
            f'<origin xyz="0.4 0 0"/><axis xyz="{xyz}"/></joint>'
        )
        parent = f'l{k}'
    sensor = f'<sensor name="box" type="{kind}" link="{parent}" xyz="0.2 0 0" rpy="{rpy}"/>'
    return f'<robot name="arm">{links}<flexibility>{sensor}</flexibility></robot>'


def motion(robot: Robot) -> tuple[Array, Array, Array]:
    """Two seconds of stillness, then sines of all joints."""
    t = np.linspace(0.0, 10.0, 800)
    t = np.maximum(t - 2.0, 0.0)[:, None]
    rate = np.array([1.1, 1.7, 2.3])[: robot.n]
    q = 0.8 * (1.0 - np.cos(rate * t))
    return q, 0.8 * rate * np.sin(rate * t), 0.8 * rate**2 * np.cos(rate * t) * (t > 0.0)


@pytest.mark.parametrize('kind', ['imu', 'accelerometer'])
def test_rotation_and_biases_are_found_within_their_errors(kind: str) -> None:
    robot = load_robot(text(SAID, kind))
    true = load_robot(text(' '.join(map(str, TRUE)), kind))
    q, qd, qdd = motion(robot)
    bias = np.concatenate([GYRO_BIAS, ACCEL_BIAS])[-len(robot.sensor_names) :]
    noise = np.array([0.005] * 3 + [0.05] * 3)[-len(bias) :]
    clean = true.sensor_values(q, qd, qdd) + bias
    readings = clean + noise * np.random.default_rng(2).normal(size=clean.shape)
    found = calibrate_mounting(robot, 'box', q, qd, qdd, readings)
    off = Rotation.from_matrix(found.rotation).inv() * TURN
    # six deviations: one in half a billion is farther off by chance
    assert np.linalg.norm(off.as_rotvec()) < 6.0 * found.angle_error
    assert found.angle_error < 0.002
    assert found.angle == pytest.approx(TURN.magnitude(), abs=6.0 * found.angle_error)
    assert (np.abs(found.accel_bias - ACCEL_BIAS) < 6.0 * found.accel_bias_error).all()
    assert found.accel_residual == pytest.approx(0.05, rel=0.1)
    if kind == 'imu':
        assert (np.abs(found.gyro_bias - GYRO_BIAS) < 6.0 * found.gyro_bias_error).all()
        assert found.gyro_residual == pytest.approx(0.005, rel=0.1)
    assert found.doubts == ()


def test_the_remounted_robot_reads_what_was_read() -> None:
    robot = load_robot(text(SAID))
    true = load_robot(text(' '.join(map(str, TRUE))))
    q, qd, qdd = motion(robot)
    readings = true.sensor_values(q, qd, qdd)
    found = calibrate_mounting(robot, 'box', q, qd, qdd, readings)
    mended = load_robot(remounted_description(text(SAID), 'box', found.rotation))
    np.testing.assert_allclose(mended.sensor_values(q, qd, qdd), readings, atol=1e-9)
    with pytest.raises(ConfigError, match="sensor 'none' must be an IMU or accelerometer"):
        remounted_description(text(SAID), 'none', found.rotation)


def test_a_large_turn_is_doubted() -> None:
    robot = load_robot(text('0 0 0'))
    q, qd, qdd = motion(robot)
    readings = load_robot(text('0 0 1.5')).sensor_values(q, qd, qdd)
    found = calibrate_mounting(robot, 'box', q, qd, qdd, readings)
    assert found.angle == pytest.approx(1.5)
    assert 'the rotation must be a small one, got 85.9 deg' in found.doubts


def test_refuses_what_does_not_determine_it() -> None:
    robot = load_robot(text(SAID))
    q, qd, qdd = motion(robot)
    readings = robot.sensor_values(q, qd, qdd)
    still = np.zeros_like(q)
    with pytest.raises(IdentificationError, match='must turn the sensor about two axes at least'):
        calibrate_mounting(robot, 'box', still, still, still, np.tile(readings[0], (len(q), 1)))
    # about the vertical alone: gravity stays where it is
    alone = load_robot(text(SAID, joints='z'), gravity=(0, 0, -9.81))
    slow = 1e-4 * np.linspace(0.0, 1.0, 50)[:, None]
    given = np.ones_like(slow), slow, np.zeros_like(slow)
    with pytest.raises(IdentificationError, match='must turn the sensor about two axes at least'):
        calibrate_mounting(alone, 'box', *given, alone.sensor_values(*given))
    with pytest.raises(IdentificationError, match=r'sensor must be .*\(box\), got .none.'):
        calibrate_mounting(robot, 'none', q, qd, qdd, readings)
    with pytest.raises(IdentificationError, match=r'readings must have shape \(800, 6\)'):
        calibrate_mounting(robot, 'box', q, qd, qdd, readings[:, :3])
