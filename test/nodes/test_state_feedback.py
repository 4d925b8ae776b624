"""State feedback in the feedforward: it brings a robot to its plan, and lets go when it must."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from feedback_runs import CANADARM
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.control.gain_schedule import spacing
from denoc_ros.nodes.feedforward import FeedforwardNode
from denoc_ros.nodes.plant import PlantNode

pytestmark = pytest.mark.ros

RATE = 400.0
JOINTS = ['joint_1', 'joint_2', 'joint_3']
COMMON = {'urdf_path': str(CANADARM), 'gravity': [0.0, 0.0, 0.0], 'update_rate': RATE}
WEIGHTS = {
    'feedback.state': 'lqr',
    'feedback.tip_error': 0.1,
    'feedback.tip_turn': 0.05,
    'feedback.joint_error': 0.05,
    'feedback.integral_time': 0.5,
}
START = [0.2, 0.7, 0.5]
AWAY = 0.01  # rad


def trajectory(*points: tuple[float, list[float]]) -> JointTrajectory:
    message = JointTrajectory(joint_names=JOINTS)
    for after, positions in points:
        point = JointTrajectoryPoint(positions=positions)
        point.time_from_start.sec = int(after)
        point.time_from_start.nanosec = round((after - int(after)) * 1e9)
        message.points.append(point)
    return message


def test_robot_comes_to_its_plan_and_a_silent_gauge_leaves_the_plan_alone(graph: Any) -> None:
    beside = (np.array(START) + AWAY).tolist()
    plant = graph.add(
        PlantNode,
        parameters={
            **COMMON, 'start': beside, 'noise.position': 1e-5, 'noise.velocity': 1e-4,
            'noise.sensors': False,
            'beam.link_1.y.ei': 0.9e5, 'beam.link_2.y.ei': 1.8e5,
        },
    )  # fmt: skip
    node = graph.add(FeedforwardNode, parameters={**COMMON, **WEIGHTS})
    commands = graph.collect(Float64MultiArray, '/feedforward/commands')
    states = graph.collect(JointState, '/joint_states')
    reference = graph.publisher(JointTrajectory, 'reference')
    graph.until(lambda: len(states) > 10)
    reference.publish(trajectory((0.0, START), (0.1, START)))

    def off() -> float:
        return float(np.abs(plant.q[plant._index] - START).max())

    assert off() == pytest.approx(AWAY, rel=0.05)
    graph.until(lambda: node.feedback.state.active, 20.0)
    # there is no gravity: without feedback nothing would move
    graph.until(lambda: off() < 0.2 * AWAY, 30.0)

    send, plant.sensors.send = plant.sensors.send, lambda *_: None
    graph.until(lambda: not node.feedback.state.active)
    commands.clear()
    graph.until(lambda: len(commands) > 5)
    # the plan alone, which is at rest
    assert np.abs([message.data for message in commands[1:]]).max() < 1e-6
    graph.until(lambda: graph.value('feedforward: state feedback', 'fallbacks') == '1')
    assert 'no good values of' in graph.value('feedforward: state feedback', 'cause')
    plant.sensors.send = send
    graph.until(lambda: node.feedback.state.active, 20.0)

    # a motion that arrives whole gets gains of its own
    before = node.feedback.state.designs
    gains = math.ceil(2.0 / spacing(2.0, 1.0 / RATE)) + 1
    there = (np.array(START) + 0.02).tolist()
    reference.publish(trajectory((0.0, START), (2.0, there)))
    graph.until(lambda: node.feedback.state.designs > before)
    graph.until(lambda: node.feedback.state.postures == gains)
    assert node.feedback.state.status().values['refused'] == ''
    assert node.tick_failures == 0


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'model': 'rigid'}, "'model' must be flexible with state feedback, got 'rigid'"),
        ({'terms.elastic': False}, "'terms.elastic' must be true with state feedback"),
        ({'feedback.strain_gain': [1.0] * 3}, 'must not be set both'),
        ({'feedback.tip': 'nose'}, "tip must be one of base, .*, got 'nose'"),
        ({'enforce_command_limits': False}, 'effort limits must be finite and > 0'),
        (
            {'feedback.integral_time': 0.01},
            r'must be stable for 0\.8 to 1\.2 of the stiffness .*, got modulus \d\.\d+ with',
        ),
    ],
)
def test_what_cannot_work_is_refused_at_configure(
    graph: Any, change: dict[str, Any], message: str
) -> None:
    given = {**COMMON, **WEIGHTS, **change}
    node = graph.add(FeedforwardNode, start=False, parameters=given)
    node.trigger_configure()
    assert node.state == 'unconfigured'
    with pytest.raises(ValueError, match=message):
        raise ValueError(node.failure)
