"""What sensors tell of modes and biases: against sensors' values themselves, and closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.estimation.observability import VALUES, observability
from denoc_ros.types import Array

LENGTH = 2.0
IMU = (
    '<sensor name="imu" type="imu" link="link" station="2" rpy="0.3 0.2 0.5" '
    'gyro_noise="0.01" accel_noise="0.1" gyro_bias="0.1" accel_bias="{accel_bias}"/>'
)
GAUGE = (
    '<sensor name="gauge" type="strain_gauge" link="link" station="0.1" direction="y" '
    'surface="0.01" noise="1e-6"/>'
)
ROOT = '<sensor name="root" type="deflection" link="link" station="0" direction="y" noise="1e-6"/>'


def arm(sensors: str, modes: int = 1) -> Robot:
    """A link in the horizontal plane's x direction that bends up and down."""
    return load_robot(
        '<robot name="arm"><link name="base"/><link name="link"><inertial>'
        '<origin xyz="1 0 0"/><mass value="4"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="1.4" '
        'iyz="0" izz="1.4"/></inertial></link><joint name="hub" type="continuous">'
        '<parent link="base"/><child link="link"/><axis xyz="0 0 1"/></joint><flexibility>'
        f'<beam link="link" length="{LENGTH}"><bending direction="y" ei="200" modes="{modes}"/>'
        f'</beam>{sensors}</flexibility></robot>',
        gravity=(0.0, -9.81, 0.0),
    )


def shown(robot: Robot, q: Array, qd: Array, qdd: Array) -> Array:
    """How the values differ from those of the straight link at rest, per amplitude."""
    zero = np.zeros(robot.n)
    return (robot.sensor_values(q, qd, qdd) - robot.sensor_values(zero, zero, zero)) / 1e-6


def test_a_mode_is_told_by_how_it_shows_in_a_vibration() -> None:
    robot = arm(IMU.format(accel_bias=0.5) + GAUGE)
    mode = observability(robot, np.zeros(2))[0]
    omega = 2.0 * np.pi * robot.natural_frequencies(np.zeros(2))[0]
    s, zero = np.array([0.0, 1e-6]), np.zeros(2)  # small, for values need not be linear
    cosine = shown(robot, s, zero, -(omega**2) * s)
    sine = shown(robot, zero, omega * s, zero)
    noise = np.array([0.01] * 3 + [0.1] * 3 + [1e-6])
    deviation = 0.01 * LENGTH  # of the only amplitude: a hundredth of the length
    signal = deviation * np.sqrt(np.sum((cosine**2 + sine**2) / noise**2))
    assert mode.name == 'mode 1'
    assert mode.frequency == pytest.approx(omega / (2.0 * np.pi))
    # differences of 1e-6 m leave 1e-5 of the values
    assert mode.left == pytest.approx(1.0 / np.sqrt(1.0 + VALUES * signal**2), rel=1e-3)
    assert mode.observable


@pytest.mark.parametrize('accel_bias', [0.02, 0.5])
@pytest.mark.parametrize('gauge', [False, True])
def test_a_bias_is_told_from_a_deflection_that_stands_still(
    accel_bias: float, gauge: bool
) -> None:
    robot = arm(IMU.format(accel_bias=accel_bias) + (GAUGE if gauge else ''))
    found = {state.name: state for state in observability(robot, np.zeros(2))}
    noise = np.array([0.01] * 3 + [0.1] * 3 + [1e-6] * gauge)
    biases = np.array([0.1] * 3 + [accel_bias] * 3)
    by_d = shown(robot, np.array([0.0, 1e-6]), np.zeros(2), np.zeros(2))
    C = np.column_stack([by_d, np.eye(len(noise))[:, :6]])
    prior = np.diag(np.array([0.01 * LENGTH, *biases]) ** 2)
    # the conditional covariance of a Gaussian, by the other of its two formulas
    gain = prior @ C.T @ np.linalg.inv(C @ prior @ C.T + np.diag(noise**2) / VALUES)
    left = np.sqrt(np.diag(prior - gain @ C @ prior))[1:] / biases
    names = [f'imu/{part}_{axis}' for part in ('gyro', 'accel') for axis in 'xyz']
    np.testing.assert_allclose([found[name].left for name in names], left, rtol=1e-3)
    assert all(found[name].observable for name in names[:3])
    # gravity turned by an unknown deflection looks like a small bias, unless a gauge tells
    assert all(found[name].observable for name in names[3:]) == (gauge or accel_bias == 0.5)


def test_what_no_sensor_shows_is_not_observed() -> None:
    (mode,) = observability(arm(ROOT), np.zeros(2))
    assert mode.left == 1.0
    assert not mode.observable


def test_a_gauge_alone_shows_every_mode() -> None:
    states = observability(arm(GAUGE, modes=3), np.zeros(4))
    assert [state.name for state in states] == ['mode 1', 'mode 2', 'mode 3']
    assert all(state.observable for state in states)
    assert [state.frequency for state in states] == sorted(state.frequency for state in states)


def test_nothing_is_said_without_noise_amplitudes_or_of_loops(repository: Path) -> None:
    assert observability(arm(GAUGE.replace('noise="1e-6"', '')), np.zeros(2)) == []
    robots = repository / 'config' / 'robots'
    for name in ('ur10', 'five_bar_ffff'):
        robot = load_robot(robots / f'{name}.urdf')
        assert observability(robot, np.zeros(robot.n)) == []
