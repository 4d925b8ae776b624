"""Motions that are stopped on their way."""

from __future__ import annotations

import numpy as np
import pytest

from denoc_ros.runtime.reference.braking import brake, slowed
from denoc_ros.trajectories import CycloidalTrajectory, SplineTrajectory

RNG = np.random.default_rng(7)
TIMES = np.linspace(0.0, 3.0, 7)
MOTION = SplineTrajectory(TIMES, np.cumsum(RNG.uniform(-0.3, 0.5, (7, 3)), axis=0))


def test_rows_are_the_samples() -> None:
    times, q, qd, qdd = MOTION.table(0.01)
    one = np.zeros((3, 3))
    for k, t in enumerate(times[:-1]):
        MOTION.sample(float(t), *one)
        np.testing.assert_allclose((q[k], qd[k], qdd[k]), one, rtol=1e-9, atol=1e-9)
    cycloid = CycloidalTrajectory(np.zeros(2), np.ones(2), np.full(2, 2.0))
    assert cycloid.table(0.1)[1].shape == (21, 2)


@pytest.mark.parametrize('moment', [0.1, 1.0, 1.7])
def test_a_braking_begins_in_motion_and_ends_at_rest(moment: float) -> None:
    t, q, qd, qdd = slowed(MOTION, moment, 0.8, 0.01)
    start = np.zeros((3, 3))
    MOTION.sample(moment, *start)
    np.testing.assert_allclose((q[0], qd[0], qdd[0]), start, atol=1e-9)
    assert np.abs((qd[-1], qdd[-1])).max() < 1e-12
    assert t[-1] == pytest.approx(0.8)
    np.testing.assert_allclose(q[-1], MOTION.rows(np.array([moment + 0.4]))[0][0], atol=1e-12)


def test_rates_and_accelerations_are_the_derivatives() -> None:
    t, q, qd, qdd = slowed(MOTION, 1.0, 0.8, 1e-4)
    np.testing.assert_allclose(np.gradient(q, t, axis=0)[2:-2], qd[2:-2], atol=1e-4)
    np.testing.assert_allclose(np.gradient(qd, t, axis=0)[2:-2], qdd[2:-2], atol=1e-2)


def test_no_joint_is_faster_than_on_the_path() -> None:
    t, _, qd, _ = slowed(MOTION, 0.3, 1.5, 0.01)
    assert (np.abs(qd).max(axis=0) <= np.abs(MOTION.table(0.001)[2]).max(axis=0)).all()
    assert t[-1] == pytest.approx(1.5)


def test_the_shortest_braking_that_is_allowed_is_taken() -> None:
    most = 2.0 * np.abs(MOTION.table(0.01)[3]).max()
    found = brake(MOTION, 1.0, 0.05, 0.01, lambda q, qd, qdd: bool(np.abs(qdd).max() <= most))
    assert found is not None
    t, _, _, qdd = found
    assert np.abs(qdd).max() <= most
    assert np.abs(slowed(MOTION, 1.0, t[-1] / 1.25, 0.01)[3]).max() > most
    assert brake(MOTION, 2.9, 0.3, 0.01, lambda *_: True) is None  # at rest before
    assert brake(MOTION, 1.0, 0.3, 0.01, lambda *_: False) is None
