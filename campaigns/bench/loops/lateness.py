"""Lateness of loops in interleaved blocks: the ratio of its 99 %, with a bootstrap interval.

A shared machine is noisy in bursts longer than a block, so whole blocks are drawn anew, never
single ticks: the interval says what other blocks of the same machine might have shown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from denoc_ros.types import Array

RESAMPLES = 400
PERCENTILE = 99.0
LEVEL = 95.0  # % of the interval


@dataclass(frozen=True)
class Ratio:
    """A ratio of two 99 % latenesses and its 95 % interval."""

    value: float
    low: float
    high: float

    def met(self, limit: float) -> bool:
        """Say whether the interval does not lie above a limit."""
        return self.low < limit

    def __str__(self) -> str:
        return f'{self.value:.2f} ({self.low:.2f} to {self.high:.2f})'


def p99(blocks: Sequence[Array]) -> float:
    """Return the 99 % of all ticks of blocks [s]."""
    return float(np.percentile(np.concatenate(blocks), PERCENTILE))


def p99_ratio(with_it: Sequence[Array], without: Sequence[Array], seed: int = 1) -> Ratio:
    """Return the ratio of 99 % latenesses.

    Parameters
    ----------
    with_it, without : sequence of (ticks,) arrays
        Lateness [s] of the blocks that took turns, pair by pair.
    seed : int
        Of the resampling.

    Raises
    ------
    ValueError
        The blocks are not pairs.
    """
    if len(with_it) != len(without) or not with_it:
        raise ValueError(f'blocks must be pairs, got {len(with_it)} and {len(without)}')
    rng = np.random.default_rng(seed)
    draws = rng.integers(0, len(with_it), (RESAMPLES, len(with_it)))
    ratios = [p99([with_it[k] for k in row]) / p99([without[k] for k in row]) for row in draws]
    low, high = np.percentile(ratios, [50.0 - 0.5 * LEVEL, 50.0 + 0.5 * LEVEL])
    return Ratio(p99(with_it) / p99(without), float(low), float(high))
