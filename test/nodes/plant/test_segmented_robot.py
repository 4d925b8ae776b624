"""A link of segments through the nodes: its deflection and the torque that carries it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from feedforward_bench import FeedforwardBench, joint_state, point
from node_robots import GRAVITY, JOINTS, two_links
from sensor_msgs.msg import JointState

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.nodes.predictor import PredictorNode

pytestmark = pytest.mark.ros
POSTURE = [0.4, -0.7]


@pytest.fixture
def divided(tmp_path: Path) -> str:
    file = tmp_path / 'divided.urdf'
    file.write_text(
        two_links().replace(
            '<beam link="one" length="1" shape="clamped-free"',
            '<beam link="one" length="1" segments="3"',
        )
    )
    return str(file)


def test_feedforward_carries_a_link_of_segments(graph: Any, divided: str) -> None:
    bench = FeedforwardBench(
        graph, divided, model='flexible', enforce_command_limits=False, max_delta_tau=1e3
    )
    robot = bench.robot
    assert 'one/3/y1' in robot.coordinate_names
    bench.follow(*(point(t, POSTURE, [0.0, 0.0]) for t in (0.0, 9.0)))
    still, zero = robot.static_deflection(POSTURE), np.zeros(robot.n)
    wanted = robot.inverse_dynamics(still, zero, zero)[robot.joint_indices]
    # a sagging link carries its load nearer to the joint than a straight one
    assert np.abs(wanted - bench.inverse(POSTURE)).max() > 0.1

    def arrived() -> bool:
        return bool(bench.commands and np.allclose(bench.commands[-1].data, wanted, atol=0.02))

    bench.until(arrived)


def test_the_predictor_estimates_a_link_of_segments(graph: Any, divided: str) -> None:
    graph.add(
        PredictorNode,
        parameters={
            'urdf_path': divided, 'gravity': GRAVITY, 'update_rate': 200.0,
            'joint_state_timeout': 1.0,
        },
    )  # fmt: skip
    states = graph.collect(JointState, 'predictor/modal_state')
    tips = graph.collect(JointState, 'predictor/tip_deflection')
    joints = graph.publisher(JointState, 'joint_states')
    robot = load_robot(divided, gravity=GRAVITY)
    still = robot.static_deflection(POSTURE)

    def settled() -> bool:
        joints.publish(joint_state(JOINTS, POSTURE, time.time_ns()))
        if not (states and tips):
            return False
        found = dict(zip(states[-1].name, states[-1].position, strict=True))
        named = [found[name] for name in robot.coordinate_names]
        tip = dict(zip(tips[-1].name, tips[-1].position, strict=True))
        # the link's tip, not the last segment's
        whole = robot.tip_deflection('one', still)[1]
        return bool(np.allclose(named, still, atol=1e-4) and abs(tip['one/uy'] - whole) < 1e-4)

    graph.until(settled)
    assert abs(robot.tip_deflection('one', still)[1]) > 0.02
