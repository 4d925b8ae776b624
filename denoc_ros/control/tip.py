"""Tip-exact motions: joints and links move so that the tip does what a stiff robot's would."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import make_interp_spline

from denoc_ros.control.grid import GridMotion, differences
from denoc_ros.control.plan import Plan
from denoc_ros.control.rest import rest_posture
from denoc_ros.control.targets import Target
from denoc_ros.control.tip_problem import TipProblem
from denoc_ros.control.tip_solver import Solved, solve_motion
from denoc_ros.control.zeros import settling_times
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError

Array = NDArray[np.float64]
Rest = tuple[Array, Array]  # coordinates and multipliers
Report = Callable[[float], object]

NODES = 400  # of the motion, at least
LONGEST_STEP = 0.04  # s between nodes
OUTPUT = 0.004  # s between rows of a plan
TURN = 0.01  # of the tip's distance: how much a radian of turn counts
DRAW = 1e-4  # of the tip's distance: what a radian away from the asked joints counts
CLOSED = 1e-9  # m, rad: loops of the asked motion that are closed as they are
SMOOTH = 3e-3  # the same for second differences


@dataclass(frozen=True)
class TipOptions:
    """What may be asked of a tip-exact motion, beside the motion.

    Attributes
    ----------
    joints : names, optional
        The driven joints; default all that mimic none.
    weights : (frames,) floats, optional
        Of the frames' errors; default 1 each.
    turn : float, optional
        How many metres of position a radian of turn counts as; 0: only positions matter. Default
        a hundredth of the tip's distance from the base.
    draw : float, optional
        How many metres of the tip a radian (or metre) of the driven joints away from the asked
        motion counts as; default 1e-4 of the tip's distance. It decides where the tip's pose does
        not, or the arm is stretched.
    preaction, postaction : float, optional
        How long the joints may move before and after the motion that was asked for [s]; default
        what the robot's zeros need.
    step : float, optional
        Between the nodes at which the equations hold [s].
    output_step : float, optional
        Between the rows of the plan [s].
    progress : callable, optional
        Takes the share of the work that is done, 0 to 1.
    cancel : callable, optional
        Returns True where the work must end: SolverError then.
    """

    joints: Sequence[str] | None = None
    weights: Sequence[float] | None = None
    turn: float | None = None
    draw: float | None = None
    preaction: float | None = None
    postaction: float | None = None
    step: float | None = None
    output_step: float | None = None
    progress: Report | None = None
    cancel: Callable[[], bool] | None = None


def tip_motion(
    robot: Robot,
    times: ArrayLike,
    q_joints: ArrayLike,
    tip: str | Sequence[str],
    options: TipOptions,
) -> Plan:
    """Return the plan of a tip-exact motion (see :func:`denoc_ros.shape_motion`)."""
    frames = (tip,) if isinstance(tip, str) else tuple(tip)
    driven = robot.indices(options.joints or driven_joints(robot))
    times, joints = np.asarray(times, dtype=np.float64), np.asarray(q_joints, dtype=np.float64)
    joints = _closed(robot, driven, joints)
    duration = float(times[-1] - times[0])
    wanted = _spline(times - times[0], joints)
    step = options.step or min(duration / NODES, LONGEST_STEP)
    step = duration / max(8, math.ceil(duration / step - 1e-9))
    rough = _problem(robot, frames, options, wanted(np.array([0.0, duration])))
    ends = [rest_posture(rough, k, _start(robot, rough.asked[k])) for k in (0, -1)]
    before, after = _window(rough, ends, duration, options)
    first, last = -math.ceil(before / step), round(duration / step) + math.ceil(after / step)
    nodes: Array = step * np.arange(first, last + 1, dtype=np.float64)
    problem = _problem(robot, frames, options, wanted(np.clip(nodes, 0.0, duration)))
    guess = _guess(problem, ends, np.clip(nodes / duration, 0.0, 1.0))
    solved = solve_motion(problem, guess, step, _size(problem), _reporter(options))
    plan = _plan(problem, solved, nodes, step, wanted, duration, options)
    return replace(plan, t=plan.t + times[0])


def _spline(times: Array, joints: Array) -> Callable[[Array], Array]:
    """Return the quintic spline of a motion (k, joints) from rest to rest, without jerk jumps."""
    rest = [(1, np.zeros(joints.shape[1])), (2, np.zeros(joints.shape[1]))]
    spline = make_interp_spline(times, joints, k=5, bc_type=(rest, rest))
    return lambda at: np.asarray(spline(at), dtype=np.float64)


def _start(robot: Robot, asked: Array) -> Array:
    """Return a posture (n,) near the equilibrium at the asked joints."""
    if robot.lowered.tie_names:
        return asked
    return robot.static_deflection(asked[robot.joint_indices])


def _problem(
    robot: Robot, frames: Sequence[str], options: TipOptions, asked_joints: Array
) -> TipProblem:
    """Return the problem at nodes where the undeformed robot's joints (k, joints) are given."""
    asked = np.zeros((len(asked_joints), robot.n))
    asked[:, robot.joint_indices] = asked_joints
    poses = [robot.frame_pose(frame, asked) for frame in frames]
    size = max(float(np.linalg.norm(pose[:, :3, 3], axis=1).max()) for pose in poses)
    turn = TURN * size if options.turn is None else options.turn
    weights = [1.0] * len(frames) if options.weights is None else list(options.weights)
    targets = [
        Target(frame, pose, weight, turn)
        for frame, pose, weight in zip(frames, poses, weights, strict=True)
    ]
    draw = DRAW * size if options.draw is None else options.draw
    driven = robot.indices(options.joints or driven_joints(robot))
    return TipProblem(robot, driven, targets, asked, draw, SMOOTH * size)


def driven_joints(robot: Robot) -> tuple[str, ...]:
    """Return the names of the joints that mimic none."""
    joints = (body.joint for body in robot.tree.bodies)
    return tuple(joint.name for joint in joints if joint is not None and joint.mimic is None)


def _closed(robot: Robot, driven: NDArray[np.int64], joints: Array) -> Array:
    """Return the joints (k, joints) with loops closed and mimic joints on their leaders.

    Driven joints stay; the others start from where they are given.
    """
    if not robot.lowered.tie_names:
        return joints
    q = np.zeros((len(joints), robot.n))
    q[:, robot.joint_indices] = joints
    fixed = [robot.coordinate_names[k] for k in driven]
    open_rows = np.flatnonzero(np.abs(robot.closure(q)).max(axis=1) > CLOSED)
    for row in open_rows:
        q[row] = robot.assemble(q[row], fixed=fixed)
        q[row, robot.flexible_indices] = 0.0
    return np.asarray(q[:, robot.joint_indices])


def _size(problem: TipProblem) -> float:
    return max(float(np.abs(t.poses[:, :3, 3]).max()) for t in problem.targets)


def _window(
    problem: TipProblem, ends: list[Rest], duration: float, options: TipOptions
) -> tuple[float, float]:
    """Return how long the joints may move before and after the motion [s]."""
    needed = [settling_times(problem, q) for q, _ in ends]
    before = max(need[0] for need in needed) if options.preaction is None else options.preaction
    after = max(need[1] for need in needed) if options.postaction is None else options.postaction
    return min(before, duration), min(after, duration)


def _guess(problem: TipProblem, ends: list[Rest], share: Array) -> Rest:
    """Return the asked motion (k, n) and multipliers (k, m) to begin with.

    What the ends have beside the asked motion is spread over the middle.
    """
    first, last = 1.0 - share[:, None], share[:, None]
    asked = problem.asked
    q = asked + first * (ends[0][0] - asked[0]) + last * (ends[1][0] - asked[-1])
    return q, first * ends[0][1] + last * ends[1][1]


def _reporter(options: TipOptions) -> Callable[[int, float], None]:
    """Return what is called at each iteration: it tells how far it is, and looks for an end."""

    def report(iteration: int, left: float) -> None:
        if options.progress is not None:
            options.progress(1.0 - 0.5**iteration)
        if options.cancel is not None and options.cancel():
            raise SolverError(
                f'shape_motion: it was cancelled after {iteration} iterations, with forces of '
                f'{left:.3g} m (or rad) over their stiffness left'
            )

    return report


def _plan(
    problem: TipProblem,
    solved: Solved,
    nodes: Array,
    step: float,
    wanted: Callable[[Array], Array],
    duration: float,
    options: TipOptions,
) -> Plan:
    """Return the plan of a motion on the grid, on finer times, with its torque and errors."""
    robot = problem.robot
    motion = GridMotion(nodes[0], step, solved.q, *differences(solved.q, step))
    fine = max(1, math.ceil(step / (options.output_step or OUTPUT) - 1e-9))
    t = nodes[0] + step / fine * np.arange((len(nodes) - 1) * fine + 1)
    q, qd, qdd = motion.sample(t)
    multipliers = make_interp_spline(nodes, solved.multipliers, k=3)(t)
    torque = problem.torque(q, qd, qdd, multipliers)
    asked = np.zeros_like(q)
    asked[:, robot.joint_indices] = wanted(np.clip(t, 0.0, duration))
    errors = [
        replace(target, poses=robot.frame_pose(target.frame, asked)).error(robot, q)
        for target in problem.targets
    ]
    if options.progress is not None:
        options.progress(1.0)
    return Plan(
        method='tip',
        t=t,
        q=q,
        qd=qd,
        qdd=qdd,
        torque=torque,
        joint_names=tuple(robot.coordinate_names[k] for k in problem.driven),
        coordinate_names=tuple(robot.coordinate_names),
        tip_error=np.max([np.linalg.norm(error[0], axis=1) for error in errors], axis=0),
        tip_turn=np.max([np.linalg.norm(error[1], axis=1) for error in errors], axis=0),
        preaction=-float(nodes[0]),
        postaction=float(nodes[-1]) - duration,
    )
