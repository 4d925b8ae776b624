"""Laws of the tracking filter."""

from __future__ import annotations

import numpy as np
import pytest

from denoc_ros.estimation.tracking import TrackingFilter

STEP = 1e-3


def follow(tracker: TrackingFilter, rates: bool, age_steps: int = 0, every: int = 1) -> None:
    """Feed 2 s of constant acceleration, 3 rad/s^2, measured late and seldom."""
    for k in range(2001):
        if k % every == 0 and k >= age_steps:
            t = (k - age_steps) * STEP
            q, qd = np.array([1.5 * t * t]), np.array([3.0 * t])
            tracker.correct(q, qd if rates else None, age_steps * STEP, every * STEP)
        if k < 2000:
            tracker.advance(STEP)


@pytest.mark.parametrize('rates', [True, False])
@pytest.mark.parametrize('age_steps', [0, 20])
@pytest.mark.parametrize('every', [1, 8])
def test_constant_acceleration_is_followed_without_lag(
    rates: bool, age_steps: int, every: int
) -> None:
    tracker = TrackingFilter(1, cutoff=5.0)
    follow(tracker, rates, age_steps, every)
    # 2 s are 63 time constants of the filter.
    np.testing.assert_allclose(
        [tracker.q[0], tracker.qd[0], tracker.qdd[0]], [6.0, 6.0, 3.0], rtol=1e-6
    )


def test_lower_cutoff_lets_less_noise_through() -> None:
    noise = np.random.default_rng(3).standard_normal((2000, 1))
    spread = {}
    for cutoff in (5.0, 50.0):
        tracker, rates = TrackingFilter(1, cutoff), []
        for value in noise:
            tracker.advance(STEP)
            tracker.correct(np.zeros(1), value, 0.0, STEP)
            rates.append(tracker.qd[0])
        spread[cutoff] = np.std(rates)
    assert spread[5.0] < 0.5 * spread[50.0] < 0.5


def test_joint_that_is_not_measured_any_more_comes_to_rest() -> None:
    tracker = TrackingFilter(1, 10.0)
    tracker.reset(np.array([1.0]), np.array([2.0]))
    for _ in range(1000):
        tracker.slow_down(STEP / 0.05)
        tracker.advance(STEP)
    assert abs(tracker.qd[0]) < 1e-8
    assert tracker.q[0] == pytest.approx(1.0 + 2.0 * 0.05, rel=0.02)
