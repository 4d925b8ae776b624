"""Nodes of an arm with elastic joints: the plant's states mean a side, the others go by it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geared_arm import arm_text
from node_robots import STATE_FEEDBACK
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.nodes.feedforward import FeedforwardNode
from denoc_ros.nodes.plant import PlantNode
from denoc_ros.nodes.predictor import PredictorNode

pytestmark = pytest.mark.ros
SHARED = {'gravity': [0.0, 0.0, -9.81], 'update_rate': 200.0}
START = [0.3, -0.5]
LONG = 300.0  # s, for a machine that is busy with others


@pytest.mark.parametrize('side', ['motor', 'link'])
def test_states_effort_and_estimates_mean_the_side_that_is_measured(
    graph: Any, tmp_path: Path, side: str
) -> None:
    file = tmp_path / 'arm.urdf'
    file.write_text(arm_text(side))
    given = {**SHARED, 'urdf_path': str(file)}
    states = graph.collect(JointState, '/joint_states')
    true = graph.collect(JointState, '/plant/true_modal_state')
    estimates = graph.collect(JointState, '/predictor/modal_state')
    plant = graph.add(PlantNode, parameters={**given, 'start': START})
    predictor = graph.add(PredictorNode, parameters=given)
    graph.until(lambda: len(states) > 5 and len(true) > 5 and len(estimates) > 5)
    whole = load_robot(file)
    q = whole.static_deflection(START)  # the brake holds the motors
    assert plant.robot.n == 4
    np.testing.assert_allclose(true[-1].position, q, atol=1e-7)
    behind = 1.0 if side == 'link' else 0.0
    np.testing.assert_allclose(states[-1].position, q[::2] + behind * q[1::2], atol=1e-7)
    weight = -whole.stiffness[1::2] * q[1::2]  # the gears carry it; braked motors give nothing
    np.testing.assert_allclose(states[-1].effort, behind * weight, atol=0.02)
    assert tuple(estimates[-1].name) == whole.coordinate_names
    estimate = np.array(estimates[-1].position)
    np.testing.assert_allclose(estimate, q, atol=1e-6)  # the motors' sides and the springs
    names = ('shoulder', 'elbow') if side == 'link' else whole.coordinate_names
    assert predictor.robot.coordinate_names == names
    tip = whole.frame_pose('tool', estimate)
    np.testing.assert_allclose(tip, whole.frame_pose('tool', q), atol=1e-6)
    feedforward = graph.add(FeedforwardNode, parameters=given)  # releases the brake
    assert feedforward.robot.coordinate_names == names


def test_state_feedback_knows_which_side_is_measured(graph: Any, tmp_path: Path) -> None:
    file = tmp_path / 'arm.urdf'
    file.write_text(arm_text('link'))
    given = {
        **SHARED,
        'urdf_path': str(file),
        **STATE_FEEDBACK,
    }
    node = graph.add(FeedforwardNode, parameters=given)
    commands = graph.collect(Float64MultiArray, '/feedforward/commands')
    reference = graph.publisher(JointTrajectory, 'reference')
    joints = graph.publisher(JointState, 'joint_states')
    names, state, last = ['shoulder', 'elbow'], node.feedback.law.state, 0.0

    def feed(offset: float, condition: Callable[[], object]) -> None:
        def fed() -> object:
            nonlocal last
            if time.perf_counter() - last > 0.004:
                last = time.perf_counter()
                there = [each + offset for each in START]
                joints.publish(JointState(name=names, position=there, velocity=[0.0, 0.0]))
            return condition()

        graph.until(fed, LONG)

    feed(0.0, lambda: node.joint_input.received)
    point = JointTrajectoryPoint(positions=START)
    later = JointTrajectoryPoint(positions=START)
    later.time_from_start.nanosec = 100_000_000
    reference.publish(JointTrajectory(joint_names=names, points=[point, later]))
    feed(0.0, lambda: state.active and state._now is not None and state._now.share == 1.0)
    plan = node.torque.source.whole_motion()[0]
    whole = load_robot(file, gravity=(0.0, 0.0, -9.81))
    np.testing.assert_allclose(plan[::2] + plan[1::2], START, atol=1e-9)
    np.testing.assert_allclose(plan, whole.static_deflection(plan[::2]), atol=1e-6)
    # the links are where they should be: the plan's torque alone carries them
    held = np.array(commands[-1].data)
    weight = whole.stiffness[1::2] * -plan[1::2]
    np.testing.assert_allclose(held, weight, atol=0.2)
    feed(1e-3, lambda: np.abs(np.array(commands[-1].data) - held).max() > 0.5)
    assert node.tick_failures == 0
