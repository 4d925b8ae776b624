"""Joint motions between two postures that end with every mode at rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg
import scipy.sparse as sparse
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline

from denoc_ros.control.driven_joints import DrivenJoints
from denoc_ros.control.end_swing import Driven, EndSwing, moments_change
from denoc_ros.control.joint_limits import JointLimits, joint_limits
from denoc_ros.control.limit_rows import LimitRows, Moments, PlanLimits
from denoc_ros.control.minimum_time import (
    NEAR,
    STEADY,
    Found,
    Part,
    checked_plan,
    excess,
    shortest,
)
from denoc_ros.control.plan import Plan
from denoc_ros.control.ringing import fastest_mode, ringing_modes
from denoc_ros.control.tip_minimum_time import PACED, require_rest
from denoc_ros.control.tip_solver import CancelledError
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.types import Array

SEGMENTS = (16, 60)  # of the splines, at least and at most
SEGMENTS_PER_PERIOD = 3.0  # of the fastest mode that is to rest
LEAST_FINE = 40  # coefficients of a joint there, at least
UNKNOWNS = 160  # of all splines in minimum time, at least; a joint has 120 at most
FINEST = 120
RESOLVED = 0.8  # segments in a period of the fastest mode, where accelerations may jump
PER_SEGMENT = {3: 2, 5: 6}  # moments at which limits are looked at, by the splines' degree
WITH_JUMPS = 4
BESIDE = 1e-9  # of the duration: how near to a jump its sides are
STEPS = 200  # of the simulated motion, at least
# of the fastest mode that rests, and of the fastest of all: while unknowns are few, and after
STEPS_PER_PERIOD = (20.0, 60.0), (10.0, 40.0)
QUIET = 1e-3  # share of the plain motion's swing that counts as rest
EXACT = 1e-4  # share to which the search brings it
STANDS = 1e-9  # rad, m: a way that is none
NEWTON = 10  # steps to rest
SLOWLY = 0.3  # share of a swing that a step with the derivatives of the motion before leaves
ROUNDS, SMOOTHER, FEW = 60, 30, 6  # of the shortest motion, and of one in a given time
# durations that the plain motion's mean square of jerk costs in minimum time, without and with
# jumps
SMOOTH = 1e-7, 1e-9
LATE = 1e4  # jerks of the plain motion that a share of the wanted duration costs
ROBUSTNESS = 2e4  # that all the swing with other frequencies costs
QUICK = 3.0, STEADY  # price of a share beyond a limit and steadiness of a search for time
TRIED = 20.0, 1e-3  # these where durations are tried one by one
TRIES, TRY, POLISH = 10, 6, 4  # durations, rounds of each, and of the search for time after them
PACE, TIGHT = 0.02, 1e-3  # share by which durations are shorter, and at which they are the same
RATE = 0.5  # share of a duration that is saved by a share of the limits
FASTER = 1.0, 0.9, 0.8, 0.7  # plain motions of which the largest swing is that scale
FIRM = 200.0, 1e-4  # price and steadiness of a search whose cost is the jerk
GUESSES = 12  # of a duration in which the plain motion keeps its limits
PARTS = 16  # of a segment, over which jerks are means
ON_TIME = 1e-5  # share of the wanted duration
STEP_OF_TIME, STEP_OF_JOINTS, STEP_OF_PASSING = 0.3, 0.3, 0.1  # scales of a trust region


class RestBasis:
    """B-splines over [0, 1] whose first derivatives are 0 at both ends.

    Parameters
    ----------
    segments : int
        Equal pieces.
    degree, ends : int
        Of the splines, and how many coefficients are fixed at each end: of degree 5 with 4
        position, velocity, acceleration and jerk; of degree 3 with 3 all but the jerk.
    jumps : bool
        Whether accelerations may jump between segments, and at both ends: of degree 3 with 2.

    Attributes
    ----------
    free : int
        Coefficients of each joint that are free.
    """

    def __init__(self, segments: int, degree: int = 5, ends: int = 4, jumps: bool = False) -> None:
        self.segments, self.jumps = segments, jumps
        self.degree, self._ends = degree, ends
        inner = np.repeat(np.linspace(0.0, 1.0, segments + 1)[1:-1], 2 if jumps else 1)
        self._knots = np.concatenate((np.zeros(degree + 1), inner, np.ones(degree + 1)))
        self._count = len(inner) + degree + 1
        self.free = self._count - 2 * ends

    def moments(self) -> tuple[int, Array]:
        """Return nodes for each segment, and the shares at which limits are looked at.

        On both sides of jumps.
        """
        nodes = WITH_JUMPS if self.jumps else PER_SEGMENT[self.degree]
        shares = np.linspace(0.0, 1.0, nodes * self.segments + 1)
        if self.jumps:
            sides = np.repeat(shares, 2)[1:-1].reshape(-1, 2)
            sides[0::nodes, 0] += BESIDE
            sides[nodes - 1 :: nodes, 1] -= BESIDE
            shares = np.unique(sides)
        return nodes, shares

    def design(self, shares: ArrayLike, derivative: int = 0) -> Array:
        """Basis functions of the free coefficients at shares (k,) of the duration: (k, free)."""
        return self._columns(shares, derivative)[:, self._ends : -self._ends]

    def fixed(self, start: Array, end: Array, shares: ArrayLike, derivative: int = 0) -> Array:
        """Motion by the fixed coefficients at shares (k,): (k, joints)."""
        columns = self._columns(shares, derivative)
        first = columns[:, : self._ends].sum(axis=1)
        last = columns[:, -self._ends :].sum(axis=1)
        return np.asarray(np.outer(first, start) + np.outer(last, end))

    def _columns(self, shares: ArrayLike, derivative: int) -> Array:
        moments = np.asarray(shares, dtype=np.float64)
        inside = np.clip(moments, 0.0, 1.0)
        spline = BSpline(self._knots, np.eye(self._count), self.degree)
        columns = np.array(spline(inside, derivative))
        if derivative:
            columns[inside != moments] = 0.0
        return columns


@dataclass(frozen=True)
class Waypoints:
    """Places that a tip must pass on the way.

    Attributes
    ----------
    frame : str
    postures : (w, driven) array
        Of the undeformed robot.
    radius : float
        m: how far the tip may be from where the undeformed robot's is in the posture.
    """

    frame: str
    postures: Array
    radius: float


@dataclass(frozen=True)
class RestMotion:
    """A motion between two postures after which nothing rings.

    Attributes
    ----------
    duration : float
        s.
    t : (k,) array
        s, in equal steps from 0.
    states : Driven
        All coordinates (k, n), their rates, and the joints' accelerations between.
    left : float
        Share of the plain motion's swing that is left.
    """

    duration: float
    t: Array
    states: Driven
    left: float
    basis: RestBasis
    coefficients: Array  # (free, driven)
    start: Array  # (driven,)
    end: Array
    driven: DrivenJoints

    def joints(self, times: ArrayLike, derivative: int = 0) -> Array:
        """Return the joints' motion (k, joints), or a derivative of it, held outside."""
        shares = np.asarray(times) / self.duration
        rows = self.basis.design(shares, derivative) @ self.coefficients
        rows += self.basis.fixed(self.start, self.end, shares, derivative)
        return self.driven.all(rows / self.duration**derivative, derivative)


class _BeyondError(SolverError):
    """No motion of a duration within the limits was found; it has the best coefficients."""

    def __init__(self, text: str, coefficients: Array) -> None:
        super().__init__(text)
        self.coefficients = coefficients


@dataclass(frozen=True)
class TimedRest:
    """A motion with coefficients, at rest at its end (see :class:`RestProblem`)."""

    coefficients: Array
    duration: float
    cost: float
    shares: Array
    at: Moments
    motion: Driven
    errors: tuple[Array, ...]  # that rings at the end, of each robot
    change: list[_Change] = field(default_factory=list)  # once it was asked for


@dataclass(frozen=True)
class _Change:
    """Derivatives of a motion by its coefficients.

    Attributes
    ----------
    errors : arrays (m, p)
        Of each robot's residual vibration.
    states : (k, 2 free, p) array
        Of the free coordinates and their rates at the ends of steps.
    resting : (p, p) array
        Changes of coefficients that stay at rest, by those that were asked for.
    back : (p, m) array
        The smoothest change of coefficients for a residual vibration.
    """

    errors: tuple[Array, ...]
    states: Array
    resting: Array
    back: Array


@dataclass(frozen=True)
class RestCost:
    """Duration, jerk and swing with other frequencies of a motion (see :class:`Objective`)."""

    here: TimedRest
    problem: RestProblem

    def part(self, c: Array, unit: float) -> Part:
        """Return its part of a program; it has no unknowns of its own."""
        scale, least, most = self.problem.region(c)
        hessian, gradient = self.problem.curvature(self.here)
        along = self.problem.change(self.here).resting * scale
        none = sparse.csr_array((0, len(c)))
        return Part(
            scale,
            least,
            most,
            along.T @ gradient / unit,
            along.T @ hessian @ along / unit,
            self.here.cost / unit,
            none,
            np.zeros(0),
            [],
        )


class RestProblem:
    """The search for a motion that ends at rest (see :class:`MinimumTimeProblem`).

    Coefficients are those of the splines, joint by joint, the duration, and at which share of it
    each waypoint is passed. Every solution is at rest at its end: a change of coefficients that
    would disturb that is followed by the smoothest one that restores it, as an implicit function.

    Parameters
    ----------
    robots : list of Robot
        The robot itself, and those with other frequencies that should rest as well.
    driven : DrivenJoints
    postures : pair of (driven,) arrays
    rows : LimitRows
    basis : RestBasis
    wanted : float
        Duration that is not to be undercut [s], 0: the shortest is looked for.
    longest : float
        Steps of the simulated motion are fine enough for durations up to this [s].
    fine : int
        Index of each of `STEPS_PER_PERIOD`.
    """

    def __init__(
        self,
        robots: list[Robot],
        driven: DrivenJoints,
        postures: tuple[Array, Array],
        rows: LimitRows,
        basis: RestBasis,
        wanted: float,
        modes: int | None,
        scale: Array,
        waypoints: Waypoints | None,
        check: Callable[[], None],
    ) -> None:
        self.robot, self.driven, self.postures = robots[0], driven, postures
        self.rows, self.basis, self.wanted = rows, basis, wanted
        self.waypoints, self._check = waypoints, check
        self.to_plan: Callable[[RestMotion], Plan]
        first, last = (driven.all(each) for each in postures)
        self.swings = [EndSwing(each, first, last, modes) for each in robots]
        self.fastest = float(ringing_modes(self.robot, last, modes).frequencies.max())
        self._all = fastest_mode(self.robot, last, self.fastest)
        count = 0 if waypoints is None else len(waypoints.postures)
        self.names = rows.names + tuple(f'waypoint {k + 1}' for k in range(count))
        self.price, self.steady = FIRM if wanted else QUICK
        self._splines = basis.free * len(postures[0])
        self._count = self._splines + 1 + count
        self.at_duration = self._splines
        self._way = self._lengths()
        self._hessian, self._gradient, self._constant = self._jerk(scale)
        eye = np.eye(self._splines)
        even = self._hessian + 1e-13 * float(np.trace(self._hessian)) / self._splines * eye
        self._smooth = scipy.linalg.cho_factor(even)
        self._plain_jerk = max(self.jerk(self.plain(1.0)), 1e-12)
        self._goals = self._places()
        self.fixed = False  # whether the duration is the wanted one all the time
        self.unit = self.size = self.swing = 1.0
        self.refine(1.0, 0)

    def refine(self, duration: float, fine: int) -> None:
        """Take steps for a duration [s]: coarse (0) or fine (1) ones."""
        each, self._look = self.basis.moments()
        nodes = each * self.basis.segments
        rests, every = (each[fine] for each in STEPS_PER_PERIOD)
        # splines excite modes little that are faster than their segments
        excited = min(self._all * duration, self.basis.segments)
        steps = max(STEPS, rests * self.fastest * duration, every * excited)
        self._every = int(np.ceil(steps / nodes))
        self.count = nodes * self._every
        self.shares = np.linspace(0.0, 1.0, self.count + 1)
        self._nodes = np.rint(self._look * self.count).astype(np.int64)
        middle = 0.5 * (self.shares[1:] + self.shares[:-1])
        # of positions, rates and accelerations: at the ends of steps, in their middle, at moments
        self._at_ends, self._between, self._at_moments = (
            [
                (self.basis.design(shares, k), self.basis.fixed(*self.postures, shares, k))
                for k in range(3)
            ]
            for shares in (self.shares, middle, self._look)
        )
        sizes = [
            float(np.linalg.norm(self.run(self.plain(share * duration)).errors[0]))
            for share in FASTER
        ]
        self.size, self.unit = max(sizes[0], 1e-9), duration
        self.swing = max(*sizes, 1e-9)

    def _lengths(self) -> Array:
        """Return how far each joint goes [rad, m], at least a tenth of the farthest."""
        between = () if self.waypoints is None else self.waypoints.postures
        way = np.ptp(np.array([*self.postures, *between]), axis=0)
        return np.asarray(np.maximum(way, max(0.1 * float(way.max()), STANDS)))

    def _jerk(self, scale: Array) -> tuple[Array, Array, float]:
        """Return H, g and c of x.H x / 2 + g.x + c: half the mean square of the jerk, scaled.

        By differences of the accelerations, which may jump.
        """
        count = PARTS * self.basis.segments
        shares = (np.arange(count) + 0.5) / count
        still = np.zeros((1, 1))

        def slopes(rows: Array) -> Array:
            rest = np.repeat(still, rows.shape[1], axis=1)
            steps = np.diff(rows, axis=0, prepend=rest, append=rest)
            return np.asarray(np.sqrt(count) * steps)

        design = np.kron(np.diag(1.0 / scale), slopes(self.basis.design(shares, 2)))
        fixed = slopes(self.basis.fixed(*self.postures, shares, 2)) / scale
        right = fixed.T.ravel()
        return design.T @ design, design.T @ right, 0.5 * float(right @ right)

    def _places(self) -> Array:
        """Return where the undeformed robot's tip is at the waypoints (w, 3)."""
        if self.waypoints is None:
            return np.zeros((0, 3))
        q = np.zeros((len(self.waypoints.postures), self.robot.n))
        q[:, self.robot.joint_indices] = self.driven.all(self.waypoints.postures)
        return np.asarray(self.robot.frame_pose(self.waypoints.frame, q)[:, :3, 3])

    def plain(self, duration: float) -> Array:
        """Return the coefficients of the least jerk through the waypoints."""
        passed = self._passing()
        rows: Array = np.zeros((0, self._splines))
        right: Array = np.zeros(0)
        if self.waypoints is not None:
            off = self.waypoints.postures - self.basis.fixed(*self.postures, passed)
            rows = np.asarray(
                np.kron(np.eye(len(self._way)), self.basis.design(passed)), dtype=np.float64
            )
            right = off.T.ravel()
        free = np.zeros(self._splines)
        for _ in range(3):  # the factored matrix is only near the Hessian
            free -= scipy.linalg.cho_solve(self._smooth, self._hessian @ free + self._gradient)
        if len(right):
            back = scipy.linalg.cho_solve(self._smooth, rows.T)
            free = free + back @ np.linalg.lstsq(rows @ back, right - rows @ free)[0]
        return np.concatenate([free, [duration], passed])

    def _passing(self) -> Array:
        """Return at which shares of the duration waypoints are passed, by the way between."""
        if self.waypoints is None:
            return np.zeros(0)
        points = np.vstack([self.postures[0], self.waypoints.postures, self.postures[1]])
        way = np.cumsum(np.linalg.norm(np.diff(points, axis=0) / self._way, axis=1))
        even = np.linspace(0.0, 1.0, 201)
        passed = even - np.sin(2.0 * np.pi * even) / (2.0 * np.pi)
        share = way[:-1] / max(float(way[-1]), STANDS)
        return np.interp(np.clip(share, 0.05, 0.95), passed, even)

    def jerk(self, x: Array) -> float:
        """Half the mean square of the jerk over the duration's cube, scaled."""
        c = x[: self._splines]
        return self._constant + float(0.5 * c @ self._hessian @ c + self._gradient @ c)

    def _prices(self) -> tuple[float, float, float]:
        """Return the prices of a second, of a jerk, and of a swing's square."""
        if self.wanted:
            quiet = self.wanted * ROBUSTNESS / self.swing**2
            return LATE, self.wanted / self._plain_jerk, quiet
        return 1.0, SMOOTH[self.basis.jumps] * self.unit / self._plain_jerk, 0.0

    def _cost(self, x: Array, errors: tuple[Array, ...]) -> float:
        late, smooth, quiet = self._prices()
        rung = sum(float(error @ error) for error in errors[1:])
        duration = late * (x[self._splines] - self.wanted)
        return float(duration + smooth * self.jerk(x) + quiet * rung)

    def curvature(self, here: TimedRest) -> tuple[Array, Array]:
        """Return the cost's second and first derivatives by the coefficients."""
        late, smooth, quiet = self._prices()
        p, n = self._splines, self._count
        hessian, gradient = np.zeros((n, n)), np.zeros(n)
        hessian[:p, :p] = smooth * self._hessian
        c = here.coefficients[:p]
        gradient[:p] = smooth * (self._hessian @ c + self._gradient)
        gradient[p] = late
        pairs = zip(here.errors[1:], self.change(here).errors[1:], strict=True)
        for error, by in pairs:
            hessian += 2.0 * quiet * by.T @ by
            gradient += 2.0 * quiet * by.T @ error
        return hessian, gradient

    def region(self, x: Array) -> tuple[Array, Array, Array]:
        """Return scales of coefficients, and bounds of their changes over these."""
        duration, passed = x[self._splines], x[self._splines + 1 :]
        scale = np.concatenate([
            np.repeat(STEP_OF_JOINTS * self._way, self.basis.free),
            [STEP_OF_TIME * duration],
            np.full(len(passed), STEP_OF_PASSING),
        ])  # fmt: skip
        least, most = np.full((2, len(x)), np.inf)
        least[self._splines] = min(duration - self.wanted, 0.6 * duration) / scale[self._splines]
        if self.fixed:
            least[self._splines] = most[self._splines] = 0.0
        gaps = np.diff(np.concatenate([[0.0], passed, [1.0]]))
        least[self._splines + 1 :] = 0.4 * gaps[:-1] / STEP_OF_PASSING
        most[self._splines + 1 :] = 0.4 * gaps[1:] / STEP_OF_PASSING
        return scale, -np.maximum(least, 0.0), most

    def program(self, solution: TimedRest) -> RestCost:
        """Return the cost as a function of the coefficients."""
        return RestCost(solution, self)

    def slower(self, coefficients: Array, factor: float) -> Array:
        """Return the same motion in a longer time; durations that are tried have no other."""
        if self.fixed and not self.wanted:
            failure = self.failure(coefficients[self._splines], 'limits are passed')
            raise _BeyondError(str(failure), coefficients)
        slower: Array = np.array(coefficients)
        slower[self._splines] *= np.sqrt(factor)
        return slower

    def kept(self, x: Array) -> Array:
        """Return the coefficients of a motion as fast as limits allow without another shape."""
        for _ in range(GUESSES):
            found = self.solve(x, None)
            x = found.coefficients
            if excess(found) <= NEAR:
                break
            x = self.slower(x, 1.0 + 1.2 * excess(found))
        return x

    def near(self, other: RestProblem, x: Array) -> Array:
        """Return the coefficients of the motion of a problem with other splines."""
        shares = np.linspace(0.0, 1.0, 4 * self.basis.segments + 1)[1:-1]
        rows = other.basis.design(shares) @ other.shaped(x)
        rows += other.basis.fixed(*self.postures, shares)
        wanted = rows - self.basis.fixed(*self.postures, shares)
        found = np.linalg.lstsq(self.basis.design(shares), wanted)[0]
        return np.concatenate([found.T.ravel(), x[other.at_duration :]])

    def shaped(self, x: Array) -> Array:
        """Return the splines' coefficients (free, driven)."""
        return np.asarray(x[: self._splines].reshape(len(self._way), -1).T)

    def run(self, x: Array) -> TimedRest:
        """Return the motion with coefficients, whatever rings at its end."""
        self._check()
        duration, c = float(x[self._splines]), self.shaped(x)

        def joints(places: list[tuple[Array, Array]], order: int) -> Array:
            design, fixed = places[order]
            return self.driven.all((design @ c + fixed) / duration**order, order)

        q, qd = (joints(self._at_ends, order) for order in range(2))
        between = joints(self._between, 2)
        step = duration / self.count
        motions = [swing.run(step, q, qd, between) for swing in self.swings]
        errors = tuple(
            swing.error(motion) for swing, motion in zip(self.swings, motions, strict=True)
        )
        own = motions[0]
        at = self._moments(own.q[self._nodes], own.qd[self._nodes], joints(self._at_moments, 2))
        shares = self.rows.values(at, step * self._every)
        shares = shares * self.rows.narrowed(self._look)
        passed = np.zeros((len(shares), len(self._goals)))
        if len(self._goals):
            passed[0], _ = self._passed(x, own)
        return TimedRest(
            x,
            duration,
            self._cost(x, errors),
            np.hstack([shares, passed]),
            at,
            own,
            errors,
        )

    def _moments(self, q: Array, qd: Array, given: Array) -> Moments:
        robot = self.robot
        q, qd = np.ascontiguousarray(q), np.ascontiguousarray(qd)
        force, free = robot.hybrid_dynamics(q, qd, given)
        qdd = np.zeros_like(q)
        qdd[:, robot.joint_indices], qdd[:, robot.free_indices] = given, free
        return Moments(q, qd, qdd, self.driven.torque(force))

    def _passed(self, x: Array, motion: Driven) -> tuple[Array, Array]:
        """Return how far tips are from the waypoints over the radius (w,), and how by q (w, n)."""
        assert self.waypoints is not None
        q = self._interpolated(motion.q, x[self._splines + 1 :])
        frame = self.waypoints.frame
        off = self.robot.frame_pose(frame, q)[:, :3, 3] - self._goals
        size = np.linalg.norm(off, axis=1)
        along = off / np.maximum(size, 1e-12)[:, None]
        gain = np.einsum('wc,wcn->wn', along, self.robot.frame_jacobian(frame, q)[:, :3])
        return size / self.waypoints.radius, gain / self.waypoints.radius

    def _interpolated(self, rows: Array, shares: Array) -> Array:
        """Return rows (k, ...) at shares (w,) of the duration, linear between steps."""
        at = np.clip(shares, 0.0, 1.0) * self.count
        low = np.minimum(at.astype(np.int64), self.count - 1)
        part = (at - low).reshape(-1, *np.ones(rows.ndim - 1, dtype=np.int64))
        return np.ascontiguousarray((1.0 - part) * rows[low] + part * rows[low + 1])

    def solve(self, coefficients: Array, near: tuple[TimedRest, Array] | None) -> TimedRest:
        """Return the motion with coefficients (p,) that is at rest at its end."""
        if near is None:
            found, back = self.run(coefficients), None
        else:
            old, change = near
            by = self.change(old)
            found, back = self.run(old.coefficients + by.resting @ change), by.back
        left = np.inf
        for _ in range(NEWTON):
            before, left = left, self.left(found)
            if left <= EXACT or (back is None and left > before):
                break
            if back is not None and left > SLOWLY * before:
                back = None
            step = self.change(found).back if back is None else back
            found = self.run(found.coefficients - step @ found.errors[0])
        left = self.left(found)
        if not left <= QUIET:
            raise self.failure(found.duration, f'{100.0 * left:.3g} % of the swing is left')
        return found

    def left(self, solution: TimedRest) -> float:
        """Residual vibration as a share of the plain motion's."""
        return float(np.linalg.norm(solution.errors[0])) / self.size

    def failure(self, duration: float, why: str) -> SolverError:
        """Return the error of a motion that was not found."""
        return SolverError(
            f'{self.robot.tree.name}: rest to rest in {duration:.4g} s must be possible, got '
            f'none: {why}'
        )

    def change(self, here: TimedRest) -> _Change:
        """Return the derivatives of a motion, kept with it."""
        if not here.change:
            here.change.append(self._changed(here))
        return here.change[0]

    def _changed(self, here: TimedRest) -> _Change:
        p, duration, motion = self._splines, here.duration, here.motion
        joints = self.robot.joint_indices
        drives = self._drives(self._between, here)
        stretch = np.zeros(self._count)
        stretch[p] = 1.0 / duration
        step = duration / self.count
        error, states = self.swings[0].change(step, motion, drives, stretch)
        errors = [error]
        q, qd = motion.q[:, joints], motion.qd[:, joints]
        for swing in self.swings[1:]:
            other = swing.run(step, q, qd, motion.qdd_joints)
            errors.append(swing.change(step, other, drives, stretch)[0])
        by = error[:, :p]
        towards = scipy.linalg.cho_solve(self._smooth, by.T)
        back = np.zeros((self._count, len(by)))
        back[:p] = towards @ np.linalg.pinv(by @ towards, rcond=1e-10, hermitian=True)
        resting = np.eye(self._count) - back @ error
        return _Change(tuple(errors), states, resting, back)

    def _drives(
        self, places: list[tuple[Array, Array]], here: TimedRest
    ) -> tuple[Array, Array, Array]:
        """Return how positions, rates and accelerations of all joints (k, joints, p) change."""
        p, duration, c = self._splines, here.duration, self.shaped(here.coefficients)
        drives = []
        for order, (design, fixed) in enumerate(places):
            whole = np.zeros((len(design), len(self.driven.ties), self._count))
            whole[:, :, :p] = np.einsum(
                'ji,kf->kjif', self.driven.ties, design / duration**order
            ).reshape(len(design), -1, p)
            rows = self.driven.all((design @ c + fixed) / duration**order, order)
            whole[:, :, p] = -order * rows / duration
            drives.append(whole)
        return drives[0], drives[1], drives[2]

    def jacobian(self, solution: TimedRest) -> Array:
        """Return the derivatives (k r, p) of the shares, row by row."""
        by = self.change(solution)
        robot, p, step = self.robot, self._splines, solution.duration / self.count
        drives = self._drives(self._at_moments, solution)
        moments = moments_change(robot, solution.at, drives, by.states[self._nodes])
        moments = moments._replace(torque=self.driven.ties.T @ moments.torque)
        rows = self.rows.changes(solution.at, step * self._every, moments)
        rows *= self.rows.narrowed(self._look)[:, :, None]
        for k, name in enumerate(self.rows.names):  # differences are over longer steps
            order = DIFFERENCES.get(name.split()[0], 0)
            rows[:, k, p] -= order * solution.shares[:, k] / solution.duration
        passed = np.zeros((len(rows), len(self._goals), self._count))
        if len(self._goals):
            _, gain = self._passed(solution.coefficients, solution.motion)
            at = solution.coefficients[p + 1 :]
            dq = np.zeros((len(at), robot.n, self._count))
            free = robot.free_indices
            dq[:, free] = self._interpolated(by.states[:, : len(free)], at)
            designs = np.einsum('ji,wf->wjif', self.driven.ties, self.basis.design(at))
            dq[:, robot.joint_indices, :p] = designs.reshape(len(at), -1, p)
            changes = np.einsum('wn,wnp->wp', gain, dq)
            pace = solution.duration * self._interpolated(solution.motion.qd, at)
            w = np.arange(len(at))
            changes[w, p + 1 + w] += np.einsum('wn,wn->w', gain, pace)
            passed[0] = changes
        whole = np.concatenate([rows, passed], axis=1).reshape(-1, self._count)
        return np.asarray(whole - (whole @ by.back) @ by.errors[0])

    def motion(self, found: TimedRest) -> RestMotion:
        """Return a motion that was found."""
        times, shaped = self.shares * found.duration, self.shaped(found.coefficients)
        return RestMotion(
            found.duration,
            times,
            found.motion,
            self.left(found),
            self.basis,
            shaped,
            *self.postures,
            self.driven,
        )

    def plan(self, found: TimedRest) -> Plan:
        """Return the plan of a motion, in finer steps."""
        return self.to_plan(self.motion(found))

    def places(self, plan: Plan) -> Array:
        """Return the places along the motion (k,), 0 to 1, of a plan's rows."""
        return np.asarray((plan.t - plan.t[0]) / (plan.t[-1] - plan.t[0]))


# of limits that LimitRows takes by differences in time, their order
DIFFERENCES = {'jerk': 1, 'effort_rate': 1, 'tip_speed': 1, 'tip_acceleration': 2}


@dataclass(frozen=True)
class RestSearch:
    """A search for motions between two postures.

    Attributes
    ----------
    robots : list of Robot
        The robot itself, and those with other frequencies.
    driven : DrivenJoints
    postures : pair of (driven,) arrays
    limits : PlanLimits
    rows : LimitRows
    modes, robustness, waypoints, check
        As of :func:`rest_to_rest`.
    """

    robots: list[Robot]
    driven: DrivenJoints
    postures: tuple[Array, Array]
    limits: PlanLimits
    rows: LimitRows
    modes: int | None
    waypoints: Waypoints | None
    check: Callable[[], None]

    def plan(
        self,
        duration: float | None,
        to_plan: Callable[[RestMotion], Plan],
        progress: Callable[[float], object],
        stopped: Callable[[], bool],
    ) -> Plan:
        """Return the plan of a duration [s], or the shortest, within all limits."""
        problem, found, gains, settled = self.found(duration, progress, stopped)
        if duration is not None:  # they are of the jerk
            gains = np.zeros(len(gains))
        problem.to_plan = to_plan
        return checked_plan(
            problem, Found(found, found.coefficients, gains, 0, settled), self.rows, stopped
        )

    def found(
        self,
        duration: float | None,
        progress: Callable[[float], object],
        stopped: Callable[[], bool],
    ) -> tuple[RestProblem, TimedRest, Array, bool]:
        """Return the problem, the motion, the limits' gains, and whether the search settled.

        Of a duration [s], or the shortest.
        """
        limits = self.limits.joints.of(self.driven.places)
        least = _least(self.postures, limits)
        if duration is None:
            self._require_pace()
            return self._shortest(progress, stopped)
        if np.abs(self.postures[1] - self.postures[0]).max() <= STANDS and self.waypoints is None:
            problem = self._problem(duration)
            problem.refine(duration, 1)
            return (
                problem,
                problem.run(problem.plain(duration)),
                np.zeros(len(problem.names)),
                True,
            )
        problem = self._problem(duration)
        if duration <= least:
            raise problem.failure(
                duration,
                'the limits of velocity, acceleration and jerk leave no motion; these limits '
                f'take {least:.4g} s at least',
            )
        why: SolverError | None = None
        try:
            result = self._timed(problem, problem.plain(duration), progress, stopped)
            if result[1].duration <= (1.0 + ON_TIME) * duration:
                return result
        except CancelledError:
            raise
        except SolverError as error:
            why = error
        shortest_problem, found, *_ = self._shortest(progress, stopped)
        if found.duration <= duration:  # the joints may wait
            problem = self._problem(duration, shortest_problem.basis)
            first = found.coefficients.copy()
            first[problem.at_duration] = duration
            problem.fixed = True
            with suppress(SolverError):
                result = self._timed(problem, first, progress, stopped)
                if result[1].duration <= (1.0 + ON_TIME) * duration:
                    return result
        reason = '' if why is None else f'; {why}'
        raise problem.failure(
            duration, f'the shortest motion that was found takes {found.duration:.4g} s{reason}'
        )

    def _require_pace(self) -> None:
        """Refuse a shortest motion that nothing bounds, or that stands."""
        ways = np.abs(self.postures[1] - self.postures[0])
        if self.waypoints is not None:
            ways = np.abs(self.waypoints.postures - self.postures[0])
        paced = any(name.split()[0] in PACED for name in self.rows.names)
        if not (paced and ways.max(initial=0.0) > STANDS):
            raise StateError(
                f'{self.robots[0].tree.name}: the shortest motion needs a way to go and limits of '
                'velocity, acceleration, effort or such, got none; give a duration'
            )

    def _problem(self, duration: float, basis: RestBasis | None = None) -> RestProblem:
        """Return the problem of a duration, 0: the shortest."""
        limits = self.limits.joints.of(self.driven.places)
        if basis is None:
            last = self.driven.all(self.postures[1])
            fastest = float(ringing_modes(self.robots[0], last, self.modes).frequencies.max())
            wanted = int(np.ceil(SEGMENTS_PER_PERIOD * fastest * duration))
            basis = RestBasis(min(max(wanted, SEGMENTS[0]), SEGMENTS[1]))
        return RestProblem(
            self.robots if duration else self.robots[:1],
            self.driven,
            self.postures,
            self.rows,
            basis,
            duration,
            self.modes,
            np.where(np.isfinite(limits.acceleration), limits.acceleration, 1.0),
            self.waypoints,
            self.check,
        )

    def _timed(
        self,
        problem: RestProblem,
        first: Array,
        progress: Callable[[float], object],
        stopped: Callable[[], bool],
    ) -> tuple[RestProblem, TimedRest, Array, bool]:
        """Return the smoothest motion in the wanted duration, or in little more."""
        wanted = problem.wanted
        problem.refine(wanted, 1)
        rounds = FEW if problem.fixed else SMOOTHER
        found = shortest(problem, first, progress, stopped, rounds)
        solution = found.solution
        if solution.duration <= (1.0 + ON_TIME) * wanted:
            exact = solution.coefficients.copy()
            exact[problem.at_duration] = wanted
            solution = problem.solve(exact, None)
        return problem, solution, found.gains, found.settled

    def _shortest(
        self, progress: Callable[[float], object], stopped: Callable[[], bool]
    ) -> tuple[RestProblem, TimedRest, Array, bool]:
        """Return the shortest motion: with few unknowns and coarse steps first, then with all."""
        joints = len(self.postures[0])
        segments = min(max(UNKNOWNS // joints, LEAST_FINE), FINEST) // 2
        rough = self._problem(0.0, RestBasis(segments, 3, 3))
        first = self._begin(rough)
        rough.refine(float(first[rough.at_duration]), 0)
        found = shortest(rough, first, lambda share: progress(0.6 * share), stopped, ROUNDS)
        jumps = self._may_jump(found.solution.duration / segments)
        basis = RestBasis(segments, 3, 2, jumps=True) if jumps else RestBasis(2 * segments, 3, 3)
        problem = self._problem(0.0, basis)
        problem.refine(found.solution.duration, 1)
        start = problem.near(rough, found.coefficients)

        found = self._faster(problem, start, lambda share: progress(0.6 + 0.4 * share), stopped)
        return problem, found.solution, found.gains, found.settled

    def _faster(
        self,
        problem: RestProblem,
        start: Array,
        progress: Callable[[float], object],
        stopped: Callable[[], bool],
    ) -> Found[TimedRest]:
        """Return the shortest motion near one: shorter and shorter durations are tried.

        In a given duration the motion of a robot with small deflections is nearly linear in its
        coefficients. In the duration it is not: the phases of fast modes turn with it.
        """
        best: Found[TimedRest] | None = None
        x, duration = start, float(start[problem.at_duration])
        low, high, guess = 0.0, np.inf, np.inf
        problem.fixed, (problem.price, problem.steady) = True, TRIED
        for k in range(TRIES):
            progress(k / TRIES)
            x = x.copy()
            x[problem.at_duration] = duration
            try:
                best = shortest(problem, x, lambda _share: None, stopped, TRY)
                x, high = best.coefficients, duration
            except CancelledError:
                raise
            except SolverError as error:
                low, guess = duration, (1.0 + PACE) * duration
                if isinstance(error, _BeyondError):
                    x = error.coefficients
                    with suppress(SolverError):
                        guess = (1.0 + RATE * excess(problem.solve(x, None))) * duration
            if stopped() or (best is not None and high <= (1.0 + TIGHT) * low):
                break
            if best is None:
                duration = max(guess, (1.0 + TIGHT) * duration)
            elif low:
                duration = min(guess, np.sqrt(low * high))
            else:
                duration *= 1.0 - PACE
        problem.fixed, (problem.price, problem.steady) = False, QUICK
        if best is None:
            return shortest(problem, problem.kept(start), progress, stopped, ROUNDS // 3)
        closed = high <= (1.0 + TIGHT) * low
        if not stopped():  # for the limits' gains
            with suppress(SolverError):
                best = shortest(problem, best.coefficients, progress, stopped, POLISH)
        return replace(best, settled=closed or (best.settled and not stopped()))

    def _may_jump(self, segment: float) -> bool:
        """Say whether accelerations may jump between segments [s].

        Where no limit needs differences in time, and segments resolve the modes that it excites.
        """
        if any(name.split()[0] in DIFFERENCES for name in self.rows.names):
            return False
        robot = self.robots[0]
        end = robot.static_deflection(self.driven.all(self.postures[1]))
        fastest = float(robot.natural_frequencies(end, held=False).max())
        return RESOLVED * fastest * segment <= 1.0

    def _begin(self, problem: RestProblem) -> Array:
        """Return the plain motion, so slow that it keeps its limits."""
        limits = self.limits.joints.of(self.driven.places)
        seconds = max(2.0 * _least(self.postures, limits), 1.0 / problem.fastest)
        for _ in range(GUESSES):
            problem.refine(seconds, 0)
            most = 1.0 + excess(problem.run(problem.plain(seconds)))
            if most <= 1.0 + NEAR:
                break
            seconds *= max(np.sqrt(most), 1.05)
        return problem.plain(1.1 * seconds)


def rest_to_rest(
    robot: Robot,
    start: ArrayLike,
    end: ArrayLike,
    duration: float | None = None,
    limits: JointLimits | None = None,
    *,
    modes: int | None = None,
    robustness: float = 0.0,
    check: Callable[[], None] = lambda: None,
) -> RestMotion:
    """Return a joint motion between two postures that ends with every mode at rest.

    Of all such motions of a duration it has the least mean square jerk. It begins and ends in
    static equilibrium, with no velocity and acceleration, and no jerk where a duration is given.

    Parameters
    ----------
    robot : Robot
        With the payload it carries, without loops.
    start, end : (joints,) arrays
        Postures [rad, m]; mimic joints follow their leaders.
    duration : float, optional
        s; default the shortest within the limits.
    limits : JointLimits, optional
        Default those of the URDF.
    modes : int, optional
        How many modes rest, from the lowest; default those below ten times the lowest.
    robustness : float
        Share by which the modes' frequencies may be off: the swing of robots that are so much
        stiffer and softer is weighed against the jerk, of a motion with a duration.
    check : callable
        Called now and then; what it raises ends the search.

    Raises
    ------
    StateError
        Postures of a wrong shape, not finite or outside of the limits.
    SolverError
        No such motion within the limits; the message says how much is left.

    Notes
    -----
    Sequential convex programming (:func:`shortest`) over the coefficients of splines and the
    duration. Each round simulates the motion on the nonlinear dynamics and takes the derivatives
    of what rings at its end and of all limits by the linearization along it.
    """
    joints = joint_limits(robot) if limits is None else limits
    search = rest_search(
        robot, (start, end), PlanLimits(joints, {}, {}, {}), (), modes, robustness, None, check
    )
    if duration is not None and not (np.isfinite(duration) and duration > 0.0):
        raise StateError(f'rest to rest: duration must be > 0 s, got {duration}')
    problem, found, _, _ = search.found(duration, lambda _share: None, lambda: False)
    return problem.motion(found)


def rest_search(
    robot: Robot,
    postures: tuple[ArrayLike, ArrayLike],
    limits: PlanLimits,
    frames: tuple[str, ...],
    modes: int | None,
    robustness: float,
    waypoints: Waypoints | None,
    check: Callable[[], None],
) -> RestSearch:
    """Return the search between two postures of all joints, after a check (see above)."""
    robot = robot.copy()
    driven = DrivenJoints(robot, 'rest to rest')
    found = _checked(robot, driven, *postures, limits.joints)
    if not 0.0 <= robustness < 1.0:
        raise StateError(f'rest to rest: robustness must be >= 0 and < 1, got {robustness}')
    _require_holding(robot, driven, found, limits.joints.of(driven.places))
    links = {body.link for body in robot.tree.bodies}
    robots = [robot] + [
        with_stiffness(robot, dict.fromkeys(links, (1.0 + share) ** 2))
        for share in (-robustness, robustness)
        if robustness
    ]
    rows = LimitRows(robot, robot.indices(driven.names), frames, limits)
    rest = np.array([robot.static_deflection(driven.all(posture)) for posture in found])
    still = np.zeros_like(rest)
    torque = driven.torque(robot.inverse_dynamics(rest, still, still)[:, robot.joint_indices])
    require_rest(rows.names, rows.values(Moments(rest, still, still, torque), 1.0))
    return RestSearch(robots, driven, found, limits, rows, modes, waypoints, check)


def _checked(
    robot: Robot, driven: DrivenJoints, start: ArrayLike, end: ArrayLike, limits: JointLimits
) -> tuple[Array, Array]:
    """Return the postures of the driven joints after a check."""
    found = []
    for name, posture in (('start', start), ('end', end)):
        q = np.array(posture, dtype=np.float64)
        if q.shape != (len(robot.joint_names),) or not np.isfinite(q).all():
            raise StateError(
                f'rest to rest: {name} must be {len(robot.joint_names)} finite numbers, got {q}'
            )
        q = driven.following(q)
        if (q < limits.lower).any() or (q > limits.upper).any():
            raise StateError(
                f'rest to rest: {name} must be within {limits.lower.tolist()} to '
                f'{limits.upper.tolist()}, got {q.tolist()}'
            )
        found.append(q[driven.places])
    return found[0], found[1]


def _require_holding(
    robot: Robot, driven: DrivenJoints, postures: tuple[Array, Array], limits: JointLimits
) -> None:
    """Refuse postures that the joints' efforts cannot hold, however long the motion takes."""
    for name, posture in zip(('start', 'end'), postures, strict=True):
        q = robot.static_deflection(driven.all(posture))
        zero = np.zeros_like(q)
        torque = driven.torque(robot.inverse_dynamics(q, zero, zero)[robot.joint_indices][None])[0]
        for joint, needed, most in zip(driven.places, torque, limits.effort, strict=True):
            if abs(needed) > most:
                raise SolverError(
                    f'{robot.tree.name}: rest to rest: effort of '
                    f'{robot.joint_names[joint]!r} must hold the {name} '
                    f'posture, which needs {abs(needed):.4g}, got a limit of {most:.4g}'
                )


def with_stiffness(robot: Robot, factors: Mapping[str, float]) -> Robot:
    """Return the robot with the stiffness of links multiplied by factors."""
    changes = {}
    for body in robot.tree.bodies:
        factor = factors.get(body.link, 1.0)
        if body.modes is not None:
            changes[f'flexible.{body.name}.stiffness'] = body.modes.factor * factor
        if body.beam is None or body.segment > 1:
            continue
        for part, path in (('y', 'y.ei'), ('z', 'z.ei'), ('torsion', 'torsion.gj')):
            deformation = getattr(body.beam, part)
            if deformation is not None and deformation.modes:
                changes[f'beam.{body.name}.{path}'] = deformation.stiffness * factor
    return robot.with_overrides(changes)


def _least(postures: tuple[Array, Array], limits: JointLimits) -> float:
    """Return the duration [s] below which the joints' limits but for effort cannot be kept."""
    way = np.abs(postures[1] - postures[0])
    least = np.maximum(way / limits.velocity, 2.0 * np.sqrt(way / limits.acceleration))
    least = np.maximum(least, np.cbrt(32.0 * way / limits.jerk))
    return float(least.max(initial=0.0))
