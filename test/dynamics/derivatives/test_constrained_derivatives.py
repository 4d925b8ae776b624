"""Derivatives of dynamics with loops: against the dense oracle, and along closed motions."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from loop_derivative_oracle import motion_derivatives
from loop_oracle import LoopOracle
from looped_robots import LOOPS, Closed, four_bar, random_closed
from scipy.linalg import null_space
from strategies import random_state, seeded_robot

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import StateError
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]
RELATIVE = 1e-9
STEP = 5e-4  # of differences of fourth order
DIFFERENCE = 1e-7  # what those come to, with the friction of slow joints


@lru_cache(maxsize=8)
def closed(kind: str) -> Closed:
    return random_closed(2, kind, mimic=kind == 'universal', links=8)


def rows_by(robot: Robot, oracle: LoopOracle, q: Array) -> Array:
    """T (rows, rows) with J = T J of the oracle, which may take other axes across the loop's."""
    J, other = robot.closure_jacobian(q), oracle.rows(q, np.zeros(robot.n)).jacobian
    T = np.linalg.lstsq(other.T, J.T, rcond=None)[0].T
    np.testing.assert_allclose(T @ T.T, np.eye(len(J)), atol=1e-8)
    return np.asarray(T)


def driving(robot: Robot, q: Array, count: int) -> tuple[str, ...]:
    """Joints whose torques the loop does not take up, and which move apart from each other."""
    free = null_space(robot.closure_jacobian(q), rcond=1e-6)
    for names in combinations(robot.joint_names, count):
        reach = free[robot.indices(names)]
        if np.linalg.svd(reach)[1].min() > 0.1:
            return names
    raise AssertionError('joints must be found that drive the mechanism')


@pytest.mark.long_cases('revolute', 'prismatic', 'universal', 'fixed')
@pytest.mark.parametrize('kind', LOOPS)
def test_forward_derivatives_equal_the_oracle(close: Close, kind: str) -> None:
    c = closed(kind)
    robot, oracle = c.robot, LoopOracle(c.robot.tree)
    tau = np.random.default_rng(3).normal(size=robot.n)
    qdd, multipliers = robot.constrained_forward_dynamics(c.q, c.qd, tau)
    T = rows_by(robot, oracle, c.q)
    motion, pushed, _ = motion_derivatives(oracle, (c.q, c.qd, qdd), T.T @ multipliers)
    found = robot.constrained_forward_dynamics_derivatives(c.q, c.qd, tau)
    for value, expected in zip(found[:3], motion, strict=False):
        close(value, expected, RELATIVE)
    for value, expected in zip(found[3:], pushed, strict=False):
        close(T.T @ value, expected, RELATIVE)


@pytest.mark.long_cases('revolute', 'prismatic', 'universal', 'fixed')
@pytest.mark.parametrize('kind', LOOPS)
def test_hybrid_and_inverse_derivatives_equal_the_oracle(close: Close, kind: str) -> None:
    c = closed(kind)
    robot, oracle = c.robot, LoopOracle(c.robot.tree)
    rng = np.random.default_rng(4)
    actuated = driving(robot, c.q, 1)
    index = [int(k) for k in robot.indices(actuated)]
    tau, given = rng.normal(size=robot.n), rng.normal(size=1)
    tau[index] = 0.0
    _, qdd, multipliers = robot.constrained_hybrid_dynamics(c.q, c.qd, given, actuated, tau)
    T = rows_by(robot, oracle, c.q)
    state = (c.q, c.qd, qdd)
    expected = motion_derivatives(oracle, state, T.T @ multipliers, index)
    expected[0][2][:, index], expected[1][2][:, index], expected[2][2][:, index] = 0.0, 0.0, 0.0
    found = robot.constrained_hybrid_dynamics_derivatives(c.q, c.qd, given, actuated, tau)
    torques, motion, pushed = found[:4], found[4:8], found[8:]
    for values, wanted in zip((motion, torques), (expected[0], expected[2]), strict=True):
        for value, by in zip(values, (wanted[0], wanted[1], wanted[3], wanted[2]), strict=True):
            close(value, by, RELATIVE)
    reactions = (expected[1][0], expected[1][1], expected[1][3], expected[1][2])
    for value, wanted_rows in zip(pushed, reactions, strict=True):
        close(T.T @ value, wanted_rows, RELATIVE)


@pytest.mark.long_cases('revolute', 'prismatic', 'universal', 'fixed')
@pytest.mark.parametrize('kind', LOOPS)
def test_inverse_derivatives_take_back_forward_ones_of_the_oracle(close: Close, kind: str) -> None:
    c = closed(kind)
    robot, oracle = c.robot, LoopOracle(c.robot.tree)
    rng, count = np.random.default_rng(5), 1 if kind == 'fixed' else 2
    actuated = driving(robot, c.q, count)
    index, tau = robot.indices(actuated), np.zeros(robot.n)
    tau[index] = rng.normal(size=count)
    qdd, multipliers = robot.constrained_forward_dynamics(c.q, c.qd, tau)
    T = rows_by(robot, oracle, c.q)
    motion, pushed, _ = motion_derivatives(oracle, (c.q, c.qd, qdd), T.T @ multipliers)
    dq, dqd = rng.normal(size=(2, robot.n))
    dtau = np.zeros(robot.n)
    dtau[index] = rng.normal(size=count)
    dqdd = motion[0] @ dq + motion[1] @ dqd + motion[2] @ dtau
    found = robot.constrained_inverse_dynamics_derivatives(c.q, c.qd, qdd, actuated)
    terms = [matrix @ change for matrix, change in zip(found, (dq, dqd, dqdd) * 2, strict=True)]
    # what comes back is a sum of terms that nearly cancel
    size = max(float(np.abs(term).max()) for term in terms[:3])
    np.testing.assert_allclose(sum(terms[:3]), dtau[index], rtol=0, atol=RELATIVE * size)
    wanted = pushed[0] @ dq + pushed[1] @ dqd + pushed[2] @ dtau
    size = max(float(np.abs(term).max()) for term in terms[3:])
    np.testing.assert_allclose(T.T @ sum(terms[3:]), wanted, rtol=0, atol=RELATIVE * size)


def difference(function: Callable[[float], Array]) -> Array:
    a, b, c, d = (function(f * STEP) for f in (1.0, -1.0, 2.0, -2.0))
    return np.asarray((8.0 * (a - b) - (c - d)) / (12.0 * STEP))


def three_cranks() -> Robot:
    """A bar on three parallel cranks: one more than closes it, so that loads turn with them."""
    links, joints, loops = '<link name="ground"/>', '', ''
    for k, (name, mass) in enumerate((('one', 1.0), ('two', 2.0), ('three', 0.7), ('bar', 3.0))):
        links += (
            f'<link name="{name}"><inertial><origin xyz="0.2 0 0"/><mass value="{mass}"/>'
            '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>'
        )
        parent, x = ('one', 0.4) if name == 'bar' else ('ground', 0.5 * k)
        joints += (
            f'<joint name="{name}" type="continuous"><parent link="{parent}"/>'
            f'<child link="{name}"/><origin xyz="{x} 0 0"/><axis xyz="0 0 1"/></joint>'
        )
        if name in ('two', 'three'):
            loops += (
                f'<loop name="to_{name}" type="revolute"><parent link="bar" xyz="{x} 0 0"/>'
                f'<child link="{name}" xyz="0.4 0 0"/><axis xyz="0 0 1"/>'
                '<dynamics damping="0.3" friction="0.2"/></loop>'
            )
    text = f'<robot name="cranks">{links}{joints}<flexibility>{loops}</flexibility></robot>'
    return load_robot(text, gravity=(1.0, -9.0, 3.0))


MECHANISMS = {
    'four_bar': lambda: four_bar('four', dynamics='damping="0.3" friction="0.2"'),
    'cranks': three_cranks,
}
START = {'four_bar': np.full(3, 0.3), 'cranks': np.array([0.8, -0.8, 0.8, 0.8])}


@pytest.mark.parametrize('name', MECHANISMS)
@pytest.mark.parametrize('loaded', [False, True])
@pytest.mark.parametrize('actuated', [('one',), ('one', 'two')])
def test_redundant_rows_and_joints_keep_multipliers_and_torques_of_least_norm(
    actuated: tuple[str, ...], name: str, loaded: bool
) -> None:
    robot = MECHANISMS[name]()
    more: dict[str, Any] = {}
    if loaded:  # by a wrench, and by a base that moves
        pulled = robot.tree.bodies[1].name
        more['wrenches'] = {pulled: np.array([2.0, -1.0, 3.0, 0.5, 1.5, -0.7])}
        more['base'] = (np.array([0.3, 0.2, 0.1, 0.5, -0.4, 0.6]), np.arange(6.0) - 2.0)
    start = robot.assemble(START[name])
    rate = robot.assemble_rates(start, np.full(robot.n, 0.2))
    assert np.linalg.matrix_rank(robot.closure_jacobian(start), 1e-6) < len(robot.closure(start))
    rng = np.random.default_rng(6)
    tau, force, turn = rng.uniform(-1, 1, (3, robot.n))
    along = robot.assemble_rates(start, np.ones(robot.n))

    def state(s: float) -> tuple[Array, Array, Array]:
        q = robot.assemble(start + 0.1 * s * along)
        return q, robot.assemble_rates(q, rate + s * turn), tau + s * force

    def forward(s: float) -> Array:
        return np.concatenate(robot.constrained_forward_dynamics(*state(s), **more))

    def inverse(s: float) -> Array:
        q, qd, _ = state(s)
        motion = (q, qd, forward(s)[: robot.n])
        return np.concatenate(robot.constrained_inverse_dynamics(*motion, actuated, **more))

    changes = difference(lambda s: np.concatenate(state(s)))
    dq, dqd, dtau = changes.reshape(3, robot.n)
    found = robot.constrained_forward_dynamics_derivatives(*state(0.0), **more)
    value = np.concatenate(
        [found[k] @ dq + found[k + 1] @ dqd + found[k + 2] @ dtau for k in (0, 3)]
    )
    wanted = difference(forward)
    np.testing.assert_allclose(value, wanted, rtol=0, atol=DIFFERENCE * np.abs(wanted).max())
    q, qd, _ = state(0.0)
    qdd, dqdd = forward(0.0)[: robot.n], value[: robot.n]
    of_torque = robot.constrained_inverse_dynamics_derivatives(q, qd, qdd, actuated, **more)
    value = np.concatenate(
        [of_torque[k] @ dq + of_torque[k + 1] @ dqd + of_torque[k + 2] @ dqdd for k in (0, 3)]
    )
    wanted = difference(inverse)
    np.testing.assert_allclose(value, wanted, rtol=0, atol=DIFFERENCE * np.abs(wanted).max())


def test_rows_of_states_give_rows_of_derivatives(close: Close) -> None:
    c = closed('revolute')
    robot, n = c.robot, c.robot.n
    tau = np.random.default_rng(7).normal(size=(2, n))
    found = robot.constrained_forward_dynamics_derivatives(c.q, c.qd, tau)
    assert found.dqdd_dq.shape == (2, n, n)
    assert found.dmultipliers_dtau.shape == (2, len(robot.closure(c.q)), n)
    alone = robot.constrained_forward_dynamics_derivatives(c.q, c.qd, tau[1])
    close(found.dqdd_dq[1], alone.dqdd_dq, 1e-14)


def test_without_loops_they_are_those_of_the_tree(close: Close) -> None:
    robot = load_robot(seeded_robot(1, 4))
    state = random_state(robot.coordinate_names, 1, 0.02)
    tau = np.ones(robot.n)
    found = robot.constrained_forward_dynamics_derivatives(state.q, state.qd, tau)
    expected = robot.forward_dynamics_derivatives(state.q, state.qd, tau)
    for value, of_tree in zip(found[:3], expected, strict=True):
        close(value, of_tree, RELATIVE)
    assert found.dmultipliers_dq.shape == (0, robot.n)
    names = robot.joint_names[:1]
    held = robot.constrained_hybrid_dynamics_derivatives(state.q, state.qd, [0.3], names)
    tree = robot.hybrid_dynamics_derivatives(state.q, state.qd, [0.3], names)
    close(held.dtau_dq, tree.dtau_dq, RELATIVE)
    close(held.dtau_dqdd, tree.dtau_dqdd, RELATIVE)


def test_refuses_what_the_verbs_refuse() -> None:
    c = closed('revolute')
    still = np.zeros(c.robot.n)
    with pytest.raises(StateError, match='tau must have shape'):
        c.robot.constrained_forward_dynamics_derivatives(c.q, c.qd, still[1:])
    with pytest.raises(StateError, match='qdd must keep'):
        c.robot.constrained_inverse_dynamics_derivatives(c.q, c.qd, still + 1.0)
