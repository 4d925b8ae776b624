"""Peaks are those that scipy finds."""

from __future__ import annotations

import numpy as np
import scipy.signal
from hypothesis import given
from hypothesis import strategies as st

from denoc_ros.identification.peaks import find_peaks

# few different values make plateaus and peaks of one height
values = st.lists(st.integers(-6, 6), min_size=3, max_size=60)


@given(values, st.integers(-6, 6), st.integers(1, 9), st.integers(0, 8))
def test_peaks_are_those_of_scipy(
    levels: list[int], height: int, distance: int, prominence: int
) -> None:
    y = np.array(levels, float)
    expected, _ = scipy.signal.find_peaks(
        y, height=height, distance=distance, prominence=prominence
    )
    np.testing.assert_array_equal(find_peaks(y, height, distance, prominence), expected)


def test_peaks_of_a_noisy_decay_are_those_of_scipy() -> None:
    t = np.linspace(0.0, 10.0, 5000)
    noise = 0.01 * np.random.default_rng(3).standard_normal(t.size)
    y = np.exp(-0.3 * t) * np.cos(20.0 * t) + noise
    for options in ({}, {'prominence': 0.1}, {'distance': 40}, {'distance': 40, 'height': 0.2}):
        expected, _ = scipy.signal.find_peaks(y, **options)
        assert expected.size > 10
        np.testing.assert_array_equal(find_peaks(y, **options), expected)
