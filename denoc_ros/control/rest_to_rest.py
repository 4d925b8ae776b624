"""Joint motions between two postures that end with every mode at rest."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.control.driven_joints import DrivenJoints
from denoc_ros.control.end_swing import Driven, EndSwing
from denoc_ros.control.joint_limits import JointLimits, joint_limits
from denoc_ros.control.least_distance import solve_bounded
from denoc_ros.control.rest_basis import RestBasis
from denoc_ros.control.ringing import ringing_modes
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.types import Array

SEGMENTS = (16, 60)  # of the spline, at least and at most
SEGMENTS_PER_PERIOD = 3.0  # of the fastest mode that is to rest
STEPS = 300  # of the simulated motion, at least
STEPS_PER_PERIOD = 60.0
PER_SEGMENT = 6  # moments at which limits hold
QUIET = 1e-3  # share of the plain motion's swing that counts as rest
STANDS = 1e-9  # rad, m: a way that is none
ROUNDS = 30
ENOUGH = 6  # rounds after which a motion that rests need not settle any more
STALLED = 8  # rounds without less swing or excess after which there is no motion
# how much of the way to the least cost a step is meant to go, and which share of it is gone
PARTS = (
    (1.0, 1.0), (1.0, 0.5), (0.3, 1.0), (0.3, 0.5), (0.1, 1.0), (0.03, 0.5),
    (0.0, 1.0), (0.0, 0.3),
)  # fmt: skip
RESTING = 6  # of them, the first that does not look for the least cost
DESCENT = 15  # rounds after which a motion only comes to rest
NEARER = 0.9  # of swing and excess: what counts as less
EXCESS = 1e4  # what effort beyond its limit costs, as a share of it, beside a jerk of 1
ROBUSTNESS = 1e3  # what a motion's swing with other frequencies costs, beside its jerk
GROWTH, CLOSE = 1.15, 1.02  # in the search for the shortest duration
LONGEST = 20.0  # times the least duration: where that search ends
LONGER = 4.0  # times the wanted duration: where the search for a longer one ends


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

    @property
    def ends(self) -> tuple[Array, Array]:
        """First and last posture of the driven joints."""
        return self.start, self.end

    def joints(self, times: ArrayLike, derivative: int = 0) -> Array:
        """Return the joints' motion (k, joints), or a derivative of it, held outside."""
        rows = self.basis.rows(self.coefficients, self.start, self.end, times, derivative)
        return self.driven.all(rows, derivative)


class _Point(NamedTuple):
    """Motions of all robots with some coefficients, and their residual vibration.

    Attributes
    ----------
    motions : list of Driven
    errors : list of (m,) arrays
        What rings at the end.
    torque : (k, driven) array
        Of the robot itself.
    """

    motions: list[Driven]
    errors: list[Array]
    torque: Array

    def left(self, size: float) -> float:
        """Residual vibration of the robot itself, as a share of a swing's size."""
        return float(np.linalg.norm(self.errors[0])) / max(size, 1e-12)


class _Problem:
    """The search for the coefficients of one duration, of the driven joints."""

    def __init__(
        self,
        robots: list[Robot],
        driven: DrivenJoints,
        postures: tuple[Array, Array],
        duration: float,
        limits: JointLimits,
        modes: int | None,
    ) -> None:
        self.robot, self.driven = robots[0], driven
        self.start, self.end = postures
        self.limits = limits
        first, last = driven.all(self.start), driven.all(self.end)
        fastest = float(ringing_modes(self.robot, last, modes).frequencies.max())
        wanted = int(np.ceil(SEGMENTS_PER_PERIOD * fastest * duration))
        segments = min(max(wanted, SEGMENTS[0]), SEGMENTS[1])
        self.basis = RestBasis(duration, segments)
        steps = max(STEPS, int(np.ceil(STEPS_PER_PERIOD * fastest * duration)))
        self.t = np.linspace(0.0, duration, steps + 1)
        middle = 0.5 * (self.t[1:] + self.t[:-1])
        position, velocity, acceleration = (self.basis.design(self.t, k) for k in range(3))
        self.designs = position, velocity, acceleration
        self._middle = self.basis.design(middle, 2), self.basis.ends(*postures, middle, 2)
        self._fixed = [self.basis.ends(*postures, self.t, order) for order in range(3)]
        step = duration / steps
        self.swings = [EndSwing(each, first, last, step, modes) for each in robots]
        self._count = self.basis.free * len(self.start)
        self._points = np.linspace(0.0, duration, PER_SEGMENT * segments + 1)[1:-1]
        self._bounds = self._limit_rows()
        self._hessian, self._drift, self._cost = self._least_jerk()

    def rows(self, x: Array, derivative: int) -> Array:
        """Return the driven joints (k, driven) of coefficients (count,) at the ends of steps."""
        moved = self.designs[derivative] @ self.shaped(x)
        return np.asarray(moved + self._fixed[derivative])

    def shaped(self, x: Array) -> Array:
        """Return coefficients (count,), joint by joint, as (free, driven)."""
        return np.asarray(x.reshape(len(self.start), -1).T)

    def run(self, x: Array, swing: EndSwing) -> Driven:
        """Return the motion of all coordinates."""
        design, fixed = self._middle
        between = self.driven.all(design @ self.shaped(x) + fixed, 2)
        q, qd = self.driven.all(self.rows(x, 0)), self.driven.all(self.rows(x, 1), 1)
        return swing.run(q, qd, between)

    def sensitivity(self, x: Array, motion: Driven, swing: EndSwing) -> tuple[Array, Array]:
        """Return how the swing's error (m, count) and torques (k, driven, count) change."""
        qdd = self.driven.all(self.rows(x, 2), 2)
        error, force = swing.sensitivity(motion, qdd, self.designs)
        torque = np.einsum('kjc,ji->kic', force, self.driven.ties)
        return self._by_driven(error), self._by_driven(torque)

    def _by_driven(self, rows: Array) -> Array:
        """Reduce a sensitivity from all joints to the driven ones."""
        whose = rows.reshape(*rows.shape[:-1], -1, self.basis.free)
        found = np.einsum('...jf,ji->...if', whose, self.driven.ties)
        return np.asarray(found.reshape(*rows.shape[:-1], -1))

    def torque(self, motion: Driven, qdd: Array) -> Array:
        """Return the driven joints' torques (k, driven) of accelerations (k, driven)."""
        force, _ = self.robot.hybrid_dynamics(motion.q, motion.qd, self.driven.all(qdd, 2))
        return self.driven.torque(force)

    def _least_jerk(self) -> tuple[Array, Array, Callable[[Array], float]]:
        """Return H, g and x -> cost: the mean square of the jerk, on the limits' scale."""
        duration, joints = self.basis.duration, len(self.start)
        times = np.linspace(0.0, duration, 8 * len(self._points))
        limit = self.limits.acceleration
        scale = duration / np.where(np.isfinite(limit), limit, 1.0)
        one = self.basis.design(times, 3) / np.sqrt(len(times))
        fixed = self.basis.ends(self.start, self.end, times, 3) / np.sqrt(len(times)) * scale
        design = np.kron(np.diag(scale), one)
        right = fixed.T.ravel()
        assert design.shape == (joints * len(times), self._count)
        return (
            design.T @ design,
            design.T @ right,
            lambda x: float(0.5 * np.sum((design @ x + right) ** 2)),
        )

    def _limit_rows(self) -> tuple[Array, Array]:
        """Return G, h of G x <= h for limits of positions and their derivatives."""
        joints, points = len(self.start), self._points
        limits = self.limits
        rows: list[Array] = [np.zeros((0, self._count))]
        most: list[Array] = [np.zeros(0)]
        columns = [(-limits.lower, limits.upper)]
        columns += [(each, each) for each in (limits.velocity, limits.acceleration, limits.jerk)]
        for order, (below, above) in enumerate(columns):
            design = self.basis.design(points, order)
            fixed = self.basis.ends(self.start, self.end, points, order)
            for sign, limit in ((1.0, above), (-1.0, below)):
                for j in np.flatnonzero(np.isfinite(limit)):
                    unit = np.zeros((1, joints))
                    unit[0, j] = sign
                    rows.append(np.asarray(np.kron(unit, design), dtype=np.float64))
                    most.append(np.asarray(limit[j] - sign * fixed[:, j]))
        return np.vstack(rows), np.concatenate(most)

    def _effort_rows(self, x: Array, torque: Array, gain: Array) -> tuple[Array, Array]:
        """Return G, h of G x <= h for torques that change by `gain` (k, driven, count)."""
        even = np.linspace(0, len(self.t) - 1, len(self._points) + 2).astype(int)[1:-1]
        at = np.unique(np.concatenate([even, torque.argmax(axis=0), torque.argmin(axis=0)]))
        torque = torque[at]
        rows, most = [np.zeros((0, self._count))], [np.zeros(0)]
        for j in np.flatnonzero(np.isfinite(self.limits.effort)):
            for sign in (1.0, -1.0):
                rows.append(sign * gain[at, j])
                most.append(self.limits.effort[j] - sign * (torque[:, j] - gain[at, j] @ x))
        return np.vstack(rows), np.concatenate(most)

    def plain(self) -> Array:
        """Return the coefficients (count,) of the least jerk within limits."""
        nothing = np.zeros((0, self._count)), np.zeros(0)
        scale = float(np.trace(self._hessian)) / self._count
        found = solve_bounded(self._hessian / scale, self._drift / scale, nothing, self._bounds)
        if found is None:
            raise self._failure('the limits of velocity, acceleration and jerk leave no motion')
        return found

    def _failure(self, why: str) -> SolverError:
        return SolverError(
            f'{self.robot.tree.name}: rest to rest in {self.basis.duration:.4g} s must be '
            f'possible, got none: {why}'
        )

    def near(self, motion: RestMotion) -> Array:
        """Return the coefficients (count,) of a motion of another duration, stretched to this."""
        shares = np.linspace(0.0, 1.0, 4 * self.basis.free + 2)[1:-1]
        wanted = motion.basis.rows(
            motion.coefficients, *motion.ends, shares * motion.duration
        ) - self.basis.ends(self.start, self.end, shares * self.basis.duration)
        design = self.basis.design(shares * self.basis.duration)
        return np.asarray(np.linalg.lstsq(design, wanted)[0].T.ravel())

    def solve(
        self, check: Callable[[], None], near: RestMotion | None = None
    ) -> tuple[Array, Driven, float]:
        """Return coefficients, motion and the share of the plain motion's swing that is left.

        The search begins at the plain motion, or at one of another duration.
        """
        x = self.plain()
        point = self._point(x)
        if np.abs(self.end - self.start).max(initial=0.0) <= STANDS:
            return x, point.motions[0], 0.0
        sizes = float(np.linalg.norm(point.errors[0])), max(self._cost(x), 1e-9)
        if near is not None:
            x = self.near(near)
            point = self._point(x)
        best, best_round, nearest, part = np.inf, 0, point, 0
        for round_ in range(ROUNDS):
            check()
            first = max(part - 1, 0) if round_ < DESCENT else RESTING
            found = self._nearer(x, point, sizes, first)
            if found is None:
                raise self._failure(
                    f'the limits but for effort leave {100.0 * point.left(sizes[0]):.3g} % of the '
                    'swing'
                )
            there, point, part = found
            moved = float(np.abs(there - x).max())
            x = there
            settled = len(self.swings) == 1 or moved < 1e-3 * np.ptp(x)
            left = point.left(sizes[0])
            if left <= QUIET and (settled or round_ >= ENOUGH) and self._kept(point):
                return x, point.motions[0], left
            off = self._off(point, sizes)
            if off < NEARER * best:
                best, best_round, nearest = off, round_, point
            elif part == len(PARTS) or round_ >= best_round + STALLED:
                break
        excess, left = self._excess(nearest), nearest.left(sizes[0])
        raise self._failure(
            f'the search ends where {100.0 * left:.3g} % of the swing is left and the effort is '
            f'{100.0 * excess:.3g} % beyond its limit'
        )

    def _point(self, x: Array) -> _Point:
        """Motions of all robots with coefficients (count,), and their residual vibration."""
        motions = [self.run(x, swing) for swing in self.swings]
        errors = [swing.error(motion) for swing, motion in zip(self.swings, motions, strict=True)]
        torque = self.torque(motions[0], self.rows(x, 2))
        return _Point(motions, errors, torque)

    def _excess(self, point: _Point) -> float:
        """Return by how much the torques exceed their limits, as a share of these."""
        with np.errstate(invalid='ignore'):
            share = float((np.abs(point.torque).max(axis=0) / self.limits.effort).max(initial=0.0))
        return max(share - 1.0, 0.0)

    def _off(self, point: _Point, sizes: tuple[float, float]) -> float:
        """Return how far a motion is from rest within its efforts."""
        found = max(point.left(sizes[0]), QUIET) + self._excess(point)
        return found if np.isfinite(found) else np.inf

    def _costs(self, x: Array, point: _Point, sizes: tuple[float, float]) -> float:
        """Return the jerk and the swing with other frequencies of a motion."""
        size, jerk = sizes
        rung = sum(float(error @ error) for error in point.errors[1:])
        return self._cost(x) / jerk + 0.5 * ROBUSTNESS / size**2 * rung

    def _nearer(
        self, x: Array, point: _Point, sizes: tuple[float, float], first: int
    ) -> tuple[Array, _Point, int] | None:
        """Return the point of a step that rests better or costs less, and which part it goes.

        One more than there are, where no part does; None: the limits leave no step.
        """
        off, cost = self._off(point, sizes), self._costs(x, point, sizes)
        step = self._linear(x, point, sizes)
        last = None
        for part in range(first, len(PARTS)):
            cheaper, share = PARTS[part]
            goal = step(cheaper)
            if goal is None:
                continue
            there = x + share * (goal - x)
            found = self._point(there)
            reached = self._off(found, sizes)
            is_cheaper = self._costs(there, found, sizes) <= cost or part >= RESTING
            if reached <= max(NEARER * off, 2.0 * QUIET) or (reached < off and is_cheaper):
                return there, found, part
            last = there, found, len(PARTS)
        return last

    def _linear(
        self, x: Array, point: _Point, sizes: tuple[float, float]
    ) -> Callable[[float], Array | None]:
        """Return the goal of the quadratic program about a point, by its part of the least cost.

        It is at rest to first order, None where the limits leave none.
        """
        size, jerk = sizes
        hessian, gradient = self._hessian / jerk, self._drift / jerk
        weight = ROBUSTNESS / size**2
        rows, torque = self.sensitivity(x, point.motions[0], self.swings[0])
        for k in range(1, len(self.swings)):
            others, _ = self.sensitivity(x, point.motions[k], self.swings[k])
            hessian = hessian + weight * others.T @ others
            gradient = gradient - weight * others.T @ (others @ x - point.errors[k])
        more = self._effort_rows(x, point.torque, torque)
        bounds = tuple(np.concatenate(pair) for pair in zip(self._bounds, more, strict=True))
        there = hessian @ x

        equality = rows, rows @ x - point.errors[0]

        @functools.cache
        def goal(cheaper: float) -> Array | None:
            drawn = cheaper * gradient - (1.0 - cheaper) * there
            found = solve_bounded(hessian, drawn, equality, (bounds[0], bounds[1]))
            if found is None and len(more[1]):
                found = self._exceeding(hessian, drawn, equality, more)
            return found

        return goal

    def _exceeding(
        self,
        hessian: Array,
        gradient: Array,
        equality: tuple[Array, Array],
        efforts: tuple[Array, Array],
    ) -> Array | None:
        """Return the coefficients whose efforts exceed their limits by the least share.

        One variable more, >= 0: the share by which all efforts may be beyond their limits.
        """
        count = len(gradient)
        wider = np.zeros((count + 1, count + 1))
        wider[:count, :count] = hessian
        wider[count, count] = EXCESS
        first = np.append(gradient, EXCESS)
        rows, right = np.pad(equality[0], ((0, 0), (0, 1))), equality[1]
        gains, room = efforts
        limit = np.repeat(self.limits.effort[np.isfinite(self.limits.effort)], 2)
        each = np.repeat(limit, len(room) // len(limit))
        inside = np.hstack([gains, -each[:, None]])
        positive = np.zeros((1, count + 1))
        positive[0, -1] = -1.0
        bounds = (
            np.vstack([np.pad(self._bounds[0], ((0, 0), (0, 1))), inside, positive]),
            np.concatenate([self._bounds[1], room, [0.0]]),
        )
        # costs on the scale that the quadratic program is solved on
        found = solve_bounded(wider / EXCESS, first / EXCESS, (rows, right), bounds)
        return None if found is None else found[:count]

    def _kept(self, point: _Point) -> bool:
        """Say whether the torques keep their limits, to five thousandths."""
        return self._excess(point) <= 0.005


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

    Of all such motions it has the least mean square jerk. It begins and ends in static
    equilibrium, with no velocity, acceleration and jerk.

    Parameters
    ----------
    robot : Robot
        With the payload it carries, without loops.
    start, end : (joints,) arrays
        Postures [rad, m]; mimic joints follow their leaders.
    duration : float, optional
        s; default the shortest within the limits, to 2 %.
    limits : JointLimits, optional
        Default those of the URDF.
    modes : int, optional
        How many modes rest, from the lowest; default those below ten times the lowest.
    robustness : float
        Share by which the modes' frequencies may be off: the swing of robots that are so much
        stiffer and softer is weighed against the jerk.
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
    The joints are quintic splines. Newton's method on the nonlinear dynamics: each round simulates
    the motion, takes the derivatives of what rings at its end and of the torques by the
    linearization along it, and solves a quadratic program for the coefficients.
    """
    robot = robot.copy()
    driven = DrivenJoints(robot, 'rest to rest')
    limits = joint_limits(robot) if limits is None else limits
    postures = _checked(robot, driven, start, end, limits)
    limits = limits.of(driven.places)
    if not 0.0 <= robustness < 1.0:
        raise StateError(f'rest to rest: robustness must be >= 0 and < 1, got {robustness}')
    _require_holding(robot, driven, postures, limits)
    robots = [robot, *(_stiffer(robot, s) for s in (-robustness, robustness) if robustness)]

    def attempt(seconds: float, near: RestMotion | None = None) -> RestMotion:
        problem = _Problem(robots, driven, postures, seconds, limits, modes)
        x, states, left = problem.solve(check, near)
        return RestMotion(
            seconds, problem.t, states, left, problem.basis, problem.shaped(x), *postures, driven
        )

    if duration is None:
        return _shortest(attempt, _least_duration(robot, postures, limits))
    if not (np.isfinite(duration) and duration > 0.0):
        raise StateError(f'rest to rest: duration must be > 0 s, got {duration}')
    return _in_time(attempt, float(duration), _least(postures, limits))


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


def _stiffer(robot: Robot, share: float) -> Robot:
    """Return the robot with all beams' frequencies higher by a share."""
    changes = {}
    for body in robot.tree.bodies:
        if body.modes is not None:
            factor = body.modes.factor * (1.0 + share) ** 2
            changes[f'flexible.{body.name}.stiffness'] = factor
        if body.beam is None or body.segment > 1:
            continue
        for part, path in (('y', 'y.ei'), ('z', 'z.ei'), ('torsion', 'torsion.gj')):
            deformation = getattr(body.beam, part)
            if deformation is not None and deformation.modes:
                stiffness = deformation.stiffness * (1.0 + share) ** 2
                changes[f'beam.{body.name}.{path}'] = stiffness
    return robot.with_overrides(changes)


def _least(postures: tuple[Array, Array], limits: JointLimits) -> float:
    """Return the duration [s] below which the joints' limits but for effort cannot be kept."""
    way = np.abs(postures[1] - postures[0])
    least = np.maximum(way / limits.velocity, 2.0 * np.sqrt(way / limits.acceleration))
    least = np.maximum(least, np.cbrt(32.0 * way / limits.jerk))
    return float(least.max(initial=0.0))


def _least_duration(robot: Robot, postures: tuple[Array, Array], limits: JointLimits) -> float:
    """Return a duration [s] > 0 below which the joints cannot do it."""
    if not (found := _least(postures, limits)) > 0.0:
        raise StateError(
            f'{robot.tree.name}: the shortest motion needs a way to go and limits of velocity or '
            'acceleration, got none; give a duration'
        )
    return found


Attempt = Callable[..., RestMotion]


def _in_time(attempt: Attempt, seconds: float, least: float) -> RestMotion:
    """Return the motion of a duration; where it is not found at once, from longer ones.

    Raises
    ------
    SolverError
        There is none; the message has the shortest duration that one was found of.
    """
    try:
        return attempt(seconds)
    except SolverError as error:
        first = error
    if least > LONGER * seconds:
        raise SolverError(f'{first}; these limits take {least:.4g} s at least') from first
    found: RestMotion | None = None
    growth, tried = GROWTH, max(seconds, least)
    while found is None and growth * tried <= LONGER * max(seconds, least):
        tried *= growth
        growth **= 1.5
        try:
            found = attempt(tried)
        except SolverError:
            continue
    if found is None:
        raise SolverError(f'{first}; none was found up to {tried:.4g} s') from first
    found = _towards(attempt, found, max(seconds, least))
    motion = _nearby(attempt, seconds, found) if seconds >= least else None
    if motion is None:
        raise SolverError(
            f'{first}; the shortest motion that was found takes {found.duration:.4g} s'
        ) from first
    return motion


def _towards(attempt: Attempt, found: RestMotion, below: float) -> RestMotion:
    """Return the motion of the shortest duration above one that has none, to `CLOSE`."""
    while found.duration > CLOSE * below:
        middle = float(np.sqrt(found.duration * below))
        motion = _nearby(attempt, middle, found)
        if motion is None:
            below = middle
        else:
            found = motion
    return found


def _nearby(attempt: Attempt, seconds: float, near: RestMotion) -> RestMotion | None:
    """Return the motion of a duration, by one of another duration; None: there is none."""
    for start in (near, None):
        try:
            return attempt(seconds, start)
        except SolverError:
            continue
    return None


def _shortest(attempt: Attempt, least: float) -> RestMotion:
    """Return the motion of the shortest duration that has one, to `CLOSE`."""
    below, above = least, least
    found: RestMotion | None = None
    while found is None:
        try:
            found = attempt(above)
        except SolverError:
            below, above = above, GROWTH * above
            if above > LONGEST * least:
                raise
    return _towards(attempt, found, below)
