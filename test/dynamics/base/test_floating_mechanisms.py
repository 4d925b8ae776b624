"""Loops on bases that move and float: derivatives, conservation, steps, linear models."""

from __future__ import annotations

import numpy as np
import pytest
from base_robots import description, floating, spacecraft

import denoc_ros as dn
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.types import Array


def four_bar(name: str) -> tuple[Robot, Array, Array]:
    """A four-bar mechanism on a light base that floats, and a state that keeps it closed."""
    fixed = load_robot(description(name))
    robot = load_robot(floating(description(name), spacecraft(50.0, 0.5)), (0, 0, 0))
    rng = np.random.default_rng(0)
    q = np.append(0.3 * rng.normal(size=6), fixed.assemble(np.zeros(fixed.n)))
    q = robot.assemble(q)
    qd = robot.assemble_rates(q, 0.5 * rng.normal(size=robot.n) * (np.arange(robot.n) < 7))
    return robot, q, qd


@pytest.mark.parametrize('name', ['four_bar_rrr', 'four_bar_rff'])
def test_a_mechanism_adrift_keeps_momentum_energy_and_loops(name: str) -> None:
    robot, q, qd = four_bar(name)
    run = dn.simulate(robot, q, qd, np.linspace(0.0, 0.5, 4), rtol=1e-10, atol=1e-12)
    momentum = robot.momentum(run.q, run.qd)
    scale = np.abs(momentum).max()
    np.testing.assert_allclose(momentum, np.tile(momentum[0], (4, 1)), rtol=0, atol=1e-8 * scale)
    assert run.energy_drift < 1e-8
    assert np.abs(robot.closure(run.q)).max() < 1e-9
    stepper = dn.Stepper(robot, 1e-3)
    for _ in range(100):
        stepper.free(q, qd, np.zeros(robot.n))
    # second order in a step of 1 ms
    np.testing.assert_allclose(robot.momentum(q, qd), momentum[0], rtol=0, atol=1e-5 * scale)


def test_derivatives_of_loops_on_a_moving_base_are_differences() -> None:
    robot = load_robot(description('four_bar_rff'), (0, -9.81, 0))
    rng = np.random.default_rng(1)
    q = robot.assemble(0.01 * rng.normal(size=robot.n))
    qd = robot.assemble_rates(q, rng.normal(size=robot.n))
    tau = rng.normal(size=robot.n)
    base = (rng.normal(size=6), rng.normal(size=6))
    found = robot.constrained_forward_dynamics_derivatives(q, qd, tau, base=base)
    step = 1e-6
    changes = []
    for direction in rng.normal(size=(3, robot.n)):
        # rates that keep the loops closed at q: changes of rates along them
        along = robot.assemble_rates(q, direction)
        ahead, behind = (
            robot.constrained_forward_dynamics(q, qd + sign * step * along, tau, base=base)[0]
            for sign in (1.0, -1.0)
        )
        expected = (ahead - behind) / (2 * step)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(found.dqdd_dqd @ along, expected, rtol=0, atol=1e-5 * scale)
        changes.append(scale)
    still = robot.constrained_forward_dynamics_derivatives(q, qd, tau)
    assert np.abs(found.dqdd_dqd - still.dqdd_dqd).max() > 1e-3  # Coriolis of the base's rate


def test_poles_of_a_linear_model_afloat_are_the_natural_frequencies() -> None:
    robot = load_robot(floating(description('two_link_ff'), spacecraft(50.0, 0.5)), (0, 0, 0))
    model = robot.linearize(np.zeros(robot.n))
    assert model.input_names == robot.joint_names
    poles = np.sort(np.abs(np.linalg.eigvals(model.a)))[::2] / (2.0 * np.pi)
    wanted = robot.natural_frequencies(np.zeros(robot.n), held=False)
    np.testing.assert_allclose(poles, wanted, rtol=1e-6, atol=1e-3)
    assert np.sum(wanted == 0.0) == 8  # six of the base, two joints
