"""Regularity of the nodes' loops, and the nodes' warnings, from /diagnostics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from denoc_ros.bags.run import Diagnostic
from denoc_ros.types import Array

SECOND = 1_000_000_000  # ns
COUNTED = ('ticks', 'overruns_total', 'skipped_total', 'histogram_counts')


@dataclass(frozen=True)
class LoopMeasure:
    """How evenly a node's loop ran, by its own word on /diagnostics, over all its starts."""

    node: str  # its name
    # periods [s]; median and p99 of the last second, longest of the whole run
    nominal: float
    median: float
    p99: float
    longest: float
    edges: Array  # (b,) of the histogram, in nominal periods; the last bin is open
    counts: Array  # (b,) ticks
    # all ticks; those late by more than half a period; deadlines passed over
    ticks: int
    late: int
    skipped: int

    def summary(self) -> dict[str, float]:
        """Return the numbers, ready for JSON."""
        names = ('nominal', 'median', 'p99', 'longest', 'ticks', 'late', 'skipped')
        return {name: getattr(self, name) for name in names}


def loop_measures(statuses: Sequence[Diagnostic], since_ns: int = 0) -> tuple[LoopMeasure, ...]:
    """Return the loops among diagnostic statuses, by node.

    Parameters
    ----------
    since_ns : int
        What was counted before it is left out [ns].
    """
    before: dict[str, dict[str, str]] = {}
    after: dict[str, list[dict[str, str]]] = {}
    for status in statuses:
        node, _, what = status.name.rpartition(': ')
        if what != 'loop' or 'histogram_counts' not in status.values:
            continue
        if status.stamp_ns < since_ns:
            before[node] = status.values
        else:
            after.setdefault(node, []).append(status.values)
    return tuple(_loop(node, values, before.get(node)) for node, values in sorted(after.items()))


class NodeWarnings(NamedTuple):
    """Messages of one status of a node that were not plain ok."""

    times: int
    last: str  # its text
    phases: tuple[str, ...]  # in which they came


def warnings(
    statuses: Sequence[Diagnostic], phases: Sequence[tuple[str, tuple[int, int]]]
) -> dict[str, NodeWarnings]:
    """Collect the messages that were not plain ok, by status.

    Parameters
    ----------
    phases : sequence of (str, (int, int))
        Name, begin and end [ns] of what counts: between them nodes may be restarted. A status
        speaks of the second before its stamp, which must be in a phase whole.
    """
    found: dict[str, NodeWarnings] = {}
    for status in statuses:
        stamp = status.stamp_ns
        during = next((n for n, (begin, end) in phases if begin + SECOND <= stamp < end), None)
        if status.level > 0 and during is not None:
            times, _, before = found.get(status.name, NodeWarnings(0, '', ()))
            within = before if during in before else (*before, during)
            found[status.name] = NodeWarnings(times + 1, status.message, within)
    return found


def _loop(node: str, statuses: list[dict[str, str]], before: dict[str, str] | None) -> LoopMeasure:
    last = statuses[-1]
    ticks = [int(values['ticks']) for values in statuses]
    ends = [k for k in range(len(ticks)) if k + 1 == len(ticks) or ticks[k + 1] < ticks[k]]
    counts = {key: np.sum([_numbers(statuses[k][key]) for k in ends], axis=0) for key in COUNTED}
    # a node that was started anew counts from zero
    if before is not None and int(before['ticks']) <= ticks[0]:
        counts = {key: value - _numbers(before[key]) for key, value in counts.items()}
    return LoopMeasure(
        node=node,
        nominal=1.0 / float(last['nominal_rate_hz']),
        median=1e-6 * float(last['period_p50_us']),
        p99=1e-6 * float(last['period_p99_us']),
        longest=1e-6 * max(float(values['period_max_us']) for values in statuses),
        edges=_numbers(last['histogram_edges']),
        counts=counts['histogram_counts'],
        ticks=int(counts['ticks'][0]),
        late=int(counts['overruns_total'][0]),
        skipped=int(counts['skipped_total'][0]),
    )


def _numbers(text: str) -> Array:
    return np.array(text.split(), dtype=np.float64)
