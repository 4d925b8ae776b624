"""Joint states out of a bag in blocks, whatever its length, with their smoothed motion."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from denoc_ros.bags.reader import Stamp
from denoc_ros.bags.series import JointSeries, Series, joint_state_blocks
from denoc_ros.errors import BagError
from denoc_ros.estimation.joint_motion import SmoothedMotion, settling, smooth
from denoc_ros.estimation.turns import unwrap_path
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
    """Channels to be read from a bag."""

    path: Path  # the bag
    topic: str  # of the joint states
    joints: tuple[str, ...]  # the names there, in the order of all columns
    beside: Mapping[str, str]  # further topics of JointState and the field of each that is read
    stamp: Stamp = 'header'  # {'header', 'log'}; as `denoc_ros.bags.reader.read_bag`


@dataclass(frozen=True)
class Block:
    """Consecutive joint states."""

    # (k,) int when they were measured and recorded [ns]
    stamp_ns: Stamps
    log_ns: Stamps
    motion: SmoothedMotion  # smoothed, at the stamps
    effort: Array  # (k, joints) as measured [N m, N]; NaN where it was not
    starts: Flags  # (k,) bool where a motion begins that does not go on from the row before
    beside: dict[str, Series]  # the other topics, interpolated at the stamps


class JointStream:
    """Goes through the joint states of a bag, block by block; as often as wanted.

    Parameters
    ----------
    source : Source
        What is read.
    method, cutoff
        Of the smoothing, as `estimation.joint_motion.smooth`; cutoffs beyond a fifth of the
        sampling rate are lowered to that.

    continuous : sequence of bool, optional
        Whether a turn more or less of a joint is the same position; default of none. Their
        positions lose jumps by a turn.

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

    def __init__(
        self, source: Source, method: str, cutoff: float, continuous: Sequence[bool] = ()
    ) -> None:
        self.source = source
        self._continuous = np.array(continuous or [False] * len(source.joints), dtype=bool)
        self.method = method
        self.cutoff = cutoff
        self.period = np.nan
        self.incomplete = self.repeated = 0

    def __iter__(self) -> Iterator[Block]:
        """Yield the blocks."""
        self.incomplete = self.repeated = 0
        self._last = -1
        self._latest: JointSeries | None = None
        rows: JointSeries | None = None
        beside: dict[str, JointSeries] = {}
        done, margin = 0, 0
        source = self.source
        topics = (source.topic, *source.beside)
        for new in joint_state_blocks(source.path, topics, ROWS, source.stamp):
            after = self._clean(new.pop(source.topic))
            rows = after if rows is None else rows.followed_by(after)
            beside = {t: beside[t].followed_by(s) if t in beside else s for t, s in new.items()}
            if len(rows.t) < 2:
                continue
            margin = margin or self._tune(rows)
            ready = len(rows.t) - margin
            # a few rows at a time would cost a margin each
            if ready - done > margin:
                yield self._block(rows, done, ready, beside)
                kept = max(0, ready - margin)
                rows, done = rows[kept:], ready - kept
                beside = {t: _since(s, int(rows.stamp_ns[0])) for t, s in beside.items()}
        if rows is None or len(rows.t) < 2:
            raise BagError(
                f'{self.source.path}: {self.source.topic} must have at least two messages with '
                f'positions of {", ".join(self.source.joints)} and rising stamps, got fewer '
                f'({self.incomplete} without all of these joints, {self.repeated} not rising; '
                'stamps may be those of the log instead)'
            )
        if done < len(rows.t):
            yield self._block(rows, done, len(rows.t), beside)

    def _tune(self, rows: JointSeries) -> int:
        """Take period and cutoff from the first rows; return the margin of a block."""
        self.period = float(np.median(np.diff(rows.stamp_ns))) * 1e-9
        self.cutoff = min(self.cutoff, FINEST / self.period)
        # the other topics, too, are to be known around the last row of a block
        waited = math.ceil(LONGEST_GAP / self.period)
        return max(settling(self.method, self.cutoff, self.period), waited)

    def _clean(self, series: JointSeries) -> JointSeries:
        """Return the rows that have every joint and stamps that rise."""
        whole = series.select(self.source.joints).complete()
        rising = whole.rising(self._last)
        self.incomplete += len(series.t) - len(whole.t)
        self.repeated += len(whole.t) - len(rising.t)
        if len(rising.t):
            self._last = int(rising.stamp_ns[-1])
        return self._unwrapped(rising) if self._continuous.any() else rising

    def _unwrapped(self, rows: JointSeries) -> JointSeries:
        """Return the rows without jumps by a turn, among them and after the rows before."""
        whole = rows if self._latest is None else self._latest.followed_by(rows)
        if not len(whole.t):
            return rows
        times = whole.since(int(whole.stamp_ns[0])).t
        whole = replace(whole, position=unwrap_path(times, whole.position, self._continuous))
        self._latest = whole[-2:]
        return whole[len(whole.t) - len(rows.t) :]

    def _block(
        self, rows: JointSeries, first: int, last: int, beside: Mapping[str, JointSeries]
    ) -> Block:
        rows = rows.since(int(rows.stamp_ns[0]))
        starts = motion_starts(rows.t, rows.position, rows.velocity, self.period)
        edges = [*np.flatnonzero(starts), len(rows.t)]
        parts = [
            self._smoothed(rows[a:b])
            for a, b in itertools.pairwise(edges)
            if b > first and a < last
        ]
        offset = max(edge for edge in edges if edge <= first)
        core = slice(first - offset, last - offset)
        motion = SmoothedMotion(
            *(np.concatenate([getattr(part, name) for part in parts])[core] for name in MOTION)
        )
        rows = rows[first:last]
        origin_ns = int(rows.stamp_ns[0])
        t = rows.since(origin_ns).t
        others = {}
        for topic, series in beside.items():
            found = series.since(origin_ns).field(self.source.beside[topic])
            others[topic] = Series(t, found.names, found.at(t))
        return Block(rows.stamp_ns, rows.log_ns, motion, rows.effort, starts[first:last], others)

    def _smoothed(self, rows: JointSeries) -> SmoothedMotion:
        rates = rows.velocity if _has_rates(rows.velocity) else None
        return smooth(rows.t, rows.position, rates, self.method, self.cutoff, self.period)


def _since(series: JointSeries, stamp_ns: int) -> JointSeries:
    """Return the rows from the last one not later than a stamp."""
    return series[max(0, int(np.searchsorted(series.stamp_ns, stamp_ns, side='right')) - 1) :]


def _has_rates(qd: Array) -> bool:
    # some drivers fill the field with zeros
    return bool(np.isfinite(qd).all() and qd.any())


def motion_starts(t: Array, q: Array, qd: Array, period: float) -> Flags:
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
