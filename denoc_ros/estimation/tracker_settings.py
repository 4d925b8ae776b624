"""Settings of the tracking of parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass

from denoc_ros.errors import StateError


@dataclass(frozen=True)
class TrackerSettings:
    """How parameters are tracked.

    Attributes
    ----------
    step : float
        Time over which joint states are drawn together [s]; longer where they come less often.
    block : float
        Time over which measured and predicted values are compared as means [s].
    memory : float
        Motion that is this old [s] counts a factor e less than the newest.
    rate : float
        The most that a value changes in a second, as a share of the width of its bounds.
    model_error : float
        How far the rest of the model may be off, as a share of its torques and elastic forces.
    cutoff : float
        Bandwidth of the filter that gives rates where joint states have none [Hz].
    lag : float
        How late sensors' values may come [s]: the tracking is so far behind.

    Raises
    ------
    StateError
        If a value is out of range.
    """

    step: float = 0.005
    block: float = 0.05
    memory: float = 0.5
    rate: float = 1.0
    model_error: float = 0.01
    cutoff: float = 10.0
    lag: float = 0.05

    def __post_init__(self) -> None:
        for name in ('step', 'block', 'memory', 'rate', 'model_error', 'cutoff'):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise StateError(f'tracker: {name} must be > 0, got {value}')
        if not (math.isfinite(self.lag) and self.lag >= 0.0):
            raise StateError(f'tracker: lag must be >= 0 s, got {self.lag}')
