"""Small deflections, the one approximation of beams: as good as docs/theory.md says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from elastica import cantilever, distance, elastica, model, rows, table

THEORY = Path(__file__).resolve().parents[3] / 'docs' / 'theory.md'


@pytest.mark.parametrize(('load', 'factor'), [('force', 1.05), ('moment', 0.33)])
def test_the_tip_s_error_grows_with_the_cube_of_the_deflection(load: str, factor: float) -> None:
    deflection, error, *_ = rows(load)[:3].T
    # the next term of the series adds 5 % at a deflection of a fifth of the length
    np.testing.assert_allclose(error / deflection**3, factor, rtol=0.08)


@pytest.mark.parametrize('load', ['force', 'moment'])
def test_without_foreshortening_it_grows_with_the_square(load: str) -> None:
    deflection, _, error, _ = rows(load)[:3].T
    # a tip that moves straight across is off by 3/5 (force) or 2/3 (moment) of the square
    np.testing.assert_allclose(
        error / deflection**2, 2 / 3 if load == 'moment' else 3 / 5, rtol=0.1
    )


def test_the_slope_under_a_moment_is_exact() -> None:
    # the section's rotation is finite, and a moment does not mind where the tip is
    np.testing.assert_allclose(rows('moment')[:, 3], 0.0, atol=1e-9)


def test_modes_of_a_clamped_free_beam_come_to_the_same() -> None:
    truth = elastica('force', 0.6)
    ours = [
        distance(model(cantilever(True, 'clamped-free', k), 'force', 0.6), truth) for k in (4, 8)
    ]
    exact = distance(model(cantilever(True), 'force', 0.6), truth)
    assert abs(ours[1] - exact) < abs(ours[0] - exact) < 0.02 * exact


def test_the_table_of_the_page_is_what_comes_out() -> None:
    assert table() in THEORY.read_text(encoding='utf-8')
