"""Plans of joint motions without a tip path: shapers and rest to rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline

from denoc_ros.dynamics.base.floating_base import ATTITUDE
from denoc_ros.dynamics.driven.driven_joints import DrivenJoints
from denoc_ros.dynamics.driven.joint_limits import require_limits
from denoc_ros.dynamics.driven.motion_grid import GridMotion
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.errors import StateError
from denoc_ros.model.mode_table import ModeTable, read_mode_table
from denoc_ros.planning.rest.end_swing import follow_joints
from denoc_ros.planning.rest.rest_problem import RestMotion, Waypoints
from denoc_ros.planning.rest.rest_to_rest import rest_search, with_stiffness
from denoc_ros.planning.shapers.ringing import fastest_mode, ringing_modes
from denoc_ros.planning.shapers.shaped_samples import shape_samples
from denoc_ros.planning.timing.limit_rows import LimitOptions, LimitRows
from denoc_ros.planning.tip.asked_motion import AskedMotion
from denoc_ros.planning.tip.reaction import require_attitude
from denoc_ros.planning.tip.targets import Target
from denoc_ros.planning.tip.tip_options import require_time
from denoc_ros.planning.tip.tip_solver import CancelledError
from denoc_ros.settings import documented, optional
from denoc_ros.types import Array

ROBUSTNESS = 0.1  # of a motion in a given time
MOST_WAYPOINTS = 20
DRAWS = 24  # of robots with other stiffness and load
STEPS = 400  # of a simulated motion, at least
STEPS_PER_PERIOD = 60.0, 40.0  # of the fastest mode that is shaped, and of the fastest of all


class JointMotion(Protocol):
    """Times (k,) and the order of a derivative -> rows (k, joints)."""

    def __call__(self, times: Array, derivative: int = 0, /) -> Array:
        """Return the rows."""


@documented
@dataclass(frozen=True, kw_only=True)
class ShaperOptions(LimitOptions):
    """Options of an input shaper.

    A shaped motion needs less of each limit than the one it is made of; a plan beyond them is
    refused. The plan's `tip_error` is from the asked motion half the delay later.

    Attributes
    ----------
    mode_table : ModeTable or path, optional
        Measured modes over postures, in place of the robot's own, which may be rigid: for
        ``zv``, ``zvd``, ``ei``. `modes` counts them as well.

    Raises
    ------
    StateError
        If a number is out of range.
    """

    modes: int | None = optional(
        int,
        'number of modes that come to rest, from the lowest; default: all below ten times the '
        'lowest frequency',
        '',
        1,
    )
    mode_table: ModeTable | str | Path | None = None

    @property
    def table(self) -> ModeTable | None:
        """The measured modes, read where a file was named."""
        given = self.mode_table
        return given if given is None or isinstance(given, ModeTable) else read_mode_table(given)


@documented
@dataclass(frozen=True, kw_only=True)
class RestOptions(ShaperOptions):
    """Options of a motion from rest to rest.

    Attributes
    ----------
    time : str
        ``minimum``: the shortest within all limits, as `duration` 0.
    waypoints : (w, driven joints) array, optional
        Postures that the first of the tips passes in this order, within `radius` of where the
        undeformed robot's is there; default those between the first and the last that were asked
        for, where there is a radius.
    progress : callable, optional
        Takes the share of the work that is done, 0 to 1.

    Raises
    ------
    StateError
        If a number is out of range.
    """

    duration: float | None = optional(
        float,
        'duration of the motion; 0: the shortest within limits; default: that of the motion that '
        'was asked for',
        's',
        0.0,
        finite=True,
    )
    # what keeps a swing small with other frequencies takes time: 0 in the shortest motion
    robustness: float | None = optional(
        float,
        "assumed error of the modes' frequencies, as a share; default: 0.1, in the shortest "
        'motion 0',
        '',
        0.0,
        below=1.0,
    )
    time: str = 'asked'
    waypoints: ArrayLike | None = None
    radius: float | None = optional(
        float,
        'the tip passes the points between first and last, in their order, so near; default: they '
        'do not matter',
        'm',
        positive=True,
        finite=True,
    )
    progress: Callable[[float], object] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        require_time(self.time)
        if self.time == 'minimum' and self.duration:
            raise StateError(
                f"shape_motion: duration must not come with time='minimum', got {self.duration!r}"
            )


def shaper_motion(
    method: str,
    robot: Robot,
    times: Array,
    q_joints: Array,
    frames: tuple[str, ...],
    options: ShaperOptions,
) -> Plan:
    """Return the plan of a motion through an input shaper (see :func:`shape_samples`)."""
    _check(options)()
    table = options.table
    samples, delay = shape_samples(robot, times, q_joints, method, options.modes, table)
    spline = make_interp_spline(samples.t, samples.q, k=5)
    begin, end = float(samples.t[0]), float(samples.t[-1])

    def motion(at: Array, derivative: int = 0) -> Array:
        return np.asarray(spline(np.clip(at, begin, end), derivative), dtype=np.float64)

    even = _even(begin, end, options)
    plan = _simulated(method, robot, motion, even, options.modes, table)
    require_limits(robot, plan, options.limits(robot).joints, '; make the motion slower')
    return _with_tip(robot, plan, times, q_joints, frames, delay, 0.5 * delay)


def rest_motion(
    robot: Robot,
    times: Array,
    q_joints: Array,
    frames: tuple[str, ...],
    options: RestOptions,
) -> Plan:
    """Return the plan of a motion from the first to the last posture (see :func:`rest_to_rest`).

    What is between them is not followed, but passed near where there is a `radius`.
    """
    if options.mode_table is not None:
        raise StateError(
            "shape_motion: mode_table must be for 'zv', 'zvd' or 'ei', got 'rest_to_rest'"
        )
    limits, fastest = options.limits(robot), options.time == 'minimum'
    asked = float(times[-1] - times[0]) if options.duration is None else float(options.duration)
    robustness, shortest = options.robustness, fastest or asked == 0.0
    if shortest and robustness:
        raise StateError(
            f'shape_motion: robustness must be 0 in the shortest motion, got {robustness!r}'
        )
    if robustness is None:
        robustness = 0.0 if shortest else ROBUSTNESS
    search = rest_search(
        robot,
        (q_joints[0], q_joints[-1]),
        limits,
        frames,
        options.modes,
        robustness,
        _waypoints(robot, q_joints, frames, options),
        # in minimum time the best so far is returned
        (lambda: None) if fastest else _check(options),
    )
    start = float(times[0])

    def plan(motion: RestMotion) -> Plan:
        t = _even(start, start + motion.duration, options, motion.rows)
        q, qd = motion.coordinates(t - start)
        for rows, order in ((q, 0), (qd, 1)):
            rows[:, robot.joint_indices] = motion.joints(t - start, order)
        return _of_states('rest_to_rest', robot, t, q, qd, motion.joints(t - start, 2))

    stopped = options.cancel if fastest and options.cancel is not None else (lambda: False)
    progress = options.progress or (lambda _share: None)
    found = search.plan(None if fastest else asked or None, plan, progress, stopped)
    late = max(0.0, float(found.t[-1] - times[-1]))
    stretch = float(found.t[-1] - found.t[0]) / float(times[-1] - times[0]) if fastest else 1.0
    found = replace(found, stretch=stretch)
    return _with_tip(robot, found, times, q_joints, frames, late)


def _waypoints(
    robot: Robot, q_joints: Array, frames: tuple[str, ...], options: RestOptions
) -> Waypoints | None:
    """Return the waypoints of the options or of the motion after a check."""
    if options.waypoints is None and options.radius is None:
        return None
    driven = DrivenJoints(robot, 'rest to rest')
    given = options.waypoints
    if given is None:
        given = q_joints[1:-1, driven.places]
        if not len(given):
            return None
    try:
        postures = np.array(given, dtype=np.float64)
    except ValueError:
        postures = np.zeros(0)
    if postures.ndim != 2 or not len(postures) or postures.shape[1] != len(driven.names):
        raise StateError(
            f'shape_motion: waypoints must be rows of {len(driven.names)} numbers (driven joints '
            f'{list(driven.names)}), got shape {np.shape(postures)}'
        )
    if len(postures) > MOST_WAYPOINTS:
        raise StateError(
            f'shape_motion: waypoints must be {MOST_WAYPOINTS} at most, got {len(postures)}; give '
            'the motion as a few points'
        )
    if not np.isfinite(postures).all():
        raise StateError(f'shape_motion: waypoints must be finite, got {postures.tolist()}')
    if options.radius is None:
        raise StateError('shape_motion: radius of waypoints must be > 0 m, got None')
    limits = options.limits(robot).joints.of(driven.places)
    for k, posture in enumerate(postures):
        if (posture < limits.lower).any() or (posture > limits.upper).any():
            raise StateError(
                f'shape_motion: waypoint {k + 1} must be within {limits.lower.tolist()} to '
                f'{limits.upper.tolist()}, got {posture.tolist()}'
            )
    return Waypoints(frames[0], postures, options.radius)


def _check(options: ShaperOptions) -> Callable[[], None]:
    def check() -> None:
        if options.cancel is not None and options.cancel():
            raise CancelledError('shape_motion: planning must run to its end, got cancelled')

    return check


def _even(begin: float, end: float, options: ShaperOptions, parts: int = 1) -> Array:
    """Return times in steps that are equal shares of as many equal parts."""
    steps = np.ceil((end - begin) / (parts * options.output_step) - 1e-9)
    return np.linspace(begin, end, parts * max(1, int(steps)) + 1)


def _simulated(
    method: str,
    robot: Robot,
    motion: JointMotion,
    t: Array,
    modes: int | None,
    table: ModeTable | None = None,
) -> Plan:
    """Return the plan of all coordinates at times (k,) in even steps; no limits are checked."""
    step = float(t[1] - t[0])
    ends = motion(t[[0, -1]])
    # what swings in the plan is the robot's own; a rigid one has nothing to integrate
    is_rigid = not len(robot.flexible_indices)
    own_modes = ringing_modes(robot, ends[1], modes, table if is_rigid else None)
    rests = float(own_modes.frequencies.max())
    pace = max(
        STEPS_PER_PERIOD[0] * rests, STEPS_PER_PERIOD[1] * fastest_mode(robot, ends[1], rests)
    )
    parts = int(np.ceil(max(step * pace, STEPS / (len(t) - 1))))
    fine: Array = np.linspace(t[0], t[-1], (len(t) - 1) * parts + 1)
    own = robot.copy()
    states = follow_joints(
        Stepper(own, step / parts),
        robot.static_deflection(ends[0]),
        motion(fine),
        motion(fine, 1),
        motion(0.5 * (fine[1:] + fine[:-1]), 2),
    )
    q, qd = np.ascontiguousarray(states.q[::parts]), np.ascontiguousarray(states.qd[::parts])
    return _of_states(method, robot, t, q, qd, motion(t, 2))


def _of_states(method: str, robot: Robot, t: Array, q: Array, qd: Array, given: Array) -> Plan:
    """Return the plan of coordinates and rates (k, n) with accelerations of joints."""
    qdd = np.zeros_like(q)
    force, free = robot.hybrid_dynamics(q, qd, given)
    qdd[:, robot.joint_indices], qdd[:, robot.free_indices] = given, free
    if len(robot.base_indices):
        require_attitude(robot, q[:, robot.base_indices[ATTITUDE]])
    driven, none = DrivenJoints(robot, method), np.zeros(len(t))
    names = driven.names, tuple(robot.coordinate_names)
    return Plan(method, t, q, qd, qdd, driven.torque(force), *names, none, none)


def with_spread(robot: Robot, plan: Plan, frames: tuple[str, ...], options: LimitOptions) -> Plan:
    """Return a plan that says how much of each limit robots would use that are a little other.

    Their joints do the plan's motion. The stiffness of each link, and the load at the first of
    the frames, are drawn evenly within the options' `uncertainty`, and at its ends.
    """
    share, limits = options.uncertainty, options.limits(robot)
    links = sorted(
        {
            body.link
            for body in robot.tree.bodies
            if body.beam is not None or body.modes is not None
        }
    )
    if not (share and links):
        return plan
    joints = robot.joint_indices
    on_grid = GridMotion(
        float(plan.t[0]),
        float(plan.t[-1] - plan.t[0]) / (len(plan.t) - 1),
        *(rows[:, joints] for rows in (plan.q, plan.qd, plan.qdd)),
    )

    def motion(at: Array, derivative: int = 0) -> Array:
        return on_grid.sample(at)[derivative]

    indices = robot.indices(DrivenJoints(robot, 'uncertainty').names)
    random = np.random.default_rng(DRAWS)
    factors = random.uniform(1.0 - share, 1.0 + share, (DRAWS, len(links) + 1))
    ends = 1.0 + share * np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
    corners = np.hstack([np.repeat(ends[:, :1], len(links), axis=1), ends[:, 1:]])
    largest: dict[str, float] = {}
    for row in np.vstack([corners, factors]).tolist():
        other = with_stiffness(robot, dict(zip(links, row, strict=False)))
        other = other.with_scaled_load(frames[0], row[-1])
        run = _simulated(plan.method, other, motion, plan.t, None)
        use = LimitRows(other, indices, frames, limits).use(run)
        for name, value in use.largest.items():
            largest[name] = max(largest.get(name, 0.0), value)
    use = plan.limits or LimitRows(robot, indices, frames, limits).use(plan)
    return replace(plan, limits=replace(use, spread=largest))


def _with_tip(
    robot: Robot,
    plan: Plan,
    times: Array,
    q_joints: Array,
    frames: tuple[str, ...],
    delay: float,
    shift: float = 0.0,
) -> Plan:
    """Return the plan with how far its tip is from the undeformed robot's on the asked motion.

    That motion is taken `shift` s later: an input shaper's impulses come half its delay late.
    """
    rows = DrivenJoints(robot, plan.method).following(q_joints)
    motion = AskedMotion(robot, times - times[0], rows)
    asked = motion.coordinates(plan.t - shift - times[0])
    distance, turn = np.zeros((2, len(plan.t)))
    for frame in frames:
        off = Target(frame, robot.frame_pose(frame, asked), 1.0, 1.0).error(robot, plan.q)
        distance = np.maximum(distance, np.linalg.norm(off[0], axis=1))
        turn = np.maximum(turn, np.linalg.norm(off[1], axis=1))
    after = max(0.0, float(plan.t[-1] - times[-1]))
    return replace(plan, tip_error=distance, tip_turn=turn, postaction=after, delay=delay)
