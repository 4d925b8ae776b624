"""A failing sequence becomes a short one that still fails."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TypeVar

T = TypeVar('T')
Fails = Callable[[list[T]], bool]


def shrink(steps: Sequence[T], fails: Fails[T], seconds: float) -> list[T] | None:
    """Return a short part of a sequence that fails as the whole did.

    First the shortest tail of 1, 2, 4, ... steps, then delta debugging of that tail.

    Parameters
    ----------
    steps : sequence
    fails : callable
        Whether a sequence fails, tried anew; it may take long and be left to chance.
    seconds : float
        After which no further try begins.

    Returns
    -------
    list or None
        None where no try failed in the time.
    """
    end = time.monotonic() + seconds
    found = failing_tail(steps, fails, end)
    return None if found is None else delta_debug(found, fails, end)


def failing_tail(steps: Sequence[T], fails: Fails[T], end: float) -> list[T] | None:
    """Return the last 1, 2, 4, ... steps that fail; None if time (monotonic, s) is over before."""
    count = 1
    while time.monotonic() < end:
        tail = list(steps[-count:])
        if fails(tail):
            return tail
        if count >= len(steps):
            return None
        count *= 2
    return None


def delta_debug(steps: list[T], fails: Fails[T], end: float) -> list[T]:
    """Leave out ever smaller chunks as long as what is left fails (ddmin, Zeller 2002)."""
    chunks = 2
    while len(steps) > 1 and time.monotonic() < end:
        size = -(-len(steps) // chunks)
        for begin in range(0, len(steps), size):
            rest = steps[:begin] + steps[begin + size :]
            if time.monotonic() >= end:
                return steps
            if rest and fails(rest):
                steps, chunks = rest, max(chunks - 1, 2)
                break
        else:
            if size == 1:
                return steps
            chunks = min(2 * chunks, len(steps))
    return steps
