"""The shaper node's parameters."""

from __future__ import annotations

from denoc_ros.runtime.parameters import Kind, Parameter, ParameterTable
from denoc_ros.runtime.shared_parameters import (
    lifecycle_parameters,
    loop_parameters,
    publishers_parameter,
    range_parameters,
    robot_parameters,
)

METHODS = ('tip', 'zv', 'zvd', 'ei', 'rest_to_rest')
OF_STREAMS = ('zv', 'zvd', 'ei')

TABLE = ParameterTable(
    [
        *lifecycle_parameters(),
        *robot_parameters(),
        *loop_parameters(),
        publishers_parameter(),
        *range_parameters(),
        Parameter(
            'method',
            Kind.STRING,
            'tip',
            "tip: the tip does what the undeformed robot's would; zv, zvd, ei: input shapers, for "
            'streams too; rest_to_rest: between first and last posture the joints do as they like',
            choices=METHODS,
            live=True,
        ),
        Parameter(
            'tip',
            Kind.STRING,
            '',
            'frame that `method: tip` leads; empty: `tool`, else the last link of the file',
            live=True,
        ),
        Parameter(
            'modes',
            Kind.INTEGER,
            0,
            'modes that come to rest, from the lowest; 0: those below ten times the lowest',
            '',
            0,
            100,
            live=True,
        ),
        Parameter(
            'robustness',
            Kind.DOUBLE,
            0.1,
            "share by which the modes' frequencies may be off (`method: rest_to_rest`)",
            '',
            0.0,
            0.5,
            live=True,
        ),
        *(
            Parameter(
                f'limits.{what}',
                Kind.DOUBLES,
                [],
                f'largest {what}, of all joints or of each in the order of the file; '
                f'empty: {none}',
                unit,
                positive=True,
                live=True,
            )
            for what, unit, none in (
                ('velocity', 'rad/s, m/s', "the URDF's"),
                ('acceleration', 'rad/s^2, m/s^2', 'no limit'),
                ('jerk', 'rad/s^3, m/s^3', 'no limit'),
                ('effort', 'N m, N', "the URDF's"),
            )
        ),
        Parameter(
            'servo.bandwidth',
            Kind.DOUBLES,
            [],
            'natural frequency at which the joints follow commands, of all or of each; empty: '
            'they are where they are told to be (`denoc identify servo`)',
            'Hz',
            positive=True,
            live=True,
        ),
        Parameter(
            'servo.damping',
            Kind.DOUBLES,
            [1.0],
            'damping ratio at which the joints follow commands, of all or of each',
            positive=True,
            live=True,
        ),
        Parameter(
            'servo.delay',
            Kind.DOUBLES,
            [0.0],
            'delay with which the joints follow commands, of all or of each',
            's',
            0.0,
            1.0,
            live=True,
        ),
        Parameter(
            'on_failure',
            Kind.STRING,
            'refuse',
            'a motion that cannot be shaped: refuse it, or pass_on: let it through as it came',
            choices=('refuse', 'pass_on'),
            live=True,
        ),
        Parameter(
            'output_step',
            Kind.DOUBLE,
            0.01,
            'between points of the motions that leave',
            's',
            0.001,
            1.0,
            live=True,
        ),
        Parameter(
            'solve_timeout',
            Kind.DOUBLE,
            10.0,
            'how long a motion may take to be planned; then the planner is ended and started anew',
            's',
            maximum=600.0,
            positive=True,
            live=True,
        ),
        Parameter(
            'start_margin',
            Kind.DOUBLE,
            0.1,
            'how long before its start a motion leaves, at least',
            's',
            0.0,
            10.0,
            live=True,
        ),
        Parameter(
            'stream_timeout',
            Kind.DOUBLE,
            0.1,
            'age after which a streamed input is stale: until then the joints go on with their '
            'last rate, then they brake',
            's',
            maximum=10.0,
            positive=True,
        ),
        Parameter(
            'stop_time',
            Kind.DOUBLE,
            0.3,
            'how long they brake',
            's',
            maximum=10.0,
            positive=True,
        ),
    ]
)
