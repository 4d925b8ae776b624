"""Modes of mechanisms against the accelerations of the constrained dynamics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from differences import central_differences

import denoc_ros as dn
from denoc_ros.dynamics.assembling import mobility
from denoc_ros.dynamics.constrained_dynamics import transposed_change
from denoc_ros.dynamics.equilibrium import Equilibrium
from denoc_ros.dynamics.linear.natural_modes import independent_joints, mechanism_modes
from denoc_ros.dynamics.robot import Robot
from denoc_ros.types import Array

GRAVITY = (0.0, -9.81, 0.0)
POSTURES = {
    'five_bar_ffff': (1.88, -1.25, 1.25, 1.25),
    'four_bar_fff': (0.4, 1.2, 2.2),
    'rssr_rrf': (2.094529, -3.93956514, 0.181833462, 0.0),
}


def mechanism(repository: Path, name: str) -> tuple[Robot, Array, tuple[str, ...]]:
    """Return a mechanism, its configuration in equilibrium and the joints that hold it."""
    robot = dn.load_robot(repository / 'config' / 'robots' / f'{name}.urdf', gravity=GRAVITY)
    q = np.zeros(robot.n)
    q[robot.joint_indices] = POSTURES[name]
    q = robot.assemble(q)
    held = independent_joints(robot, q)
    free = np.setdiff1d(np.arange(robot.n), robot.indices(held))
    Equilibrium(robot, free).find(q)
    return robot, q, held


@pytest.mark.parametrize('name', POSTURES)
def test_frequencies_are_those_of_the_constrained_accelerations(
    repository: Path, name: str
) -> None:
    robot, q, held = mechanism(repository, name)
    modes = mechanism_modes(robot, q, held)
    zero, still = np.zeros(robot.n), np.zeros(len(held))
    assert (
        np.abs(robot.closure_jacobian(q) @ modes.shapes).max() < 1e-7 * np.abs(modes.shapes).max()
    )
    for k, frequency in enumerate(modes.frequencies[:3]):
        # a small swing, loops closed again: its acceleration is -omega^2 times itself
        size = 1e-5 / np.abs(modes.shapes[:, k]).max()
        accelerations = []
        for sign in (1.0, -1.0):
            swung = robot.assemble(q + sign * size * modes.shapes[:, k], fixed=held)
            accelerations.append(
                robot.constrained_hybrid_dynamics(swung, zero, still, actuated=held)[1]
            )
        acceleration = (accelerations[0] - accelerations[1]) / (2.0 * size)
        expected = -((2.0 * np.pi * frequency) ** 2) * modes.shapes[:, k]
        # differences of second order; assemble() closes loops to 1e-10 of swings of 1e-5
        np.testing.assert_allclose(acceleration, expected, atol=2e-5 * np.abs(expected).max())


def test_without_loops_they_are_the_robots_natural_modes(repository: Path) -> None:
    robot = dn.load_robot(repository / 'config' / 'robots' / 'ssrms.urdf')
    q = np.linspace(-1.0, 1.0, robot.n)
    q[robot.flexible_indices] = 0.01
    assert independent_joints(robot, q) == robot.joint_names
    found = mechanism_modes(robot, q, robot.joint_names)
    expected = robot.natural_modes(q)
    np.testing.assert_allclose(found.frequencies, expected.frequencies, rtol=1e-9)
    np.testing.assert_allclose(found.damping_ratios, expected.damping_ratios, rtol=1e-9)


@pytest.mark.parametrize('name', POSTURES)
def test_independent_joints_are_as_many_as_degrees_of_freedom(repository: Path, name: str) -> None:
    robot, q, held = mechanism(repository, name)
    assert len(held) == mobility(robot).degrees_of_freedom
    rows = robot.closure_jacobian(q)
    others = np.setdiff1d(robot.joint_indices, robot.indices(held))
    # with these held no other joint moves: their columns are independent
    assert np.linalg.matrix_rank(rows[:, others], tol=1e-6) == len(others)


def test_the_cranks_on_the_base_hold_a_five_bar(repository: Path) -> None:
    assert mechanism(repository, 'five_bar_ffff')[2] == ('joint_1', 'joint_3')


@pytest.mark.parametrize('name', POSTURES)
def test_turning_of_the_loops_forces_is_that_of_differences(repository: Path, name: str) -> None:
    robot, q, _held = mechanism(repository, name)
    multipliers = np.random.default_rng(3).normal(size=len(robot.closure(q)))
    exact = transposed_change(robot, q, multipliers, np.zeros(0))
    differences = central_differences(lambda x: multipliers @ robot.closure_jacobian(x), q)
    np.testing.assert_allclose(exact, differences, rtol=0, atol=1e-9 * np.abs(exact).max())
