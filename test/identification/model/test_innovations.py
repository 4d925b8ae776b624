"""The filter that makes residuals white: what Gaussian conditioning by dense matrices gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import scipy.linalg
from numpy.typing import NDArray

from denoc_ros.identification.model.innovations import Innovations, LinkedRows, linked_rows
from denoc_ros.kernels.algebra.kalman import linear_states
from denoc_ros.kernels.jit.compiled import ready
from denoc_ros.types import Array, Flags

STAMPS, FREE, JOINTS, ROWS = 9, 2, 3, 31
STATES = 2 * FREE


@dataclass
class Linear:
    """What of a `NearbyMotion` the filter reads."""

    free: NDArray[np.int64]
    starts: Flags
    slopes: Array
    transitions: Array
    by_joints: Array


@pytest.fixture(scope='module')
def nearby() -> Linear:
    draw = np.random.default_rng(2)
    starts = np.zeros(STAMPS, dtype=bool)
    starts[[0, 5]] = True
    slopes = draw.standard_normal((STAMPS, STATES, STATES))
    transitions = np.eye(STATES) + 0.2 * draw.standard_normal((STAMPS - 1, STATES, STATES))
    by_joints = draw.standard_normal((STAMPS, FREE, JOINTS))
    return Linear(np.arange(FREE, dtype=np.int64), starts, slopes, transitions, by_joints)


@dataclass
class Case:
    """Rows, their noise, and the covariance (ROWS, ROWS) of all of them."""

    t: Array
    rows: LinkedRows
    deviation: Array
    rate_noise: Array
    covariance: Array


@pytest.fixture(scope='module')
def case(nearby: Linear) -> Case:
    draw = np.random.default_rng(5)
    t = 0.1 * np.arange(STAMPS) + 0.01 * draw.random(STAMPS)
    row_t = draw.uniform(t[0], t[-1], ROWS)
    row_t[:2] = t[-1] + 1.0  # far from all stamps
    by_state = draw.standard_normal((ROWS, STATES))
    rows = linked_rows(nearby, t, row_t, by_state)  # type: ignore[arg-type]
    deviation, rate_noise = draw.uniform(0.5, 2.0, ROWS), draw.uniform(0.5, 2.0, JOINTS)
    # each state is a sum of what all intervals before it have added, since it began
    noise = np.zeros((STAMPS, STATES, JOINTS))
    noise[:, :FREE] = nearby.by_joints * rate_noise
    noise[:, FREE:] = nearby.slopes[:, FREE:, FREE:] @ noise[:, :FREE]
    noise *= np.sqrt(np.diff(t, prepend=t[0]))[:, None, None]
    sums = np.zeros((STAMPS, STATES, STAMPS * JOINTS))
    for k in np.flatnonzero(~nearby.starts):
        sums[k] = nearby.transitions[k - 1] @ sums[k - 1]
        sums[k][:, k * JOINTS : (k + 1) * JOINTS] += noise[k]
    stamp = np.full(ROWS, -1)
    for j in range(STAMPS):
        stamp[rows.order[rows.edges[j] : rows.edges[j + 1]]] = j
    shown = np.array([rows.slopes[m] @ sums[k] if k >= 0 else 0 * sums[0, 0]
                      for m, k in enumerate(stamp)])  # fmt: skip
    covariance = shown @ shown.T + np.diag(deviation**2)
    return Case(t, rows, deviation, rate_noise, covariance)


def filter_of(nearby: Linear, case: Case) -> Innovations:
    return Innovations(
        nearby,  # type: ignore[arg-type]
        case.rows, case.deviation, case.rate_noise, case.t,
    )  # fmt: skip


def test_residuals_are_conditioned_on_those_before(nearby: Linear, case: Case) -> None:
    values = np.random.default_rng(7).standard_normal((ROWS, 4))
    order = np.concatenate([case.rows.alone, case.rows.order])
    assert sorted(order) == list(range(ROWS))
    assert len(case.rows.alone) >= 2
    root = np.linalg.cholesky(case.covariance[np.ix_(order, order)])
    wanted = np.empty_like(values)
    wanted[order] = scipy.linalg.solve_triangular(root, values[order], lower=True)
    found = filter_of(nearby, case)
    np.testing.assert_allclose(found.whitened(values), wanted, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(found.whitened(values[:, 1]), wanted[:, 1], rtol=1e-9, atol=1e-11)


def test_what_is_given_stays(nearby: Linear, case: Case) -> None:
    """Residuals are kept by those who work them out, and deviations by the channels."""
    values = np.random.default_rng(7).standard_normal(ROWS)
    given, deviation = values.copy(), case.deviation.copy()
    filter_of(nearby, case).whitened(values)
    np.testing.assert_array_equal(values, given)
    np.testing.assert_array_equal(case.deviation, deviation)


def test_states_solve_the_linear_system(nearby: Linear) -> None:
    """The system x = N x + g, N with the transitions below its diagonal, but at starts."""
    gained = np.random.default_rng(8).standard_normal((STAMPS, STATES))
    system = np.eye(STAMPS * STATES)
    for k in np.flatnonzero(~nearby.starts):
        own, before = (slice(j * STATES, (j + 1) * STATES) for j in (k, k - 1))
        system[own, before] = -nearby.transitions[k - 1]
    wanted = np.linalg.solve(system, gained.ravel()).reshape(STAMPS, STATES)
    ready(linear_states)
    linear_states(nearby.transitions, nearby.starts, gained)
    np.testing.assert_allclose(gained, wanted, rtol=1e-9, atol=1e-11)
