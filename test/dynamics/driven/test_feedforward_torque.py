"""Torque feedforward against the verbs of the dynamics and against the robot it drives."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from control_runs import ROBOTS
from node_robots import two_links
from scipy.integrate import cumulative_simpson

from denoc_ros.dynamics.driven.torque_feedforward import Terms, TorqueFeedforward
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.errors import SolverError, StateError
from denoc_ros.kernels.jit.handle import DAMPING, FRICTION
from denoc_ros.model.joint_friction import SLIP_RATE
from denoc_ros.trajectories import CycloidalTrajectory

LINK = """
<link name="{link}"><inertial><origin xyz="1 0 0"/><mass value="6"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="2.01" iyz="0" izz="2.01"/></inertial></link>
<joint name="{joint}" type="revolute"><parent link="{parent}"/><child link="{link}"/>
<origin xyz="{x} 0 0"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="500" velocity="9"/>
<dynamics damping="0.7" friction="0.4"/>{mimic}</joint>"""
FLEXIBILITY = """<flexibility>
<beam link="one" length="2" shape="clamped-free">
<bending direction="y" ei="900" modes="2" damping_ratio="0.01"/></beam>
<beam link="two" length="2" shape="clamped-free">
<bending direction="y" ei="900" modes="2" damping_ratio="0.01"/></beam>
</flexibility>"""


def arm(flexible: bool = True, mimic: bool = False, ei: float = 900.0) -> Robot:
    """Two links in a vertical plane with damping and friction in their joints."""
    constraint = '<mimic joint="j1" multiplier="-2" offset="0.1"/>' if mimic else ''
    links = LINK.format(link='one', joint='j1', parent='base', x=0, mimic='')
    links += LINK.format(link='two', joint='j2', parent='one', x=2, mimic=constraint)
    block = FLEXIBILITY.replace('900', str(ei)) if flexible else ''
    return load_robot(
        f'<robot name="arm"><link name="base"/>{links}{block}</robot>', gravity=(0, -9.81, 0)
    )


Q, QD, QDD = np.array([0.3, -0.5]), np.array([0.4, 0.9]), np.array([-1.0, 2.0])


def state(robot: Robot, *joints: Any) -> list[Any]:
    full = [np.zeros(robot.n) for _ in joints]
    for whole, part in zip(full, joints, strict=True):
        whole[robot.joint_indices] = part
    return full


@pytest.mark.parametrize('flexible', [False, True])
def test_rigid_torque_is_inverse_dynamics_undeformed(flexible: bool) -> None:
    robot = arm(flexible)
    expected = robot.inverse_dynamics(*state(robot, Q, QD, QDD))[robot.joint_indices]
    torque = TorqueFeedforward(robot, model='rigid').update(Q, QD, QDD, 0.0)
    np.testing.assert_array_equal(torque, expected)


@pytest.mark.parametrize('model', ['rigid', 'quasi_static'])
def test_each_switch_takes_out_its_own_term(model: str) -> None:
    robot = arm()
    full = TorqueFeedforward(robot, model=model)
    whole = full.update(Q, QD, QDD, 0.0).copy()
    q, qd, qdd, zero = full.q.copy(), full.qd.copy(), full.qdd.copy(), np.zeros(robot.n)
    index = robot.joint_indices
    inverse = robot.inverse_dynamics
    diagonals = robot.arrays.diagonals[:, index]
    friction = diagonals[DAMPING] * QD + diagonals[FRICTION] * np.tanh(QD / SLIP_RATE)
    gravity = inverse(q, zero, zero)[index]
    terms = {
        'inertia': (robot.inertia_matrix(q) @ qdd)[index],
        'gravity': gravity,
        'friction': friction,
        'coriolis': inverse(q, qd, zero)[index] - gravity - friction,
    }
    for name, term in terms.items():
        assert np.abs(term).min() > 1e-3, name
        without = TorqueFeedforward(robot, model=model, terms=replace(Terms(), **{name: False}))
        np.testing.assert_allclose(without.update(Q, QD, QDD, 0.0), whole - term, atol=1e-9)
        nothing = Terms(False, False, False, False)
        alone = TorqueFeedforward(robot, model=model, terms=replace(nothing, **{name: True}))
        np.testing.assert_allclose(alone.update(Q, QD, QDD, 0.0), term, atol=1e-9)


@pytest.mark.parametrize('model', ['flexible', 'quasi_static'])
def test_without_the_elastic_term_torque_is_the_rigid_one(model: str) -> None:
    robot = arm()
    rigid = TorqueFeedforward(robot, model='rigid').update(Q, QD, QDD, 0.0).copy()
    bare = TorqueFeedforward(robot, model=model, terms=Terms(elastic=False))
    for _ in range(3):
        np.testing.assert_array_equal(bare.update(Q, QD, QDD, 1e-3), rigid)
    assert np.abs(TorqueFeedforward(robot, model=model).update(Q, QD, QDD, 0.0) - rigid).max() > 1


def test_quasi_static_amplitudes_are_the_static_deflection() -> None:
    robot = arm()
    feedforward = TorqueFeedforward(robot, model='quasi_static')
    feedforward.update(Q, QD, QDD, 0.0)
    expected = robot.static_deflection(Q)
    assert np.abs(expected[robot.flexible_indices]).max() > 0.05
    np.testing.assert_allclose(feedforward.q, expected, atol=1e-11)


def test_flexible_torque_starts_from_equilibrium() -> None:
    robot = arm()
    feedforward = TorqueFeedforward(robot)
    torque = feedforward.update(Q, 0 * QD, 0 * QDD, 0.0)
    at_rest = robot.inverse_dynamics(robot.static_deflection(Q), np.zeros(6), np.zeros(6))
    np.testing.assert_allclose(torque, at_rest[robot.joint_indices], atol=1e-8)
    np.testing.assert_allclose(feedforward.qdd, 0.0, atol=1e-6)


def follow(model: str, step: float) -> float:
    """Drive the arm by feedforward alone along a motion; return the largest joint error [rad]."""
    plant, robot = arm(), arm()
    start = np.array([-1.2, 0.4])
    motion = CycloidalTrajectory(start, np.array([0.4, -0.6]), np.array([1.5, 1.5]))
    feedforward = TorqueFeedforward(robot, model=model, step=step)
    stepper = Stepper(plant, step)
    q, qd, tau = plant.static_deflection(start), np.zeros(plant.n), np.zeros(plant.n)
    desired, rate, acceleration = np.zeros((3, 2))
    worst = 0.0
    for tick in range(round(1.5 / step)):
        # torque is held over a step: that of the middle of it is the fair one
        motion.sample((tick + 0.5) * step, desired, rate, acceleration)
        elapsed = step if tick else 0.0
        tau[plant.joint_indices] = feedforward.update(desired, rate, acceleration, elapsed)
        stepper.free(q, qd, tau)
        motion.sample((tick + 1) * step, desired, rate, acceleration)
        worst = max(worst, float(np.abs(q[plant.joint_indices] - desired).max()))
    return worst


def test_flexible_feedforward_alone_makes_the_arm_follow() -> None:
    flexible, rigid = follow('flexible', 1e-3), follow('rigid', 1e-3)
    assert flexible < 2e-4
    assert rigid > 20 * flexible


@pytest.mark.parametrize('terms', [Terms(), Terms(friction=False)], ids=['compiled', 'in parts'])
def test_the_first_torque_gives_the_arm_its_momentum_about_the_first_axis(terms: Terms) -> None:
    """A motion of 1 and 2 Hz at 500 Hz, where neither weight nor friction acts."""
    robot, step = load_robot(ROBOTS / 'canadarm.urdf', gravity=(0, 0, 0)), 2e-3
    feedforward = TorqueFeedforward(robot, terms=terms, step=step)
    pace, times = 2.0 * np.pi * np.array([1.0, 2.0, 1.5]), step * np.arange(1000)
    torque, momentum = np.zeros((2, len(times)))
    for k, time in enumerate(times):
        swing = np.array([1.0 - np.cos(pace * time), np.sin(pace * time), np.cos(pace * time)])
        motion = 1e-3 * swing * pace ** np.arange(3)[:, None]
        torque[k] = feedforward.update(motion[0], motion[1], motion[2], step if k else 0.0)[0]
        momentum[k] = robot.inertia_matrix(feedforward.q)[0] @ feedforward.qd
    impulse = cumulative_simpson(torque, dx=step, initial=0.0)
    assert np.abs(momentum - impulse).max() < 1e-5 * np.abs(momentum).max()


def test_a_mimic_joint_is_moved_and_carried_by_its_leader() -> None:
    robot = arm(flexible=False, mimic=True)
    feedforward = TorqueFeedforward(robot, model='rigid')
    assert feedforward.joints == ('j1',)
    torque = feedforward.update(Q[:1], QD[:1], QDD[:1], 0.0)
    joints: list[Any] = [np.array([v, -2 * v]) for v in (Q[0], QD[0], QDD[0])]
    joints[0][1] += 0.1
    both = robot.inverse_dynamics(*joints)
    np.testing.assert_allclose(torque, [both[0] - 2 * both[1]], rtol=1e-12)


def test_joints_not_driven_stay_where_they_are_held() -> None:
    robot = arm(flexible=False)
    feedforward = TorqueFeedforward(robot, joints=['j2'], model='rigid', held={'j1': 0.7})
    torque = feedforward.update(Q[1:], QD[1:], QDD[1:], 0.0)
    states: list[Any] = [np.array(pair) for pair in ((0.7, Q[1]), (0.0, QD[1]), (0.0, QDD[1]))]
    np.testing.assert_allclose(torque, robot.inverse_dynamics(*states)[1:], rtol=1e-12)


def test_gravity_carries_the_weight_without_touching_the_motion() -> None:
    robot = arm()
    feedforward = TorqueFeedforward(robot)
    feedforward.update(Q, QD, QDD, 0.0)
    before = feedforward.q.copy()
    assert feedforward.gravity(Q)[0] > 100.0
    np.testing.assert_array_equal(feedforward.q, before)
    silent = TorqueFeedforward(robot, terms=Terms(gravity=False))
    np.testing.assert_array_equal(silent.gravity(Q), [0.0, 0.0])


def test_bad_choices_are_refused() -> None:
    robot = arm()
    with pytest.raises(StateError, match='model must be one of'):
        TorqueFeedforward(robot, model='stiff')
    with pytest.raises(StateError, match='driven joints must be'):
        TorqueFeedforward(robot, joints=['j1', 'j9'])
    feedforward = TorqueFeedforward(robot)
    feedforward.update(Q, QD, QDD, 0.0)
    with pytest.raises(StateError, match='finite'):
        feedforward.update(Q, QD, np.array([np.nan, 0.0]), 1e-3)


@pytest.mark.parametrize('ei', [1e5, 1e7, 1e9])
def test_stiff_beams_approach_the_rigid_torque_at_a_step_far_too_long_for_them(ei: float) -> None:
    robot = arm(ei=ei)
    assert ei < 1e7 or robot.natural_frequencies(np.zeros(robot.n))[-1] > 2000.0  # Hz, at 1 kHz
    flexible = TorqueFeedforward(robot, step=1e-3)
    rigid = TorqueFeedforward(arm(ei=ei), model='rigid')
    motion = CycloidalTrajectory(
        np.array([-1.2, 0.4]), np.array([0.4, -0.6]), np.array([1.5, 1.5])
    )
    q, qd, qdd = np.zeros((3, 2))
    gap = 0.0
    for tick in range(1500):
        motion.sample(tick * 1e-3, q, qd, qdd)
        torque = flexible.update(q, qd, qdd, 1e-3 if tick else 0.0)
        gap = max(gap, float(np.abs(torque - rigid.update(q, qd, qdd, 0.0)).max()))
    # undamped modes ring by about the square root of the flexibility, of 173 N m at most
    assert gap < 6.0 * (1e5 / ei) ** 0.5


def test_quasi_static_torque_is_in_equilibrium_where_weight_bends_by_metres() -> None:
    robot = load_robot('config/robots/ssrms.urdf', gravity=(0.0, 0.0, -9.81))
    feedforward = TorqueFeedforward(robot, model='quasi_static')
    zero = np.zeros(len(robot.joint_names))
    for angle in np.linspace(0.0, 0.3, 31):
        joints = np.full(len(zero), angle)
        torque = feedforward.update(joints, zero, zero, 0.01)
        resting = robot.static_deflection(joints, start=feedforward.q)
        expected = robot.inverse_dynamics(resting, *np.zeros((2, robot.n)))
        # the follower's relative tolerance of 1e-7 times some 1e4 N m
        np.testing.assert_allclose(torque, expected[robot.joint_indices], rtol=0.0, atol=1e-2)
    assert np.abs(robot.tip_deflection('link_2', resting)).max() > 1.0


@pytest.mark.parametrize('size', [1e20, 1e39, 1e100, np.inf, np.nan])
def test_amplitudes_out_of_reach_cost_one_update_and_no_weight(size: float) -> None:
    robot = load_robot(two_links(), gravity=(0.0, -9.81, 0.0))
    source, fresh = (TorqueFeedforward(robot.copy()) for _ in range(2))
    posture, still = np.array([0.1, 0.2]), np.zeros(2)
    expected = fresh.update(posture, still, still, 0.0).copy()
    source.update(posture, still, still, 0.0)
    source.q[robot.flexible_indices] = size * np.array([1.0, -0.3, 0.5, 1.0])
    with pytest.raises((StateError, SolverError)):
        source.update(posture, still, still, 1e-3)
    # the sag of undeformed beams is what is missing of the weight's torque
    np.testing.assert_allclose(source.gravity(posture), expected, rtol=0.05)
    np.testing.assert_allclose(source.update(posture, still, still, 1e-3), expected, rtol=1e-9)
