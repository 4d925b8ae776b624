"""`denoc identify excite`: the motion whose recording identifies a robot's numbers best."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.cli.arguments import add_gravity, given_file, named_values, number_range, require
from denoc_ros.cli.exit_statuses import exit_status
from denoc_ros.cli.identify_inputs import load_named_robot
from denoc_ros.cli.identify_numbers import numbers_text
from denoc_ros.cli.overrides import add_overrides, overrides_of
from denoc_ros.cli.plan_file import write_joint_trajectory, write_points
from denoc_ros.cli.progress import share_bar
from denoc_ros.cli.verbs import ACTIONS
from denoc_ros.identification.model.excitation import Excitation, design_excitation
from denoc_ros.identification.model.result import WORDS
from denoc_ros.identification.modes import worst
from denoc_ros.output_files import require_new, write_text
from denoc_ros.reports.identify_excite import excitation_page
from denoc_ros.reports.provenance import named_file
from denoc_ros.reports.text_table import text_table

Document = dict[str, Any]

LIMITS = {
    'velocity': ('JOINT=VALUE', 'largest velocity of a joint [rad/s, m/s]'),
    'acceleration': ('JOINT=VALUE', 'largest acceleration of a joint [rad/s^2, m/s^2]'),
    'effort': ('JOINT=VALUE', 'largest effort of a joint [N m, N]'),
    'deflection': (
        'LINK=VALUE',
        "largest deflection of a flexible link's tip [m]; default: a tenth of its length",
    ),
}


def add_actions(actions: Any) -> None:
    """Declare the action's arguments."""
    parser = actions.add_parser(
        'excite',
        help=ACTIONS['excite'],
        description='Find the motion within limits, a Fourier series of each joint from rest to '
        'rest, whose recording tells `denoc identify model` most of the free numbers; print the '
        '95 %% intervals to expect, and what no motion shows.',
    )
    parser.add_argument('robot', metavar='ROBOT', help='the URDF file')
    parser.add_argument(
        '--free',
        metavar='PATH',
        nargs='+',
        action='extend',
        required=True,
        help='what is to be identified, as of `denoc identify model`',
    )
    parser.add_argument(
        '-o',
        '--output',
        type=Path,
        required=True,
        help='the motion: a .yaml reference that `denoc up` and `denoc simulate` read',
    )
    parser.add_argument(
        '--trajectory',
        metavar='FILE',
        type=Path,
        help='also write it as the YAML of a trajectory_msgs/JointTrajectory',
    )
    parser.add_argument('--page', metavar='FILE', type=Path, help='also write an HTML page')
    parser.add_argument('--json', action='store_true', help='print JSON for machines')
    _add_motion(parser)
    _add_limits(parser)
    add_gravity(parser)
    add_overrides(parser)
    parser.set_defaults(act=run_excite)


def _add_motion(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group('motion and recording')
    numbers: tuple[tuple[str, str, Any, float, str], ...] = (
        ('duration', 'S', float, 10.0, 'of the motion [s]'),
        ('harmonics', 'K', int, 6, 'of each joint: the highest frequency is harmonics / duration'),
        ('rate', 'HZ', float, 200.0, 'of recording [Hz]'),
        ('interval', 'S', float, 0.02, 'between rows of the motion [s]'),
        ('time-limit', 'S', float, 60.0, 'of the search [s of processor time]'),
        ('seed', 'K', int, 0, 'of the motions drawn that the search starts from'),
    )
    for name, metavar, kind, default, text in numbers:
        group.add_argument(
            f'--{name}',
            metavar=metavar,
            type=kind,
            default=default,
            help=f'{text}; default: {default:g}',
        )
    group.add_argument(
        '--start',
        metavar='JOINT=VALUE',
        action='append',
        default=[],
        help='where a joint begins and ends [rad, m]; default: 0; repeatable',
    )
    group.add_argument(
        '--noise',
        metavar='CHANNEL=VALUE',
        action='append',
        default=[],
        help='standard deviation of a sample of effort, effort.JOINT [N m, N], a sensor, IMU.gyro '
        '[rad/s] or IMU.accel [m/s^2]; inf: not recorded; default: 1 %% of the effort limit, '
        "the sensor's noise; repeatable",
    )


def _add_limits(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("limits in place of the URDF's")
    group.add_argument(
        '--position',
        metavar='JOINT=LOW:HIGH',
        action='append',
        default=[],
        help='range of a joint [rad, m]; repeatable',
    )
    for name, (form, text) in LIMITS.items():
        group.add_argument(
            f'--{name}', action='append', default=[], metavar=form, help=f'{text}; repeatable'
        )


def run_excite(args: argparse.Namespace) -> int:
    """Plan the motion; exit status 0 good, 2 doubtful, 3 not identifiable."""
    options = _options(args)
    robot = load_named_robot(args.robot, args.gravity)
    overrides = overrides_of(args.set, args.payload)
    robot = robot.with_overrides(overrides) if overrides else robot
    with share_bar(args.json) as bar:
        found = design_excitation(
            robot, args.free, **options, progress=lambda share: bar.update(share - bar.n)
        )
    rows = found.rows(
        np.linspace(0.0, found.duration, 1 + math.ceil(found.duration / args.interval))
    )
    motion = (rows.q, rows.qd, rows.qdd)
    write_points(args.output, _head(found), found.joints, rows.t, motion)
    if args.trajectory is not None:
        write_joint_trajectory(args.trajectory, found.joints, rows.t, motion)
    document = excitation_result(args, found)
    if args.page is not None:
        page = excitation_page(found, document, robot.tree, args.command)
        write_text(args.page, page.html())
    print(json.dumps(document, indent=2, allow_nan=False) if args.json else as_text(document))
    return exit_status(document['verdict'])


def _options(args: argparse.Namespace) -> dict[str, Any]:
    """Arguments of design_excitation beside robot and numbers."""
    findings: list[str] = []
    if args.output.suffix not in ('.yaml', '.yml'):
        findings.append(f'--output must end in .yaml, got {args.output.name!r}')
    if not 0.0 < args.interval < math.inf:
        findings.append(f'--interval must be > 0 s, got {args.interval}')
    options: dict[str, Any] = {
        name: getattr(args, name)
        for name in ('duration', 'harmonics', 'rate', 'time_limit', 'seed')
    }
    for name, form in (
        ('start', 'JOINT=VALUE'),
        ('noise', 'CHANNEL=VALUE'),
        *((name, form) for name, (form, _) in LIMITS.items()),
    ):
        if texts := getattr(args, name):
            options[name] = named_values(f'--{name}', texts, form, float, findings)
    if args.position:
        options['position'] = named_values(
            '--position', args.position, 'JOINT=LOW:HIGH', number_range, findings
        )
    require(findings)
    require_new(args.output, args.trajectory, args.page)
    return options


def _head(found: Excitation) -> str:
    return (
        '# Planned by `denoc identify excite`: from rest to rest, for '
        f'{len(found.values)} free numbers.\n'
    )


def excitation_result(args: argparse.Namespace, found: Excitation) -> Document:
    """Result document of a motion and its expected accuracy, of plain values."""

    def finite(value: float) -> float | None:
        return value if math.isfinite(value) else None

    return {
        'output': str(args.output),
        'robot': named_file(given_file(args.robot, 'robot')),
        'duration_s': found.duration,
        'parameters': [
            {
                'path': path,
                'value': value,
                'interval': [finite(end) for end in found.interval[path]],
                'verdict': found.verdict[path],
            }
            for path, value in found.values.items()
        ],
        'not_identifiable': found.combinations,
        'not_by_any_motion': found.never,
        'combinations_seen': found.seen,
        'limits': [
            {'what': e.what, 'name': e.name, 'value': e.value, 'limit': e.limit, 'unit': e.unit}
            for e in found.extremes
        ],
        'noise': {name: finite(value) for name, value in found.noise.items()},
        'rate_hz': found.rate,
        'gain': found.gain,
        'verdict': worst(tuple(WORDS[word] for word in found.verdict.values())),
        'seconds': found.seconds,
        'evaluations': found.evaluations,
    }


def as_text(document: Mapping[str, Any]) -> str:
    """Return a result's lines for a terminal."""
    parameters = document['parameters']
    limits = [
        {
            'largest': f'{one["what"]} {one["name"]}',
            'is': one['value'],
            'limit': one['limit'],
            'unit': one['unit'],
        }
        for one in document['limits']
    ]
    seen = (
        f'{document["combinations_seen"]} of {len(parameters)} combinations are seen by any motion'
    )
    lines = [numbers_text(parameters, 'expected'), '', text_table(limits), f'  {seen}']
    lines += [f'  by no motion: {line}' for line in document['not_by_any_motion']]
    told = [o for o in document['not_identifiable'] if o not in document['not_by_any_motion']]
    lines += [f'  by this motion: {line}' for line in told]
    return '\n'.join([
        *lines,
        f'{document["output"]}: {document["duration_s"]:g} s from rest to rest',
        f'  found in {document["seconds"]:.1f} s: intervals {document["gain"]:.3g} times shorter '
        'than after the best motion drawn',
        f'expected verdict: {document["verdict"]}',
    ])  # fmt: skip
