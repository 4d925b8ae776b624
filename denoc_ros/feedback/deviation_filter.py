"""Kalman filter of the deviations from the plan, from joints and sensors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.driven.measured_side import MeasuredStates, measured_robot, whole_robot
from denoc_ros.dynamics.elastic.state_history import StateHistory
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import StateError
from denoc_ros.estimation.fusion import FusionSettings
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.estimation.sensor_faults import SensorFaults
from denoc_ros.feedback.beginning import ASTRAY, NEAR, Beginning
from denoc_ros.feedback.feedback_design import BIASES, PostureGains
from denoc_ros.feedback.gain_schedule import GainSchedule
from denoc_ros.feedback.kernels.deviation_kernels import compare, correct_estimate, sift
from denoc_ros.feedback.model_errors import ErrorEstimate
from denoc_ros.feedback.read_values import chosen_values, numbered_values
from denoc_ros.feedback.residual_modes import is_hardened
from denoc_ros.kernels.jit.compiled import entry
from denoc_ros.types import Array

FILTER_KERNELS = (compare, correct_estimate, sift)
HISTORY = 256  # periods over which values may be late
# standard deviations of an innovation beyond which a sensor's value is refused: a tick that
# comes late looks like many
GATE = 20.0
RESTART = 0.5  # s without belief after which the estimate starts anew from what is measured
LARGEST = 1e3  # m or rad, and per s: no deviation is that large
AGEING = 0.02  # weight of the newest values' age in the usual one
BRIEF = 0.06  # s of a pause that leaves no more than the gains of every period undo
UNSEEN = 0.01  # s of a pause that shows neither for an error of the model nor for a fault
UNCLEAR = 0.6  # s after a longer one in which what it left may contradict the sensors
DOUBTED = 0.3  # of what held torque did in a pause: so far the model may be off
WAITS = 0.5  # s in which it becomes clear where a robot is that went astray
BEGINS = 1.0  # s in which it is found out where an estimate begins
FIRST = 0.06  # s from one correction of where the estimate began to the next
LEARNS_AFTER_S = 1.0  # Time after a fault until the estimate is free of it and learns [s].
# Assumed error of the model's forces, in the detection of faulty sensors: stiffness 20 % too low
# and load 20 % too high together change the deflection by a third and more.
MODEL_ERROR_SHARE = 0.4
REGAIN = 0.2  # s of good values until the estimate is believed again


class Pause(NamedTuple):
    """An interruption of the loop: its torque (2 m,), its length, its end [s]."""

    pushed: Array
    seconds: float
    end: float  # of what is measured


class DeviationFilter:
    """The estimate [y; forces; biases] of deviations from a plan; allocates little per tick.

    A value is compared with what plan and estimate had at its own stamp. While a sensor that is
    read has given no value of late within the gate, the joints alone correct the estimate, which
    is not believed. Sensors that speak again are listened to within wide bounds, and believed when
    all have agreed for a while. A sensor that contradicts the estimate is left out at once, and
    the estimate is not believed. An observer of the joints' motion runs in parallel: its detection
    of faults excludes the faulty sensor; the others still tell the model's errors.

    Parameters
    ----------
    robot : Robot
        The model; worked on as a copy.
    schedule : GainSchedule

    Attributes
    ----------
    state : (e,) array
        y, the forces that the model does not know, and the biases of gyroscopes.
    believed : bool
    blind : bool
        Whether the joints alone correct it.
    cause : str
        Why it is not believed, '' if it is.
    refused : (read,) int array
        Values beyond the gate, per sensor.
    errors : ErrorEstimate or None
        Of the model's errors, where the schedule knows what they do.
    time : float
        Of the schedule, now [s].
    joints : (2 joints,) array
        Deviations of the measured joints and their rates, as they were measured last.
    joints_at : float
        When that was [s].
    """

    def __init__(self, robot: Robot, schedule: GainSchedule) -> None:
        self._robot = robot = whole_robot(robot).copy()
        self._sensors = schedule.sensors
        names = schedule.names
        self._states = MeasuredStates(robot, names)
        values = chosen_values(robot.tree, self._sensors)
        self._names = [value.name for value in values]
        self._places = [value.place for value in values]
        rates = [value.kind == 'gyro' for value in values]
        self._turning = any(rates)
        # with gyroscopes alone, what is missing of a rate stays as a deflection
        self._brief = 0.0 if values and all(rates) else BRIEF
        self._timeout = schedule.settings.sensor_timeout
        self._period = schedule.settings.period
        gains = schedule.gains[0]
        self._k, seen = len(names), len(gains.measured)
        # values that may be far off: of sensors that are believed a rate after a pause, to be
        # corrected and not refused, and any value of others
        self._rates = np.array([False] * (2 * self._k) + rates, dtype=np.bool_)
        self._any = np.ones(seen, dtype=np.bool_)
        bias = np.concatenate([np.zeros(2 * self._k), [value.bias for value in values]])
        self._biased, self._most_bias = np.flatnonzero(bias), BIASES * bias[bias > 0.0]
        self._unbiased = np.ones(len(self._biased), dtype=np.bool_)
        self._deviations = len(gains.push)
        self._rows = gains.measured[:, : self._deviations]  # the joints' are the same everywhere
        self.state: Array = np.zeros(len(gains.transition))
        self.refused = np.zeros(len(self._sensors), dtype=np.int64)
        self._values, self._stamps = np.zeros(seen), np.zeros(seen)
        self._new = np.zeros(seen, dtype=np.bool_)
        self._good, self._heard = np.zeros(seen, dtype=np.bool_), np.ones(seen, dtype=np.bool_)
        self._found = np.zeros(4)
        self._innovation, self._surprise = np.zeros((2, seen))
        self._good_at = np.zeros(seen)
        self._beginning: Beginning | None = None
        self._starts = np.inf  # when what has been measured says next where it began
        self._plan, self._own = StateHistory(HISTORY, seen), StateHistory(HISTORY, seen)
        self._slot = {int(place): 2 * self._k + at for at, place in enumerate(self._sensors)}
        self._pause: Pause | None = None
        self.errors: ErrorEstimate | None = None
        self._checker: Observer | None = None
        if schedule.errors is not None:
            self._checker = _sensor_checker(robot, names, self._period)
            checked = 0 if self._checker is None else len(values)
            self.errors = ErrorEstimate(schedule.errors, self._period, gains, checked)
        self.joints, self.joints_at = np.zeros(2 * self._k), -np.inf
        self._has_rates = math.isfinite(schedule.settings.velocity_noise)
        self.time = 0.0
        self._none = np.zeros((len(self.state), 0))  # of errors
        self._compare, self._correct, self._sift = map(entry, FILTER_KERNELS)
        self.reset()

    def reset(self) -> None:
        """Forget the deviations: the robot counts as on its plan, and that is not believed."""
        if self.errors is not None:
            self.errors.reset()
        if self._checker is not None:
            self._checker.reset()
        self._heard[:], self._suspected, self._excluded = True, False, 0
        self._forget()
        self._plan.clear()
        self._own.clear()
        self._new[:] = False
        self._good_at[:] = -np.inf
        self.believed, self.cause, self._fresh = False, 'no measurements yet', True
        self._doubted_at, self._age, self.blind = np.nan, np.nan, True
        self._began, self._judges_from, self._begins = np.nan, -np.inf, False
        self._beginning, self._pause = None, None
        self._is_astray = False
        self.joints[:], self.joints_at = 0.0, -np.inf

    def _forget(self) -> None:
        """Forget all of the estimate but the biases: they are the sensors' own.

        The robot counts as on its plan, with the errors that are known of it.
        """
        self.state[: len(self.state) - len(self._biased)] = 0.0
        if self.errors is not None:
            self.state[: self._deviations] = self.errors.state(self.time)

    @property
    def faults(self) -> SensorFaults | None:
        """The detection of faulty sensors; None where there is none."""
        fusion = None if self._checker is None else self._checker.fusion
        return None if fusion is None else fusion.faults

    def start_anew(self, now: float, cause: str) -> None:
        """Begin again from the measurements after a time [s]; errors learned and faults stay."""
        self._forget()
        self._fresh, self._is_astray, self._begins = True, True, False
        self._beginning = self._pause = None
        self.believed, self.cause, self._doubted_at = False, cause, now

    def is_like(self, other: DeviationFilter) -> bool:
        """Say whether the estimates of both have the same parts."""
        return len(self.state) == len(other.state) and np.array_equal(self._biased, other._biased)

    def take_model(self, other: DeviationFilter) -> None:
        """Go on by the model of another filter of the same coordinates and sensors."""
        self._robot, self._timeout = other._robot, other._timeout
        self._states = other._states
        if other.errors is not None:
            other.errors.adopt(self.errors, self.state)
        self.errors = other.errors
        if self._checker is not None and other._checker is not None:
            other._checker.adopt(self._checker)
        self._checker = other._checker

    def follow(self, time: float, q: Array, qd: Array, qdd: Array | None = None) -> None:
        """Take the plan's coordinates, rates and accelerations (n,) at a time of the clock [s].

        Of the robot with all its springs. Without accelerations, beams' sensors read shapes.
        """
        if len(self._plan) and time <= self._plan.last:
            return
        expected = self._plan.push(time)
        k = self._k
        self._states.positions(q, expected[:k])
        self._states.positions(qd, expected[k : 2 * k])
        if self._turning:
            expected[2 * k :] = self._robot.sensor_values(q, qd, qdd)[self._places]
        elif len(self._sensors):
            expected[2 * k :] = self._robot.beam_sensor_values(q, qd, qdd)[self._sensors]

    def take_joints(self, stamp: float, q: Array, qd: Array | None) -> None:
        """Take measured positions (joints,) and, if known, rates of a time [s]."""
        k = self._k
        self._values[:k], self._stamps[:k], self._new[:k] = q, stamp, True
        if qd is not None:
            self._values[k : 2 * k], self._stamps[k : 2 * k] = qd, stamp
            self._new[k : 2 * k] = True
        if self._checker is not None:
            try:
                self._checker.measure(stamp, q, qd)
            except StateError:  # The fused estimate left all bounds: the detection starts again.
                self._checker.reset()

    def take_sensor(self, place: int, stamp: float, value: float) -> None:
        """Take a value of one of the robot's sensors, measured at a time [s]."""
        slot = self._slot.get(place)
        if slot is not None:
            self._values[slot], self._stamps[slot], self._new[slot] = value, stamp, True
            faults = self.faults
            if self._checker is not None and faults is not None and faults.is_due(stamp):
                self._checker.sense(place, stamp, value)

    def correct(self, now: float, gains: PostureGains) -> None:
        """Correct the estimate by the received values, and say whether it is reliable."""
        if math.isnan(self._doubted_at):
            self._doubted_at = now
        self._own.push(now)[:] = gains.measured @ self.state
        innovation, new, stamps = self._innovation, self._new, self._stamps
        innovation[:] = self._surprise[:] = 0.0
        if self.errors is not None:
            self.errors.push(now, gains)
        if self._pause is not None:
            new &= stamps >= self._pause.end
        if not len(self._plan):
            new[:] = False
        places: dict[float, list[int]] = {}
        for place, (is_new, stamp) in enumerate(zip(new.tolist(), stamps.tolist(), strict=True)):
            if is_new:
                places.setdefault(stamp, []).append(place)
        groups = [
            (stamp, self._sample(now, stamp), np.array(at)) for stamp, at in sorted(places.items())
        ]
        plan, own = self._plan, self._own
        second = own if self.errors is None else self.errors.expected
        for stamp, sample, at in groups:
            self._compare(
                self._values, at, stamp, sample, plan.times, plan.states, len(plan), own.times,
                own.states, len(own), second.times, second.states, len(second), innovation,
                self._surprise, self.joints,
            )  # fmt: skip
        if new[0]:
            self.joints_at = stamps[0]
        if self._fresh and new[0]:
            self._begin(now, gains)
        if self._pause is not None and new[0]:
            self._regain(gains)
        if len(self._biased):
            self._begin_biases(gains)
        self._find_faults(now, gains)
        self._sift(
            innovation, gains.spread, gains.reach, self._rates if self.believed else self._any,
            stamps, new, self._good, self._heard, self._good_at, self.refused, now, GATE, self._k,
            self.state, self._deviations, self._found,
        )  # fmt: skip
        self._judge(now, *self._found.tolist())
        for _, sample, at in groups:
            self._take(sample, at, self._good, gains)
        self._find_beginning(now, gains)
        if not self._has_rates:
            rates = slice(self._k, 2 * self._k)
            self.joints[rates] = gains.measured[rates] @ self.state

    def _sample(self, now: float, stamp: float) -> float:
        """Return the time of the tick whose estimate a value of a stamp belongs to.

        The estimate of a tick is that of the joints' newest values: how old these usually are is
        part of the loop's delay.
        """
        age = now - stamp
        if math.isnan(self._age):
            self._age = age
        elif self._new[0] and stamp == self._stamps[0]:
            self._age += AGEING * (age - self._age)
        late = max(0, round((age - self._age) / self._period))
        return now - late * self._period

    def _take(
        self, stamp: float, at: NDArray[np.intp], good: NDArray[np.bool_], gains: PostureGains
    ) -> None:
        """Correct the estimate, and its propagation since, by the innovations of a sample."""
        correction, errors = gains.correction, self.errors
        since = stamp - 0.5 * self._period
        at = at[good[at] & self._heard[at]]
        if self._begins:
            self._watch(at, gains)
            return
        if errors is not None and not self.blind:
            learns = not self._suspected and (self.believed or self._excluded > 0)
            errors.take(gains, self._surprise, at, since, self.time if learns else None)
        if self.blind:
            at, correction = at[at < 2 * self._k], gains.blind
        if self._beginning is not None:
            self._watch(at, gains)
            self._beginning.correct(correction, gains.measured, at)
        own, seen = self._own, self._none if errors is None else errors.seen
        self._correct(
            correction, gains.measured, self._innovation, at, self.state, seen, own.times,
            own.states, len(own), since,
        )  # fmt: skip
        if errors is not None and self.blind:
            errors.restart(gains, self.state)

    def _watch(self, at: NDArray[np.intp], gains: PostureGains) -> None:
        """Take the information of innovations of values without a bias."""
        assert self._beginning is not None
        at = at[~np.isin(at, self._biased)]
        self._beginning.watch(gains.measured, self._innovation, gains.spread, at)

    def _find_faults(self, now: float, gains: PostureGains) -> None:
        """Leave out sensors that the detection excludes, or that contradict the estimate."""
        errors, faults, first = self.errors, self.faults, 2 * self._k
        if errors is None or faults is None:
            return
        used = np.array([faults.uses(place) for place in self._sensors.tolist()], dtype=np.bool_)
        excluded, suspected = int(np.count_nonzero(~used)), False
        self._heard[first:] = used
        if not (self.blind or self._begins or now < self._judges_from):
            contradicts = used & errors.contradictions(gains, self._surprise, self._new)
            suspected = bool(contradicts.any())
            # Many sensors contradict a state that is wrong: then all have to correct it.
            if 2 * np.count_nonzero(contradicts) <= len(used):
                self._heard[first:] &= ~contradicts
        if excluded > self._excluded or (suspected and not self._suspected):
            errors.forget_recent()
            errors.doubt(self.time, LEARNS_AFTER_S)
        self._excluded, self._suspected = excluded, suspected

    def _begin(self, now: float, gains: PostureGains) -> None:
        """Begin where the joints are measured, and find out about the rest."""
        self._fresh, self._begins, self._began = False, True, now
        if self.errors is not None:
            self.errors.doubt(self.time)
        likely = ASTRAY if self._is_astray else NEAR
        self._starts = now + FIRST
        self._beginning = Beginning(len(self.state), likely * gains.unit)
        known = self._new[: 2 * self._k] & np.isfinite(gains.spread[: 2 * self._k])
        at, unit = np.flatnonzero(known), gains.unit
        rows = gains.measured[at, : self._deviations] * unit
        change = np.zeros(len(self.state))
        change[: self._deviations] = unit * (np.linalg.pinv(rows) @ self._innovation[at])
        self._innovation[self._new] -= self._change(change, gains)[self._new]
        self._agree(gains)

    def _find_beginning(self, now: float, gains: PostureGains) -> None:
        """Correct the beginning of the estimate by all measurements since, now and then."""
        if self._beginning is None or not (self.believed or now >= self._starts):
            return
        self._change(self._beginning.change(), gains)
        self._begins, self._starts = False, now + FIRST
        if self.errors is not None:
            self.errors.forget_deviations()
            if self._is_astray:
                self.errors.doubt(self.time)
        self._agree(gains)
        if self.believed or now >= self._began + BEGINS:
            self._beginning, self._is_astray = None, False

    def _change(self, change: Array, gains: PostureGains) -> Array:
        """Change the estimate by (e,), and its history by as much; return that (measured,)."""
        seen = gains.measured @ change
        self.state += change
        self._own.since(-np.inf)[1][:] += seen
        return np.asarray(seen)

    def _agree(self, gains: PostureGains) -> None:
        """Let the estimate that learns go on from this one."""
        if self.errors is not None:
            self.errors.restart(gains, self.state)
            self._surprise[:] = self._innovation

    def _begin_biases(self, gains: PostureGains) -> None:
        """Initialize a gyroscope's bias by its first value."""
        first = self._unbiased & self._new[self._biased]
        if self._fresh or self._begins or not first.any():
            return
        at, biases = self._biased[first], self.state[len(self.state) - len(self._biased) :]
        most = self._most_bias[first]
        biases[first] = np.clip(self._innovation[at], -most, most)
        self._own.since(-np.inf)[1][:, at] += biases[first]
        self._innovation[at] -= biases[first]
        self._unbiased[first] = False
        if self._beginning is not None:
            places = np.flatnonzero(first) + len(self.state) - len(self._biased)
            self._beginning.give(gains.measured[at], places)
        self._agree(gains)

    def doubt(self, pushed: Array, seconds: float, now: float) -> None:
        """Take note that the loop was away.

        What was measured meanwhile arrives with the next ticks, and is left out: it shows only a
        part of what the torque did.

        Parameters
        ----------
        pushed : (2 m,) array
            What the torque did to the deviations meanwhile.
        seconds : float
            How long that was [s].
        now : float
            [s].
        """
        self._good_at += seconds  # nobody could hear a sensor
        if seconds > self._brief:
            if self._pause is not None:  # nothing has been measured since
                pushed, seconds = pushed + self._pause.pushed, seconds + self._pause.seconds
            usual = 0.0 if np.isnan(self._age) else self._age
            self._pause = Pause(pushed, seconds, now - usual - 0.5 * self._period)
        if self.errors is not None and seconds > UNSEEN:
            self.errors.doubt(self.time)
            self._judges_from = max(self._judges_from, now + UNCLEAR)

    def _regain(self, gains: PostureGains) -> None:
        """Correct the estimate by the first values after a pause.

        What a held torque has done is wrong by a share of itself (`DOUBTED`): the gains of an
        ordinary period would take that error for unknown forces, and the robot would swing.
        """
        assert self._pause is not None
        pushed, seconds, _ = self._pause
        self._pause = None
        m = self._deviations // 2
        off = np.diag(DOUBTED * pushed[m:])
        ways = np.vstack([0.5 * seconds * off, off])
        at = np.flatnonzero(self._new & np.isfinite(gains.spread))
        across = gains.measured[at, : 2 * m] @ ways
        inner = across @ across.T + np.diag(np.square(gains.spread[at]))
        correction = np.zeros((len(self.state), len(self._innovation)))
        correction[: 2 * m, at] = np.linalg.solve(inner, across @ ways.T).T
        change = correction @ self._innovation
        self.state += change
        seen = gains.measured @ change
        self._own.since(self._own.last)[1][:] += seen
        self._innovation[at] -= seen[at]
        if self.errors is not None:
            seen = self.errors.seen
            seen -= correction[:, at] @ (gains.measured[at] @ seen)
        self._agree(gains)

    def _judge(self, now: float, age: float, place: float, agrees: float, largest: float) -> None:
        """Decide by `sift` whether to believe the estimate and to hear the sensors."""
        cause = ''
        if not largest < LARGEST:  # NaN is no less
            self.state[:], self._unbiased[:] = 0.0, True
            self._fresh = self._is_astray = True
            cause = 'estimate out of bounds'
        elif not age <= self._timeout:
            worst = int(place) - 2 * self._k
            cause = f'no good values of {self._names[worst] if worst >= 0 else "the joints"}'
        elif self.faults is not None and self.faults.uses_joints_only:
            cause = self.faults.finding
        self.blind = bool(cause)
        if cause:
            self.believed, self.cause, self._doubted_at = False, cause, now
            if now - self._began >= RESTART:
                self.start_anew(now, cause)
        elif self._excluded or self._suspected:
            finding = '' if self.faults is None else self.faults.finding
            self.cause = finding or 'sensors contradict each other'
            self.believed, self._doubted_at = False, now
        elif not self.believed:
            if not agrees:
                self._doubted_at = now
            if now - self._doubted_at >= (WAITS if self._is_astray else REGAIN):
                self.believed, self.cause = True, ''

    def go_on(self, gains: PostureGains, pushes: Array) -> Array:
        """Bring the estimate forward by a period under torques on their way and the new.

        Returns what these did to the deviations (2 m,).
        """
        if self._beginning is not None:
            self._beginning.go_on(self._transition(gains))
        if self.errors is not None:
            pushed = self.errors.go_on(gains, self.state, self.time, pushes)
            self.time += self._period
            return pushed
        pushed = gains.push @ pushes
        self.state[:] = gains.transition @ self.state
        self.state[: len(pushed)] += pushed
        return pushed

    def _transition(self, gains: PostureGains) -> Array:
        """Return the estimate's transition (e, e) with the errors that are known."""
        return gains.transition if self.errors is None else gains.with_errors(self.errors.used)[0]


def _sensor_checker(robot: Robot, joints: Sequence[str], period: float) -> Observer | None:
    """Return an observer whose fusion detects faulty sensors; None where it cannot.

    It needs the motion of all joints, a base that is held, and the noise of all sensors.
    """
    known = set(joints) == set(robot.joint_names) and not len(robot.base_indices)
    noise = [value.noise for value in numbered_values(robot.tree)]
    if not (known and noise and min(noise) > 0.0 and is_hardened(robot, joints)):
        return None
    fusion = FusionSettings(model_error=MODEL_ERROR_SHARE)
    checker = Observer(measured_robot(robot), ObserverSettings(step=period, fusion=fusion), joints)
    checker.rehearse()
    return checker
