"""The tangent stiffness against differences of the forces at rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from differences import central_differences

from denoc_ros.dynamics.linear.natural_modes import stiffness
from denoc_ros.dynamics.robot import load_robot

LOADS = {'tool': (30.0, -20.0, 10.0, 1.0, 2.0, 3.0)}


@pytest.mark.parametrize('wrenches', [None, LOADS], ids=['unloaded', 'loaded'])
def test_stiffness_is_that_of_differences(
    repository: Path, wrenches: dict[str, tuple[float, ...]] | None
) -> None:
    robot = load_robot(repository / 'config/robots/ssrms.urdf')
    q = np.random.default_rng(2).uniform(-0.2, 0.2, robot.n)
    zero = np.zeros(robot.n)
    exact = stiffness(robot, q, wrenches)
    # elasticity, 1e9 times larger, is linear here: its rounding would hide the rest
    elastic = np.diag(robot.stiffness)
    differences = central_differences(
        lambda x: robot.inverse_dynamics(x, zero, zero, wrenches) - elastic @ x, q
    )
    differences = 0.5 * (differences + differences.T) + elastic
    np.testing.assert_allclose(differences, exact, rtol=0, atol=1e-10 * np.abs(exact).max())
