"""What a spring does: stiffening, backlash, equilibria, derivatives, linear models."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from spring_oracle import elastic_robot
from strategies import law, random_state, seeds

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]

PENDULUM = """<robot name="pendulum"><link name="base"/><link name="rod"><inertial>
<origin xyz="1 0 0"/><mass value="2"/><inertia ixx="0.01" iyy="0.1" izz="0.1"/></inertial></link>
<joint name="elbow" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
</joint><flexibility><spring joint="elbow" {spring}/><actuator joint="elbow" armature="0.2"/>
</flexibility></robot>"""
WEIGHT = 2 * 9.81  # N at 1 m


def pendulum(**spring: float) -> Robot:
    return load_robot(PENDULUM.format(spring=' '.join(f'{k}="{v}"' for k, v in spring.items())))


def torque(robot: Robot, s: float) -> float:
    """What the spring gives, without the weight."""
    still = np.zeros(2)
    row = robot.inverse_dynamics(np.array([0.3 - s, s]), still, still)
    return float(row[1] - row[0])


def test_a_stiffening_spring_has_a_cubic_term() -> None:
    robot = pendulum(stiffness=1e3, stiffness3=4e5)
    for s in (-0.05, 0.002, 0.1):
        assert torque(robot, s) == pytest.approx(1e3 * s + 4e5 * s**3, rel=1e-10)


def test_backlash_is_a_free_play_with_soft_corners() -> None:
    robot = pendulum(stiffness=1e4, backlash=0.02)
    assert torque(robot, 0.0) == pytest.approx(0.0, abs=1e-12)
    # a tenth of the play is where the corner begins: exp(-5) of its width 1e-3 rad is left
    assert abs(torque(robot, 0.005)) <= 1e-3 * 1e4 * 1e-3
    for s in (-0.03, 0.02, 0.1):  # beyond: the corner has died out, exp(-10) of the slope is left
        expected = 1e4 * (s - np.sign(s) * 0.01)
        assert torque(robot, s) == pytest.approx(expected, rel=2 * np.exp(-10))
        assert torque(robot, -s) == pytest.approx(-torque(robot, s), rel=1e-12)


@pytest.mark.parametrize('angle', [0.0, 1.0, 2.5])
def test_a_spring_carries_the_weight_beyond_its_play(angle: float) -> None:
    for spring in ({'stiffness': 1e4}, {'stiffness': 1e4, 'backlash': 0.02}):
        q = pendulum(**spring).static_deflection([angle])
        moment = WEIGHT * np.cos(q.sum())
        gap = np.sign(moment) * spring.get('backlash', 0.0) / 2
        # the corner holds exp(-(s - p) / w) of its width w = 1 mrad
        assert q[1] == pytest.approx(gap + moment / 1e4, abs=2e-4 if gap else 1e-14)
    robot = pendulum(stiffness=1e4, backlash=0.02)
    q = robot.static_deflection([angle])
    np.testing.assert_allclose(robot.inverse_dynamics(q, 0 * q, 0 * q)[1], 0.0, atol=1e-9)


def differences(function: Callable[[Array], Array], x: Array, step: float) -> Array:
    """Jacobian by central differences of order 4."""
    columns = []
    for e in np.eye(len(x)) * step:
        near, far = function(x + e) - function(x - e), function(x + 2 * e) - function(x - 2 * e)
        columns.append((8 * near - far) / (12 * step))
    return np.asarray(np.array(columns).T)


@law(6)
@given(seed=seeds)
def test_derivatives_are_those_of_the_verbs(seed: int) -> None:
    text = re.sub('friction="[^"]*"', 'friction="0"', elastic_robot(seed, 3))  # too steep a slope
    robot = load_robot(text)
    s = random_state(robot.coordinate_names, seed, deflection=0.02)
    found = robot.inverse_dynamics_derivatives(s.q, s.qd, s.qdd)
    by_q = differences(lambda q: robot.inverse_dynamics(q, s.qd, s.qdd), s.q, 2e-5)
    by_rate = differences(lambda qd: robot.inverse_dynamics(s.q, qd, s.qdd), s.qd, 1e-3)
    # differences of corners 5e-4 rad wide, of torques that rounding leaves 1e-11 of: h^4 and 1/h
    for value, expected in zip(found[:2], (by_q, by_rate), strict=True):
        np.testing.assert_allclose(value, expected, rtol=0, atol=2e-6 * np.abs(expected).max())
    np.testing.assert_allclose(found[2], robot.inertia_matrix(s.q), rtol=0, atol=1e-10)
    tau = robot.inverse_dynamics(s.q, s.qd, s.qdd)
    ddq, ddqd, inverse = robot.forward_dynamics_derivatives(s.q, s.qd, tau)
    inertia = robot.inertia_matrix(s.q)
    for value, expected in ((ddq, -found[0]), (ddqd, -found[1]), (inverse, np.eye(robot.n))):
        scale = np.abs(expected).max() * np.linalg.cond(inertia)
        np.testing.assert_allclose(inertia @ value, expected, rtol=0, atol=1e-12 * scale)


@law(6)
@given(seed=seeds)
def test_hybrid_derivatives_hold_the_motors(seed: int) -> None:
    robot = load_robot(re.sub('friction="[^"]*"', 'friction="0"', elastic_robot(seed, 3)))
    s = random_state(robot.coordinate_names, seed, deflection=0.02)
    joints = s.qdd[robot.joint_indices]
    found = robot.hybrid_dynamics_derivatives(s.q, s.qd, joints)
    rates = differences(lambda qd: robot.hybrid_dynamics(s.q, qd, joints)[0], s.qd, 1e-3)
    scale = np.abs(rates).max()
    np.testing.assert_allclose(found.dtau_dqd, rates, rtol=0, atol=1e-6 * scale)


@law(6)
@given(seed=seeds)
def test_torques_are_linear_in_what_the_springs_have(close: Close, seed: int) -> None:
    robot = load_robot(re.sub('backlash="[^"]*"', '', elastic_robot(seed, 3)))
    s = random_state(robot.coordinate_names, seed)
    joint = next(b.joint for b in robot.tree.bodies if b.joint is not None and b.joint.spring)
    assert joint.spring is not None
    paths = {
        f'joint.{joint.name}.stiffness': joint.spring.stiffness,
        f'joint.{joint.name}.spring_damping': joint.spring.damping,
        f'joint.{joint.name}.armature': joint.armature,
    }
    columns = robot.torque_regressor(s.q, s.qd, s.qdd, list(paths))
    before = robot.inverse_dynamics(s.q, s.qd, s.qdd)
    for column, (path, value) in zip(columns.T, paths.items(), strict=True):
        more = robot.with_overrides({path: value + 0.25}).inverse_dynamics(s.q, s.qd, s.qdd)
        assert np.abs(column).max() > 0.0
        np.testing.assert_allclose(more - before, 0.25 * column, atol=1e-11 * np.abs(more).max())


@law(6)
@given(seed=seeds)
def test_modes_of_held_motors_are_those_of_the_linear_model(seed: int) -> None:
    robot = load_robot(re.sub('backlash="[^"]*"', '', elastic_robot(seed, 3)))
    joints = robot.joint_indices
    q = robot.static_deflection(np.linspace(-0.5, 0.5, len(joints)))
    found = robot.natural_frequencies(q)
    tangent = robot.inverse_dynamics_derivatives(q, 0 * q, 0 * q)[0]
    free = np.ix_(robot.flexible_indices, robot.flexible_indices)
    squares = np.linalg.eigvals(np.linalg.solve(robot.inertia_matrix(q)[free], tangent[free]))
    signed = np.sort(np.sign(squares.real) * np.sqrt(np.abs(squares.real))) / (2 * np.pi)
    np.testing.assert_allclose(found, signed, rtol=1e-6, atol=1e-6)
