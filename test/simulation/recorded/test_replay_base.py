"""Recorded runs on bases that move or float: the bag says how, the replay computes with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from base_robots import description, floating, spacecraft
from simulated_bags import swing

import denoc_ros as dn
from denoc_ros.bags.joint_state import JOINT_STATE
from denoc_ros.bags.series import (
    ODOMETRY,
    ODOMETRY_NUMBERS,
    read_joint_states,
    read_numbers,
)
from denoc_ros.bags.writer import BagWriter
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import BagError, StateError
from denoc_ros.simulation.recorded.replay_settings import ReplaySettings
from denoc_ros.simulation.simulate import Run
from denoc_ros.simulation.simulated_bag import write_run

STEP = 5e-3
GRAVITY = (0.0, 0.0, -9.81)  # all falls: it does not matter


def afloat() -> Robot:
    return load_robot(floating(description('canadarm'), spacecraft(800.0, 1.0)), GRAVITY)


@pytest.fixture(scope='module')
def run() -> Run:
    """The arm swings on a light spacecraft that tumbles."""
    robot = afloat()
    q, qd = np.zeros((2, robot.n))
    qd[robot.base_indices] = 0.1, 0.2, -0.1, 0.15, -0.1, 0.2
    laws = {name: swing(0.2, 1.0 + 0.4 * k) for k, name in enumerate(robot.joint_names)}
    times = STEP * np.arange(400, dtype=np.float64)
    return dn.simulate(robot, q, qd, times, prescribed=laws, rtol=1e-7, atol=1e-9)


@pytest.mark.long
def test_a_floating_robot_is_replayed_on_its_recorded_base(tmp_path: Path, run: Run) -> None:
    robot, bag, output = afloat(), tmp_path / 'run.mcap', tmp_path / 'replay.mcap'
    write_run(run, robot, bag, robot.tree.source)
    replay = dn.replay_bag(bag, robot, output)
    found = replay.torque['flexible']
    # smoothing, and amplitudes that start in equilibrium; found: 1 %
    assert (found.rms < 0.05 * found.measured_rms).all()
    deflection = replay.deflection['/plant/true_deflection']
    moves = deflection.measured_rms > 1e-3
    assert moves.any()
    assert (deflection.rms < 0.05 * deflection.measured_rms)[moves].all()
    # states of the robot on a base that is held, as which the new bag describes it
    modal = read_joint_states(output, '/replay/modal_state')
    assert modal.names == load_robot(description('canadarm')).coordinate_names
    blind = dn.replay_bag(bag, load_robot(description('canadarm'), (0, 0, 0)))
    assert (blind.torque['flexible'].rms > 4.0 * found.rms).any()
    named = dn.replay_bag(bag, robot, None, ReplaySettings(base='/base_motion'))
    np.testing.assert_array_equal(named.torque['flexible'].rms, found.rms)


def test_odometry_is_that_of_the_base_link(tmp_path: Path, run: Run) -> None:
    robot, bag = afloat(), tmp_path / 'run.mcap'
    write_run(run, robot, bag)
    stamps, moved = read_numbers(bag, 'base_motion', ODOMETRY_NUMBERS)
    poses, twists = moved[:, :7], moved[:, 7:]
    np.testing.assert_allclose(1e-9 * stamps, run.t, atol=1e-9)
    for k in (0, 200, 399):
        pose = robot.frame_pose('base', run.q[k])
        np.testing.assert_allclose(poses[k, :3], pose[:3, 3], atol=1e-12)
        motion = robot.frame_motion('base', run.q[k], run.qd[k])[0].reshape(2, 3)
        np.testing.assert_allclose(twists[k], (motion @ pose[:3, :3]).ravel(), atol=1e-12)


def states_alone(path: Path, odometry: float | None) -> Path:
    """Write joint states of 2 s, and a base at rest every so many seconds, if at all."""
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', JOINT_STATE)
        bag.add_topic('/base_motion', ODOMETRY)
        for k in range(200):
            stamp = 10_000_000 * k
            names = [f'joint_{j + 1}' for j in range(3)]
            bag.write_message('/joint_states', stamp, name=names, position=np.zeros(3))
            if odometry is not None and k % round(100 * odometry) == 0:
                still = {'pose': {'orientation': {'x': 0.0, 'y': 0.0, 'z': 0.0, 'w': 1.0}}}
                bag.write_message('/base_motion', stamp, pose=still)
    return path


def test_a_base_that_floats_unrecorded_is_refused(tmp_path: Path) -> None:
    bag = states_alone(tmp_path / 'alone.mcap', None)
    with pytest.raises(StateError, match=r'must be fixed or its motion recorded .* floats'):
        dn.replay_bag(bag, afloat())
    with pytest.raises(BagError, match=f"base must come from a topic of {ODOMETRY}.* got '/odom'"):
        dn.replay_bag(bag, afloat(), None, ReplaySettings(base='/odom'))


def test_a_base_that_is_silent_for_long_is_refused(tmp_path: Path) -> None:
    bag = states_alone(tmp_path / 'gap.mcap', 0.8)
    with pytest.raises(BagError, match=r'at least every 0\.5 s, got a gap of 0\.8 s'):
        dn.replay_bag(bag, afloat())
