"""The desired motion of the `reference` topic: an interpolated trajectory, or a stream."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.kernels.algebra.spline import sample_quintics
from denoc_ros.kernels.jit.compiled import ready
from denoc_ros.runtime.inputs.input_monitor import InputError
from denoc_ros.runtime.inputs.joint_gate import JointGate, JointSample, joint_gate
from denoc_ros.runtime.inputs.trajectory_messages import TrajectoryMessage
from denoc_ros.runtime.reference.braking import brake
from denoc_ros.runtime.safety.motion_bounds import MotionBounds, largest_accelerations
from denoc_ros.trajectories import SplineTrajectory
from denoc_ros.types import Array

MOST_COMING = 64  # trajectories that wait for their start
OWN_RATES = 2.0  # A trajectory is joined at most so many times faster than it goes itself.
BRAKING, BRAKING_STEP = 0.3, 0.01  # s from a cancel to rest, and between knots of that


class FiniteDifferencer:
    """Rates of streamed points by backward differences, with bounded accelerations.

    Where points without rates ask for more than the largest accelerations, as after a jump, the
    motion goes to them as fast as these allow.

    Parameters
    ----------
    gap : float
        s between points after which a difference means nothing and is taken as zero.
    cutoff : float
        Hz of the first-order low pass on differenced accelerations, infinite for none.
    bounds : MotionBounds, optional
        What the joints can have; default everything.
    acceleration : (n,) array, optional
        Largest accelerations [rad/s^2 or m/s^2], infinite, as by default, where not known.
    """

    def __init__(
        self,
        joints: int,
        gap: float,
        cutoff: float = math.inf,
        bounds: MotionBounds | None = None,
        acceleration: Array | None = None,
    ) -> None:
        self._bounds = bounds
        self._gap = gap
        self._cutoff = cutoff
        largest = np.full(joints, np.inf) if acceleration is None else acceleration
        self._limited = np.isfinite(largest)
        self._largest = np.where(self._limited, largest, 0.0)
        self._time = -math.inf
        self._given: Array = np.zeros(joints)  # position of the last point
        self._q: Array = np.zeros(joints)
        self._qd: Array = np.zeros(joints)
        self._qdd: Array = np.zeros(joints)
        self.interval = 0.0

    def complete(
        self,
        time: float,
        q: Array,
        qd: Array | None,
        qdd: Array | None,
        present: tuple[Array, Array] | None = None,
    ) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration (n,) of a point at `time` [s].

        Parameters
        ----------
        present : pair of (n,) arrays, optional
            Position and rate at the time of a point that does not continue the points before.

        Raises
        ------
        InputError
            Cause `out_of_range`: points too far apart for so short a time; it is not taken.
        """
        step, given = time - self._time, q
        near = 0.0 < step <= self._gap and present is None
        if qd is None and near:
            q, qd = self._approach(q, step)
        elif qd is None and present is not None:
            q = np.where(self._limited, present[0], q)
            qd = np.where(self._limited, present[1], 0.0)
        elif qd is None:
            qd = np.zeros_like(q)
        if qdd is None:
            qdd = self._filtered((qd - self._qd) / step, step) if near else np.zeros_like(q)
        if self._bounds is not None and near:
            self._bounds.require_rates(qd, qdd)
        self.interval = step if near else 0.0
        self._time, self._given, self._q, self._qd, self._qdd = time, given, q, qd, qdd
        return q, qd, qdd

    def _approach(self, q: Array, step: float) -> tuple[Array, Array]:
        """Return position and rate (n,) on the way to a point (n,) after a step [s].

        Notes
        -----
        The distance beyond the point's own step is closed at the rate from which the largest
        acceleration stops in discrete steps: v + a h / 2 = sqrt((a h / 2)^2 + 2 a e).
        """
        free, largest = ~self._limited, self._largest
        rate = (q - self._given) / step
        distance = q - self._q - rate * step
        change = largest * step
        fastest = np.sqrt(0.25 * change * change + 2.0 * largest * np.abs(distance))
        closing = np.minimum(np.abs(distance) / step, fastest - 0.5 * change)
        wanted = rate + np.copysign(closing, distance)
        qd = np.where(free, rate, np.clip(wanted, self._qd - change, self._qd + change))
        # A point that is reached has its position without rounding.
        reached = (qd == wanted) & (np.abs(distance) <= closing * step * (1.0 + 1e-9))
        return np.where(free | reached, q, self._q + step * qd), qd

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
    joints, gap, bounds, acceleration
        As of :class:`FiniteDifferencer`.
    gate : JointGate, optional
        It refuses streamed points that contradict the motion; default none.
    """

    def __init__(
        self,
        joints: int,
        gap: float,
        bounds: MotionBounds | None = None,
        gate: JointGate | None = None,
        acceleration: Array | None = None,
    ) -> None:
        self._joints = joints
        self._lock = threading.Lock()
        self._gate = gate
        self._stream = FiniteDifferencer(joints, gap, math.inf, bounds, acceleration)
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
            self._forget_stream()

    def _forget_stream(self) -> None:
        """Judge the next streamed point by itself."""
        if self._gate is not None:
            self._gate.reset()

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
        refuse: Callable[[InputError], None] = lambda error: None,
    ) -> int:
        """Take a message; return how many count from now on: 0 if a point waits for the next.

        Parameters
        ----------
        now, now_ns : float, int
            When it arrived: steady clock [s], ROS time [ns].
        measured : (n,) array, optional
            Where the joints stand: there a trajectory begins whose first point is for later,
            if nothing was followed before.
        admit : callable, optional
            Called when the message is good, before it counts; may raise InputError.
        refuse : callable, optional
            Takes the refusal of a streamed point that waited.

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
            return 1
        if message.is_streamed:
            return self._offer_streamed(message, now, measured, refuse)
        trajectory, begin = self._joined(message, begin, now, measured, held)
        with self._lock:
            self._forget_stream()
            self._coming = [each for each in self._coming if each[1] < begin]
            self._coming.append((trajectory, begin))
        return 1

    def _offer_streamed(
        self,
        message: TrajectoryMessage,
        now: float,
        measured: Array | None,
        refuse: Callable[[InputError], None],
    ) -> int:
        """Take a streamed point; return how many points pass with it."""
        time = 1e-9 * message.stamp_ns if message.stamp_ns else now
        sample = JointSample(time, *message.first)
        passed = [sample]
        q, qd, qdd = np.zeros((3, self._joints))
        if self._gate is not None:
            with self._lock:
                near = q if self._evaluate(now, q, qd, qdd) else measured
                passed = self._gate.offer(sample, refuse, near)
                if not passed:  # The motion goes on until the next point.
                    self._horizon = 2.0 * self._stream.interval
        for each in passed:
            motion = each.position, each.velocity, each.acceleration
            present = (q, qd) if each.restarts else None
            point = self._stream.complete(each.time, *motion, present)
            self.offer_point(now, *point)
        return len(passed)

    def _joined(
        self,
        message: TrajectoryMessage,
        begin: float,
        now: float,
        measured: Array | None,
        held: list[int],
    ) -> tuple[SplineTrajectory, float]:
        """Return a trajectory that continues the reference, and its start [s].

        Parameters
        ----------
        begin : float
            Time of the trajectory's time 0 [s].
        held : list of int
            Places of joints that the message does not name.
        """
        positions, q, qd, qdd = message.positions, *np.zeros((3, self._joints))

        def reference_at(moment: float) -> bool:
            with self._lock:
                going = self._plan(moment, q, qd, qdd)
            if not going and measured is not None:
                q[:] = measured
            qd[held] = qdd[held] = 0.0
            return going

        going = reference_at(max(begin, now))
        known = going or measured is not None
        if self._gate is not None and known:
            offset = self._gate.begin_path(float(message.times[0]), positions[0], q)
            message = replace(message, positions=positions + offset)
        if going and message.velocities is None:
            joined = _join(message, max(0.0, now - begin), (q, qd, qdd))
            if joined is not None:
                return joined, max(begin, now)
        first = None
        if known and message.times[0] > 0.0:
            reference_at(begin)
            first = q, qd, qdd
        times, rates, changes = message.times, message.velocities, message.accelerations
        return SplineTrajectory(times, message.positions, rates, changes, first), begin

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


def _join(
    message: TrajectoryMessage, late: float, state: tuple[Array, Array, Array]
) -> SplineTrajectory | None:
    """Return the rest of a trajectory without rates, from the present state on.

    None for one that begins later, or that is not on the way: then the state would have to go to
    the next point faster than the trajectory goes from point to point.

    Parameters
    ----------
    late : float
        How long ago the trajectory's time 0 was [s].
    state : (n,) arrays
        Position, velocity, acceleration of the reference now.
    """
    times, positions, accelerations = message.times, message.positions, message.accelerations
    if len(times) < 2 or not (late > 0.0 or times[0] == 0.0):
        return None
    # To a point that is too near, the smallest distance would take a large rate.
    rest = times > late + 0.5 * float(np.median(np.diff(times)))
    if not rest.any():
        return None
    q, qd, _ = state
    rate = (positions[rest][0] - q) / (times[rest][0] - late)
    steps = np.diff(positions, axis=0) / np.diff(times)[:, None]
    if (np.abs(rate) > np.abs(qd) + OWN_RATES * np.abs(steps).max(axis=0)).any():
        return None
    rest &= times >= late + _joining_time(message, late, q, steps)
    rest[-1] = True
    changes = None if accelerations is None else accelerations[rest]
    return SplineTrajectory(times[rest] - late, positions[rest], None, changes, state)


def _joining_time(message: TrajectoryMessage, late: float, q: Array, steps: Array) -> float:
    """Return how long it takes to join a trajectory, with accelerations like its own [s].

    Parameters
    ----------
    steps : (k - 1, n) array
        Mean velocities between the points.
    """
    times = message.times
    if late < times[0] or len(times) < 3:
        return 0.0
    there = [np.interp(late, times, column) for column in message.positions.T]
    bends = np.abs(np.diff(steps, axis=0)) / (0.5 * (times[2:] - times[:-2]))[:, None]
    # A cubic that closes a distance d in a time T begins with the acceleration 6 d / T^2.
    wanted, own = 6.0 * np.abs(q - there), bends.max(axis=0)
    times_squared = np.divide(wanted, own, out=np.zeros_like(own), where=own > 0.0)
    return float(np.sqrt(times_squared.max()))


def reference_follower(
    robot: Robot, joints: Sequence[str], gap: float, bounds: MotionBounds, posture: Array
) -> ReferenceFollower:
    """Return the follower of a reference of some of a robot's joints.

    Parameters
    ----------
    gap, bounds
        As of :class:`ReferenceFollower`.
    posture : (n,) array
        In which effort limits are taken as limits of accelerations.
    """
    largest = largest_accelerations(robot, joints, posture)
    return ReferenceFollower(len(joints), gap, bounds, joint_gate(robot, joints), largest)
