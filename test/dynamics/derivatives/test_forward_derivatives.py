"""Derivatives of forward and hybrid dynamics against dense solves of the oracle's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from book.benchmarks.peers import flexible_chain
from derivative_oracle import forward_derivatives, inverse_derivatives
from hypothesis import given
from numpy.typing import NDArray
from oracles import Oracle
from strategies import law, random_state, robots, seeded_robot, seeds

from denoc_ros.dynamics.dynamics_derivatives import HybridDerivatives
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.types import Array

Index = NDArray[Any]
Close = Callable[[Array, Array, float], None]
GRAVITY = (0.7, -1.3, -9.6)


def pair(text: str) -> tuple[Robot, Oracle]:
    robot = load_robot(text, gravity=GRAVITY)
    return robot, Oracle(robot.tree, GRAVITY)


def tolerance(oracle: Oracle, q: Array) -> float:
    """Rounding times the inertia's condition, at least 1e-9."""
    return max(1e-9, 1e-14 * float(np.linalg.cond(oracle.inertia_matrix(q))))


@law(10)
@given(text=robots(), seed=seeds)
def test_forward_derivatives_solve_the_dense_equation(close: Close, text: str, seed: int) -> None:
    robot, oracle = pair(text)
    s = random_state(robot.coordinate_names, seed)
    tau = oracle.inverse_dynamics(s.q, s.qd, s.qdd)
    by_q, by_rate, inverse = robot.forward_dynamics_derivatives(s.q, s.qd, tau)
    expected = forward_derivatives(oracle, s.q, s.qd, s.qdd)
    limit, least = tolerance(oracle, s.q), float(np.abs(expected[2]).max())
    for value, wanted in zip((by_q, by_rate, inverse), expected, strict=True):
        scale = max(float(np.abs(wanted).max()), least)
        np.testing.assert_allclose(value, wanted, rtol=0, atol=limit * scale)
    np.testing.assert_array_equal(inverse, inverse.T)


def wrenches_on(robot: Robot, seed: int) -> dict[str, Array]:
    rng = np.random.default_rng(seed)
    return {frame: rng.uniform(-30, 30, 6) for frame in list(robot.tree.frames)[::2]}


@pytest.mark.long_cases('0', '3')
@pytest.mark.parametrize('seed', range(4))
def test_forward_derivatives_take_wrenches(close: Close, seed: int) -> None:
    robot, oracle = pair(seeded_robot(seed, 4))
    s = random_state(robot.coordinate_names, seed)
    wrenches = wrenches_on(robot, seed)
    tau = robot.inverse_dynamics(s.q, s.qd, s.qdd, wrenches)
    result = robot.forward_dynamics_derivatives(s.q, s.qd, tau, wrenches)
    expected = forward_derivatives(oracle, s.q, s.qd, s.qdd, wrenches)
    for value, wanted in zip(result, expected, strict=True):
        close(value, wanted, tolerance(oracle, s.q))


def hybrid_expected(
    derivatives: tuple[Array, Array, Array], held: Index, free: Index
) -> HybridDerivatives:
    """From the derivatives of I q'' + h: solve the free rows, put them into the held ones."""
    by_q, by_rate, inertia = derivatives
    inverse = np.linalg.inv(inertia[np.ix_(free, free)])
    across = inertia[np.ix_(held, free)]
    free_q, free_rate = -inverse @ by_q[free], -inverse @ by_rate[free]
    free_held = -inverse @ inertia[np.ix_(free, held)]
    return HybridDerivatives(
        by_q[held] + across @ free_q,
        by_rate[held] + across @ free_rate,
        inertia[np.ix_(held, held)] + across @ free_held,
        across @ inverse,
        free_q,
        free_rate,
        free_held,
        inverse,
    )


@pytest.mark.long_cases('True-1', 'True-3', 'True-5', 'False-1', 'False-3')
@pytest.mark.parametrize('seed', range(6))
@pytest.mark.parametrize('all_joints', [True, False])
def test_hybrid_derivatives_solve_the_dense_equation(
    close: Close, seed: int, all_joints: bool
) -> None:
    robot, oracle = pair(seeded_robot(seed))
    s = random_state(robot.coordinate_names, seed)
    joints = robot.joint_names if all_joints else robot.joint_names[::-2]
    held = robot.indices(joints)
    free = np.setdiff1d(np.arange(robot.n), held)
    wrenches = wrenches_on(robot, seed) if seed % 2 else None
    tau = np.random.default_rng(seed).uniform(-5, 5, robot.n)
    qdd = s.qdd.copy()
    qdd[free] = robot.hybrid_dynamics(s.q, s.qd, s.qdd[held], joints, tau, wrenches)[1]
    result = robot.hybrid_dynamics_derivatives(s.q, s.qd, s.qdd[held], joints, tau, wrenches)
    expected = hybrid_expected(inverse_derivatives(oracle, s.q, s.qd, qdd, wrenches), held, free)
    for value, wanted in zip(result, expected, strict=True):
        assert value.shape == wanted.shape
        if wanted.size:
            close(value, wanted, 1e-9)


def test_rows_are_states_alone(close: Close) -> None:
    robot = load_robot(seeded_robot(5))
    states = [random_state(robot.coordinate_names, seed) for seed in range(5)]
    q, qd, tau = (np.array([getattr(s, name) for s in states] * 30) for name in ('q', 'qd', 'qdd'))
    out = (np.empty((150, robot.n, robot.n)),) * 1 + tuple(np.empty((2, 150, robot.n, robot.n)))
    rows = robot.forward_dynamics_derivatives(q, qd, tau, out=out)
    assert all(np.shares_memory(a, b) for a, b in zip(rows, out, strict=True))
    given = np.ones((150, len(robot.joint_names)))
    hybrid = robot.hybrid_dynamics_derivatives(q, qd, given)
    for k, s in enumerate(states):
        alone = robot.forward_dynamics_derivatives(s.q, s.qd, s.qdd)
        for whole, one in zip(rows, alone, strict=True):
            close(whole[145 + k], one, 1e-12)
        single = robot.hybrid_dynamics_derivatives(s.q, s.qd, given[0])
        for whole, one in zip(hybrid, single, strict=True):
            if one.size:
                close(whole[145 + k], one, 1e-12)


def test_long_flexible_chain_is_exact(close: Close) -> None:
    robot = load_robot(flexible_chain(16, 2, 2, 0))
    s = random_state(robot.coordinate_names, 1, deflection=0.01)
    tau = robot.inverse_dynamics(s.q, s.qd, s.qdd)
    by_q, by_rate, inertia = robot.inverse_dynamics_derivatives(s.q, s.qd, s.qdd)
    result = robot.forward_dynamics_derivatives(s.q, s.qd, tau)
    limit = max(1e-9, 1e-14 * float(np.linalg.cond(inertia)))
    close(result[0], np.asarray(-np.linalg.solve(inertia, by_q), np.float64), limit)
    close(result[1], np.asarray(-np.linalg.solve(inertia, by_rate), np.float64), limit)
    close(result[2], np.asarray(np.linalg.inv(inertia), np.float64), limit)


def test_wrong_arguments_are_refused() -> None:
    robot = load_robot(seeded_robot(5))
    zero = np.zeros(robot.n)
    with pytest.raises(StateError, match=r'tau must have shape'):
        robot.forward_dynamics_derivatives(zero, zero, np.zeros(robot.n + 1))
    with pytest.raises(StateError, match=r'q must be finite'):
        robot.forward_dynamics_derivatives(zero + np.nan, zero, zero)
    with pytest.raises(StateError, match=r'joints must be different ones'):
        robot.hybrid_dynamics_derivatives(zero, zero, [0.0], ['nowhere'])


def test_massless_chain_has_no_accelerations() -> None:
    robot = load_robot(
        '<robot name="thin"><link name="a"/><link name="b"/><joint name="j" type="continuous">'
        '<parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>'
    )
    zero = np.zeros(1)
    with pytest.raises(SolverError, match=r'positive definite'):
        robot.forward_dynamics_derivatives(zero, zero, zero)
