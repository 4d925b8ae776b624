"""Equilibria, linearizations and payloads of random flexible trees."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from oracles import Oracle
from scipy.linalg import eigh
from strategies import law, random_state, robots, seeded_robot, seeds

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]


def stiffness(oracle: Oracle, q: Array) -> Array:
    """d(bias at rest)/dq by central differences of order 4."""
    zero, step = np.zeros(oracle.n), 1e-3
    columns = []
    for e in np.eye(oracle.n):
        h = {k: oracle.bias_forces(q + k * step * e, zero) for k in (-2, -1, 1, 2)}
        columns.append((8 * (h[1] - h[-1]) - (h[2] - h[-2])) / (12 * step))
    return np.asarray(np.array(columns).T)


def frequencies(K: Array, I: Array) -> Array:
    """Ascending natural frequencies [Hz], unstable ones negative."""
    squares = eigh((K + K.T) / 2, I, eigvals_only=True)
    return np.asarray(np.sign(squares) * np.sqrt(np.abs(squares)) / (2 * np.pi))


@pytest.mark.long
@law(12)
@given(text=robots(most=3), seed=seeds)
def test_natural_frequencies_are_of_the_linearization(text: str, seed: int) -> None:
    robot = load_robot(text)
    oracle = Oracle(robot.tree)
    q = random_state(robot.coordinate_names, seed, deflection=0.01).q
    K, I = stiffness(oracle, q), oracle.inertia_matrix(q)
    flexible = np.setdiff1d(np.arange(robot.n), robot.joint_indices)
    block = np.ix_(flexible, flexible)
    if len(flexible):
        held = robot.natural_frequencies(q)
        top = np.abs(held).max()
        np.testing.assert_allclose(
            held, frequencies(K[block], I[block]), rtol=1e-6, atol=1e-4 * top
        )
    found = robot.natural_frequencies(q, held=False)
    top = np.abs(found).max()
    # squares are accurate to 1e-8 of the largest one: a zero comes out as its root
    np.testing.assert_allclose(
        np.sign(found) * found**2, np.sign(f := frequencies(K, I)) * f**2, atol=1e-7 * top**2
    )


@law(12)
@given(text=robots(most=4), seed=seeds)
def test_static_deflection_is_an_equilibrium(text: str, seed: int) -> None:
    robot = load_robot(text, gravity=(0.3, -0.4, -0.2))
    rng = np.random.default_rng(seed)
    joints = np.asarray(robot.joint_indices)
    flexible = np.setdiff1d(np.arange(robot.n), joints)
    q_joints = rng.uniform(-1, 1, len(joints))
    wrenches = {'l1': rng.uniform(-0.1, 0.1, 6)}
    q = robot.static_deflection(q_joints, wrenches)
    np.testing.assert_array_equal(q[joints], q_joints)
    zero = np.zeros(robot.n)
    rows = robot.inverse_dynamics(q, zero, zero, wrenches=wrenches)
    oracle = Oracle(robot.tree, (0.3, -0.4, -0.2))
    scale = max(1, np.abs(oracle.stiffness @ q).max())
    assert np.abs(rows[flexible]).max(initial=0) <= 1e-9 * scale


MASS, COM = 1.4, np.array([0.1, -0.2, 0.3])
INERTIA = np.array([[0.05, 0.004, -0.003], [0.004, 0.06, 0.002], [-0.003, 0.002, 0.04]])


def with_tool(text: str, inertial: str, carrier: str) -> str:
    """The robot with a link `tool` fixed to another link."""
    tool = f"""<link name="tool">{inertial}</link><joint name="grip" type="fixed">
      <parent link="{carrier}"/><child link="tool"/>
      <origin xyz="0.9 0.1 -0.2" rpy="0.3 -0.5 0.7"/></joint><flexibility>"""
    return text.replace('<flexibility>', tool)


def inertial(mass: float, com: Array, I: Array) -> str:
    xyz = ' '.join(map(str, com))
    return f"""<inertial><origin xyz="{xyz}"/><mass value="{mass}"/>
      <inertia ixx="{I[0, 0]}" ixy="{I[0, 1]}" ixz="{I[0, 2]}" iyy="{I[1, 1]}" iyz="{I[1, 2]}"
        izz="{I[2, 2]}"/></inertial>"""


def compare(loaded: Robot, written: Robot, close: Close, seed: int) -> None:
    s = random_state(loaded.coordinate_names, seed)
    tau = np.ones(loaded.n)
    close(loaded.inertia_matrix(s.q), written.inertia_matrix(s.q), 1e-12)
    close(loaded.bias_forces(s.q, s.qd), written.bias_forces(s.q, s.qd), 1e-12)
    close(
        written.inertia_matrix(s.q) @ loaded.forward_dynamics(s.q, s.qd, tau),
        tau - written.bias_forces(s.q, s.qd),
        1e-10,
    )
    close(np.array(loaded.energy(s.q, s.qd)), np.array(written.energy(s.q, s.qd)), 1e-12)


@law(12)
@given(text=robots(most=4), seed=seeds)
def test_payload_equals_the_same_link_in_the_file(close: Close, text: str, seed: int) -> None:
    bare = load_robot(with_tool(text, '', 'l1'))
    written = load_robot(with_tool(text, inertial(MASS, COM, INERTIA), 'l1'))
    bare.set_payload('tool', 9.0, -COM, 2 * INERTIA)
    bare.set_payload('tool', MASS, COM, INERTIA)  # the last one counts
    compare(bare, written, close, seed)


@law(12)
@given(text=robots(most=3), seed=seeds)
def test_payload_of_nothing_takes_it_off(close: Close, text: str, seed: int) -> None:
    robot, untouched = load_robot(with_tool(text, '', 'l1')), load_robot(with_tool(text, '', 'l1'))
    robot.set_payload('tool', MASS, COM, INERTIA)
    robot.set_payload('tool', 0.0, np.zeros(3), np.zeros((3, 3)))
    compare(robot, untouched, close, seed)


def test_overrides_keep_the_payload(close: Close) -> None:
    text = with_tool(seeded_robot(1), '', 'l3')
    robot = load_robot(text)
    robot.set_payload('tool', MASS, COM, INERTIA)
    stiffer = robot.with_overrides({'joint.joint_l1.damping': 0.7})
    written = load_robot(with_tool(seeded_robot(1), inertial(MASS, COM, INERTIA), 'l3'))
    compare(stiffer, written.with_overrides({'joint.joint_l1.damping': 0.7}), close, 1)


def test_damping_ratios_of_a_random_tree() -> None:
    robot = load_robot(seeded_robot(2), gravity=(0, 0, 0))
    q = np.zeros(robot.n)
    found, shapes, ratios = robot.natural_modes(q)
    oracle = Oracle(robot.tree)
    I, D = oracle.inertia_matrix(q), np.diag(oracle.damping())
    for f, shape, ratio in zip(found, shapes.T, ratios, strict=True):
        modal = shape @ I @ shape
        assert ratio == pytest.approx(shape @ D @ shape / (4 * np.pi * f * modal), rel=1e-6)
