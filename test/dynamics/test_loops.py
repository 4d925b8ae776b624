"""Loops against the dense oracle, and the relations between their verbs."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest
from loop_oracle import LoopOracle
from looped_robots import LOOPS, Closed, random_closed
from numpy.typing import NDArray

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import StateError
from denoc_ros.model.ties import directions

Array = NDArray[np.float64]
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
