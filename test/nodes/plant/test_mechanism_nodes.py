"""Plant, feedforward and predictor on a mechanism with a loop, on real DDS."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

import denoc_ros as dn
from denoc_ros.nodes.feedforward import FeedforwardNode
from denoc_ros.nodes.plant import PlantNode
from denoc_ros.nodes.predictor import PredictorNode

pytestmark = pytest.mark.ros
ROBOT = Path(__file__).resolve().parents[3] / 'config' / 'robots' / 'five_bar_ffff.urdf'
DRIVEN = ['joint_1', 'joint_3']
START = np.radians([108.0, 72.0])
COMMON = {
    'urdf_path': str(ROBOT),
    'gravity': [0.0, -9.81, 0.0],
    'joints': DRIVEN,
    'posture': np.radians([108.0, -72.0, 72.0, 72.0]).tolist(),
    'update_rate': 200.0,
}


def stay() -> JointTrajectory:
    points = []
    for seconds in (0, 60):
        point = JointTrajectoryPoint(positions=START.tolist())
        point.time_from_start.sec = seconds
        points.append(point)
    return JointTrajectory(joint_names=DRIVEN, points=points)


def test_the_driven_joints_carry_the_mechanism_and_passive_ones_need_no_sensor(
    graph: Any,
) -> None:
    states = graph.collect(JointState, '/plant/true_modal_state')
    commands = graph.collect(Float64MultiArray, '/feedforward/commands')
    estimates = graph.collect(JointState, '/predictor/modal_state')
    graph.add(PredictorNode, parameters={**COMMON, 'joint_state_timeout': 0.3})
    graph.add(FeedforwardNode, parameters={**COMMON, 'joint_state_timeout': 0.3})
    drives = {'start': START.tolist(), 'feedback.kp': [20.0], 'feedback.kd': [2.0]}
    graph.add(PlantNode, parameters={**COMMON, **drives})
    reference = graph.publisher(JointTrajectory, 'reference')
    graph.until(lambda: len(states) > 10)
    reference.publish(stay())
    graph.until(lambda: len(commands) > 50 and len(estimates) > 50)
    before = len(states)
    graph.until(lambda: len(states) > before + 100)
    robot = dn.load_robot(ROBOT, gravity=(0, -9.81, 0))
    q = np.array([message.position for message in states])
    assert np.abs(robot.closure(q)).max() < 1e-9
    # carried where it stands, in equilibrium with gravity: a start without torque is a jolt
    driven = robot.joint_indices[[0, 2]]
    np.testing.assert_allclose(q[-1, driven], START, atol=5e-3)
    assert commands[-1].layout.dim[0].label == ','.join(DRIVEN)
    expected, _, _ = robot.constrained_hybrid_dynamics(
        q[0], np.zeros(robot.n), np.zeros(2), DRIVEN
    )
    np.testing.assert_allclose(commands[-1].data, expected, rtol=0.02)
    estimated = np.array(estimates[-1].position)
    assert np.abs(robot.closure(estimated)).max() < 1e-9
    np.testing.assert_allclose(estimated[robot.flexible_indices], q[-1, robot.flexible_indices],
                               atol=2e-5)  # fmt: skip


@pytest.mark.parametrize(
    ('changes', 'match'),
    [
        ({'joints': ['joint_1']}, 'must leave nothing else free'),
        ({'posture': [1.0, 2.0]}, "parameter 'posture' must have an element for each"),
    ],
)
def test_what_does_not_determine_the_mechanism_is_refused(
    graph: Any, changes: dict[str, Any], match: str
) -> None:
    node = graph.add(FeedforwardNode, start=False, parameters={**COMMON, **changes})
    node.trigger_configure()
    assert node.state != 'inactive'
    assert match in str(node.failure)


def test_the_driven_joints_must_be_named(graph: Any) -> None:
    given = {name: value for name, value in COMMON.items() if name != 'joints'}
    node = graph.add(PredictorNode, start=False, parameters=given)
    node.trigger_configure()
    assert node.state != 'inactive'
    assert "parameter 'joints' must name the driven joints" in str(node.failure)


def test_joint_states_that_the_mechanism_cannot_have_do_not_hold_the_predictor(
    graph: Any,
) -> None:
    estimates = graph.collect(JointState, '/predictor/modal_state')
    node = graph.add(PredictorNode, parameters={**COMMON, 'joint_state_timeout': 0.3})
    states = graph.publisher(JointState, 'joint_states')

    def said(positions: Any) -> bool:
        states.publish(JointState(name=DRIVEN, position=list(positions)))
        return False

    graph.until(lambda: said(START) or len(estimates) > 10)
    for far in (1e4, 1e300):
        refused = node.joint_input.rejected['out_of_range']
        graph.until(
            lambda to=far, before=refused: (
                said([to, -to]) or node.joint_input.rejected['out_of_range'] > before
            )
        )
    # within reach, but the arms are apart
    graph.until(lambda: said([2.28, 0.86]) or node.restarts.failures)
    count = len(estimates)
    graph.until(lambda: said(START) or len(estimates) > count + 20)
    assert node.loop.failure is None
