"""The shaper on robots of which some joints follow others: mimic joints and loops."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from node_robots import GRAVITY, gripper
from shaped_runs import cycloid, swing_after
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

import denoc_ros as dn
from denoc_ros.dynamics.base.reacting_base import held_robot
from denoc_ros.dynamics.driven.driven_joints import all_joints
from denoc_ros.dynamics.equilibrium import Equilibrium
from denoc_ros.planning.shaper import ShaperNode

pytestmark = pytest.mark.ros
DRIVEN = ['j1', 'j2', 'left']
FIVE_BAR = {
    'urdf_path': 'config/robots/five_bar_ffff.urdf',
    'gravity': [0.0, -9.81, 0.0],
    'posture': np.radians([108.0, -72.0, 72.0, 72.0]).tolist(),
    'joints': ['joint_1', 'joint_3'],
}


def shaped(graph: Any, node: ShaperNode, names: list[str], t: Any, q: Any) -> Any:
    """Return times and positions of what comes out for a motion."""
    out = graph.collect(JointTrajectory, 'reference')
    sender = graph.publisher(JointTrajectory, 'shaper/input')
    graph.until(lambda: node._reference.get_subscription_count() > 0)
    message = JointTrajectory(joint_names=names)
    for when, row in zip(t, q.tolist(), strict=True):
        point = JointTrajectoryPoint(positions=row)
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(round(1e9 * when), 10**9)
        message.points.append(point)
    sender.publish(message)
    graph.until(lambda: out or node.input.rejected['not_shaped'])
    (plan,) = out or pytest.fail(str(node.input.last_message))
    assert list(plan.joint_names) == names
    since = [point.time_from_start for point in plan.points]
    times = np.array([each.sec + 1e-9 * each.nanosec for each in since])
    return times, np.array([point.positions for point in plan.points])


def test_arm_with_a_gripper_moves_without_swing(graph: Any, tmp_path: Any) -> None:
    urdf = tmp_path / 'gripper.urdf'
    urdf.write_text(gripper())
    robot = dn.load_robot(urdf, gravity=tuple(GRAVITY))
    given = {'urdf_path': str(urdf), 'gravity': GRAVITY, 'limits.effort': [500.0, 500.0, 50.0]}
    node = graph.add(ShaperNode, parameters={**given, 'method': 'zvd'})
    assert node.joints == DRIVEN
    t = np.linspace(0.0, 0.6, 61)
    q = cycloid(t, 0.6)[:, None] * [0.4, -0.3, 0.5]
    times, rows = shaped(graph, node, DRIVEN, t, q)
    np.testing.assert_allclose(rows[-1], q[-1], atol=1e-6)
    left, plain = (
        swing_after(robot, at, all_joints(robot, DRIVEN, each), 'left_finger', 1.0)
        for at, each in ((times, rows), (t, q))
    )
    assert left < 0.1 * plain


def test_mechanism_brings_its_pin_where_it_should_be(graph: Any) -> None:
    node = graph.add(ShaperNode, parameters={**FIVE_BAR, 'tip': 'joint_5/parent'})
    assert node.joints == FIVE_BAR['joints']
    t = np.linspace(0.0, 2.0, 101)
    q = np.radians([108.0, 72.0]) + cycloid(t, 2.0)[:, None] * [0.2, -0.1]
    times, rows = shaped(graph, node, node.joints, t, q)
    assert times[-1] >= 2.0
    robot = dn.load_robot(FIVE_BAR['urdf_path'], gravity=(0, -9.81, 0))
    posture = node.posture(robot, node.settings)
    driven = robot.indices(node.joints)
    asked, ends = (all_joints(robot, node.joints, each, posture) for each in (q, rows))
    for row in (0, -1):
        wanted, resting = np.zeros((2, robot.n))
        wanted[robot.joint_indices] = asked[row]
        resting[robot.joint_indices] = ends[row]
        # the links sag: only other joints bring the pin where straight links would have it
        assert np.abs(ends[row] - asked[row]).max() > 1e-5
        Equilibrium(robot, np.setdiff1d(np.arange(robot.n), driven)).find(resting)
        pin, goal = (robot.frame_pose('joint_5/parent', each)[:3, 3] for each in (resting, wanted))
        assert np.linalg.norm(pin - goal) < 1e-4


def test_what_a_mechanism_cannot_have_is_refused(graph: Any) -> None:
    for change, words in (
        ({'method': 'zv'}, "method zv needs a robot without loops, got the loops ['joint_5']"),
        ({'joints': []}, "parameter 'joints' must name the driven joints of a robot with loops"),
        ({'limits.velocity': [1.0] * 3}, 'one for each of 2 joints, got 3'),
    ):
        node = graph.add(ShaperNode, start=False, parameters={**FIVE_BAR, **change})
        node.trigger_configure()
        assert words in node.failure
        graph.remove(node)


def test_all_joints_of_a_tree_are_planned(graph: Any, tmp_path: Any) -> None:
    urdf = tmp_path / 'gripper.urdf'
    urdf.write_text(gripper())
    node = graph.add(ShaperNode, start=False, urdf_path=str(urdf), joints=['j1', 'j2'])
    node.trigger_configure()
    assert "must name all joints of a robot without loops, ['j1', 'j2', 'left']" in node.failure


@pytest.mark.parametrize('base', ['free_floating', 'free_flying'])
def test_arm_on_a_spacecraft_is_planned_with_its_base(graph: Any, base: str) -> None:
    """The node's plan is the one that `shape_motion` makes of the same motion."""
    urdf = 'config/robots/canadarm_10t.urdf'
    gravity = [0.0, 0.0, 0.0]
    parameters = {'urdf_path': urdf, 'gravity': gravity, 'method': 'tip', 'base': base}
    node = graph.add(ShaperNode, parameters=parameters)
    t = np.linspace(0.0, 6.0, 121)
    q = np.array([0.2, 0.7, 0.5]) + cycloid(t, 6.0)[:, None] * [0.3, 0.1, 0.05]
    times, rows = shaped(graph, node, node.joints, t, q)
    robot = dn.load_robot(urdf, gravity=tuple(gravity))
    plan = dn.shape_motion(robot, t, q, base=base, output_step=0.01)
    assert times[-1] - times[0] == pytest.approx(plan.t[-1] - plan.t[0], abs=1e-6)
    wanted = plan.q[:, robot.joint_indices]
    apart = [np.interp(times, plan.t - plan.t[0], column) for column in wanted.T]
    np.testing.assert_allclose(rows, np.transpose(apart), atol=1e-6)
    other = 'free_flying' if base == 'free_floating' else 'free_floating'
    elsewhere = dn.shape_motion(robot, t, q, base=other, output_step=0.01)
    joints = elsewhere.q[:, robot.joint_indices].T
    fourth = [np.interp(4.0, elsewhere.t, column) for column in joints]  # s, while it moves
    ours = [np.interp(4.0, times + plan.t[0], column) for column in rows.T]
    assert np.abs(np.subtract(fourth, ours)).max() > 1e-4


@pytest.mark.parametrize('base', ['free_floating', 'free_flying'])
def test_stream_of_an_arm_on_a_spacecraft_has_its_modes(graph: Any, base: str) -> None:
    urdf = 'config/robots/canadarm_10t.urdf'
    given = {'urdf_path': urdf, 'gravity': [0.0, 0.0, -9.81], 'method': 'zv', 'base': base}
    node = graph.add(ShaperNode, parameters={**given, 'limits.effort': [1e6]})
    modes = node._modes(np.array([0.2, 0.7, 0.5]), node.settings)
    robot = dn.load_robot(urdf, gravity=(0, 0, -9.81))
    known = held_robot(robot) if base == 'free_flying' else robot
    posture = known.static_deflection([0.2, 0.7, 0.5]) if base == 'free_flying' else None
    if posture is None:
        posture = np.zeros(known.n)
        posture[known.joint_indices] = [0.2, 0.7, 0.5]
    found = known.natural_frequencies(posture)
    lowest = found[found > 1e-3][0]
    assert modes.frequencies[0] == pytest.approx(lowest, rel=1e-3)
