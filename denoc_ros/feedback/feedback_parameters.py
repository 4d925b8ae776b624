"""Parameters that the part feedback adds to the feedforward node."""

from __future__ import annotations

import math

from denoc_ros.feedback.feedback_settings import FeedbackSettings
from denoc_ros.runtime.parameters.parameter_table import SettingsParameters
from denoc_ros.settings import Kind, declared, parameter

FEEDBACK = SettingsParameters(
    FeedbackSettings,
    {
        name: f'feedback.{"state_limit" if name == "limit" else name}'
        for name in declared(FeedbackSettings)
        if name not in ('period', 'tip', 'delay')
    },
    {'sensor_delay': (0.0, 0.05)},
    'state feedback: ',
)

ROWS = [
    parameter(
        'feedback.strain_gain',
        Kind.DOUBLES,
        'damping torque per strain rate, for each driven joint from a gauge on the link '
        'behind it; empty: off. Refused unless it dissipates power in every mode of the '
        'model',
        'N m s, N s',
        0.0,
    ),
    parameter(
        'feedback.strain_limit',
        0.2,
        'largest damping torque, as a share of the effort limit',
        '',
        0.0,
        1.0,
    ),
    parameter(
        'feedback.cutoff',
        50.0,
        'bandwidth of the filter that computes the strain rate',
        'Hz',
        positive=True,
    ),
    parameter(
        'feedback.state',
        'off',
        'lqr: torque against the deviation of all coordinates from the plan, estimated '
        'from joints and sensors; refused unless stable with stiffness and load 20 % off, and '
        'with other modes of the links',
        choices=('off', 'lqr'),
        live=True,
    ),
    parameter('feedback.tip', '', 'frame to keep on the plan; empty: the last', live=True),
    parameter(
        'feedback.delay',
        1.5,  # sampling, transport and half a hold
        'state feedback: delay from a measurement to the torque that responds to it',
        'periods',
        0.0,
        50.0,
        live=True,
    ),
    parameter(
        'feedback.rate',
        math.inf,
        'state feedback: how often its torque is found anew, at least; in each tick, or, in '
        'real time, in one of several, whose torque the others hold',
        'Hz',
        positive=True,
        live=True,
    ),
    *FEEDBACK.rows(),
]
