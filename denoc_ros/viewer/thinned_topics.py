"""Joint states of a bag's topics, thinned while they are read: a long run stays small."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from denoc_ros.bags.columns import JointStateColumns
from denoc_ros.bags.definitions import decode, message_types
from denoc_ros.bags.joint_state import JOINT_STATE
from denoc_ros.bags.reader import bag_contents, header_stamp_ns, read_raw
from denoc_ros.bags.series import JointSeries
from denoc_ros.bags.thinning import read_thinned
from denoc_ros.bags.topics import find_topic
from denoc_ros.types import Array

PHASES = '/up/phase'
REFERENCE = 'reference'
TRAJECTORY = 'trajectory_msgs/msg/JointTrajectory'
MOST_ROWS = 20_000  # of a topic, whatever the run's length
SLACK = 1.0  # s that a message may be recorded before or after its stamp


@dataclass(frozen=True)
class Rows:
    """Columns of one topic over time.

    Attributes
    ----------
    t : (k,) array
        Seconds since the origin, ascending.
    names : tuple of str
        Of the columns.
    position, velocity, effort : (k, names) arrays
        NaN where a message did not have it.
    """

    t: Array
    names: tuple[str, ...]
    position: Array
    velocity: Array
    effort: Array

    def has(self, names: Sequence[str]) -> bool:
        """Say whether all these columns are there."""
        return set(names) <= set(self.names)

    def complete(self, names: Sequence[str]) -> Rows:
        """Return the rows that have a finite position in all these columns."""
        whole = np.isfinite(self.columns(names)).all(axis=1)
        fields = (self.position[whole], self.velocity[whole], self.effort[whole])
        return Rows(self.t[whole], self.names, *fields)

    def columns(self, names: Sequence[str], field: str = 'position') -> Array:
        """Return the columns of these names, (k, names), in this order."""
        values: Array = getattr(self, field)
        return np.ascontiguousarray(values[:, [self.names.index(name) for name in names]])


class ThinnedTopics:
    """Topics of JointState in a bag, read in one pass that keeps some of the messages.

    Parameters
    ----------
    path : Path
        The bag.
    wanted : collection of str
        Names or endings of topics; those that the bag does not have are left out.
    start, end : float
        What is kept of the run [s since its origin, the first joint state].
    rate : float
        Rows per second at most; fewer where they would be more than `MOST_ROWS`.

    Attributes
    ----------
    names : tuple of str
        All topics of the bag.
    duration : float
        Of the whole bag [s].
    phases : tuple of (float, str)
        What the bag says on /up/phase, and when [s]; a phase with a reference begins with that:
        what comes before brings the robot to its start.

    Raises
    ------
    BagError
        When the bag cannot be read.
    """

    def __init__(
        self, path: Path, wanted: Collection[str], start: float, end: float, rate: float
    ) -> None:
        self._path, self._start, self._end = path, start, end
        contents = bag_contents(path)
        self.duration = 1e-9 * (contents.end_ns - contents.start_ns)
        self.names = tuple(topic.name for topic in contents.topics)
        states = {t.name for t in contents.topics if t.type == JOINT_STATE and t.messages}
        self._found = {suffix: name for suffix in wanted if (name := find_topic(states, suffix))}
        series = self._read(self._period(rate)) if self._found else {}
        origin_ns = min((int(one.stamp_ns.min()) for one in series.values()), default=0)
        self._rows = {topic: _cut(one, origin_ns, start, end) for topic, one in series.items()}
        self.phases = tuple(((ns - origin_ns) * 1e-9, name) for ns, name in self._marks())

    def rows(self, suffix: str) -> Rows | None:
        """Return the rows of a topic, None if it has none."""
        rows = self._rows.get(self._found.get(suffix, ''))
        return rows if rows is not None and len(rows.t) else None

    def _period(self, rate: float) -> float:
        """Return the time between kept messages [s]."""
        return max(1.0 / rate, (min(self._end, self.duration) - max(self._start, 0.0)) / MOST_ROWS)

    def _read(self, period: float) -> dict[str, JointSeries]:
        columns = {topic: JointStateColumns(topic) for topic in self._found.values()}
        step, slack = round(1e9 * period), 1e9 * (SLACK + period)
        early, late = 1e9 * self._start - slack, 1e9 * self._end + slack
        for topic, _, log_ns, raw in read_thinned(self._path, set(columns), step, early, late):
            columns[topic].append(raw, log_ns)
        return {topic: column.series() for topic, column in columns.items()}

    def _marks(self) -> list[tuple[int, str]]:
        """Beginnings of phases [ns] and their names: as marked, or with their references."""
        marks: list[tuple[int, str]] = []
        reference, waits = find_topic(self.names, REFERENCE), False
        for topic, kind, log_ns, raw in read_raw(self._path, {PHASES, reference} & {*self.names}):
            if topic == PHASES:
                if marks:  # one that ended before its reference began
                    marks[-1] = min(marks[-1][0], log_ns), marks[-1][1]
                name = str(decode(message_types(), kind, raw)[0].data)
                marks.append((log_ns, name))
                waits = bool(name)
            elif waits and kind == TRAJECTORY:
                stamp_ns = header_stamp_ns(decode(message_types(), kind, raw)[0])
                marks[-1] = max(stamp_ns, log_ns), marks[-1][1]
                waits = False
        return marks


def _cut(series: JointSeries, origin_ns: int, start: float, end: float) -> Rows:
    """Rows between start and end, in ascending time."""
    stamps, order = np.unique(series.stamp_ns, return_index=True)
    t = np.asarray((stamps - origin_ns) * 1e-9, dtype=np.float64)
    within = (t >= start) & (t <= end)
    order = order[within]
    fields = (series.position[order], series.velocity[order], series.effort[order])
    return Rows(t[within], series.names, *fields)
