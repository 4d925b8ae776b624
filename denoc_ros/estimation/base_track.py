"""Motion of a base from its measurements: interpolated, and extrapolated for a while."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from denoc_ros.dynamics.base.base_motion import BaseMotion
from denoc_ros.errors import StateError
from denoc_ros.estimation.joint_motion import smooth
from denoc_ros.types import Array


class BaseTrack:
    """Twist, acceleration and pose of a base at any time near the last readings.

    All is given and returned in the axes of the base frame, about its origin, as
    :class:`denoc_ros.dynamics.base.base_motion.BaseMotion` says. What is not measured is found
    from differences of what is, low-pass filtered: angular acceleration from rates, acceleration
    from velocities.

    Parameters
    ----------
    cutoff : float
        Of the low-pass filter on differences [Hz].
    longest : float
        How far the motion is carried on beyond the last reading [s].
    gravity : (3,) array
        As the robot has it: what an accelerometer shows is acceleration less gravity.
    mounting : (4, 4) array, optional
        Pose of the IMU in the base frame; default: it is that frame.

    Attributes
    ----------
    time : float
        Of the last reading [s], NaN before the first.
    """

    def __init__(
        self, cutoff: float, longest: float, gravity: Array, mounting: Array | None = None
    ) -> None:
        self._cutoff, self._longest = cutoff, longest
        self._mounting = np.eye(4) if mounting is None else mounting
        self._gravity = np.asarray(gravity, dtype=np.float64)
        self.reset()

    def reset(self) -> None:
        """Forget all readings."""
        self.time = self._before = math.nan
        self._twist, self._slope, self._last, self._earlier = np.zeros((4, 6))
        self._pose: Array | None = None
        self._external: Array | None = None
        self._differences = 1  # since the last gap; readings of accelerations alone need none
        self._known = False  # since the reset

    def take_odometry(self, time: float, pose: Array, twist: Array) -> None:
        """Take a pose (4, 4) in the world and a twist (6,) in.

        Its acceleration is that of the last `take_acceleration`, if there was one.
        """
        self._difference(time, twist)
        self._pose = pose
        if self._external is None:
            found = self._slope.copy()
            found[:3] += np.cross(twist[3:], twist[:3])
        else:
            found = self._external
        self._note(time, found)

    def take_acceleration(self, time: float, acceleration: Array, alone: bool) -> None:
        """Take a classical acceleration (6,) without gravity in; `alone`: nothing else comes."""
        self._external = acceleration
        if alone:
            self._note(time, acceleration)

    def take_imu(self, time: float, rate: Array, force: Array) -> None:
        """Take an angular velocity (3,) and a specific force (3,) in, along the IMU's axes.

        Where the IMU stands at r, the base's origin has the acceleration
        a - alpha x r - omega x (omega x r).
        """
        turn, arm = self._mounting[:3, :3], self._mounting[:3, 3]
        rate = turn @ rate
        self._difference(time, np.concatenate([np.zeros(3), rate]))
        angular = self._slope[3:]
        lever = np.cross(angular, arm) + np.cross(rate, np.cross(rate, arm))
        self._note(time, np.concatenate([turn @ force + self._gravity - lever, angular]))

    def _difference(self, time: float, twist: Array) -> None:
        """Update the filtered slope of the twist's components."""
        interval = time - self.time
        if not interval <= self._longest:
            self._slope[:], self._differences = 0.0, 0  # nothing is known of so long a gap
        elif interval > 0.0:
            gain = -math.expm1(-2.0 * math.pi * self._cutoff * interval)
            gain = gain if self._differences else 1.0
            self._slope += gain * ((twist - self._twist) / interval - self._slope)
            self._differences += 1
            self._known = True
        self._twist = twist

    def _note(self, time: float, acceleration: Array) -> None:
        self._before, self._earlier = self.time, self._last
        self.time, self._last = time, acceleration

    def at(self, time: float) -> BaseMotion | None:
        """Return the motion at a time [s], None before there are readings to know it from.

        After a gap it goes on from the first reading, without angular acceleration: a base that
        came to rest for one reading would shake the links.

        Accelerations are interpolated between the last two readings and held beyond them; twist
        and attitude go on by them, for `longest` at most.
        """
        if math.isnan(self.time) or not (self._differences or self._known):
            return None
        ahead = min(max(time - self.time, -self._longest), self._longest)
        acceleration = self._last
        gap = self.time - self._before
        if ahead < 0.0 and gap > 0.0:
            share = min(-ahead / gap, 1.0)
            acceleration = (1.0 - share) * self._last + share * self._earlier
        twist = self._twist + ahead * self._slope
        pose = self._pose
        if pose is not None:
            turn, pose = pose[:3, :3], pose.copy()
            pose[:3, 3] += ahead * turn @ self._twist[:3]
            pose[:3, :3] = turn @ Rotation.from_rotvec(ahead * self._twist[3:]).as_matrix()
        return BaseMotion(twist, acceleration, pose)


# the base of a recorded run ---------------------------------------------------------------------

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
