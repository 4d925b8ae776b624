"""Tip-exact motions on grids of times: asked, solved, refined, and made a plan."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from denoc_ros.dynamics.base.floating_base import ATTITUDE
from denoc_ros.dynamics.driven.motion_grid import GridMotion, differences
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.planning.tip.asked_motion import AskedMotion, RetimedMotion
from denoc_ros.planning.tip.reaction import require_attitude
from denoc_ros.planning.tip.targets import Target
from denoc_ros.planning.tip.tip_at_rest import rest_posture
from denoc_ros.planning.tip.tip_options import TipOptions
from denoc_ros.planning.tip.tip_problem import TipProblem
from denoc_ros.planning.tip.tip_solver import CancelledError, Solved, settle, solve_motion
from denoc_ros.planning.tip.zeros import least_moved, settling_times
from denoc_ros.types import Array

Int = NDArray[np.int64]
Rest = tuple[Array, Array]  # coordinates and multipliers
Motion = AskedMotion | RetimedMotion

NODES = 400  # of the motion, at least
FEWEST = 8  # nodes, whatever step is asked for
LONGEST_STEP = 0.04  # s between nodes
HALVINGS = 2  # of the step, where the equations do not hold well between nodes
GRID_ERROR = 3e-7  # of the tip's distance: root mean square of the equations between nodes
TURN = 0.01  # of the tip's distance: how much a radian of turn counts
# rad per rad of joints: where these turn a tip less, near a singular posture, its turn counts less
FAINT = 0.15
STEEP = 3  # power by which it counts less
LEAST_TURN = 0.03  # share of what it counts
PLACES = 41  # along a motion, at which that is looked at
DRAW = 1e-4  # of the tip's distance: what a radian away from the asked joints counts
# times both, where a base floats and fewer joints than directions move the tip: what they do to
# the base moves the tip in the others as well, so that its position need not suffer
FEW = 1e-2
DIRECTIONS = 6
SMOOTH = 3e-3  # of the tip's distance: the same for second differences on the usual grid


@dataclass(frozen=True)
class TipGrid:
    """A tip-exact motion at nodes.

    Attributes
    ----------
    problem : TipProblem
    solved : Solved
    nodes : (k,) array
        Evenly spaced times [s].
    ends : list
        Coordinates and multipliers at rest, before and after.
    """

    problem: TipProblem
    solved: Solved
    nodes: Array
    ends: list[Rest]

    @property
    def step(self) -> float:
        """Between nodes [s]."""
        return float(self.nodes[1] - self.nodes[0])

    @property
    def tip_error(self) -> float:
        """Largest weighed error of the tips at the nodes, as a share of their distance."""
        return float(np.abs(self.problem.errors(self.solved.q)).max() / size_of(self.problem))

    @property
    def motion(self) -> GridMotion:
        """The motion between nodes, too."""
        q = self.solved.q
        return GridMotion(float(self.nodes[0]), self.step, q, *differences(q, self.step))


class TipGrids:
    """Finds tip-exact motions of a robot.

    Parameters
    ----------
    robot : Robot
    frames : sequence of str
    driven : int array
    options : TipOptions
    room : float
        Times the time before and after that the robot's zeros need.
    """

    def __init__(
        self,
        robot: Robot,
        frames: Sequence[str],
        driven: Int,
        options: TipOptions,
        room: float = 1.0,
    ) -> None:
        self.robot, self.frames, self.driven, self.options = robot, frames, driven, options
        self._room = room
        self.report = _reporter(options)
        self._turn: float | None = None
        self._curved = False  # as the motion before was

    def solve(self, asked: Motion, coarser: float = 1.0) -> TipGrid:
        """Return the motion on a grid `refined`, or so many times coarser than usual."""
        duration = asked.duration
        usual = min(duration / NODES, LONGEST_STEP)
        step = self.options.step or coarser * usual
        step = duration / max(FEWEST, math.ceil(duration / step - 1e-9))
        some: Array = np.linspace(0.0, duration, 9)
        rough = self.problem(asked, some, 1.0)
        ends = [rest_posture(rough, k, _start(self.robot, rough.asked[k])) for k in (0, -1)]
        before, after = self._window(rough, ends, duration)
        first, last = -math.ceil(before / step), round(duration / step) + math.ceil(after / step)
        times: Array = step * np.arange(first, last + 1, dtype=np.float64)
        problem = self.problem(asked, times, usual / step)
        guess = _guess(problem, ends, np.clip(times / duration, 0.0, 1.0))
        solved = solve_motion(problem, guess, step, size_of(problem), self.report)
        grid = self._grid(problem, solved, times, ends)
        return self.refined(grid, asked) if coarser == 1.0 else grid

    def refined(self, grid: TipGrid, asked: Motion, halvings: int = HALVINGS) -> TipGrid:
        """Return the motion on a grid that is halved while the equations do not hold between."""
        usual, first = min(asked.duration / NODES, LONGEST_STEP), float(grid.nodes[0])
        for _ in range(0 if self.options.step else halvings):
            if _between(grid) <= GRID_ERROR * size_of(grid.problem):
                break
            finer: Array = first + 0.5 * grid.step * np.arange(2.0 * len(grid.nodes) - 1.0)
            try:
                better = self.problem(asked, finer, 2.0 * usual / grid.step)
                guess = _halved(grid)
                solved = solve_motion(better, guess, 0.5 * grid.step, size_of(better), self.report)
            except CancelledError:
                raise
            except SolverError:
                break  # what was found on the coarser grid is good, and says what it leaves
            grid = self._grid(better, solved, finer, grid.ends)
        return grid

    def _window(
        self, problem: TipProblem, ends: list[Rest], duration: float
    ) -> tuple[float, float]:
        """Return how long the joints may move before and after the motion [s]."""
        needed = np.max([settling_times(problem, q) for q, _ in ends], axis=0)
        given = self.options.preaction, self.options.postaction
        pairs = zip((self._room * needed).tolist(), given, strict=True)
        before, after = (need if own is None else own for need, own in pairs)
        return min(before, duration), min(after, duration)

    def near(self, asked: Motion, times: Array, guess: Rest | None, ends: list[Rest]) -> TipGrid:
        """Return the motion on a grid (k,), from coordinates and multipliers or the asked one."""
        step = float(times[1] - times[0])
        problem = self.problem(asked, times, min(asked.duration / NODES, LONGEST_STEP) / step)
        if guess is None:
            guess = _guess(problem, ends, np.clip(times / asked.duration, 0.0, 1.0))
        solved = settle(problem, guess, step, size_of(problem), self.report)
        return self._grid(problem, solved, times, ends)

    def _grid(
        self, problem: TipProblem, solved: Solved, nodes: Array, ends: list[Rest]
    ) -> TipGrid:
        self._curved = problem.curved
        return TipGrid(problem, solved, nodes, ends)

    def problem(self, asked: Motion, nodes: Array, finer: float) -> TipProblem:
        """Return the problem at the times of nodes (k,).

        `finer` is how many times closer than usual the nodes are: accelerations weigh the same.

        Notes
        -----
        Near a singular posture joints go far for a small turn, and Gauss-Newton steps converge
        where the turn that is left is less than the squared draw over the turn's weight.
        """
        if self._turn is None:
            places: Array = np.linspace(0.0, asked.duration, PLACES)
            problem = self._problem(asked, places, 1.0, 1.0)
            turn = max(target.turn for target in problem.targets)
            share = min(least_moved(problem) / max(FAINT * turn, 1e-300), 1.0)
            self._turn = max(share**STEEP, LEAST_TURN)
        return self._problem(asked, nodes, finer, self._turn)

    def _problem(self, asked: Motion, nodes: Array, finer: float, turns: float) -> TipProblem:
        robot, frames, driven, options = self.robot, self.frames, self.driven, self.options
        poses = [asked.poses(frame, nodes) for frame in frames]
        size, turn = _distance(poses), turns * turn_weight(robot, driven, poses, options)
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
        smooth = share * SMOOTH * size * finer**2
        made = TipProblem(robot, driven, targets, rows, draw, smooth, asked.duration)
        made.curved = self._curved
        return made

    def plan(self, grid: TipGrid, asked: Motion, least: int = 1) -> Plan:
        """Return the plan of a motion on the grid, on finer times, with its torque and errors.

        With `least` rows at least from a node to the next.
        """
        problem, nodes, step, robot = grid.problem, grid.nodes, grid.step, self.robot
        fine = max(least, math.ceil(step / self.options.output_step - 1e-9))
        t = nodes[0] + step / fine * np.arange((len(nodes) - 1) * fine + 1)
        motion = grid.motion.sample(t)
        if len(problem.base):
            require_attitude(robot, motion[0][:, problem.base[ATTITUDE]])
        errors = [
            replace(target, poses=asked.poses(target.frame, t)).error(robot, motion[0])
            for target in problem.targets
        ]
        plan = self.plan_of(t, motion, problem.torque(*motion, _multipliers(grid, t)))
        return replace(
            plan,
            tip_error=np.max([np.linalg.norm(error[0], axis=1) for error in errors], axis=0),
            tip_turn=np.max([np.linalg.norm(error[1], axis=1) for error in errors], axis=0),
            preaction=-float(nodes[0]),
            postaction=float(nodes[-1]) - asked.duration,
            equation_error=_between(grid),
        )

    def plan_of(self, t: Array, motion: tuple[Array, Array, Array], torque: Array) -> Plan:
        """Return the plan of coordinates, rates and accelerations at times, without an error."""
        coordinates, none = tuple(self.robot.coordinate_names), np.zeros(len(t))
        joints = tuple(coordinates[k] for k in self.driven)
        return Plan('tip', t, *motion, torque, joints, coordinates, none, none)


def _halved(grid: TipGrid) -> Rest:
    """Return coordinates and multipliers of a solution on a grid twice as fine."""
    new = grid.nodes[0] + 0.5 * grid.step * np.arange(2 * len(grid.nodes) - 1)
    return grid.motion.sample(new)[0], _multipliers(grid, new)


def _multipliers(grid: TipGrid, times: Array) -> Array:
    """Return the multipliers at times (m,)."""
    spline = make_interp_spline(grid.nodes, grid.solved.multipliers, k=3)
    return np.asarray(spline(times), dtype=np.float64)


def _between(grid: TipGrid) -> float:
    """Return the root mean square of the equations half-way between nodes [m, rad]."""
    problem, middle = grid.problem, 0.5 * (grid.nodes[:-1] + grid.nodes[1:])
    multipliers = _multipliers(grid, middle)
    q, qd, qdd = grid.motion.sample(middle)
    left = problem.residual(q, qd, qdd, multipliers)
    left = np.concatenate([left, problem.drift(q, qd)], axis=1)
    return float(np.sqrt(np.mean(left**2))) if left.size else 0.0


def _start(robot: Robot, asked: Array) -> Array:
    """Return a posture (n,) near the equilibrium at the asked joints."""
    if robot.constraint_names or len(robot.base_indices):
        return asked
    return robot.static_deflection(asked[robot.joint_indices])


def _distance(poses: Sequence[Array]) -> float:
    """Return the largest distance of frames from the base's origin [m]."""
    return max(float(np.linalg.norm(pose[:, :3, 3], axis=1).max()) for pose in poses)


def turn_weight(robot: Robot, driven: Int, poses: Sequence[Array], options: TipOptions) -> float:
    """Return the weight of a radian of rotation [m]."""
    if options.turn is not None:
        return options.turn
    return _share(robot, driven, options) * TURN * _distance(poses)


def _share(robot: Robot, driven: Int, options: TipOptions) -> float:
    """Default factor of turn and draw."""
    few = len(robot.base_indices) > 0 and len(driven) < DIRECTIONS
    return FEW if few and options.turn is None else 1.0


def size_of(problem: TipProblem) -> float:
    """Return the largest distance of the tips from the base [m]."""
    return max(float(np.abs(t.poses[:, :3, 3]).max()) for t in problem.targets)


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
