"""Motions along a path in minimum time: plans with their derivatives by the timing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sparse
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import make_interp_spline

from denoc_ros.dynamics.driven.motion_grid import differences
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.errors import SolverError, StateError
from denoc_ros.planning.timing.limit_rows import TIPS, LimitRows, Moments
from denoc_ros.planning.timing.minimum_time import (
    EXCESS,
    NEAR,
    ROUNDS,
    STEADY,
    WITHIN,
    Found,
    Objective,
    PathDuration,
    checked_plan,
    excess,
    quiet,
    shortest,
    shortest_plan,
)
from denoc_ros.planning.timing.path_timing import Timing, TimingBasis
from denoc_ros.planning.timing.stretching import UNSOLVED
from denoc_ros.planning.tip.asked_motion import AskedMotion, RetimedMotion
from denoc_ros.planning.tip.tip_grid import (
    FEWEST,
    GRID_ERROR,
    HALVINGS,
    TipGrid,
    TipGrids,
    size_of,
)
from denoc_ros.planning.tip.tip_options import PIECES, TipOptions
from denoc_ros.planning.tip.tip_solver import CancelledError, sensitivity
from denoc_ros.types import Array

COARSER = 2.0  # times the usual step, while a timing is looked for
ROUGHEST, ROUGH = 4.0, 0.03  # the same at first, until a round saves less of the duration
ROUGHLY = 0.3  # share of the work that it takes
SHARPEST = 4.0  # times their median: coefficients of a timing, so that it begins smoothly
BEGINNINGS = 5  # motions, each slower, until one keeps the limits
FINER = 4e-3  # share of the duration that more pieces of a timing must save at first order
LOOSER = 1.5  # times the tip's error with fewer pieces, where it is not as small as it may be
CELLS = 220  # of a rigid robot's path
TURNS = 0.5  # weight of its turns beside its length, where cells are placed
MOMENTS = 4  # of each cell: its ends, and between
KNOTS = 800  # of its spline
FINE = 4000  # moments at which the length of its way is summed up
LITTLE = 1e-4  # share of a step
STANDS = 1e-9  # rad, m: a motion that is none
NEWTON = 3  # steps to the moments of its knots
LITTLE_TURN = 1e-3  # rad: of a path that is straight
EDGE = 0.05  # of the first and last cell: where they are looked at beside rest
# limits that bound the pace, and those that need rows in even steps of time
PACED = {'velocity', 'acceleration', 'jerk', 'effort', 'effort_rate', 'strain', 'moment', *TIPS}
IN_TIME = {'jerk', 'effort_rate', 'tip_speed', 'tip_acceleration'}
EXACT = 1e-7  # of the tip's distance: errors that are as small as may be
STRAYED = 3.0  # times those of a motion found from the asked one: steps went astray
# times the window that the zeros need: a sharp start shows where a motion before it is cut off
AROUND = 1.5
ROOM = 1.3  # times the window in which a motion moves, which changes with the motion
NEARLY = 0.9  # of it, that is enough
QUIET = 1e-6  # of a motion's largest acceleration: what is left of it where its window ends
ROWS = 4  # from a node to the next of a plan: its torques have peaks between nodes


@dataclass(frozen=True)
class TimedMotion:
    """A motion whose duration is to be the least."""

    timing: Timing

    @property
    def duration(self) -> float:
        """Of the motion [s]."""
        return self.timing.duration

    @property
    def cost(self) -> float:
        """That is to be the least: the duration [s]."""
        return self.timing.duration

    @property
    def coefficients(self) -> Array:
        """Of the timing."""
        return self.timing.coefficients


@dataclass(frozen=True)
class TimedTip(TimedMotion):
    """A tip-exact motion with a timing."""

    asked: RetimedMotion
    grid: TipGrid
    at: Moments
    shares: Array


class PathSearch:
    """A search for the timing of a path (see :class:`MinimumTimeProblem`)."""

    price, steady = EXCESS, STEADY
    length: float  # that a plan has passed at its end

    def slower(self, coefficients: Array, factor: float) -> Array:
        """Return coefficients of a slower timing."""
        return coefficients / factor

    def places(self, plan: Plan) -> Array:
        """Return the places along the path (k,), 0 to 1, of a plan's rows."""
        assert plan.passed is not None
        return plan.passed / self.length


class TipMinimumTime(PathSearch):
    """The search for the timing of a tip-exact motion (see :class:`MinimumTimeProblem`)."""

    def __init__(
        self, grids: TipGrids, asked: AskedMotion, basis: TimingBasis, rows: LimitRows
    ) -> None:
        self._grids, self._asked, self._basis, self._rows = grids, asked, basis, rows
        self.names, self.length = rows.names, float(basis.stations[-1])
        self._longest, self._error = (0.0, 0.0), 0.0
        self._coarser = ROUGHEST
        self._known: TimedTip | None = None  # that a search may begin with
        self._near: TimedTip | None = None  # that has the changes
        self._changes: tuple[Array, Array] = (np.zeros(0), np.zeros(0))

    def shares_at(self, found: TimedTip, here: TimedTip) -> Array:
        """Return the shares (k, r) of a motion at the places of another motion's rows."""
        nodes, grid = here.grid.nodes, found.grid
        inside = np.clip(nodes, 0.0, here.duration)
        times = found.timing.times_at(here.timing.stations_at(inside))
        times += (nodes - inside) * grid.step / here.grid.step
        spline = make_interp_spline(grid.nodes, found.shares, k=3)
        return np.asarray(spline(np.clip(times, grid.nodes[0], grid.nodes[-1])))

    def program(self, solution: TimedTip) -> Objective:
        """Return the duration's parts."""
        return PathDuration(np.diff(self._basis.stations), self._basis.design, SHARPEST)

    def solve(self, coefficients: Array, near: tuple[TimedTip, Array] | None) -> TimedTip:
        """Return the motion with coefficients (p,)."""
        if self._known is not None and coefficients is self._known.coefficients:
            return self._timed(self._known.timing, self._known.asked, self._known.grid)
        timing = Timing(self._basis, coefficients)
        require_in_time(timing, self._asked, self._grids.options)
        asked = RetimedMotion(self._asked, timing)
        if near is None:
            grid = self._grids.solve(asked, self._coarser)
            require_rest(self.names, self._rows.values(at_rest(grid), 1.0))
            self._longest = -float(grid.nodes[0]), float(grid.nodes[-1]) - timing.duration
            self._error = grid.tip_error
        else:
            grid = self._from(near, timing, asked)
            if grid.tip_error > STRAYED * max(self._error, EXACT):
                # steps from a motion with a swing that ends in the tip may keep it
                anew = self._grids.near(asked, grid.nodes, None, grid.ends)
                self._error = anew.tip_error
                grid = min(grid, anew, key=lambda each: each.tip_error)
        return self._timed(timing, asked, grid)

    def _timed(self, timing: Timing, asked: RetimedMotion, grid: TipGrid) -> TimedTip:
        """Return a motion with the shares of the limits as they are now."""
        q = grid.solved.q
        qd, qdd = differences(q, grid.step)
        torque = grid.problem.torque(q, qd, qdd, grid.solved.multipliers)
        at = Moments(q, qd, qdd, torque)
        shares = self._rows.values(at, grid.step)
        return TimedTip(timing, asked, grid, at, shares * self._narrowed(timing, grid.nodes))

    def begin(self, coefficients: Array) -> Array:
        """Return coefficients (p,) that keep the limits, by one factor slower than those given."""
        near: tuple[TimedTip, Array] | None = None
        for _ in range(BEGINNINGS):
            found: TimedTip | None = None
            factor = UNSOLVED**2
            try:
                found = self.solve(coefficients, near)
            except CancelledError:
                raise
            except SolverError:
                found = None
            else:
                self._known, factor = found, 1.0 + excess(found)
            slower = self.slower(coefficients, factor)
            longest = self._grids.options.stretch * self._asked.duration
            if factor <= 1.0 + NEAR or Timing(self._basis, slower).duration > longest:
                break
            near = None if found is None else (found, slower - coefficients)
            coefficients = slower
        return coefficients

    def rough(
        self, first: Array, report: Callable[[float], object], stopped: Callable[[], bool]
    ) -> Array:
        """Return coefficients (p,) to search from: of the shortest motion on a coarser grid."""
        try:
            found = shortest(self, self.begin(first), report, stopped, steady=ROUGH)
        except CancelledError:
            raise
        except SolverError:
            self._coarser, self._known = COARSER, None
            return self.begin(first)
        self._coarser = COARSER
        return self._refined(found.solution, 1).coefficients

    def search(
        self,
        _problem: object,
        start: Array,
        report: Callable[[float], object],
        stopped: Callable[[], bool],
        rounds: int = ROUNDS,
    ) -> Found[TimedTip]:
        """Return the shortest motion (:func:`shortest`) on a grid as fine as its equations need.

        Where it is beyond the limits there, the search goes on.
        """
        found = shortest(self, start, report, stopped, rounds)
        fine = self._refined(found.solution)
        if excess(fine) > NEAR:
            with suppress(SolverError):
                return shortest(self, fine.coefficients, report, stopped, rounds)
        return replace(found, solution=fine)

    def finer(self, basis: TimingBasis, found: TimedTip) -> tuple[TipMinimumTime, Array]:
        """Return the search among finer timings, and where it begins: with a motion found here."""
        finer = TipMinimumTime(self._grids, self._asked, basis, self._rows)
        finer._longest, finer._error, finer._coarser = self._longest, self._error, self._coarser
        before = found.timing
        square = np.interp(basis.stations, before.basis.stations, before.pace**2)
        finer._known = finer.solve(basis.nearest(square), (found, found.coefficients))
        return finer, finer._known.coefficients

    def _refined(self, found: TimedTip, halvings: int = HALVINGS) -> TimedTip:
        """Return a motion on a grid as fine as its equations need."""
        grid = self._grids.refined(found.grid, found.asked, halvings)
        self._known = found if grid is found.grid else self._timed(found.timing, found.asked, grid)
        return self._known

    def _narrowed(self, timing: Timing, times: Array) -> Array:
        return self._rows.narrowed(timing.stations_at(times) / self._basis.stations[-1])

    def _from(self, near: tuple[TimedTip, Array], timing: Timing, asked: RetimedMotion) -> TipGrid:
        """Return the motion on a grid, found from a motion with another timing."""
        old, change = near
        before, step_old = old.grid.nodes, old.grid.step
        first = round(-before[0] / step_old)
        inside = round(old.duration / step_old)
        last = len(before) - 1 - first - inside
        step = timing.duration / inside
        more = [
            self._more(count, needed, longest, step)
            for count, needed, longest in zip(
                (first, last), moves(old), self._longest, strict=True
            )
        ]
        nodes = step * np.arange(-first - more[0], inside + last + more[1] + 1, dtype=np.float64)
        guess, forces = old.grid.solved.q, old.grid.solved.multipliers
        ends = guess[[0, -1]]
        if self._near is old:
            guess, forces = (
                part + by @ change for part, by in zip((guess, forces), self._changes, strict=True)
            )
        at = np.clip(np.arange(len(nodes)) - more[0], 0, len(before) - 1)
        guess, forces = guess[at], forces[at]
        guess[[0, -1]] = ends
        return self._grids.near(asked, nodes, (guess, forces), old.grid.ends)

    @staticmethod
    def _more(count: int, needed: float, longest: float, step: float) -> int:
        """Return how many nodes more, or fewer, than `count` a window must have."""
        wanted = min(ROOM * needed, longest)
        fits = NEARLY * wanted <= count * step <= ROOM * wanted
        return 0 if fits else int(np.ceil(wanted / step)) - count

    def jacobian(self, solution: TimedTip) -> Array:
        """Return the derivatives (k r, p) of the shares at the same places of the path."""
        grid, timing = solution.grid, solution.timing
        nodes, step, duration = grid.nodes, grid.step, timing.duration
        longer = timing.by_coefficients[-1] / duration
        inside = np.clip(nodes, 0.0, duration)
        # a node comes later, and so does the moment at which its place was passed
        later = timing.change_of_times(nodes) - inside[:, None] * longer
        moved = -timing.pace_at(nodes)[:, None] * later
        twists = [
            np.concatenate([twist[:, :3], target.turn * twist[:, 3:]], axis=1) * target.weight
            for target in grid.problem.targets
            for twist in (solution.asked.twists(target.frame, nodes),)
        ]
        path = np.concatenate(twists, axis=1), solution.asked.coordinate_rates(nodes)
        found = sensitivity(grid.problem, grid.solved, step, path, (moved, longer))
        if found is None:
            raise SolverError('shape_motion: the plan must have derivatives, got none')
        dq, dm = self._changes = found
        self._near = solution
        at = solution.at
        dqd, dqdd = (part.reshape(dq.shape) for part in differences(dq.reshape(len(dq), -1), step))
        dqd -= at.qd[:, :, None] * longer
        dqdd -= 2.0 * at.qdd[:, :, None] * longer
        dtau = grid.problem.torque_change(*at[:3], grid.solved.multipliers, (dq, dqd, dqdd, dm))
        changes = self._rows.changes(at, step, Moments(dq, dqd, dqdd, dtau))
        ahead, behind = (self._rows.values(at, step * (1.0 + s * LITTLE)) for s in (1.0, -1.0))
        changes += ((ahead - behind) / (2.0 * LITTLE))[:, :, None] * longer
        changes *= self._narrowed(timing, nodes)[:, :, None]
        slope = np.gradient(solution.shares, step, axis=0)
        changes += slope[:, :, None] * later[:, None, :]
        return np.asarray(changes.reshape(-1, changes.shape[2]))

    def start(self, plan: Plan) -> Array:
        """Return the coefficients nearest to the timing of a plan."""
        assert plan.passed is not None
        inside = (plan.t >= plan.t[0] + plan.preaction) & (plan.t <= plan.t[-1] - plan.postaction)
        passed, t = plan.passed[inside], plan.t[inside]
        share = self._basis.stations[-1] / max(float(passed[-1]), 1e-300)
        pace = np.gradient(passed * share, t)
        return self._basis.nearest(np.interp(self._basis.stations, passed * share, pace**2))

    def plan(self, found: TimedTip) -> Plan:
        """Return the plan of a motion, on a grid as fine as its equations need."""
        found = self._refined(found)
        plan = self._grids.plan(found.grid, found.asked, ROWS)
        passed = found.timing.stations_at(plan.t)
        return replace(plan, stretch=found.duration / self._basis.stations[-1], passed=passed)


def moves(motion: TimedTip) -> tuple[float, float]:
    """Return how long a motion moves before and after the tip does [s]."""
    size = np.abs(motion.at.qdd).max(axis=1)
    moving = motion.grid.nodes[size > QUIET * size.max()]
    return max(-float(moving[0]), 0.0), max(float(moving[-1]) - motion.duration, 0.0)


def at_rest(grid: TipGrid) -> Moments:
    """Return the first and last posture of a motion, where it rests."""
    q, forces = grid.solved.q[[0, -1]], grid.solved.multipliers[[0, -1]]
    still = np.zeros_like(q)
    return Moments(q, still, still, grid.problem.torque(q, still, still, forces))


def require_rest(names: Sequence[str], shares: Array) -> None:
    """Refuse limits that are passed where the robot rests: no timing helps."""
    most = np.abs(shares).max(axis=0)
    if len(most) and float(most.max()) > 1.0 + WITHIN:
        what, _, whose = names[int(most.argmax())].partition(' ')
        raise SolverError(
            f'shape_motion: {whose} must keep its limit of {what} at rest, got '
            f'{float(most.max()):.4g} times that at the start or end of the motion, however slow'
        )


def require_in_time(timing: Timing, asked: AskedMotion, options: TipOptions) -> None:
    """Refuse timings that are slower than a motion may be made."""
    stretch, longest = options.stretch, options.stretch * asked.duration
    if timing.duration > longest * (1.0 + WITHIN):
        raise SolverError(
            f'a slower motion takes more than the {longest:.4g} s that stretch {stretch:g} allows'
        )


@dataclass(frozen=True)
class TimedPath(TimedMotion):
    """A rigid robot's motion with a timing; each cell of the path has `MOMENTS`."""

    shares: Array
    at: Moments


class RigidMinimumTime(PathSearch):
    """The timing of a rigid robot's path (see :class:`MinimumTimeProblem`).

    The path's parameter is the length of the joints' way; the squared pace x is linear from
    station to station, so that accelerations are constant between them. Stations are closer
    where the path turns: they share its length and its turns evenly.
    """

    def __init__(self, grids: TipGrids, asked: AskedMotion, rows: LimitRows) -> None:
        self._grids, self._asked, self._rows = grids, asked, rows
        self.names, self.length = rows.names, asked.duration
        even = np.linspace(0.0, asked.duration, FINE + 1)
        speed = make_interp_spline(even, np.linalg.norm(asked.joint_spline(even, 1), axis=1), k=3)
        way = speed.antiderivative()
        length = float(way(asked.duration))
        self._asked_at = np.linspace(0.0, length, KNOTS + 1)
        self._moment = np.interp(self._asked_at, way(even), even)
        for _ in range(NEWTON):
            slope = np.maximum(speed(self._moment[1:-1]), 1e-9 * length / asked.duration)
            self._moment[1:-1] -= (way(self._moment) - self._asked_at)[1:-1] / slope
        self._path = make_interp_spline(self._asked_at, asked.coordinates(self._moment), k=3)
        q = asked.coordinates(np.array([0.0, asked.duration]))
        rest = Moments(q, 0.0 * q, 0.0 * q, self._torque(q, 0.0 * q, 0.0 * q))
        require_rest(self.names, rows.values(rest, 1.0))
        self._basis = TimingBasis.linear(self._stations())
        self._apart = np.diff(self._basis.stations)
        share: Array = np.tile(np.linspace(0.0, 1.0, MOMENTS), (CELLS, 1))
        share[0, 0], share[-1, -1] = EDGE, 1.0 - EDGE  # at rest there is no friction
        self._cell = np.repeat(np.arange(CELLS), MOMENTS)
        self._share = share.ravel()
        self._at = self._basis.stations[self._cell] + self._share * self._apart[self._cell]
        self._rows_of_path = tuple(np.asarray(self._path(self._at, k)) for k in range(3))
        self.first = np.ones(self._basis.design.shape[1]) * (length / asked.duration) ** 2

    def _stations(self) -> Array:
        """Return stations (CELLS + 1,) that share the path's length and its turns evenly."""
        bends = np.linalg.norm(self._path(self._asked_at, 2), axis=1)
        turns = cumulative_trapezoid(bends, self._asked_at, initial=0.0)
        share = TURNS * turns / max(float(turns[-1]), LITTLE_TURN)
        share += self._asked_at / self._asked_at[-1]
        even = np.linspace(0.0, float(share[-1]), CELLS + 1)
        return np.asarray(np.interp(even, share, self._asked_at))

    def shares_at(self, found: TimedPath, here: TimedPath) -> Array:
        """Return the shares (k, r) of a motion: its rows are at the same places."""
        return found.shares

    def program(self, solution: TimedPath) -> Objective:
        """Return the duration's parts."""
        return PathDuration(self._apart, self._basis.design)

    def solve(self, coefficients: Array, near: tuple[TimedPath, Array] | None) -> TimedPath:
        """Return the motion with coefficients (p,)."""
        timing = Timing(self._basis, coefficients)
        require_in_time(timing, self._asked, self._grids.options)
        at = self._moments(timing)
        return TimedPath(timing, self._rows.values(at, 1.0) * self._narrowed(), at)

    def _narrowed(self) -> Array:
        place = np.interp(self._at, self._asked_at, self._moment)
        return self._rows.narrowed(place / self._asked.duration)

    def _moments(self, timing: Timing) -> Moments:
        """Return the motion in all cells."""
        q, slope, bend = self._rows_of_path
        x, a = self._squares(timing)
        at = q, slope * np.sqrt(x)[:, None], slope * a[:, None] + bend * x[:, None]
        return Moments(*at, self._torque(*at))

    def _torque(self, q: Array, qd: Array, qdd: Array) -> Array:
        return np.asarray(self._grids.robot.inverse_dynamics(q, qd, qdd)[:, self._grids.driven])

    def _squares(self, timing: Timing) -> tuple[Array, Array]:
        """Return the squared pace and the acceleration along the path in all cells."""
        square = timing.pace**2
        before, after = square[self._cell], square[self._cell + 1]
        x = (1.0 - self._share) * before + self._share * after
        return x, 0.5 * (after - before) / self._apart[self._cell]

    def jacobian(self, solution: TimedPath) -> sparse.csr_array:
        """Return the derivatives of the shares: each is of the stations beside it alone."""
        _, slope, bend = self._rows_of_path
        x, _ = self._squares(solution.timing)
        dx = np.stack([1.0 - self._share, self._share], axis=1)[:, None]
        half = 0.5 / self._apart[self._cell]
        da = np.stack([-half, half], axis=1)[:, None]
        dq = np.zeros((*slope.shape, 2))
        dqd = 0.5 * (slope / np.sqrt(x)[:, None])[:, :, None] * dx
        dqdd = slope[:, :, None] * da + bend[:, :, None] * dx
        robot, driven = self._grids.robot, self._grids.driven
        _, by_qd, by_qdd = robot.inverse_dynamics_derivatives(*solution.at[:3])
        dtau = by_qd[:, driven] @ dqd + by_qdd[:, driven] @ dqdd
        local = self._rows.changes(solution.at, 1.0, Moments(dq, dqd, dqdd, dtau))
        local *= self._narrowed()[:, :, None]
        k, r, _ = local.shape
        columns = np.repeat(np.stack([self._cell - 1, self._cell], axis=1)[:, None], r, axis=1)
        rows = np.repeat(np.arange(k * r).reshape(k, r, 1), 2, axis=2)
        count = len(solution.timing.coefficients)
        inside = (columns >= 0) & (columns < count)
        return sparse.csr_array(
            (local[inside], (rows[inside], columns[inside])), shape=(k * r, count)
        )

    def plan(self, found: TimedPath) -> Plan:
        """Return the plan of a motion, in even steps of time."""
        timing = found.timing
        output = self._grids.options.output_step
        count = max(FEWEST, int(np.ceil(timing.duration / output - 1e-9)))
        t = np.linspace(0.0, timing.duration, count + 1)
        cell = np.clip(np.searchsorted(timing.t, t, side='right') - 1, 0, CELLS - 1)
        square = timing.pace**2
        a = 0.5 * (square[cell + 1] - square[cell]) / self._apart[cell]
        since, pace = t - timing.t[cell], timing.pace[cell]
        s = self._basis.stations[cell] + since * (pace + 0.5 * a * since)
        s = np.clip(s, 0.0, self._basis.stations[-1])
        pace = np.maximum(pace + a * since, 0.0)
        q, slope, bend = (np.asarray(self._path(s, order)) for order in range(3))
        qd, qdd = slope * pace[:, None], slope * a[:, None] + bend * (pace**2)[:, None]
        plan = self._grids.plan_of(t, (q, qd, qdd), self._torque(q, qd, qdd))
        passed = np.interp(s, self._asked_at, self._moment)
        return replace(plan, stretch=timing.duration / self._asked.duration, passed=passed)


def fastest(grids: TipGrids, asked: AskedMotion, rows: LimitRows) -> Plan:
    """Return the plan that passes the path of a motion in the least time within limits.

    Parameters
    ----------
    grids : TipGrids
    asked : AskedMotion
        Its path stays, its timing is where the search begins.
    rows : LimitRows

    Raises
    ------
    StateError
        No limit bounds the pace.
    SolverError
        No timing keeps the limits; with the one that is passed most.
    """
    options, robot = grids.options, grids.robot
    if not any(name.split()[0] in PACED for name in rows.names):
        raise StateError(
            f'{robot.tree.name}: minimum time needs a limit of velocity, acceleration, effort, '
            'strain or such, got none'
        )
    silent = replace(options, progress=None, cancel=None)
    own = TipGrids(robot, grids.frames, grids.driven, silent, AROUND)
    some: Array = asked.coordinates(np.linspace(0.0, asked.duration, FEWEST + 1))
    if not float(np.ptp(some, axis=0).max()) > STANDS:
        raise StateError('shape_motion: q_joints must move for minimum time, got one posture')
    kinds = {name.split()[0] for name in rows.names}
    if robot.n == len(grids.driven) and not kinds & IN_TIME:
        rigid = RigidMinimumTime(own, asked, rows)
        return shortest_plan(rigid, rigid.first, rows, options.progress, options.cancel)
    speed = asked.joint_spline

    def fast(times: Array) -> Array:
        return np.asarray(np.linalg.norm(speed(times, 1), axis=1))

    counts = [min(PIECES, options.pieces)]
    while counts[-1] < options.pieces:
        counts.append(min(2 * counts[-1], options.pieces))
    bases = [TimingBasis.spline(asked.duration, fast, count) for count in counts]
    progress, stopped = options.progress or quiet, options.cancel or (lambda: False)

    def report(share: float) -> None:
        progress((done + share) / len(bases))

    done = 0
    bent = TipMinimumTime(own, asked, bases[0], rows)
    first = bases[0].asked
    if options.near is not None and options.near.passed is not None:
        first = bent.start(options.near)
    start = bent.rough(first, lambda share: report(ROUGHLY * share), stopped)
    further = 1.0 - ROUGHLY
    found = bent.search(bent, start, lambda share: report(ROUGHLY + further * share), stopped)
    plan = checked_plan(bent, found, rows, stopped, bent.search)
    for basis in bases[1:]:
        better, done = None, done + 1
        if not stopped():
            better = _with_more_pieces(bent, basis, found, plan, rows, report, stopped)
        if better is None:
            break
        bent, found, plan = better
    return plan


def _with_more_pieces(
    coarse: TipMinimumTime,
    basis: TimingBasis,
    found: Found[TimedTip],
    plan: Plan,
    rows: LimitRows,
    report: Callable[[float], object],
    stopped: Callable[[], bool],
) -> tuple[TipMinimumTime, Found[TimedTip], Plan] | None:
    """Return a search among finer timings, its motion and its plan; None: they are no better."""
    rows.widen()
    with suppress(SolverError):
        finer, start = coarse.finer(basis, found.solution)
        found = shortest(finer, start, report, stopped, steady=FINER)
        if found.coefficients is start:
            return None
        shorter = checked_plan(finer, found, rows, stopped, finer.search)
        small = GRID_ERROR * size_of(found.solution.grid.problem)
        allowed = max(LOOSER * float(plan.tip_error.max()), small)
        if shorter.stretch < plan.stretch and float(shorter.tip_error.max()) <= allowed:
            return finer, found, shorter
    return None
