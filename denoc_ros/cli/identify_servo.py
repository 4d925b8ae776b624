"""`denoc identify servo`: bandwidth, damping, delay and gain of position-controlled joints."""

from __future__ import annotations

import argparse

from denoc_ros.cli.arguments import (
    add_option,
    add_pairs,
    add_window,
    require,
    settings_of,
    window_findings,
)
from denoc_ros.cli.identify_options import Action, add_recording_options, written_result
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.identification.channel import Channel
from denoc_ros.identification.servo_runs import ServoOptions, identify_servos
from denoc_ros.reports.identify_signals import servo_page, servo_text


def _add_servo(parser: argparse.ArgumentParser) -> None:
    add_recording_options(parser, several=True)
    group = parser.add_argument_group('the signals')
    add_option(
        group,
        '--command TOPIC',
        'topic of the commands: JointTrajectory, whole or streamed, or JointState; '
        'default: /reference',
        '/reference',
        dest='commanded',
    )
    add_option(
        group,
        '--topic',
        'topic of the measured JointState; default: /joint_states',
        '/joint_states',
    )
    add_pairs(
        group,
        '--column JOINT.FIELD=COLUMN',
        'column of a table with what a joint is told (FIELD command) or its position; '
        'default: columns such as elbow/command and elbow/position',
    )
    add_option(
        group,
        '--joint NAME',
        'joint to identify; repeatable; default: all commanded joints',
        action='append',
    )
    add_window(group, 'measurement')


def _servo(args: argparse.Namespace) -> VerbResult:
    require(window_findings(args))
    channel = settings_of(Channel, args)
    options = ServoOptions(channel, args.commanded, args.column, args.joint or ())
    document, found = identify_servos(args.path, options)
    return written_result(
        args.output, document, servo_text, lambda result: servo_page(result, found, args.command)
    )


DECLARED = (
    Action(
        'servo',
        'Fit a second-order lag with a delay and a static gain to the commanded and the measured '
        'positions of joints; several recordings are fitted together. The result is the '
        "shaper's `servo.*`.",
        _add_servo,
        _servo,
    ),
)
