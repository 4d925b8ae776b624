"""Comparison of the results of several runs: mean, spread, repeatability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from denoc_ros.errors import IdentificationError

SAME_MODE = 0.1  # largest step between the log frequencies of one mode in two runs
REPEATABILITY = 1.96 * np.sqrt(2.0)  # of the deviation: what two runs differ by at most in 95 %
NORMAL_95 = 3.92  # standard deviations in a 95 % interval


@dataclass(frozen=True)
class ComparedMode:
    """One mode over several runs.

    Attributes
    ----------
    runs : tuple of int
        Places of the results that have it.
    frequency_hz, damping_ratio : float
        Means.
    frequency_deviation_hz, damping_deviation : float
        Standard deviations between runs; nan of a single one.
    repeatability : float
        What the damping ratios of two runs differ by at most in 95 % of cases.
    expected_deviation : float
        What the runs' own 95 % intervals of the damping ratio let expect (root mean square).
    verdicts : tuple of str
        The runs'.
    """

    runs: tuple[int, ...]
    frequency_hz: float
    damping_ratio: float
    frequency_deviation_hz: float
    damping_deviation: float
    repeatability: float
    expected_deviation: float
    verdicts: tuple[str, ...]

    @property
    def consistent(self) -> bool:
        """Whether the runs differ by at most three times their intervals."""
        return not self.damping_deviation > 3.0 * self.expected_deviation


def compare_results(results: Sequence[Mapping[str, Any]]) -> list[ComparedMode]:
    """Return the modes of several results of `denoc identify modal`, by rising frequency.

    Raises
    ------
    IdentificationError
        For fewer than two results, or one of another kind.
    """
    if len(results) < 2:
        raise IdentificationError(f'compare: results must be at least 2, got {len(results)}')
    for k, one in enumerate(results):
        if one.get('kind') != 'modal':
            raise IdentificationError(
                f'compare: results must be of modes, got {one.get("kind")!r} in result {k + 1}'
            )
    found = [(k, mode) for k, one in enumerate(results) for mode in one['modes']]
    found.sort(key=lambda entry: float(entry[1]['frequency_hz']))
    groups: list[list[tuple[int, Mapping[str, Any]]]] = []
    for run, mode in found:
        last = groups[-1] if groups else []
        if last and _is_same(last, run, mode):
            last.append((run, mode))
        else:
            groups.append([(run, mode)])
    return [_compared(group) for group in groups]


def _is_same(
    group: Sequence[tuple[int, Mapping[str, Any]]], run: int, mode: Mapping[str, Any]
) -> bool:
    """Say whether a mode belongs to a group, which has each run once."""
    step = np.log(mode['frequency_hz'] / group[-1][1]['frequency_hz'])
    return bool(step < SAME_MODE and run not in {other for other, _ in group})


def _compared(group: Sequence[tuple[int, Mapping[str, Any]]]) -> ComparedMode:
    group = sorted(group, key=lambda entry: entry[0])
    frequency = np.array([mode['frequency_hz'] for _, mode in group])
    ratio = np.array([mode['damping_ratio'] for _, mode in group])
    width = np.array([mode['interval'][1] - mode['interval'][0] for _, mode in group])
    several = len(group) > 1
    deviation = float(np.std(ratio, ddof=1)) if several else float('nan')
    return ComparedMode(
        runs=tuple(run for run, _ in group),
        frequency_hz=float(frequency.mean()),
        damping_ratio=float(ratio.mean()),
        frequency_deviation_hz=float(np.std(frequency, ddof=1)) if several else float('nan'),
        damping_deviation=deviation,
        repeatability=float(REPEATABILITY * deviation),
        expected_deviation=float(np.sqrt(np.mean((width / NORMAL_95) ** 2))),
        verdicts=tuple(str(mode['verdict']) for _, mode in group),
    )
