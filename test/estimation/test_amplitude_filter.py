"""The covariance of the amplitudes against dense algebra that knows nothing of it."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from planar_chains import PlanarLink, planar_chain

import denoc_ros as dn
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.estimation.amplitude_filter import AmplitudeFilter
from denoc_ros.types import Array

STEP = 1e-3
ARM = (PlanarLink(1.0, 2.0, 150.0), PlanarLink(0.8, 1.0, 60.0))
POSTURE = np.array([-0.4, 0.7])


def arm() -> dn.Robot:
    return dn.load_robot(planar_chain(ARM, 2, damping_ratio=0.02), gravity=(0, 0, 0))


def made(held: bool = True) -> AmplitudeFilter:
    robot = arm()
    free = robot.flexible_indices if held else np.arange(robot.n)
    found = AmplitudeFilter(robot, STEP, 0.2, 0.01, free)
    q = np.zeros(robot.n)
    q[robot.joint_indices] = POSTURE
    found.reset(q)
    return found


@pytest.mark.parametrize('held', [True, False])
def test_a_correction_is_carried_as_the_model_steps(held: bool) -> None:
    robot, covariance = arm(), made(held)
    flexible, m = robot.flexible_indices, len(robot.flexible_indices)
    stepper = Stepper(robot, STEP)
    # small enough for what is not linear (1e-12 of 1e-6), large against rounding
    change: Array = 1e-6 * np.concatenate((np.ones(m), np.arange(1.0, m + 1), np.full(m, -50.0)))
    ends = []
    for share in (1.0, -1.0):
        q, qd, tau = np.zeros((3, robot.n))
        q[robot.joint_indices] = POSTURE
        q[flexible], qd[flexible] = share * change[:m], share * change[m : 2 * m]
        # the loads decay over the step: their mean acts
        tau[flexible] = share * change[2 * m :] * 0.5 * (1.0 + covariance.decay)
        if held:
            stepper.driven(q, qd, np.zeros(2), tau)
        else:
            stepper.free(q, qd, tau)
        ends.append(np.concatenate((q[flexible], qd[flexible])))
    stepped = 0.5 * (ends[0] - ends[1])
    got = covariance.carry(change)[: 2 * m]
    # the loads' share of a step is of second order in their decay (7 mrad): 1e-4
    np.testing.assert_allclose(got, stepped, rtol=1e-4, atol=1e-4 * np.abs(stepped[:m]).max())


def test_values_one_by_one_correct_as_all_at_once() -> None:
    covariance = made()
    m = covariance.covariance.shape[0] // 3
    rng = np.random.default_rng(5)
    rows, noise = rng.standard_normal((3, m)), np.array([1e-3, 2e-3, 5e-4])
    state, values = 1e-3 * rng.standard_normal(3 * m), 1e-3 * rng.standard_normal(3)
    before, expected = covariance.covariance.copy(), state.copy()
    lag = 2 * STEP
    wide = np.hstack((rows, -lag * rows, np.zeros((3, m))))
    seen = wide @ before @ wide.T + np.diag(noise**2)
    gain = before @ wide.T @ np.linalg.inv(seen)
    expected += gain @ (values - wide @ state)
    taken = covariance.correct_rows(wide, noise, values, np.inf, state)
    assert taken.all()
    # rounding, as the condition of `seen` lets it grow
    np.testing.assert_allclose(state, expected, rtol=1e-7, atol=1e-12)
    after = before - gain @ wide @ before
    np.testing.assert_allclose(
        covariance.covariance, after, atol=1e-9 * np.abs(np.diag(before)).max()
    )


def test_value_beyond_the_gate_changes_nothing() -> None:
    covariance = made()
    m = covariance.covariance.shape[0] // 3
    row, noise = np.eye(1, 3 * m), np.array([1e-4])
    before, state = covariance.covariance.copy(), np.zeros(3 * m)
    deviation = float(np.hypot(np.sqrt(before[0, 0]), noise[0]))
    taken = covariance.correct_rows(row, noise, np.array([5.1 * deviation]), 5.0, state)
    assert not taken.any()
    assert not state.any()
    np.testing.assert_array_equal(covariance.covariance, before)
    assert covariance.correct_rows(row, noise, np.array([4.9 * deviation]), 5.0, state).all()


def test_covariance_stays_symmetric_and_positive() -> None:
    covariance = made()
    m = covariance.covariance.shape[0] // 3
    row, noise = np.zeros((1, 3 * m)), np.array([1e-5])
    row[0, :2] = 1.0, -2.0
    covariance.set_floor(row[:, :m], noise)
    state = np.zeros(3 * m)
    for _ in range(20000):
        covariance.predict(state[:m], state[m : 2 * m])
        covariance.correct_rows(row, noise, np.zeros(1), 5.0, state)
    found = covariance.covariance
    scale = np.sqrt(np.diag(found))
    correlation = found / np.outer(scale, scale)
    # 20 s of rounding at 1e-16 per step
    assert np.abs(correlation - correlation.T).max() < 1e-9
    assert scipy.linalg.eigvalsh(correlation)[0] > -1e-9


def test_initial_energy_is_shared_equally() -> None:
    robot, covariance = arm(), made()
    flexible, m = robot.flexible_indices, len(robot.flexible_indices)
    q = np.zeros(robot.n)
    q[robot.joint_indices] = POSTURE
    inertia = robot.inertia_matrix(q)[np.ix_(flexible, flexible)]
    first = covariance.stiffness[0] * (0.01 * ARM[0].length) ** 2
    link = slice(0, 2)
    elastic = np.diag(covariance.covariance)[link] * covariance.stiffness[link]
    np.testing.assert_allclose(elastic, first, rtol=1e-12)
    second = covariance.stiffness[2] * (0.01 * ARM[1].length) ** 2
    rates = covariance.covariance[m : 2 * m, m : 2 * m]
    np.testing.assert_allclose(np.trace(inertia @ rates), 2 * (first + second), rtol=0.5)


@pytest.mark.parametrize('size', [1e80, 1e200])
def test_a_state_that_has_left_all_bounds_is_refused(size: float) -> None:
    found = made()
    q = np.zeros(arm().n)
    q[arm().flexible_indices] = size
    q[arm().joint_indices] = 1.0
    with (
        np.errstate(all='ignore'),
        pytest.raises(dn.StateError, match=r'chain: the model must vibrate|finite'),
    ):
        found.linearize(q)
