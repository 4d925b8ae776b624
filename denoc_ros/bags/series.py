"""Numbers of a bag over time: joint states and other messages as arrays."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np

from denoc_ros.bags.cdr import CdrError, CdrReader
from denoc_ros.bags.joint_state import FIELDS, JOINT_STATE, JointStateLayout
from denoc_ros.bags.reader import Stamp, bag_topics, read_bag, read_raw, require_stamp
from denoc_ros.bags.sensor_messages import INERTIAL_NUMBERS, READERS, Place, axes
from denoc_ros.errors import BagError
from denoc_ros.types import Array, Flags, Stamps

_Part = TypeVar('_Part', bound='_Rows')

ARRAY_TYPES = ('std_msgs/msg/Float64MultiArray', 'std_msgs/msg/Float64')
ODOMETRY = 'nav_msgs/msg/Odometry'
MOST_LAYOUTS = 4  # Publishers of a topic whose layouts are kept.
LONGEST_PARTIAL_GAP_NS = 500_000_000  # Between messages of a joint that are farther apart,
LONGEST_PARTIAL_PERIODS = 5  # and by more than so many usual periods, its position is not known.


# numbers in messages, as dotted paths by message type
POSE_NUMBERS = {
    'geometry_msgs/msg/PoseStamped': (*axes('pose.position'), *axes('pose.orientation', 'xyzw'))
}
ODOMETRY_NUMBERS = {  # the twist is in the axes of the child frame
    ODOMETRY: (
        *axes('pose.pose.position'),
        *axes('pose.pose.orientation', 'xyzw'),
        *axes('twist.twist.linear'),
        *axes('twist.twist.angular'),
    )
}


@dataclass(frozen=True)
class _Rows:
    """Rows over time."""

    t: Array
    names: tuple[str, ...]
    ROWS: ClassVar[tuple[str, ...]] = ('t',)

    def __getitem__(self: _Part, rows: slice | Flags | Stamps) -> _Part:
        """Return some rows, by a slice, a mask or their numbers."""
        return replace(self, **{name: getattr(self, name)[rows] for name in self.ROWS})

    def between(self: _Part, start: float, end: float) -> _Part:
        """Return the rows with start <= t <= end."""
        within: Flags = (self.t >= start) & (self.t <= end)
        return self[within]


@dataclass(frozen=True)
class Series(_Rows):
    """Named values over time.

    Attributes
    ----------
    t : (k,) array
        Times [s].
    names : tuple of str
        Of the columns.
    values : (k, n) array
        SI units.
    """

    values: Array
    ROWS = ('t', 'values')

    def column(self, name: str) -> Array:
        """Return one column, (k,)."""
        column: Array = self.values[:, self.names.index(name)]
        return column

    def select(self, names: Sequence[str]) -> Series:
        """Return the columns of these names, in this order; NaN where there is none."""
        chosen = np.ascontiguousarray(_columns(self.names, self.values, names))
        return Series(self.t, tuple(names), chosen)

    def at(self, t: Array) -> Array:
        """Return the values interpolated linearly, (m, n), at times (m,); NaN outside."""
        if not len(self.t):
            return np.full((len(t), len(self.names)), np.nan)
        order = np.argsort(self.t, kind='stable')
        known, columns = self.t[order], self.values[order].T
        if not len(columns):
            return np.zeros((len(t), 0))
        return np.column_stack(
            [np.interp(t, known, column, left=np.nan, right=np.nan) for column in columns]
        )


@dataclass(frozen=True)
class JointSeries(_Rows):
    """Joint states over time.

    Attributes
    ----------
    t : (k,) array
        Times [s], of a whole series since its first message.
    names : tuple of str
        The m joints.
    position, velocity, effort : (k, m) array
        rad or m, per s, N m or N; NaN where a message did not have it.
    stamp_ns, log_ns : (k,) int array
        When they were measured and recorded [ns].
    """

    position: Array
    velocity: Array
    effort: Array
    stamp_ns: Stamps
    log_ns: Stamps
    ROWS = ('t', *FIELDS, 'stamp_ns', 'log_ns')

    def field(self, name: str) -> Series:
        """Return the position, the velocity or the effort alone."""
        return Series(self.t, self.names, getattr(self, name))

    def select(self, names: Sequence[str]) -> JointSeries:
        """Return the columns of these joints, in this order; NaN where there is none."""
        position, velocity, effort = (
            _columns(self.names, getattr(self, field), names) for field in FIELDS
        )
        return replace(
            self, names=tuple(names), position=position, velocity=velocity, effort=effort
        )

    def renamed(self, rename: Mapping[str, str]) -> JointSeries:
        """Return the series by the names that `renamed` gives to its joints."""
        found = renamed(self.names, rename)
        return replace(self.select(tuple(found.values())), names=tuple(found))

    def since(self, origin_ns: int) -> JointSeries:
        """Return the series with times since an origin [ns]."""
        return replace(self, t=elapsed(self.stamp_ns, origin_ns))

    def complete(self, names: Sequence[str] | None = None) -> JointSeries:
        """Return the rows that have a finite position of all joints, or of these."""
        whole = self if names is None else self.select(names)
        return self[np.flatnonzero(np.isfinite(whole.position).all(axis=1))]

    def rises(self, last_ns: int = np.iinfo(np.int64).min) -> Flags:
        """Return which stamps (k,) are later than all before, and than a last one [ns]."""
        latest = np.maximum.accumulate(np.concatenate([[last_ns], self.stamp_ns]))
        rises: Flags = self.stamp_ns > latest[:-1]
        return rises

    def rising(self, last_ns: int = np.iinfo(np.int64).min) -> JointSeries:
        """Return the rows with a stamp later than all before, and than a last one [ns]."""
        return self[self.rises(last_ns)]

    def ascending(self) -> JointSeries:
        """Return the rows in the order of their stamps, the first of those with equal ones."""
        return self[np.unique(self.stamp_ns, return_index=True)[1]]

    def followed_by(self, after: JointSeries) -> JointSeries:
        """Return these rows and, behind them, those of another series, with all joints of both."""
        names = tuple(dict.fromkeys((*self.names, *after.names)))
        parts = (self.select(names), after.select(names))
        rows = {row: np.concatenate([getattr(p, row) for p in parts]) for row in self.ROWS}
        return JointSeries(names=names, **rows)


def elapsed(stamp_ns: Stamps, origin_ns: int | None = None) -> Array:
    """Return seconds since an origin [ns], or since the first of some times in ns, (k,)."""
    since: Stamps = stamp_ns - (stamp_ns[:1] if origin_ns is None else origin_ns)
    return np.asarray(since * 1e-9, dtype=np.float64)


def renamed(names: Sequence[str], rename: Mapping[str, str]) -> dict[str, str]:
    """Map the robot's names to those in the bag.

    Parameters
    ----------
    rename : mapping of str to str
        Beginnings of these names and what they are in the robot; the longest that fits counts.
    """
    found = {}
    for name in names:
        start = max((s for s in rename if name.startswith(s)), key=len, default='')
        found[rename.get(start, '') + name[len(start) :]] = name
    return found


def _columns(names: Sequence[str], values: Array, wanted: Sequence[str]) -> Array:
    """Return the wanted columns, NaN where there is none."""
    places = [names.index(name) if name in names else len(names) for name in wanted]
    padded = np.column_stack([values, np.full(len(values), np.nan)])
    chosen: Array = padded[:, places]
    return chosen


class JointStateColumns:
    """Collects the raw messages of one topic; `series` makes arrays of them."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self._layout: JointStateLayout | None = None
        self._layouts: list[JointStateLayout] = []  # those of the last publishers
        self._stamps: list[int] = []
        self._logs: list[int] = []
        self._parts: list[tuple[JointStateLayout, int, tuple[bytearray, ...]]] = []

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self._stamps)

    def append(self, raw: bytes, log_ns: int) -> None:
        """Take in one message's CDR bytes; a zero stamp counts as its log time [ns]."""
        layout = self._layout
        if layout is None or not layout.fits(raw):
            known = (each for each in self._layouts if each.fits(raw))
            layout = self._layout = next(known, None) or self._learn(raw)
            self._parts.append((layout, len(self._stamps), tuple(bytearray() for _ in FIELDS)))
        self._stamps.append(layout.stamp_ns(raw) or log_ns)
        self._logs.append(log_ns)
        for store, (start, count) in zip(self._parts[-1][2], layout.blocks, strict=True):
            store += raw[start : start + 8 * count]

    def series(self, stamp: Stamp = 'header') -> JointSeries:
        """Return all messages as arrays; NaN where a message does not have a joint or field."""
        names = tuple(dict.fromkeys(name for part in self._parts for name in part[0].names))
        stamps, logs = (np.array(each, dtype=np.int64) for each in (self._stamps, self._logs))
        fields = {field: np.full((len(stamps), len(names)), np.nan) for field in FIELDS}
        for layout, first, stores in self._parts:
            columns = [names.index(name) for name in layout.names]
            for field, store, (_, count) in zip(FIELDS, stores, layout.blocks, strict=True):
                if count:
                    rows = np.frombuffer(store, dtype=f'{layout.order}f8').reshape(-1, count)
                    fields[field][first : first + len(rows), columns] = rows
        stamps = logs if stamp == 'log' else stamps
        return JointSeries(elapsed(stamps), names, **fields, stamp_ns=stamps, log_ns=logs)

    def named(self, names: Sequence[str]) -> Flags:
        """Return which of some joints each message names, (k, joints)."""
        found: Flags = np.zeros((len(self), len(names)), dtype=bool)
        edges = [*(first for _, first, _ in self._parts), len(self)]
        for (layout, _, _), (first, last) in zip(self._parts, pairwise(edges), strict=True):
            found[first:last] = [name in layout.names for name in names]
        return found

    def merged(self, stamp: Stamp = 'header') -> JointSeries:
        """Return all messages as `series`, those of several publishers joined by joint."""
        return PartialStates().join(self, stamp, is_last=True)

    def _learn(self, raw: bytes) -> JointStateLayout:
        try:
            layout = JointStateLayout.of(CdrReader(raw))
        except CdrError as error:
            raise BagError(
                f'{self.topic}: message must be a whole {JOINT_STATE}, got {len(raw)} bytes'
            ) from error
        if wrong := layout.wrong_length():
            field, count = wrong
            raise BagError(
                f'{self.topic}: {field} must have as many values as name has '
                f'({len(layout.names)}) or none, got {count}'
            )
        self._layouts = [layout, *self._layouts[: MOST_LAYOUTS - 1]]
        return layout


class PartialStates:
    """Joins messages of which none names all joints, as those of an arm and of its gripper.

    The messages with most joints stay, the joints of others are interpolated at their stamps, and
    NaN where there are none for long. Messages beside others that name all joints stay as they
    are. The last messages of a block wait for the next one.
    """

    def __init__(self) -> None:
        self._waiting: JointSeries | None = None
        self._named: Flags = np.zeros((0, 0), dtype=bool)
        self._done = 0  # of the waiting rows: those that are in an earlier block

    def join(self, columns: JointStateColumns, stamp: Stamp, is_last: bool) -> JointSeries:
        """Return the rows that are complete with a block of messages."""
        new = columns.series(stamp)
        named = columns.named(new.names)
        if self._waiting is None and (not len(named) or named.all(axis=1).any()):
            return new
        series, done, first = new, self._done, self._waiting
        if first is not None:
            series = first.followed_by(new)
            above = np.zeros((len(first.t), len(series.names)), dtype=bool)
            above[:, : self._named.shape[1]] = self._named
            below = columns.named(series.names)
            named = np.concatenate([above, below])
        self._waiting, self._done = None, 0
        if named[done:].all(axis=1).any():
            return series[done:]
        sizes = named.sum(axis=1)
        patterns, counts = np.unique(named[sizes == sizes.max()], axis=0, return_counts=True)
        main = patterns[np.argmax(counts)]
        of_main: Flags = (named == main).all(axis=1)
        others = [
            _Others(series, named[:, joint], joint) for joint in np.flatnonzero(~main).tolist()
        ]
        ready = len(series.t)
        if not is_last:
            ready = min((other.ready for other in others), default=ready)
            start = min([ready, *(other.before(ready) for other in others)])
            self._waiting, self._named = series[start:], named[start:]
            self._done = ready - start
        rows = np.flatnonzero(of_main[:ready])
        rows = rows[rows >= done]
        fields = {field: getattr(series, field)[rows].copy() for field in FIELDS}
        for other in others:
            for field, values in fields.items():
                values[:, other.joint] = other.at(series.stamp_ns[rows], field)
        return replace(series[rows], **fields)


class _Others:
    """Messages of a joint that the others do not name."""

    def __init__(self, series: JointSeries, named: Flags, joint: int) -> None:
        self.joint, self._series = joint, series
        self._rows = np.flatnonzero(named)
        stamps = series.stamp_ns[self._rows]
        periods = np.diff(np.unique(stamps))
        usual = float(np.median(periods)) if len(periods) else 0.0
        self._gap_ns = max(LONGEST_PARTIAL_GAP_NS, LONGEST_PARTIAL_PERIODS * usual)
        silent = len(stamps) == 0 or series.stamp_ns[-1] - stamps[-1] > self._gap_ns
        # the first row that has to wait for the next message of this joint
        self.ready = len(series.t) if silent else int(self._rows[-1])

    def before(self, row: int) -> int:
        """Return the joint's last row before another one, the first of all if there is none."""
        earlier = self._rows[self._rows < row]
        return int(earlier[-1]) if len(earlier) else row

    def at(self, stamp_ns: Stamps, field: str) -> Array:
        """Return a field of the joint at stamps (m,) [ns], NaN far from its messages."""
        stamps = self._series.stamp_ns[self._rows]
        values = getattr(self._series, field)[self._rows, self.joint]
        order = np.argsort(stamps, kind='stable')
        order = order[np.isfinite(values[order])]
        known, given = stamps[order], values[order]
        if not len(known):
            return np.full(len(stamp_ns), np.nan)
        after = np.searchsorted(known, stamp_ns, side='right')
        low, high = np.maximum(after - 1, 0), np.minimum(after, len(known) - 1)
        origin = known[0]
        found = np.interp(elapsed(stamp_ns, origin), elapsed(known, origin), given)
        # across a turn there is nothing between
        found = np.where(np.abs(given[high] - given[low]) > np.pi, given[low], found)
        far = (
            np.where(low == high, np.abs(stamp_ns - known[low]), known[high] - known[low])
            > self._gap_ns
        )
        return np.where(far & (stamp_ns != known[low]), np.nan, found)


def joint_state_blocks(
    path: str | Path, topics: Sequence[str], rows: int = 0, stamp: Stamp = 'header'
) -> Iterator[dict[str, JointSeries]]:
    """Iterate over topics of JointState in blocks, so that a bag of any length can be read.

    Parameters
    ----------
    topics : sequence of str
        All are in each block, with the messages that were recorded since the block before.
    rows : int
        Messages of the first topic in a block; 0: the whole bag is one block.

    Raises
    ------
    BagError
        As `read_bag`; also for another type, or a field of another length than `name`.
    """
    require_stamp(path, stamp)

    def empty() -> dict[str, JointStateColumns]:
        return {topic: JointStateColumns(f'{path}: {topic}') for topic in topics}

    columns, parts = empty(), {topic: PartialStates() for topic in topics}

    def block(is_last: bool) -> dict[str, JointSeries]:
        return {topic: parts[topic].join(columns[topic], stamp, is_last) for topic in topics}

    for topic, kind, log_ns, raw in read_raw(path, topics):
        if kind != JOINT_STATE:
            raise _wrong_type(path, topic, (JOINT_STATE,), kind)
        columns[topic].append(raw, log_ns)
        if topic == topics[0] and len(columns[topic]) == rows:
            yield block(is_last=False)
            columns = empty()
    yield block(is_last=True)


def read_joint_states(
    path: str | Path,
    topic: str = '/joint_states',
    names: Sequence[str] | None = None,
    stamp: Stamp = 'header',
) -> JointSeries:
    """Read a topic of sensor_msgs/JointState into arrays, joints matched by name.

    Parameters
    ----------
    names : sequence of str, optional
        The joints and their order; default: all, in the order of first appearance.

    Raises
    ------
    BagError
        As `read_bag`; also for another type, a field of another length than `name`, or a joint
        that is in no message.
    """
    series = next(joint_state_blocks(path, [topic], stamp=stamp))[topic]
    if names is None:
        return series
    if len(series.t) and (unknown := sorted(set(names) - set(series.names))):
        raise BagError(
            f'{path}: joints on {topic} must be among {", ".join(series.names)}, '
            f'got {", ".join(unknown)}'
        )
    return series.select(names)


def read_arrays(path: str | Path, topic: str, stamp: Stamp = 'header') -> tuple[Stamps, Series]:
    """Read a topic of std_msgs/Float64MultiArray, or Float64: stamps [ns], and named columns.

    Raises
    ------
    BagError
        As `read_bag`; also for another type, or when the number of values changes.
    """
    messages = list(read_bag(path, [topic], stamp))
    if others := [item.type for item in messages if item.type not in ARRAY_TYPES]:
        raise _wrong_type(path, topic, ARRAY_TYPES, others[0])
    rows = [np.atleast_1d(item.message.data) for item in messages]
    widths = sorted({len(row) for row in rows})
    if len(widths) > 1:
        raise BagError(f'{path}: messages on {topic} must keep their length, got {widths}')
    stamps = np.array([item.stamp_ns for item in messages], dtype=np.int64)
    names = element_names(messages[0].message) if messages else ()
    values = np.array(rows, dtype=np.float64).reshape(len(rows), len(names))
    return stamps, Series(elapsed(stamps), names, values)


def element_names(message: Any) -> tuple[str, ...]:
    """Names of the elements of a Float64MultiArray, or Float64.

    They come from the label of the first dimension, comma-separated; where it names another
    number of elements, or there is none, the elements are numbered from 0.
    """
    width = np.size(message.data)
    dimensions: Sequence[Any] = getattr(getattr(message, 'layout', None), 'dim', ())
    labels = tuple(dimensions[0].label.split(',')) if len(dimensions) else ()
    return labels if len(labels) == width else tuple(map(str, range(width)))


def read_numbers(
    path: str | Path, topic: str, paths: Mapping[str, Sequence[str]], stamp: Stamp = 'header'
) -> tuple[Stamps, Array]:
    """Read numbers in the messages of a topic.

    Parameters
    ----------
    paths : mapping of str to sequence of str
        By the message types that the topic may have: where n numbers are in a message, as
        `ODOMETRY_NUMBERS` has them.

    Returns
    -------
    stamps : (k,) int array
        [ns]
    numbers : (k, n) array

    Raises
    ------
    BagError
        As `read_bag`; also for a topic that is not there, or of another type.
    """
    topics = bag_topics(path)
    topic = resolved(topic, topics)
    kind = topics.get(topic, '')
    stamps, rows = [], []
    for item in read_bag(path, [topic], stamp):
        if item.type not in paths or item.type != kind:
            raise BagError(f'{path}: topic {topic} must be {" or ".join(paths)}, got {item.type}')
        stamps.append(item.stamp_ns)
        rows.append([operator.attrgetter(each)(item.message) for each in paths[kind]])
    numbers = np.array(rows, dtype=np.float64).reshape(len(rows), len(paths.get(kind, ())))
    return np.array(stamps, dtype=np.int64), numbers


def inertial_numbers(kind: str, vectors: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Return where messages of a type have angular rate (`gyro`), specific force (`accel`)."""
    known = INERTIAL_NUMBERS[kind]
    return {kind: tuple(path for vector in vectors for path in known[vector])}


def read_readings(path: str | Path, topic: str, places: Sequence[Place]) -> tuple[Stamps, Array]:
    """Return stamps (k,) [ns] and raw readings (k, sensors) of the sensors of a topic.

    Raises
    ------
    BagError
        As `read_bag`; also for a topic of another type, and a message without a sensor.
    """
    stamps, readings = [], []
    topic = resolved(topic, bag_topics(path))
    readers = {kind: make() for kind, make in READERS.items()}
    # The readers slice the bytes themselves: a decoded message would cost four times as much.
    for _, kind, log_ns, raw in read_raw(path, [topic]):
        if kind not in readers:
            raise BagError(
                f'{path}: topic {topic} must be one of {", ".join(readers)}, got {kind}'
            )
        found = []
        for place in places:
            try:
                stamp_ns, reading = readers[kind](CdrReader, raw, place)
            except CdrError as error:
                raise BagError(
                    f'{path}: messages on {topic} must hold sensor {place[0]!r} '
                    f'(field {place[1] or place[0]!r}), got one without'
                ) from error
            found.append(reading)
        stamps.append(stamp_ns or log_ns)
        readings.append(found)
    values = np.array(readings, dtype=np.float64).reshape(len(readings), len(places))
    return np.array(stamps, dtype=np.int64), values


def resolved(topic: str, topics: Iterable[str]) -> str:
    """Return the absolute name of a topic: in the root, else where only one namespace has it."""
    if topic.startswith('/'):
        return topic
    name = f'/{topic}'
    found = [each for each in topics if each.endswith(name)]
    return found[0] if len(found) == 1 else name


def find_topic(topics: Iterable[str], ending: str) -> str:
    """Return the topic of this name or, failing that, the first that ends so; '' for none."""
    names = sorted(topics)
    exact = [name for name in names if name.lstrip('/') == ending]
    return next(iter(exact + [name for name in names if name.endswith(f'/{ending}')]), '')


def _wrong_type(path: str | Path, topic: str, allowed: Sequence[str], kind: str) -> BagError:
    return BagError(f'{path}: topic {topic} must be of type {" or ".join(allowed)}, got {kind}')
