"""Closed configurations and rates near a guess, and the degrees of freedom that loops leave."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from denoc_ros.dynamics.constrained_dynamics import RANK, closure_rows, jacobian, least_solution
from denoc_ros.dynamics.robot_model import RobotModel
from denoc_ros.errors import SolverError, StateError
from denoc_ros.types import Array

Int = NDArray[np.int64]

CLOSED = 1e-10  # m or rad; rounding leaves 1e-15 of the robot's size
PRINTED = 1e-4  # m or rad, what 1.5708 for a right angle may leave
NUDGES = (0.05, 0.2, 0.5)  # rad or m
POLISH = 3  # Gauss-Newton steps at the end: each squares the error


def assemble(robot: RobotModel, guess: Array, fixed: Sequence[str]) -> Array:
    """Return closed coordinates (n,) near a guess (see :meth:`Robot.assemble`)."""
    worst = np.full(1, np.inf)
    for free in _choices(robot, fixed):
        for start in _starts(guess, free):
            try:
                q = _closed(robot, start, free)
                error = closure_rows(robot, q, np.zeros(robot.n))[0]
            except StateError:
                continue  # frames opposite to each other have no rotation error
            if np.abs(error).max(initial=0.0) <= CLOSED:
                return q
            worst = min(worst, error, key=lambda rows: float(np.abs(rows).max()))
    raise _failure(robot, worst, 'm or rad')


def close_nearby(
    robot: RobotModel,
    q: Array,
    free: Int,
    change: Callable[[Array, Array], Array],
    tolerance: float,
    steps: int,
) -> float:
    """Close q (n,) in place by Newton's steps; return the error that was left before the last.

    Parameters
    ----------
    free : (f,) int array
        The coordinates that move.
    change : callable
        Takes closure errors (rows,) and the Jacobian's columns of the free coordinates, (rows, f);
        returns the change (f,) that takes the errors away.
    tolerance : float
        m or rad, at which no further step is needed.
    """
    left, zero = np.inf, np.zeros(robot.n)
    for _ in range(steps):
        error = closure_rows(robot, q, zero)[0]
        left = float(np.abs(error).max(initial=0.0))
        if left <= tolerance:
            break
        q[free] -= change(error, jacobian(robot, q)[0][:, free])
    return left


def least_change(error: Array, rows: Array) -> Array:
    """Return the smallest change (f,) that takes closure errors away, by rows (rows, f)."""
    return least_solution(rows, error)[0]


def _starts(guess: Array, free: Int) -> Iterator[Array]:
    """Yield the guess, then others beside it: a mechanism drawn flat has no slope to follow."""
    yield guess
    rng = np.random.default_rng(0)
    for size in NUDGES:
        start = guess.copy()
        start[free] += rng.uniform(-size, size, len(free))
        yield start


def assemble_rates(robot: RobotModel, q: Array, guess: Array, fixed: Sequence[str]) -> Array:
    """Return rates (n,) near a guess that keep the loops closed."""
    rows, _ = jacobian(robot, q)
    for free in _choices(robot, fixed):
        qd: Array = guess.copy()
        for _ in range(POLISH):
            qd[free] -= least_change(rows @ qd, rows[:, free])
        if np.abs(rows @ qd).max(initial=0.0) <= CLOSED * max(1.0, float(np.abs(qd).max())):
            return qd
    raise _failure(robot, rows @ qd, 'm/s or rad/s')


def _choices(robot: RobotModel, fixed: Sequence[str]) -> list[Int]:
    """Return which coordinates may move: the joints, and if these cannot do it, all."""
    unknown = [name for name in fixed if name not in robot.coordinate_names]
    if unknown:
        raise StateError(f'fixed must be some of {robot.coordinate_names}, got {unknown}')
    kept = [robot.coordinate_names.index(name) for name in fixed]
    joints = np.setdiff1d(robot.joint_indices, kept)
    everything = np.setdiff1d(np.arange(robot.n), kept)
    return [joints, everything] if len(everything) > len(joints) else [joints]


def _closed(robot: RobotModel, guess: Array, free: Int) -> Array:
    """Return the coordinates of least closure error that a search from the guess finds."""
    q: Array = guess.copy()
    zero = np.zeros(robot.n)

    def errors(x: Array) -> Array:
        q[free] = x
        return np.asarray(closure_rows(robot, q, zero)[0])

    def slopes(x: Array) -> Array:
        q[free] = x
        return np.asarray(jacobian(robot, q)[0][:, free])

    if not len(free) or not len(robot.constraint_names):
        return q
    found = least_squares(errors, guess[free], slopes, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    q[free] = found.x
    close_nearby(robot, q, free, least_change, 0.0, POLISH)
    return q


def _failure(robot: RobotModel, error: Array, unit: str) -> SolverError:
    worst = int(np.argmax(np.abs(error)))
    size = abs(error[worst])
    hint = '; are origins and axes given with enough digits?' if size < PRINTED else ''
    return SolverError(
        f'{robot.tree.name}: loop {robot.constraint_names[worst]!r} must close to {CLOSED:g} '
        f'{unit}, got {size:.3g} at best{hint}'
    )


TRIALS = 3  # other configurations that are looked at
SPREAD = 0.3  # rad or m, how far from the first


@dataclass(frozen=True)
class ConstraintMobility:
    """One loop or mimic joint."""

    name: str
    error: float  # of closure with all coordinates zero [m or rad]
    rows: int
    rank: int

    @property
    def redundant(self) -> int:
        """Number of redundant rows."""
        return self.rows - self.rank


@dataclass(frozen=True)
class Mobility:
    """A mechanism in its closed configuration nearest to zero."""

    q: Array  # (n,) the configuration
    failure: str  # why it is not closed, '' if it is
    constraints: tuple[ConstraintMobility, ...]
    rows: int
    rank: int  # of all rows together
    usual_rank: int  # in other configurations: more means that this one is singular
    degrees_of_freedom: int  # of the joints, links taken as rigid, where the rank is the usual one


def rank_of(rows: Array) -> int:
    """Return the rank of constraint rows."""
    values = np.linalg.svd(rows, compute_uv=False)
    return int(np.sum(values > RANK * values.max(initial=1e-300)))


def mobility(robot: RobotModel) -> Mobility:
    """Return the degrees of freedom of a robot under loops and mimic joints."""
    zero = np.zeros(robot.n)
    names = np.array(robot.constraint_names)
    errors = np.abs(closure_rows(robot, zero, zero)[0])
    q, failure = zero, ''
    try:
        q = assemble(robot, zero, ())
    except SolverError as error:
        failure = str(error)
    rows, _ = jacobian(robot, q)
    constraints = []
    for name in dict.fromkeys(robot.constraint_names):
        mine = names == name
        own = rows[mine]
        constraints.append(
            ConstraintMobility(name, float(errors[mine].max()), len(own), rank_of(own))
        )
    usual = rows if failure else _usual_rows(robot, q, rows)
    joints = robot.joint_indices
    return Mobility(
        q,
        failure,
        tuple(constraints),
        len(rows),
        rank_of(rows),
        rank_of(usual),
        len(joints) - rank_of(usual[:, joints]),
    )


def _usual_rows(robot: RobotModel, q: Array, rows: Array) -> Array:
    """Return the Jacobian of greatest rank among that at q and some configurations near it."""
    rng = np.random.default_rng(0)
    for _ in range(TRIALS):
        guess = q.copy()
        guess[robot.joint_indices] += rng.uniform(-SPREAD, SPREAD, len(robot.joint_indices))
        try:
            other, _ = jacobian(robot, assemble(robot, guess, ()))
        except SolverError:
            continue
        if rank_of(other) > rank_of(rows):
            rows = other
    return rows
