"""Laws of the tracking filter."""

from __future__ import annotations

import numpy as np
import pytest

from denoc_ros.estimation.joint_tracker import TrackingFilter

STEP = 1e-3


@pytest.mark.parametrize('rates', [True, False])
@pytest.mark.parametrize('interval', [1e-3, 8e-3])
def test_constant_acceleration_is_followed_without_lag(rates: bool, interval: float) -> None:
    tracker = TrackingFilter(1, cutoff=5.0)
    times = np.arange(0.0, 2.0, interval)  # 2 s are 63 time constants of the filter
    for t in times:
        q, qd = np.array([1.5 * t * t]), np.array([3.0 * t])
        tracker.update(q, qd if rates else None, interval)
    end = times[-1]
    np.testing.assert_allclose(
        [tracker.q[0], tracker.qd[0], tracker.qdd[0]], [1.5 * end**2, 3.0 * end, 3.0], rtol=1e-6
    )


def test_lower_cutoff_lets_less_noise_through() -> None:
    noise = np.random.default_rng(3).standard_normal((2000, 1))
    spread = {}
    for cutoff in (5.0, 50.0):
        tracker, rates = TrackingFilter(1, cutoff), []
        for value in noise:
            tracker.update(np.zeros(1), value, STEP)
            rates.append(tracker.qd[0])
        spread[cutoff] = np.std(rates)
    assert spread[5.0] < 0.5 * spread[50.0] < 0.5
