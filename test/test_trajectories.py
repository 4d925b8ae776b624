"""Desired motions: exact derivatives, continuity, holding."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from denoc_ros.errors import ConfigError
from denoc_ros.simulation.reference_motion import trajectory_from_config
from denoc_ros.trajectories import CycloidalTrajectory, SplineTrajectory, Trajectory

JOINTS = ('a', 'b')
KINDS: dict[str, dict[str, Any]] = {
    'full': {'kind': 'book', 'rate': [0.3, 0.1], 'period': 4.0, 'start': [0.5, -1.0]},
    'half': {'kind': 'book', 'rate': [0.3, 0.1], 'period': [4.0, 2.0], 'form': 'half'},
    'sine': {
        'kind': 'sine',
        'amplitude': [0.3, 0.1],
        'frequency': [0.5, 1.0],
        'phase': 0.3,
        'duration': 6.0,
    },
    'points': {
        'kind': 'points',
        'times': [0.0, 1.0, 2.5, 4.0],
        'positions': [[0.0, 1.0], [1.0, 0.0], [0.5, 0.5], [0.0, 1.0]],
    },
}


def at(trajectory: Trajectory, t: float) -> tuple[Any, Any, Any]:
    q, qd, qdd = np.zeros((3, trajectory.n))
    trajectory.sample(t, q, qd, qdd)
    return q, qd, qdd


@pytest.mark.parametrize('kind', KINDS)
def test_derivatives_are_those_of_the_position(kind: str) -> None:
    trajectory = trajectory_from_config(KINDS[kind], JOINTS)
    h = 1e-4
    for t in np.linspace(0.1, 0.97, 7) * trajectory.duration:
        (before, rate_before, _), (after, rate_after, _) = (
            at(trajectory, float(t) + sign * h) for sign in (-1.0, 1.0)
        )
        _, qd, qdd = at(trajectory, float(t))
        # central differences err by h^2 / 6 times the third derivative
        np.testing.assert_allclose((after - before) / (2 * h), qd, atol=1e-6)
        np.testing.assert_allclose((rate_after - rate_before) / (2 * h), qdd, atol=1e-6)


@pytest.mark.parametrize('kind', KINDS)
def test_it_starts_and_ends_at_rest_and_holds(kind: str) -> None:
    trajectory = trajectory_from_config(KINDS[kind], JOINTS)
    eps = 1e-9
    for edge, beyond in ((eps, -1.0), (trajectory.duration - eps, trajectory.duration + 1.0)):
        q, qd, _ = at(trajectory, edge)
        held, held_rate, held_acceleration = at(trajectory, beyond)
        np.testing.assert_allclose(qd, 0.0, atol=1e-7)
        np.testing.assert_allclose(held, q, atol=1e-7)
        assert not held_rate.any()
        assert not held_acceleration.any()


def test_book_half_form_is_equation_3_56() -> None:
    t, k, period = 3.0, np.array([0.075, 0.05]), np.array([10.0, 5.0])
    q, _, _ = at(CycloidalTrajectory(np.zeros(2), k, period, 'half'), t)
    np.testing.assert_allclose(q, k * (t - period / np.pi * np.sin(np.pi * t / period)))


def test_sampled_table_reproduces_the_motion() -> None:
    motion = trajectory_from_config(KINDS['full'], JOINTS)
    spline = SplineTrajectory(*motion.table(0.02))
    for t in (0.0, 0.013, 1.001, 3.99):
        for ours, exact, tolerance in zip(
            at(spline, t), at(motion, t), (1e-12, 1e-10, 1e-7), strict=True
        ):
            np.testing.assert_allclose(ours, exact, atol=tolerance)


@pytest.mark.parametrize('given', ['positions', 'velocities', 'all'])
def test_spline_is_twice_continuous_at_its_knots(given: str) -> None:
    rng = np.random.default_rng(0)
    times = np.array([0.0, 0.7, 1.0, 2.2])
    q, qd, qdd = rng.normal(size=(3, 4, 2))
    rows = {'positions': (q,), 'velocities': (q, qd), 'all': (q, qd, qdd)}[given]
    spline = SplineTrajectory(times, *rows)
    for t in times[1:-1]:
        for left, right in zip(at(spline, t - 1e-9), at(spline, t + 1e-9), strict=True):
            np.testing.assert_allclose(left, right, atol=1e-5)


def test_late_first_point_is_reached_from_the_given_start() -> None:
    start = (np.array([1.0]), np.array([0.5]), np.array([0.2]))
    spline = SplineTrajectory(np.array([2.0]), np.array([[3.0]]), start=start)
    q, qd, _ = at(spline, 0.0)
    assert (q[0], qd[0]) == (1.0, 0.5)
    assert at(spline, 2.0)[0][0] == pytest.approx(3.0)


def test_joints_by_name_leave_the_others_at_zero() -> None:
    values = {'kind': 'book', 'joints': ['b'], 'rate': [0.1], 'period': 2.0}
    q, _, _ = at(trajectory_from_config(values, JOINTS), 2.0)
    np.testing.assert_allclose(q, [0.0, 0.2])


def test_every_finding_of_a_bad_reference_is_named() -> None:
    values = {'kind': 'book', 'rate': [1.0, 2.0, 3.0], 'period': -1.0, 'form': 'third'}
    with pytest.raises(ConfigError) as caught:
        trajectory_from_config(values, JOINTS)
    text = str(caught.value)
    for part in ('rate must be a number or 2 numbers', 'period must be > 0 s', 'form must be'):
        assert part in text
    with pytest.raises(ConfigError, match='kind must be one of'):
        trajectory_from_config({'kind': 'jump'}, JOINTS)
    with pytest.raises(ConfigError, match='period must be given'):
        trajectory_from_config({'kind': 'book', 'rate': 1.0}, JOINTS)
    with pytest.raises(ConfigError, match='times must increase'):
        trajectory_from_config({**KINDS['points'], 'times': [0.0, 2.0, 1.0, 3.0]}, JOINTS)


@pytest.mark.parametrize('whole', [True, False])
def test_knots_make_the_same_spline(whole: bool) -> None:
    times = np.array([0.0, 0.4, 0.5, 1.3])
    rows = np.random.default_rng(3).normal(size=(3, 4, 2))
    spline = SplineTrajectory(times, *(rows if whole else rows[:1]))
    again = SplineTrajectory(*spline.knots())
    for one, other in zip(spline.table(0.05), again.table(0.05), strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-9)


def test_knots_of_a_posture_hold_it() -> None:
    spline = SplineTrajectory(np.zeros(1), np.array([[0.3, -0.2]]))
    again = SplineTrajectory(*spline.knots())
    assert again.duration == 0.0
    for one, other in zip(spline.table(0.05), again.table(0.05), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize('order', ['C', 'F'])
def test_a_spline_is_sampled_as_its_rows_are(order: Any) -> None:
    random = np.random.default_rng(3)
    times = np.cumsum(random.uniform(0.01, 1.0, 9))
    points = [np.array(random.standard_normal((9, 4)), order=order) for _ in range(3)]
    for velocities, accelerations in ((None, None), (points[1], None), (points[1], points[2])):
        spline = SplineTrajectory(times, points[0], velocities, accelerations)
        moments = np.concatenate(([0.0], times, random.uniform(0.0, times[-1], 200)))
        moments = moments[moments < spline.duration]
        rows = spline.rows(moments)
        for k, moment in enumerate(moments):
            found = np.zeros((3, 4))
            spline.sample(float(moment), *found)
            for one, row in zip(found, rows, strict=True):
                np.testing.assert_allclose(one, row[k], rtol=1e-9, atol=1e-9)
