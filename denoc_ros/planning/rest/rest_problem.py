"""The motion between two postures as splines, its residual vibration, and its limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import clarabel
import numpy as np
import scipy.linalg
import scipy.sparse as sparse
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, CubicHermiteSpline, PPoly

from denoc_ros.dynamics.driven.driven_joints import DrivenJoints
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError
from denoc_ros.model.joint_friction import Friction
from denoc_ros.planning.rest.end_swing import (
    Driven,
    EndSwing,
    closing,
    free_motion,
    moments_change,
)
from denoc_ros.planning.shapers.ringing import fastest_mode, ringing_modes
from denoc_ros.planning.timing.limit_rows import LimitRows, Moments
from denoc_ros.planning.timing.minimum_time import Part
from denoc_ros.types import Array, IntArray

PER_SEGMENT = {1: 2, 3: 2, 5: 6}  # moments at which limits are looked at, by the splines' degree
MOMENTS = 1, 160  # of all, at least: with coarse steps and with fine ones
RAMPS = {1: 4, 3: 8}  # of a segment, by the degree: shares in which a motion nearly jumps
STEPS = 200  # of the simulated motion, at least
# of the fastest mode that rests, and of the fastest of all: while unknowns are few, and after
STEPS_PER_PERIOD = (20.0, 60.0), (10.0, 40.0)
STEPS_BY_TORQUE, MOMENTS_BY_TORQUE = 20.0, 8.0  # of the fastest mode whose joints are free
LEAST_BY_TORQUE = 480  # moments
FINER = 4  # parts of these steps, between which splines follow accelerations
QUIET = 1e-3  # share of the plain motion's swing that counts as rest
EXACT = 1e-4  # share to which the search brings it
STANDS = 1e-9  # rad, m: a way that is none
NEWTON = 10  # steps to rest
SLOWLY = 0.1  # share of a swing that a step with the derivatives of the motion before leaves
# durations that the plain motion's mean square of jerk costs in minimum time, without and with
# jumps, and that of the torques' slope
SMOOTH, SMOOTH_TORQUES = (1e-7, 1e-9), 1e-6
TURNS = 20.0  # mean square of the slope of a torque that goes once between its limits
ROBUSTNESS = 2e4  # jerks of the plain motion that all the swing with other frequencies costs
FIRM, STEADY = 200.0, 1e-4  # price of a share beyond a limit, and least share of the jerk saved
ROOM = 0.9  # share of the limits that the shortest motion may leave free in a duration
FASTER = 1.0, 0.9, 0.8, 0.7  # plain motions of which the largest swing is that scale
PARTS = 16  # of a segment, over which jerks are means
STEP_OF_JOINTS, STEP_OF_TORQUES = 0.3, 2.0  # scale of a trust region
RIDGE = 1e-6  # price of a square of a step of torques
RIDGE_OF_JOINTS = 1e-2  # and of the mean square of how far joints move, over their steps
TRUSTED = 15  # moments on the way at which joints change by that


class RestBasis:
    """B-splines over [0, 1] whose ends are fixed, and first derivatives 0 there.

    Parameters
    ----------
    segments : int
        Equal pieces.
    degree, ends : int
        Of the splines, and how many coefficients are fixed at each end: of degree 5 with 4
        position, velocity, acceleration and jerk; of degree 3 with 3 all but the jerk. Those of
        degree 1 are of net torques.
    steep : bool
        Whether accelerations or torques nearly jump. Of degree 3, each segment begins with a ramp,
        an eighth of it, from which the spline may bend, and the last one ends with one too; of
        degree 1 the first one begins and the last one ends with one, a quarter.

    Attributes
    ----------
    by_torque : bool
        Whether the splines are of net torques, else of joints.
    order : int
        Derivative of the splines that is an acceleration or a torque.
    inner : array
        Knots but the ends.
    free : int
        Coefficients of each joint that are free.
    rows : int
        Equal parts of the duration at whose ends all knots are.
    """

    def __init__(self, segments: int, degree: int = 5, ends: int = 4, steep: bool = False) -> None:
        self.segments, self.steep = segments, steep
        self.degree, self._ends = degree, ends
        self.by_torque = degree == 1
        self.order = 0 if self.by_torque else 2
        ramps = RAMPS[degree] if steep else 1
        self.rows = ramps * segments
        at = np.arange(1, self.rows)
        bends = at % ramps <= (1 if degree == 3 else 0)
        inner = at[bends | (at == 1) | (at == self.rows - 1)]
        self.inner = inner / self.rows
        self._knots = np.concatenate((np.zeros(degree + 1), self.inner, np.ones(degree + 1)))
        self._count = len(inner) + degree + 1
        self.free = self._count - 2 * ends

    def moments(self, least: float) -> tuple[int, Array]:
        """Return nodes for each segment, and the shares at which limits are looked at."""
        nodes = RAMPS[self.degree] if self.steep else PER_SEGMENT[self.degree]
        nodes *= max(1, int(np.ceil(least / (nodes * self.segments))))
        return nodes, np.linspace(0.0, 1.0, nodes * self.segments + 1)

    def design(self, shares: ArrayLike, derivative: int = 0) -> Array:
        """Basis functions of the free coefficients at shares (k,) of the duration: (k, free)."""
        return self._columns(shares, derivative)[:, self._ends : -self._ends]

    def fixed(self, start: Array, end: Array, shares: ArrayLike, derivative: int = 0) -> Array:
        """Motion by the fixed coefficients at shares (k,): (k, joints)."""
        columns = self._columns(shares, derivative)
        first = columns[:, : self._ends].sum(axis=1)
        last = columns[:, -self._ends :].sum(axis=1)
        return np.asarray(np.outer(first, start) + np.outer(last, end))

    def spline(self, free: Array, start: Array, end: Array, duration: float) -> BSpline:
        """Return the spline (joints,) of the time [s] with free coefficients (free, joints)."""
        ends = np.ones((self._ends, 1))
        rows = np.vstack([ends * start, free, ends * end])
        return BSpline(duration * self._knots, rows, self.degree)

    def _columns(self, shares: ArrayLike, derivative: int) -> Array:
        moments = np.asarray(shares, dtype=np.float64)
        inside = np.clip(moments, 0.0, 1.0)
        spline = BSpline(self._knots, np.eye(self._count), self.degree)
        columns = np.array(spline(inside, derivative))
        if derivative:
            columns[inside != moments] = 0.0
        return columns


Places = list[tuple[Array, Array]]  # designs and fixed parts of splines, by derivative


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
    rows : int
        Equal parts of the duration at whose ends accelerations bend.
    """

    duration: float
    t: Array
    states: Driven
    left: float
    rows: int
    spline: BSpline | PPoly  # (driven,) of the time
    driven: DrivenJoints

    def joints(self, times: ArrayLike, derivative: int = 0) -> Array:
        """Return the joints' motion (k, joints), or a derivative of it, held outside."""
        at = np.asarray(times, dtype=np.float64)
        inside = np.clip(at, 0.0, self.duration)
        rows = np.array(self.spline(inside, derivative))
        if derivative in (1, 2):  # at rest at both ends, exactly
            rows[(at <= 0.0) | (at >= self.duration)] = 0.0
        elif derivative:
            rows[inside != at] = 0.0
        return self.driven.all(rows, derivative)

    def coordinates(self, times: Array) -> tuple[Array, Array]:
        """Return all coordinates and their rates (k, n) at times within the motion."""
        spline = CubicHermiteSpline(self.t, self.states.q, self.states.qd)
        return spline(times), spline(times, 1)


@dataclass(frozen=True)
class TimedRest:
    """A motion with coefficients, at rest at its end (see :class:`RestProblem`)."""

    coefficients: Array
    duration: float
    cost: float
    shares: Array
    at: Moments
    motions: tuple[Driven, ...]  # of each robot
    errors: tuple[Array, ...]  # that rings at their ends
    gaps: Array | None  # (k - 1, 2 n), after the steps of a motion that is not simulated
    change: list[_Change] = field(default_factory=list)  # once it was asked for

    @property
    def motion(self) -> Driven:
        """Of the robot itself."""
        return self.motions[0]


@dataclass(frozen=True)
class _Change:
    """Derivatives of a motion by its coefficients.

    Attributes
    ----------
    errors : arrays (m, p)
        Of each robot's residual vibration.
    states : (k, 2 n, p) array
        Of all coordinates and their rates at the ends of steps.
    back : (p, m) array
        The smoothest change of coefficients for a residual vibration.
    passed : array
        How steps pass on a change of the states (see :meth:`EndSwing.change`).
    """

    errors: tuple[Array, ...]
    states: Array
    back: Array
    passed: Array


@dataclass(frozen=True)
class RestCost:
    """Jerk and swing with other frequencies of a motion that rests (see :class:`Objective`)."""

    here: TimedRest
    problem: RestProblem

    def part(self, c: Array, unit: float) -> Part:
        """Return its part of a program; it has no unknowns of its own."""
        problem, here = self.problem, self.here
        scale, least, most = problem.region(c)
        hessian, gradient = problem.curvature(here)
        own = problem.change(here).errors[0]
        size = np.linalg.norm(own * scale, axis=1)
        trusted = problem.trusted(here) * scale
        ridge = problem.ridge * np.eye(len(c))
        if len(trusted):
            ridge += 2.0 * RIDGE_OF_JOINTS / len(trusted) * trusted.T @ trusted
        return Part(
            scale,
            least,
            most,
            gradient * scale / unit,
            hessian * scale * scale[:, None] / unit + ridge,
            here.cost / unit,
            sparse.csr_array(own * scale / size[:, None]),
            -here.errors[0] / size,
            [clarabel.ZeroConeT(len(size))],
            0.0 if problem.gentle else ROOM,
            trusted,
        )


class RestProblem:
    """Motions in a duration that end at rest (see :class:`MinimumTimeProblem`).

    Coefficients are those of the splines of joints, or of their net torques without Coulomb
    friction, joint by joint, and the duration, which no program
    changes: the phases of fast modes turn with it, while in one duration a motion is nearly
    linear. Every solution is at rest at its end. Waypoints are passed where the tip is nearest.

    Parameters
    ----------
    robots : list of Robot
        The robot itself, and those with other frequencies that should rest as well.
    driven : DrivenJoints
    postures : pair of (driven,) arrays
    rows : LimitRows
    basis : RestBasis
    gentle : bool
        Whether the cost is the jerk; else the least share of the limits in the duration.
    modes, waypoints, check
        As of :func:`rest_to_rest`.
    scale : (driven,) array
        Of the joints' jerks, or their torques.

    Attributes
    ----------
    longer : bool
        Whether a motion that needs too much of its limits becomes slower; else there is none.
    """

    def __init__(
        self,
        robots: list[Robot],
        driven: DrivenJoints,
        postures: tuple[Array, Array],
        rows: LimitRows,
        basis: RestBasis,
        gentle: bool,
        modes: int | None,
        scale: Array,
        waypoints: Waypoints | None,
        check: Callable[[], None],
    ) -> None:
        self.robot, self.driven, self.postures = robots[0], driven, postures
        self.rows, self.basis, self.gentle = rows, basis, gentle
        self.waypoints, self._check = waypoints, check
        self.to_plan: Callable[[RestMotion], Plan]
        first, last = (driven.all(each) for each in postures)
        self._by_torque, self._scale = basis.by_torque, scale
        self.swings = [EndSwing(each, first, last, modes, self._by_torque) for each in robots]
        # of the splines: the joints, or the torques that hold them
        self._ends = postures
        if self._by_torque:
            self._ends = self._held(first), self._held(last)
            self._holding = np.ravel(
                [np.interp(basis.inner, [0.0, 1.0], e) for e in zip(*self._ends, strict=True)]
            )
        self.fastest = float(ringing_modes(self.robot, last, modes).frequencies.max())
        self._free = free_motion(self.robot, last)[0] if self._by_torque else 0.0
        self._all = fastest_mode(self.robot, last, self.fastest)
        count = 0 if waypoints is None else len(waypoints.postures)
        self.names = rows.row_names + tuple(
            f'waypoint {k + 1}' for k in range(count) for _ in range(3)
        )
        self.price, self.steady = (FIRM, STEADY) if gentle else (1.0, STEADY)
        self._splines = basis.free * len(postures[0])
        self._count = self._splines + 1
        self._way = self._lengths()
        self._hessian, self._gradient, self._constant = self._jerk(scale)
        eye = np.eye(self._splines)
        even = self._hessian + 1e-13 * float(np.trace(self._hessian)) / self._splines * eye
        self._smooth = scipy.linalg.cho_factor(even)
        self._plain_jerk = TURNS * len(scale)
        if not self._by_torque:
            self._plain_jerk = max(self.jerk(self.plain(1.0)), 1e-12)
        self._goals = self._places()
        self.longer = not gentle
        self.size = self.swing = 1.0
        self.ridge = RIDGE if self._by_torque else 0.0

    def refine(self, duration: float, fine: int) -> None:
        """Take steps for a duration [s]: coarse (0) or fine (1) ones."""
        turns = self._free * duration  # of the fastest mode that torques excite
        least = LEAST_BY_TORQUE if self._by_torque else MOMENTS[fine]
        each, self._look = self.basis.moments(max(least, MOMENTS_BY_TORQUE * turns))
        nodes = each * self.basis.segments
        rests, every = (each[fine] for each in STEPS_PER_PERIOD)
        # splines excite modes little that are faster than their segments
        excited = min(self._all * duration, self.basis.segments)
        steps = max(STEPS, rests * self.fastest * duration, every * excited)
        if self._by_torque:
            steps = max(STEPS, STEPS_BY_TORQUE * turns)
        self._every = int(np.ceil(steps / nodes))
        self.count = nodes * self._every
        self.shares = np.linspace(0.0, 1.0, self.count + 1)
        self._nodes = np.rint(self._look * self.count).astype(np.int64)
        middle = 0.5 * (self.shares[1:] + self.shares[:-1])
        # of positions, rates and accelerations: at the ends of steps, in their middle, at moments
        self._at_ends, self._between, self._at_moments = (
            [
                (self.basis.design(shares, k), self.basis.fixed(*self._ends, shares, k))
                for k in range(self.basis.order + 1)
            ]
            for shares in (self.shares, middle, self._look)
        )
        if self._by_torque:
            return
        sizes = [
            float(np.linalg.norm(self.run(self.plain(share * duration)).errors[0]))
            for share in FASTER
        ]
        self.size, self.swing = max(sizes[0], 1e-9), max(*sizes, 1e-9)

    def _held(self, posture: Array) -> Array:
        """Return the driven joints' torques (driven,) at rest in a posture of all joints."""
        rest = self.robot.static_deflection(posture)
        still = np.zeros_like(rest)
        force = self.robot.inverse_dynamics(rest, still, still)[self.robot.joint_indices]
        return self.driven.torque(force)

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

        design = np.kron(np.diag(1.0 / scale), slopes(self.basis.design(shares, self.basis.order)))
        fixed = slopes(self.basis.fixed(*self._ends, shares, self.basis.order)) / scale
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
        return np.append(free, duration)

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

    def _prices(self) -> tuple[float, float]:
        """Return the prices of a jerk, and of a swing's square."""
        if self.gentle:
            return 1.0 / self._plain_jerk, ROBUSTNESS / self.swing**2
        price = SMOOTH_TORQUES if self._by_torque else SMOOTH[self.basis.steep]
        return price / self._plain_jerk, 0.0

    def _cost(self, x: Array, errors: tuple[Array, ...]) -> float:
        smooth, quiet = self._prices()
        rung = sum(float(error @ error) for error in errors[1:])
        return float(not self.gentle) + smooth * self.jerk(x) + quiet * rung

    def curvature(self, here: TimedRest) -> tuple[Array, Array]:
        """Return the cost's second and first derivatives by the coefficients."""
        smooth, quiet = self._prices()
        p, n = self._splines, self._count
        hessian, gradient = np.zeros((n, n)), np.zeros(n)
        hessian[:p, :p] = smooth * self._hessian
        gradient[:p] = smooth * (self._hessian @ here.coefficients[:p] + self._gradient)
        pairs = zip(here.errors[1:], self.change(here).errors[1:], strict=True)
        for error, by in pairs:
            hessian += 2.0 * quiet * by.T @ by
            gradient += 2.0 * quiet * by.T @ error
        return hessian, gradient

    def region(self, x: Array) -> tuple[Array, Array, Array]:
        """Return scales of coefficients, and bounds of their changes over these."""
        each = STEP_OF_TORQUES * self._scale if self._by_torque else STEP_OF_JOINTS * self._way
        scale = np.append(np.repeat(each, self.basis.free), 1.0)
        most = np.full(len(x), np.inf)
        most[-1] = 0.0
        return scale, -most, most

    def trusted(self, here: TimedRest) -> Array:
        """Return how joints change on the way under torques (t, p), over their steps."""
        if not self._by_torque:
            return np.zeros((0, self._count))
        return self._trusted(self.change(here).states)

    def _beside(self, found: TimedRest, motion: Driven) -> float:
        """Return how far the joints of a motion are from another's, over their steps."""
        off = (found.motion.q - motion.q)[:, self.robot.joint_indices]
        return float((np.abs(off).max(axis=0) / (STEP_OF_JOINTS * self._way)).max())

    def _trusted(self, states: Array) -> Array:
        at = np.linspace(0, self.count, TRUSTED + 2).astype(np.int64)[1:-1]
        moved = states[at][:, self.robot.joint_indices]
        return np.concatenate(moved / (STEP_OF_JOINTS * self._way)[:, None])

    def shares_at(self, found: TimedRest, here: TimedRest) -> Array:
        """Return the shares (k, r) of a motion: its rows are at the same shares of time."""
        return found.shares

    def program(self, solution: TimedRest) -> RestCost:
        """Return the cost as a function of the coefficients."""
        return RestCost(solution, self)

    def slower(self, coefficients: Array, factor: float) -> Array:
        """Take more time for the same motion."""
        if not self.longer:
            raise self.failure(coefficients[-1], 'limits are passed')
        return self.lasting(coefficients, factor * coefficients[-1])

    def lasting(self, coefficients: Array, duration: float) -> Array:
        """Return the coefficients of a like motion in another duration [s]."""
        other: Array = np.array(coefficients)
        if self._by_torque:  # what accelerates a stiff arm grows with the square of the pace
            other[:-1] -= self._holding
            other[:-1] *= (other[-1] / duration) ** 2
            other[:-1] += self._holding
        other[-1] = duration
        return other

    def near(self, other: RestProblem, x: Array) -> Array:
        """Return the coefficients of the motion of a problem with other splines."""
        found = other.run(x)
        shares = other.shares
        rows = found.motion.q[:, self.robot.joint_indices]
        if self._by_torque:
            at = other._at_steps(found)
            given = np.ascontiguousarray(at.qdd[:, self.robot.joint_indices])
            rows, _ = self.swings[0].net.hybrid_dynamics(at.q, at.qd, given)
            self.size, self.swing = other.size, other.swing
        wanted = rows[:, self.driven.places] - self.basis.fixed(*self._ends, shares)
        fitted = np.linalg.lstsq(self.basis.design(shares), wanted)[0]
        return np.append(fitted.T.ravel(), found.duration)

    def shaped(self, x: Array) -> Array:
        """Return the splines' coefficients (free, driven)."""
        return np.asarray(x[: self._splines].reshape(len(self._way), -1).T)

    def run(self, x: Array, near: Driven | None = None) -> TimedRest:
        """Return the motion with coefficients, whatever rings at its end.

        One by torques may be given by the states near it, with gaps after their steps.
        """
        self._check()
        duration, swings = float(x[-1]), self.swings
        step = duration / self.count
        between = self._rows(x, self._between)
        motions, gaps = [], None
        if near is not None:
            motions.append(near._replace(between=between))
            gaps = swings[0].gaps(step, motions[0])
        if self._by_torque:
            motions += [swing.run_by_torque(step, between) for swing in swings[len(motions) :]]
        else:
            q, qd = (self._rows(x, self._at_ends, order) for order in range(2))
            motions = [swing.run(step, q, qd, between) for swing in swings]
        errors = tuple(swing.error(motion) for swing, motion in zip(swings, motions, strict=True))
        own = motions[0]
        at = self._moments(x, own.q[self._nodes], own.qd[self._nodes], self._at_moments)
        shares = self.rows.values(at, step * self._every)
        shares = shares * self.rows.narrowed(self._look)
        passed = np.zeros((len(shares), 3 * len(self._goals)))
        if len(self._goals):
            passed[0] = self._passed(own)[0]
        return TimedRest(
            x,
            duration,
            self._cost(x, errors),
            np.hstack([shares, passed]),
            at,
            tuple(motions),
            errors,
            gaps,
        )

    def _rows(self, x: Array, places: Places, order: int | None = None) -> Array:
        """Return a derivative of the splines (k, joints), by default their drive."""
        order = self.basis.order if order is None else order
        design, fixed = places[order]
        rows = (design @ self.shaped(x) + fixed) / x[-1] ** order
        return self.driven.all(rows, order) if not self._by_torque else rows

    def _forces(self, x: Array, places: Places) -> Array:
        """Return the net torques among the forces of all coordinates (k, n)."""
        rows = self._rows(x, places)
        forces = np.zeros((len(rows), self.robot.n))
        forces[:, self.robot.joint_indices] = rows
        return forces

    def _moments(self, x: Array, q: Array, qd: Array, places: Places) -> Moments:
        """Return a motion (k, n) with its accelerations and torques."""
        robot, given = self.robot, self._rows(x, places)
        q, qd = np.ascontiguousarray(q), np.ascontiguousarray(qd)
        if self._by_torque:
            forces = self._forces(x, places)
            given = self.swings[0].net.forward_dynamics(q, qd, forces)[:, robot.joint_indices]
        force, free = robot.hybrid_dynamics(q, qd, given)
        qdd = np.zeros_like(q)
        qdd[:, robot.joint_indices], qdd[:, robot.free_indices] = given, free
        return Moments(q, qd, qdd, self.driven.torque(force))

    def _passed(self, motion: Driven) -> tuple[Array, Array, IntArray]:
        """Return how far tips are from the waypoints over the radius (3 w,), and by q (3 w, n).

        And in which steps (w,). Of each waypoint in two directions across, where it is 0, and
        along: so a step sees the whole of its way past a waypoint.
        """
        assert self.waypoints is not None
        frame, radius = self.waypoints.frame, self.waypoints.radius
        apart = self.robot.frame_pose(frame, motion.q)[:, None, :3, 3] - self._goals
        steps = _nearest(np.einsum('kwc,kwc->kw', apart, apart))
        off = apart[steps, np.arange(len(steps))]
        q = np.ascontiguousarray(motion.q[steps])
        directions = np.linalg.svd(off[:, None])[2][:, ::-1]  # the last one is along
        size = np.einsum('wdc,wc->wd', directions, off)
        gain = np.einsum('wdc,wcn->wdn', directions, self.robot.frame_jacobian(frame, q)[:, :3])
        return size.ravel() / radius, gain.reshape(-1, self.robot.n) / radius, steps

    def solve(self, coefficients: Array, near: tuple[TimedRest, Array] | None) -> TimedRest:
        """Return the motion with coefficients (p,) that is at rest at its end.

        Errors of second order add up along a motion by torques, and take light joints far: so
        its states are unknowns of Newton's method as well, from those of the motion near it on.
        """
        by: _Change | None = None
        if near is None:
            found = self.run(coefficients)
        else:
            old, change = near
            found = self._moved(old, self.change(old), change)
            by = None if change[-1] else self.change(old)
        first, left, fresh = found.motion, np.inf, False
        for _ in range(NEWTON):
            before, (left, error, gap) = left, self._off(found, by)
            if left <= EXACT or (fresh and not left <= before):
                break
            if by is not None and not left <= SLOWLY * before:
                by = None
                left, error, gap = self._off(found, by)
            fresh = by is None
            step = self.change(found) if by is None else by
            found = self._moved(found, step, -step.back @ error, gap)
            by = step if self._by_torque else by
        left = self.left(found)
        if not left <= QUIET:
            raise self.failure(found.duration, f'{100.0 * left:.3g} % of the swing is left')
        if near is not None and self._by_torque and self._beside(found, first) > 1.0:
            raise self.failure(found.duration, 'a motion at rest is far')
        return found

    def _moved(
        self, old: TimedRest, by: _Change, change: Array, more: Array | float = 0.0
    ) -> TimedRest:
        """Return the motion after a change of coefficients, and of states (k, 2 n) under torques.

        There the states are those to first order.
        """
        x = old.coefficients + change
        if not self._by_torque:
            return self.run(x)
        moved = by.states @ (self.lasting(x, old.duration) - old.coefficients) + more
        q, qd = np.split(moved, 2, axis=1)
        qd = (old.duration / x[-1]) * (old.motion.qd + qd)
        return self.run(x, Driven(old.motion.q + q, qd, old.motion.between))

    def _off(self, found: TimedRest, by: _Change | None) -> tuple[float, Array, Array | float]:
        """Return the share of the plain motion's swing that is left, and how much (m,).

        And the change of the states (k, 2 n) that closes gaps after steps, by the derivatives of
        a motion near it, or its own.
        """
        error = found.errors[0]
        if found.gaps is None:
            return float(np.linalg.norm(error)) / self.size, error, 0.0
        by = self.change(found) if by is None else by
        gap = closing(by.passed, found.gaps)
        off = self.swings[0].seen(gap)
        off[-1] += error
        return float(np.linalg.norm(off, axis=1).max()) / self.size, off[-1], gap

    def left(self, solution: TimedRest) -> float:
        """Residual vibration as a share of the plain motion's."""
        return self._off(solution, None)[0]

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
        step = here.duration / self.count
        joints, n = self.robot.joint_indices, self.robot.n
        drives = self._drives(self._between, here.duration)
        error, states, passed = self.swings[0].change(step, here.motion, drives)
        if not self._by_torque:
            moved = self._drives(self._at_ends, here.duration)
            states[:, joints], states[:, n + joints] = moved[:2]
        errors = [error]
        for swing, motion in zip(self.swings[1:], here.motions[1:], strict=True):
            errors.append(swing.change(step, motion, drives)[0])
        by = error[:, : self._splines]
        metric = self._smooth
        if self._by_torque:  # the least change of torques may take light joints far
            to_joints = self._trusted(states)[:, : self._splines]
            metric = scipy.linalg.cho_factor(
                self._hessian / self._plain_jerk + to_joints.T @ to_joints / len(to_joints)
            )
        towards = scipy.linalg.cho_solve(metric, by.T)
        back = np.zeros((self._count, len(by)))
        back[: self._splines] = towards @ np.linalg.pinv(by @ towards, rcond=1e-10, hermitian=True)
        return _Change(tuple(errors), states, back, passed)

    def _drives(self, places: Places, duration: float) -> tuple[Array, ...]:
        """Return how all joints' torques, or motion and its derivatives, change.

        Each (k, joints, p).
        """
        drives = []
        for order, (design, _) in enumerate(places):
            whole = np.zeros((len(design), len(self.driven.ties), self._count))
            whole[:, :, : self._splines] = np.einsum(
                'ji,kf->kjif', self.driven.ties, design / duration**order
            ).reshape(len(design), len(self.driven.ties), -1)
            drives.append(whole)
        return tuple(drives)

    def jacobian(self, solution: TimedRest) -> Array:
        """Return the derivatives (k r, p) of the shares, row by row."""
        by = self.change(solution)
        robot, step = self.robot, solution.duration / self.count
        drive = self._drives(self._at_moments, solution.duration)[-1]
        states, at = by.states[self._nodes], solution.at
        if self._by_torque:
            joints = robot.joint_indices
            forces = self._forces(solution.coefficients, self._at_moments)
            of = self.swings[0].net.forward_dynamics_derivatives(at.q, at.qd, forces)
            q, qd = np.split(states, 2, axis=1)
            slope = Friction(np.zeros(len(joints)), robot.friction[joints]).slope(at.qd[:, joints])
            moments = Moments(
                q,
                qd,
                of[0] @ q + of[1] @ qd + of[2][:, :, joints] @ drive,
                drive + slope[:, :, None] * qd[:, joints],
            )
        else:
            moments = moments_change(robot, at, drive, states)
        moments = moments._replace(torque=self.driven.ties.T @ moments.torque)
        rows = self.rows.changes(solution.at, step * self._every, moments)
        rows *= self.rows.narrowed(self._look)[:, :, None]
        passed = np.zeros((len(rows), 3 * len(self._goals), self._count))
        if len(self._goals):
            _, gain, steps = self._passed(solution.motion)
            dq = by.states[steps, : robot.n]
            passed[0] = np.einsum('wn,wnp->wp', gain, np.repeat(dq, 3, axis=0))
        return np.concatenate([rows, passed], axis=1).reshape(-1, self._count)

    def motion(self, found: TimedRest) -> RestMotion:
        """Return a motion that was found."""
        shares, states = self.shares, found.motion
        if self._by_torque:
            step, parts = found.duration / self.count, np.arange(FINER) / FINER
            inner = np.stack([self.swings[0].after(part * step, states) for part in parts], axis=1)
            shares = np.linspace(0.0, 1.0, FINER * self.count + 1)
            q, qd = (
                np.ascontiguousarray(np.vstack([rows.reshape(-1, self.robot.n), last[-1]]))
                for rows, last in zip(np.split(inner, 2, axis=2), states[:2], strict=True)
            )
            states = Driven(q, qd, np.repeat(states.between, FINER, axis=0))
            places = [(self.basis.design(shares), self.basis.fixed(*self._ends, shares))]
            qdd = self._moments(found.coefficients, q, qd, places).qdd
            joints = self.robot.joint_indices[self.driven.places]
            spline = _spline_of(
                shares * found.duration, qd[:, joints], qdd[:, joints], *self.postures
            )
        else:
            shaped = self.shaped(found.coefficients)
            spline = self.basis.spline(shaped, *self.postures, found.duration)
        return RestMotion(
            found.duration,
            shares * found.duration,
            states,
            self.left(found),
            self.basis.rows,
            spline,
            self.driven,
        )

    def look(self, found: TimedRest) -> tuple[Array, Array]:
        """Return the ends of all steps, as shares (k,) of the duration, and the limits' there."""
        duration = found.duration
        at = self._at_steps(found)
        return self.shares, self.rows.shares(at, duration / self.count)

    def _at_steps(self, found: TimedRest) -> Moments:
        """Return a motion at the ends of its steps."""
        return self._moments(found.coefficients, found.motion.q, found.motion.qd, self._at_ends)

    def plan(self, found: TimedRest) -> Plan:
        """Return the plan of a motion, in finer steps."""
        return self.to_plan(self.motion(found))

    def places(self, plan: Plan) -> Array:
        """Return the places along the motion (k,), 0 to 1, of a plan's rows."""
        return np.asarray((plan.t - plan.t[0]) / (plan.t[-1] - plan.t[0]))


def _spline_of(t: Array, qd: Array, qdd: Array, start: Array, end: Array) -> PPoly:
    """Return the spline of joints from rates and accelerations (k, joints) at times.

    What these miss of the end at rest is spread over the motion.
    """
    share, T = (t / t[-1])[:, None], t[-1]
    smooth, slope = (
        share**3 * (10.0 - 15.0 * share + 6.0 * share**2),
        share**2 * (1.0 - share) ** 2,
    )
    qd, qdd = qd - smooth * qd[-1], qdd - 30.0 * slope / T * qd[-1]
    qdd[-1] = 0.0
    bend = share * (1.0 - share) * (1.0 - 2.0 * share)
    for _ in range(3):
        spline = CubicHermiteSpline(t, qd, qdd).antiderivative()
        off = 30.0 * (end - start - spline(T)) / T
        qd, qdd = qd + slope * off, qdd + 2.0 * bend / T * off
    spline.c[-1] += start
    return spline


def _nearest(squares: Array) -> IntArray:
    """Return at which rows the w places are passed, by squares of distances (k, w).

    In their order, with the least sum.
    """
    sums = squares[:, 0]
    below = []  # for each row the best one at or before it
    for column in squares.T[1:]:
        least = np.minimum.accumulate(sums)
        below.append(np.maximum.accumulate(np.where(sums <= least, np.arange(len(sums)), 0)))
        sums = column + least
    rows = [int(sums.argmin())]
    for before in below[::-1]:
        rows.append(int(before[rows[-1]]))
    return np.array(rows[::-1])
