"""Relations between the verbs, on random flexible trees."""

from __future__ import annotations

import copy
import gc
import pickle
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from oracles import Oracle
from strategies import State, law, random_state, robots, seeded_robot, seeds

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]


def along(robot: Robot, state: State, t: float) -> float:
    """Total energy on the parabola through the state."""
    q = state.q + state.qd * t + state.qdd * t * t / 2
    return float(sum(robot.energy(q, state.qd + state.qdd * t)))


def slope(f: Callable[[float], float], step: float) -> float:
    """Derivative at zero by Richardson's extrapolation of central differences, order 6."""
    d = [(f(h) - f(-h)) / (2 * h) for h in (step, step / 2, step / 4)]
    e = [(4 * d[1] - d[0]) / 3, (4 * d[2] - d[1]) / 3]
    return (16 * e[1] - e[0]) / 15


@law(15)
@given(text=robots(), seed=seeds)
def test_energy_rate_is_power(text: str, seed: int) -> None:
    robot = load_robot(text)
    s = random_state(robot.coordinate_names, seed, deflection=0.02)
    oracle = Oracle(robot.tree)
    lost = oracle.damping() * s.qd + oracle.joint_terms('friction') * np.tanh(s.qd / 1e-3)
    forces = robot.inverse_dynamics(s.q, s.qd, s.qdd) - lost
    scale = float(np.abs(forces) @ np.abs(s.qd))
    assert abs(slope(lambda t: along(robot, s, t), 4e-3) - forces @ s.qd) <= 1e-8 * scale


@law(15)
@given(text=robots(), seed=seeds)
def test_forward_undoes_inverse(text: str, seed: int) -> None:
    robot = load_robot(text)
    s = random_state(robot.coordinate_names, seed)
    tau = robot.inverse_dynamics(s.q, s.qd, s.qdd)
    qdd = robot.forward_dynamics(s.q, s.qd, tau)
    # errors of tau, relative to its largest, come back through I^-1
    I = robot.inertia_matrix(s.q)
    slack = 1e-13 * np.abs(tau).max() * np.linalg.norm(np.linalg.inv(I), 2)
    assert np.abs(qdd - s.qdd).max() <= slack + 1e-12 * np.abs(s.qdd).max()


@law(15)
@given(text=robots(), seed=seeds)
def test_hybrid_agrees_with_inverse(close: Close, text: str, seed: int) -> None:
    robot = load_robot(text)
    s = random_state(robot.coordinate_names, seed)
    joints = np.asarray(robot.joint_indices)
    flexible = np.setdiff1d(np.arange(robot.n), joints)
    tau_joints, qdd_flexible = robot.hybrid_dynamics(s.q, s.qd, s.qdd[joints])
    qdd = s.qdd.copy()
    qdd[flexible] = qdd_flexible
    tau = robot.inverse_dynamics(s.q, s.qd, qdd)
    scale = max(float(np.abs(robot.bias_forces(s.q, s.qd)).max()), float(np.abs(tau).max()))
    np.testing.assert_allclose(tau[joints], tau_joints, rtol=0, atol=1e-10 * scale)
    np.testing.assert_allclose(tau[flexible], 0, rtol=0, atol=1e-10 * scale)


@law(10)
@given(text=robots(), seed=seeds)
def test_hybrid_agrees_with_inverse_under_wrenches(text: str, seed: int) -> None:
    """Held joints carry their part of a wrench; forces tau act on the other coordinates alone."""
    robot = load_robot(text)
    s = random_state(robot.coordinate_names, seed)
    joints, free = np.asarray(robot.joint_indices), np.asarray(robot.free_indices)
    rng = np.random.default_rng(seed)
    wrenches, push = {robot.frame_names[-1]: rng.normal(size=6)}, rng.normal(size=robot.n)
    torque, rest = robot.hybrid_dynamics(s.q, s.qd, s.qdd[joints], tau=push, wrenches=wrenches)
    qdd, expected = s.qdd.copy(), push.copy()
    qdd[free], expected[joints] = rest, torque
    tau = robot.inverse_dynamics(s.q, s.qd, qdd, wrenches)
    scale = float(np.abs(np.concatenate([tau, robot.bias_forces(s.q, s.qd)])).max())
    np.testing.assert_allclose(tau, expected, rtol=0, atol=1e-10 * scale)


@law(15)
@given(text=robots(), seed=seeds)
def test_inertia_matrix_is_symmetric_positive_definite(close: Close, text: str, seed: int) -> None:
    robot = load_robot(text)
    I = robot.inertia_matrix(random_state(robot.coordinate_names, seed).q)
    np.testing.assert_allclose(I, I.T, rtol=0, atol=1e-15 * np.abs(I).max())
    assert np.linalg.eigvalsh(I)[0] > 0


def rows(robot: Robot, count: int) -> list[State]:
    return [random_state(robot.coordinate_names, seed) for seed in range(count)]


def test_batch_is_row_by_row(close: Close) -> None:
    robot = load_robot(seeded_robot(3))
    states = rows(robot, 7)
    q, qd, qdd = (np.array([getattr(s, name) for s in states]) for name in ('q', 'qd', 'qdd'))
    joints = np.asarray(robot.joint_indices)
    together = {
        'inverse': robot.inverse_dynamics(q, qd, qdd),
        'forward': robot.forward_dynamics(q, qd, qdd),
        'bias': robot.bias_forces(q, qd),
        'inertia': robot.inertia_matrix(q),
        'torque': robot.hybrid_dynamics(q, qd, qdd[:, joints])[0],
        'amplitudes': robot.hybrid_dynamics(q, qd, qdd[:, joints])[1],
        'energy': robot.energy(q, qd),
    }
    for k, s in enumerate(states):
        torque, amplitudes = robot.hybrid_dynamics(s.q, s.qd, s.qdd[joints])
        alone = {
            'inverse': robot.inverse_dynamics(s.q, s.qd, s.qdd),
            'forward': robot.forward_dynamics(s.q, s.qd, s.qdd),
            'bias': robot.bias_forces(s.q, s.qd),
            'inertia': robot.inertia_matrix(s.q),
            'torque': torque,
            'amplitudes': amplitudes,
            'energy': np.array(robot.energy(s.q, s.qd)),
        }
        for name, values in together.items():
            # two compiled loops may add in another order
            close(np.asarray(values)[k], np.asarray(alone[name]), 1e-13)


def test_second_call_ignores_stale_workspace() -> None:
    robot, other = load_robot(seeded_robot(4)), load_robot(seeded_robot(4))
    first, second = rows(robot, 2)
    fresh = other.forward_dynamics(first.q, first.qd, first.qdd)
    robot.inverse_dynamics(second.q, second.qd, second.qdd)
    robot.inertia_matrix(second.q)
    robot.hybrid_dynamics(second.q, second.qd, second.qdd[np.asarray(robot.joint_indices)])
    robot.energy(second.q, second.qd)
    robot.frame_pose('l3', second.q)
    np.testing.assert_array_equal(robot.forward_dynamics(first.q, first.qd, first.qdd), fresh)
    np.testing.assert_array_equal(robot.forward_dynamics(first.q, first.qd, first.qdd), fresh)


def test_a_pose_for_loops_is_that_of_its_frame_whatever_came_between() -> None:
    robot, frame = load_robot(seeded_robot(4)), 'l3'
    write, pose = robot.pose_of(frame), np.zeros((4, 4))
    first, second = rows(robot, 2)
    for state in (first, second, first):
        write(state.q, pose)
        np.testing.assert_array_equal(pose, robot.frame_pose(frame, state.q))
        robot.inverse_dynamics(second.q, second.qd, second.qdd)
    del robot  # what writes keeps the model that it reads
    gc.collect()
    write(first.q, pose)
    np.testing.assert_array_equal(pose, load_robot(seeded_robot(4)).frame_pose(frame, first.q))


@pytest.mark.parametrize('duplicate', [copy.deepcopy, lambda r: pickle.loads(pickle.dumps(r))])
def test_duplicate_outlives_its_original(duplicate: Callable[[Robot], Robot]) -> None:
    original = load_robot(seeded_robot(5), gravity=(1, 2, 3))
    original.set_payload('l1', 0.7, (0.1, 0.2, 0.3))
    first, second = rows(original, 2)
    expected = original.inverse_dynamics(first.q, first.qd, first.qdd)
    robot = duplicate(original)
    original.forward_dynamics(second.q, second.qd, second.qdd)
    del original
    gc.collect()
    np.testing.assert_array_equal(robot.inverse_dynamics(first.q, first.qd, first.qdd), expected)


def test_copy_works_apart() -> None:
    robot = load_robot(seeded_robot(5))
    first, second = rows(robot, 2)
    other = robot.copy()
    expected = robot.inverse_dynamics(first.q, first.qd, first.qdd)
    other.forward_dynamics(second.q, second.qd, second.qdd)
    np.testing.assert_array_equal(other.inverse_dynamics(first.q, first.qd, first.qdd), expected)
