"""Joints of the undeformed robot along a path of its frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from denoc_ros.control.reaction import base_gain
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.types import Array

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
