"""Predicted readings of sensors and trackers along a robot's motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from denoc_ros.dynamics.robot import Robot
from denoc_ros.identification.model.free_parameters import POSE_PARTS, SearchPoint
from denoc_ros.identification.model.robust import without_spikes
from denoc_ros.identification.model.sources import Recording
from denoc_ros.model.tree import INERTIAL_UNITS
from denoc_ros.types import Array

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


class SplineThrough:
    """Cubic splines through values at stamps (k,), whose matrix is factored once."""

    def __init__(self, t: Array) -> None:
        self._knots = np.concatenate([np.full(4, t[0]), t[2:-2], np.full(4, t[-1])])
        self._solve = splu(BSpline.design_matrix(t, self._knots, 3).tocsc()).solve

    def __call__(self, values: Array, at: Array) -> Array:
        """Return values (k, channels) at other stamps (m,), before the first as well."""
        found: Array = BSpline.construct_fast(self._knots, self._solve(values), 3)(at)
        return found


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
        self._last: dict[str, tuple[Robot, Array, float, Array]] = {}
        self._splines: dict[int, SplineThrough] = {}
        self._shared: dict[str, NDArray[np.int64] | None] = {}
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
            unit = INERTIAL_UNITS[part.partition('_')[0]]
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
        given = settings.channels
        for name in (sensor.name for sensor in self._beams):
            (own,) = [sensor for sensor in robot.tree.sensors if sensor.name == name]
            offset = given.get(f'sensor.{name}.offset', own.offset)
            gain = given.get(f'sensor.{name}.gain', own.gain)
            seen = self._seen([name], robot, states, settings)
            found += self._missed([name], (seen - offset) / gain)
        for sensor in self._inertial:
            parts = [part for part in sensor.parts if f'{sensor.name}/{part}' in self._names]
            if not parts:
                continue
            path = f'sensor.{sensor.name}'
            offsets = np.array([given.get(f'{path}.offset.{part}', 0.0) for part in parts])
            gains = np.array([given.get(f'{path}.gain.{part}', 1.0) for part in parts])
            names = [f'{sensor.name}/{part}' for part in parts]
            seen = self._seen(names, robot, states, settings)
            found += self._missed(names, (seen - offsets) / gains)
        for frame in self._frames:
            found += self._of_pose(robot, frame, states, settings)
        return [residual for residual in found if len(residual)]

    def _seen(self, names: list[str], robot: Robot, states: Array, settings: SearchPoint) -> Array:
        """Return a sensor's values (m, channels) at its stamps, before gain and offset.

        Points of a search that differ in those alone share them.
        """
        sensor = names[0].partition('/')[0]
        delay = settings.delays.get(sensor, 0.0)

        def compute() -> Array:
            every = self._once('', robot, states, 0.0, lambda: self._values(robot, states))
            values = every[:, [robot.tree.sensor_names.index(name) for name in names]]
            if sensor != names[0]:
                values = self._low_pass[: len(values), : len(values)] @ values
            elif sensor in self._filters:
                values = self._filters[sensor].passed(self._t[: len(values)], values[:, 0])[
                    :, None
                ]
            return self._delayed(names[0], values, delay)

        return self._once(sensor, robot, states, delay, compute)

    def _values(self, robot: Robot, states: Array) -> Array:
        """Return the values (j, values) of all sensors, of inertial ones if any was recorded."""
        if self._inertial:
            return robot.sensor_values(*states)
        values = np.zeros((len(states[0]), len(robot.tree.sensor_names)))
        values[:, robot.tree.beam_sensor_places] = robot.beam_sensor_values(*states)
        return values

    def _once(
        self, what: str, robot: Robot, states: Array, delay: float, compute: Callable[[], Array]
    ) -> Array:
        """Return the last result for the same robot, motion and delay, or compute it."""
        last = self._last.get(what)
        if last is None or last[0] is not robot or last[1] is not states or last[2] != delay:
            self._last[what] = last = (robot, states, delay, compute())
        return last[3]

    def _of_pose(
        self, robot: Robot, frame: str, states: Array, settings: SearchPoint
    ) -> list[Array]:
        """Residual of a tracker's pose; offsets turn and shift its axes."""
        if f'pose {frame}/x' not in self._names:
            return []
        path, q = f'pose.{frame}', states[0]
        poses = self._once(path, robot, states, 0.0, lambda: robot.frame_pose(frame, q))
        offset = np.array(
            [settings.channels.get(f'{path}.offset.{part}', 0.0) for part in POSE_PARTS]
        )
        axes, middle = Rotation.from_rotvec(offset[3:]), self._middle[frame]
        turns = middle.inv() * axes * Rotation.from_matrix(poses[:, :3, :3])
        values = np.hstack([axes.apply(poses[:, :3, 3]) + offset[:3], turns.as_rotvec()])
        names = [f'pose {frame}/{part}' for part in POSE_PARTS]
        return self._missed(names, self._delayed(names[0], values, settings.delays.get(path, 0.0)))

    def _delayed(self, name: str, values: Array, delay: float) -> Array:
        """Return values (j, channels) at the joints' first stamps at a channel's stamps."""
        stamps, count = self._names[name].t, len(values)
        if not len(stamps):
            return np.empty((0, values.shape[1]))
        if not delay and (places := self._shared_places(name)) is not None:
            return values[np.minimum(places, count - 1)]
        # behind the last stamp that was worked out nothing counts: it stays as it was there
        at = np.minimum(stamps - delay, self._t[count - 1])
        return self.between(values, at)

    def _shared_places(self, name: str) -> NDArray[np.int64] | None:
        """Return which joint stamps a channel's stamps are; None where one is between them."""
        if name not in self._shared:
            stamps = self._names[name].t
            places = np.minimum(np.searchsorted(self._t, stamps), len(self._t) - 1)
            self._shared[name] = places if (self._t[places] == stamps).all() else None
        return self._shared[name]

    def between(self, values: Array, at: Array) -> Array:
        """Return values (j, channels) at the joints' first j stamps at other stamps."""
        count = len(values)
        if count not in self._splines:
            self._splines[count] = SplineThrough(self._t[:count])
        return self._splines[count](values, at)

    def _missed(self, names: list[str], predicted: Array) -> list[Array]:
        """Return measured minus predicted (m, channels) of each channel."""
        return [
            self._names[name].value - own for name, own in zip(names, predicted.T, strict=True)
        ]


def _signal(name: str, unit: str, t: Array, value: Array) -> MeasuredSignal:
    return MeasuredSignal(name, unit, t, value, float(value.std()) if len(value) else 0.0)


def _within(span: tuple[float, float], stamps: Array, values: Array) -> tuple[Array, Array]:
    """Return the stamps in a span of time, and the values at them."""
    inside = (stamps >= span[0]) & (stamps <= span[1])
    return stamps[inside], values[inside]
