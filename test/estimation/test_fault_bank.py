"""Steps of the bank of filters against a Kalman filter of dense matrices."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from denoc_ros.kernels.runtime.fault_bank import advance_filters, compare_filters
from denoc_ros.types import Array, Flags

FILTERS, MODES, BIASES, VALUES = 3, 2, 1, 4
SIZE = 4 * MODES + BIASES  # of the state [d; d'; f; b; e]
LOOSE = 1e12  # a clip that clips nothing
SEEDS = range(5)


class Bank(NamedTuple):
    """Random filters, and values that they are compared with."""

    states: Array
    covariances: Array
    rows: Array
    values: Array
    squares: Array
    used: Flags

    def compared(self, clip: float = LOOSE) -> tuple[Array, Array, Array, Array, Array]:
        """Return states, covariances, innovations, variances and chi-squared."""
        states, covariances = self.states.copy(), self.covariances.copy()
        innovations, variances, chi = np.empty((3, *self.used.shape))
        compare_filters(
            states, covariances, self.rows, self.values, self.squares, self.used, clip,
            innovations, variances, chi,
        )  # fmt: skip
        return states, covariances, innovations, variances, chi


def bank(seed: int) -> Bank:
    draw = np.random.default_rng(seed)
    return Bank(
        draw.standard_normal((FILTERS, SIZE)),
        np.array([covariance(draw, SIZE) for _ in range(FILTERS)]),
        draw.standard_normal((VALUES, SIZE)) * (draw.random((VALUES, SIZE)) < 0.7),
        draw.standard_normal(VALUES),
        draw.uniform(0.1, 1.0, VALUES),
        draw.random((FILTERS, VALUES)) < 0.6,
    )


def covariance(draw: np.random.Generator, size: int) -> Array:
    root = draw.standard_normal((size, size))
    return np.asarray(root @ root.T / size)


@pytest.mark.parametrize('seed', SEEDS)
def test_a_correction_is_that_of_all_used_values_at_once(seed: int) -> None:
    given = bank(seed)
    states, covariances, innovations, variances, chi = given.compared()
    for h, used in enumerate(given.used):
        prior, spread = given.states[h], given.covariances[h]
        missed = given.values - given.rows @ prior
        seen = given.rows @ spread @ given.rows.T + np.diag(given.squares)
        np.testing.assert_allclose(innovations[h], missed, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(variances[h], np.diag(seen), rtol=1e-12)
        rows, own = given.rows[used], seen[np.ix_(used, used)]
        gain = np.linalg.solve(own, rows @ spread).T
        np.testing.assert_allclose(states[h], prior + gain @ missed[used], rtol=1e-9, atol=1e-9)
        left = spread - gain @ rows @ spread
        np.testing.assert_allclose(covariances[h], left, rtol=1e-9, atol=1e-9)
        square = missed[used] @ np.linalg.solve(own, missed[used])
        np.testing.assert_allclose(chi[h].sum(), square, rtol=1e-9)
        assert not chi[h, ~used].any()


@pytest.mark.parametrize('seed', SEEDS)
def test_a_value_that_no_filter_uses_changes_none(seed: int) -> None:
    given = bank(seed)
    given.used[:, 1] = False
    before = given.compared()
    given.values[1], given.squares[1] = 1e6, 1e-6
    for index in (0, 1, 4):
        np.testing.assert_array_equal(given.compared()[index], before[index])


@pytest.mark.parametrize('seed', SEEDS)
def test_a_wild_value_moves_a_state_no_further_than_one_at_the_clip(seed: int) -> None:
    given, clip = bank(seed), 9.0
    given.used[:] = False
    given.used[:, 0] = True
    variance = given.compared()[3][:, 0]
    for h in range(FILTERS):
        moves = []
        for size in (np.sqrt(clip * variance[h]), 1e3, 1e9):
            given.values[0] = given.rows[0] @ given.states[h] + size
            states, _, _, _, chi = given.compared(clip)
            moves.append(np.linalg.norm(states[h] - given.states[h]))
            np.testing.assert_allclose(chi[h, 0], clip, rtol=1e-6)
        assert moves[0] > 0.0
        assert max(moves[1:]) <= moves[0] * (1.0 + 1e-9)


@pytest.mark.parametrize('seed', SEEDS)
def test_a_step_is_that_of_the_linear_system_about_each_filter_s_state(seed: int) -> None:
    given, draw = bank(seed), np.random.default_rng([seed, 1])
    moved, first = 3 * MODES, SIZE - MODES
    alone, pushed = draw.standard_normal((moved, moved)), draw.standard_normal((moved, MODES))
    stiffness, amplitudes = draw.uniform(1.0, 2.0, MODES), draw.standard_normal(MODES)
    load_noise, share_noise = covariance(draw, MODES), covariance(draw, MODES)
    states, covariances = given.states.copy(), given.covariances.copy()
    advance_filters(
        states, covariances, alone, pushed, stiffness, amplitudes, load_noise, share_noise
    )
    for h, state in enumerate(given.states):
        transition = np.eye(SIZE)
        transition[:moved, :moved] = alone
        transition[:moved, first:] = pushed * (stiffness * (amplitudes + state[:MODES]))
        gained = np.zeros((SIZE, SIZE))
        gained[2 * MODES : moved, 2 * MODES : moved] = load_noise
        gained[first:, first:] = share_noise
        np.testing.assert_allclose(states[h], transition @ state, rtol=1e-10, atol=1e-10)
        expected = transition @ given.covariances[h] @ transition.T + gained
        np.testing.assert_allclose(covariances[h], expected, rtol=1e-9, atol=1e-9)
