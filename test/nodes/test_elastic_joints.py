"""Nodes of an arm with elastic joints: the plant's states mean a side, the others go by it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geared_arm import arm_text
from sensor_msgs.msg import JointState

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.nodes.feedforward import FeedforwardNode
from denoc_ros.nodes.plant import PlantNode
from denoc_ros.nodes.predictor import PredictorNode

pytestmark = pytest.mark.ros
SHARED = {'gravity': [0.0, 0.0, -9.81], 'update_rate': 200.0}
START = [0.3, -0.5]


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
