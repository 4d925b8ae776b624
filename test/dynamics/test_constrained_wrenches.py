"""Wrenches on frames of robots with loops: in the dynamics and in their derivatives."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest
from loop_derivative_oracle import motion_derivatives
from loop_oracle import LoopOracle
from looped_robots import Closed, random_closed
from scipy.linalg import null_space
from strategies import random_state, seeded_robot

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import StateError
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]
# The oracle solves the whole system densely. The kernels square the rows' condition on their way,
# which costs some of the sixteen digits.
RELATIVE = 1e-9
# The same forces in another order: the rows' condition makes 1e-9 of their rounding, and a wrong
# wrench makes a difference of 1.
ALIKE = 1e-6
LARGE = 3e4  # N, N m: changes of a beam's stiffness by loads are small otherwise
KINDS = ('revolute', 'universal', 'fixed')


@lru_cache(maxsize=4)
def closed(kind: str) -> Closed:
    return random_closed(2, kind, mimic=kind == 'universal', links=8)


def wrenches_on(robot: Robot, size: float = 1.0) -> dict[str, Array]:
    """Loads on the last link, on one before the loop, and on a frame of the loop."""
    rng = np.random.default_rng(9)
    loop = robot.tree.loops[0]
    names = (robot.tree.bodies[-1].name, robot.tree.bodies[0].name, loop.child.frame)
    return {name: size * rng.normal(size=6) for name in names}


def forces_of(c: Closed) -> Array:
    """Generalized forces (n,) of the wrenches, by the oracle's Jacobians."""
    oracle = LoopOracle(c.robot.tree)
    loads = wrenches_on(c.robot)
    return np.asarray(sum(oracle.frame_jacobian(x, c.q).T @ load for x, load in loads.items()))


def rows_by(robot: Robot, oracle: LoopOracle, q: Array) -> Array:
    """T (rows, rows) with J = T J of the oracle, which may take other axes across the loop's."""
    J, other = robot.closure_jacobian(q), oracle.rows(q, np.zeros(robot.n)).jacobian
    return np.asarray(np.linalg.lstsq(other.T, J.T, rcond=None)[0].T)


def driving(robot: Robot, q: Array) -> str:
    """The joint that moves most where the loops let the robot move."""
    free = null_space(robot.closure_jacobian(q), rcond=1e-6)
    return max(robot.joint_names, key=lambda x: float(np.linalg.norm(free[robot.indices((x,))])))


@pytest.mark.parametrize('kind', KINDS)
def test_wrenches_act_as_the_forces_they_make(close: Close, kind: str) -> None:
    c = closed(kind)
    robot, load, wrenches = c.robot, forces_of(c), wrenches_on(c.robot)
    tau = np.random.default_rng(3).normal(size=robot.n)
    tau[robot.flexible_indices] = 0.0
    qdd, multipliers = robot.constrained_forward_dynamics(c.q, c.qd, tau, wrenches=wrenches)
    pushed = robot.constrained_forward_dynamics(c.q, c.qd, tau + load)
    for value, expected in zip((qdd, multipliers), pushed, strict=True):
        close(value, expected, ALIKE)
    names, joints = robot.joint_names, robot.joint_indices
    torque, reactions = robot.constrained_inverse_dynamics(
        c.q, c.qd, qdd, names, wrenches=wrenches
    )
    # the equations of motion: loads, torques, reactions and what rubs in the loops' own joints
    need = robot.inverse_dynamics(c.q, c.qd, qdd) - LoopOracle(robot.tree).loop_forces(c.q, c.qd)
    given = load + robot.closure_jacobian(c.q).T @ reactions
    given[joints] += torque
    np.testing.assert_allclose(given, need, rtol=0, atol=ALIKE * np.abs(need).max())
    index = robot.indices((driving(robot, c.q),))
    driven = robot.constrained_hybrid_dynamics(
        c.q, c.qd, qdd[index], (driving(robot, c.q),), tau, wrenches=wrenches
    )
    for value, expected in zip(driven, (tau[index], qdd, multipliers), strict=True):
        close(value, expected, ALIKE)


@pytest.mark.long_cases('revolute', 'fixed')
@pytest.mark.parametrize('kind', KINDS)
def test_forward_derivatives_of_loops_take_wrenches(close: Close, kind: str) -> None:
    c = closed(kind)
    robot, oracle, wrenches = c.robot, LoopOracle(c.robot.tree), wrenches_on(c.robot, LARGE)
    tau = np.random.default_rng(3).normal(size=robot.n)
    qdd, multipliers = robot.constrained_forward_dynamics(c.q, c.qd, tau, wrenches=wrenches)
    T = rows_by(robot, oracle, c.q)
    state = (c.q, c.qd, qdd)
    motion, pushed, _ = motion_derivatives(oracle, state, T.T @ multipliers, (), wrenches)
    found = robot.constrained_forward_dynamics_derivatives(c.q, c.qd, tau, wrenches=wrenches)
    for value, expected in zip(found[:3], motion, strict=False):
        close(value, expected, RELATIVE)
    for value, expected in zip(found[3:], pushed, strict=False):
        close(T.T @ value, expected, RELATIVE)
    # the loads count beside the stiffness of the beams
    without = robot.constrained_forward_dynamics_derivatives(c.q, c.qd, tau)
    assert np.abs(without.dqdd_dq - found.dqdd_dq).max() > 1e-4 * np.abs(found.dqdd_dq).max()


@pytest.mark.long_cases('revolute', 'fixed')
@pytest.mark.parametrize('kind', KINDS)
def test_hybrid_and_inverse_derivatives_of_loops_take_wrenches(close: Close, kind: str) -> None:
    c = closed(kind)
    robot, oracle, wrenches = c.robot, LoopOracle(c.robot.tree), wrenches_on(c.robot, LARGE)
    rng = np.random.default_rng(4)
    name = driving(robot, c.q)
    index = [int(k) for k in robot.indices((name,))]
    tau, given = rng.normal(size=robot.n), rng.normal(size=1)
    tau[index] = 0.0
    asked = (c.q, c.qd, given, (name,), tau)
    _, qdd, multipliers = robot.constrained_hybrid_dynamics(*asked, wrenches=wrenches)
    T = rows_by(robot, oracle, c.q)
    expected = motion_derivatives(oracle, (c.q, c.qd, qdd), T.T @ multipliers, index, wrenches)
    found = robot.constrained_hybrid_dynamics_derivatives(*asked, wrenches=wrenches)
    for values, wanted in ((found[4:6], expected[0]), (found[:2], expected[2])):
        for value, by in zip(values, wanted, strict=False):
            close(value, by, RELATIVE)
    for value, by in zip(found[8:10], expected[1], strict=False):
        close(T.T @ value, by, RELATIVE)


@pytest.mark.usefixtures('two_threads')
def test_rows_with_wrenches_are_those_of_single_states(close: Close) -> None:
    """By two threads; each state is another one."""
    c = closed('universal')
    robot, wrenches = c.robot, wrenches_on(c.robot)
    rng = np.random.default_rng(7)
    free = np.linalg.svd(robot.closure_jacobian(c.q))[2][-3:]
    q = np.tile(c.q, (140, 1))
    qd = c.qd + rng.normal(size=(140, 3)) @ free
    tau = rng.normal(size=(140, robot.n))
    found = robot.constrained_forward_dynamics_derivatives(q, qd, tau, wrenches=wrenches)
    names = robot.joint_names[:1]
    held = robot.constrained_hybrid_dynamics_derivatives(
        c.q, qd, tau[:, :1], names, tau, wrenches=wrenches
    )
    for row in (0, 69, 70, 139):
        alone = robot.constrained_forward_dynamics_derivatives(
            q[row], qd[row], tau[row], wrenches=wrenches
        )
        for value, expected in zip(found, alone, strict=True):
            close(value[row], expected, 1e-12)
        single = robot.constrained_hybrid_dynamics_derivatives(
            c.q, qd[row], tau[row, :1], names, tau[row], wrenches=wrenches
        )
        for value, expected in zip(held, single, strict=True):
            close(value[row], expected, 1e-12)


def test_a_tree_takes_wrenches_in_the_constrained_verbs(close: Close) -> None:
    robot = load_robot(seeded_robot(1, 4))
    s = random_state(robot.coordinate_names, 1, 0.02)
    tau, wrenches = np.ones(robot.n), {robot.tree.bodies[-1].name: np.arange(6.0)}
    found = robot.constrained_forward_dynamics_derivatives(s.q, s.qd, tau, wrenches=wrenches)
    expected = robot.forward_dynamics_derivatives(s.q, s.qd, tau, wrenches)
    for value, of_tree in zip(found[:3], expected, strict=True):
        close(value, of_tree, 1e-12)
    names = robot.joint_names[:1]
    given = np.array([[0.3], [0.4]])
    held = robot.constrained_hybrid_dynamics_derivatives(
        s.q, s.qd, given, names, tau, wrenches=wrenches
    )
    tree = robot.hybrid_dynamics_derivatives(s.q, s.qd, given, names, tau, wrenches)
    free = np.setdiff1d(np.arange(robot.n), robot.indices(names))
    close(held.dtau_dq, tree.dtau_dq, 1e-12)
    close(held.dqdd_dq[:, free], tree.dqdd_dq, 1e-12)
    close(held.dqdd_dtau[:, free[:, None], free], tree.inverse_inertia, 1e-12)
    assert np.array_equal(held.dqdd_dqdd[:, robot.indices(names)[0]], [[1.0], [1.0]])


def test_refuses_a_wrench_on_a_frame_that_is_none() -> None:
    c = closed('revolute')
    still = np.zeros(c.robot.n)
    with pytest.raises(StateError, match='frame must be one of'):
        c.robot.constrained_forward_dynamics_derivatives(
            c.q, c.qd, still, wrenches={'nowhere': np.zeros(6)}
        )
    with pytest.raises(StateError, match=r'wrench must have shape \(6,\)'):
        c.robot.constrained_inverse_dynamics_derivatives(
            c.q, c.qd, still, wrenches={c.robot.tree.bodies[0].name: np.zeros(5)}
        )
