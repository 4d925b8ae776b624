"""Laws of the fixed step for robots with mimic joints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio
import pytest

import denoc_ros as dn
from denoc_ros.dynamics.stepper import with_joint_feedback
from denoc_ros.types import Array

ROBOTS = Path(pinocchio.__file__).parents[4] / 'share' / 'example-robot-data' / 'robots'
PANDA = ROBOTS / 'panda_description' / 'urdf' / 'panda.urdf'
FINGER = """
<link name="{name}"><inertial><origin xyz="0.1 0 0"/><mass value="0.4"/>
<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial></link>
<joint name="{name}_joint" type="revolute"><parent link="arm"/><child link="{name}"/>
<origin xyz="0.8 {side} 0"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="9" velocity="9"/>
<dynamics damping="{damping}" friction="0.002"/>{mimic}</joint>"""


def gripper() -> dn.Robot:
    """Return a flexible arm with three fingers: one leads, a chain of two follows it."""
    fingers = (
        FINGER.format(name='left', side=0.05, damping=0.01, mimic='')
        + FINGER.format(
            name='right',
            side=-0.05,
            damping=0.02,
            mimic='<mimic joint="left_joint" multiplier="-1.5" offset="0.2"/>',
        )
        + FINGER.format(
            name='third',
            side=0.0,
            damping=0.0,
            mimic='<mimic joint="right_joint" multiplier="0.5" offset="-0.1"/>',
        )
    )
    arm = (
        '<link name="base"/><link name="arm"><inertial><origin xyz="0.4 0 0"/>'
        '<mass value="1"/><inertia ixx="1e-3" ixy="0" ixz="0" iyy="0.06" iyz="0" izz="0.06"/>'
        '</inertial></link><joint name="shoulder" type="revolute"><parent link="base"/>'
        '<child link="arm"/><axis xyz="0 0 1"/>'
        '<limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
    )
    beam = (
        '<flexibility><beam link="arm" length="0.8">'
        '<bending direction="y" ei="20" modes="2" damping_ratio="0.02"/></beam></flexibility>'
    )
    text = f'<robot name="gripper">{arm}{fingers}{beam}</robot>'
    return dn.load_robot(text, gravity=(0.0, -9.81, 0.0))


def tied(robot: dn.Robot, q: Array) -> float:
    """Return the largest violation of the gripper's constraints."""
    left, right, third = (
        q[robot.coordinate_names.index(f'{name}_joint')] for name in ('left', 'right', 'third')
    )
    return float(max(abs(right - (-1.5 * left + 0.2)), abs(third - (0.5 * right - 0.1))))


def start(robot: dn.Robot) -> Array:
    q = np.zeros(robot.n)
    q[robot.joint_indices] = [-0.5, 0.3, -1.5 * 0.3 + 0.2, 0.5 * (-1.5 * 0.3 + 0.2) - 0.1]
    return q


def march(stepper: dn.Stepper, end: float, q: Array, qd: Array, tau: Array) -> tuple[Array, Array]:
    q, qd = q.copy(), qd.copy()
    for _ in range(round(end / stepper.step)):
        stepper.free(q, qd, tau)
    return q, qd


def test_free_step_converges_with_order_two_on_the_ties() -> None:
    robot = gripper()
    q0, rest, tau = start(robot), np.zeros(robot.n), np.zeros(robot.n)
    tau[robot.joint_indices] = [3.0, 0.2, 0.1, -0.05]
    exact = dn.simulate(
        robot, q0, rest, np.array([0.0, 0.1]), torque=lambda *_: tau, rtol=1e-11
    ).q[-1]
    errors = []
    for step in (4e-4, 2e-4, 1e-4):
        q, _ = march(dn.Stepper(robot.copy(), step), 0.1, q0, rest, tau)
        assert tied(robot, q) < 1e-12
        errors.append(np.max(np.abs(q - exact)))
    assert np.all(np.log2(np.array(errors[:-1]) / errors[1:]) > 1.8), errors
    assert errors[-1] < 1e-5
    assert np.max(np.abs(exact - q0)) > 0.02


def test_a_hand_moves_as_the_adaptive_integrator_says() -> None:
    robot = dn.load_robot(PANDA)
    fingers = [robot.joint_names.index(f'panda_finger_joint{k}') for k in (1, 2)]
    q0, rest = np.zeros(robot.n), np.zeros(robot.n)
    q0[robot.joint_indices[:7]] = [0.0, -0.4, 0.2, -1.8, 0.1, 1.5, 0.3]
    q0[fingers] = 0.02
    tau = np.zeros(robot.n)
    tau[fingers[0]] = 0.05
    exact = dn.simulate(robot, q0, rest, np.array([0.0, 0.2]), torque=lambda *_: tau, rtol=1e-10)
    errors = []
    for step in (2e-3, 1e-3):
        q, qd = march(dn.Stepper(robot.copy(), step), 0.2, q0, rest, tau)
        assert abs(q[fingers[1]] - q[fingers[0]]) < 1e-12
        assert abs(qd[fingers[1]] - qd[fingers[0]]) < 1e-12
        errors.append(np.max(np.abs(q - exact.q[-1])))
    assert np.log2(errors[0] / errors[1]) > 1.8, errors
    assert errors[-1] < 1e-5


def test_stiff_feedback_on_a_leader_stays_stable() -> None:
    robot = gripper()
    leaders = robot.joint_indices[:2]
    stiff = with_joint_feedback(robot, leaders, 1e6, 1e4)
    q, rest = start(robot), np.zeros(robot.n)
    tau = np.zeros(robot.n)
    tau[leaders] = 1e6 * q[leaders]
    q, _ = march(dn.Stepper(stiff, 2e-3), 1.0, q, rest, tau)
    np.testing.assert_allclose(q[leaders], [-0.5, 0.3], atol=1e-4)
    assert tied(robot, q) < 1e-12


def test_driven_joints_keep_their_ties() -> None:
    robot = gripper()
    stepper = dn.Stepper(robot, 1e-3)
    q, qd = start(robot), np.zeros(robot.n)
    for _ in range(1000):
        stepper.driven(q, qd, np.array([0.1, 0.4, -0.6, -0.3]))
    assert tied(robot, q) < 1e-12
    left = robot.coordinate_names.index('left_joint')
    assert q[left] == pytest.approx(0.3 + 0.2, abs=1e-12)


def test_state_is_untouched_by_a_step_that_is_refused() -> None:
    robot = gripper()
    q, qd = start(robot), np.zeros(robot.n)
    for tau in (np.full(robot.n, np.nan), np.zeros(robot.n - 1)):
        with pytest.raises(dn.StateError, match='must be'):
            dn.Stepper(robot, 1e-3).free(q, qd, tau)
        np.testing.assert_array_equal(q, start(robot))
