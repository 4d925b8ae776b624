"""Lag, bias, shares, friction and thinned curves: known numbers come out, block by block."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from denoc_ros.simulation.recorded.agreement import BINS, Comparison, Shares, Traces
from denoc_ros.simulation.recorded.residual_friction import FrictionFitter
from denoc_ros.types import Array

PERIOD = 0.008
EDGES = (0, 700, 1500, 3000)


def wander(t: Array) -> Array:
    """A smooth curve without a period of its own within the record."""
    return np.asarray(np.sin(3.0 * t) + 0.5 * np.sin(7.3 * t + 1.0) + 0.2 * np.sin(17.1 * t))


def compared(t: Array, measured: Array, computed: Array) -> Comparison:
    comparison = Comparison(measured.shape[1], PERIOD)
    for a, b in itertools.pairwise(EDGES):
        starts = np.zeros(b - a, dtype=bool)
        comparison.add(t[a:b], measured[a:b], computed[a:b], starts)
    return comparison


def test_lag_is_found_between_samples() -> None:
    t = PERIOD * np.arange(EDGES[-1], dtype=np.float64)
    lags = np.array([0.0, 0.02, -0.0133, 0.1])
    measured = np.column_stack([wander(t - lag) for lag in lags]) * [1.0, 5.0, 2.0, 1.0] + 3.0
    computed = np.repeat(wander(t)[:, None], len(lags), axis=1)
    # linear interpolation and the parabola through three: some hundredths of a period
    np.testing.assert_allclose(
        compared(t, measured, computed).result().lag, lags, rtol=0, atol=0.05 * PERIOD
    )


def test_curves_that_are_not_alike_have_no_lag() -> None:
    t = PERIOD * np.arange(EDGES[-1], dtype=np.float64)
    noise = np.random.default_rng(0).standard_normal((len(t), 1))
    lag = compared(t, np.hstack([noise, np.ones((len(t), 1))]), np.ones((len(t), 2))).result().lag
    assert np.isnan(lag).all()


def test_rms_and_bias_leave_out_what_is_not_known() -> None:
    t = PERIOD * np.arange(EDGES[-1], dtype=np.float64)
    computed = wander(t)[:, None] * [1.0, 1.0, 1.0]
    measured = computed + [0.0, 2.0, 1.0]
    measured[::2, 1] = np.nan
    measured[:, 2] = np.nan
    found = compared(t, measured, computed).result()
    assert found.samples.tolist() == [len(t), len(t) // 2, 0]
    np.testing.assert_allclose(found.bias, [0.0, 2.0, np.nan], atol=1e-12)
    np.testing.assert_allclose(found.rms, [0.0, 2.0, np.nan], atol=1e-12)
    expected = np.sqrt(np.mean(measured[1::2, 1] ** 2))
    np.testing.assert_allclose(found.measured_rms[1], expected, rtol=1e-12)
    assert found.measured_peak[1] == np.nanmax(np.abs(measured[:, 1]))


def test_shares_add_up_to_one_and_give_an_exact_part_its_share() -> None:
    rng = np.random.default_rng(2)
    parts = {name: rng.standard_normal((900, 2)) for name in ('gravity', 'inertia')}
    rest = 0.1 * rng.standard_normal((900, 2))
    y = parts['gravity'] + parts['inertia'] + rest
    shares = Shares(2)
    for rows in (slice(0, 400), slice(400, 900)):
        shares.add(y[rows], {name: part[rows] for name, part in parts.items()})
    found = shares.result()
    np.testing.assert_allclose(np.sum(list(found.values()), axis=0), 1.0, atol=1e-12)
    mean_square = np.mean(y**2, axis=0)
    np.testing.assert_allclose(
        found['unexplained'], np.mean(rest * y, axis=0) / mean_square, atol=1e-12
    )
    whole = Shares(1)
    whole.add(y[:, :1], {'all': y[:, :1]})
    assert whole.result()['all'] == pytest.approx(1.0)


def fitted_friction(seed: int) -> tuple[FrictionFitter, Array]:
    """Rates like an excitation's, residuals that hang together for a fifth of a second."""
    rng = np.random.default_rng(seed)
    t = PERIOD * np.arange(3750, dtype=np.float64)
    phases = rng.uniform(0.0, 6.0, 3)
    qd = np.column_stack([np.sin(0.9 * t + p) + 0.6 * np.sin(2.1 * t + 2.0 * p) for p in phases])
    qd[:, 2] = 0.0
    noise = rng.standard_normal((len(t) // 25, 3)).repeat(25, axis=0)
    truth = np.array([[20.0, 12.0, 0.5], [3.0, 0.0, -1.0], [0.0, 0.0, 2.0]])
    rest = truth[:, 0] * qd + truth[:, 1] * np.tanh(qd / 1e-3) + truth[:, 2] + noise
    fitter = FrictionFitter(3)
    for rows in np.array_split(np.arange(len(t)), 4):
        starts = np.arange(len(t))[rows] == 0
        fitter.add(t[rows], qd[rows], rest[rows], starts)
    return fitter, truth


def test_friction_is_found_within_what_its_errors_say() -> None:
    seen = []
    for seed in range(40):
        fitter, truth = fitted_friction(seed)
        fit = fitter.fit()
        found = np.stack(list(vars(fit.friction).values()), axis=1)
        seen.append(((found - truth) / fit.by_window)[:2])
        # the joint that stands still has an offset and nothing else
        assert found[2, :2].tolist() == [0.0, 0.0]
        assert np.isnan(fit.by_window[2, :2]).all()
        assert found[2, 2] == pytest.approx(2.0, abs=0.3)
        assert (fit.explained[:2] > 0.5).all()
    # 240 values in 30 windows: 95 % of them within 2.05 if errors are right, five sigma below
    assert np.mean(np.abs(seen) < 2.05) > 0.88
    # residuals that hang together for 25 samples make formal errors five times too small
    assert np.mean(fit.by_window[:2] / fit.formal[:2]) > 2.0


def test_traces_stay_small_and_keep_extremes_and_every_stretch() -> None:
    traces = Traces(['a', 'b'])
    rng = np.random.default_rng(0)
    values = rng.standard_normal((50_000, 2))
    values[31_417, 1] = 9.0
    values[100:200, 0] = np.nan
    t = 0.001 * np.arange(len(values), dtype=np.float64)
    for rows in np.array_split(np.arange(len(t)), 23):
        traces.add(t[rows], values[rows])
        assert len(traces.curve('a')[0]) <= 2 * BINS + 2
    time, curve = traces.curve('b')
    assert curve.max() == 9.0
    assert time[np.argmax(curve)] == pytest.approx(31.417, abs=50.0 / BINS * 2)
    assert np.nanmin(traces.curve('a')[1]) == np.nanmin(values[:, 0])
    assert np.diff(time).max() < 2 * 50.0 / BINS * 1.01


def test_short_curves_are_left_as_they_are() -> None:
    traces = Traces(['a'])
    for k in range(3):
        traces.add(np.array([k, k + 0.5]), np.array([[1.0 * k], [-1.0]]))
    time, curve = traces.curve('a')
    assert time.tolist() == [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
    assert curve.tolist() == [0.0, -1.0, 1.0, -1.0, 2.0, -1.0]
