"""Joint states out of a bag in blocks, whatever its length, with their smoothed motion."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from denoc_ros.bags.columns import JointStateColumns
from denoc_ros.bags.joint_state import FIELDS
from denoc_ros.bags.reader import Stamp, read_raw
from denoc_ros.bags.series import JointSeries
from denoc_ros.errors import BagError
from denoc_ros.estimation.joint_motion import SmoothedMotion, settling, smooth
from denoc_ros.types import Array, Flags, Stamps

MOTION = ('q', 'qd', 'qdd')
ROWS = 4096  # read at once, more where the smoothing looks further
FINEST = 0.2  # of the sampling rate: motion faster than that is not in the samples
LONGEST_GAP = 0.5  # s, or periods below: beyond it a motion begins anew
LONGEST_GAP_PERIODS = 5
JUMP_FACTOR = 10  # times the way that the rate explains: the robot was put elsewhere
JUMP = 0.01  # rad or m, at least


@dataclass(frozen=True)
class Source:
    """Channels to be read from a bag.

    Attributes
    ----------
    path : Path
        The bag.
    topic : str
        Of the joint states.
    joints : tuple of str
        The names there, in the order of all columns.
    beside : mapping of str to str
        Further topics of JointState and the field of each that is read.
    stamp : {'header', 'log'}
        As `denoc_ros.bags.reader.read_bag`.
    """

    path: Path
    topic: str
    joints: tuple[str, ...]
    beside: Mapping[str, str]
    stamp: Stamp = 'header'


@dataclass(frozen=True)
class Block:
    """Consecutive joint states.

    Attributes
    ----------
    stamp_ns, log_ns : (k,) int array
        When they were measured and recorded [ns].
    motion : SmoothedMotion
        Smoothed, at the stamps.
    effort : (k, joints) array
        As measured [N m, N]; NaN where it was not.
    starts : (k,) bool array
        Where a motion begins that does not go on from the row before.
    beside : dict of str to Values
        The other topics, interpolated at the stamps.
    """

    stamp_ns: Stamps
    log_ns: Stamps
    motion: SmoothedMotion
    effort: Array
    starts: Flags
    beside: dict[str, Values]


@dataclass(frozen=True)
class Values:
    """Named columns (k, names); NaN where the topic has no value around a stamp."""

    names: tuple[str, ...]
    values: Array


@dataclass(frozen=True)
class _Rows:
    stamp_ns: Stamps
    log_ns: Stamps
    q: Array
    qd: Array
    effort: Array

    def __getitem__(self, rows: slice | Flags) -> _Rows:
        return _Rows(*(values[rows] for values in vars(self).values()))

    def __add__(self, other: _Rows) -> _Rows:
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return _Rows(*(np.concatenate(pair) for pair in pairs))


class JointStream:
    """Goes through the joint states of a bag, block by block; as often as wanted.

    Parameters
    ----------
    source : Source
        What is read.
    method, cutoff
        Of the smoothing, as `estimation.joint_motion.smooth`; cutoffs beyond a fifth of the
        sampling rate are lowered to that.

    Attributes
    ----------
    period : float
        Usual time between joint states [s], of the first block.
    cutoff : float
        As used [Hz].
    incomplete, repeated : int
        Messages left out so far: without a position of every joint; with a stamp not later than
        one before.

    Raises
    ------
    BagError
        When there are no two joint states to go by, or the bag cannot be read.
    """

    def __init__(self, source: Source, method: str, cutoff: float) -> None:
        self.source = source
        self.method = method
        self.cutoff = cutoff
        self.period = np.nan
        self.incomplete = self.repeated = 0

    def __iter__(self) -> Iterator[Block]:
        """Yield the blocks."""
        self.incomplete = self.repeated = 0
        self._last = -1
        rows: _Rows | None = None
        beside: dict[str, JointSeries] = {}
        done, margin = 0, 0
        for new, others in self._read():
            rows = new if rows is None else rows + new
            beside = {topic: _joined(beside.get(topic), others[topic]) for topic in others}
            if len(rows.stamp_ns) < 2:
                continue
            margin = margin or self._tune(rows)
            ready = len(rows.stamp_ns) - margin
            # a few rows at a time would cost a margin each
            if ready - done > margin:
                yield self._block(rows, done, ready, beside)
                kept = max(0, ready - margin)
                rows, done = rows[kept:], ready - kept
                beside = {t: _since(s, int(rows.stamp_ns[0])) for t, s in beside.items()}
        if rows is None or len(rows.stamp_ns) < 2:
            raise BagError(
                f'{self.source.path}: {self.source.topic} must have at least two messages with '
                f'positions of {", ".join(self.source.joints)} and rising stamps, got fewer '
                f'({self.incomplete} without all of these joints, {self.repeated} not rising; '
                'stamps may be those of the log instead)'
            )
        if done < len(rows.stamp_ns):
            yield self._block(rows, done, len(rows.stamp_ns), beside)

    def _tune(self, rows: _Rows) -> int:
        """Take period and cutoff from the first rows; return the margin of a block."""
        self.period = float(np.median(np.diff(rows.stamp_ns))) * 1e-9
        self.cutoff = min(self.cutoff, FINEST / self.period)
        # the other topics, too, are to be known around the last row of a block
        waited = math.ceil(LONGEST_GAP / self.period)
        return max(settling(self.method, self.cutoff, self.period), waited)

    def _read(self) -> Iterator[tuple[_Rows, dict[str, JointSeries]]]:
        """Yield rows in the bag's order, with the messages of the other topics since the last."""
        source = self.source
        topics = (source.topic, *source.beside)
        columns = {topic: _Column(topic) for topic in topics}
        for topic, _, log_ns, raw in read_raw(source.path, topics):
            columns[topic].append(raw, log_ns)
            if topic == source.topic and len(columns[topic].logs) == ROWS:
                yield self._taken(columns)
                columns = {topic: _Column(topic) for topic in topics}
        yield self._taken(columns)

    def _taken(self, columns: Mapping[str, _Column]) -> tuple[_Rows, dict[str, JointSeries]]:
        stamp = self.source.stamp
        others = {topic: columns[topic].series(stamp) for topic in self.source.beside}
        column = columns[self.source.topic]
        return self._clean(column.series(stamp), np.array(column.logs, np.int64)), others

    def _clean(self, series: JointSeries, logs: Stamps) -> _Rows:
        """Return the rows that have every joint and stamps that rise."""
        fields = (series.position, series.velocity, series.effort)
        columns = [_columns(series.names, values, self.source.joints) for values in fields]
        rows = _Rows(series.stamp_ns, logs, *columns)
        whole: Flags = np.asarray(np.isfinite(rows.q).all(axis=1))
        self.incomplete += int(np.count_nonzero(~whole))
        rows = rows[whole]
        latest = np.maximum.accumulate(np.concatenate([[self._last], rows.stamp_ns]))
        rising: Flags = rows.stamp_ns > latest[:-1]
        self.repeated += int(np.count_nonzero(~rising))
        self._last = int(latest[-1])
        return rows[rising]

    def _block(
        self, rows: _Rows, first: int, last: int, beside: Mapping[str, JointSeries]
    ) -> Block:
        t = (rows.stamp_ns - rows.stamp_ns[0]) * 1e-9
        starts = _starts(t, rows.q, rows.qd, self.period)
        edges = [*np.flatnonzero(starts), len(t)]
        parts = [
            self._smoothed(t[a:b], rows[a:b])
            for a, b in itertools.pairwise(edges)
            if b > first and a < last
        ]
        offset = max(edge for edge in edges if edge <= first)
        core = slice(first - offset, last - offset)
        motion = SmoothedMotion(
            *(np.concatenate([getattr(part, name) for part in parts])[core] for name in MOTION)
        )
        rows = rows[first:last]
        return Block(
            rows.stamp_ns,
            rows.log_ns,
            motion,
            rows.effort,
            starts[first:last],
            {
                topic: _at(series, self.source.beside[topic], rows.stamp_ns)
                for topic, series in beside.items()
            },
        )

    def _smoothed(self, t: Array, rows: _Rows) -> SmoothedMotion:
        rates = rows.qd if _has_rates(rows.qd) else None
        return smooth(t, rows.q, rates, self.method, self.cutoff, self.period)


class _Column(JointStateColumns):
    """The messages of a topic, with their log times."""

    def __init__(self, topic: str) -> None:
        super().__init__(topic)
        self.logs: list[int] = []

    def append(self, raw: bytes, log_ns: int) -> None:
        super().append(raw, log_ns)
        self.logs.append(log_ns)

    def series(self, stamp: Stamp = 'header') -> JointSeries:
        series = super().series()
        if stamp == 'log':
            return replace(series, stamp_ns=np.array(self.logs, np.int64))
        return series


def _columns(names: Sequence[str], values: Array, wanted: Sequence[str]) -> Array:
    """Return the wanted columns, NaN where there is none."""
    places = [names.index(name) if name in names else len(names) for name in wanted]
    padded = np.column_stack([values, np.full(len(values), np.nan)])
    chosen: Array = padded[:, places]
    return chosen


def _joined(before: JointSeries | None, after: JointSeries) -> JointSeries:
    if before is None or not len(before.stamp_ns):
        return after
    names = tuple(dict.fromkeys((*before.names, *after.names)))
    stamps = np.concatenate([before.stamp_ns, after.stamp_ns])
    fields = {
        field: np.concatenate(
            [_columns(s.names, getattr(s, field), names) for s in (before, after)]
        )
        for field in FIELDS
    }
    return JointSeries(stamps, names, **fields)


def _since(series: JointSeries, stamp_ns: int) -> JointSeries:
    """Return the rows from the last one not later than a stamp."""
    first = max(0, int(np.searchsorted(series.stamp_ns, stamp_ns, side='right')) - 1)
    fields = {field: getattr(series, field)[first:] for field in FIELDS}
    return JointSeries(series.stamp_ns[first:], series.names, **fields)


def _at(series: JointSeries, field: str, stamp_ns: Stamps) -> Values:
    """Return a field interpolated at stamps; NaN outside of the series."""
    values: Array = getattr(series, field)
    origin = stamp_ns[0]
    t, known = (stamp_ns - origin) * 1e-9, (series.stamp_ns - origin) * 1e-9
    if not len(known):
        return Values((), np.zeros((len(t), 0)))
    order = np.argsort(known, kind='stable')
    columns = [
        np.interp(t, known[order], column[order], left=np.nan, right=np.nan) for column in values.T
    ]
    return Values(series.names, np.column_stack(columns))


def _has_rates(qd: Array) -> bool:
    # some drivers fill the field with zeros
    return bool(np.isfinite(qd).all() and qd.any())


def _starts(t: Array, q: Array, qd: Array, period: float) -> Flags:
    """Return where a motion begins anew: at the first row, after a gap, after a jump."""
    intervals = np.diff(t)
    steps = np.abs(np.diff(q, axis=0))
    if _has_rates(qd):
        rates = np.abs(qd)
        explained = np.maximum(rates[1:], rates[:-1]) * intervals[:, None]
    else:
        around = np.pad(steps, ((1, 1), (0, 0)))
        explained = np.maximum(around[2:], around[:-2])
    jumps = (steps > JUMP_FACTOR * explained + JUMP).any(axis=1)
    gaps = intervals > max(LONGEST_GAP, LONGEST_GAP_PERIODS * period)
    starts: Flags = np.concatenate([[True], jumps | gaps])
    return starts
