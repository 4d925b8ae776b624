"""The motion that is asked for: coordinates of the undeformed robot, and poses of its frames."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from denoc_ros.dynamics.robot import Robot
from denoc_ros.planning.shapers.shaped_samples import rest_spline
from denoc_ros.planning.timing.path_timing import Timing
from denoc_ros.planning.tip.reaction import reaction
from denoc_ros.types import Array

LITTLE = 1e-4  # of a motion's time: half of a difference along it


class AskedMotion:
    """A motion of the undeformed robot from rest to rest; a base that floats reacts to it.

    Parameters
    ----------
    robot : Robot
    times : (k,) array
        Increasing, from 0 [s].
    joints : (k, joints) array
        At the times [rad, m].
    path : mapping of frame to (k, 4, 4) array, optional
        Poses that frames are to have in place of those of the undeformed robot.

    Attributes
    ----------
    duration : float
        s.

    Raises
    ------
    SolverError
        A floating base turns too far (see :func:`reaction`).
    """

    def __init__(
        self,
        robot: Robot,
        times: Array,
        joints: Array,
        path: Mapping[str, Array] | None = None,
    ) -> None:
        self._robot = robot
        self.duration = float(times[-1])
        self._joints = rest_spline(times, joints)
        self._base: Any = None
        if len(robot.base_indices):
            self._base = rest_spline(*reaction(robot, self._joints, self.duration))
        # splines from rest to rest of positions and of columns of rotations
        self._path = {
            frame: rest_spline(times, poses[:, :3].reshape(len(poses), 12))
            for frame, poses in (path or {}).items()
        }

    @property
    def joint_spline(self) -> Any:
        """The spline of the joints: times (k,) and the order of a derivative -> (k, joints)."""
        return self._joints

    def coordinates(self, times: Array) -> Array:
        """Return the undeformed robot's coordinates (k, n), held before and after the motion."""
        at, q = np.clip(times, 0.0, self.duration), np.zeros((len(times), self._robot.n))
        q[:, self._robot.joint_indices] = self._joints(at)
        if self._base is not None:
            q[:, self._robot.base_indices] = self._base(at)
        return q

    def poses(self, frame: str, times: Array) -> Array:
        """Return the poses (k, 4, 4) that a frame is to have."""
        if frame not in self._path:
            return self._robot.frame_pose(frame, self.coordinates(times))
        rows = self._path[frame](np.clip(times, 0.0, self.duration))
        return _poses(rows)


class RetimedMotion:
    """A motion that is asked for, at other times.

    Parameters
    ----------
    asked : AskedMotion
        A floating base reacts to a path, however fast: without momentum its way is the path's.
    timing : Timing
        Its stations are times of `asked` [s].
    """

    def __init__(self, asked: AskedMotion, timing: Timing) -> None:
        self._asked, self._timing, self.duration = asked, timing, timing.duration

    def coordinates(self, times: Array) -> Array:
        """Return the undeformed robot's coordinates (k, n), held before and after the motion."""
        return self._asked.coordinates(self._timing.stations_at(times))

    def poses(self, frame: str, times: Array) -> Array:
        """Return the poses (k, 4, 4) that a frame is to have."""
        return self._asked.poses(frame, self._timing.stations_at(times))

    def coordinate_rates(self, times: Array) -> Array:
        """Return the change (k, n) of the coordinates per second of the motion asked for."""
        before, after, apart = self._beside(times)
        change = self._asked.coordinates(after) - self._asked.coordinates(before)
        return np.asarray(change / apart[:, None])

    def twists(self, frame: str, times: Array) -> Array:
        """Return the change (k, 6) of a pose per second of the motion asked for: linear, turn."""
        before, after, apart = self._beside(times)
        first, last = (self._asked.poses(frame, at) for at in (before, after))
        turn = Rotation.from_matrix(last[:, :3, :3] @ first[:, :3, :3].transpose(0, 2, 1))
        change = np.concatenate([last[:, :3, 3] - first[:, :3, 3], turn.as_rotvec()], axis=1)
        return np.asarray(change / apart[:, None])

    def _beside(self, times: Array) -> tuple[Array, Array, Array]:
        """Return stations (k,) a little before and after those at times, and their distance."""
        at, little = self._timing.stations_at(times), LITTLE * self._asked.duration
        before = np.maximum(at - little, 0.0)
        after = np.minimum(at + little, self._asked.duration)
        return before, after, after - before


def _poses(rows: Array) -> Array:
    """Return poses (k, 4, 4) of a spline's rows (k, 12): the nearest rotations."""
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = rows.reshape(-1, 3, 4)
    left, _, right = np.linalg.svd(poses[:, :3, :3])
    poses[:, :3, :3] = left @ right
    return poses
