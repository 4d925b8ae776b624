"""The linear model of the amplitudes: what matrix exponentials and simulations give."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

import denoc_ros as dn
from denoc_ros.dynamics.robot import Robot
from denoc_ros.estimation.joint_motion import SmoothedMotion
from denoc_ros.estimation.torque_along import TorqueReplay
from denoc_ros.identification.model.innovations import Motion, NearbyMotion, _transitions
from denoc_ros.types import Array

ROBOTS = Path(__file__).parents[3] / 'config' / 'robots'
JOINTS = 'joint_1', 'joint_2', 'joint_3'
COUNT, PERIOD = 600, 2e-3
STEP = 1e-4  # s: simulations in which its own error does not show


@pytest.fixture(scope='module')
def robot() -> Robot:
    return dn.load_robot(ROBOTS / 'canadarm_gauges.urdf', gravity=(0.0, -9.81, 0.0))


T: Array = PERIOD * np.arange(COUNT, dtype=np.float64)
STARTS = np.isin(np.arange(COUNT), (0, 350))


@pytest.fixture(scope='module')
def swing() -> SmoothedMotion:
    omega, sizes = 4.0, np.array([0.3, -0.2, 0.1])
    angle = omega * T[:, None]
    return SmoothedMotion(
        sizes * np.sin(angle), omega * sizes * np.cos(angle), -(omega**2) * sizes * np.sin(angle)
    )


def simulated(robot: Robot, motion: SmoothedMotion) -> Motion:
    return TorqueReplay(robot, JOINTS, step=STEP).states(T, motion, STARTS)


@pytest.fixture(scope='module')
def nearby(robot: Robot, swing: SmoothedMotion) -> NearbyMotion:
    return NearbyMotion(robot, JOINTS, T, STARTS, simulated(robot, swing))


def difference(changed: Motion, motion: Motion) -> tuple[Array, Array]:
    return changed[0][:2] - motion[0][:2], changed[1] - motion[1]


@pytest.mark.parametrize('fastest', [3.0, 300.0, 3e4])
def test_transitions_are_matrix_exponentials_whatever_the_frequency(fastest: float) -> None:
    draw = np.random.default_rng(4)
    shapes = draw.standard_normal((3, 3))
    omega = np.geomspace(0.01 * fastest, fastest, 3)
    slopes = np.zeros((5, 6, 6))
    slopes[:, :3, 3:] = np.eye(3)
    slopes[:, 3:, :3] = -shapes @ np.diag(omega**2) @ np.linalg.inv(shapes)
    slopes[:, 3:, 3:] = -0.1 * shapes @ np.diag(omega) @ np.linalg.inv(shapes)
    t = np.array([0.0, 1e-3, 3e-3, 4e-3, 9e-3])
    transitions, early, late = _transitions(t, np.zeros(5, dtype=bool), slopes)
    for k, h in enumerate(np.diff(t)):
        # C. F. Van Loan, IEEE Transactions on Automatic Control 23, 1978: integrals as blocks
        whole = np.zeros((18, 18))
        whole[:6, :6], whole[:6, 6:12], whole[6:12, 12:] = slopes[k], np.eye(6), np.eye(6)
        block = scipy.linalg.expm(h * whole)
        second = block[:6, 15:] / h
        for found, wanted in (
            (transitions[k], block[:6, :6]),
            (late[k], second),
            (early[k], block[:6, 9:12] - second),
        ):
            np.testing.assert_allclose(found, wanted, atol=1e-8 * np.abs(wanted).max())


def test_noise_of_the_joints_moves_the_links_as_in_a_simulation(
    robot: Robot, swing: SmoothedMotion, nearby: NearbyMotion
) -> None:
    draw = np.random.default_rng(1)
    sizes = 1e-6, 1e-5, 1e-3
    noises = [
        SmoothedMotion(*(size * draw.standard_normal(swing.q.shape) for size in sizes))
        for _ in range(2)
    ]
    for noise, motion in zip(noises, nearby.shaken(robot, noises), strict=True):
        shaken = SmoothedMotion(swing.q + noise.q, swing.qd + noise.qd, swing.qdd + noise.qdd)
        wanted = difference(simulated(robot, shaken), nearby.motion)
        for found, own in zip(difference(motion, nearby.motion), wanted, strict=True):
            # 2 %: the rates' parabolas between stamps count by their means
            assert np.linalg.norm(found - own) < 0.04 * np.linalg.norm(own)


def test_a_linear_model_moves_to_a_motion_nearby(
    robot: Robot, swing: SmoothedMotion, nearby: NearbyMotion
) -> None:
    stiffer = robot.with_overrides({'beam.link_1.y.ei': 1.001e5})
    moved = simulated(stiffer, swing)
    found = nearby.about(moved)
    assert found.motion is moved
    assert found.transitions is nearby.transitions
    # about its own motion a robot has that motion
    same = found.of(stiffer)
    np.testing.assert_allclose(same[0], moved[0], atol=1e-8 * np.abs(moved[0]).max())


def test_a_robot_nearby_moves_as_in_a_simulation(
    robot: Robot, swing: SmoothedMotion, nearby: NearbyMotion
) -> None:
    heavier = robot.with_overrides({'payload.tool.mass': 1e-3})
    wanted = difference(simulated(heavier, swing), nearby.motion)
    for found, own in zip(difference(nearby.of(heavier), nearby.motion), wanted, strict=True):
        assert np.linalg.norm(found - own) < 0.02 * np.linalg.norm(own)
