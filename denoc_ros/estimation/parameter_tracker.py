"""Tracking of a payload, a stiffness or friction while the robot works."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from denoc_ros.dynamics.base_motion import BaseMotion
from denoc_ros.dynamics.driven_motion import driven_motion
from denoc_ros.dynamics.live_numbers import LiveNumbers
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.errors import SolverError, StateError
from denoc_ros.estimation.block_sensitivity import BlockSensitivity
from denoc_ros.estimation.block_sensors import BlockSensors
from denoc_ros.estimation.channel_levels import ChannelLevels
from denoc_ros.estimation.parameter_filter import Block, Excitation, ParameterFilter
from denoc_ros.estimation.tracked_paths import tracked_bounds, tracked_paths
from denoc_ros.estimation.tracker_settings import TrackerSettings
from denoc_ros.estimation.tracking import TrackingFilter
from denoc_ros.types import Array, Flags

DEVIATIONS = 4.0  # width of the bounds in deviations of what is not known yet
SILENT = 'no effort and no values of sensors'
KNOWN = 0.5  # share of that deviation below which the data support a value
START = 0.005  # deviation of a tip's deflection at the start, as a share of the beam's length
STATIC = 0.2  # share of a channel's value that may be its offset at first
DRIFT = 0.05  # of the offsets from block to block, as a share of the model's error
JUDGED = 1.0  # s of motion over which the model's error is judged
WORST = 20.0  # times the expected square: more counts as so much
COLOUR = 4.0  # blocks over which the model's error is the same
LONGEST_GAP = 0.25  # s without joint states that are not integrated over
QUEUE = 4096  # joint states that wait for the sensors' values at most

BaseAt = Callable[[float], BaseMotion | None]


class _Sample(NamedTuple):
    stamp: float
    q: Array
    qd: Array | None
    effort: Array | None


class ParameterTracker:
    """Follows numbers of a robot by measured torques and sensors, within bounds.

    Parameters
    ----------
    robot : Robot
        The model with what is known of it; worked on as copies. Without loops and mimic joints.
    paths : sequence of str
        Dotted paths of the numbers, of :func:`denoc_ros.dynamics.live_numbers.live_paths`; `*`
        and `?` stand for others, `payload.tool` for its mass.
    settings : TrackerSettings, optional
    bounds : mapping of str to pair of floats, optional
        Lowest and highest value by path, not negative; default half and one and a half of the
        present value.
    joints : sequence of str, optional
        The joints that are measured, in the order of all arrays of joints here; default all.

    Attributes
    ----------
    paths : tuple of str
    values : (p,) array
        In use: what the data have supported so far.
    bounds : (p, 2) array
    cause : str
        Why nothing is tracked now; '' if it is.
    blocks, restarts, failures : int
        Blocks that were compared; gaps that were not integrated over; states that the model could
        not go on from.
    moving : (p,) bool array
        Which numbers the motion shows now.
    model_error : float
        The setting's, or larger where measurements were farther off.
    base : callable or None
        Motion of the base at a time; None: it is at rest.

    Raises
    ------
    ConfigError
        Paths that cannot be tracked, wrong bounds, or a robot with loops or mimic joints.

    Notes
    -----
    docs/identification.md tells how: a Kalman filter over amplitudes, parameters and constant
    offsets of all channels, by the means over blocks of measured minus predicted.
    """

    def __init__(
        self,
        robot: Robot,
        paths: Sequence[str],
        settings: TrackerSettings | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        joints: Sequence[str] | None = None,
    ) -> None:
        paths = tracked_paths(robot, paths)
        self.settings = settings or TrackerSettings()
        self._robot = robot.copy()
        self.numbers = LiveNumbers(robot, paths)
        self.paths = self.numbers.paths
        self.start: Array = self.numbers.values.copy()
        self.bounds = tracked_bounds(self.paths, self.start, bounds or {})
        self._size = (self.bounds[:, 1] - self.bounds[:, 0]) / DEVIATIONS
        self._motion = driven_motion(self._robot, joints)
        self._joints = self._motion.index
        self._stepper = Stepper(robot.copy(), self.settings.step, self._motion.given)
        self._sensitivity = BlockSensitivity(robot.copy(), self._joints, len(self.paths))
        self._sensors = BlockSensors(robot.copy(), self._sensitivity.states // 2)
        self._rates = TrackingFilter(len(self._joints), self.settings.cutoff)
        self._regressor = np.zeros((robot.n, len(self.paths)))
        self.values: Array = self.start.copy()
        self.blocks = self.restarts = self.failures = 0
        self.base: BaseAt | None = None
        self._begin()

    def _begin(self) -> None:
        """Forget all but the values."""
        p, j, s = len(self.paths), len(self._joints), self._sensors.count
        self._filter = ParameterFilter(self._sensitivity.states, p, j + s)
        self._excitation = Excitation(p)
        least = np.concatenate([np.full(j, 1e-12), self._sensors.noise])
        self._levels = ChannelLevels(j + s, p, least)
        self._target: Array = self.values.copy()
        self._queue: deque[_Sample] = deque(maxlen=QUEUE)
        self._q, self._qd = np.zeros((2, self._robot.n))
        self._offsets: Array = np.zeros(j + s)
        self._have_offsets = np.zeros(j + s, dtype=bool)
        self._newest = self._stamp = self._step_start = math.nan
        self.moving = np.zeros(p, dtype=bool)
        self.model_error = self.settings.model_error
        self._step = self.settings.step
        self._effort: Array | None = None
        self.cause = 'no joint states'

    # ---- what it has found

    @property
    def deviations(self) -> Array:
        """Standard deviations of the values (p,), in their units."""
        return np.asarray(self._shares * self._size)

    @property
    def supported(self) -> Array:
        """Which values the data support (p,) bool."""
        return np.asarray(self._shares < KNOWN)

    @property
    def _shares(self) -> Array:
        return np.sqrt(np.diag(self._filter.parameters))

    # ---- measurements

    def reset(self) -> None:
        """Forget all data; the values stay."""
        self._retune(self.values - self._target)
        self._begin()
        self._sensors.clear()

    def restart(self) -> None:
        """Forget all data; the values are those of the start again."""
        self.values = self.start.copy()
        self.reset()

    def adopt(self, other: ParameterTracker) -> bool:
        """Go on from the values of another tracker of the same numbers; False: it is not.

        What the data say is forgotten: the rest of the model may be another now.
        """
        same = self.paths == other.paths and np.array_equal(self.start, other.start)
        if not same:
            return False
        self.values = np.clip(other.values, self.bounds[:, 0], self.bounds[:, 1])
        self._retune(self.values - self._target)
        self._begin()
        self.blocks = other.blocks
        self.restarts, self.failures = other.restarts, other.failures
        return True

    def sense(self, place: int, stamp: float, value: float) -> None:
        """Take a calibrated value of a sensor on a beam, measured at a time [s].

        Those of inertial sensors, which are behind them in the order of places, do not count.
        """
        self._sensors.take(place, stamp, value)

    def measure(
        self, stamp: float, q: Array, qd: Array | None = None, effort: Array | None = None
    ) -> bool:
        """Take a measurement of the joints.

        Parameters
        ----------
        stamp : float
            When it was taken [s].
        q, qd : (joints,) arrays
            Positions and, if known, rates.
        effort : (joints,) array, optional
            Torques or forces at the joints [N m, N].

        Returns
        -------
        bool
            Whether `values` have changed.
        """
        if not stamp > self._newest and not math.isnan(self._newest):
            return False
        self._newest = stamp
        self._queue.append(_Sample(stamp, q, qd, effort))
        changed = False
        while self._queue and self._queue[0].stamp <= stamp - self.settings.lag:
            try:
                changed |= self._take(self._queue.popleft())
            except (StateError, SolverError, np.linalg.LinAlgError):
                self.failures += 1
                self.reset()
        return changed

    def _take(self, sample: _Sample) -> bool:
        interval = sample.stamp - self._stamp
        if not interval <= LONGEST_GAP:
            self.restarts += not math.isnan(interval)
            self._start(sample)
            return False
        if sample.qd is None:
            self._rates.update(sample.q, None, interval)
        if self._effort is not None and sample.effort is not None:
            self._impulse += 0.5 * interval * (self._effort + sample.effort)
            self._with_effort += interval
        self._stamp, self._effort = sample.stamp, sample.effort
        if sample.stamp - self._step_start < (1.0 - 1e-6) * self.settings.step:
            return False
        self._advance(sample)
        self._step_start = sample.stamp
        if self._sensitivity.duration < (1.0 - 1e-6) * self.settings.block:
            return False
        return self._end_block()

    # ---- the model along a block

    def _start(self, sample: _Sample) -> None:
        """Start from a measurement, the amplitudes in equilibrium."""
        self._stamp = self._step_start = sample.stamp
        self._effort = sample.effort
        self._rates.reset(sample.q, sample.qd)
        self._move_base(sample.stamp)
        self._motion.positions(self._q, sample.q)
        self._qd[:] = 0.0
        self._q[self._robot.flexible_indices] = 0.0
        if len(self._robot.flexible_indices):
            # without an equilibrium at this posture (buckled) nothing is known of the amplitudes
            with suppress(SolverError):
                joints = self._q[self._robot.joint_indices]
                self._q[:] = self._robot.static_deflection(joints)
        self._motion.rates(self._qd, self._rates.qd)
        self._begin_block()
        self._levels.interrupt()
        rest = np.zeros(self._robot.n)
        self._numbers_at(self._q, rest, rest)
        bent = self._sensitivity.bent(self._regressor)
        self._sensitivity.start(bent)
        start = self._sensitivity.start_covariance(START)
        self._filter.forget_state(start, bent)

    def _begin_block(self) -> None:
        self._sensitivity.begin(self._q, self._step)
        self._sensors.begin(self._q)
        self._impulse, self._torque = np.zeros((2, len(self._joints)))
        self._with_effort = 0.0

    def _advance(self, sample: _Sample) -> None:
        """Bring the model to a sample."""
        step = sample.stamp - self._step_start
        self._move_base(sample.stamp - 0.5 * step)
        q, qd = self._q.copy(), self._qd.copy()
        rates = self._rates.qd if sample.qd is None else sample.qd
        places = self._rates.q if sample.qd is None else sample.q
        mean = self._motion.given_accelerations((rates - qd[self._joints]) / step)
        self._stepper.step = step
        self._stepper.driven(self._q, self._qd, mean)
        self._motion.positions(self._q, places)
        self._motion.rates(self._qd, rates)
        middle, rate = 0.5 * (q + self._q), 0.5 * (qd + self._qd)
        acceleration = (self._qd - qd) / step
        torque = self._robot.inverse_dynamics(middle, rate, acceleration)
        self._torque += step * torque[self._joints]
        self._numbers_at(middle, rate, acceleration)
        derivatives = self._sensitivity.advance(middle, step, self._regressor)
        self._sensors.advance(self._step_start, sample.stamp, q, self._q, derivatives)
        self._step = step

    def _numbers_at(self, q: Array, qd: Array, qdd: Array) -> None:
        self.numbers.columns(q, qd, qdd, self._robot.slip_rate, self._regressor)
        self._regressor *= self._size

    def _move_base(self, time: float) -> None:
        if self.base is not None:
            motion = self.base(time)
            self._robot.move_base(motion)
            self._stepper.robot.move_base(motion)
            self.numbers.move_base(motion)

    # ---- what a block says

    def _end_block(self) -> bool:
        """Compare means of measured and predicted; return whether `values` have changed."""
        sensitivity, duration = self._sensitivity, self._sensitivity.duration
        by_state, by, by_long = sensitivity.torques()
        sensors = self._sensors.means(sensitivity.columns)
        seen_state, seen, seen_long = sensitivity.split(sensors.derivatives)
        with_effort = self._with_effort > (1.0 - 1e-6) * duration
        heard = np.concatenate([np.full(len(self._joints), with_effort), sensors.heard])
        torque = (self._impulse - self._torque) / duration
        gap = np.concatenate([torque, sensors.gap]) - self._offsets
        predicted = np.concatenate([self._torque / duration, sensors.value])
        levels = self._levels
        moved = levels.take(heard, gap, predicted, np.vstack([by_long, seen_long]), duration)
        usable = heard & levels.known
        self._open_offsets(usable, gap, predicted)
        noise = levels.noise
        free = self._excitation.take(moved[usable], noise[usable], duration)
        self.moving = np.sum(free**2, axis=1) > 0.5
        self._explain(heard, usable)
        self._filter.forget(free, math.exp(0.5 * duration / self.settings.memory))
        error = np.hypot(noise, math.sqrt(COLOUR) * self.model_error * levels.movement)
        block = Block(
            gap, np.vstack([by_state, seen_state]), np.vstack([by, seen]), noise, error, usable
        )
        self._correct(block, free)
        self._begin_block()
        self.blocks += 1
        return self._publish(duration)

    def _open_offsets(self, usable: Flags, gap: Array, predicted: Array) -> None:
        for channel in np.flatnonzero(usable & ~self._have_offsets).tolist():
            deviation = math.hypot(gap[channel], STATIC * predicted[channel])
            self._filter.open_offset(channel, deviation + 3.0 * self._levels.noise[channel])
            self._have_offsets[channel] = True

    def _explain(self, heard: Flags, usable: Flags) -> None:
        if not heard.any():
            self.cause = SILENT
        elif not usable.any():
            self.cause = 'the noise is not known yet'
        else:
            self.cause = '' if self.moving.any() else 'nothing moves that shows the parameters'

    def _correct(self, block: Block, free: Array) -> None:
        """Take a block into the filter; correct the model's state and numbers."""
        found, sensitivity = self._filter, self._sensitivity
        transition, by_parameters, by_force = sensitivity.end()
        load = self.model_error * self.moving.any() * sensitivity.load_deviation(self._q, self._qd)
        spread = COLOUR * (load[:, None] * sensitivity.shape * load)
        change = np.zeros(sensitivity.states)
        if block.heard.any():
            correction = found.take(block, free)
            self._judge(correction.surprise, sensitivity.duration)
            change = transition @ correction.state + by_parameters @ correction.parameters
            self._offsets += correction.offsets
            before = self._target
            self._target = np.clip(
                before + self._size * correction.parameters, self.bounds[:, 0], self.bounds[:, 1]
            )
            self._retune(self._target - before)
        drift = DRIFT * self.model_error * self._levels.movement
        found.go_on(transition, by_parameters, by_force @ spread @ by_force.T, drift)
        flexible = self._robot.flexible_indices
        self._q[flexible] += change[: len(flexible)]
        self._qd[flexible] += change[len(flexible) :]

    def _judge(self, surprise: float, duration: float) -> None:
        """Take the model's error for larger where measurements are farther off than expected."""
        if self.moving.any() and math.isfinite(surprise):
            share = -math.expm1(-duration / JUDGED)
            grown = self.model_error * math.sqrt(1.0 + share * (min(surprise, WORST) - 1.0))
            self.model_error = min(max(grown, self.settings.model_error), 1.0)

    def _retune(self, change: Array) -> None:
        """Let the models that are worked with have other numbers."""
        for robot in (self._robot, self._stepper.robot, self._sensitivity.robot):
            self.numbers.set(robot, change)

    def _publish(self, duration: float) -> bool:
        """Bring the values towards what is found, along what the data tell, not too fast."""
        spread, vectors = np.linalg.eigh(self._filter.parameters)
        known = vectors[:, spread < KNOWN**2]
        step = known @ (known.T @ ((self._target - self.values) / self._size)) * self._size
        most = self.settings.rate * (self.bounds[:, 1] - self.bounds[:, 0]) * duration
        step *= min(1.0, float(np.min(most / np.maximum(np.abs(step), 1e-300))))
        values = np.clip(self.values + step, self.bounds[:, 0], self.bounds[:, 1])
        changed = not np.array_equal(values, self.values)
        self.values = values
        return changed
