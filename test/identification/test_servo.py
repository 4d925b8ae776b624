"""Servos identified on synthetic truth."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from denoc_ros.control.servo import joint_servo
from denoc_ros.errors import IdentificationError
from denoc_ros.identification.servo import ServoFit, fit_servo

Array = NDArray[np.float64]
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
    return fit_servo('j1', t, command, measured), measured


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
    fit = fit_servo('j1', t[part], command[part], measured[part])
    assert fit.bandwidth == pytest.approx(5.0, rel=0.05)
    assert fit.delay == pytest.approx(0.02, abs=2e-3)


def test_what_cannot_be_told_is_said() -> None:
    t, command = commanded()
    exact = fit_servo('j1', t, command, command)
    assert exact.verdict == 'not identifiable'
    rough = np.random.default_rng(0).normal(0.0, 0.3, len(t))
    assert fit_servo('j1', t, command, command + rough).verdict == 'not identifiable'
    # a joint that turns a quarter of what it is told to is no servo of this kind
    wrong = fit_servo('j1', t, command, 0.75 * command)
    assert wrong.verdict != 'good'
    with pytest.raises(IdentificationError, match='50 samples of a command that moves by'):
        fit_servo('j1', t, np.zeros(len(t)), command)
    with pytest.raises(IdentificationError, match='got 20 of one that moves by'):
        fit_servo('j1', t[:20], np.linspace(0.0, 1.0, 20), command[:20])
