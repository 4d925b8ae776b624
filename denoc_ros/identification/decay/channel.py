"""Find a signal in a bag or a table, and read its record."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.bags.definitions import DefinitionError
from denoc_ros.bags.joint_state import FIELDS, JOINT_STATE
from denoc_ros.bags.reader import bag_folder, bag_topics, read_bag, warn_left_out
from denoc_ros.bags.series import elapsed, element_names, read_arrays, read_joint_states
from denoc_ros.errors import BagError
from denoc_ros.identification.decay.records import Record
from denoc_ros.identification.tables.joint_table import (
    MOST_PER_STAMP,
    RecordedWindow,
    shown,
    table_times,
    used_rows,
)
from denoc_ros.identification.tables.tables import is_table, read_table
from denoc_ros.settings import setting
from denoc_ros.types import Array, Stamps

MULTI_ARRAY = 'std_msgs/msg/Float64MultiArray'
DEFLECTION_UNITS = {'u': 'm', 'r': 'rad'}
REPEAT = 'with the time of another'
DEEPEST = 4  # levels of a message that are looked into


@dataclass(frozen=True)
class Channel(RecordedWindow):
    """One signal of a file: its place, and its conversion to a quantity."""

    # where there is one topic of numbers, or one field, its name may be left out
    topic: str = setting('', 'topic of a bag, such as /predictor/tip_deflection')
    field: str = setting(
        '',
        'name in a JointState (arm/uy), label or index in an array, dotted path in another '
        'message (wrench.force.x), or column of a table',
    )
    quantity: str = setting('position', 'quantity of a JointState', choices=FIELDS)
    gain: float = setting(1.0, 'value = gain * raw + offset', finite=True)
    offset: float = setting(
        0.0, 'offset in value = gain * raw + offset, in the unit of the value', finite=True
    )
    unit: str = setting('', 'unit of the value')

    @property
    def name(self) -> str:
        """Name of the channel in reports."""
        where = ' '.join(filter(None, (self.topic, self.field)))
        return f'{where} {self.quantity}' if self.topic and self.quantity != 'position' else where


@dataclass(frozen=True, eq=False)
class Reading:
    """A record and its source."""

    record: Record  # times from the channel's first sample on [s]
    path: Path  # the file
    channel: Channel  # with all that was left out of it filled in
    origin_ns: int = 0  # stamp of time 0 [ns]; 0 in a table
    # rows or messages in the window that are not in the record, by why
    lost: Mapping[str, int] = field(default_factory=dict)
    doubt: str = ''  # why a result is doubtful: too few of the rows are used

    @property
    def rows(self) -> int:
        """Rows or messages in the window that have the signal."""
        return len(self.record.t) + sum(self.lost.values())


def read_record(path: str | Path, channel: Channel) -> Reading:
    """Return a channel's record.

    Parameters
    ----------
    path : str or Path
        A bag, or a table that `read_table` reads.
    channel : Channel
        What is left out of it is found where there is no choice.

    Raises
    ------
    BagError
        When the file cannot be read, or does not have the channel; it says what it has.
    IdentificationError
        When the samples make no record.
    """
    path = bag_folder(Path(path))
    origin_ns = 0
    lost: dict[str, int] = {}
    if is_table(path):
        channel, t, raw, lost = _table_samples(path, channel)
    else:
        channel, stamp_ns, raw = _bag_samples(path, channel)
        t, origin_ns = elapsed(stamp_ns), int(stamp_ns[0]) if len(stamp_ns) else 0
    there = np.isfinite(raw) & np.isfinite(t)
    t, raw = t[there], raw[there]
    window = (t >= channel.begin) & (t <= channel.end)
    unit = channel.unit or _deflection_unit(channel)
    values = channel.gain * raw[window] + channel.offset
    if channel.topic:
        _require_own_stamps(path, channel, t[window])
    record = Record(t[window], values, f'{path.name}: {channel.name}', unit)
    # The rows that were not read lie anywhere in the file: a window has its share of them.
    lost = {why: round(count * np.mean(window)) for why, count in lost.items()}
    lost[REPEAT] = len(values) - len(record.t)
    rows = len(record.t) + sum(lost.values())
    why = ', '.join(f'{count} {reason}' for reason, count in lost.items() if count)
    doubt = used_rows(record.name, len(record.t), rows, why)
    return Reading(record, path, replace(channel, unit=unit), origin_ns, lost, doubt)


def _require_own_stamps(path: Path, channel: Channel, t: Array) -> None:
    """Raise BagError where most messages have the stamp of another."""
    stamps = len(np.unique(t))
    if stamps and len(t) >= MOST_PER_STAMP * stamps:
        other = 'log' if channel.stamp == 'header' else 'header'
        raise BagError(
            f'{path}: messages on {channel.topic} must have stamps of their own, got '
            f'{len(t) / stamps:.3g} messages per stamp ({len(t)} with {stamps} stamps): '
            f'use --stamp {other}'
        )


def joint_positions(reading: Reading, begin: float, end: float) -> dict[str, float]:
    """Return the median positions of a bag's joints in a window of a record's time [s].

    {} where the bag has no `/joint_states`. Errors as `read_record`.
    """
    if is_table(reading.path) or '/joint_states' not in bag_topics(reading.path):
        return {}
    series = read_joint_states(reading.path, stamp=reading.channel.stamp)
    rows = series.since(reading.origin_ns).between(begin, end)
    if not len(rows.t):
        return {}
    return dict(zip(rows.names, np.nanmedian(rows.position, axis=0).tolist(), strict=True))


def channels_of(path: str | Path) -> list[Channel]:
    """Return every channel of numbers in a file; errors as `read_record`."""
    path = Path(path)
    if is_table(path):
        columns = read_table(path)
        longest = max(map(len, columns.values()))
        return [
            Channel(field=name)
            for name, values in columns.items()
            if len(values) == longest and not columns.is_time(name)
        ]
    return list(_bag_channels(path))


def _deflection_unit(channel: Channel) -> str:
    """Return the unit of a deflection such as `arm/uy`, '' where the name does not say."""
    component = re.search(r'/([ur])[xyz]$', channel.field)
    if channel.gain != 1.0 or channel.quantity != 'position' or component is None:
        return ''
    return DEFLECTION_UNITS[component[1]]


def _table_samples(path: Path, channel: Channel) -> tuple[Channel, Array, Array, dict[str, int]]:
    columns = read_table(path)
    others = [name for name in columns if name != channel.time and not columns.is_time(name)]
    field = channel.field or _only_one(path, 'field', others)
    if field not in columns:
        listed = shown(list(columns))
        raise BagError(f'{path}: field must be a column of numbers ({listed}), got {field!r}')
    values = columns[field]
    time, unit, t = table_times(path, columns, channel, len(values))
    if len(t) != len(values):
        raise BagError(
            f'{path}: {field} must have as many values as {time} has ({len(t)}), got {len(values)}'
        )
    unread = columns.unread
    lost = {'with other cells': columns.left_out, 'without a number': unread.get(field, 0)}
    if channel.rate > 0.0 or not time:
        rate = channel.rate or 1.0 / columns.step
        return replace(channel, field=field, time='', rate=rate), t, values, lost
    lost['without a time'] = unread.get(time, 0)
    return replace(channel, field=field, time=time, time_unit=unit), t, values, lost


def _bag_samples(path: Path, channel: Channel) -> tuple[Channel, Stamps, Array]:
    topics = bag_topics(path)
    if not (channel.topic and channel.field):
        channel = _completed(path, channel)
    kind = topics.get(channel.topic, '')
    if kind == JOINT_STATE:
        joints = read_joint_states(path, channel.topic, [channel.field], channel.stamp)
        values = getattr(joints, channel.quantity)[:, 0]
        given = [one for one in FIELDS if np.any(np.isfinite(getattr(joints, one)))]
        if len(values) and channel.quantity not in given:
            raise BagError(
                f'{path}: {channel.quantity} of {channel.field} on {channel.topic} must be in the '
                f'messages, which have {" and ".join(given) or "none"}: --quantity'
            )
        return channel, joints.stamp_ns, values
    if kind == MULTI_ARRAY:
        stamp_ns, arrays = read_arrays(path, channel.topic, channel.stamp)
        if channel.field not in arrays.names:
            raise BagError(
                f'{path}: field of {channel.topic} must be one of {", ".join(arrays.names)}, '
                f'got {channel.field!r}'
            )
        return channel, stamp_ns, arrays.column(channel.field)
    stamps, values = [], []
    for item in read_bag(path, [channel.topic], channel.stamp):
        stamps.append(item.stamp_ns)
        values.append(_value(path, channel, item.message))
    return channel, np.array(stamps, dtype=np.int64), np.array(values, dtype=np.float64)


def _completed(path: Path, channel: Channel) -> Channel:
    """Return the channel with topic and field where the bag leaves no choice."""
    found = list(_bag_channels(path))
    if channel.topic:
        found = [one for one in found if one.topic == channel.topic]
    topic = channel.topic or _only_one(path, 'topic', list(dict.fromkeys(c.topic for c in found)))
    fields = list(dict.fromkeys(one.field for one in found if one.topic == topic))
    field = channel.field or _only_one(path, f'field of {topic}', fields)
    return replace(channel, topic=topic, field=field)


def _only_one(path: Path, whose: str, names: list[str]) -> str:
    if len(names) != 1:
        listed = shown(names) or '(none)'
        raise BagError(f'{path}: {whose} must be given, one of {listed}, got none')
    return names[0]


def _value(path: Path, channel: Channel, message: Any) -> float:
    """Return the number at a dotted path such as `wrench.force.x` or `data[2]`."""
    value = message
    try:
        for name, index in re.findall(r'(\w+)(?:\[(\d+)\])?\.?', channel.field):
            value = getattr(value, name)
            value = value[int(index)] if index else value
        return float(value)
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        known = ', '.join(name for name, _ in _numbers(message, '', DEEPEST))
        raise BagError(
            f'{path}: field of {channel.topic} must be a number in its messages '
            f'({known or "none there"}), got {channel.field!r}'
        ) from error


def _bag_channels(path: Path) -> Iterator[Channel]:
    for topic in bag_topics(path):
        try:
            item = next(read_bag(path, [topic]), None)
        except DefinitionError as error:
            warn_left_out(str(error))
            continue
        if item is not None:
            yield from _message_channels(topic, item.type, item.message)


def _message_channels(topic: str, kind: str, message: Any) -> Iterator[Channel]:
    if kind == JOINT_STATE:
        for quantity in FIELDS:
            if len(getattr(message, quantity)):
                yield from (Channel(topic, name, quantity) for name in message.name)
    elif kind == MULTI_ARRAY:
        yield from (Channel(topic, name) for name in element_names(message))
    else:
        yield from (Channel(topic, name) for name, _ in _numbers(message, '', DEEPEST))


def _numbers(value: Any, name: str, depth: int) -> Iterator[tuple[str, float]]:
    """Yield the floating-point numbers of a message with their dotted paths."""
    if isinstance(value, float):
        yield name, value
    elif depth and hasattr(value, '__dataclass_fields__'):
        for inner in value.__dataclass_fields__:
            yield from _numbers(getattr(value, inner), f'{name}.{inner}'.lstrip('.'), depth - 1)
