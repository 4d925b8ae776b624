"""Recordings: joints, effort and sensors of a run by one clock, out of bags and tables."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.signal import cont2discrete, lfilter, lfilter_zi

from denoc_ros.bags.reader import bag_topics
from denoc_ros.bags.series import (
    POSE_NUMBERS,
    JointSeries,
    elapsed,
    inertial_numbers,
    read_joint_states,
    read_numbers,
    read_readings,
    resolved,
)
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import BagError, IdentificationError
from denoc_ros.estimation.turns import without_turns
from denoc_ros.identification.tables.joint_table import (
    RecordedWindow,
    joints_of_table,
    require_rows,
)
from denoc_ros.identification.tables.tables import Table, is_table, read_table
from denoc_ros.model.sensors import message_place
from denoc_ros.model.tree import INERTIAL_SENSORS, Tree
from denoc_ros.settings import setting
from denoc_ros.simulation.recorded.plausibility import (
    angular_joints,
    found_jumps,
    gaps_between,
    jump_doubts,
    jumps_between,
)
from denoc_ros.types import Array, Stamps

FEWEST = 50  # joint states of a recording
SENSOR = 'sensor.'

Readings = Mapping[str, tuple[Array, Array]]


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
    doubts : tuple of str
        What speaks against it, in words.

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
    origin_ns: int = 0  # of the stamps, by the clock of the recording [ns]
    doubts: tuple[str, ...] = ()

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

    def between(self, begin: float, end: float) -> Recording:
        """Return what was measured at begin <= t <= end [s].

        Raises
        ------
        IdentificationError
            Too few joint states are left.
        """
        rows = (self.t >= begin) & (self.t <= end)

        def part(readings: Readings) -> Readings:
            inside = {name: (t >= begin) & (t <= end) for name, (t, _) in readings.items()}
            return {name: (t[inside[name]], v[inside[name]]) for name, (t, v) in readings.items()}

        return replace(
            self,
            t=self.t[rows],
            position=self.position[rows],
            effort=self.effort[rows],
            velocity=None if self.velocity is None else self.velocity[rows],
            sensors=part(self.sensors),
            poses=part(self.poses),
        )


def reading_spreads(recording: Recording, tree: Tree) -> dict[str, float]:
    """Return by how much raw readings vary, by the name of each of a sensor's values."""
    found = {}
    parts = {s.name: [f'{s.name}/{part}' for part in s.parts] for s in tree.inertial_sensors}
    for sensor, (_, raw) in recording.sensors.items():
        names = [sensor] if raw.ndim == 1 else parts[sensor]
        for name, column in zip(names, np.atleast_2d(raw.T), strict=True):
            found[name] = float(np.std(column)) if len(column) else 0.0
    return found


def _shapes(count: int) -> list[tuple[int, ...]]:
    sizes = {len(kind.parts) for kind in INERTIAL_SENSORS.values()}
    return [(count,), *((count, size) for size in sorted(sizes))]


@dataclass(frozen=True)
class RecordingSettings(RecordedWindow):
    """How recordings are read."""

    topic: str = setting('/joint_states', 'joint states of a bag')
    # beginnings of joint names in a bag and what they are in the robot
    rename: Mapping[str, str] = field(default_factory=dict)
    # of a table: `joint.field` or `sensor.name` to a column, whatever its name
    columns: Mapping[str, str] = field(default_factory=dict)
    # by the sensor's name: what its readings have passed
    filters: Mapping[str, SensorFilter] = field(default_factory=dict)
    # topics of poses that a tracker measured, of a bag, and the frames of the robot that have them
    poses: Mapping[str, str] = field(default_factory=dict)
    # by joint [N m/A, N/A]: what was recorded as its effort is a current [A]
    torque_constants: Mapping[str, float] = field(default_factory=dict)


def read_source(
    path: str | Path, robot: Robot, settings: RecordingSettings | None = None
) -> Recording:
    """Read a robot's joints and sensors from a bag or a table.

    Raises
    ------
    BagError, IdentificationError
        It cannot be read, has too little, or names that are not there.
    """
    path, settings = Path(path), settings or RecordingSettings()
    if is_table(path):
        if settings.poses:
            raise BagError(f'{path}: --pose must come with a bag, got a table')
        whole = _of_table(path, robot, settings)
    elif settings.columns:
        raise BagError(f'{path}: --column must come with a table, got a bag')
    else:
        whole = _of_bag(path, robot, settings)
    known = [sensor.name for sensor in robot.tree.sensors]
    if unknown := sorted(set(settings.filters) - set(known)):
        raise BagError(
            f'{path}: --filter must be of a sensor of the robot ({", ".join(known)}), '
            f'got {", ".join(unknown)}'
        )
    whole = _with_torque_constants(path, whole, settings.torque_constants)
    part = _window(whole, settings.begin, settings.end)
    return replace(part, filters=settings.filters, doubts=tuple(_jumps(robot.tree, part)))


def _recording(
    path: Path,
    tree: Tree,
    series: JointSeries,
    sensors: Readings,
    poses: Readings,
    origin_ns: int = 0,
) -> Recording:
    """Return the rows whose stamps rise and that have all positions."""
    whole = without_turns(series.rising().complete(), tree)
    rates = whole.velocity if np.isfinite(whole.velocity).all() else None
    return Recording(
        whole.t,
        whole.names,
        whole.position,
        whole.effort,
        rates,
        sensors,
        path.name,
        poses=poses,
        origin_ns=origin_ns,
    )


def _jumps(tree: Tree, read: Recording) -> list[str]:
    """Return in words where positions jump: the model is integrated across."""
    trusted = read.velocity if read.velocity is not None and read.velocity.any() else None
    jumps = jumps_between(read.t, read.position, trusted)
    jumps &= ~gaps_between(read.t, float(np.median(np.diff(read.t))))[:, None]
    found = found_jumps(
        read.joints, read.t, read.position, jumps, angular_joints(tree, read.joints)
    )
    return jump_doubts([jump for _, jump in found], ('turn', 'sample', 'place'))


def _of_bag(path: Path, robot: Robot, settings: RecordingSettings) -> Recording:
    topic = settings.topic
    series = read_joint_states(path, topic, None, settings.stamp).renamed(settings.rename)
    known = [name for name in series.names if name in robot.joint_names]
    if not known:
        raise IdentificationError(
            f'{path}: {topic} must have joints of the robot ({", ".join(robot.joint_names)}), '
            f'got {", ".join(series.names) or "none"}'
        )
    origin = int(series.stamp_ns[0]) if len(series.t) else 0
    sensors, poses = _sensors(path, robot, origin), _poses(path, robot, origin, settings.poses)
    return _recording(path, robot.tree, series.select(known), sensors, poses, origin)


def _of_table(path: Path, robot: Robot, settings: RecordingSettings) -> Recording:
    given = read_table(path)
    columns = _sensor_columns(path, given, robot, settings.columns)
    named = {k: c for k, c in settings.columns.items() if not k.startswith(SENSOR)}
    series = joints_of_table(path, given, robot.joint_names, named, settings)
    require_rows(path, given, columns.values(), series.t)
    rows = np.flatnonzero(np.isfinite(series.t))
    rows = rows[series[rows].rises()]
    sensors = {}
    for name, column in columns.items():
        raw = given[column][rows]
        whole = np.isfinite(raw)
        sensors[name] = (series.t[rows][whole], raw[whole])
    return _recording(path, robot.tree, series[rows], sensors, {})


def _sensors(path: str | Path, robot: Robot, origin_ns: int) -> Readings:
    """Return stamps [s] and readings of the sensors whose topics are in the bag."""
    found = {}
    topics = bag_topics(path)
    recorded = [
        sensor
        for sensor in robot.tree.sensors
        if sensor.topic and resolved(sensor.topic, topics) in topics
    ]
    for topic in dict.fromkeys(sensor.topic for sensor in recorded):
        own = [sensor for sensor in recorded if sensor.topic == topic]
        places = [message_place(sensor, robot.tree) for sensor in own]
        stamp_ns, raw = read_readings(path, topic, places)
        for sensor, column in zip(own, raw.T, strict=True):
            t, values = _on_clock(stamp_ns, column[:, None], origin_ns)
            found[sensor.name] = (t, values[:, 0])
    for inertial in robot.tree.inertial_sensors:
        if inertial.topic and resolved(inertial.topic, topics) in topics:
            numbers = inertial_numbers(inertial.kind.message, inertial.kind.vectors)
            stamp_ns, values = read_numbers(path, inertial.topic, numbers)
            found[inertial.name] = _on_clock(stamp_ns, values, origin_ns)
    return found


def _poses(path: str | Path, robot: Robot, origin_ns: int, topics: Mapping[str, str]) -> Readings:
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
        found[frame] = _on_clock(*read_numbers(path, topic, POSE_NUMBERS), origin_ns)
    return found


def _on_clock(stamp_ns: Stamps, values: Array, origin_ns: int) -> tuple[Array, Array]:
    """Return stamps [s] from an origin, and values (m, parts), where all of them are finite."""
    whole = np.isfinite(values).all(axis=1)
    return elapsed(stamp_ns[whole], origin_ns), values[whole]


def _sensor_columns(
    path: Path, given: Table, robot: Robot, named: Mapping[str, str]
) -> dict[str, str]:
    """Return the column of each sensor that a table has: the named one, or that of its name."""
    known = [sensor.name for sensor in robot.tree.sensors]
    found = {name: name for name in known if name in given}
    for what, column in named.items():
        if not what.startswith(SENSOR):
            continue
        name = what.removeprefix(SENSOR)
        if name not in known or column not in given:
            raise BagError(
                f'{path}: --column {what} must be a sensor of the robot '
                f'({", ".join(known) or "none"}) and a column ({", ".join(list(given)[:20])}), '
                f'got {column!r}'
            )
        found[name] = column
    return found


def _with_torque_constants(
    path: Path, whole: Recording, constants: Mapping[str, float]
) -> Recording:
    """Return a recording whose currents [A] have become effort."""
    if unknown := sorted(set(constants) - set(whole.joints)):
        raise BagError(
            f'{path}: --torque-constant must be of a recorded joint ({", ".join(whole.joints)}), '
            f'got {", ".join(unknown)}'
        )
    factors = np.array([constants.get(joint, 1.0) for joint in whole.joints])
    if not (np.isfinite(factors) & (factors != 0.0)).all():
        raise BagError(
            f'{path}: --torque-constant must be finite and not 0 N m/A, got {dict(constants)}'
        )
    return replace(whole, effort=whole.effort * factors)


def _window(whole: Recording, begin: float, end: float) -> Recording:
    if begin <= 0.0 and end == math.inf:
        return whole
    return whole.between(whole.t[0] + begin, whole.t[0] + end)


@dataclass(frozen=True)
class SensorFilter:
    """A low-pass of second order: y'' + 2 damping omega y' + omega^2 y = omega^2 u.

    Raises
    ------
    IdentificationError
        One of them is not > 0.
    """

    omega: float  # [rad/s]
    damping: float  # share of critical

    def __post_init__(self) -> None:
        for name, value in (('omega', self.omega), ('damping', self.damping)):
            if not (math.isfinite(value) and value > 0.0):
                raise IdentificationError(f'filter: {name} must be > 0, got {value}')

    def passed(self, t: Array, values: Array) -> Array:
        """Filter values (k,) at stamps t (k,) [s], settled at the first one.

        Values are taken as linear between stamps; uneven stamps go through an even grid.
        """
        period = float(np.median(np.diff(t)))
        even = np.arange(t[0], t[-1] + period, period)
        w, z = self.omega, self.damping
        system = ([w * w], [1.0, 2.0 * z * w, w * w])
        above, below, _ = cont2discrete(system, period, method='foh')
        above = np.ravel(above)
        given = np.interp(even, t, values)
        found, _ = lfilter(above, below, given, zi=given[0] * lfilter_zi(above, below))
        follows: Array = np.interp(t, even, found)
        return follows
