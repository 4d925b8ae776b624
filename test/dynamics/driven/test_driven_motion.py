"""Mechanisms from their driven joints: the loops stay closed and torques are the multipliers'."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from denoc_ros.dynamics.driven.driven_motion import LoopedMotion
from denoc_ros.dynamics.driven.torque_feedforward import TorqueFeedforward
from denoc_ros.dynamics.equilibrium import UnsettledError
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.types import Array

ROBOTS = Path(__file__).parents[3] / 'config' / 'robots'
DRIVEN = ('joint_1', 'joint_3')
START = np.radians([108.0, -72.0, 72.0, 72.0])


def five_bar(kind: str) -> tuple[Robot, Array]:
    robot = load_robot(ROBOTS / f'five_bar_{kind}.urdf', gravity=(0, -9.81, 0))
    posture = np.zeros(robot.n)
    posture[robot.joint_indices] = START
    return robot, robot.assemble(posture)


def looped(kind: str = 'rrrr') -> LoopedMotion:
    robot, posture = five_bar(kind)
    return LoopedMotion(robot, DRIVEN, posture=posture)


def test_the_loops_stay_closed_along_the_driven_motion() -> None:
    motion = looped()
    q, before = motion.posture.copy(), motion.posture.copy()
    for driven in ([2.0, 1.2], [1.0, 0.9], [1.9, 1.1]):
        motion.positions(q, np.array(driven))
        np.testing.assert_array_equal(q[motion.index], driven)
        np.testing.assert_allclose(motion.robot.closure(q), 0.0, atol=1e-14)
        # the branch of the start: both elbows stay on their sides
        np.testing.assert_array_equal(np.sign(q[[1, 3]]), np.sign(before[[1, 3]]))


def test_rates_and_accelerations_are_derivatives_of_positions() -> None:
    motion, step = looped(), 1e-4

    def at(t: float) -> Array:
        q: Array = motion.posture.copy()
        motion.positions(q, q[motion.index] + np.array([0.5 * t - t * t, 0.3 * t + 2.0 * t * t]))
        return q

    before, after, q = at(-step), at(step), at(0.0)
    qd, qdd = np.zeros((2, motion.robot.n))
    motion.rates(qd, np.array([0.5, 0.3]))
    motion.accelerations(q, qd, qdd, np.array([-2.0, 4.0]))
    # central differences: 1e-8 of truncation, 1e-16 / 1e-8 of rounding
    np.testing.assert_allclose(qd, (after - before) / (2 * step), atol=1e-6)
    np.testing.assert_allclose(qdd, (after - 2 * q + before) / step**2, atol=1e-5)


@pytest.mark.parametrize('kind', ['rrrr', 'ffff'])
def test_rigid_torque_is_constrained_inverse_dynamics(kind: str) -> None:
    robot, posture = five_bar(kind)
    feedforward = TorqueFeedforward(robot, DRIVEN, 'rigid', posture=posture)
    torque = feedforward.update(
        posture[[0, robot.joint_indices[2]]] + 0.1, np.array([0.4, -0.7]), np.array([2.0, 3.0]), 0
    )
    # a rigid link has no equation of its amplitudes: they count as driven, and only they
    held = load_robot(ROBOTS / 'five_bar_rrrr.urdf', gravity=(0, -9.81, 0))
    index = robot.joint_indices
    expected, _ = held.constrained_inverse_dynamics(
        feedforward.q[index], feedforward.qd[index], feedforward.qdd[index], DRIVEN
    )
    np.testing.assert_allclose(torque, expected, rtol=1e-9)


def test_flexible_torque_starts_from_the_equilibrium_of_the_closed_mechanism() -> None:
    robot, posture = five_bar('ffff')
    feedforward = TorqueFeedforward(robot, DRIVEN, 'quasi_static', posture=posture)
    angles = posture[feedforward.motion.index]
    for shift in (0.0, 1e-3, 2e-3):  # found, then followed
        feedforward.update(angles + shift, np.zeros(2), np.zeros(2), 1e-3)
    q, zero = feedforward.q, np.zeros(robot.n)
    np.testing.assert_allclose(robot.closure(q), 0.0, atol=1e-12)
    assert np.abs(q[robot.flexible_indices]).max() > 1e-5
    torque, qdd, _ = robot.constrained_hybrid_dynamics(q, zero, np.zeros(2), DRIVEN)
    # the links' lowest frequency is 40 rad/s or more: 1e-6 rad/s^2 are 1e-9 of the amplitudes
    np.testing.assert_allclose(qdd, 0.0, atol=1e-6)
    np.testing.assert_allclose(torque, feedforward.update(angles + 2e-3, zero[:2], zero[:2], 0))


@pytest.mark.parametrize(
    ('joints', 'match'),
    [
        (('joint_1',), 'must leave nothing else free, got 1 free motion'),
        (('joint_1', 'joint_2', 'joint_3'), 'must move independently of each other'),
    ],
)
def test_driven_joints_must_determine_the_mechanism(joints: tuple[str, ...], match: str) -> None:
    robot, posture = five_bar('rrrr')
    with pytest.raises(StateError, match=match):
        LoopedMotion(robot, joints, posture=posture)


def test_positions_out_of_reach_are_refused_and_change_nothing() -> None:
    motion = looped()
    q = motion.posture.copy()
    with pytest.raises(SolverError, match='must be where the loops close'):
        motion.positions(q, np.array([3.1, 0.0]))
    np.testing.assert_array_equal(q, motion.posture)


def test_turns_are_left_out_on_a_far_way() -> None:
    motion = looped()
    q, near = motion.posture.copy(), motion.posture.copy()
    driven = np.array([2.0, 1.2])
    motion.positions(near, driven)
    turns = 2.0 * np.pi * np.array([5000.0, -5000.0])
    begin = time.thread_time()
    motion.positions(q, driven + turns)
    assert time.thread_time() - begin < 1.0  # in steps of 0.2 rad it took 10 s and more
    np.testing.assert_array_equal(q[motion.index], driven + turns)
    np.testing.assert_allclose(motion.robot.closure(q), 0.0, atol=1e-9)
    np.testing.assert_allclose(q[motion.bound], near[motion.bound], atol=1e-6)


def test_a_mechanism_on_a_rail_may_be_anywhere_along_it() -> None:
    text = (ROBOTS / 'five_bar_rrrr.urdf').read_text()
    rail = (
        '<link name="ground"/><link name="base"/><joint name="rail" type="prismatic">'
        '<parent link="ground"/><child link="base"/><axis xyz="1 0 0"/>'
        '<limit lower="0" upper="50" effort="1000" velocity="5"/></joint>'
    )
    robot = load_robot(text.replace('<link name="base"/>', rail), gravity=(0, -9.81, 0))
    posture = robot.assemble(np.concatenate(([0.0], START)))
    motion = LoopedMotion(robot, ('rail', *DRIVEN), posture=posture)
    q, near = motion.posture.copy(), motion.posture.copy()
    motion.positions(near, np.array([0.0, 2.0, 1.2]))
    for place in (45.0, 3.0):
        motion.positions(q, np.array([place, 2.0, 1.2]))
        assert q[0] == place
        np.testing.assert_allclose(robot.closure(q), 0.0, atol=1e-9)
        np.testing.assert_allclose(q[1:], near[1:], atol=1e-9)


@pytest.mark.parametrize('far', [1.7e308, np.inf, np.nan])
def test_what_is_too_far_is_refused_at_once(far: float) -> None:
    motion = looped()
    q = motion.posture.copy()
    with pytest.raises(SolverError, match=r'must be within|where the loops close'):
        motion.positions(q, np.array([far, 1.0]))
    np.testing.assert_array_equal(q, motion.posture)


def test_a_search_that_takes_too_long_goes_on_in_the_next_update() -> None:
    robot, posture = five_bar('ffff')
    whole = TorqueFeedforward(robot.copy(), DRIVEN, 'quasi_static', posture=posture)
    parts = TorqueFeedforward(robot.copy(), DRIVEN, 'quasi_static', posture=posture)
    parts.patience = 0.0  # one Newton step per update
    there, still = np.radians([100.0, 75.0]), np.zeros(2)
    for _ in range(2):  # the first one has the loops as they were before it settled
        expected = whole.update(there, still, still, 0.0)
    unsettled = 0
    for _ in range(50):
        try:
            torque = parts.update(there, still, still, 1e-3)
            break
        except UnsettledError:
            unsettled += 1
    assert unsettled
    np.testing.assert_allclose(torque, expected, rtol=1e-6)
