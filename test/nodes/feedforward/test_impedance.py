"""Drives that close a soft loop themselves: position, velocity, gains, torque in one message."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from node_robots import GRAVITY, JOINTS, two_links
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.nodes.feedforward import FeedforwardNode
from denoc_ros.nodes.plant import PlantNode
from denoc_ros.runtime.inputs.input_monitor import InputError
from denoc_ros.runtime.inputs.message_readers import CommandReader

pytestmark = pytest.mark.ros
RATE, RAMP = 200.0, 0.3
STIFFNESS, DAMPING = np.array([400.0, 200.0]), np.array([40.0, 15.0])
GOAL = np.array([0.2, -0.4])
LONG = 120.0  # s, on a machine that is busy with others
GAINS = {
    'impedance.stiffness': STIFFNESS.tolist(),
    'impedance.damping': DAMPING.tolist(),
    'ramp_time': RAMP,
    'joint_state_timeout': 10.0,
}


@pytest.fixture
def rigid(tmp_path: Path) -> Path:
    text, file = two_links(), tmp_path / 'rigid.urdf'
    file.write_text(text[: text.index('<flexibility>')] + '</robot>')
    return file


def held(graph: Any, rigid: Path, **more: Any) -> tuple[Any, list[Any], list[Any]]:
    """Return a feedforward beside a plant that it holds at `GOAL`, its commands, the states."""
    common = {'urdf_path': str(rigid), 'gravity': GRAVITY, 'update_rate': RATE}
    states = graph.collect(JointState, 'joint_states', reliable=False)
    commands = graph.collect(Float64MultiArray, 'feedforward/impedance_commands', reliable=False)
    topic = 'feedforward/impedance_commands'
    graph.add(PlantNode, parameters={**common, 'impedance_command': topic, 'start': GOAL.tolist()})
    node = graph.add(FeedforwardNode, parameters={**common, **GAINS, **more})
    reference = graph.publisher(JointTrajectory, 'reference')
    message = JointTrajectory(joint_names=JOINTS)
    message.points = [JointTrajectoryPoint(positions=GOAL.tolist()) for _ in range(2)]
    message.points[1].time_from_start.nanosec = 500_000_000
    graph.until(lambda: len(states) > 5)
    reference.publish(message)

    def rests() -> bool:
        if not commands or len(states) < 300 or stiffness(commands[-1])[0] < STIFFNESS[0]:
            return False
        return float(np.ptp([s.position for s in states[-60:]], axis=0).max()) < 1e-5

    graph.until(rests, LONG)
    return node, commands, states


def stiffness(message: Any) -> Any:
    return np.array(message.data).reshape(2, 5)[:, 2]


def test_the_model_s_torque_takes_the_sag_of_a_soft_servo(graph: Any, rigid: Path) -> None:
    _, commands, states = held(graph, rigid)
    last = np.array(commands[-1].data).reshape(2, 5)
    np.testing.assert_array_equal(last[:, :2], np.column_stack([GOAL, np.zeros(2)]))
    np.testing.assert_array_equal(last[:, 2:4], np.column_stack([STIFFNESS, DAMPING]))
    assert [d.label for d in commands[-1].layout.dim] == [
        'j1,j2',
        'position,velocity,stiffness,damping,effort',
    ]
    arm = load_robot(str(rigid), gravity=tuple(GRAVITY))
    np.testing.assert_allclose(last[:, 4], arm.bias_forces(GOAL, np.zeros(2)), atol=1e-6)
    np.testing.assert_allclose(states[-1].position, GOAL, atol=1e-4)


def test_without_torque_the_servo_sags_by_weight_over_stiffness(graph: Any, rigid: Path) -> None:
    _, _, states = held(graph, rigid, effort_limits=[0.0, 0.0])
    there = np.array(states[-1].position)
    weight = load_robot(str(rigid), gravity=tuple(GRAVITY)).bias_forces(there, np.zeros(2))
    np.testing.assert_allclose(STIFFNESS * (GOAL - there), weight, rtol=0.02)
    assert (GOAL - there)[0] > 0.08


def test_stiffness_comes_and_goes_over_the_ramp(graph: Any, rigid: Path) -> None:
    node, commands, _ = held(graph, rigid)
    node.trigger_deactivate()
    graph.until(lambda: not stiffness(commands[-1]).any(), LONG)
    shares = np.array([stiffness(each)[0] for each in commands]) / STIFFNESS[0]
    assert shares[0] < 0.1
    steps = np.diff(shares)
    # of 1/60 a tick; a busy machine leaves ticks out
    assert np.median(np.abs(steps[steps != 0.0])) == pytest.approx(1.0 / (RATE * RAMP), rel=0.2)


def test_commands_of_five_numbers_are_read_by_name() -> None:
    message = Float64MultiArray(data=np.arange(10.0).tolist())
    message.layout.dim = [MultiArrayDimension(label='b,a', size=2), MultiArrayDimension(size=5)]
    reader = CommandReader(['a', 'b'], 5)
    reader.read(bytes(serialize_message(message)))
    np.testing.assert_array_equal(reader.values, np.arange(10.0).reshape(2, 5)[::-1])
    message.data = [0.0] * 9
    with pytest.raises(InputError, match='data must have 10 elements, got 9'):
        reader.read(bytes(serialize_message(message)))
    message.data = [0.0] * 9 + [float('nan')]
    with pytest.raises(InputError, match='finite'):
        reader.read(bytes(serialize_message(message)))
