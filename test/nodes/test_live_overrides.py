"""Every override of the robot's model can be set while a node runs, and read."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from node_robots import GRAVITY, JOINTS
from remote_parameters import Remote
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.nodes.feedforward import FeedforwardNode
from denoc_ros.nodes.plant import PlantNode
from denoc_ros.nodes.predictor import PredictorNode
from denoc_ros.runtime.live_model import LiveModel

pytestmark = pytest.mark.ros
Q, QD, QDD = [0.4, -0.7], [0.3, 0.2], [1.0, -2.0]


@pytest.fixture
def running(graph: Any, urdf: str) -> Any:
    """Return the parameters of a feedforward that answers each reference, and what asks it."""
    effort = graph.collect(JointState, '/feedforward/effort')
    graph.add(
        FeedforwardNode,
        parameters={
            'urdf_path': urdf,
            'gravity': GRAVITY,
            'model': 'rigid',
            'trigger': 'message',
            'enforce_command_limits': False,
        },
    )
    reference = graph.publisher(JointTrajectory, 'reference')
    stamps = iter(range(1, 1000))

    def torque() -> Any:
        point = JointTrajectoryPoint(positions=Q, velocities=QD, accelerations=QDD)
        message = JointTrajectory(joint_names=JOINTS, points=[point])
        message.header.stamp.sec = next(stamps)
        count = len(effort)
        reference.publish(message)
        graph.until(lambda: len(effort) > count)
        return effort[-1].effort

    return Remote(graph, 'feedforward'), torque


def rigid_torque(urdf: str, **payloads: Any) -> Any:
    """Return inverse dynamics of the robot, undeformed, with payloads set by Robot."""
    robot = load_robot(urdf, gravity=GRAVITY)
    for link, payload in payloads.items():
        robot.set_payload(link, *payload)
    rows = np.zeros((3, robot.n))
    rows[:, robot.joint_indices] = Q, QD, QDD
    return robot.inverse_dynamics(*rows)[robot.joint_indices]


def test_a_payload_set_on_a_running_node_is_in_the_next_torque(running: Any, urdf: str) -> None:
    remote, torque = running
    np.testing.assert_allclose(torque(), rigid_torque(urdf), rtol=1e-12)
    assert remote.get('payload.two.mass') == 0.0
    assert remote.give('payload.two.mass', 2.5) == ''
    assert remote.get('payload.two.mass') == 2.5
    np.testing.assert_allclose(torque(), rigid_torque(urdf, two=(2.5,)), rtol=1e-12)
    assert remote.give('payload.two.com', [0.9, 0.1, 0.0]) == ''
    assert remote.give('payload.two.inertia', [0.1, 0.0, 0.0, 0.2, 0.0, 0.3]) == ''
    assert remote.give('payload.one.mass', 1) == ''
    whole = (2.5, (0.9, 0.1, 0.0), np.diag([0.1, 0.2, 0.3]))
    expected = rigid_torque(urdf, two=whole, one=(1.0,))
    np.testing.assert_allclose(torque(), expected, rtol=1e-12)
    assert np.abs(expected - rigid_torque(urdf)).min() > 1.0


def test_damping_has_two_names_and_one_value(running: Any) -> None:
    remote, torque = running
    before = np.array(torque())
    assert remote.get('damping.j1') == 0.2
    assert remote.give('damping.j1', 1.2) == ''
    assert remote.get('joint.j1.damping') == 1.2
    np.testing.assert_allclose(torque() - before, [QD[0], 0.0], atol=1e-12)
    assert remote.give('joint.j1.damping', 0.2) == ''
    assert remote.get('damping.j1') == 0.2
    np.testing.assert_allclose(torque(), before, rtol=1e-12)
    assert remote.get('damping.one.y') == [0.02, 0.02]
    assert remote.give('damping.one.y', [0.01, 0.03]) == ''
    assert remote.get('beam.one.y.damping_ratio') == [0.01, 0.03]
    # an absolute coefficient says what the ratio then is, and a ratio takes its place
    assert remote.give('beam.one.y.damping', 0.0) == ''
    assert remote.get('damping.one.y') == [0.0, 0.0]
    assert remote.give('damping.one.y', 0.05) == ''
    assert remote.get('beam.one.y.damping_ratio') == 0.05
    assert min(remote.get('beam.one.y.damping')) > 0.1


def test_every_override_is_listed(running: Any) -> None:
    remote, _ = running
    names = remote.names()
    for joint in JOINTS:
        assert {f'joint.{joint}.{field}' for field in ('damping', 'friction', 'armature')} <= names
        assert f'damping.{joint}' in names
    for link in ('one', 'two'):
        assert {f'beam.{link}.y.ei', f'beam.{link}.y.damping_ratio', f'damping.{link}.y'} <= names
        assert {f'payload.{link}.{field}' for field in ('mass', 'com', 'inertia')} <= names
    assert remote.get('beam.one.y.ei') == 300.0


@pytest.mark.parametrize(
    ('name', 'value', 'says'),
    [
        ('payload.two.mass', -1.0, 'must be >= 0 kg, got -1'),
        ('payload.two.mass', [1.0, 2.0], 'must be 1 finite numbers'),
        ('payload.two.com', [1.0], 'must be 3 finite numbers'),
        ('payload.two.inertia', [-1.0, 0.0, 0.0, 1.0, 0.0, 1.0], 'positive semidefinite'),
        ('payload.tool.mass', 1.0, 'must be one that the robot has'),
        ('payload.two.mass', 'heavy', 'must be a double'),
        ('joint.j1.damping', -1.0, 'must be >= 0'),
        ('damping.j9', 1.0, 'must be one that the robot has'),
        ('beam.one.y.ei', 0.0, 'must be > 0'),
        ('beem.one.y.ei', 1.0, 'must be one this node has'),
    ],
)
def test_a_bad_value_changes_nothing(running: Any, name: str, value: Any, says: str) -> None:
    remote, torque = running
    before = torque()
    assert says in remote.give(name, value)
    np.testing.assert_array_equal(torque(), before)
    assert remote.give('payload.two.mass', 0.5) == ''  # nothing of it is left in the way


def test_the_predictor_takes_a_payload_beside_a_change_of_a_beam(graph: Any, urdf: str) -> None:
    node = graph.add(PredictorNode, parameters={'urdf_path': urdf, 'gravity': GRAVITY})
    remote = Remote(graph, 'predictor')
    assert remote.give('beam.one.y.ei', 600.0) == ''
    assert remote.give('payload.two.mass', 2.0) == ''
    graph.until(lambda: not node._changes)
    expected = load_robot(urdf, gravity=GRAVITY).with_overrides({'beam.one.y.ei': 600.0})
    expected.set_payload('two', 2.0)
    sag = node.observer.robot.static_deflection([0.0, 0.0])
    np.testing.assert_allclose(sag, expected.static_deflection([0.0, 0.0]), rtol=1e-12)


def test_what_a_node_shows_can_be_given_to_it(urdf: str) -> None:
    base = load_robot(urdf, gravity=GRAVITY)
    model = LiveModel(base)
    shown = model.values({'damping.two.y': 0.03})
    assert shown['beam.two.y.damping_ratio'] == 0.03
    robot = model.robot(model.values({}))
    states = np.random.default_rng(2).normal(size=(3, base.n))
    np.testing.assert_allclose(
        robot.inverse_dynamics(*states), base.inverse_dynamics(*states), rtol=1e-10
    )


def test_names_given_at_the_start_agree_or_are_refused(graph: Any, urdf: str) -> None:
    given = {'urdf_path': urdf, 'gravity': GRAVITY, 'damping.j1': 0.7}
    node = graph.add(PlantNode, parameters=given)
    assert node.get_parameter('joint.j1.damping').value == 0.7
    assert node.get_parameter('damping.j1').value == 0.7
    bad = graph.add(FeedforwardNode, start=False, parameters={**given, 'joint.j1.damping': 0.8})
    bad.trigger_configure()
    assert "value must be that of 'joint.j1.damping'" in bad.failure
