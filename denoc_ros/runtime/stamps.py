"""Stamps of moments of the robot's clock, none earlier than before."""

from __future__ import annotations

from denoc_ros.runtime.clocks import Clock

SET_BACK = 1_000_000_000  # ns by which a clock that goes back has been set back


class StampOf:
    """Gives the stamp [ns] of a moment of a clock [s]; none earlier than before.

    Parameters
    ----------
    clock : Clock
    """

    def __init__(self, clock: Clock) -> None:
        self._stamp_ns = clock.stamp_ns
        self._last = 0

    def __call__(self, moment: float) -> int:
        """Return the stamp of a moment [s]."""
        stamp = self._stamp_ns(moment)
        if not 0 < self._last - stamp < SET_BACK:
            self._last = stamp
        return self._last
