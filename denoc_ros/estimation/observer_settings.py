"""Settings of the observer."""

from __future__ import annotations

from dataclasses import dataclass

from denoc_ros.estimation.fusion import FusionSettings
from denoc_ros.settings import documented, positive, require_declared, setting

SOURCES = ('joints', 'torque')


@documented
@dataclass(frozen=True)
class ObserverSettings:
    """Settings of the observer.

    Attributes
    ----------
    motor_effort : bool
        Whether efforts are those of the motors where joints are measured behind their springs.
    fusion : FusionSettings or None
        How the robot's sensors correct the amplitudes; None: they do not.

    Raises
    ------
    StateError
        If a value is out of range.
    """

    step: float = positive(float, 'time of one tick', 's')
    source: str = setting(
        'joints',
        'joints: measured joint motion drives the amplitudes; torque: forward dynamics from '
        'the effort, joints corrected by measurement',
        choices=SOURCES,
    )
    cutoff: float = positive(50.0, 'bandwidth of the filter on measured joint motion', 'Hz')
    correction_cutoff: float = positive(
        10.0,
        'bandwidth with which measured joints correct the integrated ones of `source: torque`',
        'Hz',
    )
    horizon: float = setting(
        0.0,
        'prediction horizon of `~/tip_deflection_predicted`; 0 = not published',
        's',
        0.0,
        finite=True,
    )
    # of that from the last measurement to now as well; fewer where a step would be below a tick
    horizon_steps: int = setting(10, 'largest number of integration steps over the horizon', '', 1)
    max_age: float = positive(
        0.05,
        'age after which a measurement is refused, and to which the estimate goes beyond the last',
        's',
    )
    motor_effort: bool = False
    fusion: FusionSettings | None = None

    def __post_init__(self) -> None:
        require_declared(self, 'observer')
