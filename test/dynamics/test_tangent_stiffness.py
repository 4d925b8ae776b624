"""The tangent stiffness: analytical where its kernel is at hand, by differences elsewhere."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from denoc_ros.dynamics import linearization
from denoc_ros.dynamics.robot import load_robot


def test_analytical_and_differences_agree(
    repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = load_robot(repository / 'config/robots/ssrms.urdf')
    q = np.random.default_rng(2).uniform(-0.2, 0.2, robot.n)
    loads = {'tool': (30.0, -20.0, 10.0, 1.0, 2.0, 3.0)}
    zero = np.zeros(robot.n)
    robot.inverse_dynamics_derivatives(q, zero, zero, loads)  # compiles
    assert linearization.derivatives_are_ready(loaded=True)
    for wrenches in (None, loads):
        exact = linearization.stiffness(robot, q, wrenches)
        with monkeypatch.context() as patch:
            patch.setattr(linearization, 'derivatives_are_ready', lambda *_: False)
            differences = linearization.stiffness(robot, q, wrenches)
        np.testing.assert_allclose(differences, exact, rtol=0, atol=1e-10 * np.abs(exact).max())


def test_a_check_waits_for_no_derivative_kernel(repository: Path) -> None:
    code = (
        'import sys; from denoc_ros.cli.main import main; '
        'from denoc_ros.dynamics.linearization import derivatives_are_ready; '
        "assert main(['check', sys.argv[1]]) == 0; assert not derivatives_are_ready()"
    )
    robot = repository / 'config/robots/canadarm.urdf'
    done = subprocess.run(
        [sys.executable, '-c', code, str(robot)], timeout=300, capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr.decode()
