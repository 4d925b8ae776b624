"""Damping torque from a gauge in the feedforward: present, limited, refused where it feeds."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest
from node_robots import JOINTS
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.nodes.feedforward import FeedforwardNode

pytestmark = pytest.mark.ros


def parameters(urdf: str, **more: Any) -> dict[str, Any]:
    return {
        'urdf_path': urdf,
        'gravity': [0.0, 0.0, 0.0],
        'update_rate': 1000.0,
        'require_joint_states': False,
        'joint.j1.armature': 1.0,
        'joint.j2.armature': 1.0,
        'feedback.strain_gain': [100.0, 0.0],
        **more,
    }


def test_strain_rate_becomes_torque_within_its_limit(graph: Any, urdf: str) -> None:
    node = graph.add(FeedforwardNode, parameters=parameters(urdf))
    effort = graph.collect(JointState, 'feedforward/effort')
    gauge = graph.probe.create_publisher(Float64, '/strain', 10)
    reference = graph.publisher(JointTrajectory, 'reference')
    graph.until(lambda: gauge.get_subscription_count() > 0)
    point = JointTrajectoryPoint(
        positions=[0.0, 0.0], velocities=[0.0] * 2, accelerations=[0.0] * 2
    )
    message = JointTrajectory(joint_names=JOINTS, points=[point])
    start = time.perf_counter()

    def feed(size: float) -> bool:
        reference.publish(message)
        strain = size * math.sin(6.0 * (time.perf_counter() - start))
        gauge.publish(Float64(data=strain / 2.0e-6))
        graph.spin(0.01)
        return len(damped()) > 100

    def damped() -> list[Any]:
        # without a gauge's word, as while the machine stands still, there is no torque
        return [sample.effort for sample in effort if sample.effort[0] != 0.0]

    graph.until(lambda: feed(1e-3))
    torque = np.array(damped())
    # rates up to 6e-3 per s by 100 N m s, jumps of the gauge at late messages aside; on a busy
    # machine values come in bunches, and torque decays between them
    size = np.abs(torque[20:, 0])
    assert np.quantile(size, 0.75) > 0.1
    assert np.median(size) < 1.5
    assert np.all(torque[:, 1] == 0.0)
    effort.clear()
    graph.until(lambda: feed(1.0))
    # a fifth of 80 N m
    assert max(abs(sample.effort[0]) for sample in effort) == pytest.approx(16.0)
    # a robot that it would feed is refused while the node runs
    (result,) = node.set_parameters([Parameter('joint.j1.armature', value=0.0)])
    assert not result.successful
    assert 'torque must take power from every mode' in result.reason


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'joint.j1.armature': 0.0}, 'strain damping: torque must take power from every mode'),
        ({'feedback.strain_gain': [0.0, 1.0]}, "'j2' must have a strain gauge"),
        ({'feedback.strain_gain': [1.0]}, r'must have 2 elements \(j1, j2\), got 1'),
        ({'enforce_command_limits': False}, 'must come with finite effort limits'),
    ],
)
def test_what_cannot_damp_is_refused_at_configure(
    graph: Any, urdf: str, change: dict[str, Any], message: str
) -> None:
    node = graph.add(FeedforwardNode, start=False, parameters=parameters(urdf, **change))
    node.trigger_configure()
    assert node.state == 'unconfigured'
    with pytest.raises(ValueError, match=message):
        raise ValueError(node.failure)
