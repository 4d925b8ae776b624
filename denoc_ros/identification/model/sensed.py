"""Predicted readings of sensors and trackers along a robot's motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from denoc_ros.dynamics.robot import Robot
from denoc_ros.identification.model.free_parameters import POSE_PARTS, SearchPoint
from denoc_ros.identification.model.robust import without_spikes
from denoc_ros.identification.model.sources import Recording
from denoc_ros.types import Array

UNITS = {'gyro': 'rad/s', 'accel': 'm/s^2'}
# of stamps to the low-pass over them, and the rows that count
Thinned = Callable[[Array], tuple[scipy.sparse.csr_array, NDArray[np.int64]]]


@dataclass(frozen=True)
class MeasuredSignal:
    """One measured signal."""

    name: str  # `effort <joint>`, `<sensor>`, `<imu>/gyro_x`, `pose <frame>/x`
    unit: str
    t: Array  # (m,) stamps [s]
    value: Array  # (m,) as measured; effort, rates and accelerations through the low-pass
    # what residuals are compared with: the deviation of the values, or of what is balanced in a
    # joint without effort
    size: float


class SensedChannels:
    """Recorded sensors and poses of a run, and their predictions by a robot.

    Parameters
    ----------
    span : (float, float)
        First and last stamp that counts [s].
    thinned : callable
        Of the low-pass that IMUs go through: their predictions have the noise of accelerations.
    low_pass : sparse array (k, k)
        The same over the joints' stamps.
    """

    def __init__(
        self,
        recording: Recording,
        robot: Robot,
        span: tuple[float, float],
        thinned: Thinned,
        low_pass: scipy.sparse.csr_array,
    ) -> None:
        self._t, self._low_pass, self._filters = recording.t, low_pass, recording.filters
        self._beams = [s for s in robot.tree.sensors if s.name in recording.sensors]
        self._inertial = [s for s in robot.tree.inertial_sensors if s.name in recording.sensors]
        self._middle: dict[str, Rotation] = {}
        self._frames = [frame for frame in robot.tree.frames if frame in recording.poses]
        self.channels: list[MeasuredSignal] = []
        for sensor in self._beams:
            stamps, raw = _within(span, *recording.sensors[sensor.name])
            self.channels.append(_signal(sensor.name, 'raw', stamps, raw))
        for inertial in self._inertial:
            self._add_inertial(inertial.name, inertial.parts, recording, span, thinned)
        for frame in self._frames:
            self._add_pose(frame, *_within(span, *recording.poses[frame]))
        self._names = {channel.name: channel for channel in self.channels}
        self.channels = [channel for channel in self.channels if len(channel.t)]

    def _add_inertial(
        self,
        name: str,
        parts: tuple[str, ...],
        recording: Recording,
        span: tuple[float, float],
        thinned: Thinned,
    ) -> None:
        stamps, raw = recording.sensors[name]
        if len(stamps) < 2:
            return
        passing, rows = thinned(stamps)
        rows = rows[(stamps[rows] >= span[0]) & (stamps[rows] <= span[1])]
        passed = (passing @ without_spikes(raw))[rows]
        for part, column in zip(parts, passed.T, strict=True):
            unit = UNITS[part.partition('_')[0]]
            self.channels.append(_signal(f'{name}/{part}', unit, stamps[rows], column))

    def _add_pose(self, frame: str, stamps: Array, poses: Array) -> None:
        """Add positions, and rotation vectors from the mean orientation."""
        if not len(stamps):
            return
        turns = Rotation.from_quat(poses[:, 3:])
        self._middle[frame] = turns.mean()
        values = np.hstack([poses[:, :3], (turns.mean().inv() * turns).as_rotvec()])
        for part, column in zip(POSE_PARTS, values.T, strict=True):
            unit = 'rad' if part.startswith('r') else 'm'
            self.channels.append(_signal(f'pose {frame}/{part}', unit, stamps, column))

    def residuals(self, robot: Robot, states: Array, settings: SearchPoint) -> list[Array]:
        """Return measured minus predicted of each channel.

        Parameters
        ----------
        states : (3, j, n) array
            Coordinates, rates and accelerations at the joints' first j stamps.
        """
        found: list[Array] = []
        if self._beams:
            values = robot.beam_sensor_values(*states)
            places = [sensor.name for sensor in robot.tree.sensors]
            for mine in self._beams:
                place = places.index(mine.name)
                sensor = robot.tree.sensors[place]
                seen = values[:, place]
                if (behind := self._filters.get(mine.name)) is not None:
                    seen = behind.passed(self._t[: len(seen)], seen)
                path, given = f'sensor.{mine.name}', settings.channels
                offset = given.get(f'{path}.offset', sensor.offset)
                raw = (seen - offset) / given.get(f'{path}.gain', sensor.gain)
                found.append(self._missed(mine.name, raw, settings.delays.get(mine.name, 0.0)))
        found += self._of_inertial(robot, states, settings)
        for frame in self._frames:
            found += self._of_pose(robot, frame, states[0], settings)
        return [residual for residual in found if len(residual)]

    def _of_inertial(self, robot: Robot, states: Array, settings: SearchPoint) -> list[Array]:
        if not self._inertial:
            return []
        found: list[Array] = []
        values = robot.sensor_values(*states)
        passing = self._low_pass
        if len(values) < len(self._t):
            passing = passing[: len(values), : len(values)]
        for sensor in self._inertial:
            places = [k for k, p in enumerate(sensor.parts) if f'{sensor.name}/{p}' in self._names]
            if not places:
                continue
            paths = [f'sensor.{sensor.name}.{{}}.{sensor.parts[k]}' for k in places]
            gain, offset = (
                np.array([settings.channels.get(path.format(word), usual) for path in paths])
                for word, usual in (('gain', 1.0), ('offset', 0.0))
            )
            raw = (values[:, [sensor.first + k for k in places]] - offset) / gain
            names = [f'{sensor.name}/{sensor.parts[k]}' for k in places]
            delay = settings.delays.get(sensor.name, 0.0)
            found += self._missed_together(names, passing @ raw, delay)
        return found

    def _of_pose(self, robot: Robot, frame: str, q: Array, settings: SearchPoint) -> list[Array]:
        """Residual of a tracker's pose; offsets turn and shift its axes."""
        if f'pose {frame}/x' not in self._names:
            return []
        poses, path = robot.frame_pose(frame, q), f'pose.{frame}.offset'
        offset = np.array([settings.channels.get(f'{path}.{part}', 0.0) for part in POSE_PARTS])
        axes, middle = Rotation.from_rotvec(offset[3:]), self._middle[frame]
        turns = middle.inv() * axes * Rotation.from_matrix(poses[:, :3, :3])
        values = np.hstack([axes.apply(poses[:, :3, 3]) + offset[:3], turns.as_rotvec()])
        delay = settings.delays.get(f'pose.{frame}', 0.0)
        names = [f'pose {frame}/{part}' for part in POSE_PARTS]
        return self._missed_together(names, values, delay)

    def _missed_together(self, names: list[str], predicted: Array, delay: float) -> list[Array]:
        """Return the same of channels with the same stamps, predicted (j, channels)."""
        stamps = self._names[names[0]].t
        if not len(stamps):
            return [stamps for _ in names]
        count = len(predicted)
        at = np.minimum(stamps - delay, self._t[count - 1])
        seen = CubicSpline(self._t[:count], predicted)(at)
        return [self._names[name].value - own for name, own in zip(names, seen.T, strict=True)]

    def _missed(self, name: str, predicted: Array, delay: float) -> Array:
        """Measured minus predicted values of a channel at the joints' first stamps (j,)."""
        channel, count = self._names[name], len(predicted)
        if not len(channel.t):
            return channel.t
        # behind the last stamp that was worked out nothing counts: it stays as it was there
        at = np.minimum(channel.t - delay, self._t[count - 1])
        missed: Array = channel.value - CubicSpline(self._t[:count], predicted)(at)
        return missed


def _signal(name: str, unit: str, t: Array, value: Array) -> MeasuredSignal:
    return MeasuredSignal(name, unit, t, value, float(value.std()) if len(value) else 0.0)


def _within(span: tuple[float, float], stamps: Array, values: Array) -> tuple[Array, Array]:
    """Return the stamps in a span of time, and the values at them."""
    inside = (stamps >= span[0]) & (stamps <= span[1])
    return stamps[inside], values[inside]
