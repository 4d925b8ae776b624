"""Raw readings of one sensor out of a bag, whatever type of message carries them."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from denoc_ros.bags.reader import Stamp, bag_topics, read_bag
from denoc_ros.bags.series import elapsed
from denoc_ros.errors import BagError
from denoc_ros.types import Array

TYPES = (
    'std_msgs/msg/Float64',
    'std_msgs/msg/Float64MultiArray',
    'sensor_msgs/msg/JointState',
    'geometry_msgs/msg/WrenchStamped',
)
ODOMETRY = 'nav_msgs/msg/Odometry'


def read_readings(
    path: str | Path, topic: str, name: str, field: str = '', wrench_field: str = ''
) -> tuple[Array, Array]:
    """Return times since the first reading [s] and raw readings, (k,) each.

    Arguments and errors are those of `read_stamped_readings`.
    """
    stamp_ns, raw = read_stamped_readings(path, topic, name, field, wrench_field)
    return elapsed(stamp_ns), raw


def read_stamped_readings(
    path: str | Path, topic: str, name: str, field: str = '', wrench_field: str = ''
) -> tuple[NDArray[np.int64], Array]:
    """Return stamps [ns] and raw readings, (k,) each.

    Parameters
    ----------
    path : str or Path
        A bag that `read_bag` reads.
    topic : str
        Of one of `TYPES`; a relative one is that of the robot's namespace.
    name, field : str
        The sensor's name, and which element or name in the message is its own.
    wrench_field : str
        Which component of a wrench.

    Raises
    ------
    BagError
        As `read_bag`; also for a topic of another type, and a message without the sensor.
    """
    stamps, raw = [], []
    topic = resolved(topic, bag_topics(path))
    for item in read_bag(path, [topic]):
        if item.type not in TYPES:
            raise BagError(
                f'{path}: topic {topic} must be one of {", ".join(TYPES)}, got {item.type}'
            )
        stamps.append(item.stamp_ns)
        try:
            raw.append(_reading(item.type, item.message, name, field, wrench_field))
        except (ValueError, IndexError) as error:
            raise BagError(
                f'{path}: messages on {topic} must hold sensor {name!r} '
                f'(field {field or name!r}), got one without'
            ) from error
    return np.array(stamps, dtype=np.int64), np.array(raw, dtype=np.float64)


def read_inertial(path: str | Path, topic: str) -> tuple[NDArray[np.int64], Array]:
    """Return stamps [ns] and values of an IMU (k, 6), or of an accelerometer (k, 3).

    Parameters
    ----------
    path : str or Path
        A bag that `read_bag` reads.
    topic : str
        Of sensor_msgs/Imu: angular rate and specific force; or of geometry_msgs/AccelStamped: its
        linear part. A relative one is that of the robot's namespace.

    Raises
    ------
    BagError
        As `read_bag`; also for a topic of another type.
    """
    stamps, values = [], []
    topic = resolved(topic, bag_topics(path))
    for item in read_bag(path, [topic]):
        message = item.message
        if item.type == 'sensor_msgs/msg/Imu':
            parts = [message.angular_velocity, message.linear_acceleration]
        elif item.type == 'geometry_msgs/msg/AccelStamped':
            parts = [message.accel.linear]
        else:
            raise BagError(
                f'{path}: topic {topic} must be sensor_msgs/msg/Imu or '
                f'geometry_msgs/msg/AccelStamped, got {item.type}'
            )
        stamps.append(item.stamp_ns)
        values.append([number for part in parts for number in (part.x, part.y, part.z)])
    return np.array(stamps, dtype=np.int64), np.array(values, dtype=np.float64)


def read_poses(path: str | Path, topic: str) -> tuple[NDArray[np.int64], Array]:
    """Return stamps [ns], and positions [m] with quaternions x, y, z, w (k, 7).

    Parameters
    ----------
    path : str or Path
        A bag that `read_bag` reads.
    topic : str
        Of geometry_msgs/PoseStamped; a relative one is that of the robot's namespace.

    Raises
    ------
    BagError
        As `read_bag`; also for a topic that is not there, or of another type.
    """
    stamps, values = [], []
    topic = resolved(topic, bag_topics(path))
    for stamp_ns, message in _messages(path, topic, 'geometry_msgs/msg/PoseStamped'):
        stamps.append(stamp_ns)
        values.append(_pose(message.pose))
    return np.array(stamps, dtype=np.int64), np.array(values, dtype=np.float64).reshape(-1, 7)


def read_odometry(
    path: str | Path, topic: str, stamp: Stamp = 'header'
) -> tuple[NDArray[np.int64], Array, Array]:
    """Return stamps [ns], poses (k, 7) and twists (k, 6) of an Odometry.

    Parameters
    ----------
    path : str or Path
        A bag that `read_bag` reads.
    topic : str
        Of nav_msgs/Odometry; a relative one is that of the robot's namespace.
    stamp : {'header', 'log'}
        As `read_bag`.

    Returns
    -------
    stamps : (k,) array
    poses : (k, 7) array
        Positions [m] with quaternions x, y, z, w.
    twists : (k, 6) array
        Velocities and angular velocities [m/s, rad/s], in the axes of the child frame.

    Raises
    ------
    BagError
        As `read_bag`; also for a topic that is not there, or of another type.
    """
    stamps, poses, twists = [], [], []
    topic = resolved(topic, bag_topics(path))
    for stamp_ns, message in _messages(path, topic, ODOMETRY, stamp):
        twist = message.twist.twist
        stamps.append(stamp_ns)
        poses.append(_pose(message.pose.pose))
        twists.append([getattr(v, axis) for v in (twist.linear, twist.angular) for axis in 'xyz'])
    return (
        np.array(stamps, dtype=np.int64),
        np.array(poses, dtype=np.float64).reshape(-1, 7),
        np.array(twists, dtype=np.float64).reshape(-1, 6),
    )


def _messages(
    path: str | Path, topic: str, kind: str, stamp: Stamp = 'header'
) -> Iterator[tuple[int, Any]]:
    """Yield stamps [ns] and messages of a topic, all of which must be of one type."""
    for item in read_bag(path, [topic], stamp):
        if item.type != kind:
            raise BagError(f'{path}: topic {topic} must be {kind}, got {item.type}')
        yield item.stamp_ns, item.message


def _pose(pose: Any) -> list[float]:
    """Return the position and the quaternion x, y, z, w of a Pose."""
    at, turned = pose.position, pose.orientation
    return [at.x, at.y, at.z, turned.x, turned.y, turned.z, turned.w]


def resolved(topic: str, topics: Iterable[str]) -> str:
    """Return the absolute name of a topic: in the root, else where only one namespace has it."""
    if topic.startswith('/'):
        return topic
    name = f'/{topic}'
    found = [each for each in topics if each.endswith(name)]
    return found[0] if len(found) == 1 else name


def _reading(kind: str, message: Any, name: str, field: str, wrench_field: str) -> float:
    if kind.endswith('Float64'):
        return float(message.data)
    if kind.endswith('WrenchStamped'):
        return float(operator.attrgetter(wrench_field)(message.wrench))
    if kind.endswith('JointState'):
        values = message.position if len(message.position) else message.effort
        return float(values[list(message.name).index(field or name)])
    labels = message.layout.dim[0].label.split(',') if message.layout.dim else []
    element = field or '0'
    return float(message.data[labels.index(element) if element in labels else int(element)])
