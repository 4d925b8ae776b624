"""Laws of the input shapers' impulse sequences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from denoc_ros.errors import StateError
from denoc_ros.planning.shapers.impulses import (
    METHODS,
    TOLERATED_SWING,
    Impulses,
    impulse_weights,
    modes_shaper,
    shaper,
)

RATIOS = st.floats(0.0, 0.4)
FREQUENCIES = st.floats(0.1, 100.0)


def ringing(impulses: Impulses, frequency: float, ratio: float) -> float:
    """Return the swing that steps of the impulses leave, on that of one step, by integration.

    The oscillator's exact response, sampled: nothing of the closed form is used.
    """
    omega = 2.0 * np.pi * frequency
    damped = omega * np.sqrt(1.0 - ratio**2)

    def state(after: float) -> np.ndarray:
        # of x'' + 2 zeta omega x' + omega^2 x = 0 from x = 0, x' = 1
        fall = np.exp(-ratio * omega * after)
        position = fall * np.sin(damped * after) / damped
        rate = fall * (np.cos(damped * after) - ratio * omega / damped * np.sin(damped * after))
        return np.array([position, rate])

    last = impulses.delay
    whole = sum(
        weight * state(last - time)
        for time, weight in zip(impulses.times, impulses.weights, strict=True)
    )
    position, rate = np.asarray(whole)
    return float(np.hypot(damped * position, rate + ratio * omega * position))


@settings(max_examples=30, deadline=None)
@given(frequency=FREQUENCIES, ratio=RATIOS, method=st.sampled_from(METHODS))
def test_weights_sum_to_one_and_begin_now(frequency: float, ratio: float, method: str) -> None:
    impulses = shaper(method, frequency, ratio)
    assert impulses.weights.sum() == pytest.approx(1.0, abs=1e-12)
    assert (impulses.weights > 0.0).all()
    assert impulses.times[0] == 0.0
    half_periods = {'zv': 1, 'zvd': 2, 'ei': 2}[method]
    damped = frequency * np.sqrt(1.0 - ratio**2)
    assert impulses.delay == pytest.approx(0.5 * half_periods / damped)


@settings(max_examples=30, deadline=None)
@given(frequency=FREQUENCIES, ratio=RATIOS)
def test_zv_and_zvd_leave_nothing_at_their_frequency(frequency: float, ratio: float) -> None:
    for method in ('zv', 'zvd'):
        impulses = shaper(method, frequency, ratio)
        assert ringing(impulses, frequency, ratio) < 1e-12
        assert impulses.residual(frequency, ratio) < 1e-12


@settings(max_examples=30, deadline=None)
@given(share=st.floats(0.3, 1.9), ratio=RATIOS, method=st.sampled_from(METHODS))
def test_residual_is_the_closed_form(share: float, ratio: float, method: str) -> None:
    impulses = shaper(method, 2.0, ratio)
    left = ringing(impulses, 2.0 * share, ratio)
    assert impulses.residual(2.0 * share, ratio) == pytest.approx(left, abs=1e-12)


def test_undamped_residuals_are_the_textbooks_curves() -> None:
    shares = np.linspace(0.2, 1.8, 81)
    cosine = np.cos(0.5 * np.pi * shares)
    np.testing.assert_allclose(shaper('zv', 3.0).residual(3.0 * shares), abs(cosine), atol=1e-12)
    np.testing.assert_allclose(shaper('zvd', 3.0).residual(3.0 * shares), cosine**2, atol=1e-12)
    v = TOLERATED_SWING
    ei = 0.5 * (1.0 - v) + 0.5 * (1.0 + v) * np.cos(np.pi * shares)
    np.testing.assert_allclose(shaper('ei', 3.0).residual(3.0 * shares), abs(ei), atol=1e-12)


@pytest.mark.parametrize('ratio', [0.0, 0.05, 0.2])
def test_zvd_has_no_slope_and_zv_has_one(ratio: float) -> None:
    step = 1e-4
    zvd = shaper('zvd', 1.0, ratio).residual(1.0 + step, ratio) / step
    zv = shaper('zv', 1.0, ratio).residual(1.0 + step, ratio) / step
    assert zvd < 1e-2 < 0.5 < zv


@pytest.mark.parametrize('ratio', [0.0, 0.02, 0.1, 0.3])
def test_ei_leaves_its_share_at_its_frequency(ratio: float) -> None:
    left = shaper('ei', 1.7, ratio).residual(1.7, ratio)
    assert left == pytest.approx(TOLERATED_SWING, abs=1e-12)


def test_ei_stays_under_its_bound_over_its_band() -> None:
    v = TOLERATED_SWING
    # where the curve leaves the bound: cos(pi share) = -(1 - 3 v) / (1 + v)
    half = np.arccos((1.0 - 3.0 * v) / (1.0 + v)) / np.pi
    band = np.linspace(1.0 - half, 1.0 + half, 401)
    left = shaper('ei', 5.0).residual(5.0 * band)
    assert left.max() <= v + 1e-12
    assert shaper('ei', 5.0).residual(5.0 * (1.0 + 1.02 * half)) > v
    assert half > 0.19  # a band of 0.39, where ZVD's for 5 % is 0.29
    damped = shaper('ei', 5.0, 0.03).residual(5.0 * np.linspace(0.85, 1.15, 101), 0.03)
    assert damped.max() <= 1.1 * v


@settings(max_examples=30, deadline=None)
@given(
    method=st.sampled_from(METHODS),
    frequencies=st.lists(FREQUENCIES, min_size=1, max_size=4),
    ratio=RATIOS,
)
def test_several_modes_leave_each_at_rest(
    method: str, frequencies: list[float], ratio: float
) -> None:
    impulses = modes_shaper(method, frequencies, [ratio] * len(frequencies))
    assert impulses.weights.sum() == pytest.approx(1.0, abs=1e-12)
    assert (np.diff(impulses.times) >= 0.0).all()
    bound = TOLERATED_SWING if method == 'ei' else 0.0
    for frequency in frequencies:
        # what one mode's impulses leave, the other's cannot make more than 1 of
        assert impulses.residual(frequency, ratio) <= bound + 1e-9


def test_wrong_modes_are_refused() -> None:
    with pytest.raises(StateError, match='method must be one of zv, zvd, ei, got'):
        shaper('zvdd', 1.0)
    with pytest.raises(StateError, match='frequency must be > 0 Hz, got 0'):
        shaper('zv', 0.0)
    with pytest.raises(StateError, match='damping ratio must be >= 0 and < 1, got 1'):
        impulse_weights('zv', 1.0)
