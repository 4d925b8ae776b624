"""Laws of `dn.simulate` with closed loops."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from loop_oracle import LoopOracle
from mechanism_runs import book_fall, closed_start, columns, cut_four_bar, gaps, loaded
from mechanisms import DOWN, SHIPPED, START
from planar_chains import reference

import denoc_ros as dn
from denoc_ros.simulation.simulate import Run
from denoc_ros.types import Array

RIGID = [(table, kind) for table, kind, links in SHIPPED if 'F' not in links]


def worst_opening(robot: dn.Robot, run: Run) -> tuple[float, float]:
    """Largest closure error [m, rad] and its rate over a run."""
    errors = [float(np.max(np.abs(robot.closure(q)))) for q in run.q]
    rates = [
        float(np.max(np.abs(robot.closure_jacobian(q) @ qd)))
        for q, qd in zip(run.q, run.qd, strict=True)
    ]
    return max(errors), max(rates)


@pytest.mark.parametrize(('table', 'kind'), RIGID)
def test_rigid_mechanisms_fall_as_the_reference_solutions(table: str, kind: str) -> None:
    robot, expected = loaded(table, kind), reference(f'{table}_{kind}')
    run = book_fall(robot, table, expected['t'], rtol=1e-10, atol=1e-12)
    assert gaps(columns(robot, run, table, kind), expected)[0] <= 5e-7  # the reference's accuracy
    opening, rate = worst_opening(robot, run)
    assert opening <= 1e-9
    assert rate <= 1e-8
    assert run.energy_drift <= 1e-8


@pytest.mark.parametrize(
    ('table', 'kind'), [('four_bar', 'FFF'), ('five_bar', 'FRRF'), ('rssr', 'FFF')]
)
def test_flexible_mechanisms_keep_loops_and_energy(table: str, kind: str) -> None:
    robot = loaded(table, kind)
    run = book_fall(robot, table, np.linspace(0.0, 0.05, 26), rtol=1e-6, atol=1e-8)
    opening, rate = worst_opening(robot, run)
    assert opening <= 1e-9
    assert rate <= 1e-8
    total = run.energy.sum(axis=1)
    # of the energy that 2.5 s set free, some 10 J: little has moved in 0.05 s
    assert np.max(np.abs(total - total[0])) <= 1e-6
    strain = np.max(np.abs(run.q[:, robot.flexible_indices]))
    assert strain > 1e-6  # m: they do bend


def test_accelerations_along_a_run_are_the_oracles() -> None:
    robot, h = loaded('four_bar', 'RRF'), 2e-5
    times = np.array([0.0, 0.02 - h, 0.02, 0.02 + h])
    run = book_fall(robot, 'four_bar', times, rtol=1e-10, atol=1e-12)
    oracle = LoopOracle(robot.tree, DOWN)
    expected, _, _ = oracle.constrained_forward_dynamics(run.q[2], run.qd[2], np.zeros(robot.n))
    # truncation (w h)^2 / 6 of the fastest vibration, w = 4000 rad/s
    bound = 2e-3 * np.max(np.abs(expected))
    np.testing.assert_allclose((run.qd[3] - run.qd[1]) / (2 * h), expected, atol=bound)


def mirrored(run: Run, robot: dn.Robot) -> float:
    """How far the second arm of the five-bar is from the mirror image of the first [m, rad]."""
    first = [robot.amplitudes(f'link_{k}') for k in (1, 2)]
    second = [robot.amplitudes(f'link_{k}') for k in (3, 4)]
    worst = 0.0
    for one, other in zip(first, second, strict=True):
        worst = max(worst, float(np.max(np.abs(run.q[:, one] + run.q[:, other]))))
    return worst


def test_arms_of_the_five_bar_mirror_each_other() -> None:
    robot = loaded('five_bar', 'FFFF')
    run = book_fall(robot, 'five_bar', np.linspace(0.0, 0.05, 26), rtol=1e-7)
    assert np.max(np.abs(run.q[:, robot.flexible_indices])) > 1e-5
    assert mirrored(run, robot) <= 1e-9
    np.testing.assert_allclose(
        run.coordinate('joint_1') + run.coordinate('joint_3'), np.pi, atol=1e-9
    )


def crank_motion(cut: int, times: Array) -> tuple[Array, Array]:
    """Crank angle over time, and its torque at a moving posture, of the four-bar cut somewhere."""
    robot, q = cut_four_bar(cut)
    run = dn.simulate(robot, q, np.zeros(robot.n), times, rtol=1e-11, atol=1e-12)
    qd = robot.assemble_rates(q, np.full(robot.n, 2.0), ['crank_joint'])
    torque, _, _ = robot.constrained_hybrid_dynamics(q, qd, np.array([3.0]), ['crank_joint'])
    return run.coordinate('crank_joint'), torque


@pytest.mark.parametrize('cut', [2, 3])
def test_any_cut_of_the_rigid_four_bar_gives_the_same_motion_and_torque(cut: int) -> None:
    times = np.linspace(0.0, 0.6, 13)
    (angle, torque), (expected, needed) = crank_motion(cut, times), crank_motion(4, times)
    assert np.ptp(expected) > 1.0
    np.testing.assert_allclose(angle, expected, atol=1e-8)
    np.testing.assert_allclose(torque, needed, rtol=1e-9)


def swing(t: float) -> tuple[float, float, float]:
    return 0.3 * np.sin(2.0 * t), 0.6 * np.cos(2.0 * t), -1.2 * np.sin(2.0 * t)


def test_torque_of_a_prescribed_crank_reproduces_its_motion() -> None:
    robot = loaded('four_bar', 'RRR')
    q = closed_start(robot, START['four_bar'])
    qd = robot.assemble_rates(q, np.array([0.6, 0.0, 0.0]), ['joint_1'])
    times = np.linspace(0.0, 0.5, 501)

    def load(_t: float, _q: Array, _qd: Array) -> Array:
        return np.array([0.0, 0.5, 0.0])  # beside the crank's

    driven = dn.simulate(
        robot, q, qd, times, torque=load, prescribed={'joint_1': swing}, rtol=1e-10
    )
    np.testing.assert_allclose(driven.q[:, 0], [swing(t)[0] for t in times], atol=1e-15)
    assert worst_opening(robot, driven)[0] <= 1e-9

    def torque(t: float, _q: Array, _qd: Array) -> Array:
        return np.array([np.interp(t, times, driven.torque[:, 0]), 0.5, 0.0])

    again = dn.simulate(robot, q, qd, times[::50], torque=torque)
    np.testing.assert_allclose(again.q, driven.q[::50], atol=2e-5)  # torque interpolated over 1 ms
    power = np.sum(driven.torque * driven.qd, axis=1)
    work = np.sum(0.5 * (power[1:] + power[:-1]) * np.diff(times))
    total = driven.energy.sum(axis=1)
    assert total[-1] - total[0] == pytest.approx(work, rel=1e-5)  # trapezoids of 1 ms


def open_start(robot: dn.Robot) -> dict[str, Any]:
    return {'q0': np.array(START['four_bar']) + [0.0, 1e-3, 0.0]}


def open_rates(robot: dn.Robot) -> dict[str, Any]:
    return {'qd0': np.array([1.0, 0.0, 0.0])}


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (open_start, "position of 'joint_[123]' at the start must be"),
        (open_rates, "rate of 'joint_[123]' at the start must be"),
        (lambda _: {'method': 'LSODA'}, "method must be one of DOP853, RK45, Radau, got 'LSODA'"),
    ],
)
def test_bad_starts_and_methods_are_refused(
    change: Callable[[dn.Robot], dict[str, Any]], message: str
) -> None:
    robot = loaded('four_bar', 'RRR')
    arguments = {'q0': closed_start(robot, START['four_bar']), 'qd0': np.zeros(3)}
    with pytest.raises(dn.StateError, match=message):
        dn.simulate(robot, t=np.linspace(0.0, 0.1, 2), **{**arguments, **change(robot)})


def test_prescribed_motion_that_no_closed_loop_has_is_a_solver_error() -> None:
    robot = loaded('four_bar', 'RRR')
    q = closed_start(robot, START['four_bar'])
    joints = {
        'joint_1': lambda t: (t, 1.0, 0.0),
        'joint_2': lambda _t: (q[1], 0.0, 0.0),
        'joint_3': lambda _t: (q[2], 0.0, 0.0),
    }
    start = np.array([1.0, 0.0, 0.0])
    with pytest.raises(dn.DenocError, match=r'loops must close|contradict'):
        dn.simulate(robot, q, start, np.linspace(0.0, 0.1, 3), prescribed=joints)
