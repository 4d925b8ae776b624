"""Readings of sensors in the messages of their topics, by message type.

A reader of a sensor on a beam takes the class of a CDR reader, whose errors it raises, a message,
and the place of the reading in it. It returns stamp [ns], 0 without one, and value.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from denoc_ros.bags.cdr import CdrReader
from denoc_ros.bags.joint_state import JOINT_STATE, JointStateLayout

# name of the sensor, its `field` (element or name; '' if not given), component of a wrench from 0
Place = tuple[str, str, int]
MakeReader = Callable[[bytes], CdrReader]
Reader = Callable[[MakeReader, bytes, Place], tuple[int, float]]


def read_float(make: MakeReader, raw: bytes, _place: Place) -> tuple[int, float]:
    """Return the value of a Float64."""
    return 0, make(raw).float64()


def read_array(make: MakeReader, raw: bytes, place: Place) -> tuple[int, float]:
    """Return the sensor's element of a Float64MultiArray."""
    reader = make(raw)
    labels = []
    for _ in range(reader.count()):
        labels.append(reader.string())
        reader.uint32()
        reader.uint32()
    reader.uint32()
    values = reader.doubles()
    field = place[1] or '0'
    names = labels[0].split(',') if labels else []
    if field not in names and not field.isdecimal():
        reader.fail(f'layout must label an element {field!r}, got {names}', 'missing_field')
    element = names.index(field) if field in names else int(field)
    if element >= len(values):
        reader.fail(f'data must have element {element}, got {len(values)}', 'wrong_length')
    return 0, float(values[element])


class JointStateValues:
    """Reads the JointState messages of a topic, whose sensors ask one after the other."""

    def __init__(self) -> None:
        self._raw = b''
        self._layout: JointStateLayout | None = None
        self._stamp_ns = 0
        self._position, self._effort = list[float](), list[float]()

    def __call__(self, make: MakeReader, raw: bytes, place: Place) -> tuple[int, float]:
        """Return the position, effort where it has none, under the field or the name."""
        layout = self._layout
        if layout is None or raw is not self._raw:
            layout = self._read(make, raw)
        names, wanted = layout.names, place[1] or place[0]
        if wanted not in names:
            make(raw).fail(f'name must contain {wanted!r}, got {list(names)}', 'missing_field')
        own, position = names.index(wanted), self._position
        # joint_state_broadcaster writes NaN where there is no such interface
        has_position = own < len(position) and not math.isnan(position[own])
        values = position if has_position or not self._effort else self._effort
        if own >= len(values):
            make(raw).fail(f'position must have {len(names)} elements', 'wrong_length')
        return self._stamp_ns, values[own]

    def _read(self, make: MakeReader, raw: bytes) -> JointStateLayout:
        layout = self._layout
        if layout is None or not layout.fits(raw):
            layout = JointStateLayout.of(make(raw))
        position, _, effort = layout.values(raw)
        self._position, self._effort = position.tolist(), effort.tolist()
        self._raw, self._layout, self._stamp_ns = raw, layout, layout.stamp_ns(raw)
        return layout


def read_wrench(make: MakeReader, raw: bytes, place: Place) -> tuple[int, float]:
    """Return the sensor's component of a WrenchStamped."""
    reader = make(raw)
    stamp_ns = reader.stamp_ns()
    reader.string()
    return stamp_ns, [reader.float64() for _ in range(6)][place[2]]


READERS: dict[str, Callable[[], Reader]] = {
    'std_msgs/msg/Float64': lambda: read_float,
    'std_msgs/msg/Float64MultiArray': lambda: read_array,
    JOINT_STATE: JointStateValues,
    'geometry_msgs/msg/WrenchStamped': lambda: read_wrench,
}


def axes(part: str, names: str = 'xyz') -> tuple[str, ...]:
    """Return the dotted paths of the axes of a part of a message."""
    return tuple(f'{part}.{name}' for name in names)


# of inertial sensors: angular rate and specific force, as dotted paths
INERTIAL_NUMBERS = {
    'sensor_msgs/msg/Imu': {
        'gyro': axes('angular_velocity'),
        'accel': axes('linear_acceleration'),
    },
    'geometry_msgs/msg/AccelStamped': {'accel': axes('accel.linear')},
}
