"""What a robot says that a recording's channels should have shown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import IdentificationError
from denoc_ros.estimation.joint_motion import SmoothedMotion, smooth
from denoc_ros.estimation.torque_along import TorqueReplay, Torques
from denoc_ros.identification.model.free_parameters import SearchPoint
from denoc_ros.identification.model.recording import Recording
from denoc_ros.types import Array

PER_CUTOFF = 4.0  # samples of a smoothed channel that are kept, per period of the cutoff
FINEST = 0.3  # of the sampling rate: the cutoff of the motion's smoothing, as high as it goes
REACH = 4.0  # standard deviations at which a Gaussian's tail is cut


@dataclass(frozen=True)
class MeasuredSignal:
    """One measured signal.

    Attributes
    ----------
    name : str
        `effort <joint>` or `<sensor>`.
    unit : str
    t : (m,) array
        Stamps [s].
    value : (m,) array
        As measured; effort through the low-pass.
    size : float
        What residuals are compared with: the deviation of the values, or of what is balanced in
        a joint without effort.
    """

    name: str
    unit: str
    t: Array
    value: Array
    size: float


class PreparedRun:
    """A recording prepared: smoothed motion, channels, and their prediction by any robot.

    Parameters
    ----------
    recording : Recording
    robot : Robot
        Whose joints and sensors are meant.
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
        self._motion = smooth(
            t, recording.position, recording.velocity, cutoff=FINEST / period, period=period
        )
        self._starts = np.concatenate([[True], np.diff(t) > 10.0 * period])
        self._kept = self._clear_rows(period)
        joints = [
            k for k in range(len(recording.joints)) if np.isfinite(recording.effort[:, k]).all()
        ]
        self._joints = joints
        self._low_pass = low_pass(t, self._cutoff)
        self._effort = self._passed(recording.effort[:, joints])
        self._unpowered = np.asarray((recording.effort[:, joints] == 0.0).all(axis=0), dtype=bool)
        self._balance = self._balanced(robot) if self.has_unpowered_joints else np.ones(0)
        self.channels = [
            MeasuredSignal(
                f'effort {recording.joints[k]}',
                _unit(robot, recording.joints[k]),
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
        self._sensors = [
            sensor for sensor in robot.tree.sensors if sensor.name in recording.sensors
        ]
        first, last = t[self._kept[0]], t[self._kept[-1]]
        self._inside = {}
        for sensor in self._sensors:
            stamps, raw = recording.sensors[sensor.name]
            inside = (stamps >= first) & (stamps <= last)
            self._inside[sensor.name] = inside
            size = float(raw[inside].std()) if inside.any() else 0.0
            self.channels.append(
                MeasuredSignal(sensor.name, 'raw', stamps[inside], raw[inside], size)
            )
        self.channels = [channel for channel in self.channels if len(channel.t)]
        if not self.channels:
            raise IdentificationError(
                f'{self.name}: must have measured effort or sensors of the robot, got neither'
            )

    @property
    def has_unpowered_joints(self) -> bool:
        """Whether a joint's effort is 0 throughout: what balances in it is seen, not its scale."""
        return bool(self._unpowered.any())

    def _balanced(self, robot: Robot, torques: Torques | None = None) -> Array:
        """Return the size of what gravity and inertia make in each joint with effort, rms."""
        if torques is None:
            replay = TorqueReplay(robot, self.recording.joints, step=self._step)
            torques = replay.torques(self.recording.t, self._motion, self._starts)
        parts = [torques.parts[name][:, self._joints] for name in ('gravity', 'inertia')]
        sizes = np.sqrt(sum(np.mean(part**2, axis=0) for part in parts))
        return np.asarray(np.maximum(sizes, 1e-300))

    def gains(self, settings: SearchPoint) -> list[float]:
        """Return effort over torque of each joint whose effort was measured."""
        return [settings.gains.get(self.recording.joints[k], 1.0) for k in self._joints]

    def _clear_rows(self, period: float) -> NDArray[np.int64]:
        """Return the rows of effort that count: away from the ends, no denser than they tell."""
        count = len(self.recording.t)
        every = max(1, int(1.0 / (PER_CUTOFF * self._cutoff * period)))
        edge = min(int(1.0 / (self._cutoff * period)) + 8, count // 10)
        return np.arange(edge, count - edge, every)

    def _passed(self, values: Array) -> Array:
        passed: Array = self._low_pass @ values
        return passed

    def residuals(self, robot: Robot, settings: SearchPoint, until: float = 1.0) -> list[Array]:
        """Return measured minus predicted of each channel, in its unit.

        Parameters
        ----------
        robot : Robot
            Of these settings.
        settings : SearchPoint
            Gains of effort, and delays.
        until : float
            Part of the run that matters: what is behind it is not worked out.
        """
        replay = TorqueReplay(robot, self.recording.joints, step=self._step)
        count = len(self.recording.t)
        end = min(count, int(until * count) + 2 * int(self._kept[0]) + 2)
        whole = self._motion
        motion = SmoothedMotion(whole.q[:end], whole.qd[:end], whole.qdd[:end])
        torques = replay.torques(self.recording.t[:end], motion, self._starts[:end])
        delay = settings.delays.get('effort', 0.0)
        torque = np.zeros((count, len(self._joints)))
        torque[:end] = torques.best[:, self._joints] * self.gains(settings)
        torque += [settings.offsets.get(self.recording.joints[k], 0.0) for k in self._joints]
        predicted = self._passed(torque)
        if delay:
            predicted = CubicSpline(self.recording.t, predicted)(self.recording.t - delay)
        if self.has_unpowered_joints:
            # as many times as large, robot and residual alike would fit alike: held to one scale
            scale = self._balance / self._balanced(robot, torques)
            predicted = predicted * np.where(self._unpowered, scale, 1.0)
        found = list((self._effort - predicted)[self._kept].T)
        if torques.amplitudes is None:
            return found + [self._raw(s.name) for s in self._sensors]
        values = np.zeros((count, len(robot.tree.sensors)))
        values[:end] = robot.beam_sensor_values(torques.amplitudes[0])
        for k, sensor in enumerate(robot.tree.sensors):
            if sensor.name not in self._inside:
                continue
            stamps = self.recording.sensors[sensor.name][0][self._inside[sensor.name]]
            stamps = stamps - settings.delays.get(sensor.name, 0.0)
            if (behind := self.recording.filters.get(sensor.name)) is not None:
                values[:end, k] = behind.passed(self.recording.t[:end], values[:end, k])
            value = CubicSpline(self.recording.t, values[:, k])(stamps)
            found.append(self._raw(sensor.name) - (value - sensor.offset) / sensor.gain)
        return [residual for residual in found if len(residual)]

    def torque_slopes(self, robot: Robot, paths: Sequence[str], gains: Sequence[float]) -> Array:
        """Return how the residuals (m,) of a rigid robot's effort change by its parameters (m, p).

        Those of sensors do not.
        """
        q, qd, qdd = np.zeros((3, len(self.recording.t), robot.n))
        index = robot.indices(self.recording.joints)
        motion = self._motion
        q[:, index], qd[:, index], qdd[:, index] = motion.q, motion.qd, motion.qdd
        columns = robot.torque_regressor(q, qd, qdd, paths)
        found = [
            self._low_pass[self._kept] @ (-gain * columns[:, index[joint]])
            for joint, gain in zip(self._joints, gains, strict=True)
        ]
        rest = sum(len(channel.t) for channel in self.channels[len(self._joints) :])
        slopes: Array = np.concatenate([*found, np.zeros((rest, len(paths)))])
        return slopes

    def _raw(self, name: str) -> Array:
        raw: Array = self.recording.sensors[name][1][self._inside[name]]
        return raw


def low_pass(t: Array, cutoff: float) -> scipy.sparse.csr_array:
    """Return a Gaussian low-pass (k, k) for samples at stamps t (k,), even or not.

    Half the power passes at the cutoff [Hz], a 1e-7th at five times that: local polynomials
    let a tenth of what is far above their cutoff through.
    """
    deviation = math.sqrt(math.log(2.0)) / (2.0 * math.pi * cutoff)
    first, last = (np.searchsorted(t, t + side * REACH * deviation) for side in (-1.0, 1.0))
    counts = last - first
    starts = np.concatenate([[0], np.cumsum(counts)])
    columns = np.arange(starts[-1]) - np.repeat(starts[:-1] - first, counts)
    rows = np.repeat(np.arange(len(t)), counts)
    weights = np.exp(-0.5 * ((t[columns] - t[rows]) / deviation) ** 2)
    weights /= np.repeat(np.add.reduceat(weights, starts[:-1]), counts)
    return scipy.sparse.csr_array((weights, columns, starts), shape=(len(t), len(t)))


def _unit(robot: Robot, joint: str) -> str:
    kinds = {body.joint.name: body.joint.kind.name for body in robot.tree.bodies if body.joint}
    return 'N' if kinds.get(joint) == 'PRISMATIC' else 'N m'
