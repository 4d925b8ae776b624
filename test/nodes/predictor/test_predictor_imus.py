"""The predictor's IMUs and accelerometers on real DDS."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import AccelStamped
from node_robots import GRAVITY, two_links
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.nodes.predictor import PredictorNode
from denoc_ros.types import Array

pytestmark = pytest.mark.ros
RATE = 100.0
IMUS = """
<sensor name="tip" type="imu" link="two" station="1" rpy="0.3 -0.2 0.5" topic="/imu"
 gyro_noise="0.01" accel_noise="0.1" gyro_bias="0.2" accel_bias="0.5"/>
<sensor name="knock" type="accelerometer" link="one" station="1" topic="/accel"
 accel_noise="0.1" accel_bias="0.5"/>"""
BIAS = np.array([0.1, -0.05, 0.08])  # rad/s


@pytest.fixture
def urdf(tmp_path: Path) -> str:
    text = two_links()
    first = text.index('<sensor name="gauge"')
    text = text[:first] + IMUS + '</flexibility></robot>'
    file = tmp_path / 'arm.urdf'
    file.write_text(text)
    return str(file)


def at(stamp_ns: int) -> Time:
    return Time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)


def imu(stamp_ns: int, values: Array) -> Imu:
    message = Imu()
    message.header.stamp = at(stamp_ns)
    rate, force = message.angular_velocity, message.linear_acceleration
    rate.x, rate.y, rate.z, force.x, force.y, force.z = values.tolist()
    return message


def accel(stamp_ns: int, values: Array) -> AccelStamped:
    message = AccelStamped()
    message.header.stamp = at(stamp_ns)
    linear = message.accel.linear
    linear.x, linear.y, linear.z = values.tolist()
    return message


def joints(stamp_ns: int, position: list[float]) -> JointState:
    message = JointState(name=['j1', 'j2'], position=position, velocity=[0.0, 0.0])
    message.header.stamp = at(stamp_ns)
    return message


def test_values_are_fused_and_the_gyros_biases_found(graph: Any, urdf: str) -> None:
    """An arm that hangs still: what the gyros show of a rate is their bias."""
    node = graph.add(
        PredictorNode, urdf_path=urdf, gravity=GRAVITY, update_rate=RATE, strain='fuse'
    )
    robot = load_robot(urdf, gravity=GRAVITY)
    q = robot.static_deflection([-1.2, 0.3])
    values = robot.sensor_values(q)
    shown = values.copy()
    shown[:3] += BIAS
    out = graph.publisher(JointState, 'joint_states')
    to_imu, to_accel = graph.publisher(Imu, '/imu'), graph.publisher(AccelStamped, '/accel')
    fusion = node.observer.fusion
    assert fusion.names == robot.sensor_names

    def send() -> bool:
        stamp = time.time_ns()
        out.publish(joints(stamp, [-1.2, 0.3]))
        to_imu.publish(imu(stamp, shown[:6]))
        to_accel.publish(accel(stamp, shown[6:]))
        return all(count['accepted'] > 100 for count in fusion.counts)

    graph.until(send)
    # one value leaves 0.01 rad/s, a hundred a tenth of that: half a bias is far from both
    np.testing.assert_allclose(fusion.biases[:3], BIAS, atol=0.5 * np.abs(BIAS).min())
    np.testing.assert_allclose(node.observer.q, q, atol=0.02)


def test_a_topic_of_another_type_is_said_so(graph: Any, urdf: str) -> None:
    graph.probe.create_publisher(Float64, '/imu', 10)
    node = graph.add(
        PredictorNode, urdf_path=urdf, gravity=GRAVITY, update_rate=RATE, strain='fuse'
    )
    graph.until(lambda: node.sensors._refused == {'/imu'})
    # the other topic is heard all the same
    assert graph.publisher(AccelStamped, '/accel').get_subscription_count() == 1
