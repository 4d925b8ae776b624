"""Motion that identifies the free numbers of a robot best, and the accuracy to expect of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linprog

from denoc_ros.dynamics.base.floating_base import require_known_base
from denoc_ros.dynamics.driven.joint_limits import Given, JointLimits, joint_limits
from denoc_ros.dynamics.driven.measured_side import measured_robot
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError, SolverError
from denoc_ros.identification.model.excited_channels import (
    FEWEST_HARMONICS,
    WHERE,
    ExcitedChannels,
    MotionRows,
    PrescribedRobot,
    RestSeries,
    channel_noise,
    waves,
)
from denoc_ros.identification.model.free_parameters import PRIOR, FreeParameters
from denoc_ros.identification.model.information import (
    Information,
    combinations,
    in_directions,
    information,
    interval_ends,
    left_beside_noise,
    verdict_of,
)
from denoc_ros.identification.model.motion_space import (
    FULL,
    Extreme,
    MotionLimits,
    MotionSpace,
    deflection_limits,
)
from denoc_ros.model.beams.segments import whole_beams
from denoc_ros.types import Array

DRAWN = 16  # motions at random, the best of which the search starts from
FEWEST_DRAWN = 3  # of them, whatever the time
STARTS = 2  # of the search, as far as time allows
ITERATIONS = 60
STEP = 1e-4  # of the differences by x
SETTLED = 3e-3  # what a step must gain: 0.3 % of the intervals
WIDEST, NARROWEST = 0.3, 3e-3  # of the largest x: radius of a step
WIDER, NARROWER = 1.5, 0.4
NEAR_SHARE = 0.5  # shares of limits that a step looks at
REGROWN = 1.3  # by how much a step may be scaled up to the limits
NOTHING = 1e3  # the criterion of a motion that the robot cannot follow
DEFLECTION = 0.1  # of its length, that a link may bend by: the model's tip is 0.1 % off there
SEARCH_STEP, FINE_STEP = 0.04, 0.0025  # s
SHOWN_BY = 8  # of the motions tried, that what no motion shows is worked out along
NEVER = 1e-9  # of the information of the best seen direction: rounding of differences leaves more


class _TimeIsOverError(Exception):
    """The search has taken as long as it may."""


@dataclass
class SearchClock:
    """Time limit of a search, and reports of its progress.

    Processor time: on a busy machine a search takes longer and comes as far.
    """

    limit: float
    report: Callable[[float], None]
    began: float = field(default_factory=time.process_time)

    @property
    def elapsed(self) -> float:
        """Processor time since the begin [s]."""
        return time.process_time() - self.began

    def check(self) -> None:
        """Tell the share of the time that is over; raise when it is all of it."""
        self.report(min(self.elapsed / self.limit, 1.0))
        if self.elapsed > self.limit:
            raise _TimeIsOverError


def random_motions(space: MotionSpace, times: Array, seed: int, clock: SearchClock) -> list[Array]:
    """Return motions drawn at random, all at their limits; fewer when half the time is over."""
    draw, found = np.random.default_rng(seed), list[Array]()
    while len(found) < DRAWN:
        found.append(space.to_limits(draw.normal(size=space.size), times))
        if len(found) >= FEWEST_DRAWN and clock.elapsed > 0.5 * clock.limit:
            break
    return found


class ExcitationSearch:
    """D-optimal motions: the determinant of the information and of a prior is the largest.

    Parameters
    ----------
    times : (k,) array
        At which motions are worked out.
    """

    def __init__(self, space: MotionSpace, channels: ExcitedChannels, times: Array) -> None:
        self._space, self._channels, self._times = space, channels, times

    def criterion(self, x: Array) -> float:
        """Return how little is known after a motion: mean logarithm of the intervals, shifted.

        -log det(H + prior) / (2 p), so that a change by -0.01 is 1 % of the intervals.
        """
        try:
            jacobian = self._channels.jacobian(self._space.rows(x, self._times))
        except SolverError:  # bent beyond what a model of small deflections has
            return NOTHING
        size = jacobian.shape[1]
        whole = jacobian.T @ jacobian + np.eye(size) / PRIOR**2
        return float(-np.linalg.slogdet(whole)[1] / (2 * size))

    def best(self, motions: list[Array], clock: SearchClock) -> tuple[Array, float]:
        """Return the best motion found from given ones within the time, and its criterion."""
        order = sorted((self.criterion(x), k) for k, x in enumerate(motions))
        least, place = order[0]
        best = motions[place]
        for value, k in order[:STARTS]:
            try:
                for found, reached in self._improving(motions[k], value, clock):
                    if reached < least:
                        best, least = found, reached
            except _TimeIsOverError:
                break
        return best, least

    def _improving(
        self, x: Array, value: float, clock: SearchClock
    ) -> Iterator[tuple[Array, float]]:
        """Yield ever better motions and their criteria: linear programs within a radius.

        Each keeps the limits: what a step takes too much is scaled back.
        """
        radius = WIDEST * float(np.abs(x).max())
        for _ in range(ITERATIONS):
            slopes, shares, edges = self._slopes(x, value, clock)
            gained = 0.0
            while gained < SETTLED and radius > NARROWEST * float(np.abs(x).max()):
                clock.check()
                step = _linear_step(slopes, shares, edges, radius)
                trial = self._space.to_limits(x + step, self._times, REGROWN)
                gained = value - self.criterion(trial)
                radius *= WIDER if gained >= SETTLED else NARROWER
            if gained < SETTLED:
                return
            x, value = trial, value - gained
            yield x, value

    def _slopes(self, x: Array, value: float, clock: SearchClock) -> tuple[Array, Array, Array]:
        """Return the derivatives of the criterion (x,), the shares (m,) that matter and theirs.

        Shares of limits near or beyond which the motion is at some time, all to one side.
        """
        shares = self._space.shares(x, self._times).ravel()
        near = np.flatnonzero(np.abs(shares) > NEAR_SHARE)
        side = np.sign(shares[near])
        slopes, edges = np.empty(len(x)), np.empty((len(near), len(x)))
        for k in range(len(x)):
            clock.check()
            moved = x.copy()
            moved[k] += STEP
            slopes[k] = (self.criterion(moved) - value) / STEP
            after = self._space.shares(moved, self._times).ravel()[near]
            edges[:, k] = side * (after - shares[near]) / STEP
        return slopes, np.abs(shares[near]), edges


def _linear_step(slopes: Array, shares: Array, edges: Array, radius: float) -> Array:
    """Return the step (x,) within a radius that lowers the criterion most, limits kept."""
    room = np.maximum(FULL - shares, 0.0)
    found = linprog(slopes, A_ub=edges, b_ub=room, bounds=[(-radius, radius)] * len(slopes))
    return np.asarray(found.x, dtype=np.float64)


@dataclass(frozen=True)
class Excitation:
    """Identifying motion, and the expected accuracy of the numbers from its recording.

    Attributes
    ----------
    joints : tuple of str
        Order of all columns: the driven joints.
    duration : float
        s.
    start : (joints,) array
        Where the motion begins and ends, at rest [rad, m].
    sines, cosines : (harmonics, joints) arrays
        s_k and c_k of q = start + sum s_k sin(k w t) + c_k (cos(k w t) - 1), w = 2 pi / duration.
    values, interval, verdict, combinations
        As of :class:`IdentifiedModel`: what to expect, at the robot's numbers.
    never : list of str
        What none of the motions tried shows, whatever the noise; combinations that are seen.
    seen : int
        How many independent combinations of the numbers the motions tried show.
    noise : dict of str to float
        Of one sample of each channel.
    rate : float
        Of recording [Hz].
    extremes : tuple of Extreme
        What the motion has of what is limited.
    gain : float
        Mean factor by which intervals are shorter than after the best of the motions drawn.
    seconds : float
    evaluations : int
        Of the model along a motion.
    """

    joints: tuple[str, ...]
    duration: float
    start: Array
    sines: Array
    cosines: Array
    values: dict[str, float]
    interval: dict[str, tuple[float, float]]
    verdict: dict[str, str]
    combinations: list[str]
    never: list[str]
    seen: int
    noise: dict[str, float]
    rate: float
    extremes: tuple[Extreme, ...]
    gain: float
    seconds: float
    evaluations: int

    def rows(self, times: ArrayLike) -> MotionRows:
        """Return the motion of the joints at times (k,) [s]; it rests outside of its duration."""
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        inside, harmonics = np.clip(t, 0.0, self.duration), len(self.sines)
        both = np.vstack([self.sines, self.cosines])
        q, qd, qdd = (waves(inside, self.duration, harmonics, k) @ both for k in range(3))
        return MotionRows(t, self.start + q, qd, qdd)


def design_excitation(
    robot: Robot,
    free: Sequence[str],
    *,
    duration: float = 10.0,
    harmonics: int = 6,
    start: Mapping[str, float] | None = None,
    position: Mapping[str, tuple[float, float]] | None = None,
    velocity: Given | None = None,
    acceleration: Given | None = None,
    effort: Given | None = None,
    deflection: Mapping[str, float] | None = None,
    noise: Mapping[str, float] | None = None,
    rate: float = 200.0,
    time_limit: float = 60.0,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Excitation:
    """Return the motion within limits whose recording identifies free numbers best.

    Parameters
    ----------
    robot : Robot
        The best guess of its numbers; with its gravity and payload as they are set.
    free : sequence of str
        Dotted paths with `*`, as of :func:`identify_model`.
    duration : float
        Of the motion [s].
    harmonics : int
        Of the Fourier series of each joint, at least 3: the highest frequency is
        harmonics / duration.
    start : dict of str to float, optional
        Where joints begin and end [rad, m]; default 0, or the middle of a range without 0.
    position : dict of str to (float, float), optional
        Ranges of joints [rad, m] within the URDF's. A joint without one has pi to either side.
    velocity, acceleration, effort : optional
        Limits as of :func:`joint_limits`; default the URDF's.
    deflection : dict of str to float, optional
        By flexible link, how far its tip may bend across its axis [m]; default a tenth of its
        length.
    noise : dict of str to float, optional
        Standard deviation of one sample: `effort` or `effort.<joint>` [N m, N], `<sensor>` in the
        unit of its value; infinite: not recorded. Default: of effort 1 % of its limit (without
        one, 2 % of the largest torque tried), of sensors the URDF's.
    rate : float
        Of recording [Hz].
    time_limit : float
        Of the search [s of processor time]: the best motion until then counts.
    seed : int
        Of the motions drawn that it starts from.
    progress : callable, optional
        Receives the share of the time limit that is over.

    Raises
    ------
    ConfigError
        A path, joint, link or channel that is none; a limit or number that cannot be.
    StateError
        A limit that is not > 0; a base that floats.

    Notes
    -----
    D-optimal: the determinant of the Fisher information of theta and of its prior is largest.
    """
    robot = measured_robot(robot.with_modelled_payloads())
    require_known_base(robot, WHERE)
    _require(robot, duration, harmonics, rate, time_limit)
    clock = SearchClock(time_limit, progress or (lambda share: None))
    began = time.perf_counter()
    along = PrescribedRobot(robot)
    joints = joint_limits(robot, velocity, acceleration, None, effort)
    lengths = {beam.link: beam.length for beam in whole_beams(robot.tree)}
    limits = MotionLimits(
        _narrowed(robot, joints, position or {}),
        deflection_limits(along, lengths, DEFLECTION, deflection or {}),
    )
    begin = _start(along, limits.joints, start or {})
    by_joint = dict(zip(along.every_joint, limits.joints.effort.tolist(), strict=True))
    deviations = noise or {}
    # what is given wrong is told before anything is worked out
    channel_noise(robot, along.joints, deviations, by_joint, dict.fromkeys(along.joints, 1.0))
    FreeParameters(robot, free)
    space = MotionSpace(along, RestSeries(duration, harmonics), begin, limits)
    times = space.times(SEARCH_STEP)
    drawn = random_motions(space, times, seed, clock)
    tried = [along.response(space.rows(x, times)).effort for x in drawn]
    largest = dict(zip(along.joints, np.abs(np.vstack(tried)).max(axis=0).tolist(), strict=True))
    parameters = FreeParameters(robot, free, {k: v for k, v in largest.items() if v > 0.0})
    own = channel_noise(robot, along.joints, deviations, by_joint, largest)
    channels = ExcitedChannels(along, parameters, own, rate)
    search = ExcitationSearch(space, channels, times)
    before = min(search.criterion(x) for x in drawn)
    best, _ = search.best(drawn, clock)
    fine = space.times(FINE_STEP)
    best = space.to_limits(best, fine, 1.0)
    gain = float(np.exp(before - search.criterion(best)))
    never, seen = _never_seen(channels, [space.rows(x, times) for x in (best, *drawn)[:SHOWN_BY]])
    return _concluded(
        channels, space, best, fine, (never, seen, gain, time.perf_counter() - began)
    )


def _require(
    robot: Robot, duration: float, harmonics: int, rate: float, time_limit: float
) -> None:
    findings = [
        f'{name} must be > 0 {unit}, got {value}'
        for name, value, unit in (
            ('duration', duration, 's'), ('rate', rate, 'Hz'), ('time_limit', time_limit, 's')
        )
        if not 0.0 < value < np.inf
    ]  # fmt: skip
    if harmonics < FEWEST_HARMONICS:
        findings.append(f'harmonics must be at least {FEWEST_HARMONICS}, got {harmonics}')
    if robot.tree.loops:
        loops = ', '.join(loop.name for loop in robot.tree.loops)
        findings.append(f'the robot must have no loops, got {loops}')
    if not robot.joint_names:
        findings.append('the robot must have joints, got none')
    ConfigError.raise_any(WHERE, findings)


def _narrowed(
    robot: Robot, limits: JointLimits, ranges: Mapping[str, tuple[float, float]]
) -> JointLimits:
    lower, upper = limits.lower.copy(), limits.upper.copy()
    names, findings = list(robot.joint_names), []
    for name, (low, high) in ranges.items():
        if name not in names:
            findings.append(f'position must be of joints of {", ".join(names)}, got {name!r}')
            continue
        k = names.index(name)
        if not (low < high and lower[k] <= low and high <= upper[k]):
            findings.append(
                f'position of {name} must be a range within {lower[k]:.6g} to {upper[k]:.6g}, '
                f'got {low} to {high}'
            )
        lower[k], upper[k] = low, high
    ConfigError.raise_any(WHERE, findings)
    return replace(limits, lower=lower, upper=upper)


def _start(along: PrescribedRobot, limits: JointLimits, given: Mapping[str, float]) -> Array:
    findings = [
        f'start must be of joints of {", ".join(along.joints)}, got {name!r}'
        for name in given
        if name not in along.joints
    ]
    found = np.zeros(len(along.joints))
    for k, name in enumerate(along.joints):
        place = along.every_joint.index(name)
        low, high = float(limits.lower[place]), float(limits.upper[place])
        found[k] = given.get(name, 0.0 if low < 0.0 < high else 0.5 * (low + high))
        if not low < found[k] < high:
            findings.append(
                f'start of {name} must be within {low:.6g} to {high:.6g}, got {found[k]}'
            )
    ConfigError.raise_any(WHERE, findings)
    return found


def _in_sizes(channels: ExcitedChannels, rows: MotionRows) -> Array:
    """Return the derivatives of all channels by the reported numbers, in sizes of theirs."""
    parameters = channels.parameters
    zero = np.zeros(parameters.size)
    by_numbers = channels.jacobian(rows, both=True) @ np.linalg.inv(parameters.slopes(zero))
    return np.asarray(by_numbers * parameters.scales(zero))


def _never_seen(channels: ExcitedChannels, motions: Sequence[MotionRows]) -> tuple[list[str], int]:
    """Parameters that no motion shows, and the number of combinations that the motions show.

    The rank is that of all motions together, each number in the unit in which it is seen best.
    """
    parameters = channels.parameters
    whole = np.zeros((parameters.size, parameters.size))
    for rows in motions:
        jacobian = _in_sizes(channels, rows)
        whole += jacobian.T @ jacobian
    values, vectors = np.linalg.eigh(whole)
    seen = values > NEVER * max(float(values[-1]), 1e-300)
    unseen = vectors[:, ~seen]
    half = np.where(in_directions(unseen), np.inf, 0.0)
    blind = Information(half, unseen, np.zeros_like(whole))
    lines = combinations(blind, parameters.paths, parameters.multiplicative)
    return lines, int(seen.sum())


def _concluded(
    channels: ExcitedChannels,
    space: MotionSpace,
    best: Array,
    times: Array,
    told: tuple[list[str], int, float, float],
) -> Excitation:
    never, seen, gain, seconds = told
    parameters, series = channels.parameters, space.series
    jacobian = _in_sizes(channels, space.rows(best, times))
    # residuals of 1, each row for itself: the information of white noise
    rows = len(jacobian)
    left = left_beside_noise(parameters.is_sensor_offset)
    info = information(jacobian, np.ones(rows), np.arange(rows), exact=left)
    zero = np.zeros(parameters.size)
    values, half = parameters.values(zero), info.half * parameters.scales(zero)
    low, high = interval_ends(values, half, parameters.multiplicative)
    sines, cosines = series.coefficients(space.free(best))
    return Excitation(
        space.along.joints,
        series.duration,
        space.start,
        sines,
        cosines,
        dict(zip(parameters.paths, values.tolist(), strict=True)),
        {p: (float(a), float(b)) for p, a, b in zip(parameters.paths, low, high, strict=True)},
        {p: verdict_of(h) for p, h in zip(parameters.paths, info.half, strict=True)},
        combinations(info, parameters.paths, parameters.multiplicative),
        never,
        seen,
        channels.noise,
        channels.rate,
        space.extremes(best, times),
        gain,
        seconds,
        channels.evaluations,
    )
