"""The shortest motion within limits: convex programs in the coefficients of a timing."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import clarabel
import numpy as np
import scipy.sparse as sparse

from denoc_ros.dynamics.driven.motion_plan import LimitUse, Plan
from denoc_ros.errors import SolverError
from denoc_ros.planning.timing.limit_rows import LimitRows
from denoc_ros.planning.tip.tip_solver import CancelledError
from denoc_ros.types import Array

ROUNDS = 40
STEADY = 1e-3  # share of the duration that a round must save
# price of a share beyond a limit, in durations: about what a share of all limits saves, so that
# steps of a search may be beyond them by a little; and where that leaves a motion beyond them
EXCESS, DEAR = 2.0, 20.0
NEAR = 1e-3  # share beyond a limit that counts as kept
KEPT = 1e-3  # share of each limit that programs keep free
START, LEAST, MOST = 0.5, 2e-3, 4.0  # of the trust region, as a share of each coefficient
GOOD, POOR = 0.7, 0.2  # share of a predicted gain that is found
NEARBY = 0.3  # of a limit: rows that a program looks at first
CUTS = 6  # programs, each with the rows that the one before exceeds
AGAIN = 8  # times that limits are made narrower where a finer plan is beyond them
FURTHER = 1.2  # times what it is beyond them, so that once is enough
TIGHTEN = 4  # rounds each time
SLOWER = 8  # times that a motion is made slower where that is not enough
WITHIN = 1e-3  # share beyond a limit that a plan may be


class Solution(Protocol):
    """A motion with some coefficients.

    Attributes
    ----------
    duration : float
        s.
    cost : float
        That is to be the least: the duration [s], or with more.
    coefficients : (p,) array
    shares : (k, r) array
        Of the limits; at each moment, of each row.
    """

    @property
    def duration(self) -> float:
        """Of the motion."""

    @property
    def cost(self) -> float:
        """That is to be the least."""

    @property
    def coefficients(self) -> Array:
        """Of the motion."""

    @property
    def shares(self) -> Array:
        """Of the limits."""


S = TypeVar('S', bound=Solution)


class MinimumTimeProblem(Protocol[S]):
    """A motion whose duration is to be the least.

    Attributes
    ----------
    names : tuple of str
        Of the rows.
    price : float
        Of a share beyond a limit, as a share of the cost, to begin with.
    steady : float
        Share of the cost that a round must save.
    """

    names: tuple[str, ...]
    price: float
    steady: float

    def solve(self, coefficients: Array, near: tuple[S, Array] | None) -> S:
        """Return the motion; `near` is one with its change of coefficients to this one."""

    def jacobian(self, solution: S) -> Array | sparse.csr_array:
        """Return the derivatives (k r, p) of the shares, row by row."""

    def shares_at(self, found: S, here: S) -> Array:
        """Return the shares (k, r) of a motion at the places of another motion's rows."""

    def program(self, solution: S) -> Objective:
        """Return the cost as a function of the coefficients."""

    def slower(self, coefficients: Array, factor: float) -> Array:
        """Return the coefficients of a motion that needs a factor less of its limits."""

    def plan(self, found: S) -> Plan:
        """Return the plan of a motion, with finer steps."""

    def places(self, plan: Plan) -> Array:
        """Return the places along the motion (k,), 0 to 1, of a plan's rows."""


@dataclass(frozen=True)
class Part:
    """A convex cost as a part of a program: of d = (new - old) / scale, and of own unknowns.

    Attributes
    ----------
    scale, least, most : (p,) arrays
        Of the coefficients, and bounds of d.
    linear : (p + own,) array
    quadratic : (p, p) array or None
    constant : float
    rows : (m, p + own) array
    right : (m,) array
    cones : list
        rows z + s = right with s in the cones.
    room : float
        How far below 1 a smaller largest share of the limits is still worth its price.
    trusted : (t, p) array
        Further numbers of d that change by the radius of the trust region at most.
    """

    scale: Array
    least: Array
    most: Array
    linear: Array
    quadratic: Array | None
    constant: float
    rows: sparse.csr_array
    right: Array
    cones: list[object]
    room: float = 0.0
    trusted: Array | None = None


class Objective(Protocol):
    """A convex cost of coefficients."""

    def part(self, c: Array, unit: float) -> Part:
        """Return its part of a program at coefficients (p,), over a unit."""


@dataclass(frozen=True)
class PathDuration:
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

    def part(self, c: Array, unit: float) -> Part:
        """Return its part of a program: its own unknowns are w (k) and times (k - 1)."""
        p, k = len(c), len(self.apart) + 1
        scale = np.maximum(np.abs(c), 1e-3 * np.abs(c).max())
        design = sparse.csr_array(self.design)
        x_unit = float(np.median(design @ c))
        moved = design @ sparse.diags_array(scale) / x_unit
        count = p + k + (k - 1)
        linear = np.zeros(count)
        linear[p + k :] = 2.0 * self.apart / (np.sqrt(x_unit) * unit)
        first, first_right = _square_roots(moved, (design @ c) / x_unit, k, count, p)
        second, second_right = _inverses(k, count, p)
        return Part(
            scale,
            np.full(p, -0.9),
            np.maximum(self.largest * np.median(c) - c, 0.0) / scale,
            linear,
            None,
            0.0,
            sparse.csr_array(sparse.vstack([first, second])),
            np.concatenate([first_right, second_right]),
            [clarabel.SecondOrderConeT(3)] * (2 * k - 1),
        )


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
    steady: float | None = None,
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
    steady : float, optional
        Share of the duration that a round must save; default: the problem's.

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
    steady = problem.steady if steady is None else steady
    here = problem.solve(start, None)
    coefficients, radius = here.coefficients, START
    best: tuple[S, Array] | None = (here, coefficients) if excess(here) <= NEAR else None
    gains, price = np.zeros(len(problem.names)), problem.price
    settled, round_ = False, 0
    for round_ in range(rounds):
        report(1.0 - 0.85**round_)
        if stopped():
            break
        jacobian = problem.jacobian(here)
        cost = _cost(here, here.cost, price)
        while True:
            step = program(problem.program(here), here, jacobian, coefficients, radius, price)
            if step is None:
                radius *= 0.3
            else:
                there, expected, gains_there, length = step
                wanted = cost - expected
                if wanted <= steady * (1.0 if excess(here) <= NEAR else 0.1):
                    settled, gains = True, gains_there
                    break
                found = _attempt(problem, there, (here, there - coefficients))
                if found is not None and cost - _cost(found, here.cost, price) < POOR * wanted:
                    found, there = _corrected(
                        problem, (here, found), jacobian, (coefficients, there), radius, price
                    )
                gain = -np.inf if found is None else cost - _cost(found, here.cost, price)
                if found is not None and gain >= POOR * wanted:
                    here, coefficients, gains = found, found.coefficients, gains_there
                    good = gain >= GOOD * wanted
                    # the next gain is as much less than this one as the step was short
                    small = length < radius and length * wanted <= steady
                    settled = good and small and excess(here) <= NEAR
                    radius = min(2.0 * radius, MOST) if good else radius
                    break
                radius = 0.4 * min(radius, length)
            if radius < LEAST or stopped():
                settled = radius < LEAST
                break
        if excess(here) <= NEAR and (best is None or here.cost <= best[0].cost):
            best = here, coefficients
        if settled and excess(here) > NEAR and price < DEAR:
            price, radius, settled = DEAR, START, False
        elif settled and excess(here) > NEAR:
            # no step helps from beyond the limits: go on from a slower motion
            slower = problem.slower(coefficients, 1.0 + max(1.2 * excess(here), 0.05))
            try:
                calmer = problem.solve(slower, None)
            except SolverError as error:
                if best is not None:
                    break
                raise SolverError(f'{_broken(problem, here)}; {error}') from error
            if best is None or calmer.cost < (1.0 - steady) * best[0].cost:
                here, coefficients, radius, settled = calmer, slower, START, False
        if settled:
            break
    if best is None:
        raise SolverError(f'{_broken(problem, here)} after {round_ + 1} rounds')
    return Found(*best, gains, round_ + 1, settled)


def shortest_plan(
    problem: MinimumTimeProblem[S],
    first: Array,
    rows: LimitRows,
    progress: Callable[[float], object] | None,
    cancel: Callable[[], bool] | None,
    search: Callable[..., Found[S]] = shortest,
) -> Plan:
    """Return the plan of the shortest motion, made a little slower where it needs that.

    Arguments and errors as of :func:`shortest`; `search` is it, or another with its arguments.
    """
    stopped = cancel or (lambda: False)
    found = search(problem, first, progress or quiet, stopped)
    return checked_plan(problem, found, rows, stopped, search)


def quiet(_share: float) -> None:
    """Report nothing."""


def checked_plan(
    problem: MinimumTimeProblem[S],
    found: Found[S],
    rows: LimitRows,
    stopped: Callable[[], bool],
    search: Callable[..., Found[S]] = shortest,
) -> Plan:
    """Return the plan of a motion that was found, made a little slower where it needs that.

    `search` is :func:`shortest`, or another with its first five arguments.
    """
    plans: list[tuple[Plan, LimitUse]] = []

    def look(solution: S) -> tuple[Array, Array]:
        plan = problem.plan(solution)
        plans.append((plan, rows.use(plan)))
        return problem.places(plan), plans[-1][1].shares

    found = kept(problem, found, rows, look, stopped, search)
    plan, use = plans[-1]
    gains = dict.fromkeys(problem.names, 0.0)
    for name, gain in zip(problem.names, found.gains, strict=True):
        gains[name] += 0.01 * gain
    return replace(plan, limits=replace(use, gains=gains, settled=found.settled))


def kept(
    problem: MinimumTimeProblem[S],
    found: Found[S],
    rows: LimitRows,
    look: Callable[[S], tuple[Array, Array]],
    stopped: Callable[[], bool],
    search: Callable[..., Found[S]] = shortest,
) -> Found[S]:
    """Return a motion that keeps its limits between the moments of the search as well.

    Where it is beyond them they are made narrower, and it is searched for again; where that is
    not enough it is made a little slower. `look` returns places (k,) along a motion, 0 to 1, and
    the limits' shares (k, rows) there. The other arguments are those of :func:`checked_plan`.
    """
    for again in range(AGAIN + SLOWER):
        places, shares = look(found.solution)
        beyond = np.abs(shares).max(axis=0, initial=0.0) - 1.0
        if not beyond.max(initial=0.0) > WITHIN:
            return found
        narrowed = None
        with suppress(SolverError):
            # between the moments of the search: there the limits are made narrower, until it has
            # something to mend
            for _ in range(AGAIN if again < AGAIN else 0):
                over = FURTHER * (np.abs(shares) - 1.0)
                rows.narrow(places, np.where(over > 0.0, 1.0 + over, 0.0))
                if excess(problem.solve(found.coefficients, None)) > NEAR:
                    narrowed = search(problem, found.coefficients, quiet, stopped, TIGHTEN)
                    break
        if narrowed is not None and not np.array_equal(narrowed.coefficients, found.coefficients):
            found = replace(narrowed, settled=found.settled and narrowed.settled)
        else:
            slower = problem.slower(found.coefficients, 1.0 + 1.1 * float(beyond.max()))
            solution = problem.solve(slower, None)
            found = replace(found, solution=solution, coefficients=solution.coefficients)
    name = rows.names[int(beyond.argmax())]
    raise SolverError(
        f'shape_motion: {name} must keep its limit, got {1.0 + float(beyond.max()):.4g} times '
        'that of the shortest motion that was found'
    )


def _broken(problem: MinimumTimeProblem[S], solution: S) -> str:
    """Say which limit a motion is most beyond."""
    worst = int(np.abs(solution.shares).max(axis=0).argmax())
    return (
        f'shape_motion: the motion must keep its limits, got {1.0 + excess(solution):.4g} times '
        f'that of {problem.names[worst]} in {solution.duration:.4g} s'
    )


def _corrected(
    problem: MinimumTimeProblem[S],
    motions: tuple[S, S],
    jacobian: Array | sparse.csr_array,
    steps: tuple[Array, Array],
    radius: float,
    price: float,
) -> tuple[S | None, Array]:
    """Return the motion of a program with the limits' values as they were found, and where.

    A correction of second order: the derivatives are those of the motion before.
    """
    (here, found), (before, there) = motions, steps
    shares = problem.shares_at(found, here).ravel() - jacobian @ (there - before)
    step = program(
        problem.program(here),
        here,
        jacobian,
        before,
        radius,
        price,
        shares.reshape(here.shares.shape),
    )
    if step is None:
        return found, there
    again = _attempt(problem, step[0], (here, step[0] - before))
    if again is None or _cost(again, here.cost, price) >= _cost(found, here.cost, price):
        return found, there
    return again, step[0]


def _cost(solution: Solution, unit: float, price: float) -> float:
    return solution.cost / unit + price * max(0.0, excess(solution) - 0.5 * NEAR)


def _attempt(
    problem: MinimumTimeProblem[S], coefficients: Array, near: tuple[S, Array]
) -> S | None:
    try:
        return problem.solve(coefficients, near)
    except CancelledError:
        raise
    except SolverError:
        return None


def program(
    objective: Objective,
    here: Solution,
    jacobian: Array | sparse.csr_array,
    c: Array,
    radius: float,
    price: float,
    shares: Array | None = None,
) -> tuple[Array, float, Array, float] | None:
    """Return the convex program's coefficients, its cost, the rows' multipliers, and its step.

    `shares` stand in place of those of the motion.
    """
    p, part = len(c), objective.part(c, here.cost)
    scale, count = part.scale, len(part.linear) + 1
    shares = (here.shares if shares is None else shares).ravel()
    reach = radius * (abs(jacobian) @ scale)
    level = min(1.0, float(np.abs(shares).max(initial=0.0))) if part.room else 1.0
    near = [side * shares + np.minimum(reach, NEARBY) > level - 2.0 * NEAR for side in (1.0, -1.0)]
    eye = sparse.eye_array(p)
    trusted = np.zeros((0, p)) if part.trusted is None else part.trusted
    bounds = [
        sparse.hstack([eye, _empty(p, count - p)]),
        sparse.hstack([-eye, _empty(p, count - p)]),
        sparse.hstack([np.vstack([trusted, -trusted]), _empty(2 * len(trusted), count - p)]),
        sparse.csr_array(([-1.0], ([0], [count - 1])), shape=(1, count)),
        sparse.hstack([part.rows, _empty(len(part.right), 1)]),
    ]
    within = [
        np.minimum(radius, part.most),
        np.minimum(radius, -part.least),
        np.full(2 * len(trusted), radius),
        np.array([part.room]),
    ]
    quadratic = sparse.csc_array((count, count))
    if part.quadratic is not None:  # its upper triangle
        own = sparse.coo_array(np.triu(part.quadratic))
        quadratic = sparse.csc_array((own.data, own.coords), shape=(count, count))
    cost = np.append(part.linear, price)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    for _ in range(CUTS):
        rows = np.concatenate([np.flatnonzero(each) for each in near])
        sides = np.repeat([1.0, -1.0], [np.count_nonzero(each) for each in near])
        limit = sparse.csr_array(jacobian[rows])
        limit = sparse.diags_array(sides) @ limit @ sparse.diags_array(scale)
        # unknowns: d (p), those of the objective, excess; clarabel: A z + s = b, s in the cone
        column = sparse.csr_array(np.ones((len(rows), 1)))
        first = sparse.hstack([limit, _empty(len(rows), count - p - 1), -column])
        right = [1.0 - KEPT - sides * shares[rows], *within, part.right]
        found = clarabel.DefaultSolver(
            quadratic,
            cost,
            sparse.csc_array(sparse.vstack([first, *bounds])),
            np.concatenate(right),
            [clarabel.NonnegativeConeT(sum(map(len, right[:-1]))), *part.cones],
            settings,
        ).solve()
        if 'Solved' not in str(found.status):
            return None
        z = np.array(found.x)
        d = z[:p]
        there = shares + jacobian @ (scale * d)
        more = [
            (side * there > 1.0 + z[-1]) & ~each
            for side, each in zip((1.0, -1.0), near, strict=True)
        ]
        if not (more[0].any() or more[1].any()):
            break
        near = [old | new for old, new in zip(near, more, strict=True)]
    gains = np.zeros(here.shares.shape)
    np.add.at(gains.ravel(), rows, np.maximum(np.array(found.z)[: len(rows)], 0.0))
    cost_there = part.constant + float(cost[:-1] @ z[:-1])
    if part.quadratic is not None:
        cost_there += 0.5 * float(d @ part.quadratic @ d)
    cost_there += price * max(-part.room, float(z[-1]) - KEPT - 0.5 * NEAR)
    return c + scale * d, cost_there, gains.sum(axis=0), float(np.abs(d).max())


def _empty(rows: int, columns: int) -> sparse.csr_array:
    return sparse.csr_array((rows, columns))


def _square_roots(
    moved: sparse.csr_array, x_here: Array, k: int, count: int, p: int
) -> tuple[sparse.csr_array, Array]:
    """Return the cones w_i^2 <= x_i: (x + 1, x - 1, 2 w)."""
    first = sparse.hstack([-moved, _empty(k, count - p)])
    rows = np.arange(k)
    w = sparse.csr_array((np.full(k, -2.0), (rows, p + rows)), shape=(k, count))
    stacked = sparse.csr_array(sparse.vstack([first, first, w]))
    order = np.arange(3 * k).reshape(3, k).T.ravel()
    right = np.stack([x_here + 1.0, x_here - 1.0, np.zeros(k)], axis=1).ravel()
    return stacked[order], right


def _inverses(k: int, count: int, p: int) -> tuple[sparse.csr_array, Array]:
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
