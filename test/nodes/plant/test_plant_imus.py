"""The plant's IMUs and accelerometers on real DDS."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import AccelStamped
from node_robots import GRAVITY, two_links
from sensor_msgs.msg import Imu, JointState

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.nodes.plant import PlantNode
from denoc_ros.types import Array

pytestmark = pytest.mark.ros
RATE = 200.0
SENSORS = """
<sensor name="tip" type="imu" link="two" station="1" xyz="0 0.02 0" rpy="0.3 -0.2 0.5"
 topic="/imu" gyro_noise="0.02" accel_noise="0.3" gyro_bias="0.5" accel_bias="4"/>
<sensor name="knock" type="accelerometer" link="one" station="0.4" topic="/accel"/>
<sensor name="mute" type="imu" link="one" station="0.4"/>"""


@pytest.fixture
def urdf(tmp_path: Path) -> str:
    file = tmp_path / 'arm.urdf'
    file.write_text(two_links().replace('</flexibility>', f'{SENSORS}</flexibility>'))
    return str(file)


def plant(graph: Any, urdf: str, **parameters: Any) -> Any:
    given = {'urdf_path': urdf, 'gravity': GRAVITY, 'update_rate': RATE, **parameters}
    return graph.add(PlantNode, parameters=given)


def stamp_of(message: Any) -> int:
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def reading(message: Any) -> Array:
    """Angular rate, of an Imu, and specific force."""
    if isinstance(message, AccelStamped):
        linear = message.accel.linear
        return np.array([linear.x, linear.y, linear.z])
    rate, force = message.angular_velocity, message.linear_acceleration
    return np.array([rate.x, rate.y, rate.z, force.x, force.y, force.z])


def by_stamp(messages: list[Any]) -> dict[int, Any]:
    return {stamp_of(message): message for message in messages}


def single_steps(states: list[Any], *others: list[Any]) -> list[list[Any]]:
    """States one step apart, and the others' messages of the later one's stamp.

    A late tick takes several steps between two messages: the mean over the last one is not known.
    """
    known = by_stamp(states)
    found = []
    for before, stamp in itertools.pairwise(sorted(known)):
        beside = [by_stamp(messages).get(stamp) for messages in others]
        # stamps are whole nanoseconds
        if abs((stamp - before) * 1e-9 * RATE - 1.0) < 1e-3 and None not in beside:
            found.append([known[before], known[stamp], *beside])
    return found


def test_they_read_the_motion_of_their_links(graph: Any, urdf: str) -> None:
    """The accelerations are the differences of the rates over the last step."""
    modal = graph.collect(JointState, '/plant/true_modal_state')
    imu = graph.collect(Imu, '/imu')
    accel = graph.collect(AccelStamped, '/accel')
    # two free pendulums, which fall from here
    plant(graph, urdf, brake=False, start=[-0.9, 0.4], **{'noise.sensors': False})
    graph.until(lambda: len(imu) > 40 and len(single_steps(modal, imu, accel)) > 20)
    robot = load_robot(urdf, gravity=GRAVITY)
    places = {name: k for k, name in enumerate(robot.sensor_names)}
    first, knock = places['tip/gyro_x'], places['knock/accel_x']
    for before, state, of_imu, of_accel in single_steps(modal, imu, accel):
        q, qd = np.array(state.position), np.array(state.velocity)
        values = robot.sensor_values(q, qd, (qd - np.array(before.velocity)) * RATE)
        atol = 1e-9 * np.abs(values).max()
        np.testing.assert_allclose(reading(of_imu), values[first : first + 6], atol=atol)
        np.testing.assert_allclose(reading(of_accel), values[knock : knock + 3], atol=atol)
    assert imu[0].header.frame_id == 'tip'
    assert imu[0].orientation_covariance[0] == -1.0
    assert np.abs(reading(imu[-1])[:3]).max() > 0.1  # it moves


def test_noise_and_an_unknown_bias_are_added(graph: Any, urdf: str) -> None:
    imu = graph.collect(Imu, '/imu')
    modal = graph.collect(JointState, '/plant/true_modal_state')
    plant(graph, urdf, start=[0.3, 0.2], seed=4, **{'noise.sensors': True})
    graph.until(lambda: len(imu) > 250 and modal)
    robot = load_robot(urdf, gravity=GRAVITY)
    first = robot.sensor_names.index('tip/gyro_x')
    still = robot.sensor_values(np.array(modal[0].position))[first : first + 6]  # braked
    errors = np.array([reading(message) for message in imu]) - still
    deviations = np.array([0.02] * 3 + [0.3] * 3)
    # of 250 values: 4.5 % is one standard deviation of what they scatter by
    np.testing.assert_allclose(errors.std(axis=0), deviations, rtol=0.25)
    bias = errors.mean(axis=0) / np.array([0.5] * 3 + [4.0] * 3)
    assert np.abs(bias).max() < 4.5
    assert np.abs(bias).max() > 0.3  # six draws of a normal distribution that are all less: 2e-4
    assert imu[0].angular_velocity_covariance[4] == pytest.approx(4e-4)
    assert imu[0].linear_acceleration_covariance[8] == pytest.approx(0.09)
