"""A recorded run, read in one pass: joint states as series, phases, and a few whole messages."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.bags.definitions import decode, message_types
from denoc_ros.bags.joint_state import JOINT_STATE
from denoc_ros.bags.reader import (
    RawMessage,
    bag_contents,
    bag_topics,
    header_stamp_ns,
    read_raw,
    read_thinned,
)
from denoc_ros.bags.series import JointSeries, JointStateColumns, Series, find_topic
from denoc_ros.errors import BagError
from denoc_ros.types import Array

UNFINISHED = '(unfinished)'  # behind the name of a phase that has no end
PHASE_TOPIC = '/up/phase'
PARAMETER_TOPIC = '/parameter_events'
# fields of rcl_interfaces/ParameterValue by its type, of those that hold numbers
NUMBER_FIELDS = {2: 'integer_value', 3: 'double_value', 8: 'double_array_value'}
REFERENCE = 'reference'
TRAJECTORY = 'trajectory_msgs/msg/JointTrajectory'
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
# Types of which whole messages are kept; there are few of each.
KEPT = ('std_msgs/msg/String', TRAJECTORY, DIAGNOSTICS)
ALL_TIME = (-math.inf, math.inf)
MOST_ROWS = 20_000  # of a topic that is thinned, whatever the run's length
LATEST_NS = 2**63  # stamps of messages and bags are below [ns]
SLACK = 1.0  # s that a message may be recorded before or after its stamp


@dataclass(frozen=True)
class RecordedPhase:
    """A phase by the clock of the recording [ns]: begin_ns <= stamp < end_ns.

    A recording that names no phases is one phase without a name.
    """

    name: str
    begin_ns: int = 0
    end_ns: int = LATEST_NS
    # numbers of the plant by dotted path, as far as the session noted them; None: it did not
    plant: Mapping[str, Any] | None = None
    # the same of the model that the session's nodes worked with
    model: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Interval:
    """A phase of the run, in seconds since the recording's origin."""

    name: str
    start: float
    end: float


@dataclass(frozen=True)
class Kept:
    """One whole message; times in seconds since the recording's origin."""

    log_time: float
    stamp: float
    message: Any


@dataclass(frozen=True)
class Diagnostic:
    """One status of a DiagnosticArray: level 0 ok, 1 warning, 2 error, 3 stale."""

    stamp_ns: int
    name: str
    level: int
    message: str
    hardware_id: str
    values: dict[str, str]


@dataclass(frozen=True)
class RecordedTopics:
    """Topics of a recorded run; all times count from its origin."""

    path: Path  # the bag
    topics: Mapping[str, str]  # name -> type of all topics
    counts: Mapping[str, int]  # name -> number of messages
    length: float  # from the first to the last message of the whole bag [s]
    joint_states: Mapping[str, JointSeries]  # by topic
    # log times [ns] and CDR bytes of the messages that are kept whole, by topic
    kept: Mapping[str, Sequence[tuple[int, bytes]]]
    origin_ns: int  # the first stamp of a JointState [ns]
    # `name`, `begin_ns` and `end_ns` (None: unfinished) of each phase, as a session notes them by
    # the clock of the recording
    noted: Sequence[Mapping[str, Any]] = ()

    @property
    def duration(self) -> float:
        """Seconds from the first to the last stamp."""
        last = max(series.stamp_ns.max() for series in self.joint_states.values())
        return float((last - self.origin_ns) * 1e-9)

    def joints(self, ending: str) -> JointSeries | None:
        """Return the JointState topic of this name or ending, None where it has no rows."""
        found = self.joint_states.get(find_topic(self.joint_states, ending))
        return found if found is not None and len(found.t) else None

    def series(self, ending: str, field: str = 'position') -> Series | None:
        """Return a field of the JointState topic with this name or ending, None without values.

        Parameters
        ----------
        ending : str
            Such as `joint_states` or `plant/true_deflection`.
        """
        found = self.joints(ending)
        series = None if found is None else found.field(field)
        return series if series is not None and np.isfinite(series.values).any() else None

    def messages(self, ending: str) -> list[Kept]:
        """Return the messages of a topic of one of the types `KEPT`; none if there is none."""
        topic = find_topic(self.kept, ending)
        found = []
        for log_ns, raw in self.kept.get(topic, ()):
            message, _ = decode(message_types(), self.topics[topic], raw)
            stamp_ns = header_stamp_ns(message) or log_ns
            found.append(Kept(self._seconds(log_ns), self._seconds(stamp_ns), message))
        return found

    def diagnostics(self) -> list[Diagnostic]:
        """Return every status of /diagnostics, in order."""
        return [
            status
            for kept in self.messages('diagnostics')
            for status in statuses(self.origin_ns + round(kept.stamp * 1e9), kept.message)
        ]

    @property
    def phases(self) -> tuple[Interval, ...]:
        """The phases in order: as noted, else as the bag marks them, else all of the recording."""
        marks = [
            (self.origin_ns + round(kept.log_time * 1e9), str(kept.message.data))
            for kept in self.messages(PHASE_TOPIC.lstrip('/'))
        ]
        return tuple(map(self._interval, phases_of(self.noted, marks)))

    @property
    def begin_ns(self) -> int:
        """When the first phase begins [ns]; 0 where the bag names none."""
        return self.span_ns(self.phases[0].start, np.inf)[0]

    def span_ns(self, begin: float, end: float) -> tuple[int, int]:
        """Return an interval of s since the origin in ns; infinite ends are those of all time."""
        first = self.origin_ns + round(begin * 1e9) if np.isfinite(begin) else 0
        last = self.origin_ns + round(end * 1e9) if np.isfinite(end) else 2**63
        return first, last

    def _seconds(self, stamp_ns: int) -> float:
        return (stamp_ns - self.origin_ns) * 1e-9

    def _interval(self, phase: RecordedPhase) -> Interval:
        """Return a phase in seconds since the origin; an open end is infinite."""
        begin = self._seconds(phase.begin_ns) if phase.begin_ns else -np.inf
        end = self._seconds(phase.end_ns) if phase.end_ns < LATEST_NS else np.inf
        return Interval(phase.name or 'run', begin, end)

    def marks(self) -> tuple[tuple[float, str], ...]:
        """Return times at which phases begin [s], and their names; '' where one ends.

        A phase with a reference begins with that, as `motions_of` says.
        """
        found = motions_of(self.path, phases_of(self.noted, read_marks(self.path)))
        marks: list[tuple[float, str]] = []
        for phase, following in zip_longest(found, found[1:]):
            if phase.name:
                marks.append((self._seconds(phase.begin_ns), phase.name))
                if phase.end_ns < (LATEST_NS if following is None else following.begin_ns):
                    marks.append((self._seconds(phase.end_ns), ''))
        return tuple(marks)


def phases_of(
    noted: Sequence[Mapping[str, Any]], marks: Sequence[tuple[int, str]]
) -> tuple[RecordedPhase, ...]:
    """Return the phases in order: as noted, else as marked, else one for the whole recording.

    Parameters
    ----------
    noted : sequence of mapping
        As of `RecordedTopics.noted`. The name of an unfinished phase says so.
    marks : sequence of (int, str)
        Times [ns] and the name of the phase that begins then, '' for an end.
    """
    if noted:
        return tuple(map(_noted_phase, noted))
    ends = [*marks[1:], (LATEST_NS, '')]
    found = tuple(
        RecordedPhase(name, begin_ns, end_ns)
        for (begin_ns, name), (end_ns, following) in zip(marks, ends, strict=False)
        if name not in ('', following)  # a name that comes twice is a phase that began anew
    )
    return found or (RecordedPhase(''),)


def _noted_phase(noted: Mapping[str, Any]) -> RecordedPhase:
    numbers = noted.get('plant'), noted.get('model')
    if noted.get('end_ns') is None:
        return RecordedPhase(
            f'{noted["name"]} {UNFINISHED}', noted['begin_ns'], LATEST_NS, *numbers
        )
    return RecordedPhase(noted['name'], noted['begin_ns'], noted['end_ns'], *numbers)


def read_marks(path: Path) -> list[tuple[int, str]]:
    """Return the marks of phases in a bag: log times [ns] and names, as `phases_of` takes them."""
    return [
        (log_ns, str(decode(message_types(), kind, raw)[0].data))
        for _, kind, log_ns, raw in read_raw(path, {PHASE_TOPIC} & {*bag_topics(path)})
    ]


def parameter_changes(path: Path, node: str) -> list[tuple[int, dict[str, Any]]]:
    """Return stamps [ns] and changed parameters of a node while a bag was recorded.

    Only numbers and arrays of numbers count.
    """
    found = []
    for _, kind, log_ns, raw in read_raw(path, {PARAMETER_TOPIC} & {*bag_topics(path)}):
        event = decode(message_types(), kind, raw)[0]
        if event.node.rpartition('/')[2] == node:
            changed = {
                each.name: getattr(each.value, NUMBER_FIELDS[each.value.type])
                for each in event.changed_parameters
                if each.value.type in NUMBER_FIELDS
            }
            found.append((header_stamp_ns(event) or log_ns, changed))
    return found


def motions_of(path: Path, phases: Sequence[RecordedPhase]) -> tuple[RecordedPhase, ...]:
    """Return phases from the start of their reference on: before it the robot goes to its start.

    A phase without a name or a reference stays. The bag is read for it, one message at a time: a
    streamed reference is long.
    """
    reference = find_topic(bag_topics(path), REFERENCE)
    if not reference:
        return tuple(phases)
    begins_ns = [0 if phase.name else phase.end_ns for phase in phases]
    for _, kind, log_ns, raw in read_raw(path, {reference}):
        for k, phase in enumerate(phases):
            within = phase.begin_ns <= log_ns < phase.end_ns
            if kind == TRAJECTORY and within and not begins_ns[k]:
                stamp_ns = header_stamp_ns(decode(message_types(), kind, raw)[0])
                begins_ns[k] = min(max(stamp_ns, log_ns), phase.end_ns)
    return tuple(
        replace(phase, begin_ns=begin_ns) if phase.name and begin_ns else phase
        for phase, begin_ns in zip(phases, begins_ns, strict=True)
    )


def read_run(
    path: Path,
    topics: Collection[str] | None = None,
    window: tuple[float, float] = ALL_TIME,
    rate: float = math.inf,
    phases: Sequence[Mapping[str, Any]] = (),
) -> RecordedTopics:
    """Read the joint states of a bag in one pass.

    Parameters
    ----------
    path : Path
        What `denoc_ros.bags.reader.read_bag` reads.
    topics : collection of str, optional
        Names or endings of topics of JointState; those that the bag does not have are left out.
        Default: all of them, and the messages of types `KEPT`.
    window : (float, float)
        What is read of the run [s since its origin].
    rate : float
        Rows per second at most [Hz]; where it is given, topics have at most `MOST_ROWS` rows, and
        messages in between are not opened.
    phases : sequence of mapping
        As of `RecordedTopics.noted`; empty: the marks in the bag tell.

    Raises
    ------
    BagError
        When the bag cannot be read, or has no JointState where none are named.
    """
    contents = bag_contents(path)
    length = 1e-9 * (contents.end_ns - contents.start_ns)
    kinds = {topic.name: topic.type for topic in contents.topics}
    states = {t.name for t in contents.topics if t.type == JOINT_STATE and t.messages}
    kept: dict[str, list[tuple[int, bytes]]] = {}
    if topics is None:
        kept = {t.name: [] for t in contents.topics if t.type in KEPT and t.messages}
    else:
        states = {name for ending in topics if (name := find_topic(states, ending))}
    columns = {topic: JointStateColumns(topic) for topic in states}
    for topic, kind, log_ns, raw in _raw(path, {*states, *kept}, window, rate, length):
        if topic in columns and kind == JOINT_STATE:
            columns[topic].append(raw, log_ns)
        elif topic in kept and kind == kinds[topic]:
            kept[topic].append((log_ns, bytes(raw)))
    series = {topic: column.merged() for topic, column in columns.items() if len(column)}
    if topics is None and not series:
        raise BagError(
            f'{path}: bag must have messages on a topic such as joint_states, '
            f'got topics {", ".join(sorted(kinds)) or "(none)"}'
        )
    origin_ns = min((int(one.stamp_ns.min()) for one in series.values()), default=0)
    rows = {topic: one.since(origin_ns) for topic, one in series.items()}
    if window != ALL_TIME:
        rows = {topic: one.between(*window) for topic, one in rows.items()}
    counts: Counter[str] = Counter()
    for one in contents.topics:
        counts[one.name] += one.messages
    return RecordedTopics(path, kinds, counts, length, rows, kept, origin_ns, phases)


def _raw(
    path: Path, topics: set[str], window: tuple[float, float], rate: float, length: float
) -> Iterator[RawMessage]:
    """Iterate over messages of topics; those that can be in a window, at a rate."""
    if not topics:
        return iter(())
    if rate == math.inf:
        return read_raw(path, topics)
    start, end = window
    period = max(1.0 / rate, (min(end, length) - max(start, 0.0)) / MOST_ROWS)
    slack = 1e9 * (SLACK + period)
    return read_thinned(path, topics, round(1e9 * period), 1e9 * start - slack, 1e9 * end + slack)


def point_columns(points: Sequence[Any]) -> tuple[Array, Array | None, Array | None]:
    """Return positions, velocities and accelerations (k, n) of the points of a JointTrajectory.

    None stands for rates or accelerations that a point lacks.
    """

    def column(field: str) -> Array | None:
        rows = [getattr(point, field) for point in points]
        return np.array(rows, dtype=np.float64) if all(map(len, rows)) else None

    positions = np.array([point.positions for point in points], dtype=np.float64)
    return positions, column('velocities'), column('accelerations')


def point_times(points: Sequence[Any]) -> Array:
    """Return the times (k,) [s] of the points of a JointTrajectory since its start."""
    since = [point.time_from_start for point in points]
    return np.array([each.sec + 1e-9 * each.nanosec for each in since])


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
