"""Tracking of a payload, a stiffness or friction while the robot works."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from denoc_ros.dynamics.parameter_columns import LiveNumbers
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.estimation.joint_tracker import TrackingFilter
from denoc_ros.identification.tracking.block_sensitivity import LARGEST
from denoc_ros.identification.tracking.parameter_filter import (
    BlockValues,
    ChannelLevels,
    ExcitedDirections,
    ParameterFilter,
)
from denoc_ros.identification.tracking.tracked_model import BlockMeans, TrackedModel
from denoc_ros.identification.tracking.tracker_settings import (
    TrackerSettings,
    tracked_bounds,
    tracked_paths,
)
from denoc_ros.runtime.adaptation import BaseAt
from denoc_ros.types import Array, Flags

DEVIATIONS = 4.0  # width of the bounds in deviations of what is not known yet
NOTHING_HEARD = 'no effort and no values of sensors'
KNOWN = 0.5  # share of that deviation below which the data support a value
STATIC = 0.2  # share of a channel's value that may be its offset at first
DRIFT = 0.05  # of the offsets from block to block, as a share of the model's error
JUDGED = 1.0  # s of motion over which the model's error is judged
WORST = 20.0  # times the expected square: more counts as so much
TINY = 1e-300
COLOUR = 4.0  # blocks over which the model's error is the same
LONGEST_GAP = 0.25  # s without joint states that are not integrated over
BEHIND = 0.03  # s by which the work may wait for the next calls, beyond the lag
QUEUE = 4096  # joint states that wait for the sensors' values at most


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
        The model with what is known of it; worked on as copies. Without loops.
    paths : sequence of str
        Dotted paths of the numbers, of
        :func:`denoc_ros.dynamics.parameter_columns.live_paths`; `*` and `?` stand for others,
        `payload.tool` for its mass.
    settings : TrackerSettings, optional
    bounds : mapping of str to pair of floats, optional
        Lowest and highest value by path, not negative; default half and one and a half of the
        present value.
    joints : sequence of str, optional
        The joints that are measured, in the order of all arrays of joints here; default all that
        are no mimics.

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

    Raises
    ------
    ConfigError
        Paths that cannot be tracked, wrong bounds, or a robot with loops.

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
        self.numbers = LiveNumbers(robot, paths)
        self.paths = self.numbers.paths
        self.start: Array = self.numbers.values.copy()
        self.bounds = tracked_bounds(self.paths, self.start, bounds or {})
        self._size = (self.bounds[:, 1] - self.bounds[:, 0]) / DEVIATIONS
        self._model = TrackedModel(robot, self.numbers, self._size, joints, self.settings.step)
        self._rates = TrackingFilter(len(self._model.joints), self.settings.cutoff)
        self.values: Array = self.start.copy()
        self.blocks = self.restarts = self.failures = 0
        self._begin()

    def _begin(self) -> None:
        """Forget all but the values."""
        model, p = self._model, len(self.paths)
        channels = len(model.joints) + model.sensors.count
        self._filter = ParameterFilter(model.sensitivity.states, p, channels)
        self._excitation = ExcitedDirections(p)
        least = np.concatenate([np.full(len(model.joints), TINY), model.sensors.noise])
        self._levels = ChannelLevels(channels, p, least)
        self._target: Array = self.values.copy()
        self._queue: deque[_Sample] = deque(maxlen=QUEUE)
        self._work: Iterator[None] | None = None
        self._offsets: Array = np.zeros(channels)
        self._have_offsets = np.zeros(channels, dtype=bool)
        self._newest = self._stamp = self._step_start = math.nan
        self.moving = np.zeros(p, dtype=bool)
        self.model_error = self.settings.model_error
        self._effort: Array | None = None
        self.cause = 'no joint states'

    @property
    def base(self) -> BaseAt | None:
        """Motion of the base at a time; None: it is at rest."""
        return self._model.base

    @base.setter
    def base(self, base: BaseAt | None) -> None:
        self._model.base = base

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
        return np.sqrt(np.maximum(np.diag(self._filter.parameters), 0.0))

    # ---- measurements

    def reset(self) -> None:
        """Forget all data; the values stay."""
        self._model.retune(self.values - self._target)
        self._begin()
        self._model.sensors.clear()

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
        self._model.retune(self.values - self._target)
        self._begin()
        self.blocks = other.blocks
        self.restarts, self.failures = other.restarts, other.failures
        return True

    def sense(self, place: int, stamp: float, value: float) -> None:
        """Take a calibrated value of a sensor on a beam, measured at a time [s].

        Those of inertial sensors, which are behind them in the order of places, do not count.
        """
        self._model.sensors.take(place, stamp, value)

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
            Torques or forces at the joints [N m, N]; what is beyond any robot's counts as none.

        Returns
        -------
        bool
            Whether `values` have changed.
        """
        if not stamp > self._newest and not math.isnan(self._newest):
            return False
        self._newest = stamp
        if effort is not None and not np.all(np.abs(effort) < LARGEST):
            effort = None
        self._queue.append(_Sample(stamp, q, qd, effort))
        due, before = stamp - self.settings.lag, self.values
        while self._work is not None or (self._queue and self._queue[0].stamp <= due):
            late = bool(self._queue) and self._queue[0].stamp <= due - BEHIND
            try:
                if self._go_on() and not late:
                    break  # the rest in the next calls, so that none takes long
            except (StateError, SolverError, ArithmeticError, np.linalg.LinAlgError):
                self.failures += 1
                self.reset()
        return self.values is not before

    def _go_on(self) -> bool:
        """Do the next piece of work; return whether it was a large one."""
        if self._work is None:
            return self._take(self._queue.popleft())
        if next(self._work, self) is self:
            self._work = None
        return True

    def _take(self, sample: _Sample) -> bool:
        interval = sample.stamp - self._stamp
        if not interval <= LONGEST_GAP:
            self.restarts += not math.isnan(interval)
            self._start(sample)
            return True
        if sample.qd is None:
            self._rates.update(sample.q, None, interval)
        if self._effort is not None and sample.effort is not None:
            self._model.take_effort(0.5 * interval * (self._effort + sample.effort), interval)
        self._stamp, self._effort = sample.stamp, sample.effort
        if sample.stamp - self._step_start < (1.0 - 1e-6) * self.settings.step:
            return False
        motion = (self._rates.q, self._rates.qd) if sample.qd is None else (sample.q, sample.qd)
        self._model.advance(self._step_start, sample.stamp, *motion)
        self._step_start = sample.stamp
        if self._model.sensitivity.duration >= (1.0 - 1e-6) * self.settings.block:
            self._work = self._end_block()
        return True

    def _start(self, sample: _Sample) -> None:
        """Start from a measurement."""
        self._stamp = self._step_start = sample.stamp
        self._effort = sample.effort
        self._rates.reset(sample.q, sample.qd)
        self._levels.interrupt()
        self._filter.forget_state(*self._model.start(sample.stamp, sample.q, self._rates.qd))

    # ---- what a block says

    def _end_block(self) -> Iterator[None]:
        """Compare means of measured and predicted, a piece of the work at a time."""
        duration = self._model.sensitivity.duration
        means = self._model.means(self._offsets)
        yield
        levels = self._levels
        moved = levels.take(means.heard, means.gap, means.predicted, means.over_long, duration)
        usable = means.heard & levels.known
        for channel in np.flatnonzero(usable & ~self._have_offsets).tolist():
            deviation = math.hypot(means.gap[channel], STATIC * means.predicted[channel])
            self._filter.open_offset(channel, deviation + 3.0 * levels.noise[channel])
            self._have_offsets[channel] = True
        free = self._excitation.take(moved[usable], levels.noise[usable], duration)
        self.moving = np.sum(free**2, axis=1) > 0.5
        self._explain(means.heard, usable)
        yield
        self._filter.forget(free, math.exp(0.5 * duration / self.settings.memory))
        yield
        yield from self._correct(means, usable, free)
        if not np.isfinite(self._filter.covariance).all():
            raise FloatingPointError('what is known of the parameters must be finite')
        self._model.begin_block()
        yield
        self._publish(duration)
        self.blocks += 1

    def _explain(self, heard: Flags, usable: Flags) -> None:
        if not heard.any():
            self.cause = NOTHING_HEARD
        elif not usable.any():
            self.cause = 'the noise is not known yet'
        else:
            self.cause = '' if self.moving.any() else 'nothing moves that shows the parameters'

    def _correct(self, means: BlockMeans, usable: Flags, free: Array) -> Iterator[None]:
        """Take a block into the filter; correct the model's state and numbers."""
        model, noise, movement = self._model, self._levels.noise, self._levels.movement
        transition, by_parameters, _ = model.sensitivity.end()
        added = model.error_covariance(math.sqrt(COLOUR) * self.model_error * self.moving.any())
        error = np.hypot(noise, math.sqrt(COLOUR) * self.model_error * movement)
        if usable.any():
            block = BlockValues(means.gap, means.by_state, means.by_parameters, error, usable)
            found = self._filter.take(block, free)
            yield
            self._judge(found.surprise, model.sensitivity.duration)
            self._offsets += found.offsets
            before, (low, high) = self._target, self.bounds.T
            self._target = np.clip(before + self._size * found.parameters, low, high)
            model.retune(self._target - before)
            model.correct(transition @ found.state + by_parameters @ found.parameters)
        drift = DRIFT * self.model_error * movement
        self._filter.go_on(transition, by_parameters, added, drift)
        yield

    def _judge(self, surprise: float, duration: float) -> None:
        """Take the model's error for larger where measurements are farther off than expected."""
        if self.moving.any() and math.isfinite(surprise):
            share = -math.expm1(-duration / JUDGED)
            grown = self.model_error * math.sqrt(1.0 + share * (min(surprise, WORST) - 1.0))
            self.model_error = min(max(grown, self.settings.model_error), 1.0)

    def _publish(self, duration: float) -> None:
        """Move published values to the estimate, along observable directions, rate-limited."""
        spread, vectors = np.linalg.eigh(self._filter.parameters)
        known = vectors[:, spread < KNOWN**2]
        step = known @ (known.T @ ((self._target - self.values) / self._size)) * self._size
        low, high = self.bounds.T
        most = self.settings.rate * (high - low) * duration
        step *= min(1.0, float(np.min(most / np.maximum(np.abs(step), TINY))))
        values = np.clip(self.values + step, low, high)
        if not np.array_equal(values, self.values):
            self.values = values
