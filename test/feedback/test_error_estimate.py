"""Compiled steps of the errors' estimate are what dense algebra makes of them."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from denoc_ros.feedback.feedback_design import terms
from denoc_ros.feedback.kernels.deviation_kernels import (
    estimates_ahead,
    learn_errors,
    plan_changes,
)
from denoc_ros.kernels.jit.compiled import entry
from denoc_ros.types import Array

S, P, K, E, C, MEASURED = 6, 4, 2, 9, 3, 6  # K joints, of P torques on their way
TERMS = C * (C + 3) // 2
STEP, PERIOD, AVERAGED, ENTERS, GROWTH, NONE = 0.1, 0.01, 0.3, 0.2, 1e-3, 10.0
RARE, RARELY, UNSURE, LIKELY = 1, 20.0, 0.1, np.array([0.2, 0.05, 0.2])
INFINITE = np.inf


def value(polynomial: Array, errors: Array) -> Array:
    """Return polynomials (..., 1 + terms) at errors."""
    return np.asarray(polynomial[..., 0] + polynomial[..., 1:] @ terms(errors))


def random(rng: np.random.Generator, *shape: int) -> Array:
    return rng.standard_normal(shape)


def covariance(rng: np.random.Generator, size: int) -> Array:
    root = random(rng, size, size)
    return np.asarray(root @ root.T + np.eye(size))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def between(table: Array, along: float) -> Array:
    """Return a table at a fractional row: cubic, with the slopes of central differences."""
    held = np.concatenate([table[:1], table, table[-1:]])
    slopes = 0.5 * (held[2:] - held[:-2])
    within = np.clip(along, 0.0, len(table) - 1.0)
    return np.asarray(CubicHermiteSpline(np.arange(len(table)), table, slopes)(within))


def test_changes_of_a_plan_are_its_tables_terms(rng: np.random.Generator) -> None:
    states, torques, errors = random(rng, 8, S, TERMS), random(rng, 8, K, TERMS), random(rng, C)
    state, torque = np.zeros(S), np.zeros(K)
    for along in (-1.0, 0.0, 0.4, 2.25, 6.9, 7.0, 11.0):
        entry(plan_changes)(states, torques, along, errors, state, torque)
        for found, table in ((state, states), (torque, torques)):
            row = between(table, along)
            np.testing.assert_allclose(found, row @ terms(errors), rtol=1e-9, atol=1e-12)


def test_a_period_moves_all_estimates_as_the_robot_with_the_errors(
    rng: np.random.Generator,
) -> None:
    states, torques = random(rng, 8, S, TERMS), random(rng, 8, K, TERMS)
    transition, push, pushes = random(rng, E, E), random(rng, S, P), random(rng, P)
    by_errors = random(rng, TERMS, S, S + P)
    state, seen = random(rng, E), random(rng, E, C)
    second, spread = random(rng, E, 1 + TERMS), covariance(rng, C)
    away, pushed = random(rng, 2, S + P, 1 + C), np.zeros(S)
    values, used, entering = 0.1 * random(rng, 3, C)
    numbers = np.array([
        STEP, PERIOD, AVERAGED, ENTERS, GROWTH, NONE, RARE, RARELY, UNSURE, *LIKELY
    ])  # fmt: skip
    time, before = 0.237, [each.copy() for each in (state, seen, second, away, used)]
    wanted_spread = spread + GROWTH * np.eye(C)
    odds = np.exp(-0.5 * values @ np.linalg.solve(wanted_spread, values))
    odds *= NONE * LIKELY.prod() / np.sqrt(np.linalg.det(wanted_spread))
    spreads = np.sqrt(np.diag(wanted_spread))
    alone = NONE * LIKELY / spreads * np.exp(-0.5 * (values / spreads) ** 2)
    odds = np.minimum(odds, alone)  # of each error
    # if the rare error is none, the others are what they are given that
    others = values - wanted_spread[:, RARE] / wanted_spread[RARE, RARE] * values[RARE]
    seeming = np.hypot(spreads[RARE], UNSURE)
    rare = RARELY * LIKELY[RARE] / seeming * np.exp(-0.5 * (values[RARE] / seeming) ** 2)
    mean = (values + rare * others) / (1.0 + rare)
    entered = entering + ENTERS * (mean / (1.0 + odds) - entering)
    entry(estimates_ahead)(
        states, torques, numbers, time, transition, push, by_errors, pushes, state, seen,
        second, spread, away, values, used, entering, pushed,
    )  # fmt: skip
    state0, seen0, second0, away0, used0 = before
    np.testing.assert_allclose(spread, wanted_spread, rtol=1e-12)
    np.testing.assert_allclose(entering, entered, rtol=1e-12)
    np.testing.assert_allclose(used, used0 + ENTERS * (entered - used0), rtol=1e-12)

    def changes(table: Array, at: float, errors: Array) -> Array:
        return np.asarray(between(table, at / STEP) @ terms(errors))

    # the transition of the robot with the errors in use; errors beside them act on averages
    change = np.tensordot(terms(used0), by_errors, 1)
    slopes = [
        0.5 * np.tensordot(terms(used0 + each) - terms(used0 - each), by_errors, 1)
        for each in np.eye(C)
    ]
    moves, ways = transition.copy(), push + change[:, S:]
    moves[:S, :S] += change[:, :S]
    np.testing.assert_allclose(
        pushed, ways @ (pushes - np.tile(changes(torques, time, used0), P // K)), rtol=1e-12
    )

    def ahead(estimate: Array, beside: Array, averages: Array) -> Array:
        errors, off = used0 + beside, estimate.copy()
        off[:S] -= changes(states, time, errors)
        later = moves @ off
        later[:S] += changes(states, time + PERIOD, errors)
        later[:S] += ways @ (pushes - np.tile(changes(torques, time, errors), P // K))
        later[:S] += np.einsum('e,eij,j->i', beside, slopes, averages)
        return np.asarray(later)

    def averaged(beside: Array) -> Array:
        """Averages that are linear in errors beside, of deviations and torques."""

        def exact(some: Array) -> Array:
            errors = used0 + some
            return np.concatenate([
                value(second0[:S], some) - changes(states, time, errors),
                pushes - np.tile(changes(torques, time, errors), P // K),
            ])  # fmt: skip

        # a polynomial of second degree: central differences are its slope
        at_none, unit = exact(np.zeros(C)), np.eye(C)
        slope = np.array([0.5 * (exact(each) - exact(-each)) for each in unit]).T
        now = away0[0] + AVERAGED * (np.column_stack([at_none, slope]) - away0[0])
        np.testing.assert_allclose(away[0], now, rtol=1e-9, atol=1e-9)
        again = away0[1] + AVERAGED * (now - away0[1])
        np.testing.assert_allclose(away[1], again, rtol=1e-9, atol=1e-9)
        return np.asarray(again[:, 0] + again[:, 1:] @ beside)

    for beside in 0.1 * random(rng, 4, C):
        # the estimates are polynomials in errors beside those in use now
        moved = beside - (used - used0)
        expected = ahead(value(second0, beside), beside, averaged(beside))
        np.testing.assert_allclose(value(second, moved), expected, rtol=1e-9, atol=1e-9)
    none = ahead(state0, np.zeros(C), np.zeros(S + P))
    slopes = [
        0.5 * (ahead(state0 + seen0 @ each, each, averaged(np.zeros(C)))
               - ahead(state0 - seen0 @ each, -each, averaged(np.zeros(C))))
        for each in np.eye(C)
    ]  # fmt: skip
    np.testing.assert_allclose(seen, np.array(slopes).T, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(state, none + seen @ (used - used0), rtol=1e-9, atol=1e-9)


def test_a_correction_is_that_of_least_squares(rng: np.random.Generator) -> None:
    measured, noise, learner = (
        random(rng, MEASURED, E),
        covariance(rng, MEASURED),
        random(rng, E, 6),
    )
    second, at = random(rng, E, 1 + TERMS), np.array([0, 1, 3, 4, 5])
    values, used = 0.05 * random(rng, 2, C)
    spread, innovation = covariance(rng, C), 0.1 * random(rng, MEASURED)
    times, expected = np.array([0.0, 1.0, 2.0, 0.0]), np.zeros((4, MEASURED))
    second0, values0, spread0 = second.copy(), values.copy(), spread.copy()
    far = entry(learn_errors)(
        measured, noise, np.ones(MEASURED), learner, innovation, at, INFINITE, INFINITE, True,
        second, values, used, spread, times, expected, 3, 0.5,
    )  # fmt: skip
    assert far == 0
    rows, step = measured @ second0, 1e-3
    # how innovations change with the errors, by differences that are exact for second degree
    beside = values0 - used
    slopes = np.array([
        (value(rows, beside + step * each) - value(rows, beside - step * each)) / (2.0 * step)
        for each in np.eye(C)
    ]).T  # fmt: skip
    explained_by = value(rows, beside) - rows[:, 0]
    weights = np.linalg.inv(noise[np.ix_(at, at)])
    posterior = np.linalg.inv(np.linalg.inv(spread0) + slopes[at].T @ weights @ slopes[at])
    np.testing.assert_allclose(spread, posterior, rtol=1e-8)
    left = innovation[at] - explained_by[at]
    np.testing.assert_allclose(
        values, values0 + posterior @ slopes[at].T @ weights @ left, rtol=1e-7
    )
    change = learner[:, at] @ innovation[at]
    np.testing.assert_allclose(expected[1:3], np.tile(measured @ change, (2, 1)), rtol=1e-12)
    assert not expected[[0, 3]].any()
    for errors in 0.1 * random(rng, 3, C):
        seen = value(second0, errors)
        # what was measured, beyond the plan's, less what this estimate expects
        missed = innovation + rows[:, 0] - measured @ seen
        np.testing.assert_allclose(
            value(second, errors), seen + learner[:, at] @ missed[at], rtol=1e-9
        )


def test_terms_are_in_the_order_of_the_compiled_ones() -> None:
    errors = np.array([2.0, 3.0, 5.0])
    pairs = [a * b for a, b in combinations_with_replacement(errors, 2)]
    np.testing.assert_array_equal(terms(errors), [*errors, *pairs])
