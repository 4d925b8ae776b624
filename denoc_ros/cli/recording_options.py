"""How `denoc identify model` reads recordings: topics, names, columns, windows, filters."""

from __future__ import annotations

import argparse
import math

from denoc_ros.bags.joint_table import TableTimes
from denoc_ros.cli.arguments import add_stamp, add_times, named_values, require, times_findings
from denoc_ros.identification.model.sources import RecordingSettings, SensorFilter


def add_recording_settings(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    group = parser.add_argument_group('the recordings')
    group.add_argument(
        '--topic', default='/joint_states', help='joint states of a bag; default: /joint_states'
    )
    group.add_argument(
        '--rename',
        action='append',
        default=[],
        metavar='OLD=NEW',
        help='beginning of joint names in the bag, and its replacement in the robot; repeatable',
    )
    group.add_argument(
        '--column',
        action='append',
        default=[],
        metavar='NAME=COLUMN',
        help="column of a table: JOINT.position, JOINT.velocity, JOINT.effort, or a sensor's raw "
        'readings as sensor.NAME; repeatable',
    )
    group.add_argument(
        '--torque-constant',
        action='append',
        default=[],
        metavar='JOINT=NM_PER_A',
        help="torque per ampere at the joint, where the joint's effort was recorded as current; "
        'negative where current turns it the other way; repeatable',
    )
    group.add_argument(
        '--filter',
        action='append',
        default=[],
        metavar='SENSOR=OMEGA,DAMPING',
        help="low-pass of second order that a sensor's readings have passed [rad/s, share of "
        'critical]; repeatable',
    )
    group.add_argument(
        '--pose',
        action='append',
        default=[],
        metavar='TOPIC=FRAME',
        help='poses (geometry_msgs/PoseStamped) that a tracker measured of a frame of the robot, '
        "in axes near those of the robot's base; repeatable",
    )
    group.add_argument(
        '--begin', metavar='S', type=float, default=0.0, help='since the first joint state [s]'
    )
    group.add_argument(
        '--end', metavar='S', type=float, default=math.inf, help='since the first joint state [s]'
    )
    add_stamp(group)
    add_times(group)


def recording_settings(args: argparse.Namespace) -> RecordingSettings:
    """Settings by the options; ConfigError with every finding."""
    findings = times_findings(args)
    if not args.begin < args.end:
        findings.append(f'--begin must be before --end, got {args.begin} and {args.end} s')
    rename = named_values('--rename', args.rename, 'OLD=NEW', str, findings)
    columns = named_values('--column', args.column, 'NAME=COLUMN', str, findings)
    form = 'SENSOR=OMEGA,DAMPING'
    filters = named_values('--filter', args.filter, form, _two_numbers, findings)
    poses = named_values('--pose', args.pose, 'TOPIC=FRAME', str, findings)
    constants = named_values(
        '--torque-constant', args.torque_constant, 'JOINT=NM_PER_A', float, findings
    )
    require(findings)
    return RecordingSettings(
        topic=args.topic,
        stamp=args.stamp,
        rename=rename,
        columns=columns,
        times=TableTimes(args.time, args.time_unit, args.rate),
        begin=args.begin,
        end=args.end,
        filters={name: SensorFilter(*pair) for name, pair in filters.items()},
        poses=poses,
        torque_constants=constants,
    )


def _two_numbers(text: str) -> tuple[float, float]:
    """Return the two numbers of a text, ValueError for any other."""
    first, second = text.split(',')
    return float(first), float(second)
