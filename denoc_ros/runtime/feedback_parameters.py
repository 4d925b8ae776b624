"""The feedforward node's parameters `feedback.*`."""

from __future__ import annotations

from denoc_ros.control.feedback_settings import FeedbackSettings
from denoc_ros.runtime.parameters import Kind, Parameter

STATES = ('off', 'lqr')
DELAY = 1.5  # periods: sampling, transport and half a hold
# rows that say how a setting of the state feedback is called, and what it is
SETTINGS = (
    ('tip_error', 'position error of the tip that is weighted like `effort_share`', 'm'),
    ('tip_turn', 'rotation error of the tip with the same weight', 'rad'),
    ('joint_error', "joint error with the same weight, in addition to the tip's", 'rad, m'),
    ('effort_share', 'share of the effort limits with the same weight as these errors', ''),
    ('model_error', "assumed error of the model's torques and elastic forces, as a share", ''),
    ('position_noise', 'standard deviation of measured joint positions', 'rad, m'),
    ('velocity_noise', 'standard deviation of measured joint velocities', 'rad/s, m/s'),
    (
        'sensor_timeout',
        "longest time without a good value of every sensor; then the plan and the joints' own "
        'feedback alone',
        's',
    ),
)


def feedback_parameters() -> tuple[Parameter, ...]:
    """Return the rows of damping by strain and of state feedback."""
    return (*_strain_parameters(), *_state_parameters())


def _state_parameters() -> tuple[Parameter, ...]:
    defaults = {name: getattr(FeedbackSettings, name) for name, *_ in SETTINGS}
    return (
        Parameter(
            'feedback.state',
            Kind.STRING,
            'off',
            'lqr: torque against the deviation of all coordinates from the plan, estimated '
            'from joints and sensors; refused unless stable with stiffness and load 20 % off, and '
            'with other modes of the links',
            choices=STATES,
            live=True,
        ),
        Parameter(
            'feedback.tip', Kind.STRING, '', 'frame to keep on the plan; empty: the last',
            live=True,
        ),
        *(
            Parameter(
                f'feedback.{name}', Kind.DOUBLE, defaults[name], f'state feedback: {text}', unit,
                positive=True, live=True,
            )
            for name, text, unit in SETTINGS
        ),
        Parameter(
            'feedback.integral_time',
            Kind.DOUBLE,
            FeedbackSettings.integral_time,
            'state feedback: time after which the integral of a constant error doubles the '
            'torque; 0: no integral',
            's',
            0.0,
            live=True,
        ),
        Parameter(
            'feedback.joint_bandwidth',
            Kind.DOUBLE,
            FeedbackSettings.joint_bandwidth,
            "state feedback: bandwidth of each joint's own feedback, which goes on while sensors "
            'are silent or wrong; lowered where it is not stable; 0: none',
            'Hz',
            0.0,
            live=True,
        ),
        Parameter(
            'feedback.delay',
            Kind.DOUBLE,
            DELAY,
            'state feedback: delay from a measurement to the torque that responds to it',
            'periods',
            0.0,
            50.0,
            live=True,
        ),
        Parameter(
            'feedback.sensor_delay',
            Kind.DOUBLE,
            0.0,
            "state feedback: delay of the sensors' values after the joints'",
            's',
            0.0,
            0.05,
            live=True,
        ),
        Parameter(
            'feedback.state_limit',
            Kind.DOUBLE,
            FeedbackSettings.limit,
            'largest torque of the state feedback, as a share of the effort limit',
            '',
            maximum=1.0,
            positive=True,
            live=True,
        ),
    )  # fmt: skip


def _strain_parameters() -> tuple[Parameter, ...]:
    return (
        Parameter(
            'feedback.strain_gain',
            Kind.DOUBLES,
            [],
            'damping torque per strain rate, for each driven joint from a gauge on the link '
            'behind it; empty: off. Refused unless it dissipates power in every mode of the '
            'model',
            'N m s, N s',
            0.0,
        ),
        Parameter(
            'feedback.strain_limit',
            Kind.DOUBLE,
            0.2,
            'largest damping torque, as a share of the effort limit',
            '',
            0.0,
            1.0,
        ),
        Parameter(
            'feedback.cutoff',
            Kind.DOUBLE,
            50.0,
            'bandwidth of the filter that computes the strain rate',
            'Hz',
            positive=True,
        ),
    )
