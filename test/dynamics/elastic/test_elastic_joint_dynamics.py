"""Elastic joints: every verb against the dense oracle, and the rule of the format."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from geared_arm import arm_text
from hypothesis import given
from spring_oracle import GRAVITY, SpringOracle, elastic_robot
from strategies import law, random_state, seeds

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.dynamics.springs import with_motors
from denoc_ros.errors import SolverError
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]
ROUNDING = 1e-9  # of modal integrals in two ways, and of a force by differences of an energy

TWO_MASSES = """<robot name="drive"><link name="base"/>
<link name="wheel"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="{load}"/></inertial>
</link><joint name="gear" type="continuous"><parent link="base"/><child link="wheel"/>
<axis xyz="0 0 1"/></joint><flexibility><spring joint="gear" stiffness="{k}" damping="{d}"/>
{actuator}</flexibility></robot>"""
K, D, LOAD, ROTOR = 1.2e4, 8.0, 3.0, 0.9


def drive(actuator: str = f'<actuator joint="gear" armature="{ROTOR}"/>') -> Robot:
    return load_robot(TWO_MASSES.format(k=K, d=D, load=LOAD, actuator=actuator))


def pair(seed: int) -> tuple[Robot, SpringOracle]:
    text = elastic_robot(seed)
    return load_robot(text, gravity=GRAVITY), SpringOracle(text)


@law(15)
@given(seed=seeds)
def test_a_spring_stands_after_its_joint(seed: int) -> None:
    robot, oracle = pair(seed)
    assert robot.n == oracle.n
    for name, at in oracle.places().items():
        assert robot.coordinate_names[at : at + 2] == (name, f'{name}/spring')
        assert at in robot.joint_indices
        assert at + 1 in robot.flexible_indices


@law(15)
@given(seed=seeds)
def test_inverse_dynamics_and_inertia_are_lagranges(close: Close, seed: int) -> None:
    robot, oracle = pair(seed)
    s = random_state(robot.coordinate_names, seed)
    expected = oracle.inverse_dynamics(s.q, s.qd, s.qdd)
    close(robot.inverse_dynamics(s.q, s.qd, s.qdd), expected, ROUNDING)
    close(with_motors(robot).inverse_dynamics(s.q, s.qd, s.qdd), expected, ROUNDING)
    close(robot.inertia_matrix(s.q), oracle.inertia_matrix(s.q), ROUNDING)
    close(np.array(robot.energy(s.q, s.qd)), oracle.energy(s.q, s.qd), ROUNDING)


@law(15)
@given(seed=seeds)
def test_forward_dynamics_solve_the_dense_equation(close: Close, seed: int) -> None:
    robot, oracle = pair(seed)
    s = random_state(robot.coordinate_names, seed)
    tau = np.random.default_rng(seed).uniform(-5, 5, robot.n)
    bias = oracle.inverse_dynamics(s.q, s.qd, np.zeros(robot.n))
    for each in (robot, with_motors(robot)):
        residual = oracle.inertia_matrix(s.q) @ each.forward_dynamics(s.q, s.qd, tau)
        close(residual, tau - bias, ROUNDING)


@law(10)
@given(seed=seeds)
def test_motors_that_are_held_leave_the_springs_free(seed: int) -> None:
    robot, oracle = pair(seed)
    s = random_state(robot.coordinate_names, seed)
    joints = robot.joint_indices
    tau, free = robot.hybrid_dynamics(s.q, s.qd, s.qdd[joints])
    qdd = s.qdd.copy()
    qdd[robot.flexible_indices] = free
    expected = np.zeros(robot.n)
    expected[joints] = tau
    scale = np.abs(oracle.inverse_dynamics(s.q, s.qd, 0.0 * s.qd)).max()  # of forces that cancel
    found = oracle.inverse_dynamics(s.q, s.qd, qdd)
    np.testing.assert_allclose(found, expected, rtol=0, atol=ROUNDING * scale)


@law(10)
@given(seed=seeds)
def test_springs_at_rest_change_no_row_of_a_joint(close: Close, seed: int) -> None:
    text = elastic_robot(seed)
    robot, plain = load_robot(text), load_robot(re.sub('<spring[^>]*/>', '', text))
    s = random_state(plain.coordinate_names, seed)
    at = [robot.coordinate_names.index(name) for name in plain.coordinate_names]
    q, qd, qdd = np.zeros((3, robot.n))
    q[at], qd[at], qdd[at] = s.q, s.qd, s.qdd
    rigid = plain.inverse_dynamics(s.q, s.qd, s.qdd)
    close(robot.inverse_dynamics(q, qd, qdd)[at], rigid, 1e-12)  # rounding of a chain of five
    close(robot.inertia_matrix(q)[np.ix_(at, at)], plain.inertia_matrix(s.q), 1e-12)
    for frame in plain.frame_names:
        close(robot.frame_pose(frame, q), plain.frame_pose(frame, s.q), 1e-12)


@law(8)
@given(seed=seeds)
def test_payloads_load_the_links_of_both_ways(close: Close, seed: int) -> None:
    robot = load_robot(elastic_robot(seed))
    s = random_state(robot.coordinate_names, seed)
    before = robot.inverse_dynamics(s.q, s.qd, s.qdd)
    frame = [f for f, at in robot.tree.frames.items() if at.body > 0 and at.station == 0.0][-1]
    robot.set_payload(frame, 2.5, (0.1, 0.2, -0.1))
    after = robot.inverse_dynamics(s.q, s.qd, s.qdd)
    assert np.abs(after - before).max() > 1e-3
    for other in (with_motors(robot), robot.copy()):
        close(other.inverse_dynamics(s.q, s.qd, s.qdd), after, 1e-11)
    scaled = robot.with_scaled_load(frame, 1.5)
    close(
        with_motors(scaled).inverse_dynamics(s.q, s.qd, s.qdd),
        scaled.inverse_dynamics(s.q, s.qd, s.qdd),
        1e-11,
    )


def test_rows_are_the_same_as_states_one_by_one(close: Close) -> None:
    robot = load_robot(elastic_robot(3))
    states = [random_state(robot.coordinate_names, k) for k in range(7)]
    q, qd, u = (np.array([getattr(s, name) for s in states]) for name in ('q', 'qd', 'qdd'))
    for verb in (robot.inverse_dynamics, robot.forward_dynamics):
        one_by_one = np.array([verb(*row) for row in zip(q, qd, u, strict=True)])
        close(verb(q, qd, u), one_by_one, 1e-12)
    out = u[0].copy()  # the result may take an argument's place
    robot.inverse_dynamics(q[0], qd[0], out, out=out)
    close(out, robot.inverse_dynamics(q[0], qd[0], u[0]), 1e-14)
    out = u[0].copy()
    robot.forward_dynamics(q[0], qd[0], out, out=out)
    close(out, robot.forward_dynamics(q[0], qd[0], u[0]), 1e-14)


def test_two_masses_on_a_spring_have_their_closed_form() -> None:
    robot = drive()
    q = np.zeros(2)
    held = robot.natural_modes(q)
    assert held.frequencies[0] == pytest.approx(np.sqrt(K / LOAD) / (2 * np.pi), rel=1e-12)
    assert held.damping_ratios[0] == pytest.approx(D / (2 * np.sqrt(K * LOAD)), rel=1e-9)
    free = robot.natural_modes(q, held=False)
    reduced = LOAD * ROTOR / (LOAD + ROTOR)
    assert free.frequencies[0] == pytest.approx(0.0, abs=1e-6)  # root of what rounding leaves
    assert free.frequencies[1] == pytest.approx(np.sqrt(K / reduced) / (2 * np.pi), rel=1e-12)
    assert free.damping_ratios[1] == pytest.approx(D / (2 * np.sqrt(K * reduced)), rel=1e-9)


def test_two_masses_on_a_spring_have_their_transfer_function() -> None:
    robot = drive()
    model = robot.linearize(np.zeros(2), outputs=('joints',))
    for frequency in (1.0, 11.0, 100.0):  # below, near and above the resonance [Hz]
        p = 2j * np.pi * frequency
        spring = K + D * p
        # motor side: ROTOR p^2 q - spring s = tau, LOAD p^2 (q + s) + spring s = 0
        s_by_q = -LOAD * p**2 / (LOAD * p**2 + spring)
        expected = 1.0 / (ROTOR * p**2 - spring * s_by_q)
        found = model.c @ np.linalg.solve(p * np.eye(4) - model.a, model.b) + model.d
        assert abs(found[0, 0] - expected) <= 1e-9 * abs(expected)


def test_without_a_rotor_only_what_holds_the_motor_can_be_solved(close: Close) -> None:
    robot = drive(actuator='')
    (warning,) = robot.tree.warnings
    assert "spring of joint 'gear': armature of <actuator> should be > 0" in warning
    q, qd, u = np.array([[0.3, 0.01], [0.2, 0.1], [1.0, 2.0]])
    tau = robot.inverse_dynamics(q, qd, u)
    close(tau, np.array([LOAD * 3.0, LOAD * 3.0 + K * 0.01 + D * 0.1]), 1e-12)
    assert robot.hybrid_dynamics(q, qd, [1.0])[1][0] == pytest.approx(-1 - (K * 0.01 + 0.8) / 3)
    message = 'joint .gear. has a <spring>: the armature of <actuator .* must be > 0 where'
    for solve in (
        lambda: robot.forward_dynamics(q, qd, tau),
        lambda: robot.forward_dynamics(np.array([q, q]), qd, tau),
        lambda: robot.hybrid_dynamics(q, qd, [], joints=[]),
        lambda: robot.natural_modes(q, held=False),
    ):
        with pytest.raises(SolverError, match=message):
            solve()


BEAM = (
    '<beam link="upper" length="0.6" mass_per_length="1" segments="2">'
    '<bending direction="y" ei="500" modes="2"/><bending direction="z" ei="700" modes="1"/></beam>'
)
FLOATING = (
    '<link name="world"/><link name="base"><inertial><mass value="5"/>'
    '<inertia ixx="1" iyy="1" izz="1"/></inertial></link><joint name="float" type="floating">'
    '<parent link="world"/><child link="base"/></joint>'
)


@pytest.mark.parametrize('floats', [False, True])
def test_springs_stand_beside_segments_and_a_base_that_moves_or_floats(
    close: Close, floats: bool
) -> None:
    text = arm_text().replace('</flexibility>', f'{BEAM}</flexibility>')
    text = text.replace('<link name="base"/>', FLOATING) if floats else text
    robot = load_robot(text)
    whole = with_motors(robot)
    rng = np.random.default_rng(1)
    q, qd, qdd = rng.uniform(-0.02, 0.02, (3, robot.n))
    q[robot.joint_indices] = 0.4
    base = None if floats else (rng.uniform(-1, 1, 6), rng.uniform(-1, 1, 6))
    tau = robot.inverse_dynamics(q, qd, qdd, base=base)
    close(tau, whole.inverse_dynamics(q, qd, qdd, base=base), 1e-12)
    # what rounding of torques leaves behind the inertia of 20 g at the tip
    found = robot.forward_dynamics(q, qd, tau, base=base)
    np.testing.assert_allclose(found, qdd, rtol=0, atol=1e-8)
