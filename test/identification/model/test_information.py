"""Intervals of what whitened residuals tell."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from denoc_ros.identification.model.information import EXACT, FAR, information
from denoc_ros.types import Array

ROWS, STRETCH = 600, 10


def line(beside: float) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return derivatives (m, 1) and residuals (m,) of a slope's fit that ended beside its best."""
    draw = np.random.default_rng(3)
    slope = 30.0 * np.linspace(-1.0, 1.0, ROWS)[:, None]
    noise = draw.standard_normal(ROWS)
    noise -= slope[:, 0] * float(slope[:, 0] @ noise) / float(slope[:, 0] @ slope[:, 0])
    return slope, noise + beside * slope[:, 0], np.arange(ROWS, dtype=np.int64) // STRETCH


def test_an_estimate_beside_the_greatest_likelihood_has_that_in_its_interval() -> None:
    """A prior that pulls, a search that ended too early: the interval reaches to the goal."""
    at, beside = (float(information(*line(off)).half[0]) for off in (0.0, 0.02))
    noise = 2.0 / np.linalg.norm(line(0.0)[0])
    # 60 stretches tell their own spread within a tenth or two
    assert at == pytest.approx(np.hypot(noise, EXACT), rel=0.3)
    # stretches that all pull one way look like spread, too
    assert at + 0.019 < beside < at + 0.03


def test_what_noise_pulls_an_estimate_by_is_in_its_interval() -> None:
    slope, residual, blocks = line(0.0)
    white = float(slope[:, 0] @ slope[:, 0])
    halves = [
        float(information(slope, residual, blocks, pull=np.array([white * by])).half[0])
        for by in (0.0, 0.004, 0.01)
    ]
    assert halves[1] == pytest.approx(halves[0] + 0.004)
    # farther than the interval: to first order only, and so not to be trusted
    assert halves[2] == pytest.approx(halves[0] + FAR * 0.01)
