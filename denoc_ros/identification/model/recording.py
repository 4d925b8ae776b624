"""Measurements of one run: joints, effort, sensors, all by the clock of the joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from denoc_ros.bags.reader import Stamp, bag_topics
from denoc_ros.bags.readings import (
    read_inertial,
    read_poses,
    read_stamped_readings,
    resolved,
)
from denoc_ros.bags.series import read_joint_states
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import IdentificationError
from denoc_ros.identification.joint_columns import renamed
from denoc_ros.identification.model.sensor_filter import SensorFilter
from denoc_ros.model.tree import INERTIAL_PARTS
from denoc_ros.types import Array

FEWEST = 50  # joint states of a recording


@dataclass(frozen=True, eq=False)
class Recording:
    """One run.

    Parameters
    ----------
    t : (k,) array
        Stamps of the joint states [s], rising.
    joints : tuple of str
    position : (k, joints) array
        [rad, m], finite.
    effort : (k, joints) array
        [N m, N]; NaN where a joint's was not measured.
    velocity : (k, joints) array, optional
        [rad/s, m/s]
    sensors : dict of str to ((m,) array, array), optional
        By the sensor's name: stamps on the same clock [s] and raw readings, (m,) of a sensor on a
        beam, (m, 6) of an IMU, (m, 3) of an accelerometer.
    filters : dict of str to SensorFilter, optional
        By the sensor's name: what its readings have passed; the prediction passes it, too.
    poses : dict of str to ((m,) array, (m, 7) array), optional
        By the frame's name: stamps [s], and positions [m] with quaternions x, y, z, w of a
        tracker, whose axes are those of the robot's base but for a small offset.
    name : str
        What messages call it.

    Raises
    ------
    IdentificationError
        Shapes differ, stamps do not rise, positions are not finite, or there are too few.
    """

    t: Array
    joints: tuple[str, ...]
    position: Array
    effort: Array
    velocity: Array | None = None
    sensors: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    name: str = 'recording'
    filters: Mapping[str, SensorFilter] = field(default_factory=dict)
    poses: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        k = len(self.t)
        if k < FEWEST:
            raise IdentificationError(
                f'{self.name}: must have at least {FEWEST} joint states, got {k}'
            )
        for what in ('position', 'effort', 'velocity'):
            values = getattr(self, what)
            if values is not None and np.shape(values) != (k, len(self.joints)):
                raise IdentificationError(
                    f'{self.name}: {what} must have shape {(k, len(self.joints))}, '
                    f'got {np.shape(values)}'
                )
        if not (np.diff(self.t) > 0.0).all():
            raise IdentificationError(f'{self.name}: stamps must rise, got some that do not')
        if not np.isfinite(self.position).all():
            raise IdentificationError(
                f'{self.name}: positions must be finite, got some that are not'
            )
        for name, (stamps, values) in (*self.sensors.items(), *self.poses.items()):
            shapes = [(len(stamps), 7)] if name in self.poses else _shapes(len(stamps))
            if np.shape(values) not in shapes:
                raise IdentificationError(
                    f'{self.name}: {name}: readings must have shape '
                    f'{" or ".join(map(str, shapes))}, got {np.shape(values)}'
                )


PARTS = {len(parts): parts for parts in INERTIAL_PARTS.values()}


def reading_spreads(recording: Recording) -> dict[str, float]:
    """Return by how much raw readings vary, by the name of each of a sensor's values."""
    found = {}
    for name, (_, raw) in recording.sensors.items():
        columns = (raw[:, None] if raw.ndim == 1 else raw).T
        parts = [''] if raw.ndim == 1 else [f'/{part}' for part in PARTS[raw.shape[1]]]
        for part, column in zip(parts, columns, strict=True):
            found[f'{name}{part}'] = float(np.std(column)) if len(column) else 0.0
    return found


def _shapes(count: int) -> list[tuple[int, ...]]:
    """Return the shapes that readings of a sensor may have."""
    return [(count,), *((count, parts) for parts in sorted(PARTS))]


def read_recording(
    path: str | Path,
    robot: Robot,
    topic: str = '/joint_states',
    stamp: Stamp = 'header',
    rename: Mapping[str, str] | None = None,
    poses: Mapping[str, str] | None = None,
) -> Recording:
    """Read a robot's joints and sensors from a bag.

    Parameters
    ----------
    path : str or Path
    robot : Robot
        Its joints, and the topics of its sensors.
    topic : str
        Joint states.
    stamp : {'header', 'log'}
        As of `read_bag`.
    rename : mapping of str to str, optional
        Beginnings of joint names in the bag and what they are in the robot.
    poses : dict of str to str, optional
        Topic of geometry_msgs/PoseStamped to the frame whose pose it has.

    Raises
    ------
    BagError, IdentificationError
        The bag cannot be read, or has too little.
    """
    series = read_joint_states(path, topic, None, stamp)
    called = renamed(series.names, rename or {})
    known = [name for name in called if name in robot.joint_names]
    if not known:
        raise IdentificationError(
            f'{path}: {topic} must have joints of the robot ({", ".join(robot.joint_names)}), '
            f'got {", ".join(called) or "none"}'
        )
    columns = [series.names.index(called[name]) for name in known]
    position = series.position[:, columns]
    rises = np.concatenate([[True], np.diff(np.maximum.accumulate(series.stamp_ns)) > 0])
    whole = np.isfinite(position).all(axis=1) & rises
    origin = series.stamp_ns[0] if len(series.stamp_ns) else 0
    velocity = series.velocity[whole][:, columns]
    return Recording(
        1e-9 * (series.stamp_ns[whole] - origin).astype(np.float64),
        tuple(known),
        position[whole],
        series.effort[whole][:, columns],
        velocity if np.isfinite(velocity).all() else None,
        _sensors(path, robot, int(origin)),
        Path(path).name,
        poses=_poses(path, robot, int(origin), poses or {}),
    )


def _sensors(path: str | Path, robot: Robot, origin_ns: int) -> dict[str, tuple[Array, Array]]:
    """Return stamps [s] and readings of the sensors whose topics are in the bag."""
    found = {}
    topics = bag_topics(path)
    for sensor in robot.tree.sensors:
        if not sensor.topic or resolved(sensor.topic, topics) not in topics:
            continue
        stamp_ns, raw = read_stamped_readings(path, sensor.topic, sensor.name, sensor.field)
        t, values = _on_clock(stamp_ns, raw[:, None], origin_ns)
        found[sensor.name] = (t, values[:, 0])
    for inertial in robot.tree.inertial_sensors:
        if inertial.topic and resolved(inertial.topic, topics) in topics:
            stamp_ns, values = read_inertial(path, inertial.topic)
            count = len(inertial.parts)
            if values.shape[1:] != (count,):
                raise IdentificationError(
                    f'{path}: {inertial.topic} must have the {count} values of sensor '
                    f'{inertial.name!r}, got {values.shape[1:]}'
                )
            found[inertial.name] = _on_clock(stamp_ns, values, origin_ns)
    return found


def _poses(
    path: str | Path, robot: Robot, origin_ns: int, topics: Mapping[str, str]
) -> dict[str, tuple[Array, Array]]:
    """Return stamps [s] and poses (m, 7) by frame."""
    found = {}
    for topic, frame in topics.items():
        if frame not in robot.tree.frames:
            raise IdentificationError(
                f'--pose {topic}={frame} must name a frame of the robot '
                f'({", ".join(robot.tree.frames)}), got {frame!r}'
            )
        if frame in found:
            raise IdentificationError(f'--pose must name each frame once, got {frame!r} twice')
        found[frame] = _on_clock(*read_poses(path, topic), origin_ns)
    return found


def _on_clock(stamp_ns: NDArray[np.int64], values: Array, origin_ns: int) -> tuple[Array, Array]:
    """Return stamps [s] from an origin, and values (m, parts), where all of them are finite."""
    whole = np.isfinite(values).all(axis=1)
    t = 1e-9 * (stamp_ns[whole] - origin_ns).astype(np.float64)
    return np.asarray(t, dtype=np.float64), values[whole]
