"""Plans of joint motions without a tip path: shapers and rest to rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy.interpolate import make_interp_spline

from denoc_ros.control.asked_motion import AskedMotion
from denoc_ros.control.driven_joints import DrivenJoints
from denoc_ros.control.end_swing import follow_joints
from denoc_ros.control.joint_limits import WITHIN, JointLimits, require_limits
from denoc_ros.control.limit_rows import LimitOptions, LimitRows
from denoc_ros.control.minimum_time import NEAR
from denoc_ros.control.mode_table import ModeTable, read_mode_table
from denoc_ros.control.plan import Plan
from denoc_ros.control.reaction import require_attitude
from denoc_ros.control.rest_to_rest import rest_to_rest
from denoc_ros.control.ringing import ringing_modes
from denoc_ros.control.shaped_samples import shape_samples
from denoc_ros.control.targets import Target
from denoc_ros.control.tip_options import require_time
from denoc_ros.dynamics.floating_base import ATTITUDE
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.errors import SolverError, StateError
from denoc_ros.types import Array

OUTPUT = 0.004  # s between rows of a plan
SLOWER = 12  # times that the shortest motion is made slower until it keeps all limits
ROUNDING = 0.005  # of a limit: what the search for a duration may be beyond
STEPS_PER_PERIOD = 60.0  # of the fastest mode that is shaped


class JointMotion(Protocol):
    """Times (k,) and the order of a derivative -> rows (k, joints)."""

    def __call__(self, times: Array, derivative: int = 0, /) -> Array:
        """Return the rows."""


@dataclass(frozen=True, kw_only=True)
class ShaperOptions(LimitOptions):
    """Options of an input shaper.

    A shaped motion needs less of each limit than the one it is made of; a plan beyond them is
    refused. The plan's `tip_error` is from the asked motion half the delay later.

    Attributes
    ----------
    modes : int, optional
        How many modes, from the lowest; default those below ten times the lowest.
    output_step : float
        Between the rows of the plan [s].
    cancel : callable, optional
        Returns True where the work must end: SolverError then.
    mode_table : ModeTable or path, optional
        Measured modes over postures, in place of the robot's own, which may be rigid: for
        ``zv``, ``zvd``, ``ei``. `modes` counts them as well.
    """

    modes: int | None = None
    output_step: float = OUTPUT
    cancel: Callable[[], bool] | None = None
    mode_table: ModeTable | str | Path | None = None

    @property
    def table(self) -> ModeTable | None:
        """The measured modes, read where a file was named."""
        given = self.mode_table
        return given if given is None or isinstance(given, ModeTable) else read_mode_table(given)


@dataclass(frozen=True, kw_only=True)
class RestOptions(ShaperOptions):
    """Options of a motion from rest to rest.

    Attributes
    ----------
    duration : float, optional
        s; default that of the motion that was asked for; 0: the shortest within the limits.
    robustness : float
        Share by which the modes' frequencies may be off.
    time : str
        ``minimum``: the shortest within all limits, as `duration` 0 within those of the joints.
    """

    duration: float | None = None
    robustness: float = 0.1
    time: str = 'asked'

    def __post_init__(self) -> None:
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

    plan = _plan(method, robot, motion, (begin, end), options, table)
    return _with_tip(robot, plan, times, q_joints, frames, delay, 0.5 * delay)


def rest_motion(
    robot: Robot,
    times: Array,
    q_joints: Array,
    frames: tuple[str, ...],
    options: RestOptions,
) -> Plan:
    """Return the plan of a motion from the first to the last posture (see :func:`rest_to_rest`).

    What is between them is not followed.
    """
    if options.mode_table is not None:
        raise StateError(
            "shape_motion: mode_table must be for 'zv', 'zvd' or 'ei', got 'rest_to_rest'"
        )
    limits = options.limits(robot)
    duration = float(times[-1] - times[0]) if options.duration is None else options.duration
    fastest = options.time == 'minimum'
    if fastest:
        duration = 0.0
        limits = replace(limits, joints=limits.joints.scaled(1.0 - ROUNDING))
    start = float(times[0])

    def planned(seconds: float) -> Plan:
        found = rest_to_rest(
            robot,
            q_joints[0],
            q_joints[-1],
            seconds or None,
            limits.joints,
            modes=options.modes,
            robustness=options.robustness,
            check=_check(options),
        )

        def motion(at: Array, derivative: int = 0) -> Array:
            return found.joints(at - start, derivative)

        return _plan('rest_to_rest', robot, motion, (start, start + found.duration), options)

    rows = LimitRows(robot, robot.indices(DrivenJoints(robot, 'limits').names), frames, limits)
    plan = planned(duration)
    for _ in range(SLOWER if fastest else 1):
        use = rows.use(plan)
        beyond = float(use.shares.max(initial=0.0))
        if beyond <= (1.0 + NEAR if fastest else 1.0 + WITHIN):
            late = max(0.0, float(plan.t[-1] - times[-1]))
            plan = replace(plan, limits=use)
            return _with_tip(robot, plan, times, q_joints, frames, late)
        if fastest:
            plan = planned(float(plan.t[-1] - plan.t[0]) * max(beyond**0.5, 1.005))
    name = rows.names[int(use.shares.max(axis=0).argmax())]
    raise SolverError(
        f'{robot.tree.name}: rest to rest must keep its limit of {name}, got {beyond:.4g} times '
        f'that in {float(plan.t[-1] - plan.t[0]):.4g} s'
    )


def _check(options: ShaperOptions) -> Callable[[], None]:
    def check() -> None:
        if options.cancel is not None and options.cancel():
            raise SolverError('shape_motion: planning must run to its end, got cancelled')

    return check


def _plan(
    method: str,
    robot: Robot,
    motion: JointMotion,
    window: tuple[float, float],
    options: ShaperOptions,
    table: ModeTable | None = None,
) -> Plan:
    """Return the plan of all coordinates while the joints do a motion, from rest."""
    if not (np.isfinite(options.output_step) and options.output_step > 0.0):
        raise StateError(f'shape_motion: output_step must be > 0 s, got {options.output_step}')
    count = max(2, int(np.ceil((window[1] - window[0]) / options.output_step - 1e-9)) + 1)
    step = (window[1] - window[0]) / (count - 1)
    ends = motion(np.array(window))
    # what swings in the plan is the robot's own; a rigid one has nothing to integrate
    is_rigid = not len(robot.flexible_indices)
    own_modes = ringing_modes(robot, ends[1], options.modes, table if is_rigid else None)
    fastest = float(own_modes.frequencies.max())
    parts = max(1, int(np.ceil(step * STEPS_PER_PERIOD * fastest)))
    fine: Array = np.linspace(*window, (count - 1) * parts + 1)
    own = robot.copy()
    states = follow_joints(
        Stepper(own, step / parts),
        robot.static_deflection(ends[0]),
        motion(fine),
        motion(fine, 1),
        motion(0.5 * (fine[1:] + fine[:-1]), 2),
    )
    t: Array = fine[::parts]
    q, qd = np.ascontiguousarray(states.q[::parts]), np.ascontiguousarray(states.qd[::parts])
    qdd = np.zeros_like(q)
    given = motion(t, 2)
    force, free = own.hybrid_dynamics(q, qd, given)
    qdd[:, robot.joint_indices], qdd[:, robot.free_indices] = given, free
    if len(robot.base_indices):
        require_attitude(robot, q[:, robot.base_indices[ATTITUDE]])
    driven, none = DrivenJoints(robot, method), np.zeros(len(t))
    names = driven.names, tuple(robot.coordinate_names)
    plan = Plan(method, t, q, qd, qdd, driven.torque(force), *names, none, none)
    require_limits(robot, plan, _limits(robot, options), '; make the motion slower')
    return plan


def _limits(robot: Robot, options: ShaperOptions) -> JointLimits:
    return options.limits(robot).joints


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
