"""Results of a benchmark run: one record per line of its table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from book.benchmarks.timing import Effort, Spread, Subject, Times, compare, ratio
from numpy.typing import ArrayLike, NDArray

from denoc_ros.output_files import plain


@dataclass(frozen=True)
class Reach:
    """Bound on a line's value."""

    value: float
    sense: Literal['<=', '>='] = '<='

    def met(self, value: float) -> bool:
        """Say whether a value is within reach."""
        return value <= self.value if self.sense == '<=' else value >= self.value


@dataclass(frozen=True)
class BenchCheck:
    """The comparison that a line's results had to pass before they were timed."""

    against: str  # whose results
    error: float  # largest difference over largest magnitude
    tolerance: float

    @property
    def good(self) -> bool:
        """Whether the results agree."""
        return bool(self.error <= self.tolerance)


@dataclass(frozen=True)
class BenchLine:
    """One line of the table."""

    # group, what, against: the part of the benchmark, what was timed, and beside what
    group: str
    what: str
    against: str
    check: BenchCheck
    unit: str = 'ratio'  # of the value: 'ratio', 'slope', 's', …
    value: Spread | None = None  # None where the results were wrong, or are only checked
    reach: Reach | None = None
    ours: Times | None = None
    peer: Times | None = None
    note: str = ''

    @property
    def verdict(self) -> str:
        """Return 'wrong', 'met', 'missed' or '' (no reach, or nothing timed)."""
        if not self.check.good:
            return 'wrong'
        if self.reach is None or self.value is None:
            return ''
        return 'met' if self.reach.met(self.value.value) else 'missed'

    def record(self) -> dict[str, Any]:
        """Return plain lists and numbers, ready for JSON; None where there is no finite value."""
        found: dict[str, Any] = {
            'group': self.group,
            'what': self.what,
            'against': self.against,
            'check': {**asdict(self.check), 'good': self.check.good},
            'unit': self.unit,
            'value': self.value and plain(asdict(self.value)),
            'reach': self.reach and {'sense': self.reach.sense, 'value': self.reach.value},
            'verdict': self.verdict,
            'note': self.note,
        }
        for name, times in (('ours', self.ours), ('peer', self.peer)):
            found[name] = times and {'median_s': times.median, 'p99_s': times.p99}
        return found


def compared(
    line: BenchLine, subjects: Sequence[Subject], effort: Effort, most: float | None = None
) -> BenchLine:
    """Return a line with the ratio of our time to the peer's, if its results are good.

    Parameters
    ----------
    most : float, optional
        Largest ratio that is good.
    """
    if not line.check.good:
        return line
    ours, peer = compare(subjects, effort)
    reach = None if most is None else Reach(most)
    return replace(line, value=ratio(ours, peer), reach=reach, ours=ours, peer=peer)


def relative_error(value: ArrayLike, expected: ArrayLike) -> float:
    """Return the largest difference over the largest magnitude expected."""
    reference: NDArray[np.float64] = np.asarray(expected, dtype=np.float64)
    difference = np.abs(np.asarray(value) - reference).max(initial=0.0)
    return float(difference / max(np.abs(reference).max(initial=0.0), 1e-300))
