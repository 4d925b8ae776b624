"""The low-pass that a sensor's readings have passed: the prediction passes it, too."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import cont2discrete, lfilter, lfilter_zi

from denoc_ros.errors import IdentificationError
from denoc_ros.types import Array


@dataclass(frozen=True)
class SensorFilter:
    """A low-pass of second order: y'' + 2 damping omega y' + omega^2 y = omega^2 u.

    Parameters
    ----------
    omega : float
        [rad/s]
    damping : float
        Share of critical.

    Raises
    ------
    IdentificationError
        One of them is not > 0.
    """

    omega: float
    damping: float

    def __post_init__(self) -> None:
        for name, value in (('omega', self.omega), ('damping', self.damping)):
            if not (math.isfinite(value) and value > 0.0):
                raise IdentificationError(f'filter: {name} must be > 0, got {value}')

    def passed(self, t: Array, values: Array) -> Array:
        """Filter values (k,) at stamps t (k,) [s], settled at the first one.

        Values are taken as linear between stamps; uneven stamps go through an even grid.
        """
        period = float(np.median(np.diff(t)))
        even = np.arange(t[0], t[-1] + period, period)
        w, z = self.omega, self.damping
        system = ([w * w], [1.0, 2.0 * z * w, w * w])
        above, below, _ = cont2discrete(system, period, method='foh')
        above = np.ravel(above)
        given = np.interp(even, t, values)
        found, _ = lfilter(above, below, given, zi=given[0] * lfilter_zi(above, below))
        follows: Array = np.interp(t, even, found)
        return follows
