"""Loops against the dense oracle, and the relations between their verbs."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest
from loop_oracle import LoopOracle
from looped_robots import LOOPS, Closed, random_closed

from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.errors import StateError
from denoc_ros.model.loop_constraints import directions
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]
SEEDS = (1, 2, 3)


@lru_cache(maxsize=32)
def closed(seed: int, kind: str) -> Closed:
    return random_closed(seed, kind)


def wrench_of(robot: Robot, q: Array, multipliers: Array) -> Array:
    """Wrench (6,) of a robot's one loop from its multipliers."""
    loop = robot.tree.loops[0]
    _, linear, angular, _ = directions(loop)
    if loop.type == 'universal':
        parent, child = (robot.frame_pose(s.frame, q)[:3, :3] for s in (loop.parent, loop.child))
        assert loop.axis is not None
        angular = np.cross(loop.axis, parent.T @ child @ loop.axis2)[None]
    force = linear.T @ multipliers[: len(linear)]
    torque = angular.T @ multipliers[len(linear) :]
    return np.concatenate([force, torque])


CASES = pytest.mark.parametrize(('kind', 'seed'), [(k, s) for k in LOOPS for s in SEEDS])


@CASES
def test_random_states_are_closed(kind: str, seed: int) -> None:
    c = closed(seed, kind)
    assert np.abs(c.robot.closure(c.q)).max() < 1e-10  # what assemble promises
    assert np.abs(c.robot.closure_jacobian(c.q) @ c.qd).max() < 1e-9


@CASES
def test_jacobian_is_the_derivative_of_closure_even_where_it_is_open(kind: str, seed: int) -> None:
    robot, q = closed(seed, kind).robot, closed(seed, kind).q + 0.1
    h = 1e-6
    numeric = [
        (robot.closure(q + h * e) - robot.closure(q - h * e)) / (2 * h) for e in np.eye(robot.n)
    ]
    # differences of numbers near 1 over 2e-6: 1e-9 of rounding and h^2 of truncation
    np.testing.assert_allclose(robot.closure_jacobian(q), np.transpose(numeric), atol=2e-8)


@CASES
def test_bias_is_the_derivative_of_the_jacobian_along_the_rates(kind: str, seed: int) -> None:
    c = closed(seed, kind)
    h = 1e-5
    ahead, behind = (c.robot.closure_jacobian(c.q + s * h * c.qd) @ c.qd for s in (1, -1))
    bias = c.robot.closure_bias(c.q, c.qd)
    # third derivatives along rates up to 2 rad/s through long arms are some hundreds
    np.testing.assert_allclose((ahead - behind) / (2 * h), bias, atol=1e-6)


@CASES
def test_rows_equal_those_of_the_oracle(close: Close, kind: str, seed: int) -> None:
    c = closed(seed, kind)
    oracle = LoopOracle(c.robot.tree)
    rows = oracle.rows(c.q, c.qd)
    J = c.robot.closure_jacobian(c.q)
    # the oracle may take other axes across the loop's: what is common are the spans of the rows
    close(np.linalg.pinv(J, 1e-8) @ J, np.linalg.pinv(rows.jacobian, 1e-8) @ rows.jacobian, 1e-8)


@CASES
def test_forward_dynamics_equals_the_oracle(close: Close, kind: str, seed: int) -> None:
    c = closed(seed, kind)
    oracle = LoopOracle(c.robot.tree)
    tau = np.random.default_rng(seed).normal(size=c.robot.n)
    qdd, multipliers = c.robot.constrained_forward_dynamics(c.q, c.qd, tau)
    expected, wrenches, _ = oracle.constrained_forward_dynamics(c.q, c.qd, tau)
    close(qdd, expected, 1e-8)
    close(wrench_of(c.robot, c.q, multipliers), wrenches[0], 1e-7)


@pytest.mark.parametrize('seed', SEEDS)
def test_loops_that_share_links_and_a_mimic_joint_equal_the_oracle(
    close: Close, seed: int
) -> None:
    c = random_closed(seed, 'spherical', 'universal', mimic=True)
    robot, oracle = c.robot, LoopOracle(c.robot.tree)
    rows = oracle.rows(c.q, c.qd)
    # no free directions here: row by row, sign by sign
    close(robot.closure_jacobian(c.q), rows.jacobian, 1e-9)
    close(robot.closure_bias(c.q, c.qd), rows.bias, 1e-8)
    tau = np.random.default_rng(seed).normal(size=robot.n)
    qdd, multipliers = robot.constrained_forward_dynamics(c.q, c.qd, tau)
    expected, wrenches, constraints = oracle.constrained_forward_dynamics(c.q, c.qd, tau)
    close(qdd, expected, 1e-8)
    close(multipliers[-1:], constraints, 1e-7)
    close(multipliers[:3], wrenches[0][:3], 1e-7)
    leader = robot.joint_names[:1]
    given = np.array([0.4])
    torque, qdd, _ = robot.constrained_hybrid_dynamics(c.q, c.qd, given, leader)
    index = [int(k) for k in robot.joint_indices[:1]]
    expected, accelerations, *_ = oracle.constrained_hybrid_dynamics(c.q, c.qd, given, index)
    close(torque, expected, 1e-7)
    close(qdd, accelerations, 1e-8)


@pytest.mark.usefixtures('two_threads')
@pytest.mark.parametrize('kind', LOOPS)
def test_rows_of_states_equal_states_one_by_one(close: Close, kind: str) -> None:
    c = closed(1, kind)
    robot, many = c.robot, 130
    rng = np.random.default_rng(2)
    tau = rng.normal(size=(many, robot.n))
    qdd, multipliers = robot.constrained_forward_dynamics(c.q, c.qd, tau)
    assert multipliers.shape == (many, len(robot.closure(c.q)))
    for k in (0, 64, many - 1):
        alone, reaction = robot.constrained_forward_dynamics(c.q, c.qd, tau[k])
        close(qdd[k], alone, 1e-12)
        close(multipliers[k], reaction, 1e-11)


@pytest.mark.parametrize('kind', LOOPS)
def test_steps_stay_on_the_loop_and_converge_with_order_two(kind: str) -> None:
    c = closed(1, kind)
    robot, ends = c.robot, []
    for step in (2e-4, 1e-4, 5e-5):
        q, qd = c.q.copy(), c.qd.copy()
        stepper = Stepper(robot.copy(), step)
        for _ in range(round(4e-3 / step)):
            stepper.free(q, qd, np.zeros(robot.n))
        assert np.abs(robot.closure(q)).max() < 1e-11
        assert np.abs(robot.closure_jacobian(q) @ qd).max() < 1e-10
        ends.append(q)
    first, second = np.abs(ends[0] - ends[1]).max(), np.abs(ends[1] - ends[2]).max()
    # 4 in the limit; stiff modes are not there yet
    assert first / second > 2.5


@CASES
def test_inverse_dynamics_equals_the_oracle(close: Close, kind: str, seed: int) -> None:
    c = closed(seed, kind)
    robot = c.robot
    qdd, _ = robot.constrained_forward_dynamics(c.q, c.qd, np.ones(robot.n))
    with pytest.raises(StateError, match='qdd must be one that the actuated joints can give'):
        robot.constrained_inverse_dynamics(c.q, c.qd, qdd, robot.joint_names[:1])
    torque, qdd, multipliers = robot.constrained_hybrid_dynamics(
        c.q, c.qd, qdd[robot.joint_indices[:1]], robot.joint_names[:1]
    )
    oracle = LoopOracle(robot.tree)
    index = [int(k) for k in robot.joint_indices[:1]]
    expected, wrenches, _ = oracle.constrained_inverse_dynamics(c.q, c.qd, qdd, index)
    close(torque, expected, 1e-7)
    close(wrench_of(robot, c.q, multipliers), wrenches[0], 1e-7)


@CASES
def test_forward_dynamics_returns_what_hybrid_dynamics_gave(
    close: Close, kind: str, seed: int
) -> None:
    c = closed(seed, kind)
    robot, names = c.robot, c.robot.joint_names[:2]
    given = np.array([0.7, -1.1])
    tau = np.random.default_rng(seed).normal(size=robot.n)
    torque, qdd, multipliers = robot.constrained_hybrid_dynamics(c.q, c.qd, given, names, tau)
    index = robot.joint_indices[:2]
    np.testing.assert_allclose(qdd[index], given, atol=1e-9)
    tau[index] = torque
    again, reaction = robot.constrained_forward_dynamics(c.q, c.qd, tau)
    close(again, qdd, 1e-7)
    close(reaction, multipliers, 1e-7)
