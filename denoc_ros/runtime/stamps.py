"""Stamps of moments of the steady clock."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

TRIES = 4
NEAR = 2e-5  # s between two readings that count as the same moment
SET_BACK = 1_000_000_000  # ns by which a clock that goes back has been set back


def at_once(now_ns: Callable[[], int]) -> tuple[float, int]:
    """Return a moment of `time.perf_counter` [s] and what another clock shows then [ns].

    The two clocks are read close together: a thread that loses the processor between the readings
    would see one clock jump by the time it was away.
    """
    best, moment, shown = math.inf, 0.0, 0
    for _ in range(TRIES):
        before = time.perf_counter()
        reading = now_ns()
        after = time.perf_counter()
        if after - before < best:
            best, moment, shown = after - before, 0.5 * (before + after), reading
        if best < NEAR:
            break
    return moment, shown


class StampOf:
    """Gives the stamp [ns] of a moment of the steady clock [s]; none earlier than before.

    Parameters
    ----------
    now_ns : callable
        The clock that stamps.
    """

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self._now_ns = now_ns
        self._last = 0

    def __call__(self, moment: float) -> int:
        """Return the stamp of a moment [s] of `time.perf_counter`."""
        now, now_ns = at_once(self._now_ns)
        stamp = now_ns - round(1e9 * (now - moment))
        if not 0 < self._last - stamp < SET_BACK:
            self._last = stamp
        return self._last
