"""Settings of the observer."""

from __future__ import annotations

import math
from dataclasses import dataclass

from denoc_ros.errors import StateError
from denoc_ros.estimation.fusion import FusionSettings

SOURCES = ('joints', 'torque')


@dataclass(frozen=True)
class ObserverSettings:
    """Settings of the observer.

    Attributes
    ----------
    step : float
        Time of one tick [s].
    source : str
        `joints`: the measured joint motion drives the amplitudes. `torque`: full forward
        dynamics under the effort, joints corrected by measurement.
    cutoff : float
        Bandwidth of the filter on measured joint motion [Hz].
    correction_cutoff : float
        Bandwidth at which measured joints correct the model's [Hz] (`torque` only).
    horizon : float
        How far ahead deflections are predicted [s]; 0: not at all.
    horizon_steps : int
        Steps of that prediction at most, and of that from the last measurement to now; fewer
        where they would be shorter than a tick.
    max_age : float
        Measurements older than this [s] are refused, and the estimate goes no further than this
        beyond the last one.
    motor_effort : bool
        Whether efforts are those of the motors where joints are measured behind their springs.
    fusion : FusionSettings or None
        How the robot's sensors correct the amplitudes; None: they do not.

    Raises
    ------
    StateError
        If a value is out of range.
    """

    step: float
    source: str = 'joints'
    cutoff: float = 50.0
    correction_cutoff: float = 10.0
    horizon: float = 0.0
    horizon_steps: int = 10
    max_age: float = 0.05
    motor_effort: bool = False
    fusion: FusionSettings | None = None

    def __post_init__(self) -> None:
        if self.source not in SOURCES:
            raise StateError(
                f'observer: source must be one of {", ".join(SOURCES)}, got {self.source!r}'
            )
        for name in ('step', 'cutoff', 'correction_cutoff', 'max_age'):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise StateError(f'observer: {name} must be > 0, got {value}')
        if not (math.isfinite(self.horizon) and self.horizon >= 0.0):
            raise StateError(f'observer: horizon must be >= 0 s, got {self.horizon}')
        if self.horizon_steps < 1:
            raise StateError(f'observer: horizon_steps must be >= 1, got {self.horizon_steps}')
