"""Settings of the state feedback, in the user's terms."""

from __future__ import annotations

import math
from dataclasses import dataclass

from denoc_ros.errors import StateError

POSITIVE = (
    'period', 'tip_error', 'tip_turn', 'joint_error', 'effort_share', 'model_error',
    'position_noise', 'velocity_noise', 'sensor_timeout',
)  # fmt: skip

NOT_NEGATIVE = {'delay': 's', 'sensor_delay': 's', 'integral_time': 's', 'joint_bandwidth': 'Hz'}


@dataclass(frozen=True)
class FeedbackSettings:
    """Weights, delays and noise of the state feedback.

    Attributes
    ----------
    period : float
        Of the loop [s].
    tip : str
        Frame that is to be where the plan has it.
    delay : float
        From a measurement to the torque that answers it [s], without the hold of one period.
    sensor_delay : float
        How much later than the joints' the sensors' values come [s].
    tip_error, tip_turn, joint_error : float
        Errors [m, rad, rad or m] that are each worth as much as `effort_share`.
    effort_share : float
        Share of the effort limits.
    integral_time : float
        s in which an error that stays asks for as much again; 0: no integral action.
    model_error : float
        How far the plan's torques and elastic forces may be off, as a share of them.
    position_noise, velocity_noise : float
        Standard deviations of the measured joints [rad or m, and per s]; rates are
        not measured where `velocity_noise` is infinite.
    sensor_timeout : float
        s without a good value of each sensor after which the estimate is not believed.
    joint_bandwidth : float
        Of the feedback of each joint's own deviation, which is in while the joints are measured
        and with which the other is designed [Hz]; 0: none.
    limit : float
        Largest torque of the feedback, as a share of the effort limits.

    Raises
    ------
    StateError
        If a value is out of range.
    """

    period: float
    tip: str
    delay: float
    sensor_delay: float = 0.0
    tip_error: float = 0.009
    tip_turn: float = 0.01
    joint_error: float = 0.01
    effort_share: float = 0.1
    integral_time: float = 0.3
    model_error: float = 0.4
    position_noise: float = 1e-5
    velocity_noise: float = 1e-4
    sensor_timeout: float = 0.05
    joint_bandwidth: float = 0.3
    limit: float = 0.5

    def __post_init__(self) -> None:
        for name in POSITIVE:
            value = getattr(self, name)
            if not value > 0.0 or (math.isinf(value) and name != 'velocity_noise'):
                raise StateError(f'state feedback: {name} must be > 0, got {value}')
        for name, unit in NOT_NEGATIVE.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise StateError(f'state feedback: {name} must be >= 0 {unit}, got {value}')
        if not 0.0 < self.limit <= 1.0:
            raise StateError(f'state feedback: limit must be in (0, 1], got {self.limit}')
