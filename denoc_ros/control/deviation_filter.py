"""Where the robot is beside its plan, from joints and sensors as they come."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from denoc_ros.control.feedback_design import PostureGains
from denoc_ros.control.gain_schedule import GainSchedule
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.trail import Trail

Array = NDArray[np.float64]

HISTORY = 256  # periods over which values may be late
GATE = 6.0  # standard deviations of an innovation beyond which a sensor's value is refused
WIDENING = 2.0  # per s: how the gate opens while the estimate is not believed
REGAIN = 0.2  # s of good values until the estimate is believed again


class DeviationFilter:
    """The estimate [y; forces] of deviations from a plan; allocates little per tick.

    A value is compared with what plan and estimate had at its own stamp. The estimate is believed
    while every sensor that is read has given a value within the gate of late, and the joints too.

    Parameters
    ----------
    robot : Robot
        The model; worked on as a copy.
    schedule : GainSchedule

    Attributes
    ----------
    state : (2 m + d,) array
        y and the forces that the model does not know.
    believed : bool
    cause : str
        Why it is not believed, '' if it is.
    refused : (read,) int array
        Values beyond the gate, per sensor.
    """

    def __init__(self, robot: Robot, schedule: GainSchedule) -> None:
        self._robot = robot.copy()
        self._joints, self._sensors = schedule.joints, schedule.sensors
        self._names = [robot.tree.sensors[k].name for k in self._sensors]
        self._timeout = schedule.settings.sensor_timeout
        gains = schedule.gains[0]
        self._k, seen = len(self._joints), len(gains.measured)
        self.state: Array = np.zeros(len(gains.transition))
        self.refused = np.zeros(len(self._sensors), dtype=np.int64)
        self._values, self._stamps = np.zeros(seen), np.zeros(seen)
        self._new = np.zeros(seen, dtype=np.bool_)
        self._innovation = np.zeros(seen)
        self._good_at = np.zeros(seen)
        self._plan, self._own = Trail(HISTORY, seen), Trail(HISTORY, seen)
        self._slot = {int(place): 2 * self._k + at for at, place in enumerate(self._sensors)}
        self.reset()

    def reset(self) -> None:
        """Forget the deviations: the robot counts as on its plan, and that is not believed."""
        self.state[:] = 0.0
        self._plan.clear()
        self._own.clear()
        self._new[:] = False
        self._good_at[:] = -np.inf
        self.believed, self.cause = False, 'no measurements yet'
        self._lost_at = self._doubted_at = np.nan

    def take_model(self, other: DeviationFilter) -> None:
        """Go on by the model of another filter of the same coordinates and sensors."""
        self._robot, self._timeout = other._robot, other._timeout

    def follow(self, time: float, q: Array, qd: Array) -> None:
        """Take the plan's coordinates and rates (n,) at a time of the loop's clock [s]."""
        if len(self._plan) and time <= self._plan.last:
            return
        expected = self._plan.push(time)
        k = self._k
        expected[:k], expected[k : 2 * k] = q[self._joints], qd[self._joints]
        if len(self._sensors):
            expected[2 * k :] = self._robot.sensor_values(q, qd)[self._sensors]

    def take_joints(self, stamp: float, q: Array, qd: Array | None) -> None:
        """Take measured positions (joints,) and, if known, rates of a time [s]."""
        k = self._k
        self._values[:k], self._stamps[:k], self._new[:k] = q, stamp, True
        if qd is not None:
            self._values[k : 2 * k], self._stamps[k : 2 * k] = qd, stamp
            self._new[k : 2 * k] = True

    def take_sensor(self, place: int, stamp: float, value: float) -> None:
        """Take a value of one of the robot's sensors, measured at a time [s]."""
        slot = self._slot.get(place)
        if slot is not None:
            self._values[slot], self._stamps[slot], self._new[slot] = value, stamp, True

    def correct(self, now: float, gains: PostureGains) -> None:
        """Take what has come into the estimate of now [s], and say whether to believe that."""
        if np.isnan(self._lost_at):
            self._lost_at = self._doubted_at = now
        own = self._own.push(now)
        np.dot(gains.measured, self.state[: gains.measured.shape[1]], out=own)
        innovation, new, stamps = self._innovation, self._new, self._stamps
        innovation[:] = 0.0
        if not len(self._plan):
            new[:] = False
        new &= stamps >= self._own.first
        for stamp in set(stamps[new].tolist()):
            at = np.flatnonzero(new & (stamps == stamp))
            expected = self._plan.at(stamp) + self._own.at(stamp)
            innovation[at] = self._values[at] - expected[at]
        self._refuse(now, gains.spread)
        self._good_at[new] = stamps[new]
        new[:] = False
        self.state += gains.correction @ innovation
        self._judge(now)

    def _refuse(self, now: float, spread: Array) -> None:
        """Leave out sensors' values that are too far off."""
        first = 2 * self._k
        ratio = np.abs(self._innovation[first:]) / spread[first:]
        far = ~(ratio <= GATE)
        if far.any():
            wide = GATE if self.believed else GATE * (1.0 + WIDENING * (now - self._lost_at))
            self._innovation[first:][~(ratio <= wide)] = 0.0
            self._new[first:][far] = False
            self.refused += far

    def _judge(self, now: float) -> None:
        """Decide whether to believe the estimate."""
        age = now - self._good_at
        age[self._k : 2 * self._k] = 0.0  # rates need not be measured
        cause = ''
        if not np.isfinite(self.state).all():
            self.state[:] = 0.0
            cause = 'estimate not finite'
        elif not age.max() <= self._timeout:
            worst = int(np.argmax(age)) - 2 * self._k
            cause = f'no good values of {self._names[worst] if worst >= 0 else "the joints"}'
        if cause:
            if self.believed:
                self._lost_at = now
            self.believed, self.cause, self._doubted_at = False, cause, now
        elif not self.believed and now - self._doubted_at >= REGAIN:
            self.believed, self.cause = True, ''

    def go_on(self, gains: PostureGains, pushes: Array, periods: int) -> None:
        """Bring the estimate forward by some periods under torques on their way and the new."""
        s = len(gains.push)
        for _ in range(periods):
            self.state = gains.transition @ self.state
            self.state[:s] += gains.push @ pushes
