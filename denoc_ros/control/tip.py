"""Tip-exact motions: joints and links move so that the tip follows a stiff robot's."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from denoc_ros.control.asked_motion import AskedMotion
from denoc_ros.control.grid import GridMotion, differences
from denoc_ros.control.joint_limits import joint_limits
from denoc_ros.control.plan import Plan
from denoc_ros.control.reaction import require_attitude
from denoc_ros.control.rest import rest_posture
from denoc_ros.control.stretching import within_limits
from denoc_ros.control.targets import Target
from denoc_ros.control.tip_options import TipOptions
from denoc_ros.control.tip_path import checked_path, joints_along
from denoc_ros.control.tip_problem import TipProblem
from denoc_ros.control.tip_solver import CancelledError, Solved, solve_motion
from denoc_ros.control.zeros import rings, settling_times
from denoc_ros.dynamics.floating_base import ATTITUDE
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.types import Array

Int = NDArray[np.int64]
Rest = tuple[Array, Array]  # coordinates and multipliers

NODES = 400  # of the motion, at least
FEWEST = 8  # nodes, whatever step is asked for
LONGEST_STEP = 0.04  # s between nodes
HALVINGS = 2  # of the step, where the equations do not hold well between nodes
GRID_ERROR = 3e-7  # of the tip's distance: root mean square of the equations between nodes
OUTPUT = 0.004  # s between rows of a plan
TURN = 0.01  # of the tip's distance: how much a radian of turn counts
DRAW = 1e-4  # of the tip's distance: what a radian away from the asked joints counts
# times both, where a base floats and fewer joints than directions move the tip: what they do to
# the base moves the tip in the others as well, so that its position need not suffer
FEW = 1e-2
DIRECTIONS = 6
CLOSED = 1e-9  # m, rad: loops of the asked motion that are closed as they are
POINTS = 10  # of a motion: with fewer, its rates at the ends are not known
MOVING = 0.1  # of the largest rate: more is no rest
STANDS = 1e-9  # rad/s, m/s: what rounding leaves of joints that stand still
SMOOTH = 3e-3  # of the tip's distance: the same for second differences on the usual grid
# times that, where links can swing on while the tip stands still (on a base that reacts): else
# the end of the grid would stop them within a few nodes
RINGING = 100.0


def tip_motion(
    robot: Robot,
    times: Array,
    q_joints: Array,
    frames: Sequence[str],
    options: TipOptions,
) -> Plan:
    """Return the plan of a tip-exact motion (see :func:`denoc_ros.shape_motion`).

    Parameters
    ----------
    robot : Robot
    times : (k,) array
        Increasing [s].
    q_joints : (k, joints) array
        Of the undeformed robot, from rest to rest.
    frames : sequence of str
        Those that are to be where the undeformed robot would have them.
    options : TipOptions
    """
    driven = robot.indices(options.joints or robot.tree.non_mimic_joints)
    path = None
    if options.path is not None:
        poses = checked_path(options.path, frames, len(times))
        turn = _turn(robot, driven, poses, options)
        q_joints = joints_along(robot, frames, poses, q_joints[0], turn)
        path = dict(zip(frames, poses, strict=True)) if len(robot.base_indices) else None
    joints = _closed(robot, driven, q_joints)
    _require_rest(robot, times, joints)
    limits = joint_limits(robot, options.velocity, options.acceleration, effort=options.effort)

    def plan(stretch: float) -> Plan:
        asked = AskedMotion(robot, stretch * (times - times[0]), joints, path)
        return replace(_at_pace(robot, asked, frames, driven, options), stretch=stretch)

    made = within_limits(robot, plan, limits, options.stretch)
    if options.progress is not None:
        options.progress(1.0)
    return replace(made, t=made.t + times[0])


def _at_pace(
    robot: Robot,
    asked: AskedMotion,
    frames: Sequence[str],
    driven: Int,
    options: TipOptions,
) -> Plan:
    """Return the plan of a motion that takes exactly the requested time."""
    duration = asked.duration
    usual = min(duration / NODES, LONGEST_STEP)
    step = options.step or usual
    step = duration / max(FEWEST, math.ceil(duration / step - 1e-9))
    some: Array = np.linspace(0.0, duration, 9)
    rough = _problem(robot, asked, frames, driven, options, some, 1.0)
    ends = [rest_posture(rough, k, _start(robot, rough.asked[k])) for k in (0, -1)]
    before, after = _window(rough, ends, duration, options)
    first, last = -math.ceil(before / step), round(duration / step) + math.ceil(after / step)
    nodes: Array = step * np.arange(first, last + 1, dtype=np.float64)
    # nodes that are closer than usual: accelerations weigh the same
    smoother = (RINGING if any(rings(rough, q) for q, _ in ends) else 1.0) * (usual / step) ** 2
    problem = _problem(robot, asked, frames, driven, options, nodes, smoother)
    guess = _guess(problem, ends, np.clip(nodes / duration, 0.0, 1.0))
    report = _reporter(options)
    solved = solve_motion(problem, guess, step, _size(problem), report)
    for _ in range(0 if options.step else HALVINGS):
        if _between(problem, solved, step) <= GRID_ERROR * _size(problem):
            break
        finer = nodes[0] + 0.5 * step * np.arange(2 * len(nodes) - 1)
        try:
            better = _problem(robot, asked, frames, driven, options, finer, 4.0 * smoother)
            guess = _halved(solved, step)
            solved = solve_motion(better, guess, 0.5 * step, _size(better), report)
        except CancelledError:
            raise
        except SolverError:
            break  # what was found on the coarser grid is good, and says what it leaves
        problem, nodes, step, smoother = better, finer, 0.5 * step, 4.0 * smoother
    return _plan(problem, solved, nodes, asked, options.output_step or OUTPUT)


def _halved(solved: Solved, step: float) -> Rest:
    """Return coordinates and multipliers of a solution on a grid twice as fine."""
    motion = GridMotion(0.0, step, solved.q, *differences(solved.q, step))
    old = step * np.arange(len(solved.q))
    new: Array = 0.5 * step * np.arange(2 * len(solved.q) - 1, dtype=np.float64)
    return motion.sample(new)[0], make_interp_spline(old, solved.multipliers, k=3)(new)


def _between(problem: TipProblem, solved: Solved, step: float) -> float:
    """Return the root mean square of the equations half-way between nodes [m, rad]."""
    count = len(solved.q)
    motion = GridMotion(0.0, step, solved.q, *differences(solved.q, step))
    middle: Array = step * (np.arange(count - 1, dtype=np.float64) + 0.5)
    multipliers = make_interp_spline(step * np.arange(count), solved.multipliers, k=3)(middle)
    q, qd, qdd = motion.sample(middle)
    left = problem.residual(q, qd, qdd, multipliers)
    left = np.concatenate([left, problem.drift(q, qd)], axis=1)
    return float(np.sqrt(np.mean(left**2))) if left.size else 0.0


def _require_rest(robot: Robot, times: Array, joints: Array) -> None:
    """Raise StateError where a motion (k, joints) of at least `POINTS` begins or ends fast.

    A plan rests at both ends; a motion that does not would be bent to rest within a few points.
    """
    if len(times) < POINTS:
        return
    rates = make_interp_spline(times, joints, k=5)(times, 1)
    fastest = float(np.abs(rates).max(initial=0.0))
    for place, row in (('begin', 0), ('end', -1)):
        joint = int(np.abs(rates[row]).argmax())
        if abs(rates[row, joint]) > max(MOVING * fastest, STANDS):
            raise StateError(
                f'shape_motion: q_joints must {place} at rest, got {rates[row, joint]:.3g} rad/s '
                f'(or m/s) of {robot.joint_names[joint]}'
            )


def _start(robot: Robot, asked: Array) -> Array:
    """Return a posture (n,) near the equilibrium at the asked joints."""
    if robot.constraint_names or len(robot.base_indices):
        return asked
    return robot.static_deflection(asked[robot.joint_indices])


def _problem(
    robot: Robot,
    asked: AskedMotion,
    frames: Sequence[str],
    driven: Int,
    options: TipOptions,
    nodes: Array,
    smoother: float,
) -> TipProblem:
    """Return the problem at the times of nodes (k,).

    `smoother` is how many times more than usual second differences of the joints count.
    """
    poses = [asked.poses(frame, nodes) for frame in frames]
    size, turn = _distance(poses), _turn(robot, driven, poses, options)
    weights = [1.0] * len(frames) if options.weights is None else list(options.weights)
    if len(weights) != len(frames):
        raise StateError(
            f'shape_motion: weights must be one for each of {list(frames)}, got {len(weights)}'
        )
    targets = [
        Target(frame, pose, weight, turn)
        for frame, pose, weight in zip(frames, poses, weights, strict=True)
    ]
    share = _share(robot, driven, options)
    draw = share * DRAW * size if options.draw is None else options.draw
    rows = asked.coordinates(nodes)
    smooth = share * SMOOTH * size * smoother
    return TipProblem(robot, driven, targets, rows, draw, smooth, asked.duration)


def _distance(poses: Sequence[Array]) -> float:
    """Return the largest distance of frames from the base's origin [m]."""
    return max(float(np.linalg.norm(pose[:, :3, 3], axis=1).max()) for pose in poses)


def _turn(robot: Robot, driven: Int, poses: Sequence[Array], options: TipOptions) -> float:
    """Return the weight of a radian of rotation [m]."""
    if options.turn is not None:
        return options.turn
    return _share(robot, driven, options) * TURN * _distance(poses)


def _share(robot: Robot, driven: Int, options: TipOptions) -> float:
    """Default factor of turn and draw."""
    few = len(robot.base_indices) > 0 and len(driven) < DIRECTIONS
    return FEW if few and options.turn is None else 1.0


def _closed(robot: Robot, driven: Int, joints: Array) -> Array:
    """Return the joints (k, joints) with loops closed and mimic joints on their leaders.

    Driven joints stay; the others start from where they are given.
    """
    if not robot.constraint_names:
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
    """Return the callback of each iteration: it reports progress and checks for cancellation."""

    def report(iteration: int, left: float) -> None:
        if options.progress is not None:
            options.progress(1.0 - 0.5**iteration)
        if options.cancel is not None and options.cancel():
            raise CancelledError(
                f'shape_motion: it was cancelled after {iteration} iterations, with forces of '
                f'{left:.3g} m (or rad) over their stiffness left'
            )

    return report


def _plan(
    problem: TipProblem,
    solved: Solved,
    nodes: Array,
    asked: AskedMotion,
    output_step: float,
) -> Plan:
    """Return the plan of a motion on the grid, on finer times, with its torque and errors."""
    robot, step = problem.robot, float(nodes[1] - nodes[0])
    motion = GridMotion(nodes[0], step, solved.q, *differences(solved.q, step))
    fine = max(1, math.ceil(step / output_step - 1e-9))
    t = nodes[0] + step / fine * np.arange((len(nodes) - 1) * fine + 1)
    q, qd, qdd = motion.sample(t)
    multipliers = make_interp_spline(nodes, solved.multipliers, k=3)(t)
    torque = problem.torque(q, qd, qdd, multipliers)
    if len(problem.base):
        require_attitude(robot, q[:, problem.base[ATTITUDE]])
    errors = [
        replace(target, poses=asked.poses(target.frame, t)).error(robot, q)
        for target in problem.targets
    ]
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
        postaction=float(nodes[-1]) - asked.duration,
        equation_error=_between(problem, solved, step),
    )
