"""Intervals of what whitened residuals tell."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from denoc_ros.identification.model.information import (
    EXACT,
    EXACT_OFFSET,
    REACH,
    information,
    left_beside_noise,
)
from denoc_ros.identification.model.whitening import LARGEST_NOISE_SHARE, JointNoise, bounded
from denoc_ros.types import Array

ROWS, STRETCH = 600, 10
OFFSETS = np.array([False, True])


def line(beside: float) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return derivatives (m, 1) and residuals (m,) of a slope's fit that ended beside its best."""
    draw = np.random.default_rng(3)
    slope = 30.0 * np.linspace(-1.0, 1.0, ROWS)[:, None]
    noise = draw.standard_normal(ROWS)
    noise -= slope[:, 0] * float(slope[:, 0] @ noise) / float(slope[:, 0] @ slope[:, 0])
    return slope, noise + beside * slope[:, 0], np.arange(ROWS, dtype=np.int64) // STRETCH


def test_an_estimate_beside_the_greatest_likelihood_has_that_in_its_interval() -> None:
    """A prior that pulls, a search that ended too early: the interval reaches to the goal."""
    halves = []
    for off in (0.0, 0.02):
        slope, residual, blocks = line(off)
        info = information(slope, residual, blocks)
        halves.append(float(info.widened(slope.T @ residual).half[0]))
    noise = 2.0 / np.linalg.norm(line(0.0)[0])
    # 60 stretches tell their own spread within a tenth or two
    assert halves[0] == pytest.approx(np.hypot(noise, EXACT), rel=0.3)
    # stretches that all pull one way look like spread, too
    assert halves[0] + 0.019 < halves[1] < halves[0] + 0.03


def test_no_interval_is_narrower_than_what_is_left_beside_noise() -> None:
    """A slope and a constant that a million times as many samples tell."""
    slope, residual, blocks = line(0.0)
    both = 1e6 * np.hstack([slope, np.ones_like(slope)])
    half = information(both, residual, blocks, exact=left_beside_noise(OFFSETS)).half
    np.testing.assert_allclose(half, [EXACT, EXACT_OFFSET], rtol=1e-3)
    np.testing.assert_allclose(information(both, residual, blocks).half, EXACT, rtol=1e-3)


@pytest.mark.parametrize('rounding', [0.0, 1e-9, 1e-8])
def test_a_little_of_what_is_not_told_at_all_is_in_the_interval(rounding: float) -> None:
    """An offset that is not told moves a gain by 0.002 of its size for each of its own.

    What derivatives by differences leave of an exact zero told how far the offset may be.
    """
    slope, residual, blocks = line(0.0)
    share = 0.002
    told = 1e3 * slope * [1.0, -share]
    other = np.random.default_rng(4).standard_normal((ROWS, 1))
    jacobian = told + 1e3 * np.linalg.norm(slope) * rounding * other * [share, 1.0]
    half = information(jacobian, residual, blocks).half
    assert half[0] == pytest.approx(share * REACH, rel=0.05)
    assert np.isinf(half[1])


def test_what_noise_pulls_an_estimate_by_is_in_its_interval() -> None:
    """Of a slope's information half is noise's: the pull acts twice as far as that says."""
    slope, residual, blocks = line(0.0)
    white = slope.T @ slope
    alone = float(information(slope, residual, blocks).half[0])
    for share in (0.0, 0.5, 0.8):
        noise = JointNoise(0.004 * white, share * white)
        half = float(information(slope, residual, blocks, noise=noise).half[0])
        assert half == pytest.approx(alone + 0.004 / (1.0 - share))


def test_what_few_draws_leave_open_of_a_pull_is_in_the_interval() -> None:
    slope, residual, blocks = line(0.0)
    white = slope.T @ slope
    pulls = np.array([[0.03], [-0.01]]) @ white  # moves by 0.01, to within 0.02
    half = float(
        information(slope, residual, blocks, noise=JointNoise(pulls, 0.0 * white)).half[0]
    )
    alone = float(information(slope, residual, blocks).half[0])
    assert np.hypot(alone, 2.0 * 0.02) + 0.01 == pytest.approx(half, rel=0.05)  # Student's 2.00


def test_the_pull_tells_how_far_least_squares_are_from_the_truth() -> None:
    """Least squares make a slope too small by what the places' noise adds to their squares."""
    draw = np.random.default_rng(1)
    places = draw.uniform(-1.0, 1.0, (4000, 2))
    truth = np.array([0.4, -0.2])
    values = places @ truth + 0.01 * draw.standard_normal(len(places))
    spread = np.array([0.5, 0.02])
    measured = places + spread * draw.standard_normal(places.shape)
    found: Array = np.asarray(np.linalg.lstsq(measured, values, rcond=None)[0], dtype=float)
    assert found[0] < 0.65 * truth[0]  # 1 / (1 + 0.25 / 0.33)

    def at(noise: Array) -> tuple[Array, Array]:
        there = measured + noise
        return (there @ found - values) @ there, there.T @ there

    scores, normal = at(0.0 * measured)
    pulls, lost = [], np.zeros((2, 2))
    for _ in range(4):
        more = spread * draw.standard_normal(places.shape)
        pair = [at(more), at(-more)]
        pulls.append(0.5 * (pair[0][0] + pair[1][0]) - scores)
        lost += (0.5 * (pair[0][1] + pair[1][1]) - normal) / 4
    noise = JointNoise(np.array(pulls), lost)
    away = np.linalg.solve(normal - noise.lost, noise.pull)
    # 4000 values and four draws leave 0.01; by the squares as they are it is 0.57 of that
    assert np.allclose(found + away, truth, atol=0.04)
    assert np.linalg.solve(normal, noise.pull)[0] < 0.7 * away[0]


def test_noise_takes_most_of_the_information_at_most() -> None:
    normal = np.diag([4.0, 1.0])
    found = bounded(np.diag([40.0, -0.5]), normal)
    assert np.allclose(found, np.diag([4.0 * LARGEST_NOISE_SHARE, 0.0]))
