"""Tip-exact motions: joints and links move so that the tip follows a stiff robot's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.planning.timing.limit_rows import LimitRows
from denoc_ros.planning.timing.stretching import within_limits
from denoc_ros.planning.tip.asked_motion import AskedMotion
from denoc_ros.planning.tip.reaction import base_gain
from denoc_ros.planning.tip.tip_grid import Int, TipGrids, turn_weight
from denoc_ros.planning.tip.tip_minimum_time import fastest
from denoc_ros.planning.tip.tip_options import TipOptions
from denoc_ros.types import Array

CLOSED = 1e-9  # m, rad: loops of the asked motion that are closed as they are
POINTS = 10  # of a motion: with fewer, its rates at the ends are not known
MOVING = 0.1  # of the largest rate: more is no rest
STANDS = 1e-9  # rad/s, m/s: what rounding leaves of joints that stand still
ITERATIONS = 100
REACHED = 1e-6  # of the path's size: positions that count as reached
SETTLED = 1e-12
LONGEST = 0.3  # rad or m of a joint in one step
DAMPING = 1e-6  # of the rows' largest singular value: below it a joint's motion moves nothing


def checked_path(
    path: ArrayLike | Mapping[str, ArrayLike], frames: Sequence[str], rows: int
) -> list[Array]:
    """Return the poses (rows, 4, 4) of each frame after a check, or raise StateError."""
    if isinstance(path, Mapping):
        if set(path) != set(frames):
            raise StateError(
                f'shape_motion: path must have the frames {list(frames)}, got {sorted(path)}'
            )
        given = [path[frame] for frame in frames]
    else:
        given = [path]
    if len(given) != len(frames):
        raise StateError(
            f'shape_motion: path must be a mapping for the frames {list(frames)}, got one array'
        )
    poses = [np.asarray(each, dtype=np.float64) for each in given]
    for frame, pose in zip(frames, poses, strict=True):
        if pose.shape != (rows, 4, 4) or not np.isfinite(pose).all():
            raise StateError(
                f'shape_motion: path of {frame!r} must be finite and have shape ({rows}, 4, 4), '
                f'got {pose.shape}'
            )
        turned = pose[:, :3, :3] @ pose[:, :3, :3].transpose(0, 2, 1) - np.eye(3)
        worst = float(np.abs(turned).max())
        if worst > 1e-6 or (np.linalg.det(pose[:, :3, :3]) < 0.0).any():
            raise StateError(
                f'shape_motion: path of {frame!r} must have rotations, got columns that are off '
                f'by {worst:.3g}, or mirrored'
            )
    return poses


def joints_along(
    robot: Robot, frames: Sequence[str], poses: Sequence[Array], start: Array, turn: float
) -> Array:
    """Return the joints (k, joints) of the undeformed robot with frames on a path.

    Parameters
    ----------
    robot : Robot
        Its loops stay closed; its links are taken as rigid. A base that floats reacts from its
        zero coordinates on, to second order in the distance of rows.
    frames : sequence of str
    poses : sequence of (k, 4, 4) arrays
        Of each frame.
    start : (joints,) array
        Near the first row; every row starts from the one before it.
    turn : float
        How many metres of position a radian of turn counts as [m].

    Raises
    ------
    SolverError
        A position is out of reach; with the row and how far.
    """
    joints, base = robot.joint_indices, robot.base_indices
    q = np.zeros(robot.n)
    q[joints] = start
    before = q.copy()
    found = np.empty((len(poses[0]), len(joints)))
    size = max(float(np.linalg.norm(pose[:, :3, 3], axis=1).max()) for pose in poses)
    for row in range(len(found)):
        for _ in range(ITERATIONS):
            gain = min(row, 1) * _reacting(robot, 0.5 * (before + q))  # it begins at zero
            q[base] = before[base] + gain @ (q - before)[joints]
            rows, wanted = _rows(robot, frames, [pose[row] for pose in poses], q, turn)
            by_joints = rows[:, joints] + rows[:, base] @ gain
            change = np.linalg.lstsq(by_joints, wanted, rcond=DAMPING)[0]
            largest = float(np.abs(change).max(initial=0.0))
            q[joints] += change * min(1.0, LONGEST / max(largest, 1e-300))
            if largest <= SETTLED * (1.0 + np.abs(q).max()):
                break
        reached = np.array([robot.frame_pose(frame, q)[:3, 3] for frame in frames])
        left = reached - [pose[row, :3, 3] for pose in poses]
        worst = float(np.max(np.linalg.norm(left, axis=1)))
        if worst > REACHED * size:
            raise SolverError(
                f'shape_motion: {robot.tree.name}: the undeformed robot must reach row {row} of '
                f'the path, got no closer than {worst:.3g} m'
            )
        found[row] = q[joints]
        before = q.copy()
    return found


def _reacting(robot: Robot, q: Array) -> Array:
    """Return how a floating base (6, joints) reacts to the joints at q (n,); else (0, joints)."""
    if not len(robot.base_indices):
        return np.zeros((0, len(robot.joint_indices)))
    return np.asarray(base_gain(robot, q[None])[0][:, robot.joint_indices])


def _rows(
    robot: Robot, frames: Sequence[str], poses: Sequence[Array], q: Array, turn: float
) -> tuple[Array, Array]:
    """Jacobian (r, n) and residual (r,) of closure and of the frames."""
    rows, wanted = [robot.closure_jacobian(q)], [-robot.closure(q)]
    for frame, pose in zip(frames, poses, strict=True):
        here, jacobian = robot.frame_pose(frame, q), robot.frame_jacobian(frame, q)
        angle = Rotation.from_matrix(pose[:3, :3] @ here[:3, :3].T).as_rotvec()
        rows += [jacobian[:3], turn * jacobian[3:]]
        wanted += [pose[:3, 3] - here[:3, 3], turn * angle]
    return np.concatenate(rows), np.concatenate(wanted)


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
        turn = turn_weight(robot, driven, poses, options)
        q_joints = joints_along(robot, frames, poses, q_joints[0], turn)
        path = dict(zip(frames, poses, strict=True)) if len(robot.base_indices) else None
    joints = _closed(robot, driven, q_joints)
    _require_rest(robot, times, joints)
    limits = options.limits(robot)
    rows = LimitRows(robot, driven, tuple(frames), limits)
    grids = TipGrids(robot, frames, driven, options)

    def asked(stretch: float) -> AskedMotion:
        return AskedMotion(robot, stretch * (times - times[0]), joints, path)

    def plan(stretch: float) -> Plan:
        motion = asked(stretch)
        return replace(grids.plan(grids.solve(motion), motion), stretch=stretch)

    if options.time == 'minimum':
        made = fastest(grids, asked(1.0), rows)
    else:
        made = within_limits(robot, plan, rows, options.stretch)
    if options.progress is not None:
        options.progress(1.0)
    return replace(made, t=made.t + times[0])


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
