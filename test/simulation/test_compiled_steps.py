"""Compiled steps of DOP853 are scipy's: the same motion, with and without loops."""

from __future__ import annotations

import numpy as np
import pytest
from mechanism_runs import closed_start, loaded
from mechanisms import DOWN, START
from planar_chains import FLEXIBLE, RIGID, planar_chain

import denoc_ros as dn
from denoc_ros.simulation.simulate import Run
from denoc_ros.types import Array


def no_torque(robot: dn.Robot) -> dict[str, object]:
    """A torque that is zero, but that the integrator must ask for in Python."""
    zero = np.zeros(robot.n)
    return {'torque': lambda *_: zero}


def both(robot: dn.Robot, q0: Array, times: Array, rtol: float) -> tuple[Run, Run]:
    zero = np.zeros(robot.n)
    compiled = dn.simulate(robot, q0, zero, times, rtol=rtol)
    return compiled, dn.simulate(robot, q0, zero, times, rtol=rtol, **no_torque(robot))  # type: ignore[arg-type]


def test_open_chain_takes_scipys_very_steps() -> None:
    robot = dn.load_robot(planar_chain([FLEXIBLE, RIGID]), gravity=DOWN)
    q0 = np.zeros(robot.n)
    q0[robot.joint_indices] = [-1.2, 0.4]
    compiled, scipys = both(robot, q0, np.linspace(0.0, 0.3, 31), 1e-8)
    # sums in another order: rounding, and what it comes to in 0.3 s
    np.testing.assert_allclose(compiled.q, scipys.q, atol=1e-12)
    np.testing.assert_allclose(compiled.qd, scipys.qd, atol=1e-9)
    # scipy works out a rejected step's last stage too; outputs take three evaluations each
    assert compiled.evaluations == pytest.approx(scipys.evaluations, rel=0.05)


def test_loops_take_the_same_motion() -> None:
    robot = loaded('four_bar', 'RRF')
    q0 = closed_start(robot, START['four_bar'])
    compiled, scipys = both(robot, q0, np.linspace(0.0, 0.05, 11), 1e-9)
    # both within the tolerance of some hundred steps
    np.testing.assert_allclose(compiled.q, scipys.q, atol=1e-8)
    assert np.max(np.abs(compiled.q[:, robot.flexible_indices])) > 1e-4
