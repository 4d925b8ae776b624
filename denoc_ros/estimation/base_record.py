"""The motion of a base from a whole record of it: smoothed, with accelerations, at any time."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from denoc_ros.dynamics.base_motion import BaseMotion
from denoc_ros.errors import StateError
from denoc_ros.estimation.joint_motion import smooth
from denoc_ros.types import Array

UNIT = 1e-3  # how far a quaternion may be from unit length


class BaseRecord:
    """Twist, acceleration and pose of a base, interpolated between the samples of a record.

    Parameters
    ----------
    t : (k,) array
        Times [s], rising.
    poses : (k, 7) array
        Of the base frame in the world: position [m], quaternion x, y, z, w.
    twists : (k, 6) array
        In the axes of the base frame [m/s, rad/s].
    method, cutoff
        As :func:`denoc_ros.estimation.joint_motion.smooth`: accelerations are slopes of twists.

    Attributes
    ----------
    floats : bool
        Whether the base falls freely; False at first. Nothing has a weight then.

    Raises
    ------
    StateError
        Fewer than two samples, numbers that are not finite, quaternions that are no rotation.
    """

    def __init__(
        self, t: Array, poses: Array, twists: Array, method: str = 'filter', cutoff: float = 20.0
    ) -> None:
        if len(t) < 2:
            raise StateError(f'motion of the base must have two samples at least, got {len(t)}')
        if not (np.isfinite(poses).all() and np.isfinite(twists).all()):
            raise StateError('motion of the base must be finite, got a number that is not')
        length = np.linalg.norm(poses[:, 3:], axis=1)
        worst = float(length[np.argmax(np.abs(length - 1.0))])
        if not abs(worst - 1.0) <= UNIT:
            raise StateError(f'orientation of the base must have unit length, got {worst:.6g}')
        self.floats = False
        motion = smooth(t, twists, None, method, cutoff)
        self._t, self._positions, self._twists = t, poses[:, :3], motion.q
        # the acceleration of the origin is that of its velocity along turning axes, and the turn
        turning = np.cross(motion.q[:, 3:], motion.q[:, :3])
        self._accelerations = motion.qd + np.hstack([turning, np.zeros_like(turning)])
        self._turns = Slerp(t, Rotation.from_quat(poses[:, 3:]))

    def at(self, t: Array) -> BaseMotion:
        """Return the motion at times (k,) [s], one row each; at the ends beyond the record."""
        within = np.clip(t, self._t[0], self._t[-1])
        twist, acceleration, position = (
            np.column_stack([np.interp(within, self._t, column) for column in columns.T])
            for columns in (self._twists, self._accelerations, self._positions)
        )
        pose = np.zeros((len(within), 4, 4))
        pose[:, :3, :3] = self._turns(within).as_matrix()
        pose[:, :3, 3], pose[:, 3, 3] = position, 1.0
        return BaseMotion(twist, acceleration, pose)

    def once(self, t: float) -> BaseMotion:
        """Return the motion at one time [s]."""
        return self.at(np.array([t])).row(0)
