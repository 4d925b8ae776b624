"""The shortest motions from rest to rest: against closed forms, within limits, past waypoints."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from control_runs import ROBOTS
from ipopt_rest import Beams, RestBeams
from planar_chains import FLEXIBLE, planar_chain
from scipy.optimize import brentq
from shaped_runs import cycloid, swing_after

import denoc_ros as dn
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.planning.rest.rest_to_rest import rest_to_rest

HUB = 0.1  # kg m^2
EFFORT = 4.0  # N m
ARM = f"""
<robot name="one_link">
  <link name="base"/>
  <link name="hub">
    <inertial><mass value="1"/>
      <inertia ixx="1" iyy="1" izz="{HUB}" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="arm">
    <inertial><origin xyz="0.5 0 0"/><mass value="1"/>
      <inertia ixx="1e-6" iyy="0.083333" izz="0.083333" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="hub"/><axis xyz="0 0 1"/>
    <limit lower="-7" upper="7" velocity="100" effort="{EFFORT}"/>
  </joint>
  <joint name="grasp" type="fixed"><parent link="hub"/><child link="arm"/></joint>
  <link name="tool"/>
  <joint name="end" type="fixed">
    <parent link="arm"/><child link="tool"/><origin xyz="1 0 0"/>
  </joint>
  <flexibility>
    <beam link="arm" length="1" shape="clamped-free">
      <bending direction="y" ei="40" modes="1" damping_ratio="0"/>
    </beam>
  </flexibility>
</robot>
"""
T = np.linspace(0.0, 2.0, 41)


def one_link() -> Robot:
    return dn.load_robot(ARM, gravity=(0, 0, 0))


def ask(way: float = 0.5, **options: Any) -> dn.Plan:
    q = (way * (T / T[-1]))[:, None]
    return dn.shape_motion(one_link(), T, q, 'rest_to_rest', time='minimum', **options)


def bang_bang(robot: Robot, way: float) -> float:
    """Return the duration of the closed form: torque +, -, +, - with switches odd in time.

    About the middle the switches are at -s, 0 and s and the ends at -h and h. The rigid motion
    arrives where h^2 - 2 s^2 = way I / u, the mode of frequency w rests where
    cos w h - 2 cos w s + 1 = 0 (Singh, Kabamba and McClamroch, 1989).
    """
    still = np.zeros(2)
    inertia = robot.inertia_matrix(still)
    stiffness = robot.inverse_dynamics(np.array([0.0, 1e-5]), still, still)[1] / 1e-5
    w = np.sqrt(stiffness * inertia[0, 0] / np.linalg.det(inertia))
    turn = way * inertia[0, 0] / EFFORT

    def ringing(h: float) -> float:
        return float(np.cos(w * h) - 2.0 * np.cos(w * np.sqrt((h * h - turn) / 2.0)) + 1.0)

    h = np.sqrt(turn) * np.linspace(1.0 + 1e-9, 1.5, 20001)
    signs = np.sign([ringing(each) for each in h])
    first = int(np.flatnonzero(signs[1:] != signs[:-1])[0])
    return 2.0 * float(brentq(ringing, h[first], h[first + 1]))


@pytest.mark.parametrize('way', [0.2, 1.0])
def test_one_link_is_as_fast_as_the_bang_bang_of_its_closed_form(way: float) -> None:
    robot = one_link()
    motion = rest_to_rest(robot, [0.0], [way])
    assert motion.duration == pytest.approx(bang_bang(robot, way), rel=0.005)
    assert motion.left < 1e-3


def test_one_link_is_as_fast_as_by_ipopt() -> None:
    peer = Beams(1, FLEXIBLE.length, FLEXIBLE.mass, FLEXIBLE.ei, armature=0.2)
    robot = dn.load_robot(planar_chain((FLEXIBLE,)), gravity=(0, 0, 0))
    robot = robot.with_overrides({'joint.joint_1.armature': peer.armature})
    state = np.random.default_rng(1).uniform(-0.3, 0.3, (3, robot.n))
    forces = np.array(peer.forces()(*state))[:, 0]
    np.testing.assert_allclose(forces, robot.inverse_dynamics(*state), rtol=1e-6, atol=1e-6)
    least = RestBeams(peer, np.zeros(1), np.array([0.2]), np.array([100.0]), 2).shortest(0.15, 16)
    plan = dn.shape_motion(
        robot, [0.0, 1.0], [[0.0], [0.2]], 'rest_to_rest', time='minimum', effort=100.0, modes=2
    )
    assert plan.t[-1] == pytest.approx(least, rel=0.005)
    assert plan.limits is not None
    assert plan.limits.binding().count('') < 0.15 * len(plan.t)  # a limit binds all the time


@pytest.mark.long
def test_light_joints_of_a_long_arm_keep_a_limit_at_its_bound(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A torque that is off by 1 % takes its wrist by radians: no search got anywhere there."""
    monkeypatch.setattr('denoc_ros.planning.rest.rest_to_rest.UNKNOWNS', 120)
    monkeypatch.setattr('denoc_ros.planning.rest.rest_to_rest.LEAST_FINE', 20)
    text = (ROBOTS / 'ssrms.urdf').read_text().replace('craig-bampton', 'clamped-free')
    text = re.sub(r'<bending direction="y"[^>]*/>', '', text.replace('modes="2"', 'modes="1"'))
    robot = dn.load_robot(text, gravity=(0, 0, 0))
    first = np.array([0.2, 0.5, -0.9, 0.4, 0.3, 0.2])
    effort = [1000.0, 1000.0, 1000.0, 200.0, 200.0, 200.0]
    plan = dn.shape_motion(
        robot, [0, 9], [first, first + 0.5], 'rest_to_rest', time='minimum', effort=effort
    )
    assert plan.limits is not None
    assert max(plan.limits.largest.values()) <= 1.001
    assert plan.limits.binding().count('') < 0.15 * len(plan.t)
    assert plan.t[-1] < 7.7  # 7.90 s where states were no unknowns
    joints = robot.joint_indices
    assert not plan.qd[[0, -1]][:, joints].any()
    np.testing.assert_allclose(plan.q[-1, joints], first + 0.5, atol=1e-9)
    t = np.linspace(0.0, plan.t[-1], 201)
    plain = first + 0.5 * cycloid(t, t[-1])[:, None]
    left = swing_after(robot, plan.t, plan.q[:, joints], 'tool')
    assert left < 0.02 * swing_after(robot, t, plain, 'tool')


def test_limits_hold_on_the_flexible_motion_and_nothing_rings() -> None:
    plan = ask(effort_rate=400.0, moment=1.5, tip_acceleration=30.0, power=8.0, jerk=4e3)
    assert plan.limits is not None
    assert plan.limits.settled
    assert max(plan.limits.largest.values()) <= 1.001
    assert {name.split()[0] for name in set(plan.limits.binding()) if name}
    assert any(gain > 0.0 for gain in plan.limits.gains.values())
    still = np.array([plan.q[0, :1], plan.q[-1, :1]])
    plain = still[0] + (still[1] - still[0]) * cycloid(plan.t, plan.t[-1])[:, None]
    swings = [swing_after(one_link(), plan.t, q, 'tool') for q in (plan.q[:, :1], plain)]
    assert swings[0] < 0.02 * swings[1]


@pytest.mark.long
def test_the_plan_of_two_links_does_what_the_search_found() -> None:
    robot = dn.load_robot('config/robots/two_link_ff.urdf', gravity=(0, 0, 0))
    ends = np.array([[0.0, 0.0], [0.5, 0.5]])
    plan = dn.shape_motion(robot, [0.0, 0.6], ends, 'rest_to_rest', time='minimum')
    assert plan.limits is not None
    assert plan.t[-1] <= 0.336  # 0.346 s with accelerations that are linear over its 120th
    assert max(plan.limits.largest.values()) <= 1.001
    t = np.linspace(0.0, plan.t[-1], 201)
    plain = ends[0] + (ends[1] - ends[0]) * cycloid(t, t[-1])[:, None]
    joints = robot.joint_indices
    assert not plan.qd[[0, -1]][:, joints].any()
    assert not plan.qdd[[0, -1]][:, joints].any()
    # two of four modes rest by default: the others swing by little
    left = swing_after(robot, plan.t, plan.q[:, joints], 'tool', step=1e-4)
    assert left < 0.05 * swing_after(robot, t, plain, 'tool')


def test_margin_keeps_room_and_uncertainty_says_how_much_is_used() -> None:
    plan = ask(moment=1.5, uncertainty=0.2)
    assert plan.limits is not None
    spread = plan.limits.spread
    assert spread['moment arm'] > 1.02
    with_room = ask(moment=1.5, uncertainty=0.2, margin=0.2)
    assert with_room.limits is not None
    assert with_room.t[-1] > plan.t[-1]
    # shares are of the limits less their margin
    assert 0.8 * with_room.limits.spread['moment arm'] < spread['moment arm']


@pytest.mark.long
def test_waypoints_are_passed_within_their_radius() -> None:
    robot = dn.load_robot('config/robots/two_link_ff.urdf', gravity=(0, 0, 0))
    q = np.linspace([0.0, 0.0], [0.5, 0.5], 41)
    via = np.array([[0.6, 0.6]])
    undeformed = np.zeros(robot.n)
    undeformed[robot.joint_indices] = via[0]
    goal = robot.frame_pose('tool', undeformed)[:3, 3]

    def nearest(**options: Any) -> float:
        plan = dn.shape_motion(
            robot, T, q, 'rest_to_rest', time='minimum', acceleration=20.0, **options
        )
        tips = robot.frame_pose('tool', plan.q)[:, :3, 3]
        return float(np.linalg.norm(tips - goal, axis=1).min())

    assert nearest() > 0.1
    assert nearest(waypoints=via, radius=0.05) <= 0.051


def test_points_between_are_waypoints_where_there_is_a_radius() -> None:
    robot = dn.load_robot('config/robots/two_link_ff.urdf', gravity=(0, 0, 0))
    points = np.array([[0.0, 0.0], [0.6, 0.6], [0.5, 0.5]])
    t = np.array([0.0, 1.0, 2.0])
    given: dict[str, Any] = {'robustness': 0.0, 'radius': 0.02}
    plan = dn.shape_motion(robot, t, points, 'rest_to_rest', **given)
    same = dn.shape_motion(
        robot, t[::2], points[::2], 'rest_to_rest', waypoints=points[1:2], duration=2.0, **given
    )
    np.testing.assert_allclose(plan.q, same.q, atol=1e-9)
    assert plan.limits is not None
    assert not any(plan.limits.gains.values())  # of the time, which was given


@pytest.mark.parametrize(
    ('options', 'error', 'words'),
    [
        ({'effort': 0.0}, StateError, 'effort must be > 0, got'),
        ({'effort': np.nan}, StateError, 'effort must be > 0, got'),
        ({'moment': 0.0}, StateError, 'moment must be a number > 0, got 0.0'),
        ({'tip_speed': np.nan}, StateError, 'tip_speed must be a number > 0 m/s, got nan'),
        ({'margin': 1.0}, StateError, 'margin must be >= 0 and < 1, got 1.0'),
        ({'uncertainty': 1.0}, StateError, 'uncertainty must be >= 0 and < 1, got 1.0'),
        ({'duration': 1.0}, StateError, "duration must not come with time='minimum'"),
        ({'robustness': 0.1}, StateError, 'robustness must be 0 in the shortest motion, got 0.1'),
        ({'waypoints': [[9.0]], 'radius': 0.1}, StateError, r'waypoint 1 must be within \[-7'),
        ({'waypoints': [[0.1]]}, StateError, 'radius of waypoints must be > 0 m, got None'),
        ({'radius': 0.1}, StateError, 'waypoints must be 20 at most, got 39'),
        ({'waypoints': [[np.nan]], 'radius': 0.1}, StateError, 'waypoints must be finite, got'),
        ({'waypoints': [0.1], 'radius': 0.1}, StateError, 'waypoints must be rows of 1 numbers'),
        ({'way': 8.0}, StateError, 'end must be within'),
        ({'way': 0.0}, StateError, 'needs a way to go and limits'),
    ],
)
def test_what_cannot_be_is_named(options: dict[str, Any], error: type, words: str) -> None:
    with pytest.raises(error, match=words):
        ask(**options)


def test_limits_that_contradict_are_named() -> None:
    robot = dn.load_robot(ARM, gravity=(0, -9.81, 0))
    q = np.linspace([0.0], [0.5], 41)
    with pytest.raises(SolverError, match='arm must keep its limit of moment at rest, got'):
        dn.shape_motion(robot, T, q, 'rest_to_rest', time='minimum', effort=20.0, moment=0.1)
    with pytest.raises(SolverError, match="effort of 'shoulder' must hold the start posture"):
        dn.shape_motion(robot, T, q, 'rest_to_rest', time='minimum', effort=1.0)


def test_the_best_motion_so_far_is_returned_where_the_search_is_ended() -> None:
    asked = iter([False] * 4)
    plan = ask(cancel=lambda: next(asked, True))
    assert plan.limits is not None
    assert not plan.limits.settled
    assert max(plan.limits.largest.values()) <= 1.001
    assert plan.t[-1] > ask().t[-1]
