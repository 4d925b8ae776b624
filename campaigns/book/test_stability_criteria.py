"""Laws of the stability study: what is numerical, and what the motion itself does."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from book.stability_study import CholeskyRobot, Study, roughness, study_stability
from book_runs import desired, joints, shipped
from planar_chains import CANADARM, PlanarLink, planar_chain

import denoc_ros as dn
from denoc_ros.simulation.scenario import scenario_from_config
from denoc_ros.simulation.time_functions import SampledTorque

LENGTH, DOWN = 1.3, (0.0, -9.81, 0.0)
PENDULUM = planar_chain([PlanarLink(LENGTH, 5.0)])
# Torques that swing the pendulum from lying to lying over the top: upright at half the time.
OVER_THE_TOP = {
    'torque': {
        'kind': 'rigid_inverse_dynamics',
        'reference': {'kind': 'book', 'rate': np.pi / 6.0, 'period': 6.0},
    },
    'output_rate': 200,
    'method': 'RK45',
    'rtol': 1e-8,
}


def study(robot: dn.Robot, **values: Any) -> Study:
    return study_stability(robot, scenario_from_config(values, robot, 'a.yaml'))


@pytest.fixture(scope='module')
def swing() -> Study:
    return study(dn.load_robot(PENDULUM, gravity=DOWN), duration=6.0, **OVER_THE_TOP)


def test_upright_pendulum_lets_errors_grow_at_its_own_rate(swing: Study) -> None:
    # a slender rod about its end: q'' = 3 g / (2 l) cos(q) + tau(t) / I
    angle = np.interp(swing.spectrum_times, swing.times, swing.solution.q[:, 0])
    pull = 1.5 * 9.81 / LENGTH * np.sin(angle)
    np.testing.assert_allclose(swing.growth, np.sqrt(np.maximum(pull, 0.0)), atol=2e-3)


def test_both_algorithms_leave_an_unstable_motion_together(swing: Study) -> None:
    recursion, cholesky = swing.runs['recursion'], swing.runs['cholesky']
    assert swing.exact
    assert not swing.acceptable
    assert recursion.acceptable[0] == cholesky.acceptable[0]
    assert 2.0 < recursion.acceptable[0] < 6.0
    # the integrator's error has grown by e^(growth time); what rounding does stays far below it
    assert swing.fine_difference < 1e-6 < float(np.max(recursion.deviation))


def test_power_difference_and_deviation_are_of_the_joints_that_deviate(swing: Study) -> None:
    one = swing.runs['recursion']
    off = one.trace.q[:, 0] - swing.solution.q[:, 0]
    np.testing.assert_array_equal(one.deviation[:, 0], np.abs(off))
    rates = one.trace.qd[:, 0] - swing.solution.qd[:, 0]
    np.testing.assert_allclose(one.power_difference, one.trace.tau[:, 0] * rates)


def test_flexible_links_deviate_from_the_desired_motion_but_not_from_the_solution() -> None:
    robot = dn.load_robot(planar_chain(CANADARM), gravity=(0.0, 0.0, 0.0))
    book = {'kind': 'book', 'form': 'half', 'rate': [0.075, 0.05, 0.1], 'period': [10, 5, 5]}
    torque = {'kind': 'rigid_inverse_dynamics', 'reference': book}
    found = study(robot, torque=torque, duration=0.5, method='RK45', rtol=1e-8)
    assert found.acceptable
    assert not found.exact
    for one in found.runs.values():
        assert one.from_desired is not None
        assert np.max(np.abs(one.from_desired)) > 1e-3
        assert np.max(one.deviation) < 1e-7  # tolerance 1e-8 per step
        # interpolated outputs of order 4: as smooth as the solution
        np.testing.assert_allclose(one.roughness, found.solution_roughness, rtol=1e-2)
    assert found.difference < 1e-12


@pytest.fixture(scope='module')
def puma() -> Study:
    """The book's section 7.2, sampled less often."""
    robot, scenario = shipped('puma', 'stability_puma')
    return study_stability(robot, replace(scenario, times=np.linspace(0.0, 6.0, 601)))


def test_puma_leaves_its_motion_when_its_third_link_stands_up(puma: Study) -> None:
    calm = puma.spectrum_times <= 5.0
    assert np.max(puma.growth[calm]) < 3.0
    # a rod of 20 mm upright: sqrt(3 g / (2 l)) = 27 / s, and what the other joints add
    assert np.max(puma.growth) == pytest.approx(29.7, rel=0.02)
    for one in puma.runs.values():
        assert np.max(one.deviation[:501]) < 1e-7
        assert np.min(one.acceptable) == pytest.approx(5.81, abs=0.15)
    recursion, cholesky = (one.acceptable for one in puma.runs.values())
    np.testing.assert_allclose(recursion, cholesky, atol=0.011)  # one output


def test_pumas_printed_times_are_those_of_torques_from_a_table() -> None:
    printed = np.array([5.4, 5.6, 5.4, 5.4, 5.4, 5.4])  # table 7.1, recursive
    robot, scenario = shipped('puma', 'stability_puma')
    assert scenario.torque is not None
    table = replace(
        scenario,
        times=np.linspace(0.0, 6.0, 601),
        torque=SampledTorque(scenario.torque, 0.001, 'linear'),
    )
    off = np.abs(joints(robot, table.run(robot)) - desired(table))
    found = table.times[np.argmax(off > 1e-4, axis=0)]
    np.testing.assert_allclose(found, printed, atol=0.3)


def test_cholesky_gives_the_accelerations_of_the_recursion() -> None:
    robot = dn.load_robot(planar_chain(CANADARM), gravity=DOWN)
    robot.set_payload('link_3', 20.0, (2.0, 0.0, 0.0))
    random = np.random.default_rng(3)
    q, qd, tau = 0.1 * random.standard_normal((3, robot.n))
    expected = robot.forward_dynamics(q, qd, tau)
    dense = CholeskyRobot.of(robot)
    # condition number of the inertia matrix: 1e6
    np.testing.assert_allclose(dense.forward_dynamics(q, qd, tau), expected, rtol=1e-9, atol=1e-9)
    out = np.empty(robot.n)
    assert dense.copy().forward_dynamics(q, qd, tau, out=out) is out
    np.testing.assert_allclose(out, expected, rtol=1e-9, atol=1e-9)


def test_roughness_of_a_sine_is_its_squared_step() -> None:
    step, omega = 1e-3, 30.0
    t = np.arange(0.0, 20.0 * np.pi / omega, step)
    sine = np.sin(omega * t)[:, None]
    assert roughness(sine)[0] == pytest.approx((omega * step) ** 2, rel=1e-3)
    noise = np.random.default_rng(0).standard_normal((len(t), 1))
    assert roughness(noise)[0] == pytest.approx(np.sqrt(6.0), rel=0.1)


def test_joints_that_are_prescribed_are_refused() -> None:
    robot = dn.load_robot(PENDULUM, gravity=DOWN)
    spin = {'joint_1': {'kind': 'spin_up', 'rate': 1.0, 'time': 1.0}}
    with pytest.raises(dn.ConfigError, match='must drive the robot by torques'):
        study(robot, prescribed=spin, duration=1.0)
    with pytest.raises(dn.ConfigError, match='must have 4 output times, got 2'):
        study(robot, duration=0.01)
