"""Joint states out of a bag in blocks, whatever its length, with their smoothed motion."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from denoc_ros.bags.reader import Stamp
from denoc_ros.bags.run import RecordedPhase
from denoc_ros.bags.series import JointSeries, Series, elapsed, joint_state_blocks
from denoc_ros.errors import BagError
from denoc_ros.estimation.joint_motion import SmoothedMotion, settling, smooth
from denoc_ros.estimation.turns import unwrap_path
from denoc_ros.simulation.recorded.plausibility import (
    LONGEST_GAP_S,
    Jump,
    found_jumps,
    gaps_between,
    jumps_between,
)
from denoc_ros.types import Array, Flags, Stamps

MOTION = ('q', 'qd', 'qdd')
ROWS = 4096  # read at once, more where the smoothing looks further
FINEST = 0.2  # of the sampling rate: motion faster than that is not in the samples
SET_BACK_NS = 500_000_000  # A stamp that is earlier by more was made by a clock that was set back.


@dataclass(frozen=True)
class Source:
    """Channels to be read from a bag."""

    path: Path  # the bag
    topic: str  # of the joint states
    joints: tuple[str, ...]  # the names there, in the order of all columns
    beside: Mapping[str, str]  # further topics of JointState and the field of each that is read
    stamp: Stamp = 'header'  # {'header', 'log'}; as `denoc_ros.bags.reader.read_bag`
    phases: tuple[RecordedPhase, ...] = (
        RecordedPhase(''),
    )  # What lies outside of all phases is not read.
    turning: tuple[bool, ...] = ()  # Which joints' positions are angles; () for all.


@dataclass(frozen=True)
class Block:
    """Consecutive joint states of one phase."""

    # (k,) int when they were measured and recorded [ns]
    stamp_ns: Stamps
    log_ns: Stamps
    t: Array  # (k,) s since the first joint state of all, by a clock that is never set back
    motion: SmoothedMotion  # smoothed, at the stamps
    effort: Array  # (k, joints) as measured [N m, N]; NaN where it was not
    starts: Flags  # (k,) bool where a motion begins that does not go on from the row before
    beside: dict[str, Series]  # the other topics, interpolated at the stamps
    phase: int  # number of the source's phase


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
    incomplete, repeated : list of int
        By phase, messages left out so far: without a position of every joint; with a stamp not
        later than one before.
    jumps : list of list of Jump
        By phase, those found so far.
    set_back : int
        How often the clock of the stamps has been set back so far.

    Raises
    ------
    BagError
        When there are no two joint states to go by, or the bag cannot be read.
    """

    def __init__(
        self, source: Source, method: str, cutoff: float, continuous: Sequence[bool] = ()
    ) -> None:
        self.source = source
        count = len(source.joints)
        self._continuous = np.array(continuous or [False] * count, dtype=bool)
        self._angular = np.array(source.turning or [True] * count, dtype=bool)
        self.method = method
        self.cutoff = cutoff
        self.period = np.nan
        self._reset()

    def _reset(self) -> None:
        count = len(self.source.phases)
        self.incomplete, self.repeated = [0] * count, [0] * count
        self.jumps: list[list[Jump]] = [[] for _ in range(count)]
        self._last, self._last_log = -1, -1
        self._latest: JointSeries | None = None
        # log times from which on the clock's stamps count as later [ns], and by how much
        self._clock: list[tuple[int, int]] = [(-1, 0)]
        self._origin_ns = -1

    @property
    def set_back(self) -> int:
        """How often the clock of the stamps has been set back so far."""
        return len(self._clock) - 1

    def __iter__(self) -> Iterator[Block]:
        """Yield the blocks."""
        self._reset()
        rows: JointSeries | None = None
        beside: dict[str, JointSeries] = {}
        done, margin = 0, 0
        source = self.source
        topics = (source.topic, *source.beside)
        for new in joint_state_blocks(source.path, topics, ROWS, source.stamp):
            after = self._clean(new.pop(source.topic))
            new = {t: self._on_clock(s) for t, s in new.items()}
            rows = after if rows is None else rows.followed_by(after)
            beside = {t: beside[t].followed_by(s) if t in beside else s for t, s in new.items()}
            if len(rows.t) < 2:
                continue
            margin = margin or self._tune(rows)
            ready = len(rows.t) - margin
            # a few rows at a time would cost a margin each
            if ready - done > margin:
                yield from self._blocks(rows, done, ready, beside)
                kept = max(0, ready - margin)
                rows, done = rows[kept:], ready - kept
                beside = {t: _since(s, int(rows.stamp_ns[0])) for t, s in beside.items()}
        if rows is None or len(rows.t) < 2:
            raise BagError(
                f'{self.source.path}: {self.source.topic} must have at least two messages with '
                f'positions of {", ".join(self.source.joints)} and rising stamps, got fewer '
                f'({sum(self.incomplete)} without all of these joints, {sum(self.repeated)} not '
                'rising; stamps may be those of the log instead)'
            )
        if done < len(rows.t):
            yield from self._blocks(rows, done, len(rows.t), beside)

    def _tune(self, rows: JointSeries) -> int:
        """Take period and cutoff from the first rows; return the margin of a block."""
        self.period = float(np.median(np.diff(rows.stamp_ns))) * 1e-9
        self.cutoff = min(self.cutoff, FINEST / self.period)
        # the other topics, too, are to be known around the last row of a block
        waited = math.ceil(LONGEST_GAP_S / self.period)
        return max(settling(self.method, self.cutoff, self.period), waited)

    def _clean(self, series: JointSeries) -> JointSeries:
        """Return the rows of the phases that have every joint and stamps that rise."""
        series = series.select(self.source.joints)
        phase = phase_numbers(self.source.phases, series.stamp_ns)
        inside = np.flatnonzero(phase >= 0)
        series, phase = series[inside], phase[inside]
        is_whole = np.asarray(np.isfinite(series.position).all(axis=1), dtype=bool)
        self._count(self.incomplete, phase[~is_whole])
        whole, phase = self._on_clock(self._steadied(series[is_whole])), phase[is_whole]
        rises = whole.rises(self._last)
        self._count(self.repeated, phase[~rises])
        rising = whole[rises]
        if len(rising.t):
            self._last, self._last_log = int(rising.stamp_ns[-1]), int(rising.log_ns[-1])
        return self._unwrapped(rising) if self._continuous.any() else rising

    def _count(self, counts: list[int], phases: Stamps) -> None:
        for phase in phases.tolist():
            counts[phase] += 1

    def _steadied(self, rows: JointSeries) -> JointSeries:
        """Note where the clock of the stamps was set back: two rows or more are earlier."""
        while True:
            stamps = self._on_clock(rows).stamp_ns
            latest = np.maximum.accumulate(np.concatenate([[self._last], stamps]))[:-1]
            behind = stamps < latest - SET_BACK_NS
            places = np.flatnonzero(behind[:-1] & behind[1:])
            if not len(places):
                return rows
            k = int(places[0])
            log_ns = int(rows.log_ns[k])
            passed = log_ns - (int(rows.log_ns[k - 1]) if k else self._last_log)
            ahead = int(latest[k]) + max(passed, 1) - int(rows.stamp_ns[k])
            self._clock.append((log_ns, ahead))

    def _on_clock(self, series: JointSeries) -> JointSeries:
        """Return the rows with stamps by a clock that is never set back."""
        if len(self._clock) == 1:
            return series
        return replace(series, stamp_ns=series.stamp_ns + self._ahead(series.log_ns))

    def _ahead(self, log_ns: Stamps) -> Stamps:
        """Return by how much that clock is ahead of the recorded one (k,) [ns]."""
        since, ahead = np.array(self._clock, dtype=np.int64).T
        return np.asarray(ahead[np.searchsorted(since, log_ns, side='right') - 1])

    def _unwrapped(self, rows: JointSeries) -> JointSeries:
        """Return the rows without jumps by a turn, among them and after the rows before."""
        whole = rows if self._latest is None else self._latest.followed_by(rows)
        if not len(whole.t):
            return rows
        times = whole.since(int(whole.stamp_ns[0])).t
        whole = replace(whole, position=unwrap_path(times, whole.position, self._continuous))
        self._latest = whole[-2:]
        return whole[len(whole.t) - len(rows.t) :]

    def _blocks(
        self, rows: JointSeries, first: int, last: int, beside: Mapping[str, JointSeries]
    ) -> Iterator[Block]:
        """Yield the rows from the first to before the last one, a block for each phase."""
        rows = rows.since(int(rows.stamp_ns[0]))
        phase = phase_numbers(self.source.phases, rows.stamp_ns - self._ahead(rows.log_ns))
        starts = self._starts(rows, phase, first, last)
        edges = [*np.flatnonzero(starts), len(rows.t)]
        parts = [
            self._smoothed(rows[a:b])
            for a, b in itertools.pairwise(edges)
            if b > first and a < last
        ]
        offset = max(edge for edge in edges if edge <= first)
        q, qd, qdd = (np.concatenate([getattr(part, name) for part in parts]) for name in MOTION)
        changes = np.flatnonzero(np.diff(phase[first:last])) + first + 1
        for a, b in itertools.pairwise([first, *changes.tolist(), last]):
            core = slice(a - offset, b - offset)
            motion = SmoothedMotion(q[core], qd[core], qdd[core])
            yield self._block(rows[a:b], motion, starts[a:b], beside, int(phase[a]))

    def _block(
        self,
        rows: JointSeries,
        motion: SmoothedMotion,
        starts: Flags,
        beside: Mapping[str, JointSeries],
        phase: int,
    ) -> Block:
        origin_ns = int(rows.stamp_ns[0])
        t = rows.since(origin_ns).t
        others = {}
        for topic, series in beside.items():
            found = series.since(origin_ns).field(self.source.beside[topic])
            others[topic] = Series(t, found.names, found.at(t))
        if self._origin_ns < 0:
            self._origin_ns = origin_ns
        since = elapsed(rows.stamp_ns, self._origin_ns)
        stamp_ns = rows.stamp_ns - self._ahead(rows.log_ns)
        return Block(stamp_ns, rows.log_ns, since, motion, rows.effort, starts, others, phase)

    def _starts(self, rows: JointSeries, phase: Stamps, first: int, last: int) -> Flags:
        """Return where a motion begins anew; note the jumps from the first to the last row."""
        rates = rows.velocity if _has_rates(rows.velocity) else None
        jumps = jumps_between(rows.t, rows.position, rates)
        begins = gaps_between(rows.t, self.period) | (np.diff(phase) != 0)
        begins |= np.diff(self._ahead(rows.log_ns)) != 0
        jumps &= ~begins[:, None]
        since = elapsed(rows.stamp_ns, self._origin_ns if self._origin_ns >= 0 else None)
        inside = np.arange(1, len(rows.t))
        found = found_jumps(
            self.source.joints, since, rows.position, jumps, self._angular,
            np.flatnonzero((inside >= first) & (inside < last)),
        )  # fmt: skip
        for row, jump in found:
            self.jumps[phase[row]].append(jump)
        starts: Flags = np.concatenate([[True], begins | jumps.any(axis=1)])
        return starts

    def _smoothed(self, rows: JointSeries) -> SmoothedMotion:
        rates = rows.velocity if _has_rates(rows.velocity) else None
        return smooth(rows.t, rows.position, rates, self.method, self.cutoff, self.period)


def phase_numbers(phases: Sequence[RecordedPhase], stamp_ns: Stamps) -> Stamps:
    """Return the number of the phase of each stamp (k,), -1 outside of all."""
    numbers = np.full(len(stamp_ns), -1, dtype=np.int64)
    for number, phase in enumerate(phases):
        numbers[(stamp_ns >= phase.begin_ns) & (stamp_ns < phase.end_ns)] = number
    return numbers


def _since(series: JointSeries, stamp_ns: int) -> JointSeries:
    """Return the rows from the last one not later than a stamp."""
    return series[max(0, int(np.searchsorted(series.stamp_ns, stamp_ns, side='right')) - 1) :]


def _has_rates(qd: Array) -> bool:
    # some drivers fill the field with zeros
    return bool(np.isfinite(qd).all() and qd.any())
