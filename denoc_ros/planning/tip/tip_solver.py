"""Tip-exact motions on a grid: Gauss-Newton steps with the equations of motion as constraints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from scipy.linalg import lapack

from denoc_ros.dynamics.driven.motion_grid import (
    BETWEEN,
    FIRST,
    REACH,
    SECOND,
    SLOPE,
    differences,
    halfway,
)
from denoc_ros.errors import SolverError, StateError
from denoc_ros.planning.tip.tip_problem import Equations, Momentum, TipProblem
from denoc_ros.types import Array

ITERATIONS = 14
EASED = (30.0, 10.0, 3.0)  # times the draw to the asked joints
HALVINGS = 6
SETTLED = 1e-9  # of the robot's size: equations left, and the next change of errors
STILL = 1e-11  # rad, m: a last change of all coordinates
QUICK = 0.1  # of the change before: steps that get so much shorter settle
ALIKE = 1e-3  # rad, m: change of the coordinates after which another matrix is made
HOLD = 3e-3  # of the robot's size: Levenberg's term where steps go to and fro
BACK = 0.25  # of the step before: a step back by more goes to and fro
GAIN = 1e-3  # share of the errors that a further step must take off where they cannot vanish
NONE_NEARBY = (
    'no bounded motion nearby (ask for a slower motion, or one away from singular postures)'
)
BENDS = np.array([1.0, -2.0, 1.0])
Int = NDArray[np.int64]


class BlockBand:
    """A square matrix of count x count blocks that couple `reach` neighbours on either side.

    It stands in LAPACK's band storage, so memory and time grow linearly with count.

    Parameters
    ----------
    count, size : int
        Blocks along the diagonal, and rows of a block.
    reach : int
    """

    def __init__(self, count: int, size: int, reach: int) -> None:
        self._count, self._size = count, size
        self._width = (reach + 1) * size - 1
        self._rows = 3 * self._width + 1
        # column by column, as Fortran has it; the first `width` rows take what pivoting fills in
        self._band = np.zeros((count * size, self._rows))

    def blocks(self, offset: int, row: int, column: int, rows: int, columns: int) -> Array:
        """Return a view (count - |offset|, rows, columns) of parts of blocks, to write into.

        Entry k is of the block in block column k + max(0, -offset) and `offset` blocks below the
        diagonal, from its row `row` and column `column`.
        """
        size = self._size
        first = max(0, -offset) * size + column
        start = self._band[first:, 2 * self._width + offset * size + row - column :]
        stride = self._band.itemsize
        along = (size * self._rows * stride, stride, (self._rows - 1) * stride)
        return as_strided(start, (self._count - abs(offset), rows, columns), along)

    def factor(self) -> bool:
        """Put the matrix's factors in its place; False where it is singular."""
        self._factors, self._pivots, info = lapack.dgbtrf(
            self._band.T, self._width, self._width, overwrite_ab=1
        )
        return bool(info == 0)

    def solve(self, right: Array) -> Array:
        """Return x (count, size) of matrix x = right, of a matrix that is factored.

        Several right sides (count, size, m) are solved together.
        """
        columns = right.reshape(self._count * self._size, *right.shape[2:])
        x, _ = lapack.dgbtrs(self._factors, self._width, self._width, columns, self._pivots)
        return np.asarray(x).reshape(right.shape)


def add_equations(equations: Equations, band: BlockBand, step: float, end: Int) -> None:
    """Write the equations' derivatives by all nodes, and their transposes, into the band.

    Of the first node no coordinate moves, of the last one those of `end`. Where none moves,
    closure is no equation.
    """
    k, p, n = equations.by_q.shape
    m = equations.by_multipliers.shape[2]
    at, fixed = n + m, np.setdiff1d(np.arange(n), end)
    for column, (first, second) in enumerate(zip(FIRST, SECOND, strict=True)):
        offset = column - REACH
        entry = (first / step) * equations.by_qd + (second / step**2) * equations.by_qdd
        if offset == 0:
            entry += equations.by_q
        # the row of node j has the column of node j + offset
        entry = entry[max(0, -offset) : k - max(0, offset)]
        if offset <= 0:
            entry[0] = 0.0
        if offset >= 0:
            entry[-1] = _by_end(equations, step, offset)
            entry[-1][:, fixed] = 0.0
        band.blocks(-offset, at, 0, p, n)[...] = entry
        band.blocks(offset, 0, at, n, p)[...] = entry.transpose(0, 2, 1)
    if m:
        band.blocks(0, at, n, p, m)[...] = equations.by_multipliers
        band.blocks(0, n, at, m, p)[...] = equations.by_multipliers.transpose(0, 2, 1)
        closure, ends = np.arange(p - m, p), np.array([0] if len(end) else [0, k - 1])
        band.blocks(0, at, at, p, p)[np.ix_(ends, closure, closure)] += np.eye(m)


def _by_end(equations: Equations, step: float, offset: int) -> Array:
    """Return how the equations (p, n) of the node `offset` before the last change with the last.

    All nodes beyond it are as it is.
    """
    row, beyond = len(equations.by_q) - 1 - offset, REACH + offset
    found = (FIRST[beyond:].sum() / step) * equations.by_qd[row]
    found = found + (SECOND[beyond:].sum() / step**2) * equations.by_qdd[row]
    return np.asarray(found if offset else found + equations.by_q[row])


def add_momentum(momentum: Momentum, band: BlockBand, step: float, end: Int, at: int) -> None:
    """Write the derivatives of the momentum half-way after each node into rows from `at` on.

    Of the first node no coordinate moves, of the last one those of `end`.
    """
    between, six, n = momentum.by_q.shape
    if not six:
        return
    fixed = np.setdiff1d(np.arange(n), end)
    for column, (share, slope) in enumerate(zip(BETWEEN, SLOPE, strict=True)):
        offset = column - 1
        entry = share * momentum.by_q + (slope / step) * momentum.by_qd
        if offset == 1:  # the node beyond the last is as the last
            entry[-1] += BETWEEN[-1] * momentum.by_q[-1] + SLOPE[-1] / step * momentum.by_qd[-1]
        # the row after node j has the column of node j + offset
        entry = entry[max(0, -offset) : between - max(0, offset - 1)]
        if offset <= 0:
            entry[0] = 0.0
        if offset >= 1:
            entry[-1][:, fixed] = 0.0
        band.blocks(-offset, at, 0, six, n)[: len(entry)] = entry
        band.blocks(offset, 0, at, n, six)[: len(entry)] = entry.transpose(0, 2, 1)
    band.blocks(0, at, at, six, six)[-1] = np.eye(six)


class CancelledError(SolverError):
    """The work was ended from outside."""


@dataclass(frozen=True)
class Solved:
    """A motion on the grid with how it was found.

    Attributes
    ----------
    q : (k, n) array
    multipliers : (k, m) array
        Of loops and mimic joints, over the problem's stiffness.
    equation : float
        The largest force without an actuator, over its stiffness [m, rad].
    iterations : int
    """

    q: Array
    multipliers: Array
    equation: float
    iterations: int


def solve_motion(
    problem: TipProblem,
    guess: tuple[Array, Array],
    step: float,
    size: float,
    report: Callable[[int, float], None],
) -> Solved:
    """Return the motion that obeys the equations and comes nearest to the targets.

    Arguments and errors as of :func:`settle`. Where it does not settle (an arm that is stretched,
    and moves along itself), the joints are first drawn to the asked motion more strongly and made
    smoother, then drawn less and less, as long as that settles.
    """
    try:
        return settle(problem, guess, step, size, report)
    except CancelledError:
        raise
    except SolverError as error:
        reason = error
    found: Solved | None = None
    for factor in EASED:
        try:
            found = settle(problem.eased(factor), guess, step, size, report)
        except CancelledError:
            raise
        except SolverError:
            if found is not None:
                break
        else:
            guess = found.q, found.multipliers
    if found is None:
        raise reason
    return found


def settle(
    problem: TipProblem,
    guess: tuple[Array, Array],
    step: float,
    size: float,
    report: Callable[[int, float], None],
) -> Solved:
    """Return the motion that Gauss-Newton steps from a guess find.

    Parameters
    ----------
    problem : TipProblem
        It becomes `curved` where steps go to and fro.
    guess : (k, n) and (k, m) arrays
        Coordinates and multipliers to begin with; the coordinates' first and last row stay: there
        the robot rests. Of a robot that floats, joints and base of the last row are free.
    step : float
        Between nodes [s].
    size : float
        Of the robot [m].
    report : callable
        Takes the number of each iteration and the equations' largest residual; may raise.

    Raises
    ------
    SolverError
        None was found; with what is left.
    """
    floor = SETTLED * size
    q, multipliers = guess
    motion = differences(q, step)
    value, errors = _values(problem, q, motion, multipliers, step)
    hold, last, way = 0.0, np.inf, np.zeros_like(q)
    matrix: BlockBand | None = None
    for iteration in range(ITERATIONS):
        report(iteration, float(np.abs(value).max(initial=0.0)))
        jacobian, fresh = problem.error_derivatives(q, errors), matrix is None
        try:
            if matrix is None:
                rows = (
                    problem.equations(q, *motion, multipliers),
                    problem.momentum(*halfway(q, step)),
                )
                hessian = problem.hessian(q, errors, jacobian)
                matrix, since = _matrix(problem, hessian, rows, step, hold), 0.0
            changes = None
            if matrix is not None:
                changes = _changes(problem, matrix, (q, value, errors), jacobian)
        except StateError as error:
            raise _diverged(problem, iteration, str(error)) from error
        if changes is None:
            raise SolverError(
                f'shape_motion: {problem.robot.tree.name}: the equations at iteration {iteration} '
                f'must have a solution, got a singular matrix of {len(q)} nodes: '
                f'{NONE_NEARBY}'
            )
        before = value, errors
        for halving in range(HALVINGS + 1):
            share = 0.5**halving
            q_new, forces = q + share * changes[0], multipliers + share * changes[1]
            motion = differences(q_new, step)
            value, errors = _values(problem, q_new, motion, forces, step)
            if _better(value, errors, *before, floor):
                break
        if not (np.isfinite(value).all() and np.isfinite(errors).all()):
            raise _diverged(problem, iteration, f'no finite forces after {HALVINGS} halvings')
        q, multipliers = q_new, forces
        worst = float(np.abs(value).max(initial=0.0))
        moved = float(np.abs(errors - before[1]).max())
        gain = 1.0 - float(np.linalg.norm(errors) / max(np.linalg.norm(before[1]), 1e-300))
        # equations at what rounding leaves of accelerations on a fine grid do not get any smaller
        still = not halving and float(np.abs(changes[0]).max()) <= STILL
        # a further step changes as much less as this one did than the one before
        ahead = moved * min(moved / last, 1.0) if iteration and not halving else moved
        if still or (worst <= floor and (ahead <= floor or (hold > 0.0 and abs(gain) < GAIN))):
            return Solved(q, multipliers, worst, iteration + 1)
        back = float(np.sum(way * changes[0])) < -BACK * float(np.sum(way**2))
        way = changes[0]
        slow = iteration > 1 and (halving > 0 or back or moved > 0.5 * last)
        since += max(float(np.abs(change).max(initial=0.0)) for change in changes)
        # errors that stay weigh the equations' derivatives, which must be those of the solution
        unreached = len(problem.unreached(errors)) > 0
        stale = hold > 0.0 or since > ALIKE or (problem.curved and unreached)
        if not moved < QUICK * last or stale:
            matrix = None
        if slow and fresh and unreached and not problem.curved:
            problem.curved, matrix = True, None
        elif slow and fresh:
            hold = min(max(2.0 * hold, HOLD * size), size)
        elif moved < 0.1 * last:
            hold *= 0.25
        last = moved
    raise SolverError(
        f'shape_motion: {problem.robot.tree.name}: the motion must settle in {ITERATIONS} '
        f'iterations, got forces without an actuator of {worst:.3g} m (or rad) over their '
        f'stiffness and a last change of the tip of {moved:.3g} m: {NONE_NEARBY}'
    )


def _diverged(problem: TipProblem, iteration: int, what: str) -> SolverError:
    return SolverError(
        f'shape_motion: {problem.robot.tree.name}: the motion must settle, got one that diverges '
        f'at iteration {iteration} ({what}): {NONE_NEARBY}'
    )


def _values(
    problem: TipProblem,
    q: Array,
    motion: tuple[Array, Array],
    multipliers: Array,
    step: float,
) -> tuple[Array, Array]:
    """Return all equations' values and the errors; infinite ones where forces overflow.

    Equations hold at the nodes, and for a floating base's momentum between them.
    """
    try:
        parts = problem.residual(q, *motion, multipliers), problem.drift(*halfway(q, step))
        return np.concatenate([part.ravel() for part in parts]), problem.errors(q)
    except StateError:  # a step so long that the numbers are not finite
        return np.full(1, np.inf), np.full(1, np.inf)


def _better(value: Array, errors: Array, old: Array, old_errors: Array, floor: float) -> bool:
    """Say whether equations or errors have become smaller, or the equations are good."""
    if not (np.isfinite(value).all() and np.isfinite(errors).all()):
        return False
    left, before = (float(np.abs(x).max(initial=0.0)) for x in (value, old))
    good = left <= max(floor, 0.9 * before)
    return good or bool(np.linalg.norm(errors) < np.linalg.norm(old_errors))


def _changes(
    problem: TipProblem, matrix: BlockBand, at: tuple[Array, Array, Array], jacobian: Array
) -> tuple[Array, Array] | None:
    """Return the changes (k, n) and (k, m) of one Gauss-Newton step, or None if not finite.

    `at` has coordinates, equations' values and errors, `jacobian` the errors' derivatives.
    """
    q, value, errors = at
    (k, n), m, six = q.shape, problem.loops.count, len(problem.base)
    equations = n + m + len(problem.undriven) + m
    right = np.zeros((k, equations + six))
    right[:, :n] = -np.einsum('kij,ki->kj', jacobian, errors)
    _add_pull(problem, -(q - problem.asked)[:, problem.driven], right)
    _fix_ends(problem, right)
    residual, drift = np.split(value, [len(value) - (k - 1) * six])
    right[:, n + m : equations] = -residual.reshape(k, -1)
    right[:-1, equations:] = -drift.reshape(k - 1, six)
    return _finite(matrix.solve(right), n, m)


def _finite(solution: Array, n: int, m: int) -> tuple[Array, Array] | None:
    """Return the changes of coordinates and multipliers in a solution, or None if not finite."""
    good = np.isfinite(solution).all()
    return (solution[:, :n], solution[:, n : n + m]) if good else None


def sensitivity(
    problem: TipProblem,
    solved: Solved,
    step: float,
    path: tuple[Array, Array],
    by: tuple[Array, Array],
) -> tuple[Array, Array] | None:
    """Return the change of a solution as the asked motion moves along its path, and the step.

    Parameters
    ----------
    problem : TipProblem
    solved : Solved
        Of the problem.
    step : float
        Between nodes [s].
    path : (k, 6 targets) and (k, n) arrays
        Weighed twists of the targets, and the asked coordinates, per unit of the path.
    by : (k, p) and (p,) arrays
        By how much each node moves along the path, and the step as a share of itself, per unit
        of each parameter.

    Returns
    -------
    (k, n, p) and (k, m, p) arrays, or None where the equations have no solution
        Of the coordinates and the multipliers, at the nodes.

    Notes
    -----
    The implicit function of the conditions that :func:`settle` meets, by one factorization; the
    part of their second derivatives that vanishes with the tip's error is left out. With a longer
    step, the same coordinates at the nodes have smaller rates and accelerations.
    """
    q, n = solved.q, solved.q.shape[1]
    motion, between = (q, *differences(q, step), solved.multipliers), halfway(q, step)
    equations, momentum = problem.equations(*motion), problem.momentum(*between)
    _, p, m = equations.by_multipliers.shape
    errors = problem.errors(q)
    jacobian = problem.error_derivatives(q, errors)
    hessian = problem.hessian(q, errors, jacobian)
    matrix = _matrix(problem, hessian, (equations, momentum), step, 0.0)
    if matrix is None:
        return None
    moved, longer = by
    right = np.zeros((len(q), n + m + p + momentum.by_q.shape[1], moved.shape[1]))
    twists, asked = path
    right[:, :n] = np.einsum('kij,ki->kj', jacobian, twists)[:, :, None] * moved[:, None]
    _add_pull(problem, asked[:, problem.driven, None] * moved[:, None], right)
    _fix_ends(problem, right)
    slower = np.einsum('kij,kj->ki', equations.by_qd, motion[1])
    slower += 2.0 * np.einsum('kij,kj->ki', equations.by_qdd, motion[2])
    right[:, n + m : n + m + p] = slower[:, :, None] * longer
    slower = np.einsum('kij,kj->ki', momentum.by_qd, between[1])
    right[:-1, n + m + p :] = slower[:, :, None] * longer
    return _finite(matrix.solve(right), n, m)


def _matrix(
    problem: TipProblem,
    hessian: Array,
    rows: tuple[Equations, Momentum],
    step: float,
    hold: float,
) -> BlockBand | None:
    """Return the matrix of a Gauss-Newton step, factored; None if it is singular.

    It has the costs' Hessian and the equations; `hold` [m per rad or m] weighs the driven joints'
    change (Levenberg's term).
    """
    equations, momentum = rows
    k, p, n = equations.by_q.shape
    m = equations.by_multipliers.shape[2]
    band = BlockBand(k, n + m + p + momentum.by_q.shape[1], REACH)
    hessian[:, problem.driven, problem.driven] += problem.draw**2 + hold**2
    _add_smoothness(problem, band, hessian)
    for node, free in ((0, problem.end[:0]), (-1, problem.end)):
        fixed = np.setdiff1d(np.arange(n), free)
        hessian[node, fixed] = hessian[node, :, fixed] = 0.0
        hessian[node, fixed, fixed] = 1.0
    band.blocks(0, 0, 0, n, n)[...] += hessian
    add_equations(equations, band, step, problem.end)
    add_momentum(momentum, band, step, problem.end, n + m + p)
    return band if band.factor() else None


def _fix_ends(problem: TipProblem, right: Array) -> None:
    """Keep the coordinates that do not move at the first and last node."""
    right[0, : problem.robot.n] = 0.0
    right[-1, np.setdiff1d(np.arange(problem.robot.n), problem.end)] = 0.0


def _add_pull(problem: TipProblem, apart: Array, right: Array) -> None:
    """Add the pull on the driven joints by distances (k, driven, …), and on their bends."""
    j, weight, k = problem.driven, problem.smooth**2, len(apart)
    right[:, j] += problem.draw**2 * apart
    bend = apart[:-2] - 2.0 * apart[1:-1] + apart[2:]
    for row, share in enumerate(BENDS):
        right[row : k - 2 + row, j] += weight * share * bend


def _add_smoothness(problem: TipProblem, band: BlockBand, hessian: Array) -> None:
    """Add the cost of second differences of the driven joints' distance from the asked ones.

    Without it, vibrations near the grid's highest frequency in which the tip stands still (zeros
    of the robot that neither grow nor decay) would be found only to a few digits.
    """
    j, weight, (k, n) = problem.driven, problem.smooth**2, hessian.shape[:2]
    for row, share in enumerate(BENDS):
        at = np.zeros(k)
        at[row : k - 2 + row] = weight * share**2
        hessian[:, j, j] += at[:, None]
    for offset in (1, 2):
        entry = np.zeros((k - offset, len(problem.driven)))
        for row in range(3 - offset):
            entry[row : k - 2 + row] += weight * BENDS[row] * BENDS[row + offset]
        entry[0] = 0.0  # the first node does not move
        if not len(problem.end):
            entry[-1] = 0.0
        for sign in (1, -1):
            view = band.blocks(sign * offset, 0, 0, n, n)
            view[:, j, j] += entry
