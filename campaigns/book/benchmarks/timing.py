"""Interleaved timing of calls: short blocks in turn, so that all see the same machine."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from denoc_ros.types import Array

Call = Callable[..., Any]


@dataclass(frozen=True)
class Effort:
    """How long to measure."""

    blocks: int  # how often the subjects take turns
    seconds: float  # length of one subject's block; at least every state is called once


FULL = Effort(25, 0.02)
QUICK = Effort(2, 0.0)


@dataclass(frozen=True)
class Subject:
    """A call and the arguments that it is given in turn."""

    call: Call
    states: Sequence[tuple[Any, ...]]


@dataclass(frozen=True)
class Times:
    """Times of one subject's calls [s]."""

    # over all calls of all blocks
    median: float
    p99: float
    blocks: Array  # (blocks,) medians of the blocks

    def scaled(self, factor: float) -> Times:
        """Return the times per part of a call."""
        return Times(self.median * factor, self.p99 * factor, self.blocks * factor)


@dataclass(frozen=True)
class Spread:
    """A figure with one value per block: the median and the quartiles of them."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Array) -> Spread:
        """Return the median and the quartiles of values (blocks,)."""
        low, value, high = np.percentile(values, [25, 50, 75])
        return cls(float(value), float(low), float(high))


def ratio(ours: Times, peer: Times) -> Spread:
    """Return the ratio of medians, block by block."""
    return Spread.of(ours.blocks / peer.blocks)


def compare(subjects: Sequence[Subject], effort: Effort) -> list[Times]:
    """Time subjects in turn, each block beginning with another one; garbage stays uncollected."""
    rounds = [_rounds(subject, effort.seconds) for subject in subjects]
    taken: list[list[Array]] = [[] for _ in subjects]
    with _uncollected():
        for block in range(effort.blocks):
            for turn in range(len(subjects)):
                k = (turn + block) % len(subjects)
                taken[k].append(_sample(subjects[k], rounds[k]))
    return [_times(blocks) for blocks in taken]


def _rounds(subject: Subject, seconds: float) -> int:
    """Return how often all states are to be called in a block; warms the caches too."""
    _sample(subject, 1)
    once = float(_sample(subject, 1).sum())
    return max(1, min(10_000, round(seconds / once)))


def _sample(subject: Subject, rounds: int) -> Array:
    """Return the time of each call [s], without the clock's own time."""
    clock, call = time.perf_counter_ns, subject.call
    taken: list[int] = []
    add = taken.append
    for _ in range(rounds):
        for arguments in subject.states:
            start = clock()
            call(*arguments)
            add(clock() - start)
    return 1e-9 * np.maximum(np.array(taken) - _clock_cost(), 1.0)


def _clock_cost() -> float:
    """Return the time [ns] that two readings of the clock show with nothing between them."""
    clock = time.perf_counter_ns
    taken = []
    for _ in range(200):
        start = clock()
        taken.append(clock() - start)
    return float(np.median(taken))


def _times(blocks: Sequence[Array]) -> Times:
    every = np.concatenate(blocks)
    medians = np.array([np.median(block) for block in blocks])
    return Times(float(np.median(every)), float(np.percentile(every, 99)), medians)


@contextmanager
def _uncollected() -> Iterator[None]:
    gc.collect()
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
