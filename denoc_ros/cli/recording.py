"""A recorded run: the topics that denoc_ros knows, as series, whatever else the bag holds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from denoc_ros.bags.reader import BagMessage, bag_topics, read_attachment, read_bag
from denoc_ros.bags.series import Diagnostic, JointSeries, read_diagnostics, read_joint_states
from denoc_ros.errors import BagError

Array = NDArray[np.float64]
JOINT_STATE = 'sensor_msgs/msg/JointState'
PHASE_TOPIC = '/up/phase'
DESCRIPTION_ATTACHMENT = 'robot_description.urdf'
# Topics a report reads, by the end of their names.
SERIES = (
    'joint_states',
    'feedforward/effort',
    'predictor/tip_deflection',
    'plant/true_deflection',
    'plant/true_modal_state',
)


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


class Recording:
    """The topics of one bag, each read when it is asked for.

    Parameters
    ----------
    path : Path
        What `denoc_ros.bags.reader.read_bag` reads.
    progress : callable, optional
        Called with the name of each topic before it is read.

    Attributes
    ----------
    path : Path
        The bag.
    topics : dict of str to str
        Name -> type of all topics.
    origin_ns : int
        The first stamp [ns]; all times count from it.
    phases : tuple of Interval
        In order; all of the recording where the bag names none.

    Raises
    ------
    BagError
        When it cannot be read, or has none of the topics that a report shows.
    """

    def __init__(self, path: Path, progress: Callable[[str], None] = lambda _: None) -> None:
        self.path = path
        self.topics = bag_topics(path)
        self._joint_states: dict[str, JointSeries] = {}
        for suffix in SERIES:
            if topic := self._find(suffix, JOINT_STATE):
                progress(topic)
                self._joint_states[suffix] = read_joint_states(path, topic)
        starts = [series.stamp_ns.min() for series in self._joint_states.values() if len(series.t)]
        if not starts:
            raise BagError(
                f'{path}: bag must have messages on a topic such as joint_states, '
                f'got topics {", ".join(sorted(self.topics)) or "(none)"}'
            )
        self.origin_ns = int(min(starts))
        self.phases = tuple(self._intervals())

    @property
    def duration(self) -> float:
        """Seconds from the first to the last stamp."""
        ends = [series.stamp_ns.max() for series in self._joint_states.values() if len(series.t)]
        return float((max(ends) - self.origin_ns) * 1e-9)

    def series(self, suffix: str, field: str = 'position') -> Series | None:
        """Return a field of one of `SERIES`, None where the bag has no such values.

        Parameters
        ----------
        suffix : str
            One of `SERIES`.
        field : str
            `position`, `velocity` or `effort`.
        """
        found = self._joint_states.get(suffix)
        if found is None:
            return None
        values: Array = getattr(found, field)
        if not np.isfinite(values).any():
            return None
        t = np.asarray((found.stamp_ns - self.origin_ns) * 1e-9, dtype=np.float64)
        return Series(t, found.names, values)

    def messages(self, suffix: str) -> list[BagMessage]:
        """Return all messages of the topic with this name or ending; none if there is none."""
        topic = self._find(suffix)
        return list(read_bag(self.path, [topic])) if topic else []

    def diagnostics(self) -> list[Diagnostic]:
        """Return every status of /diagnostics, in order."""
        topic = self._find('diagnostics', 'diagnostic_msgs/msg/DiagnosticArray')
        return read_diagnostics(self.path, topic) if topic else []

    def seconds(self, stamp_ns: int) -> float:
        """Return a stamp as seconds since the origin."""
        return (stamp_ns - self.origin_ns) * 1e-9

    def description(self) -> str:
        """Return the robot's URDF as attached or as published, '' if the bag has none."""
        try:
            return read_attachment(self.path, DESCRIPTION_ATTACHMENT).decode()
        except BagError:
            published = self.messages('robot_description')
            return str(published[-1].message.data) if published else ''

    def _find(self, suffix: str, kind: str = '') -> str:
        names = sorted(name for name, held in self.topics.items() if kind in ('', held))
        exact = [name for name in names if name.lstrip('/') == suffix]
        return next(iter(exact + [name for name in names if name.endswith(f'/{suffix}')]), '')

    def _intervals(self) -> Iterator[Interval]:
        """Yield the phases: each message names what begins then, '' that a phase has ended."""
        marks = [
            (self.seconds(item.log_ns), str(item.message.data))
            for item in self.messages(PHASE_TOPIC.lstrip('/'))
        ]
        if not any(name for _, name in marks):
            yield Interval('run', -np.inf, np.inf)
            return
        ends = [t for t, _ in marks[1:]] + [np.inf]
        for (start, name), end in zip(marks, ends, strict=True):
            if name:
                yield Interval(name, start, end)
