"""The desired motion of the `reference` topic: an interpolated trajectory, or a stream."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

import numpy as np

from denoc_ros.control.braking import brake
from denoc_ros.kernels.compiled import ready
from denoc_ros.kernels.spline import sample_quintics
from denoc_ros.runtime.input_monitor import InputError
from denoc_ros.runtime.motion_bounds import MotionBounds
from denoc_ros.runtime.trajectory_messages import TrajectoryMessage
from denoc_ros.trajectories import SplineTrajectory
from denoc_ros.types import Array

MOST_COMING = 64  # trajectories that wait for their start
BRAKING, BRAKING_STEP = 0.3, 0.01  # s from a cancel to rest, and between knots of that


class FiniteDifferencer:
    """Rates of streamed points by backward differences.

    Parameters
    ----------
    gap : float
        s between points after which a difference means nothing and is taken as zero.
    cutoff : float
        Hz of the first-order low pass on differenced accelerations, infinite for none.
    bounds : MotionBounds, optional
        What the joints can have; default everything.
    """

    def __init__(
        self, joints: int, gap: float, cutoff: float = math.inf, bounds: MotionBounds | None = None
    ) -> None:
        self._bounds = bounds
        self._gap = gap
        self._cutoff = cutoff
        self._time = -math.inf
        self._q: Array = np.zeros(joints)
        self._qd: Array = np.zeros(joints)
        self._qdd: Array = np.zeros(joints)
        self.interval = 0.0

    def complete(
        self, time: float, q: Array, qd: Array | None, qdd: Array | None
    ) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration (n,) of a point at `time` [s].

        Raises
        ------
        InputError
            Cause `out_of_range`: points too far apart for so short a time; it is not taken.
        """
        step = time - self._time
        near = 0.0 < step <= self._gap
        if qd is None:
            qd = (q - self._q) / step if near else np.zeros_like(q)
        if qdd is None:
            qdd = self._filtered((qd - self._qd) / step, step) if near else np.zeros_like(q)
        if self._bounds is not None and near:
            self._bounds.require_rates(qd, qdd)
        self.interval = step if near else 0.0
        self._time, self._q, self._qd, self._qdd = time, q, qd, qdd
        return q, qd, qdd

    def _filtered(self, qdd: Array, step: float) -> Array:
        if self._cutoff == math.inf:
            return qdd
        share = 1.0 - math.exp(-2.0 * math.pi * self._cutoff * step)
        return np.asarray(self._qdd + share * (qdd - self._qdd), dtype=np.float64)


class ReferenceFollower:
    """The desired motion on the steady clock; offered by one thread, sampled by another.

    A trajectory starts at its stamp (0: now), until then the one before goes on; after its end it
    holds. A streamed point counts from its arrival; up to the next one, and at most for one
    interval of the stream, it goes on with its velocity and acceleration. Joints that a message
    does not name stay where they are wanted, else where they stand. A message without points
    brings the motion to rest along its path within `BRAKING`, no joint faster than it is.

    Parameters
    ----------
    joints, gap, bounds
        As of :class:`FiniteDifferencer`.
    """

    def __init__(self, joints: int, gap: float, bounds: MotionBounds | None = None) -> None:
        self._joints = joints
        self._lock = threading.Lock()
        self._stream = FiniteDifferencer(joints, gap, bounds=bounds)
        self._now: SplineTrajectory | None = None
        self._now_start = 0.0
        self._coming: list[tuple[SplineTrajectory, float]] = []  # by their starts
        self._point: tuple[Array, Array, Array] | None = None
        self._point_time = -math.inf
        self._horizon = 0.0
        ready(sample_quintics)  # not by the first reference, in a loop

    @property
    def given(self) -> bool:
        """Whether there is any reference."""
        return self._has_current() or bool(self._coming)

    @property
    def streamed(self) -> bool:
        """Whether the newest reference is a stream, which can go stale."""
        return self._point is not None

    @property
    def horizon(self) -> float:
        """How long the last streamed point goes on with its rate [s]: the stream's interval."""
        return self._horizon

    def age(self, now: float) -> float:
        """Return how long ago [s] the last streamed point came; 0 for a trajectory."""
        if self._point is None and not self._coming:
            return 0.0
        with self._lock:
            self._take_due(now)
            return now - self._point_time if self._point is not None else 0.0

    def trajectories(self) -> list[tuple[SplineTrajectory, float]]:
        """Return the trajectory that is followed and those to come, with their starts [s]."""
        with self._lock:
            begun = [] if self._now is None else [(self._now, self._now_start)]
            return [*begun, *self._coming]

    def finished(self, now: float) -> bool:
        """Say whether a trajectory is at its end and holds."""
        trajectory = self._now
        return trajectory is not None and now - self._now_start >= trajectory.duration

    def clear(self) -> None:
        """Forget everything."""
        with self._lock:
            self._now = self._point = None
            self._coming.clear()

    def forget_begun(self, now: float) -> None:
        """Forget motions that have begun by steady `now` [s]; a trajectory still to come stays."""
        with self._lock:
            self._point = None
            if self._now is not None and self._now_start <= now:
                self._now = None

    def offer(
        self,
        message: TrajectoryMessage,
        now: float,
        now_ns: int,
        measured: Array | None = None,
        admit: Callable[[], None] = lambda: None,
    ) -> None:
        """Take a message.

        Parameters
        ----------
        now, now_ns : float, int
            When it arrived: steady clock [s], ROS time [ns].
        measured : (n,) array, optional
            Where the joints stand: there a trajectory begins whose first point is for later,
            if nothing was followed before.
        admit : callable, optional
            Called when the message is good, before it counts; may raise InputError.

        Raises
        ------
        InputError
            Cause `missing_joint`: it does not name all joints, and nothing says where they are;
            `flood`: too many wait for their start; `out_of_range`: of differences of a stream.
        """
        begin = now + (1e-9 * (message.stamp_ns - now_ns) if message.stamp_ns else 0.0)
        held = list(message.held)
        if held:
            message = self._whole(message, now if message.is_streamed else begin, measured)
        if begin > now and len(self._coming) >= MOST_COMING:
            rule = f'at most {MOST_COMING} trajectories must wait for their start'
            raise InputError('flood', f'{rule}, got one more')
        admit()
        if message.is_cancel:
            self._stop(now)
            return
        if message.is_streamed:
            time = 1e-9 * message.stamp_ns if message.stamp_ns else now
            self.offer_point(now, *self._stream.complete(time, *message.first))
            return
        first = None
        if message.times[0] > 0.0 and (self.given or measured is not None):
            q, qd, qdd = np.zeros((3, message.positions.shape[1]))
            with self._lock:
                going = self._plan(begin, q, qd, qdd)
            if not going and measured is not None:
                q[:] = measured
            qd[held] = qdd[held] = 0.0
            first = q, qd, qdd
        trajectory = SplineTrajectory(
            message.times, message.positions, message.velocities, message.accelerations, first
        )
        with self._lock:
            self._coming = [each for each in self._coming if each[1] < begin]
            self._coming.append((trajectory, begin))

    def _whole(
        self, message: TrajectoryMessage, moment: float, measured: Array | None
    ) -> TrajectoryMessage:
        """Return a message that names all joints."""
        q, qd, qdd = np.zeros((3, self._joints))
        with self._lock:
            going = self._plan(moment, q, qd, qdd)
        if not going and measured is None:
            raise InputError(
                'missing_joint',
                'reference must name all joints while neither a reference nor joint states give '
                f'the positions of the others, got none for {len(message.held)} of {self._joints}',
            )
        return message.holding(q if going or measured is None else measured)

    def _stop(self, now: float) -> None:
        """Come to rest along the path, and drop the trajectories to come."""
        with self._lock:
            self._take_due(now)
            self._coming.clear()
            if self._now is not None:
                left = self._now, now - self._now_start
                rows = brake(*left, BRAKING, BRAKING_STEP, lambda *_motion: True)
                if rows is not None:  # it is not at rest before
                    self._now, self._now_start = SplineTrajectory(*rows), now
            elif self._point is not None:
                self._now, self._now_start = self._streamed_to_rest(now), now
                self._point = None

    def _streamed_to_rest(self, now: float) -> SplineTrajectory:
        """Return the motion that goes on from a stream's last point, slower and slower."""
        q, qd, qdd = np.zeros((3, self._joints))
        self._extrapolate(now, q, qd, qdd)
        rest = np.zeros(self._joints)
        rows = np.stack([q, q + 0.5 * BRAKING * qd])
        times = np.array([0.0, BRAKING])
        return SplineTrajectory(times, rows, np.stack([qd, rest]), np.stack([qdd, rest]))

    def offer_point(self, now: float, q: Array, qd: Array, qdd: Array) -> None:
        """Take a streamed point that is for steady `now`."""
        with self._lock:
            self._point = q, qd, qdd
            self._point_time = now
            self._horizon = self._stream.interval
            self._now = None
            self._coming.clear()

    def sample(self, now: float, q: Array, qd: Array, qdd: Array) -> bool:
        """Write the motion wanted at steady `now` into (n,) arrays; say whether there is one."""
        with self._lock:
            if self._coming:
                self._take_due(now)
            return self._evaluate(now, q, qd, qdd)

    def _take_due(self, now: float) -> None:
        """Let a trajectory that has begun, or the first one there is, take over."""
        while self._coming and (now >= self._coming[0][1] or not self._has_current()):
            self._now, self._now_start = self._coming.pop(0)
            self._point = None

    def _has_current(self) -> bool:
        return self._now is not None or self._point is not None

    def _plan(self, moment: float, q: Array, qd: Array, qdd: Array) -> bool:
        due = [each for each in self._coming if each[1] <= moment]
        if not due:
            return self._evaluate(moment, q, qd, qdd)
        trajectory, start = due[-1]
        trajectory.sample(moment - start, q, qd, qdd)
        return True

    def _evaluate(self, now: float, q: Array, qd: Array, qdd: Array) -> bool:
        if self._now is not None:
            self._now.sample(now - self._now_start, q, qd, qdd)
            return True
        if self._point is not None:
            self._extrapolate(now, q, qd, qdd)
            return True
        return False

    def _extrapolate(self, now: float, q: Array, qd: Array, qdd: Array) -> None:
        assert self._point is not None
        position, rate, acceleration = self._point
        h = min(max(0.0, now - self._point_time), self._horizon)
        np.multiply(acceleration, h, out=qd)
        np.multiply(qd, 0.5, out=q)
        qd += rate
        q += rate
        q *= h
        q += position
        qdd[:] = acceleration
