"""A recorded run: the topics that denoc_ros knows, as series, whatever else the bag holds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.bags.columns import JointStateColumns
from denoc_ros.bags.definitions import decode, message_types
from denoc_ros.bags.joint_state import JOINT_STATE
from denoc_ros.bags.reader import bag_topics, header_stamp_ns, read_raw
from denoc_ros.bags.series import Diagnostic, JointSeries, statuses
from denoc_ros.bags.topics import find_topic
from denoc_ros.errors import BagError
from denoc_ros.types import Array

UNFINISHED = '(unfinished)'  # behind the name of a phase that has no end
PHASE_TOPIC = '/up/phase'
ASKED_TOPICS = ('up/asked', 'shaper/input')  # what a shaped reference was shaped from
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
# Types of which whole messages are kept; there are few of each.
KEPT = ('std_msgs/msg/String', 'trajectory_msgs/msg/JointTrajectory', DIAGNOSTICS)


@dataclass(frozen=True)
class Series:
    """Named values over time.

    Attributes
    ----------
    t : (k,) array
        Stamps [s].
    names : tuple of str
        Of the columns.
    values : (k, n) array
        SI units.
    """

    t: Array
    names: tuple[str, ...]
    values: Array

    def column(self, name: str) -> Array:
        """Return one column, (k,)."""
        column: Array = self.values[:, self.names.index(name)]
        return column

    def select(self, names: tuple[str, ...]) -> Series:
        """Return the columns of these names, in this order."""
        return Series(self.t, names, np.column_stack([self.column(name) for name in names]))

    def between(self, start: float, end: float) -> Series:
        """Return the rows with start <= t <= end."""
        rows = (self.t >= start) & (self.t <= end)
        return Series(self.t[rows], self.names, self.values[rows])

    def at(self, t: Array) -> Array:
        """Return the values interpolated linearly, (m, n), at times (m,); NaN outside."""
        columns = [
            np.interp(t, self.t, column, left=np.nan, right=np.nan) for column in self.values.T
        ]
        return np.column_stack(columns)


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


class RecordedTopics:
    """One bag, read in one pass.

    Parameters
    ----------
    path : Path
        What `denoc_ros.bags.reader.read_bag` reads.
    phases : sequence of mapping
        `name`, `begin_ns` and `end_ns` (None: unfinished) of each phase, as a session notes them
        by the clock of the recording; empty: the marks in the bag tell.

    Attributes
    ----------
    path : Path
        The bag.
    topics : dict of str to str
        Name -> type of all topics.
    counts : dict of str to int
        Name -> number of messages.
    origin_ns : int
        The first stamp of a JointState [ns]; all times count from it.
    phases : tuple of Interval
        In order; all of the recording where the bag names none.

    Raises
    ------
    BagError
        When it cannot be read, or has no JointState.
    """

    def __init__(self, path: Path, phases: Sequence[Mapping[str, Any]] = ()) -> None:
        self.path = path
        self.topics = bag_topics(path)
        self.counts = dict.fromkeys(self.topics, 0)
        self._kept: dict[str, list[tuple[int, bytes]]] = {}
        self._series = self._read()
        starts = [series.stamp_ns.min() for series in self._series.values()]
        if not starts:
            raise BagError(
                f'{path}: bag must have messages on a topic such as joint_states, '
                f'got topics {", ".join(sorted(self.topics)) or "(none)"}'
            )
        self.origin_ns = int(min(starts))
        self.phases = tuple(map(self._interval, phases)) or tuple(self._intervals())

    def _read(self) -> dict[str, JointSeries]:
        columns: dict[str, JointStateColumns] = {}
        for topic, kind, log_ns, raw in read_raw(self.path):
            self.counts[topic] += 1
            if kind == JOINT_STATE:
                if topic not in columns:
                    columns[topic] = JointStateColumns(topic)
                columns[topic].append(raw, log_ns)
            elif kind in KEPT:
                self._kept.setdefault(topic, []).append((log_ns, bytes(raw)))
        return {topic: column.series() for topic, column in columns.items()}

    @property
    def duration(self) -> float:
        """Seconds from the first to the last stamp."""
        last = max(series.stamp_ns.max() for series in self._series.values())
        return float((last - self.origin_ns) * 1e-9)

    @property
    def begin_ns(self) -> int:
        """When the first phase begins [ns]; 0 where the bag names none."""
        return self.span_ns(self.phases[0].start, np.inf)[0]

    def span_ns(self, begin: float, end: float) -> tuple[int, int]:
        """Return an interval of s since the origin in ns; infinite ends are those of all time."""
        first = self.origin_ns + round(begin * 1e9) if np.isfinite(begin) else 0
        last = self.origin_ns + round(end * 1e9) if np.isfinite(end) else 2**63
        return first, last

    def series(self, suffix: str, field: str = 'position') -> Series | None:
        """Return a field of the JointState topic with this name or ending, None without values.

        Parameters
        ----------
        suffix : str
            Such as `joint_states` or `plant/true_deflection`.
        field : str
            `position`, `velocity` or `effort`.
        """
        found = self._series.get(find_topic(self._series, suffix))
        if found is None:
            return None
        values: Array = getattr(found, field)
        if not np.isfinite(values).any():
            return None
        t = np.asarray((found.stamp_ns - self.origin_ns) * 1e-9, dtype=np.float64)
        return Series(t, found.names, values)

    def messages(self, suffix: str) -> list[Kept]:
        """Return the messages of a topic of one of the types `KEPT`; none if there is none."""
        topic = find_topic(self._kept, suffix)
        kept = []
        for log_ns, raw in self._kept.get(topic, []):
            message, _ = decode(message_types(), self.topics[topic], raw)
            stamp_ns = header_stamp_ns(message) or log_ns
            kept.append(Kept(self._seconds(log_ns), self._seconds(stamp_ns), message))
        return kept

    def diagnostics(self) -> list[Diagnostic]:
        """Return every status of /diagnostics, in order."""
        return [
            status
            for kept in self.messages('diagnostics')
            for status in statuses(self.origin_ns + round(kept.stamp * 1e9), kept.message)
        ]

    def _seconds(self, stamp_ns: int) -> float:
        return (stamp_ns - self.origin_ns) * 1e-9

    def _interval(self, phase: Mapping[str, Any]) -> Interval:
        """Return a phase as its session noted it; an unfinished one says so by its name."""
        end = phase['end_ns']
        begin = self._seconds(phase['begin_ns'])
        if end is None:
            return Interval(f'{phase["name"]} {UNFINISHED}', begin, np.inf)
        return Interval(phase['name'], begin, self._seconds(end))

    def _intervals(self) -> Iterator[Interval]:
        """Yield the phases: each message names the phase that begins then, '' an end."""
        marks = [
            (kept.log_time, str(kept.message.data))
            for kept in self.messages(PHASE_TOPIC.lstrip('/'))
        ]
        if not any(name for _, name in marks):
            yield Interval('run', -np.inf, np.inf)
            return
        ends = [t for t, _ in marks[1:]] + [np.inf]
        for (start, name), end in zip(marks, ends, strict=True):
            if name:
                yield Interval(name, start, end)
