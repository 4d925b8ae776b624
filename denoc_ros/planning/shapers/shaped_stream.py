"""A streamed motion through an input shaper, on the steady clock."""

from __future__ import annotations

import numpy as np

from denoc_ros.planning.shapers.joint_servo import JointServo
from denoc_ros.planning.shapers.ringing import RingingModes
from denoc_ros.planning.shapers.stream_shaper import StreamShaper
from denoc_ros.runtime.reference.reference import ReferenceFollower
from denoc_ros.types import Array


class ShapedStream:
    """Commands of the joints, tick by tick, while single points come and until the joints rest.

    Points that stop coming are no reason to stop dead: the joints go on with their last rate until
    the stream is stale, then they brake.

    Parameters
    ----------
    period : float
        s between ticks.
    stale_after, stop_time : float
        s without points after which the joints brake, and for how long.
    follower : ReferenceFollower, optional
        It takes the points; default one of all points.

    Attributes
    ----------
    ending : bool
        Whether the joints brake whatever comes.
    """

    def __init__(
        self,
        joints: int,
        period: float,
        stale_after: float,
        stop_time: float,
        follower: ReferenceFollower | None = None,
    ) -> None:
        self._period = period
        self._stale_after, self._stop_time = stale_after, stop_time
        self.follower = follower or ReferenceFollower(joints, stale_after)
        self._shaper: StreamShaper | None = None
        self._servo: JointServo | None = None
        self._q, self._qd, self._qdd = np.zeros((3, joints))
        self._rate = np.zeros(joints)
        self._braking = 0.0
        self._quiet = 0.0
        self.ending = False
        self.last: Array = np.zeros(joints)

    @property
    def active(self) -> bool:
        """Whether the joints are told anything."""
        return self._shaper is not None

    @property
    def delay(self) -> float:
        """How much later a motion ends [s]."""
        shaper = self._shaper
        return shaper.delay if shaper is not None else 0.0

    def begin(self, method: str, modes: RingingModes, start: Array, servo: JointServo) -> None:
        """Begin to shape; the joints stand at `start` (joints,)."""
        self._servo = servo
        self._braking = self._quiet = 0.0
        self._q[:], self.last = start, np.array(start)
        self._qd[:] = self._qdd[:] = 0.0
        self._shaper = StreamShaper(method, *modes, np.array(start), self._period)

    def retune(self, modes: RingingModes) -> None:
        """Take the modes of another posture or payload."""
        shaper = self._shaper
        if shaper is not None:
            shaper.retune(modes.frequencies)

    def brake(self) -> None:
        """Bring the joints to rest; then they are told nothing more."""
        self.ending = self.active

    def end(self) -> None:
        """Forget everything: the joints are told nothing more."""
        self._shaper = None
        self.ending = False
        self.follower.clear()

    def tick(self, now: float, steps: int) -> Array | None:
        """Commands of the joints now (3, joints); None where there are none."""
        shaper = self._shaper
        if shaper is None:
            return None
        for _ in range(min(steps, 1 + int(0.1 / self._period))):
            self._input(now)
            row = shaper.step(self._q, self._qd, self._qdd)
        self.last = row[0]
        if self._quiet > shaper.delay + 2.0 * self._period:
            self.end()
            row[1:] = 0.0
        return self._commanded(row)

    def _input(self, now: float) -> None:
        """Take the input's next sample: along the points, else coasting, then braking."""
        follower, h = self.follower, self._period
        age = follower.age(now)
        if age <= self._stale_after and not self.ending:
            self._braking = self._quiet = 0.0
            if age > follower.horizon + h or not follower.sample(
                now, self._q, self._qd, self._qdd
            ):
                self._q += h * self._qd  # the next point is late: on with the last rate
                self._qdd[:] = 0.0
            self._rate[:] = self._qd
            return
        left = max(0.0, self._stop_time - self._braking)
        if left > h:
            self._qdd[:] = -self._rate / self._stop_time
            self._q += h * self._qd + 0.5 * h * h * self._qdd
            self._qd += h * self._qdd
        else:
            self._q += 0.5 * h * self._qd
            self._qd[:] = self._qdd[:] = 0.0
            self._quiet += h
        self._braking += h

    def _commanded(self, row: Array) -> Array:
        """Invert the joints' servos, but for delay and jerk."""
        servo = self._servo
        if servo is None or np.isinf(servo.bandwidth).all():
            return row
        omega = 2.0 * np.pi * servo.bandwidth
        lag, inertia = 2.0 * servo.damping / omega, 1.0 / omega**2
        q, qd, qdd = row
        return np.stack((q + lag * qd + inertia * qdd, qd + lag * qdd, qdd))
