"""Settings of the state feedback, in the user's terms."""

from __future__ import annotations

from dataclasses import dataclass

from denoc_ros.settings import documented, require_declared, setting


@documented
@dataclass(frozen=True)
class FeedbackSettings:
    """Weights, delays and noise of the state feedback.

    Raises
    ------
    StateError
        If a value is out of range.
    """

    period: float = setting(float, 'period of the loop', 's', positive=True, finite=True)
    tip: str = setting(str, 'frame to keep on the plan')
    delay: float = setting(
        float,
        'delay from a measurement to the torque that responds to it, without the hold of a period',
        's',
        0.0,
        finite=True,
    )
    sensor_delay: float = setting(
        0.0, "delay of the sensors' values after the joints'", 's', 0.0, finite=True
    )
    tip_error: float = setting(
        0.009,
        'position error of the tip that is weighted like `effort_share`',
        'm',
        positive=True,
        finite=True,
    )
    tip_turn: float = setting(
        0.01, 'rotation error of the tip with the same weight', 'rad', positive=True, finite=True
    )
    joint_error: float = setting(
        0.01,
        "joint error with the same weight, in addition to the tip's",
        'rad, m',
        positive=True,
        finite=True,
    )
    effort_share: float = setting(
        0.1,
        'share of the effort limits with the same weight as these errors',
        positive=True,
        finite=True,
    )
    integral_time: float = setting(
        0.3,
        'time after which the integral of a constant error doubles the torque; 0: no integral',
        's',
        0.0,
        finite=True,
    )
    model_error: float = setting(
        0.4,
        "assumed error of the model's torques and elastic forces, as a share",
        positive=True,
        finite=True,
    )
    position_noise: float = setting(
        1e-5,
        'standard deviation of measured joint positions',
        'rad, m',
        positive=True,
        finite=True,
    )
    # infinite: rates are not measured
    velocity_noise: float = setting(
        1e-4, 'standard deviation of measured joint velocities', 'rad/s, m/s', positive=True
    )
    sensor_timeout: float = setting(
        0.05,
        "longest time without a good value of every sensor; then the plan and the joints' own "
        'feedback alone',
        's',
        positive=True,
        finite=True,
    )
    joint_bandwidth: float = setting(
        0.3,
        "bandwidth of each joint's own feedback, which goes on while sensors are silent or wrong; "
        'lowered where it is not stable; 0: none',
        'Hz',
        0.0,
        finite=True,
    )
    limit: float = setting(
        0.5,
        'largest torque, as a share of the effort limit',
        maximum=1.0,
        positive=True,
    )

    def __post_init__(self) -> None:
        require_declared(self, 'state feedback')
