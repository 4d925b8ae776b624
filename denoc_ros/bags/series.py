"""Arrays out of bags: joint states, multi-arrays and diagnostics over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.bags.columns import JointStateColumns
from denoc_ros.bags.joint_series import JointSeries as JointSeries
from denoc_ros.bags.joint_series import elapsed as elapsed
from denoc_ros.bags.joint_state import FIELDS, JOINT_STATE
from denoc_ros.bags.reader import BagMessage, Stamp, read_bag, read_raw, require_stamp
from denoc_ros.errors import BagError
from denoc_ros.types import Array, Stamps


@dataclass(frozen=True)
class ArraySeries:
    """Float64MultiArray over time.

    Attributes
    ----------
    stamp_ns : (k,) int array
        Times [ns].
    labels : tuple of str
        Names of the m columns, from the label of the first dimension, comma-separated; empty
        when it names another number of columns.
    values : (k, m) array
    """

    stamp_ns: Stamps
    labels: tuple[str, ...]
    values: Array

    @property
    def t(self) -> Array:
        """Times since the first message [s], (k,)."""
        return elapsed(self.stamp_ns)


@dataclass(frozen=True)
class Diagnostic:
    """One status of a DiagnosticArray: level 0 ok, 1 warning, 2 error, 3 stale."""

    stamp_ns: int
    name: str
    level: int
    message: str
    hardware_id: str
    values: dict[str, str]


def read_joint_states(
    path: str | Path,
    topic: str = '/joint_states',
    names: Sequence[str] | None = None,
    stamp: Stamp = 'header',
) -> JointSeries:
    """Read a topic of sensor_msgs/JointState into arrays, joints matched by name.

    Parameters
    ----------
    path : str or Path
        A bag that `read_bag` reads.
    topic : str
        The topic.
    names : sequence of str, optional
        The joints and their order; default: all, in the order of first appearance.
    stamp : {'header', 'log'}
        As `read_bag`.

    Raises
    ------
    BagError
        As `read_bag`; also for another type, a field of another length than `name`, or a joint
        that is in no message.
    """
    require_stamp(path, stamp)
    columns, logged = JointStateColumns(f'{path}: {topic}'), []
    for _, kind, log_ns, raw in read_raw(path, [topic]):
        if kind != JOINT_STATE:
            raise _wrong_type(path, topic, (JOINT_STATE,), kind)
        columns.append(raw, log_ns)
        logged.append(log_ns)
    series = columns.series()
    if stamp == 'log':
        series = replace(series, stamp_ns=np.array(logged, dtype=np.int64))
    return series if names is None else _chosen(path, topic, series, names)


def _chosen(
    path: str | Path, topic: str, series: JointSeries, names: Sequence[str]
) -> JointSeries:
    """Return some joints of a series, in the order of the names."""
    seen = series.names
    if len(series.stamp_ns) and (unknown := sorted(set(names) - set(seen))):
        raise BagError(
            f'{path}: joints on {topic} must be among {", ".join(seen)}, got {", ".join(unknown)}'
        )
    index = [seen.index(name) for name in names] if seen else [0] * len(names)
    # messages without joints give rows without columns
    chosen = {
        field: getattr(series, field)[:, index] if seen else np.empty((0, len(names)))
        for field in FIELDS
    }
    return JointSeries(series.stamp_ns, tuple(names), **chosen)


def read_arrays(path: str | Path, topic: str, stamp: Stamp = 'header') -> ArraySeries:
    """Read a topic of std_msgs/Float64MultiArray, or Float64, into an array.

    Raises
    ------
    BagError
        As `read_bag`; also for another type, or when the number of values changes.
    """
    messages = list(
        _of_type(path, topic, ('std_msgs/msg/Float64MultiArray', 'std_msgs/msg/Float64'), stamp)
    )
    rows = [np.atleast_1d(item.message.data) for item in messages]
    widths = sorted({len(row) for row in rows})
    if len(widths) > 1:
        raise BagError(f'{path}: messages on {topic} must keep their length, got {widths}')
    width = widths[0] if widths else 0
    layout = getattr(messages[0].message, 'layout', None) if messages else None
    labels = tuple(layout.dim[0].label.split(',')) if layout is not None and layout.dim else ()
    values = np.array(rows, dtype=np.float64).reshape(len(rows), width)
    return ArraySeries(_stamps(messages), labels if len(labels) == width else (), values)


def statuses(stamp_ns: int, message: Any) -> list[Diagnostic]:
    """Return the statuses of a DiagnosticArray that has a stamp [ns]."""
    return [
        Diagnostic(
            stamp_ns,
            status.name,
            int(status.level),
            status.message,
            status.hardware_id,
            {pair.key: pair.value for pair in status.values},
        )
        for status in message.status
    ]


def _of_type(
    path: str | Path, topic: str, types: str | tuple[str, ...], stamp: Stamp
) -> Iterator[BagMessage]:
    allowed = (types,) if isinstance(types, str) else types
    for item in read_bag(path, [topic], stamp):
        if item.type not in allowed:
            raise _wrong_type(path, topic, allowed, item.type)
        yield item


def _wrong_type(path: str | Path, topic: str, allowed: Sequence[str], kind: str) -> BagError:
    return BagError(f'{path}: topic {topic} must be of type {" or ".join(allowed)}, got {kind}')


def _stamps(messages: list[BagMessage]) -> Stamps:
    return np.array([item.stamp_ns for item in messages], dtype=np.int64)
