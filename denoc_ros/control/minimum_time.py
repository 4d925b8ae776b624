"""The shortest motion within limits: convex programs in the coefficients of a timing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import clarabel
import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from denoc_ros.control.tip_solver import CancelledError
from denoc_ros.errors import SolverError
from denoc_ros.types import Array

ROUNDS = 40
STEADY = 1e-3  # share of the duration that a round must save
EXCESS = 20.0  # price of a share beyond a limit, in durations
NEAR = 1e-3  # share beyond a limit that counts as kept
KEPT = 2e-4  # share of each limit that programs keep free
START, LEAST, MOST = 0.5, 2e-3, 4.0  # of the trust region, as a share of each coefficient
GOOD, POOR = 0.7, 0.2  # share of a predicted gain that is found
FIRST_ROOM = 0.1  # of limits that are in a program from the first
LEFT = 1e-6  # of a limit that a program is beyond


class Solution(Protocol):
    """A motion with some coefficients.

    Attributes
    ----------
    duration : float
        s.
    shares : (k, r) array
        Of the limits; at each moment, of each row.
    """

    @property
    def duration(self) -> float:
        """Of the motion."""

    @property
    def shares(self) -> Array:
        """Of the limits."""


S = TypeVar('S', bound=Solution)
Cones = tuple[sparse.csr_array, Array]  # rows A and right side b of A z + s = b


class MinimumTimeProblem(Protocol[S]):
    """A motion whose duration is to be the least.

    Attributes
    ----------
    names : tuple of str
        Of the rows.
    """

    names: tuple[str, ...]

    def solve(self, coefficients: Array, near: tuple[S, Array] | None) -> S:
        """Return the motion; `near` is one with its change of coefficients to this one."""

    def jacobian(self, solution: S) -> Array | sparse.csr_array:
        """Return the derivatives (k r, p) of the shares, row by row."""

    def program(self, solution: S) -> Objective:
        """Return the duration as a function of the coefficients."""


@dataclass(frozen=True)
class Objective:
    """The duration of a timing as cones: sum of 2 ds / (w_i + w_{i+1}), w_i^2 <= x_i = B c.

    Attributes
    ----------
    apart : (k - 1,) array
    design : (k, p) array
    largest : float
        Of the coefficients, over their median.
    """

    apart: Array
    design: Array
    largest: float = np.inf


@dataclass(frozen=True)
class Found(Generic[S]):
    """The shortest motion that was found.

    Attributes
    ----------
    solution : Solution
    coefficients : (p,) array
    gains : (r,) array
        By which share of the duration one more share of each row's limit makes it shorter.
    rounds : int
    settled : bool
        Whether no round would have saved more; False: stopped before.
    """

    solution: S
    coefficients: Array
    gains: Array
    rounds: int
    settled: bool


def excess(solution: Solution) -> float:
    """Return the share by which a motion is beyond its limits, 0 where it keeps them."""
    return max(0.0, float(np.abs(solution.shares).max(initial=0.0)) - 1.0)


def shortest(
    problem: MinimumTimeProblem[S],
    start: Array,
    report: Callable[[float], object],
    stopped: Callable[[], bool],
    rounds: int = ROUNDS,
) -> Found[S]:
    """Return the shortest motion within limits.

    Parameters
    ----------
    problem : MinimumTimeProblem
    start : (p,) array
        Coefficients to begin with.
    report : callable
        Takes the share of the work that is done.
    stopped : callable
        Says whether to return the best motion so far.
    rounds : int
        At most.

    Raises
    ------
    SolverError
        None within the limits was found.

    Notes
    -----
    Sequential convex programming with a trust region and an exact penalty of the largest share
    beyond a limit. Each program has the duration exactly, as second-order cones, and the limits
    to first order; of a rigid robot without viscous friction the limits are exact as well.
    """
    here = problem.solve(start, None)
    coefficients, radius = start, START
    best: tuple[S, Array] | None = (here, start) if excess(here) <= NEAR else None
    gains = np.zeros(len(problem.names))
    settled, round_ = False, 0
    for round_ in range(rounds):
        report(1.0 - 0.85**round_)
        if stopped():
            break
        jacobian = problem.jacobian(here)
        cost = _cost(here, here.duration)
        while True:
            step = _program(problem.program(here), here, jacobian, coefficients, radius)
            if step is None:
                radius *= 0.3
            else:
                there, expected, gains_there = step
                found = _attempt(problem, there, (here, there - coefficients))
                if found is not None and _cost(found, here.duration) > cost - POOR * (
                    cost - expected
                ):
                    found, there = _corrected(
                        problem, here, found, jacobian, (coefficients, there), radius
                    )
                gain = -np.inf if found is None else cost - _cost(found, here.duration)
                wanted = cost - expected
                if wanted <= STEADY * (1.0 if excess(here) <= NEAR else 0.1):
                    settled, gains = True, gains_there
                    break
                if found is not None and gain >= POOR * wanted:
                    radius = min(2.0 * radius, MOST) if gain >= GOOD * wanted else radius
                    here, coefficients, gains = found, there, gains_there
                    break
                radius *= 0.4
            if radius < LEAST or stopped():
                settled = radius < LEAST
                break
        if excess(here) <= NEAR and (best is None or here.duration <= best[0].duration):
            best = here, coefficients
        if settled and excess(here) > NEAR and best is None:
            # no step helps from beyond the limits: go on from a slower motion
            coefficients = coefficients / (1.0 + max(1.2 * excess(here), 0.05))
            try:
                slower = problem.solve(coefficients, None)
            except SolverError as error:
                raise SolverError(f'{_broken(problem, here)}; {error}') from error
            here, radius, settled = slower, START, False
        if settled:
            break
    if best is None:
        raise SolverError(f'{_broken(problem, here)} after {round_ + 1} rounds')
    return Found(*best, gains, round_ + 1, settled)


def _broken(problem: MinimumTimeProblem[S], solution: S) -> str:
    """Say which limit a motion is most beyond."""
    worst = int(np.abs(solution.shares).max(axis=0).argmax())
    return (
        f'shape_motion: the motion must keep its limits, got {1.0 + excess(solution):.4g} times '
        f'that of {problem.names[worst]} in {solution.duration:.4g} s'
    )


def _corrected(
    problem: MinimumTimeProblem[S],
    here: S,
    found: S,
    jacobian: Array | sparse.csr_array,
    steps: tuple[Array, Array],
    radius: float,
) -> tuple[S | None, Array]:
    """Return the motion of a program with the limits' values as they were found, and where.

    A correction of second order: the derivatives are those of the motion before.
    """
    before, there = steps
    if found.shares.shape != here.shares.shape:
        return found, there
    shares = found.shares.ravel() - jacobian @ (there - before)
    step = _program(
        problem.program(here), here, jacobian, before, radius, shares.reshape(here.shares.shape)
    )
    if step is None:
        return found, there
    again = _attempt(problem, step[0], (here, step[0] - before))
    if again is None or _cost(again, here.duration) >= _cost(found, here.duration):
        return found, there
    return again, step[0]


def _cost(solution: Solution, unit: float) -> float:
    return solution.duration / unit + EXCESS * max(0.0, excess(solution) - 0.5 * NEAR)


def _attempt(
    problem: MinimumTimeProblem[S], coefficients: Array, near: tuple[S, Array]
) -> S | None:
    try:
        return problem.solve(coefficients, near)
    except CancelledError:
        raise
    except SolverError:
        return None


def _program(
    objective: Objective,
    here: Solution,
    jacobian: Array | sparse.csr_array,
    c: Array,
    radius: float,
    shares: Array | None = None,
) -> tuple[Array, float, Array] | None:
    """Return the coefficients of the convex program, its cost, and the rows' multipliers.

    `shares` stand in place of those of the motion.
    """
    p, k = len(c), len(objective.apart) + 1
    scale = np.maximum(np.abs(c), 1e-3 * np.abs(c).max())
    shares = (here.shares if shares is None else shares).ravel()
    rows, sides = _near_rows(shares, jacobian, scale, radius)
    limit = (
        sparse.diags_array(sides) @ sparse.csr_array(jacobian[rows]) @ sparse.diags_array(scale)
    )
    room = 1.0 - KEPT - sides * shares[rows]
    # unknowns: d = (new - old) / scale (p), w (k), times (k - 1), excess
    design = sparse.csr_array(objective.design)
    x_unit = float(np.median(design @ c))
    moved = design @ sparse.diags_array(scale) / x_unit
    count = p + k + (k - 1) + 1
    cost = np.zeros(count)
    cost[p + k : -1] = 2.0 * objective.apart / (np.sqrt(x_unit) * here.duration)
    cost[-1] = EXCESS
    largest = np.maximum(objective.largest * np.median(c) - c, 0.0) / scale
    cones = [
        _bounds(np.minimum(radius, largest), np.full(p, min(radius, 0.9)), count),
        _square_roots(moved, (design @ c) / x_unit, k, count, p),
        _inverses(k, count, p),
    ]
    limits = sparse.hstack(
        [limit, _empty(len(rows), 2 * k - 1), -np.ones((len(rows), 1))], format='csr'
    )
    # dense rows are dear, and limits that a solution keeps without them change nothing
    used = np.flatnonzero((room < FIRST_ROOM) | sparse.issparse(jacobian))
    while True:
        found = _conic(cost, (limits[used], room[used]), cones)
        if found is None:
            return None
        z, multipliers = found
        beyond = np.setdiff1d(np.flatnonzero(limits @ z > room + LEFT), used)
        if not len(beyond):
            break
        used = np.concatenate([used, beyond])
    there = c + scale * z[:p]
    gains = np.zeros(here.shares.shape)
    np.add.at(gains.ravel(), rows[used], np.maximum(multipliers, 0.0))
    cost_there = float(cost[:-1] @ z[:-1]) + EXCESS * max(0.0, float(z[-1]) - KEPT - 0.5 * NEAR)
    return there, cost_there, gains.sum(axis=0)


def _conic(cost: Array, limits: Cones, others: Sequence[Cones]) -> tuple[Array, Array] | None:
    """Return the solution of a conic program and the multipliers of its limits, or None.

    The first of `others` are linear, too; the rest are cones of three rows. clarabel: A z + s = b,
    s in the cone.
    """
    parts = [limits, *others]
    linear = sum(len(right) for _, right in parts[:2])
    b = np.concatenate([right for _, right in parts])
    a = sparse.csc_array(sparse.vstack([rows for rows, _ in parts]))
    cones = [clarabel.NonnegativeConeT(linear)]
    cones += [clarabel.SecondOrderConeT(3)] * ((len(b) - linear) // 3)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    none = sparse.csc_array((len(cost), len(cost)))
    found = clarabel.DefaultSolver(none, cost, a, b, cones, settings).solve()
    if 'Solved' not in str(found.status):
        return None
    return np.array(found.x), np.array(found.z)[: len(limits[1])]


def _bounds(above: Array, below: Array, count: int) -> Cones:
    """Return the rows of steps within a radius, and of an excess that is not negative."""
    p = len(above)
    steps = sparse.hstack([sparse.eye_array(p), _empty(p, count - p)])
    last = sparse.csr_array(([-1.0], ([0], [count - 1])), shape=(1, count))
    return sparse.csr_array(sparse.vstack([steps, -steps, last])), np.concatenate(
        [above, below, np.zeros(1)]
    )


def _near_rows(
    shares: Array, jacobian: Array | sparse.csr_array, scale: Array, radius: float
) -> tuple[NDArray[np.int64], Array]:
    """Return which rows could come to their limit within a radius, and on which side."""
    reach = radius * (abs(jacobian) @ scale)
    found, sides = [], []
    for side in (1.0, -1.0):
        at = np.flatnonzero(side * shares + reach > 1.0 - 2.0 * NEAR)
        found.append(at)
        sides.append(np.full(len(at), side))
    return np.concatenate(found), np.concatenate(sides)


def _empty(rows: int, columns: int) -> sparse.csr_array:
    return sparse.csr_array((rows, columns))


def _square_roots(moved: sparse.csr_array, x_here: Array, k: int, count: int, p: int) -> Cones:
    """Return the cones w_i^2 <= x_i: (x + 1, x - 1, 2 w)."""
    first = sparse.hstack([-moved, _empty(k, count - p)])
    rows = np.arange(k)
    w = sparse.csr_array((np.full(k, -2.0), (rows, p + rows)), shape=(k, count))
    stacked = sparse.csr_array(sparse.vstack([first, first, w]))
    order = np.arange(3 * k).reshape(3, k).T.ravel()
    right = np.stack([x_here + 1.0, x_here - 1.0, np.zeros(k)], axis=1).ravel()
    return stacked[order], right


def _inverses(k: int, count: int, p: int) -> Cones:
    """Return the cones t (w_i + w_{i+1}) >= 1: (t + both, t - both, 2)."""
    n = k - 1
    rows = np.arange(n)
    ones = np.ones(n)
    both = sparse.csr_array(
        (
            np.concatenate([ones, ones]),
            (np.tile(rows, 2), np.concatenate([p + rows, p + rows + 1])),
        ),
        shape=(n, count),
    )
    t = sparse.csr_array((ones, (rows, p + k + rows)), shape=(n, count))
    stacked = sparse.csr_array(sparse.vstack([-(t + both), -(t - both), _empty(n, count)]))
    order = np.arange(3 * n).reshape(3, n).T.ravel()
    right = np.stack([np.zeros(n), np.zeros(n), np.full(n, 2.0)], axis=1).ravel()
    return stacked[order], right
