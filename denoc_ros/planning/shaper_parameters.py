"""The shaper node's parameters."""

from __future__ import annotations

import math
from dataclasses import replace

from denoc_ros.planning.rest.joint_plans import RestOptions
from denoc_ros.planning.shapers import impulses
from denoc_ros.planning.timing.limit_rows import JOINTS
from denoc_ros.runtime.parameters.parameter_table import ParameterTable
from denoc_ros.runtime.parameters.shared_parameters import LOOPING, PUBLISHERS, RANGES
from denoc_ros.settings import Kind, Parameter, Value, declared, parameter

OF_STREAMS = impulses.METHODS
METHODS = ('tip', *OF_STREAMS, 'rest_to_rest')
PLANS = declared(RestOptions)


def _of_plans(name: str, default: Value, highest: float, when: str = '') -> Parameter:
    """Return an option of plans as a live parameter; 0 stands for one that is not given."""
    row = PLANS[name].within(0.0, highest)
    text, _, unset = row.text.partition('; default: ')
    text += f'; 0: {unset}' if unset and not default else ''
    return replace(row, name=name, default=default, text=when + text, positive=False, live=True)


TABLE = ParameterTable(
    [
        *LOOPING,
        PUBLISHERS,
        *RANGES,
        parameter(
            'joints',
            Kind.STRINGS,
            'driven joints of a robot with loops; empty: all but mimic joints',
        ),
        parameter(
            'method',
            'tip',
            'tip: the tip moves like that of the undeformed robot; zv, zvd, ei: input shapers,'
            ' also for streams; rest_to_rest: the path of the joints between first and last '
            'posture is free',
            choices=METHODS,
            live=True,
        ),
        parameter(
            'fastest',
            False,
            'with `method: tip` or `rest_to_rest`: the timing is free, each motion takes the '
            'least time within the limits',
            live=True,
        ),
        _of_plans('margin', 0.0, 0.9, 'with `fastest`: '),
        parameter(
            'tip',
            '',
            'frame that `method: tip` controls; empty: `tool`, or else the last link of the file',
            live=True,
        ),
        parameter(
            'base',
            'free_floating',
            'a floating base: free_floating (it reacts to the arm) or free_flying (thrusters hold '
            'it)',
            choices=('free_floating', 'free_flying'),
            live=True,
        ),
        _of_plans('modes', 0, 100),
        parameter(
            'mode_table',
            '',
            'file with measured modes over postures (`denoc identify postures`), in place of the '
            'modes of the model, which may be rigid (`method: zv, zvd, ei`); read again by '
            '`~/reload_model`',
        ),
        _of_plans('robustness', 0.1, 0.5, 'with `method: rest_to_rest`: '),
        _of_plans('radius', 0.0, math.inf, 'with `method: rest_to_rest`: '),
        *(
            parameter(
                f'limits.{what}',
                Kind.DOUBLES,
                f'largest {what}, one or one per driven joint; empty: '
                + ("the URDF's" if what in ('velocity', 'effort') else 'no limit'),
                unit,
                positive=True,
                live=True,
            )
            for what, unit in JOINTS.items()
        ),
        parameter(
            'servo.bandwidth',
            Kind.DOUBLES,
            'natural frequency with which the joints follow commands, one or one per joint; '
            'empty: they follow exactly (see `denoc identify servo`)',
            'Hz',
            positive=True,
            live=True,
        ),
        parameter(
            'servo.damping',
            [1.0],
            'damping ratio with which the joints follow commands, one or one per joint',
            positive=True,
            live=True,
            kind=Kind.DOUBLES,
        ),
        parameter(
            'servo.delay',
            [0.0],
            'delay with which the joints follow commands, one or one per joint',
            's',
            0.0,
            1.0,
            live=True,
            kind=Kind.DOUBLES,
        ),
        parameter(
            'on_failure',
            'refuse',
            'for a motion that cannot be shaped: refuse it, or pass_on: publish it unchanged',
            choices=('refuse', 'pass_on'),
            live=True,
        ),
        parameter(
            'output_step',
            0.01,
            'time between points of the published motions',
            's',
            0.001,
            1.0,
            live=True,
        ),
        parameter(
            'solve_timeout',
            10.0,
            'longest planning time of a motion; after it the planner is ended and restarted',
            's',
            maximum=600.0,
            positive=True,
            live=True,
        ),
        parameter(
            'start_margin',
            0.1,
            'shortest time between the publication and the start of a motion',
            's',
            0.0,
            10.0,
            live=True,
        ),
        parameter(
            'stream_timeout',
            0.1,
            'age after which a streamed input is stale: until then the joints keep their last '
            'velocity, then they brake',
            's',
            maximum=10.0,
            positive=True,
        ),
        parameter(
            'stop_time',
            0.3,
            'braking time after a stale stream; the shortest one of `~/stop`',
            's',
            maximum=10.0,
            positive=True,
        ),
    ]
)
