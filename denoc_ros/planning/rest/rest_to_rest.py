"""Joint motions between two postures that end with every mode at rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics.driven.driven_joints import DrivenJoints
from denoc_ros.dynamics.driven.joint_limits import JointLimits, joint_limits
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.planning.rest.end_swing import free_motion
from denoc_ros.planning.rest.rest_problem import (
    STANDS,
    RestBasis,
    RestMotion,
    RestProblem,
    TimedRest,
    Waypoints,
)
from denoc_ros.planning.shapers.ringing import ringing_modes
from denoc_ros.planning.timing.limit_rows import LimitRows, Moments, PlanLimits
from denoc_ros.planning.timing.minimum_time import (
    NEAR,
    Found,
    checked_plan,
    excess,
    kept,
    program,
    shortest,
)
from denoc_ros.planning.tip.tip_minimum_time import PACED, require_rest
from denoc_ros.planning.tip.tip_solver import CancelledError
from denoc_ros.types import Array

SEGMENTS = (16, 60)  # of the splines, at least and at most
SEGMENTS_PER_PERIOD = 3.0  # of the fastest mode that is to rest
LEAST_FINE = 40  # coefficients of a joint in minimum time, at least
UNKNOWNS = 240  # of all splines there, at least; a joint has 120 at most
FINEST = 120
SMOOTH = {'acceleration', 'jerk', 'tip_acceleration'}  # limits that take accelerations as unknowns
JUMPING = {'position', 'velocity', 'acceleration', 'effort'}  # and where these may jump
RESOLVED = 0.8  # segments in a period of the fastest mode, where accelerations may jump
LOST = 1.03  # times the rough search's duration where torques do not shorten it
PERIODS, GROWTH = 200.0, 6.0  # of free modes and of a fall, in a motion by torques
ROUNDS = 30  # of the smoothest motion
DURATIONS, LEAST, HOLD = 40, 15, 16  # that are tried, at least, and more where they stay
LATELY, STILL = 8, 4e-3  # durations that differ by such a share: they save little more
LITTLE, AWHILE = 5e-4, 4  # share by which a duration is longer that stays, and steps in it
FAR, NARROW = 1.0, 0.01  # share beyond limits where no search ends, and the least radius
POWER, POWERS = 2.0, (0.5, 4.0)  # of the duration with which the share that is needed falls
APART, BESIDE = 0.01, 0.04  # shares of a duration: two say with which power, or are one problem
LEAP = 1.6  # times a duration that the next one is, at most
RADIUS, NEARER = 1.0, 0.5  # of programs, and what shrinks it
RADIUS_OF_TIGHTER = 0.1  # where a motion is known that keeps nearly the same limits
FASTER, SLOWER = 0.2, 0.6  # shares to which an excess falls where it grows, or else shrinks
LESS, BOLD = 0.996, 0.3  # share of the limits that saves time, and excess at which it grows
CLOSE, ROUGH = (3e-4, NEAR), (1e-2, 0.05)  # where a search ends: steps in time, shares beyond
GUESSES = 12  # of a duration in which a motion keeps its limits
STRETCHES, STRETCH = 30, 1.2  # of the plain motion, where no other is found


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
        problem, found = self.found(duration, progress, stopped)
        if duration is not None:  # they are of the jerk
            found = replace(found, gains=np.zeros(len(found.gains)))
        problem.longer, problem.to_plan = True, to_plan
        search = shortest if problem.gentle else tightened
        try:
            return checked_plan(problem, found, self.rows, stopped, search)
        except CancelledError:
            raise
        except SolverError:
            if duration is not None:
                raise
            problem, found = self._stretched(found.solution.duration)
            problem.longer, problem.to_plan = True, to_plan
            return checked_plan(problem, found, self.rows, stopped, search)

    def found(
        self,
        duration: float | None,
        progress: Callable[[float], object],
        stopped: Callable[[], bool],
    ) -> tuple[RestProblem, Found[TimedRest]]:
        """Return the problem and the motion of a duration [s], or the shortest."""
        if duration is None:
            self._require_pace()
            return self._shortest(progress, stopped)
        self.rows.widen()
        problem = self._gentle(duration, self._basis(duration))
        start = problem.plain(duration)
        if np.abs(self.postures[1] - self.postures[0]).max() <= STANDS and self.waypoints is None:
            gains = np.zeros(len(problem.names))
            return problem, Found(problem.run(start), start, gains, 0, True)
        least = _least(self.postures, self.limits.joints.of(self.driven.places))
        if duration <= least:
            raise problem.failure(
                duration,
                'the limits of velocity, acceleration and jerk leave no motion; these limits '
                f'take {least:.4g} s at least',
            )
        smooth, keeps = self._smoothest(problem, start, progress, stopped)
        if smooth is not None and keeps:
            return problem, smooth
        fast, found = self._shortest(progress, stopped)
        if found.solution.duration <= duration:  # the joints may wait
            waits = self._gentle(duration, fast.basis)
            start = waits.lasting(found.coefficients, duration)
            other, keeps = self._smoothest(waits, start, progress, stopped)
            if other is not None and (keeps or smooth is None):
                return waits, other
        if smooth is not None:
            return problem, smooth
        raise problem.failure(
            duration,
            f'the shortest motion that was found takes {found.solution.duration:.4g} s',
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

    def _basis(self, duration: float) -> RestBasis:
        """Return smooth splines for a duration [s]."""
        last = self.driven.all(self.postures[1])
        fastest = float(ringing_modes(self.robots[0], last, self.modes).frequencies.max())
        wanted = int(np.ceil(SEGMENTS_PER_PERIOD * fastest * duration))
        return RestBasis(min(max(wanted, SEGMENTS[0]), SEGMENTS[1]))

    def _problem(
        self, basis: RestBasis, gentle: bool, torques: Array | None = None
    ) -> RestProblem:
        """Return the problem with splines of joints, or of torques of a size (driven,)."""
        limits = self.limits.joints.of(self.driven.places)
        scale = np.where(np.isfinite(limits.acceleration), limits.acceleration, 1.0)
        return RestProblem(
            self.robots if gentle else self.robots[:1],
            self.driven,
            self.postures,
            self.rows,
            basis,
            gentle,
            self.modes,
            scale if torques is None else torques,
            self.waypoints,
            self.check,
        )

    def _gentle(self, duration: float, basis: RestBasis) -> RestProblem:
        """Return the problem of the smoothest motion in a duration [s]."""
        problem = self._problem(basis, True)
        problem.refine(duration, 1)
        return problem

    def _smoothest(
        self,
        problem: RestProblem,
        first: Array,
        progress: Callable[[float], object],
        stopped: Callable[[], bool],
    ) -> tuple[Found[TimedRest] | None, bool]:
        """Return the smoothest motion in the duration of a problem, None where none is found.

        And whether it keeps the limits between the moments of the search.
        """
        found = None
        try:
            found = shortest(problem, first, progress, stopped, ROUNDS)
            return kept(problem, found, self.rows, problem.look, stopped), True
        except CancelledError:
            raise
        except SolverError:
            return found, False

    def _shortest(
        self, progress: Callable[[float], object], stopped: Callable[[], bool]
    ) -> tuple[RestProblem, Found[TimedRest]]:
        """Return the shortest motion, at worst the plain one as slow as it must be."""
        self.rows.widen()
        least = _least(self.postures, self.limits.joints.of(self.driven.places))
        try:
            problem, found = self._quickest(progress, stopped)
            return problem, kept(problem, found, self.rows, problem.look, stopped, tightened)
        except CancelledError:
            raise
        except SolverError:
            return self._stretched(least)

    def _quickest(
        self, progress: Callable[[float], object], stopped: Callable[[], bool]
    ) -> tuple[RestProblem, Found[TimedRest]]:
        """Search with few unknowns and coarse steps first, then with all."""
        joints = len(self.postures[0])
        segments = min(max(UNKNOWNS // joints, LEAST_FINE), FINEST) // 2
        rough = self._problem(RestBasis(segments, 3, 3), False)
        first = self._begin(rough)
        found = quickest(
            rough, first, lambda share: progress(0.4 * share), stopped, DURATIONS, ROUGH
        )
        steep = self._may_jump(found.solution.duration / segments)
        bases = [RestBasis(segments if steep else 2 * segments, 3, 3, steep)]
        if self._by_torque(found.solution.duration):
            bases.insert(0, RestBasis(2 * segments, 1, 1, 'effort_rate' not in self._limited))
        effort = self.limits.joints.of(self.driven.places).effort
        needed = np.minimum(effort, np.abs(found.solution.at.torque).max(axis=0))
        best: tuple[RestProblem, Found[TimedRest]] | None = None
        for basis in bases:
            problem = self._problem(basis, False, needed if basis.by_torque else None)
            problem.refine(found.solution.duration, 1)
            start = problem.near(rough, found.coefficients)
            try:
                fine = quickest(
                    problem,
                    start,
                    lambda share: progress(0.4 + 0.6 * share),
                    stopped,
                    DURATIONS,
                    longest=LOST * found.solution.duration if basis.by_torque else np.inf,
                )
            except CancelledError:
                raise
            except SolverError as error:
                failure = error
                continue
            if best is None or fine.solution.duration < best[1].solution.duration:
                best = problem, fine
            if fine.solution.duration <= found.solution.duration:
                break  # else the search was lost in the fast modes that torques excite
        if best is None:
            raise failure
        return best

    def _stretched(self, seconds: float) -> tuple[RestProblem, Found[TimedRest]]:
        """Return the plain motion at rest, so much slower than a duration [s] as it must be."""
        self.rows.widen()
        for _ in range(STRETCHES):
            problem = self._gentle(seconds, self._basis(seconds))
            x, longer = problem.plain(seconds), STRETCH
            with suppress(SolverError):
                there = problem.solve(x, None)
                most = max(excess(there), float(np.abs(problem.look(there)[1]).max()) - 1.0)
                if most <= NEAR:
                    gains = np.zeros(len(problem.names))
                    return problem, Found(there, there.coefficients, gains, 0, False)
                longer = float(np.clip(1.01 * np.sqrt(1.0 + most), 1.02, 2.0))
            seconds *= longer
        raise problem.failure(seconds, 'the limits are passed')

    @property
    def _limited(self) -> set[str]:
        """The quantities that have limits."""
        return {name.split()[0] for name in self.rows.names}

    def _by_torque(self, duration: float) -> bool:
        """Say whether the shortest motion has net torques as its unknowns, else accelerations.

        Where each joint has a rotor's inertia and a limit of effort, and none of an acceleration
        or a jerk, steps can resolve all modes with free joints, and the robot falls little in the
        duration [s]. Joints without inertia of their own would swing with the fastest modes.
        """
        robot, effort = self.robots[0], self.limits.joints.of(self.driven.places).effort
        smooth = self._limited & SMOOTH or robot.constraint_names
        rotors = robot.armature[robot.joint_indices]
        if smooth or not (np.isfinite(effort).all() and rotors.all()):
            return False
        for posture in self.postures:
            fastest, growth = free_motion(robot, self.driven.all(posture))
            if fastest * duration > PERIODS or growth * duration > GROWTH:
                return False
        return True

    def _may_jump(self, segment: float) -> bool:
        """Say whether accelerations may jump between segments [s].

        Where only joints have limits, none of them on a jerk or an effort rate, and segments
        resolve the modes that it excites.
        """
        fastest, _ = free_motion(self.robots[0], self.driven.all(self.postures[1]))
        return self._limited <= JUMPING and RESOLVED * fastest * segment <= 1.0

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


def quickest(
    problem: RestProblem,
    start: Array,
    progress: Callable[[float], object],
    stopped: Callable[[], bool],
    durations: int,
    close: tuple[float, float] = CLOSE,
    longest: float = np.inf,
    radius: float = RADIUS,
) -> Found[TimedRest]:
    """Return the motion in the shortest duration that was found (see :func:`shortest`).

    In one duration after the other a program says how little of the limits is needed at least.
    That falls with a power of the duration, by which the next one is chosen. The last one is a
    share `close` from the one before, with that share beyond the limits. Where durations save
    little, steps in a slightly longer one bring the motion within the limits. A search that comes
    to a duration beyond the longest [s] is lost.
    """
    best: Found[TimedRest] | None = None
    here: TimedRest | None = None
    x, power, last, most = start, POWER, 0.0, 1.0
    tried: list[float] = []
    hold = 0.0
    for k in range(durations + HOLD):
        progress(1.0 - 0.85**k)
        ended = stopped()
        if best is not None and ended:
            return replace(best, settled=False)
        if best is not None and best.solution.duration <= hold:
            return best
        try:
            there = problem.solve(x, None if here is None else (here, x - here.coefficients))
        except CancelledError:
            raise
        except SolverError:
            if here is None:
                raise
            radius *= NEARER
        else:
            if here is not None and abs(np.log(there.duration / last)) <= BESIDE:
                saves = not hold and most < LESS and excess(there) <= BOLD
                if not saves and excess(there) > SLOWER * excess(here) + NEAR:
                    radius = max(radius * NEARER, NARROW)
                elif saves or (not hold and excess(there) <= FASTER * excess(here) + NEAR):
                    radius = min(radius / NEARER, RADIUS)
            here, jacobian = there, problem.jacobian(there)
        objective, c = problem.program(here), here.coefficients
        step = program(objective, here, jacobian, c, radius, problem.price)
        if step is None:  # the program's numbers were too far apart
            radius, last = radius * NEARER, here.duration
            if radius < NARROW:
                break
            continue
        x, _, gains, _ = step
        needed = float(np.abs(here.shares.ravel() + jacobian @ (x - c)).max())
        if last and abs(np.log(last / here.duration)) > APART:
            estimate = float(np.log(most / needed) / np.log(here.duration / last))
            power = estimate if POWERS[0] <= estimate <= POWERS[1] else power
        last, most = here.duration, needed
        if last > longest:
            raise problem.failure(last, 'the search does not shorten its motion')
        tried.append(last)
        longer = needed ** (1.0 / power)
        settled = abs(longer - 1.0) <= close[0] and excess(here) <= close[1]
        shorter = best is None or last < best.solution.duration
        if settled or (shorter and excess(here) <= NEAR):
            best = Found(here, c, gains / power, k + 1, not ended and (settled or hold > 0.0))
            if settled:
                return best
        durations = k if ended else durations
        if k + 1 >= min(durations, LEAST) and not hold:
            saves = durations > k and (
                excess(here) > FAR or np.ptp(np.log(tried[-LATELY:])) > STILL
            )
            if not saves and best is not None and best.solution.duration <= (1.0 + LITTLE) * last:
                return replace(best, settled=True)
            if not saves or k + 1 >= durations:
                hold = max(longer, 1.0) * (1.0 + LITTLE) * last
        if hold:  # steps in one duration bring the motion within its limits
            hold *= 1.0 if (k + 1) % AWHILE else 1.0 + LITTLE
            x = problem.lasting(x, hold)
            continue
        leap = radius / RADIUS
        x = problem.lasting(x, float(np.clip(longer, LEAP**-leap, LEAP**leap)) * last)
    if here is not None:
        here = _slowed(problem, here, power)
        if excess(here) <= NEAR and (best is None or here.duration < best.solution.duration):
            best = Found(here, here.coefficients, gains / power, durations, False)
    if best is None:
        raise problem.failure(last, 'the limits are passed')
    return best


def _slowed(problem: RestProblem, there: TimedRest, power: float) -> TimedRest:
    """Return a motion made slower until it keeps the limits, as far as that succeeds.

    What it needs of the limits falls with that power of its duration.
    """
    for _ in range(GUESSES):
        if excess(there) <= NEAR:
            break
        seconds = (1.0 + 1.1 * excess(there)) ** (1.0 / power) * there.duration
        try:
            x = problem.lasting(there.coefficients, seconds)
            there = problem.solve(x, (there, x - there.coefficients))
        except SolverError:
            break
    return there


def tightened(
    problem: RestProblem,
    start: Array,
    progress: Callable[[float], object],
    stopped: Callable[[], bool],
    _rounds: int,
) -> Found[TimedRest]:
    """Return a motion that keeps narrower limits in little more than the duration of another."""
    return quickest(problem, start, progress, stopped, 0, radius=RADIUS_OF_TIGHTER)


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
    problem, found = search.found(duration, lambda _share: None, lambda: False)
    return problem.motion(found.solution)


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
    rows = LimitRows(robot, robot.indices(driven.names), frames, limits, all_stations=True)
    rest = np.array([robot.static_deflection(driven.all(posture)) for posture in found])
    still = np.zeros_like(rest)
    torque = driven.torque(robot.inverse_dynamics(rest, still, still)[:, robot.joint_indices])
    require_rest(rows.row_names, rows.values(Moments(rest, still, still, torque), 1.0))
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
