"""The feedforward node's parameters."""

from __future__ import annotations

import math

from denoc_ros.dynamics.feedforward import MODELS
from denoc_ros.runtime.feedback_parameters import feedback_parameters
from denoc_ros.runtime.parameters import Kind, Parameter, ParameterTable
from denoc_ros.runtime.safety import STALE_ACTIONS
from denoc_ros.runtime.shared_parameters import (
    input_parameters,
    lifecycle_parameters,
    loop_parameters,
    range_parameters,
    robot_parameters,
)

TABLE = ParameterTable(
    [
        *lifecycle_parameters(),
        *robot_parameters(),
        *loop_parameters(),
        *input_parameters(),
        *range_parameters(),
        Parameter(
            'joints',
            Kind.STRINGS,
            [],
            'joints that are driven, in the order of the commands; empty: all but mimic joints',
        ),
        Parameter(
            'model',
            Kind.STRING,
            'flexible',
            'rigid: links as rigid; flexible: amplitudes move freely; quasi_static: they stand',
            choices=MODELS,
            live=True,
        ),
        *(
            Parameter(f'terms.{name}', Kind.BOOL, True, f'torque has {text}', live=True)
            for name, text in (
                ('inertia', 'what accelerations need'),
                ('coriolis', 'what centrifugal and Coriolis forces need'),
                ('gravity', 'what weight needs; false where the robot compensates it itself'),
                ('friction', "what the joints' damping and friction need"),
                ('elastic', 'what deflection changes'),
            )
        ),
        Parameter(
            'trigger',
            Kind.STRING,
            'clock',
            'clock: commands at `update_rate`; message: one `~/effort` per accepted reference '
            'with its stamp, for recorded runs; no commands leave',
            choices=('clock', 'message'),
        ),
        Parameter(
            'reference_source',
            Kind.STRING,
            'topic',
            'topic: `reference`; joint_states: the measured motion, accelerations differenced',
            choices=('topic', 'joint_states'),
        ),
        Parameter(
            'acceleration_cutoff',
            Kind.DOUBLE,
            20.0,
            'low pass of the accelerations differenced from joint states',
            'Hz',
            positive=True,
        ),
        Parameter(
            'require_joint_states',
            Kind.BOOL,
            True,
            'torque along the reference only while joint states are fresh',
        ),
        Parameter(
            'allow_extra_joints',
            Kind.BOOL,
            False,
            'take joint states that also have joints the robot does not have',
        ),
        Parameter(
            'lead_time',
            Kind.DOUBLE,
            0.0,
            'how far ahead of now the reference is taken: makes up for transport and hold delay',
            's',
            0.0,
            0.1,
            live=True,
        ),
        Parameter('enabled', Kind.BOOL, True, 'follow at once; false: after `~/enable`'),
        Parameter(
            'stale_action',
            Kind.STRING,
            'ramp_to_gravity',
            'what to do while there is no good input',
            choices=STALE_ACTIONS,
        ),
        Parameter(
            'ramp_time', Kind.DOUBLE, 0.5, 'of ramp_to_gravity', 's', maximum=30.0, positive=True
        ),
        Parameter(
            'effort_limits',
            Kind.DOUBLES,
            [],
            "largest effort, one per driven joint; empty: the URDF's",
            'N m, N',
            0.0,
        ),
        Parameter(
            'enforce_command_limits', Kind.BOOL, True, 'hold the torque within the effort limits'
        ),
        Parameter(
            'max_delta_tau',
            Kind.DOUBLE,
            math.inf,
            'largest change of torque per tick',
            'N m, N',
            positive=True,
        ),
        *feedback_parameters(),
        Parameter(
            'publish_joint_trajectory',
            Kind.BOOL,
            False,
            'also publish `~/joint_trajectory` with effort, one point per tick',
        ),
    ]
)
