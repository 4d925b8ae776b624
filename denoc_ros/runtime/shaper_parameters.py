"""The shaper node's parameters."""

from __future__ import annotations

from denoc_ros.control import impulses
from denoc_ros.runtime.parameters import ParameterTable
from denoc_ros.runtime.shared_parameters import (
    lifecycle_parameters,
    loop_parameters,
    publishers_parameter,
    range_parameters,
    robot_parameters,
)
from denoc_ros.settings import Kind, Parameter

OF_STREAMS = impulses.METHODS
METHODS = ('tip', *OF_STREAMS, 'rest_to_rest')

TABLE = ParameterTable(
    [
        *lifecycle_parameters(),
        *robot_parameters(),
        *loop_parameters(),
        publishers_parameter(),
        *range_parameters(),
        Parameter(
            'joints',
            Kind.STRINGS,
            [],
            'driven joints of a robot with loops; empty: all but mimic joints',
        ),
        Parameter(
            'method',
            Kind.STRING,
            'tip',
            'tip: the tip moves like that of the undeformed robot; zv, zvd, ei: input shapers,'
            ' also for streams; rest_to_rest: the path of the joints between first and last '
            'posture is free',
            choices=METHODS,
            live=True,
        ),
        Parameter(
            'fastest',
            Kind.BOOL,
            False,
            'with `method: tip` or `rest_to_rest`: the timing is free, each motion takes the '
            'least time within the limits',
            live=True,
        ),
        Parameter(
            'margin',
            Kind.DOUBLE,
            0.0,
            'share of every limit but positions that `fastest` keeps free',
            '',
            0.0,
            0.9,
            live=True,
        ),
        Parameter(
            'tip',
            Kind.STRING,
            '',
            'frame that `method: tip` controls; empty: `tool`, or else the last link of the file',
            live=True,
        ),
        Parameter(
            'base',
            Kind.STRING,
            'free_floating',
            'a floating base: free_floating (it reacts to the arm) or free_flying (thrusters hold '
            'it)',
            choices=('free_floating', 'free_flying'),
            live=True,
        ),
        Parameter(
            'modes',
            Kind.INTEGER,
            0,
            'number of modes that come to rest, from the lowest; 0: all below ten times the '
            'lowest frequency',
            '',
            0,
            100,
            live=True,
        ),
        Parameter(
            'mode_table',
            Kind.STRING,
            '',
            'file with measured modes over postures (`denoc identify postures`), in place of the '
            'modes of the model, which may be rigid (`method: zv, zvd, ei`); read again by '
            '`~/reload_model`',
        ),
        Parameter(
            'robustness',
            Kind.DOUBLE,
            0.1,
            "assumed error of the modes' frequencies, as a share (`method: rest_to_rest`)",
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
                f'largest {what}, one or one per driven joint; empty: {none}',
                unit,
                positive=True,
                live=True,
            )
            for what, unit, none in (
                ('velocity', 'rad/s, m/s', "the URDF's"),
                ('acceleration', 'rad/s^2, m/s^2', 'no limit'),
                ('jerk', 'rad/s^3, m/s^3', 'no limit'),
                ('effort', 'N m, N', "the URDF's"),
                ('effort_rate', 'N m/s, N/s', 'no limit'),
            )
        ),
        Parameter(
            'servo.bandwidth',
            Kind.DOUBLES,
            [],
            'natural frequency with which the joints follow commands, one or one per joint; '
            'empty: they follow exactly (see `denoc identify servo`)',
            'Hz',
            positive=True,
            live=True,
        ),
        Parameter(
            'servo.damping',
            Kind.DOUBLES,
            [1.0],
            'damping ratio with which the joints follow commands, one or one per joint',
            positive=True,
            live=True,
        ),
        Parameter(
            'servo.delay',
            Kind.DOUBLES,
            [0.0],
            'delay with which the joints follow commands, one or one per joint',
            's',
            0.0,
            1.0,
            live=True,
        ),
        Parameter(
            'on_failure',
            Kind.STRING,
            'refuse',
            'for a motion that cannot be shaped: refuse it, or pass_on: publish it unchanged',
            choices=('refuse', 'pass_on'),
            live=True,
        ),
        Parameter(
            'output_step',
            Kind.DOUBLE,
            0.01,
            'time between points of the published motions',
            's',
            0.001,
            1.0,
            live=True,
        ),
        Parameter(
            'solve_timeout',
            Kind.DOUBLE,
            10.0,
            'longest planning time of a motion; after it the planner is ended and restarted',
            's',
            maximum=600.0,
            positive=True,
            live=True,
        ),
        Parameter(
            'start_margin',
            Kind.DOUBLE,
            0.1,
            'shortest time between the publication and the start of a motion',
            's',
            0.0,
            10.0,
            live=True,
        ),
        Parameter(
            'stream_timeout',
            Kind.DOUBLE,
            0.1,
            'age after which a streamed input is stale: until then the joints keep their last '
            'velocity, then they brake',
            's',
            maximum=10.0,
            positive=True,
        ),
        Parameter(
            'stop_time',
            Kind.DOUBLE,
            0.3,
            'braking time after a stale stream; the shortest one of `~/stop`',
            's',
            maximum=10.0,
            positive=True,
        ),
    ]
)
