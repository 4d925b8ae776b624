"""Servos identified on synthetic truth."""

from __future__ import annotations

import numpy as np
import pytest

from denoc_ros.errors import IdentificationError
from denoc_ros.identification.servo.servo_fit import ServoFit, fit_servo_runs
from denoc_ros.planning.shapers.joint_servo import joint_servo
from denoc_ros.types import Array

STEP = 0.004


def commanded(duration: float = 6.0) -> tuple[Array, Array]:
    """Return times and two steps of minimum jerk with a pause."""
    t = np.arange(0.0, duration, STEP)

    def step(at: float, takes: float) -> Array:
        s = np.clip((t - at) / takes, 0.0, 1.0)
        return np.asarray(s**3 * (10.0 - 15.0 * s + 6.0 * s**2))

    return t, 0.2 + 0.5 * step(0.5, 0.5) - 0.8 * step(2.5, 0.3) + 0.1 * step(4.0, 0.2)


def fitted(
    truth: tuple[float, float, float], noise: float = 0.0, seed: int = 0, offset: float = 0.0
) -> tuple[ServoFit, Array]:
    t, command = commanded()
    fine = np.arange(0.0, t[-1] + STEP, STEP / 8)
    late = joint_servo(1, *truth).response(fine, np.interp(fine, t, command)[:, None])
    measured = np.interp(t, fine, late[:, 0]) + offset
    measured = measured + np.random.default_rng(seed).normal(0.0, noise, len(t))
    return fit_servo_runs('j1', [(t, command, measured)]), measured


@pytest.mark.parametrize(
    'truth', [(5.0, 0.5, 0.004), (2.0, 1.2, 0.03), (12.0, 0.8, 0.0), (8.0, 0.3, 0.1)]
)
def test_truth_is_found_without_noise(truth: tuple[float, float, float]) -> None:
    fit, measured = fitted(truth, offset=0.01)
    assert fit.bandwidth == pytest.approx(truth[0], rel=2e-3)
    assert fit.damping == pytest.approx(truth[1], rel=5e-3)
    assert fit.delay == pytest.approx(truth[2], abs=2e-4)
    assert fit.offset == pytest.approx(0.01, abs=1e-4)
    np.testing.assert_allclose(fit.fitted, measured, atol=1e-4)
    assert fit.verdict == 'good'


@pytest.mark.long
def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    truth = 5.0, 0.5, 0.004
    held = np.zeros(3)
    for seed in range(24):
        fit, _ = fitted(truth, noise=1e-3, seed=seed)
        for k, name in enumerate(('bandwidth', 'damping', 'delay')):
            low, high = fit.interval[name]
            held[k] += low <= truth[k] <= high
    # of 24 at 95 %: 19 or more with probability 0.9994 each
    assert (held >= 19).all(), held
    assert fit.verdict == 'good'
    assert fit.residual == pytest.approx(1e-3, rel=0.1)


def test_record_may_begin_in_motion() -> None:
    t, command = commanded()
    fine = np.arange(0.0, t[-1] + STEP, STEP / 8)
    late = joint_servo(1, 5.0, 0.5, 0.02).response(fine, np.interp(fine, t, command)[:, None])
    part = t > 0.7
    measured = np.interp(t, fine, late[:, 0])
    fit = fit_servo_runs('j1', [(t[part], command[part], measured[part])])
    assert fit.bandwidth == pytest.approx(5.0, rel=0.05)
    assert fit.delay == pytest.approx(0.02, abs=2e-3)


def test_what_cannot_be_told_is_said() -> None:
    t, command = commanded()
    exact = fit_servo_runs('j1', [(t, command, command)])
    assert exact.verdict == 'not identifiable'
    rough = np.random.default_rng(0).normal(0.0, 0.3, len(t))
    assert fit_servo_runs('j1', [(t, command, command + rough)]).verdict == 'not identifiable'
    # a joint that turns a quarter of what it is told to is no servo of this kind
    wrong = fit_servo_runs('j1', [(t, command, 0.75 * command)])
    assert wrong.verdict != 'good'
    with pytest.raises(IdentificationError, match='50 samples of a command that moves by'):
        fit_servo_runs('j1', [(t, np.zeros(len(t)), command)])
    with pytest.raises(IdentificationError, match='got 20 of one that moves by'):
        fit_servo_runs('j1', [(t[:20], np.linspace(0.0, 1.0, 20), command[:20])])


def rough_run(seed: int, gain: float = 1.0) -> tuple[Array, Array, Array]:
    """Return a run of an arm as those are: slow motion, 100 Hz, friction and sag in the position.

    The residual hangs together over seconds.
    """
    draw = np.random.default_rng([seed, 20])
    t = np.arange(0.0, 8.0, 0.01)
    parts = [
        draw.uniform(0.1, 0.3) * np.sin(2.0 * np.pi * f * t + draw.uniform(0.0, 6.0))
        for f in (0.13, 0.31, 0.52)
    ]
    command = np.sum(parts, axis=0) * np.minimum(t, 1.0)
    fine = np.arange(0.0, t[-1] + 0.01, 0.01 / 8)
    late = joint_servo(1, 6.0, 0.9, 0.012).response(fine, np.interp(fine, t, command)[:, None])
    reached = np.interp(t, fine, late[:, 0])
    speed = np.gradient(reached, t)
    rough = 1e-3 * np.tanh(speed / 0.02) + 2e-3 * np.sin(3.0 * reached + draw.uniform(0.0, 6.0))
    return t, command, gain * reached + rough + 1e-4 * draw.standard_normal(t.size)


def test_an_arm_that_stops_short_has_a_static_gain() -> None:
    """Its arm stops 37 % short: no lag without a gain explains that."""
    t, command = commanded()
    fine = np.arange(0.0, t[-1] + STEP, STEP / 8)
    late = joint_servo(1, 5.0, 0.5, 0.01).response(fine, np.interp(fine, t, command)[:, None])
    fit = fit_servo_runs('j1', [(t, command, 0.63 * np.interp(t, fine, late[:, 0]))])
    assert fit.gain == pytest.approx(0.63, rel=1e-3)
    assert fit.bandwidth == pytest.approx(5.0, rel=0.01)
    assert fit.verdict == 'good'
    assert any('stops 37 % short of its commands' in reason for reason in fit.reasons)


@pytest.mark.long
def test_runs_of_a_rough_arm_agree_and_tell_its_lag() -> None:
    """Five runs that repeat were all not identifiable, with intervals beyond zero."""
    runs = [rough_run(seed) for seed in range(5)]
    alone = [fit_servo_runs('j1', [run]) for run in runs]
    lag = 2.0 * 0.9 / (2.0 * np.pi * 6.0) + 0.012
    for fit in alone:
        assert fit.verdict != 'not identifiable', fit.reasons
        assert all((interval > 0.0).all() for name, interval in fit.interval.items()
                   if name != 'delay'), fit.interval  # fmt: skip
        assert fit.interval['delay'][0] >= 0.0
        assert fit.interval['bandwidth'][1] < 1e3
        assert fit.interval['damping'][1] < 1e3
    assert np.std([fit.lag for fit in alone]) < 0.08 * lag
    together = fit_servo_runs('j1', runs)
    assert together.runs == 5
    # friction of the position, which the model does not have, takes 2 % of the lag
    assert together.lag == pytest.approx(lag, rel=0.05)
    assert together.verdict == 'good', together.reasons
    for name, truth in (('bandwidth', 6.0), ('damping', 0.9), ('delay', 0.012)):
        low, high = together.interval[name]
        assert low < truth < high
        assert high - low < np.median([np.ptp(fit.interval[name]) for fit in alone])


def test_a_run_that_differs_widens_the_interval() -> None:
    t, command = commanded()
    fine = np.arange(0.0, t[-1] + STEP, STEP / 8)
    runs = []
    for bandwidth in (5.0, 5.0, 4.0):
        late = joint_servo(1, bandwidth, 0.5, 0.004).response(
            fine, np.interp(fine, t, command)[:, None]
        )
        noise = np.random.default_rng(2).normal(0.0, 1e-4, len(t))
        runs.append((t, command, np.interp(t, fine, late[:, 0]) + noise))
    low, high = fit_servo_runs('j1', runs).interval['bandwidth']
    assert low < 4.0
    assert high > 5.0
