"""A real arm's recorded joint states through the nodes, against an independent library."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
import pytest
from data_files import UR10_BAG
from sensor_msgs.msg import JointState

from denoc_ros.bags.joint_state import JOINT_STATE
from denoc_ros.bags.reader import read_bag
from denoc_ros.bags.writer import BagWriter
from denoc_ros.nodes.bag_player import read_motion
from denoc_ros.nodes.feedforward import FeedforwardNode

pytestmark = pytest.mark.ros

ROOT = Path(__file__).resolve().parents[3]
URDF = ROOT / 'config' / 'robots' / 'ur10.urdf'
SPEED = 4.0  # times real time; every message must come through all the same


def rnea(joints: tuple[str, ...], q: Any, qd: Any, qdd: Any) -> Any:
    """Return rigid inverse dynamics (k, n) with columns in the order of `joints`."""
    model = pinocchio.buildModelFromUrdf(str(URDF))
    data = model.createData()
    names = list(model.names)[1:]
    order = [joints.index(name) for name in names]
    rows = [
        pinocchio.rnea(model, data, q[k, order], qd[k, order], qdd[k, order])
        for k in range(len(q))
    ]
    return np.array(rows)[:, [names.index(name) for name in joints]]


def test_every_recorded_message_gets_the_torque_of_rnea(graph: Any) -> None:
    graph.add(
        FeedforwardNode,
        urdf_path=str(URDF),
        model='rigid',
        trigger='message',
        enforce_command_limits=False,
    )
    answers = graph.collect(JointState, '/feedforward/effort')
    options = ['--speed', str(SPEED), '--listeners', 'feedforward']
    player = subprocess.Popen(
        [sys.executable, '-m', 'denoc_ros.cli.player', str(UR10_BAG), *options]
    )
    motion = read_motion(UR10_BAG)
    try:
        graph.until(lambda: player.poll() is not None, 60.0)
        # on a busy machine this process reads them later
        graph.until(lambda: len(answers) >= len(motion.stamp_ns), 60.0)
        graph.spin(0.5)
    finally:
        player.kill()
        player.wait(60.0)
    stamps = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in answers])
    # none missing, none twice: the stamps are the recorded ones, moved by one constant
    np.testing.assert_array_equal(stamps - stamps[0], motion.stamp_ns - motion.stamp_ns[0])
    assert all(tuple(answer.name) == motion.names for answer in answers)
    torque = np.array([answer.effort for answer in answers])
    expected = rnea(motion.names, motion.position, motion.velocity, motion.acceleration)
    # rounding: both sum a few hundred products of numbers up to 1e2 N m
    np.testing.assert_allclose(torque, expected, rtol=0.0, atol=1e-10)


def test_accelerations_are_the_derivative_of_the_recorded_velocities() -> None:
    motion = read_motion(UR10_BAG)
    assert len(motion.stamp_ns) == sum(1 for _ in read_bag(UR10_BAG))
    t = (motion.stamp_ns - motion.stamp_ns[0]) * 1e-9
    # a cubic spline's integral over a step is Simpson's with the rate midway from its own data:
    # the mean of two end accelerations differs from it by the third derivative only
    mean = 0.5 * (motion.acceleration[1:] + motion.acceleration[:-1])
    differences = np.diff(motion.velocity, axis=0) / np.diff(t)[:, np.newaxis]
    spread = np.abs(np.diff(motion.acceleration, axis=0)).max()
    assert np.abs(mean - differences).max() < 0.5 * spread
    correlation = np.corrcoef(mean.ravel(), differences.ravel())[0, 1]
    assert correlation > 0.95


def test_recorded_positions_that_wrap_have_the_rates_of_the_motion(tmp_path: Path) -> None:
    t = 0.01 * np.arange(300)
    turning = 5.0 * t
    with BagWriter(tmp_path / 'turns.mcap') as bag:
        bag.add_topic('/joint_states', JOINT_STATE)
        for stamp, q in zip(t, (turning + np.pi) % (2.0 * np.pi) - np.pi, strict=True):
            stamp_ns = 10**9 + round(1e9 * stamp)
            bag.write_message('/joint_states', stamp_ns, name=['swing'], position=[q])
    motion = read_motion(tmp_path / 'turns.mcap')
    np.testing.assert_allclose(motion.position[:, 0], turning, atol=1e-9)
    np.testing.assert_allclose(motion.velocity, 5.0, atol=1e-6)
