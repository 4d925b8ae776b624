"""The flexible five-bar beside Exudyn's nonlinear finite elements, over a short time."""

from __future__ import annotations

import numpy as np
from bench.links.exudyn_five_bar import compare, differences, exudyn_fall, our_fall


def test_five_bar_falls_as_finite_elements_do() -> None:
    times = np.linspace(0.0, 0.1, 11)
    theirs = exudyn_fall(times, step=5e-5)
    angle, deflection = differences(our_fall(times, shapes=4), theirs)
    # elements stretch, ours do not; theirs are integrated to order 2, eight vibrations long
    assert angle <= 8e-6
    assert deflection <= 0.03
    moved = np.ptp(theirs.angles, axis=0)
    assert np.all(moved > 0.02)


def test_comparison_reports_both_and_conserves_energy() -> None:
    result = compare(0.05, repeats=1)
    assert result.ratio == result.exudyn_s / result.ours_s
    assert result.drift <= 1e-6
    assert result.angle <= 1e-4
