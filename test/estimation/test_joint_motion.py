"""Smoothed motion: exact on polynomials, not late, what the cutoff says, noise goes."""

from __future__ import annotations

import numpy as np
import pytest

from denoc_ros.errors import StateError
from denoc_ros.estimation.joint_motion import METHODS, settling, smooth
from denoc_ros.types import Array

RATE = 125.0


def uneven(count: int) -> Array:
    """Stamps with a tenth of the period of jitter."""
    rng = np.random.default_rng(3)
    stamps: Array = (np.arange(count) + rng.uniform(-0.1, 0.1, count)) / RATE
    return stamps


def sine(t: Array, frequency: float) -> tuple[Array, Array, Array]:
    w = 2.0 * np.pi * frequency
    s, c = np.sin(w * t)[:, None], np.cos(w * t)[:, None]
    return s, w * c, -w * w * s


@pytest.mark.parametrize('rates', [False, True])
def test_polynomials_are_exact_up_to_the_ends(rates: bool) -> None:
    t = uneven(300)
    power = np.polynomial.Polynomial([100.0, 1.0, -2.0, 0.5, 0.3, -0.2])
    q, qd, qdd = (power.deriv(k)(t)[:, None] if k else power(t)[:, None] for k in range(3))
    motion = smooth(t, q, qd if rates else None, 'filter', 10.0)
    # rounding of positions of 100 rad, divided by the square of half a window (0.1 s)
    np.testing.assert_allclose(motion.q, q, rtol=0, atol=1e-11)
    np.testing.assert_allclose(motion.qd, qd, rtol=0, atol=1e-9)
    np.testing.assert_allclose(motion.qdd, qdd, rtol=0, atol=1e-7)


@pytest.mark.parametrize('rates', [False, True])
@pytest.mark.parametrize('method', METHODS)
def test_slow_motion_passes_and_is_not_late(method: str, rates: bool) -> None:
    t = uneven(1500)
    q, qd, qdd = sine(t, 0.5)
    motion = smooth(t, q, qd if rates else None, method, 10.0)
    inside = slice(200, -200)
    # a delay of one sample alone would be off by 0.025 of the largest
    for found, true, share in (
        (motion.q, q, 1e-6),
        (motion.qd, qd, 1e-5),
        (motion.qdd, qdd, 1e-3),
    ):
        assert np.abs(found - true)[inside].max() < share * np.abs(true).max()


@pytest.mark.parametrize('method', METHODS)
def test_about_half_passes_at_the_cutoff_and_nothing_far_above(method: str) -> None:
    t = np.arange(3000) / RATE
    inside = slice(300, -300)
    gains = []
    for frequency in (5.0, 20.0):
        q, _, _ = sine(t, frequency)
        motion = smooth(t, q, None, method, 5.0)
        gains.append(np.abs(motion.q[inside]).max())
    assert 0.35 < gains[0] < 0.75
    # the smoother falls as (cutoff / f)^6; the polynomials have side lobes
    assert gains[1] < (0.01 if method == 'kalman' else 0.15)


def test_kalman_smoothing_is_the_formula_s() -> None:
    """1 / (1 + (f / cutoff)^6), for positions, rates and accelerations alike."""
    t = np.arange(4000) / RATE
    inside = slice(500, -500)
    for ratio in (0.5, 1.0, 1.5):
        true = sine(t, 2.0 * ratio)
        motion = smooth(t, true[0], None, 'kalman', 2.0)
        expected = 1.0 / (1.0 + ratio**6)
        for found, exact in zip(vars(motion).values(), true, strict=True):
            gain = np.sum(found[inside] * exact[inside]) / np.sum(exact[inside] ** 2)
            # the formula is that of continuous time; 30 to 60 samples a period
            assert gain == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize('method', METHODS)
def test_measured_rates_make_accelerations_better(method: str) -> None:
    t = uneven(1000)
    q, qd, qdd = sine(t, 0.5)
    rng = np.random.default_rng(1)
    q = q + 1e-4 * rng.standard_normal(q.shape)
    qd = qd + 1e-3 * rng.standard_normal(qd.shape)
    errors = [
        np.std((smooth(t, q, given, method, 10.0).qdd - qdd)[100:-100]) for given in (None, qd)
    ]
    assert errors[1] < 0.8 * errors[0]


@pytest.mark.parametrize('method', METHODS)
def test_samples_beyond_the_settling_time_do_not_matter(method: str) -> None:
    t = uneven(1200)
    q, qd, _ = sine(t, 1.0)
    reach = settling(method, 10.0, 1.0 / RATE)
    whole = smooth(t, q, qd, method, 10.0, 1.0 / RATE)
    cut = slice(600 - reach, 601 + reach)
    part = smooth(t[cut], q[cut], qd[cut], method, 10.0, 1.0 / RATE)
    # the smoother forgets as exp(-pi cutoff t): after 8 periods to 1e-11, of 40 rad/s^2
    for a, b in zip(vars(whole).values(), vars(part).values(), strict=True):
        np.testing.assert_allclose(b[reach], a[600], rtol=0, atol=1e-7)


@pytest.mark.parametrize('count', [1, 2, 3, 6])
@pytest.mark.parametrize('method', METHODS)
def test_few_samples_still_give_a_motion(method: str, count: int) -> None:
    t = np.arange(count) / RATE
    motion = smooth(t, 0.3 * t[:, None], None, method, 10.0)
    np.testing.assert_allclose(motion.q[:, 0], 0.3 * t, atol=1e-6)
    assert np.isfinite(motion.qdd).all()


def test_wrong_ways_are_refused() -> None:
    t, q = np.arange(9.0), np.zeros((9, 1))
    with pytest.raises(StateError, match='method must be one of filter, kalman, got'):
        smooth(t, q, None, 'spline', 1.0)
    with pytest.raises(StateError, match='cutoff must be > 0 Hz, got nan'):
        smooth(t, q, None, 'filter', np.nan)


@pytest.mark.parametrize('rate', [200.0, 1000.0])
def test_gaps_part_windows(rate: float) -> None:
    """Few samples beside one behind a gap of 0.9 s left a singular matrix, with a traceback."""
    t = np.arange(0.0, 4.0, 1.0 / rate)
    # stretches of 1 to 7 samples between gaps, then long ones
    kept = t < 0.5
    for k in range(7):
        first = int((0.5 + 0.4 * (k + 1)) * rate)
        kept[first : first + k + 1] = True
    kept |= t > 3.7
    t = t[kept]
    q = np.stack([np.sin(2.0 * t), t**2], axis=1)
    found = smooth(t, q, cutoff=20.0, period=1.0 / rate)
    np.testing.assert_allclose(found.q, q, atol=1e-4)
    for rows in (found.qd, found.qdd):
        assert np.isfinite(rows).all()
        assert np.abs(rows).max() < 10.0  # the truth: 8
    # a stretch is smoothed as if it were alone
    last = t > 3.7
    alone = smooth(t[last], q[last], cutoff=20.0, period=1.0 / rate)
    np.testing.assert_array_equal(found.qdd[last], alone.qdd)
