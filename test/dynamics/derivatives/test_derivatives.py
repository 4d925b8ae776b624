"""Derivatives of the dynamics against complex steps through the dense oracle."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from derivative_oracle import inverse_derivatives
from hypothesis import given
from hypothesis import strategies as st
from oracles import Oracle
from strategies import law, random_state, robots, seeded_robot, seeds

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import StateError
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]
GRAVITY = (0.7, -1.3, -9.6)
RELATIVE = 1e-9  # rounding over a chain of six bodies stays a hundred times below


def pair(text: str, geometric_stiffness: bool = True) -> tuple[Robot, Oracle]:
    robot = load_robot(text, gravity=GRAVITY, geometric_stiffness=geometric_stiffness)
    return robot, Oracle(robot.tree, GRAVITY, geometric_stiffness)


def wrenches_on(robot: Robot, seed: int) -> dict[str, Array]:
    rng = np.random.default_rng(seed)
    return {frame: rng.uniform(-30, 30, 6) for frame in list(robot.tree.frames)[::2]}


def agree(result: tuple[Array, Array, Array], expected: tuple[Array, Array, Array]) -> None:
    """Equality relative to the largest number; what ought to vanish, to that of the inertia."""
    least = float(np.abs(expected[2]).max())
    for value, wanted in zip(result, expected, strict=True):
        scale = max(float(np.abs(wanted).max()), least)
        np.testing.assert_allclose(value, wanted, rtol=0, atol=RELATIVE * scale)


@pytest.mark.long
@law(12)
@given(text=robots(), seed=seeds, geometric=st.booleans())
def test_inverse_derivatives_are_those_of_lagranges_equations(
    text: str, seed: int, geometric: bool
) -> None:
    robot, oracle = pair(text, geometric)
    s = random_state(robot.coordinate_names, seed)
    s.qd[::2] *= 1e-3  # where friction is not saturated
    result = robot.inverse_dynamics_derivatives(s.q, s.qd, s.qdd)
    agree(result, inverse_derivatives(oracle, s.q, s.qd, s.qdd))


@law(6)
@given(text=robots(4), seed=seeds)
def test_sections_that_turn_far_have_exact_derivatives(text: str, seed: int) -> None:
    robot, oracle = pair(text)
    s = random_state(robot.coordinate_names, seed, deflection=0.6)
    result = robot.inverse_dynamics_derivatives(s.q, s.qd, s.qdd)
    agree(result, inverse_derivatives(oracle, s.q, s.qd, s.qdd))


MANY_MODES = """<robot name="boom"><link name="world"/>
  <link name="boom"><inertial><origin xyz="2 0 0"/><mass value="12"/>
    <inertia ixx="0.2" iyy="16" izz="16" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tip"><inertial><origin xyz="0.2 0.1 -0.3"/><mass value="3"/>
    <inertia ixx="0.4" iyy="0.5" izz="0.3" ixy="0.02" ixz="0.01" iyz="-0.03"/></inertial></link>
  <link name="arm"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>
    <inertia ixx="0.1" iyy="0.3" izz="0.3" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="slew" type="revolute"><parent link="world"/><child link="boom"/>
    <origin xyz="0 0 1" rpy="0.2 0.1 0"/><axis xyz="0 0 1"/>
    <limit effort="10" velocity="1" lower="-2" upper="2"/></joint>
  <joint name="grip" type="fixed"><parent link="boom"/><child link="tip"/>
    <origin xyz="4 0 0" rpy="0.3 0 0"/></joint>
  <joint name="side" type="revolute"><parent link="boom"/><child link="arm"/>
    <origin xyz="2.5 0.1 0"/><axis xyz="0 1 0"/>
    <limit effort="10" velocity="1" lower="-2" upper="2"/></joint>
  <flexibility><beam link="boom" length="4" shape="clamped-free">
    <bending direction="y" ei="2e4" modes="4"/><bending direction="z" ei="3e4" modes="3"/>
    <torsion gj="1e4" polar_inertia="0.05" modes="2"/></beam></flexibility></robot>"""


@pytest.mark.parametrize('twist', [2, 0])
def test_more_modes_than_lanes_have_exact_derivatives(twist: int) -> None:
    text = MANY_MODES if twist else re.sub('<torsion[^>]*/>', '', MANY_MODES)
    robot, oracle = pair(text)
    assert robot.n == 2 + 4 + 3 + twist
    s = random_state(robot.coordinate_names, 5)
    result = robot.inverse_dynamics_derivatives(s.q, s.qd, s.qdd)
    agree(result, inverse_derivatives(oracle, s.q, s.qd, s.qdd))


@pytest.mark.long
@law(8)
@given(text=robots(4), seed=seeds)
def test_wrenches_have_their_share(text: str, seed: int) -> None:
    robot, oracle = pair(text)
    s = random_state(robot.coordinate_names, seed)
    wrenches = wrenches_on(robot, seed)
    loaded = robot.inverse_dynamics_derivatives(s.q, s.qd, s.qdd, wrenches)
    agree(loaded, inverse_derivatives(oracle, s.q, s.qd, s.qdd, wrenches))
    # without gravity, rates and accelerations only the wrenches' share is left
    rest = np.zeros(robot.n)
    free = robot.inverse_dynamics_derivatives(s.q, rest, rest)[0]
    held = robot.inverse_dynamics_derivatives(s.q, rest, rest, wrenches)[0]
    share = inverse_derivatives(oracle, s.q, rest, rest, wrenches)[0]
    share = share - inverse_derivatives(oracle, s.q, rest, rest)[0]
    np.testing.assert_allclose(held - free, share, atol=1e-11 * np.abs(held).max() + 1e-12)


def test_payload_enters_the_derivatives(close: Close) -> None:
    text = seeded_robot(11)
    robot = load_robot(text, gravity=GRAVITY)
    s = random_state(robot.coordinate_names, 3)
    before = robot.inverse_dynamics_derivatives(s.q, s.qd, s.qdd)
    frame = robot.tree.bodies[-1].name
    robot.set_payload(frame, 3.0, (0.1, -0.2, 0.05), np.diag([0.1, 0.2, 0.25]))
    after = robot.inverse_dynamics_derivatives(s.q, s.qd, s.qdd)
    assert all(np.abs(a - b).max() > 1e-3 for a, b in zip(before, after, strict=True))
    close(after[2], robot.inertia_matrix(s.q), 1e-12)
    step = 1e-5 * np.eye(robot.n)
    columns = [
        robot.inverse_dynamics(s.q + h, s.qd, s.qdd) - robot.inverse_dynamics(s.q - h, s.qd, s.qdd)
        for h in step
    ]
    close(after[0], np.column_stack(columns) / 2e-5, 1e-7)


@pytest.mark.parametrize('seed', range(6))
def test_stiffness_at_rest_is_symmetric(seed: int) -> None:
    robot = load_robot(seeded_robot(seed), gravity=GRAVITY)
    q = random_state(robot.coordinate_names, seed).q
    rest = np.zeros(robot.n)
    stiffness, damping, inertia = robot.inverse_dynamics_derivatives(q, rest, rest)
    scale = np.abs(stiffness).max()
    np.testing.assert_allclose(stiffness, stiffness.T, rtol=0, atol=1e-12 * scale)
    np.testing.assert_allclose(inertia, inertia.T, rtol=0, atol=1e-13 * np.abs(inertia).max())
    # nothing moves: what is left of the rates is damping and friction, each on its coordinate
    np.testing.assert_array_equal(damping, np.diag(np.diag(damping)))


def test_rows_lists_and_given_arrays_give_the_same(close: Close) -> None:
    robot = load_robot(seeded_robot(5))
    states = [random_state(robot.coordinate_names, seed) for seed in range(5)]
    q, qd, qdd = (np.array([getattr(s, name) for s in states] * 40) for name in ('q', 'qd', 'qdd'))
    wrenches = wrenches_on(robot, 1)
    rows = robot.inverse_dynamics_derivatives(q, qd, qdd, wrenches)
    out = np.full((3, *rows[0].shape), np.nan)
    given = robot.inverse_dynamics_derivatives(q, qd, qdd, wrenches, out=tuple(out))
    for value, same, target in zip(rows, given, out, strict=True):
        assert same is not value
        assert np.shares_memory(same, target)
        np.testing.assert_array_equal(same, value)
    for k, s in enumerate(states):
        alone = np.full((3, robot.n, robot.n), np.nan)
        robot.inverse_dynamics_derivatives(s.q, s.qd, s.qdd, wrenches, out=tuple(alone))
        listed = robot.inverse_dynamics_derivatives(list(s.q), s.qd, s.qdd, wrenches)
        for whole, one, another in zip(rows, alone, listed, strict=True):
            close(whole[k], one, 1e-13)
            close(whole[-5 + k], one, 1e-13)
            close(another, one, 1e-13)


def test_wrong_arguments_are_refused() -> None:
    robot = load_robot(seeded_robot(5))
    zero = np.zeros(robot.n)
    with pytest.raises(StateError, match=r'q must have shape'):
        robot.inverse_dynamics_derivatives(np.zeros(robot.n + 1), zero, zero)
    with pytest.raises(StateError, match=r'qd must be finite'):
        robot.inverse_dynamics_derivatives(zero, zero + np.inf, zero)
    with pytest.raises(StateError, match=r'out must be three arrays, got 2'):
        robot.inverse_dynamics_derivatives(zero, zero, zero, out=(zero, zero))
    with pytest.raises(StateError, match=r'out must be a writable'):
        robot.inverse_dynamics_derivatives(zero, zero, zero, out=(zero, zero, zero))
    with pytest.raises(StateError, match=r'frame must be one of'):
        robot.inverse_dynamics_derivatives(zero, zero, zero, {'nowhere': np.zeros(6)})


def test_nothing_moves_in_a_robot_without_coordinates() -> None:
    robot = load_robot('<robot name="r"><link name="a"/></robot>')
    empty = np.zeros(0)
    assert all(m.shape == (0, 0) for m in robot.inverse_dynamics_derivatives(empty, empty, empty))
