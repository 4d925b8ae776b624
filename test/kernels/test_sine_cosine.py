"""The kernels' own sine and cosine against the C library's."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from denoc_ros.kernels.algebra.rotation import FARTHEST, sine_cosine


def angles(reach: float) -> NDArray[np.float64]:
    """Angles within a reach, and whole eighths of turns, where the polynomials meet."""
    within = np.random.default_rng(1).uniform(-reach, reach, 2000)
    eighths = np.arange(-200, 201) * (np.pi / 4.0)
    return np.concatenate([within, eighths[np.abs(eighths) <= reach], [0.0, -0.0, 1e-300]])


@pytest.mark.parametrize('reach', [0.1, 4.0, 200.0, FARTHEST, 1e3 * FARTHEST])
def test_sine_and_cosine_are_those_of_the_library(reach: float) -> None:
    for x in angles(reach):
        sine, cosine = sine_cosine(float(x))
        # an ulp each of the polynomial, of the reduced angle and of the sum
        assert sine == pytest.approx(math.sin(x), rel=4e-16, abs=1e-20)
        assert cosine == pytest.approx(math.cos(x), rel=4e-16, abs=1e-20)


@pytest.mark.parametrize('x', [np.inf, -np.inf, np.nan])
def test_no_angle_has_no_sine(x: float) -> None:
    assert np.isnan(sine_cosine(x)).all()
