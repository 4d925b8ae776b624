"""Runs side by side: the same mode is found again, spread and repeatability are those drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from denoc_ros.errors import IdentificationError
from denoc_ros.identification.apply import compare_results


def result(*modes: tuple[float, float, float]) -> dict[str, Any]:
    """Return a result of modes: frequency [Hz], damping ratio, its standard deviation."""
    return {
        'kind': 'modal',
        'modes': [
            {
                'frequency_hz': hz,
                'damping_ratio': zeta,
                'interval': [zeta - 1.96 * deviation, zeta + 1.96 * deviation],
                'verdict': 'good',
            }
            for hz, zeta, deviation in modes
        ],
    }


def test_modes_are_matched_by_frequency_and_a_run_has_each_once() -> None:
    runs = [
        result((1.0, 0.01, 1e-4), (11.5, 0.02, 1e-4), (11.9, 0.03, 1e-4)),
        result((1.02, 0.011, 1e-4), (11.6, 0.02, 1e-4)),
        result((40.0, 0.05, 1e-4)),
    ]
    compared = compare_results(runs)
    assert [mode.runs for mode in compared] == [(0, 1), (0, 1), (0,), (2,)]
    assert compared[0].damping_ratio == pytest.approx(0.0105)
    assert np.isnan(compared[3].damping_deviation)
    assert compared[3].consistent


def test_spread_is_that_of_the_draws() -> None:
    draw = np.random.default_rng(5)
    zetas = 0.02 + 1e-3 * draw.standard_normal(200)
    same = compare_results([result((5.0, zeta, 1e-3)) for zeta in zetas])[0]
    # 200 draws: a standard deviation to 5 %, four times that
    assert same.damping_deviation == pytest.approx(1e-3, rel=0.2)
    pairs = np.abs(zetas[::2] - zetas[1::2])
    # 100 pairs: 95 % of them to 2.2 %, four times that
    assert np.mean(pairs < same.repeatability) == pytest.approx(0.95, abs=0.09)
    assert same.consistent
    sure = compare_results([result((5.0, zeta, 1e-4)) for zeta in zetas])[0]
    assert not sure.consistent


def test_one_run_or_another_kind_is_refused() -> None:
    with pytest.raises(IdentificationError, match='must be at least 2, got 1'):
        compare_results([result()])
    with pytest.raises(IdentificationError, match="must be of modes, got 'joint' in result 2"):
        compare_results([result(), {'kind': 'joint'}])
