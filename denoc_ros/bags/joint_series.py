"""Joint states over time, as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from denoc_ros.types import Array, Stamps


@dataclass(frozen=True)
class JointSeries:
    """Joint states over time.

    Attributes
    ----------
    stamp_ns : (k,) int array
        Times [ns].
    names : tuple of str
        The m joints.
    position, velocity, effort : (k, m) array
        rad or m, per s, N m or N; NaN where a message did not have it.
    """

    stamp_ns: Stamps
    names: tuple[str, ...]
    position: Array
    velocity: Array
    effort: Array

    @property
    def t(self) -> Array:
        """Times since the first message [s], (k,)."""
        return elapsed(self.stamp_ns)


def elapsed(stamp_ns: Stamps) -> Array:
    """Return seconds since the first of some times in ns, (k,)."""
    since: Stamps = stamp_ns - stamp_ns[:1]
    return np.asarray(since * 1e-9, dtype=np.float64)
