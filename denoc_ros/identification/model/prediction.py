"""Predicted channel values of a recording."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.linalg import eigvalsh

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import IdentificationError
from denoc_ros.estimation.joint_motion import LocalPolynomials, SmoothedMotion, stretch_starts
from denoc_ros.estimation.torque_along import TorqueReplay
from denoc_ros.identification.model.free_parameters import SearchPoint
from denoc_ros.identification.model.innovations import LinkedRows, NearbyMotion, linked_rows
from denoc_ros.identification.model.robust import noise_of, without_spikes
from denoc_ros.identification.model.sensed import MeasuredSignal, SensedChannels
from denoc_ros.identification.model.sources import Recording
from denoc_ros.model.joint_friction import Friction
from denoc_ros.simulation.recorded.plausibility import EffortSizes, effort_sums, vanishes
from denoc_ros.types import Array, Flags

FINEST = 0.3  # of the sampling rate: the cutoff of smoothing, as high as it goes
TRIED = tuple(FINEST * 0.7**k for k in range(8))  # cutoffs, of the sampling rate
LONGEST = 401  # samples that tell how much each counts in its own smoothed value
STILL = 6.0  # deviations of its noise within which a joint that stands still is seen
FEWEST = 20  # samples that tell noise from motion
PER_CUTOFF = 4.0  # samples of a smoothed channel that are kept, per period of the cutoff
SMALL_CHANGE = 1e-6  # m or rad, and per s: of amplitudes, for differences
QUIETEST = 0.35  # of a channel's noise by its differences: what a filter takes it for at least
SAMPLED = 0.6  # rad between two samples of the fastest mode: enough to come near its frequency
FEW = 1500  # samples of a run: of fewer each one counts
REACH = 4.0  # standard deviations at which a Gaussian's tail is cut


@dataclass(frozen=True)
class MeasuredMotion:
    """Motion of the joints, and the noise of its measurement."""

    motion: SmoothedMotion
    # (joints,) standard deviations of what was measured [rad, m] and [rad/s, m/s]
    position_noise: Array
    velocity_noise: Array
    # (2, joints) of the smoothing of positions and rates [Hz]; 0 where rates were not measured
    cutoffs: Array
    period: float  # usual time between samples [s]
    smoothers: Mapping[float, LocalPolynomials]  # of the stamps, by cutoff

    def noise(self, draws: Sequence[np.random.Generator]) -> Iterator[SmoothedMotion]:
        """Yield what noise of this size adds to the motion, once for each generator."""
        shape = *self.motion.q.shape, len(draws)
        measured = bool((self.cutoffs[1] > 0.0).any())
        drawn = [draw.standard_normal((2, *shape[:2])) for draw in draws]
        position, velocity = np.stack(drawn, axis=-1)
        position *= self.position_noise[:, None]
        velocity *= self.velocity_noise[:, None]
        found = np.zeros((3, *shape))
        for cutoff, smoother in self.smoothers.items():
            own, rates = self.cutoffs == cutoff
            if own.any():
                _smooth_noise(smoother, position, own, found[:1] if measured else found)
            if measured and rates.any():
                _smooth_noise(smoother, velocity, rates, found[1:])
        return (SmoothedMotion(*rows) for rows in np.moveaxis(found, -1, 0))


def _with_noise(motion: SmoothedMotion, noise: SmoothedMotion) -> SmoothedMotion:
    """Return a motion with noise on top."""
    return SmoothedMotion(motion.q + noise.q, motion.qd + noise.qd, motion.qdd + noise.qdd)


def _smooth_noise(smoother: LocalPolynomials, noise: Array, joints: Flags, found: Array) -> None:
    """Write the smoothed noise (k, joints, draws) of some joints and its first derivatives."""
    columns = noise[:, joints].reshape(len(noise), -1)
    for derivative, target in enumerate(found):
        smoothed = smoother.matrix(derivative) @ columns
        target[:, joints] = smoothed.reshape(len(noise), -1, noise.shape[2])


def measured_motion(t: Array, position: Array, velocity: Array | None) -> MeasuredMotion:
    """Return smoothed joint motion.

    Parameters
    ----------
    t : (k,) array
        Stamps [s].
    position : (k, joints) array
    velocity : (k, joints) array or None

    Notes
    -----
    Each signal's cutoff is one step above that of generalized cross-validation, with which the
    samples' prediction by their neighbours is best (P. Craven, G. Wahba, Numerische Mathematik 31,
    1979): what is cut off there is as large as what is left of the noise, and of no known sign.
    A joint that shows noise alone stands still: it has neither rates nor noise that drives links,
    and its friction makes no torque that is known.
    """
    period = float(np.median(np.diff(t)))
    position = without_spikes(position)
    velocity = None if velocity is None else without_spikes(velocity)
    signals = [position] if velocity is None else [position, velocity]
    cutoffs: Array = np.zeros((2, position.shape[1]))
    noise: Array = np.zeros((2, position.shape[1]))
    chosen = _chosen(t, np.hstack(signals), period)
    for rows, found in zip((cutoffs, noise), chosen, strict=True):
        rows[: len(signals)] = found.reshape(len(signals), -1)
    still = np.all([_is_noise(values) for values in signals], axis=0)
    position = np.where(still, np.median(position, axis=0), position)
    velocity = None if velocity is None else np.where(still, 0.0, velocity)
    noise[:, still] = 0.0
    smoothers = {
        float(cutoff): LocalPolynomials(t, float(cutoff), period)
        for cutoff in np.unique(cutoffs[cutoffs > 0.0])
    }
    motion = _smoothed(position, velocity, cutoffs, smoothers)
    return MeasuredMotion(motion, noise[0], noise[1], cutoffs, period, smoothers)


def _smoothed(
    position: Array,
    velocity: Array | None,
    cutoffs: Array,
    smoothers: Mapping[float, LocalPolynomials],
) -> SmoothedMotion:
    q, qd, qdd = (np.empty(position.shape) for _ in range(3))
    for cutoff, smoothed in smoothers.items():
        own, rates = cutoffs == cutoff
        if own.any():
            q[:, own], slope, bend = smoothed(position[:, own])
            if velocity is None:
                qd[:, own], qdd[:, own] = slope, bend
        if velocity is not None and rates.any():
            qd[:, rates], qdd[:, rates], _ = smoothed(velocity[:, rates])
    return SmoothedMotion(q, qd, qdd)


def _chosen(t: Array, values: Array, period: float) -> tuple[Array, Array]:
    """Return the cutoff and the noise of each column of values (k, columns)."""
    scores, noises = np.empty((2, len(TRIED), values.shape[1]))
    for row, share in enumerate(TRIED):
        left = values - LocalPolynomials(t, share / period, period)(values)[0]
        kept = 1.0 - own_weight(min(len(t), LONGEST), share)
        square = np.mean(left**2, axis=0)
        scores[row], noises[row] = square / kept**2, np.sqrt(square / kept)
    best = np.argmin(scores, axis=0)
    cutoffs: Array = np.asarray(TRIED)[np.maximum(best - 1, 0)] / period
    return cutoffs, noises[best, np.arange(values.shape[1])]


def _is_noise(values: Array) -> Flags:
    """Return which columns (joints,) show white noise about a constant and nothing else."""
    if len(values) < FEWEST:
        return np.zeros(values.shape[1], dtype=bool)
    apart = np.abs(values - np.median(values, axis=0))
    white = np.array([noise_of(column, 1.0) for column in values.T])
    return np.asarray((apart <= STILL * white).all(axis=0))


@cache
def own_weight(count: int, share: float) -> float:
    """Return how much one of `count` samples counts in its own smoothed value.

    The cutoff is a share of the sampling rate.
    """
    impulse: Array = np.zeros((count, 1))
    impulse[count // 2] = 1.0
    smoothed = LocalPolynomials(np.arange(count, dtype=np.float64), share, 1.0)
    return float(smoothed(impulse)[0][count // 2, 0])


class PreparedRun:
    """A recording prepared: smoothed motion, channels, and their prediction by any robot.

    Parameters
    ----------
    cutoff : float
        Of the low-pass that measured effort and predicted torque both go through [Hz]: what noise
        of positions makes of accelerations above it does not count.
    step : float
        Longest step of the amplitudes' integration [s].

    Raises
    ------
    IdentificationError
        Nothing but joint positions was measured.
    """

    def __init__(self, recording: Recording, robot: Robot, cutoff: float, step: float) -> None:
        self.name = recording.name
        self.recording, self._step = recording, step
        t = recording.t
        period = float(np.median(np.diff(t)))
        self._cutoff = min(cutoff, FINEST / period)
        self._measured = measured_motion(t, recording.position, recording.velocity)
        self._starts = stretch_starts(t, period)
        self._kept = self._clear_rows(period)
        joints = [
            k for k in range(len(recording.joints)) if np.isfinite(recording.effort[:, k]).all()
        ]
        self._joints = joints
        self._low_pass = low_pass(t, self._cutoff)
        self._low_pass_kept = self._low_pass[self._kept]
        self._gravity, self._balance = self._balanced(robot)
        effort = recording.effort[:, joints].copy()
        sizes = np.sqrt(np.mean(effort**2, axis=0))
        self._unpowered = np.array(
            [vanishes(*each) for each in zip(sizes, self._balance, strict=True)], dtype=bool
        )
        # What is left of an effort that vanishes is rounding: a fit to it finds anything.
        effort[:, self._unpowered] = 0.0
        self._effort = self._passed(without_spikes(effort))
        self.channels = [
            MeasuredSignal(
                f'effort {recording.joints[k]}',
                robot.tree.joints[recording.joints[k]].effort_unit,
                t[self._kept],
                self._effort[self._kept, column],
                float(
                    self._balance[column]
                    if self._unpowered[column]
                    else self._effort[self._kept, column].std()
                ),
            )
            for column, k in enumerate(joints)
        ]
        span = (float(t[self._kept[0]]), float(t[self._kept[-1]]))
        self._sensed = SensedChannels(recording, robot, span, self._thinned, self._low_pass)
        self.channels += self._sensed.channels
        if not self.channels:
            raise IdentificationError(
                f'{self.name}: must have measured effort or sensors of the robot, got neither'
            )

    def nearby(self, robot: Robot, motion: tuple[Array, Array]) -> NearbyMotion:
        """Return the linear model of the amplitudes about a motion that `motion` gave."""
        count = len(motion[0][0])
        stamps, starts = self.recording.t[:count], self._starts[:count]
        return NearbyMotion(robot, self.recording.joints, stamps, starts, motion)

    def is_followed(self, robot: Robot) -> bool:
        """Say whether the amplitudes have a linear model that rows hang on stamp by stamp."""
        odd = robot.constraint_names or len(robot.base_indices)
        plain = not (odd or self.has_unpowered_joints or self.recording.filters)
        return plain and len(robot.flexible_indices) > 0

    def linked_rows(self, robot: Robot, settings: SearchPoint, nearby: NearbyMotion) -> LinkedRows:
        """Return which residuals hang on which stamp, and how on the amplitudes there.

        Arguments are those of `residuals`; by what they become where amplitudes are a bit off.
        """
        stamps = self.recording.t[: len(nearby.starts)]
        here = np.concatenate(self.residuals(robot, settings, nearby.motion))
        slopes = np.empty((len(here), 2 * len(nearby.free)))
        for k in range(slopes.shape[1]):
            change = np.zeros((len(stamps), slopes.shape[1]))
            change[:, k] = SMALL_CHANGE
            found = self.residuals(robot, settings, nearby.changed(change))
            slopes[:, k] = (np.concatenate(found) - here) / SMALL_CHANGE
        row_t = [
            channel.t - settings.delays.get(delayed_with(channel.name), 0.0)
            for channel in self.channels
        ]
        return linked_rows(nearby, stamps, np.concatenate(row_t), slopes)

    def quietest(self) -> list[float]:
        """Return the least deviation of each channel, a part of its noise by fourth differences.

        A filter that takes a channel for exact follows it wherever it goes.
        """
        found = []
        for channel in self.channels:
            is_passed = channel.name.startswith('effort ') or '/gyro_' in channel.name
            is_passed = is_passed or '/accel_' in channel.name
            memory = time_deviation(self._cutoff) if is_passed else 0.0
            period = float(np.median(np.diff(channel.t))) if len(channel.t) > 1 else 1.0
            found.append(QUIETEST * noise_of(channel.value, period, memory))
        return found

    def rate_noise(self, robot: Robot) -> Array:
        """Noise density of the joints' rates (joints,).

        Without measured rates they have that of positions at half the smoothing's cutoff.
        """
        measured = self._measured
        slowly = np.pi * measured.cutoffs[0] * measured.position_noise
        rates = np.where(measured.cutoffs[1] > 0.0, measured.velocity_noise, slowly)
        found = np.zeros(len(robot.joint_names))
        places = [robot.joint_names.index(name) for name in self.recording.joints]
        found[places] = rates * np.sqrt(measured.period)
        return found

    @property
    def has_unpowered_joints(self) -> bool:
        """Whether a joint's effort is zero throughout: its balance is seen, not its scale."""
        return bool(self._unpowered.any())

    def effort_sizes(
        self, residuals: Sequence[Array], offsets: Mapping[str, float]
    ) -> EffortSizes:
        """Return the measured efforts beside the predicted ones.

        Parameters
        ----------
        residuals : sequence of (k,) array
            Of the channels, as `residuals` gives them.
        offsets : mapping of str to float
            Fitted offsets of efforts by joint [N m, N].
        """
        count = len(self._joints)
        effort = np.column_stack([each.value for each in self.channels[:count]])
        rest = np.column_stack(residuals[:count])
        offset = np.array([offsets.get(self.recording.joints[k], 0.0) for k in self._joints])
        effort[:, self._unpowered] = np.nan
        gravity = np.broadcast_to(self._gravity, effort.shape)
        return EffortSizes.of_sums(effort_sums(effort, effort - rest - offset, gravity), offset)

    @property
    def effort_joints(self) -> list[str]:
        """The joints whose effort was measured."""
        return [self.recording.joints[k] for k in self._joints]

    def _balanced(self, robot: Robot, count: int | None = None) -> tuple[Array, Array]:
        """Rms torque of gravity, and of gravity and inertia, in each joint with effort."""
        replay = TorqueReplay(robot, self.recording.joints, step=self._step)
        t, moved, starts = self._first(count or len(self.recording.t))
        torques = replay.torques(t, moved, starts)
        parts = [torques.parts[name][:, self._joints] for name in ('gravity', 'inertia')]
        gravity, inertia = (np.mean(part**2, axis=0) for part in parts)
        return np.sqrt(gravity), np.maximum(np.sqrt(gravity + inertia), 1e-300)

    def _first(
        self, count: int, motion: SmoothedMotion | None = None
    ) -> tuple[Array, SmoothedMotion, NDArray[np.bool_]]:
        """Return stamps, motion and starts of the first rows."""
        whole = motion or self._measured.motion
        rows = SmoothedMotion(whole.q[:count], whole.qd[:count], whole.qdd[:count])
        return self.recording.t[:count], rows, self._starts[:count]

    def gains(self, settings: SearchPoint) -> list[float]:
        """Return effort over torque of each joint whose effort was measured."""
        return [settings.gains.get(self.recording.joints[k], 1.0) for k in self._joints]

    def _clear_rows(self, period: float) -> NDArray[np.int64]:
        """Return the rows of effort that count: away from the ends, no denser than they tell."""
        count = len(self.recording.t)
        every = max(1, int(1.0 / (PER_CUTOFF * self._cutoff * period)))
        edge = min(int(1.0 / (self._cutoff * period)) + 8, count // 10)
        return np.arange(edge, count - edge, every)

    def _thinned(self, t: Array) -> tuple[scipy.sparse.csr_array, NDArray[np.int64]]:
        """Return the low-pass over other stamps (m,), and which of them tell something new."""
        period = float(np.median(np.diff(t)))
        every = max(1, int(1.0 / (PER_CUTOFF * self._cutoff * period)))
        return low_pass(t, self._cutoff), np.arange(0, len(t), every)

    def _passed(self, values: Array) -> Array:
        passed: Array = self._low_pass @ values
        return passed

    def motion(
        self, robot: Robot, until: float = 1.0, noise: SmoothedMotion | None = None
    ) -> tuple[Array, Array]:
        """Return states (3, j, n) and torques (j, joints) of a robot on the recorded motion.

        Parameters
        ----------
        until : float
            Part of the run's time that matters: what is behind it is not worked out.
        noise : SmoothedMotion, optional
            Added to that of the joints.
        """
        replay = TorqueReplay(robot, self.recording.joints, step=self._step)
        t = self.recording.t
        last = int(np.searchsorted(t, t[0] + until * (t[-1] - t[0])))
        end = min(len(t), last + 2 * int(self._kept[0]) + 2)
        whole = self._measured.motion
        return replay.states(
            *self._first(end, whole if noise is None else _with_noise(whole, noise))
        )

    def noise(self, draws: Sequence[np.random.Generator]) -> Iterator[SmoothedMotion]:
        """Yield noise of the size that the joints' measurement has, once for each generator."""
        return self._measured.noise(draws)

    def fastest_angle(self, robot: Robot) -> float:
        """Return the angle of the fastest mode of the amplitudes between two samples [rad]."""
        posture, free = np.zeros(robot.n), robot.flexible_indices
        posture[robot.indices(self.recording.joints)] = self._measured.motion.q[0]
        inertia = robot.inertia_matrix(posture)[np.ix_(free, free)]
        square = eigvalsh(np.diag(robot.stiffness[free]), inertia)[-1]
        return float(np.sqrt(square)) * self._measured.period

    def spare_samples(self, robot: Robot) -> int:
        """Return of how many joint samples one is enough to come near the numbers of a robot."""
        by_cutoff = FINEST / (self._cutoff * self._measured.period)
        by_mode = SAMPLED / max(self.fastest_angle(robot), 1e-9)
        return max(1, int(min(by_cutoff, by_mode, len(self.recording.t) / FEW)))

    def coarser(self, robot: Robot, every: int) -> PreparedRun:
        """Return the run with one of so many joint samples, and steps as much longer."""
        whole = self.recording
        rows = slice(None, None, every)
        thinned = dataclasses.replace(
            whole,
            t=whole.t[rows],
            position=whole.position[rows],
            effort=whole.effort[rows],
            velocity=None if whole.velocity is None else whole.velocity[rows],
            sensors={name: _thinned(*own, every) for name, own in whole.sensors.items()},
            poses={name: _thinned(*own, every) for name, own in whole.poses.items()},
        )
        return PreparedRun(thinned, robot, self._cutoff, every * self._step)

    def residuals(
        self, robot: Robot, settings: SearchPoint, motion: tuple[Array, Array] | None = None
    ) -> list[Array]:
        """Return measured minus predicted of each channel, in its unit.

        Parameters
        ----------
        robot : Robot
            Of these settings, but for friction and armature of joints: those are added.
        motion : (states, torques), optional
            As `motion` gives them for this robot.
        """
        settings = settings.of_run(self.name)
        states, torques = self.motion(robot) if motion is None else motion
        torque = np.zeros((len(self.recording.t), len(self._joints)))
        torques = torques[:, self._joints] + self._own_torque(robot, states, settings)
        torque[: len(torques)] = torques * self.gains(settings)
        torque += [settings.offsets.get(self.recording.joints[k], 0.0) for k in self._joints]
        delay = settings.delays.get('effort', 0.0)
        if delay:
            whole = self._sensed.between(self._passed(torque), self.recording.t - delay)
            predicted = whole[self._kept]
        else:
            predicted = self._low_pass_kept @ torque
        if self.has_unpowered_joints:
            # as many times as large, robot and residual alike would fit alike: held to one scale
            scale = self._balance / self._balanced(robot, len(states[0]))[1]
            predicted = predicted * np.where(self._unpowered, scale, 1.0)
        found = list((self._effort[self._kept] - predicted).T)
        return found + self._sensed.residuals(robot, states, settings)

    def _own_torque(self, robot: Robot, states: Array, settings: SearchPoint) -> Array:
        """Torque of the settings' friction and armature beyond the robot's (k, joints)."""
        names = [self.recording.joints[k] for k in self._joints]
        index = robot.indices(names)
        viscous, coulomb, armature = (
            [
                settings.overrides.get(f'joint.{n}.{term}', has)
                for n, has in zip(names, own, strict=True)
            ]
            - own
            for term, own in (
                ('damping', robot.damping[index]),
                ('friction', robot.friction[index]),
                ('armature', robot.armature[index]),
            )
        )
        added = Friction(viscous, coulomb).force(states[1][:, index])
        torque: Array = added + armature * states[2][:, index]
        return torque

    def torque_slopes(self, robot: Robot, paths: Sequence[str], gains: Sequence[float]) -> Array:
        """Return how the residuals (m,) of a rigid robot's effort change by its parameters (m, p).

        Those of sensors do not.
        """
        q, qd, qdd = np.zeros((3, len(self.recording.t), robot.n))
        index = robot.indices(self.recording.joints)
        motion = self._measured.motion
        q[:, index], qd[:, index], qdd[:, index] = motion.q, motion.qd, motion.qdd
        columns = robot.torque_regressor(q, qd, qdd, paths)
        found = [
            self._low_pass_kept @ (-gain * columns[:, index[joint]])
            for joint, gain in zip(self._joints, gains, strict=True)
        ]
        rest = sum(len(channel.t) for channel in self.channels[len(self._joints) :])
        slopes: Array = np.concatenate([*found, np.zeros((rest, len(paths)))])
        return slopes


def _thinned(t: Array, values: Array, every: int) -> tuple[Array, Array]:
    """Return one of so many readings, more where they are few."""
    rows = slice(None, None, max(1, min(every, len(t) // FEW)))
    return t[rows], values[rows]


def low_pass(t: Array, cutoff: float) -> scipy.sparse.csr_array:
    """Return a Gaussian low-pass (k, k) for samples at stamps t (k,), even or not.

    Half the power passes at the cutoff [Hz], a 1e-7th at five times that: local polynomials
    let a tenth of what is far above their cutoff through.
    """
    deviation = time_deviation(cutoff)
    first, last = (np.searchsorted(t, t + side * REACH * deviation) for side in (-1.0, 1.0))
    counts = last - first
    starts = np.concatenate([[0], np.cumsum(counts)])
    columns = np.arange(starts[-1]) - np.repeat(starts[:-1] - first, counts)
    rows = np.repeat(np.arange(len(t)), counts)
    weights = np.exp(-0.5 * ((t[columns] - t[rows]) / deviation) ** 2)
    weights /= np.repeat(np.add.reduceat(weights, starts[:-1]), counts)
    return scipy.sparse.csr_array((weights, columns, starts), shape=(len(t), len(t)))


def time_deviation(cutoff: float) -> float:
    """Return the standard deviation [s] of the Gaussian that half the power passes at [Hz]."""
    return math.sqrt(math.log(2.0)) / (2.0 * math.pi * cutoff)


def delayed_with(channel: str) -> str:
    """Owner of a channel's delay: `imu` of `imu/gyro_x`, `pose.tool`."""
    kind, _, rest = channel.partition(' ')
    if kind == 'effort' and rest:
        return 'effort'
    name = channel.partition('/')[0]
    return f'pose.{name.removeprefix("pose ")}' if name.startswith('pose ') else name
