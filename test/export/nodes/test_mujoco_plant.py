"""The plant node with MuJoCo as its engine."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lockstep_stage import LockstepStage, differences
from node_robots import GRAVITY, two_links
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64, Float64MultiArray, MultiArrayDimension

from denoc_ros.dynamics.robot import load_robot
from denoc_ros.nodes.plant import PlantNode
from denoc_ros.trajectories import SplineTrajectory

pytestmark = pytest.mark.ros
RATES = {'plant': 100.0, 'feedforward': 100.0}
SENSORS = """<sensor name="root" type="strain_gauge" link="one" station="0.05" direction="y"
surface="0.02" gain="2" offset="0.1" noise="0" topic="/root"/>
<sensor name="tip" type="imu" link="two" station="0.4" topic="/imu"/>"""


@pytest.fixture
def urdf(tmp_path: Path) -> str:
    file = tmp_path / 'arm.urdf'
    file.write_text(two_links().replace('</flexibility>', f'{SENSORS}</flexibility>'))
    return str(file)


def parameters(urdf: str, **more: Any) -> dict[str, Any]:
    given = {'urdf_path': urdf, 'gravity': GRAVITY, 'update_rate': 200.0, 'engine': 'mujoco'}
    return {**given, 'segments': 8, 'noise.sensors': False, **more}


def test_it_publishes_what_our_engine_does(graph: Any, urdf: str) -> None:
    states = graph.collect(JointState, '/joint_states')
    modal = graph.collect(JointState, '/plant/true_modal_state')
    tips = graph.collect(JointState, '/plant/true_deflection')
    gauge, imu = graph.collect(Float64, '/root'), graph.collect(Imu, '/imu')
    node = graph.add(PlantNode, parameters=parameters(urdf, start=[0.2, -0.4]))
    graph.until(lambda: min(map(len, (states, modal, tips, gauge, imu))) > 5)
    robot = load_robot(urdf, gravity=GRAVITY)
    q = robot.static_deflection([0.2, -0.4])
    np.testing.assert_allclose(states[-1].position, [0.2, -0.4], atol=1e-12)
    assert tuple(modal[-1].name) == robot.coordinate_names
    np.testing.assert_allclose(modal[-1].position, q, atol=2e-2 * np.abs(q[1:]).max())
    deflection = [robot.tip_deflection(link, q) for link in ('one', 'two')]
    found = np.reshape(tips[-1].position, (2, 6))[:, :3]
    np.testing.assert_allclose(found, deflection, atol=2e-2 * np.abs(deflection).max())
    strain = robot.sensor_values(q)[robot.sensor_names.index('root')]
    assert 2.0 * gauge[-1].data + 0.1 == pytest.approx(strain, rel=0.1)
    assert abs(imu[-1].linear_acceleration.y) > 1.0  # it holds the link against gravity
    command = Float64MultiArray(data=[3.0, 30.0])
    command.layout.dim = [MultiArrayDimension(label='j2,j1', size=2)]
    publisher = graph.publisher(Float64MultiArray, '/feedforward/commands')
    publisher.publish(command)
    graph.until(lambda: node.command_input.accepted == 1)
    graph.until(lambda: abs(states[-1].position[0] - 0.2) > 1e-3)
    assert list(states[-1].effort) == [30.0, 3.0]


def test_a_payload_bends_it_while_it_runs_and_reset_brings_it_back(graph: Any, urdf: str) -> None:
    modal = graph.collect(JointState, '/plant/true_modal_state')
    damped = {'damping.one.y': 0.5, 'damping.two.y': 0.5}
    node = graph.add(PlantNode, parameters=parameters(urdf, **damped))
    graph.until(lambda: len(modal) > 5)
    start = np.array(modal[-1].position)
    (result,) = node.set_parameters([Parameter('payload.two.mass', value=2.0)])
    assert result.successful, result.reason
    robot = load_robot(urdf, gravity=GRAVITY)
    robot.set_payload('two', 2.0)
    loaded = robot.static_deflection([0.0, 0.0])
    gap = np.abs(loaded - start).max()
    graph.until(lambda: np.abs(np.array(modal[-1].position) - start).max() > 0.8 * gap)
    assert 'back at the start' in node._reset()
    graph.until(lambda: np.abs(np.array(modal[-1].position) - node.start).max() < 1e-6)


def refusal(graph: Any, given: dict[str, Any]) -> str:
    node = graph.add(PlantNode, start=False, parameters=given)
    with pytest.raises(Exception) as caught:  # noqa: PT011
        node.configure()
    return str(caught.value)


def test_what_it_cannot_do_is_refused(
    graph: Any, urdf: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = refusal(graph, parameters(urdf, shape='craig-bampton'))
    assert "'modes' and 'shape' must be 0 and '' where 'engine' is mujoco" in found
    ours = {**parameters(urdf), 'engine': 'denoc', 'segments': 0}
    assert "'scene' must be empty where 'engine' is denoc" in refusal(
        graph, {**ours, 'scene': 'wall.xml'}
    )
    found = refusal(graph, parameters(urdf, geometric_stiffness=False))
    assert "'geometric_stiffness' must be true where 'engine' is mujoco" in found
    found = refusal(graph, parameters(urdf, scene='gone.xml'))
    assert 'gone.xml: the file must be readable' in found
    monkeypatch.setitem(sys.modules, 'mujoco', None)
    assert "MuJoCo must be installed (pip install 'denoc_ros[mujoco]')" in refusal(
        graph, parameters(urdf)
    )


@pytest.mark.long
def test_two_runs_in_lockstep_give_the_same_bag(urdf: str, tmp_path: Path) -> None:
    motion = SplineTrajectory(
        np.array([0.0, 0.5]), np.array([[0.0, 0.0], [0.3, -0.2]]), *np.zeros((2, 2, 2))
    )
    runs = []
    for name in ('one', 'other'):
        given: dict[str, dict[str, Any]] = {node: {'gravity': list(GRAVITY)} for node in RATES}
        given['plant'].update({'engine': 'mujoco', 'noise.position': 1e-5, 'seed': 7})
        with LockstepStage(tmp_path / name, urdf, RATES, given) as stage:
            stage.go_to(0.5)
            stage.follow(('j1', 'j2'), motion, 0.6)
            stage.go_to(1.3)
            runs.append(stage.finish())
    assert differences(*runs) == {}
    assert len(runs[0]['/joint_states']) == 130
