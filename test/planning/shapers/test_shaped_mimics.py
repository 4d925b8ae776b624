"""Input shapers and rest to rest on a robot with a mimic joint: its driven joints are planned."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from shaped_runs import cycloid, swing_after

import denoc_ros as dn
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError

T = np.linspace(0.0, 0.8, 101)
# the wrist keeps the gripper level; what a message says of a follower does not count
Q = np.column_stack((cycloid(T, 0.8)[:, None] * [0.5, 0.8], np.full(len(T), 7.0)))
PLAIN = np.column_stack((Q[:, :2], -Q[:, 1]))
WRIST = """
<link name="gripper"><inertial><origin xyz="0.1 0 0"/><mass value="1.5"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.03"/></inertial></link>
<joint name="wrist" type="revolute"><parent link="link_2"/><child link="gripper"/>
<origin xyz="1 0 0"/><axis xyz="0 0 1"/>
<limit lower="-9" upper="9" velocity="50" effort="1"/>
<mimic joint="joint_2" multiplier="-1"/></joint>
"""


@cache
def levelled() -> Robot:
    """Return two flexible links whose gripper turns back by as much as the elbow turns."""
    text = Path('config/robots/two_link_ff.urdf').read_text()
    return dn.load_robot(text.replace('<flexibility', WRIST + '<flexibility', 1), (0, -9.81, 0))


@pytest.mark.long_cases('rest_to_rest')
@pytest.mark.parametrize('method', ['zv', 'zvd', 'ei', 'rest_to_rest'])
def test_followers_follow_and_their_torque_is_the_leaders(method: str) -> None:
    robot = levelled()
    plan = dn.shape_motion(robot, T, Q, method, 'gripper', effort=400.0)
    joints = robot.joint_indices
    assert plan.joint_names == ('joint_1', 'joint_2')
    for rows in (plan.q, plan.qd, plan.qdd):
        np.testing.assert_allclose(rows[:, joints[2]], -rows[:, joints[1]], atol=1e-9)
    np.testing.assert_allclose(plan.q[-1, joints], PLAIN[-1], atol=1e-6)
    torque, _ = robot.constrained_inverse_dynamics(plan.q, plan.qd, plan.qdd)
    np.testing.assert_allclose(plan.torque, torque, atol=1e-6 * np.abs(torque).max())
    left = swing_after(robot, plan.t, plan.q[:, joints], 'gripper')
    assert left < 0.08 * swing_after(robot, T, PLAIN, 'gripper')


@pytest.mark.long
def test_limits_count_a_followers_torque_as_its_leaders() -> None:
    robot = levelled()

    def peak(method: str, share: float, of: float) -> float:
        limits = {'joint_1': 400.0, 'joint_2': share * of}
        plan = dn.shape_motion(robot, T, Q, method, effort=limits)
        return float(np.abs(plan.torque[:, 1]).max())

    free = peak('rest_to_rest', 1.0, 400.0)
    assert peak('rest_to_rest', 0.8, free) <= 1.01 * 0.8 * free
    shaped = peak('zv', 1.0, 400.0)
    with pytest.raises(SolverError, match="times the effort limit of 'joint_2'"):
        peak('zv', 0.9, shaped)


@pytest.mark.parametrize('method', ['zv', 'zvd'])
def test_followers_need_no_column(method: str) -> None:
    robot = levelled()
    whole = dn.shape_motion(robot, T, PLAIN, method, 'gripper', effort=400.0)
    driven = dn.shape_motion(robot, T, PLAIN[:, :2], method, 'gripper', effort=400.0)
    np.testing.assert_allclose(driven.q, whole.q, atol=1e-12)
    with pytest.raises(StateError, match=r"\(101, 2\) \(times, driven joints \['joint_1', 'jo"):
        dn.shape_motion(robot, T, PLAIN[:, :1], method, 'gripper')
