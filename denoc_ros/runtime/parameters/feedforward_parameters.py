"""The feedforward node's parameters."""

from __future__ import annotations

import math

from denoc_ros.dynamics.driven.torque_feedforward import MODELS
from denoc_ros.parts import added_rows
from denoc_ros.runtime.parameters.parameter_table import ParameterTable
from denoc_ros.runtime.parameters.shared_parameters import EXTRA_JOINTS, MEASURING
from denoc_ros.runtime.safety.torque import STALE_ACTIONS
from denoc_ros.settings import Kind, parameter

TABLE = ParameterTable(
    [
        *MEASURING,
        parameter(
            'joints',
            Kind.STRINGS,
            'driven joints, in the order of the commands; empty: all but mimic joints',
        ),
        parameter(
            'model',
            'flexible',
            'rigid: rigid links; flexible: amplitudes move freely; quasi_static: amplitudes at'
            ' static equilibrium',
            choices=MODELS,
            live=True,
        ),
        parameter(
            'base',
            'free_floating',
            'a floating base: free_floating (it reacts to the arm, without momentum), drifting '
            '(it reacts; `base_motion` measures its twist) or free_flying (thrusters hold it; the '
            'required wrench goes to `~/base_wrench`); with the first and the last, a measured '
            '`base_motion` is that of a known base',
            choices=('free_floating', 'drifting', 'free_flying'),
        ),
        *(
            parameter(f'terms.{name}', True, f'include {text}', live=True)
            for name, text in (
                ('inertia', 'the torque for accelerations'),
                ('coriolis', 'the torque for centrifugal and Coriolis forces'),
                (
                    'gravity',
                    'the torque against gravity; false if the robot compensates it itself',
                ),
                ('friction', "the torque against the joints' damping and friction"),
                ('elastic', 'the change of torque due to deflection'),
            )
        ),
        parameter(
            'trigger',
            'clock',
            'clock: commands at `update_rate`; message: one `~/effort` per accepted reference,'
            ' with its stamp, and no commands (for recorded runs)',
            choices=('clock', 'message'),
        ),
        parameter(
            'reference_source',
            'topic',
            'topic: `reference`; joint_states: the measured motion, with differentiated '
            'accelerations',
            choices=('topic', 'joint_states'),
        ),
        parameter(
            'acceleration_cutoff',
            20.0,
            'bandwidth of the low-pass filter on accelerations differentiated from joint states',
            'Hz',
            positive=True,
        ),
        parameter(
            'require_joint_states', True, 'follow the reference only while joint states are fresh'
        ),
        EXTRA_JOINTS,
        parameter(
            'sync_to_joint_states',
            False,
            "keep each tick half a period after the joint states' stamps: the delay from a "
            'measurement to its torque is then the same in every period; needs joint states '
            'every period, or every few',
        ),
        parameter(
            'lead_time',
            0.0,
            'how far ahead of the current time the reference is evaluated: compensates '
            'transport and hold delay',
            's',
            0.0,
            0.1,
            live=True,
        ),
        parameter('enabled', True, 'follow the reference from the start; false: after `~/enable`'),
        parameter(
            'stale_action',
            'ramp_to_gravity',
            'what to send while joint states or reference are stale',
            choices=STALE_ACTIONS,
        ),
        parameter(
            'ramp_time', 0.5, 'duration of ramp_to_gravity', 's', maximum=30.0, positive=True
        ),
        parameter(
            'effort_limits',
            Kind.DOUBLES,
            "largest effort, one per driven joint; empty: the URDF's",
            'N m, N',
            0.0,
        ),
        parameter('enforce_command_limits', True, 'clamp the torque to the effort limits'),
        parameter(
            'max_delta_tau', math.inf, 'largest change of torque per tick', 'N m, N', positive=True
        ),
        *added_rows('feedforward'),
        parameter(
            'publish_joint_trajectory',
            False,
            'also publish `~/joint_trajectory` with effort, one point per tick',
        ),
        parameter(
            'impedance.stiffness',
            Kind.DOUBLES,
            "also publish `~/impedance_commands` with this stiffness of the drives' own loop, one "
            'value or one per joint; empty: off',
            'N m/rad, N/m',
            0.0,
        ),
        parameter(
            'impedance.damping',
            [0.0],
            'the same, damping relative to the velocity of the reference',
            'N m s/rad, N s/m',
            0.0,
            kind=Kind.DOUBLES,
        ),
    ]
)
