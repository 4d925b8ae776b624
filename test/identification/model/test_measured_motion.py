"""Joint motion from what was measured: noise of a joint that stands still is no motion."""

from __future__ import annotations

import numpy as np
import pytest

from denoc_ros.estimation.joint_motion import LocalPolynomials, smooth
from denoc_ros.identification.model.prediction import measured_motion


def test_a_joint_that_shows_noise_alone_stands_still() -> None:
    draw = np.random.default_rng(4)
    t = 5e-3 * np.arange(400.0)
    position = 2e-5 * draw.standard_normal((400, 2)) + 0.3
    velocity = 1e-3 * draw.standard_normal((400, 2))
    position[:, 1] += 0.1 * np.sin(5.0 * t)
    velocity[:, 1] += 0.5 * np.cos(5.0 * t)
    measured = measured_motion(t, position, velocity)
    motion = measured.motion
    np.testing.assert_array_equal(motion.qd[:, 0], 0.0)
    np.testing.assert_array_equal(motion.qdd[:, 0], 0.0)
    np.testing.assert_allclose(motion.q[:, 0], 0.3, atol=1e-5)  # the median of 400 samples
    assert measured.velocity_noise[0] == 0.0
    # the other moves, and keeps its noise: 1e-3 rad/s
    assert np.abs(motion.qd[:, 1]).max() > 0.4
    assert 0.5e-3 < measured.velocity_noise[1] < 2e-3


@pytest.mark.parametrize('has_rates', [False, True])
def test_noise_is_what_the_smoothing_makes_of_white_noise(has_rates: bool) -> None:
    draw, t = np.random.default_rng(6), 5e-3 * np.arange(100.0)
    position = 0.1 * np.sin(5.0 * t)[:, None] + 1e-4 * draw.random((100, 1))
    velocity = 0.5 * np.cos(5.0 * t)[:, None] + 1e-3 * draw.random((100, 1))
    measured = measured_motion(t, position, velocity if has_rates else None)
    seeds = 0, 1
    found = list(measured.noise([np.random.default_rng(seed) for seed in seeds]))
    for seed, noise in zip(seeds, found, strict=True):
        white = np.random.default_rng(seed).standard_normal((2, 100, 1))
        q, qd, qdd = measured.smoothers[float(measured.cutoffs[0, 0])](
            measured.position_noise * white[0]
        )
        if has_rates:
            smoother = measured.smoothers[float(measured.cutoffs[1, 0])]
            qd, qdd, _ = smoother(measured.velocity_noise * white[1])
        for own, wanted in ((noise.q, q), (noise.qd, qd), (noise.qdd, qdd)):
            assert np.abs(wanted).max() > 0.0
            np.testing.assert_allclose(own, wanted, atol=1e-9 * np.abs(wanted).max())


def test_a_slow_joint_moves() -> None:
    """A drift of a few noises is motion, even where the rates are lost in theirs."""
    draw = np.random.default_rng(5)
    t = 5e-3 * np.arange(400.0)
    position = 1e-4 * t[:, None] + 2e-6 * draw.standard_normal((400, 1))
    measured = measured_motion(t, position, None)
    assert np.abs(measured.motion.qd).max() > 5e-5


@pytest.mark.parametrize('cutoff', [8.0, 40.0])
def test_smoothing_that_is_kept_is_smoothing(cutoff: float) -> None:
    """Uneven stamps, large positions, ends included."""
    draw = np.random.default_rng(6)
    t = 5e-3 * (np.arange(120.0) + 0.3 * draw.random(120))
    y = 1e3 + np.sin(20.0 * t)[:, None] + 1e-2 * draw.standard_normal((120, 3))
    wanted = smooth(t, y, cutoff=cutoff, period=5e-3)
    found = LocalPolynomials(t, cutoff, 5e-3)(y)
    for own, other in zip(found, (wanted.q, wanted.qd, wanted.qdd), strict=True):
        # rounding of differences over a window
        np.testing.assert_allclose(own, other, rtol=1e-9, atol=1e-9 * np.abs(other).max())
