"""Recordings out of bags and tables: names, windows, and filters that sensors stand behind."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from denoc_ros.bags.joint_state import FIELDS
from denoc_ros.bags.reader import Stamp
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import BagError
from denoc_ros.identification.channel import Channel, is_table, table_times
from denoc_ros.identification.joint_columns import joint_columns
from denoc_ros.identification.model.recording import Recording, read_recording
from denoc_ros.identification.model.sensor_filter import SensorFilter
from denoc_ros.identification.tables import read_table
from denoc_ros.types import Array

SENSOR = 'sensor.'


@dataclass(frozen=True)
class RecordingSettings:
    """How recordings are read.

    Attributes
    ----------
    topic : str
        Joint states of a bag.
    stamp : {'header', 'log'}
        What counts as the time of a message.
    rename : mapping of str to str
        Beginnings of joint names in a bag and what they are in the robot.
    columns : mapping of str to str
        Of a table: `joint.field` or `sensor.name` to a column, whatever its name.
    times : Channel
        Of a table: whose `time`, `time_unit` and `rate` say how times are read.
    begin, end : float
        The window [s], from the first joint state on.
    filters : mapping of str to SensorFilter
        By the sensor's name: what its readings have passed.
    poses : mapping of str to str
        Topics of poses that a tracker measured, of a bag, and the frames of the robot that have
        them.
    torque_constants : mapping of str to float
        By joint [N m/A, N/A]: what was recorded as its effort is a current [A].
    """

    topic: str = '/joint_states'
    stamp: Stamp = 'header'
    rename: Mapping[str, str] = field(default_factory=dict)
    columns: Mapping[str, str] = field(default_factory=dict)
    times: Channel = field(default_factory=Channel)
    begin: float = 0.0
    end: float = math.inf
    filters: Mapping[str, SensorFilter] = field(default_factory=dict)
    poses: Mapping[str, str] = field(default_factory=dict)
    torque_constants: Mapping[str, float] = field(default_factory=dict)


def read_source(path: str | Path, robot: Robot, settings: RecordingSettings) -> Recording:
    """Read a robot's joints and sensors from a bag or a table.

    Parameters
    ----------
    path : str or Path
        What `read_bag` or `read_table` reads.
    robot : Robot
        Its joints and its sensors.
    settings : RecordingSettings
        How.

    Raises
    ------
    BagError, IdentificationError
        It cannot be read, has too little, or names that are not there.
    """
    path = Path(path)
    if is_table(path):
        if settings.poses:
            raise BagError(f'{path}: --pose must come with a bag, got a table')
        whole = _of_table(path, robot, settings)
    elif settings.columns:
        raise BagError(f'{path}: --column must come with a table, got a bag')
    else:
        whole = read_recording(
            path, robot, settings.topic, settings.stamp, settings.rename, settings.poses
        )
    known = [sensor.name for sensor in robot.tree.sensors]
    if unknown := sorted(set(settings.filters) - set(known)):
        raise BagError(
            f'{path}: --filter must be of a sensor of the robot ({", ".join(known)}), '
            f'got {", ".join(unknown)}'
        )
    whole = _with_torque_constants(path, whole, settings.torque_constants)
    return replace(_window(whole, settings.begin, settings.end), filters=settings.filters)


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


def _of_table(path: Path, robot: Robot, settings: RecordingSettings) -> Recording:
    given = read_table(path)
    sensors = _sensor_columns(path, given, robot, settings.columns)
    named = {k: c for k, c in settings.columns.items() if not k.startswith(SENSOR)}
    found = joint_columns(path, given, robot.joint_names, named)
    names = [joint for joint in robot.joint_names if (joint, 'position') in found]
    if not names:
        raise BagError(
            f'{path}: table must have the position of a joint (columns such as '
            f"'{robot.joint_names[0]}/position', or named by --column), "
            f'got {", ".join(list(given)[:20])}'
        )
    rows = len(given[found[names[0], 'position']])
    _, _, t = table_times(path, given, settings.times, rows)
    used = {column: given[column] for column in (*found.values(), *sensors.values())}
    for column, values in used.items():
        if len(values) != len(t):
            raise BagError(
                f'{path}: {column} must have as many values as there are times ({len(t)}), '
                f'got {len(values)}'
            )
    missing = np.full(len(t), np.nan)
    states = {
        what: np.column_stack(
            [used[found[name, what]] if (name, what) in found else missing for name in names]
        )
        for what in FIELDS
    }
    whole = _rising(t) & np.isfinite(states['position']).all(axis=1)
    velocity = states['velocity'][whole]
    return Recording(
        t[whole],
        tuple(names),
        states['position'][whole],
        states['effort'][whole],
        velocity if np.isfinite(velocity).all() else None,
        {name: _finite(t, used[column]) for name, column in sensors.items()},
        path.name,
    )


def _sensor_columns(
    path: Path, given: Mapping[str, Array], robot: Robot, named: Mapping[str, str]
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


def _rising(t: Array) -> NDArray[np.bool_]:
    """Return which times are finite and later than all before them."""
    latest = np.maximum.accumulate(np.where(np.isfinite(t), t, -np.inf))
    later: NDArray[np.bool_] = np.isfinite(t)
    later[1:] &= np.diff(latest) > 0.0
    return later


def _finite(t: Array, values: Array) -> tuple[Array, Array]:
    whole = _rising(t) & np.isfinite(values)
    return t[whole], values[whole]


def _window(whole: Recording, begin: float, end: float) -> Recording:
    """Return the part of a recording between two times [s] since its first joint state."""
    if begin <= 0.0 and end == math.inf:
        return whole
    since = whole.t - whole.t[0]
    rows = (since >= begin) & (since <= end)
    sensors = {}
    for name, (t, raw) in whole.sensors.items():
        own = (t - whole.t[0] >= begin) & (t - whole.t[0] <= end)
        sensors[name] = (t[own], raw[own])
    return replace(
        whole,
        t=whole.t[rows],
        position=whole.position[rows],
        effort=whole.effort[rows],
        velocity=None if whole.velocity is None else whole.velocity[rows],
        sensors=sensors,
    )
