"""`denoc replay BAG`: torque and deflection recomputed along a recorded run."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from denoc_ros.bags.joint_table import TableTimes, bag_of_table
from denoc_ros.bags.tables import is_table
from denoc_ros.cli.arguments import (
    add_gravity,
    add_setting,
    add_stamp,
    add_times,
    named_values,
    number_range,
    require,
    times_findings,
    unused,
)
from denoc_ros.cli.exit_statuses import DOUBTFUL
from denoc_ros.cli.overrides import add_overrides, overrides_of
from denoc_ros.cli.progress import share_bar
from denoc_ros.cli.recorded_run import robot_source
from denoc_ros.cli.verbs import VERBS
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import BagError
from denoc_ros.estimation.tracker_settings import TrackerSettings
from denoc_ros.output_files import require_new, write_text
from denoc_ros.replay.adaptation import AdaptSettings
from denoc_ros.replay.bag import replay_bag
from denoc_ros.replay.settings import ReplaySettings
from denoc_ros.replay.summary import summarize
from denoc_ros.reports.provenance import named_file, named_text, provenance
from denoc_ros.reports.replay import page
from denoc_ros.reports.run_files import EARTH, find_bag, read_session, recording_name
from denoc_ros.reports.text_table import Row, text_table
from denoc_ros.runtime.predictor_parameters import TRACKER


def add_parser(subparsers: Any) -> None:
    """Declare the verb's arguments."""
    parser = subparsers.add_parser(
        'replay',
        help=(VERBS['replay']),
        description=(
            'Read the joint states of a bag (MCAP or db3) or of a table, and compute the '
            'torque of the rigid and of the flexible model and the deflection along them. '
            'Write a new bag with these results beside all recorded messages, a table and one '
            'HTML page. Exit status 2: the numbers are doubtful.'
        ),
    )
    parser.add_argument(
        'bag',
        metavar='BAG',
        type=Path,
        help='a bag, the directory of a run, or a table of numbers with columns such as '
        'elbow/position',
    )
    parser.add_argument(
        '--robot',
        help=(
            'the URDF file, in this folder or in the installed package; default: the one in '
            'the bag'
        ),
    )
    parser.add_argument(
        '-o',
        '--output',
        type=Path,
        metavar='BAG',
        help='the new bag, a folder or a .mcap file (default: BAG_replay here, or replay in the '
        "run's directory)",
    )
    parser.add_argument(
        '--no-output', action='store_true', help='write only table and page, no bag'
    )
    parser.add_argument(
        '--report',
        type=Path,
        metavar='FILE',
        help=("file of the page (default: the new bag's name .html)"),
    )
    _add_table(parser)
    _add_ways(parser)
    _add_adaptation(parser)
    add_overrides(parser)
    parser.add_argument('--json', action='store_true', help='print the numbers as JSON')


def _add_table(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group('tables')
    group.add_argument(
        '--column',
        action='append',
        default=[],
        metavar='JOINT.FIELD=COLUMN',
        help="column of a joint's position, velocity or effort; repeatable",
    )
    add_times(group)


def _add_ways(parser: argparse.ArgumentParser) -> None:
    add_gravity(parser, None, "the run's, else 0 0 -9.81")
    parser.add_argument('--topic', default='', help='topic of the joint states (default: found)')
    parser.add_argument(
        '--joint',
        action='append',
        default=[],
        metavar='NAME',
        help=(
            'a driven joint; in a mechanism the driven joints determine the motion (default: '
            'all); repeatable'
        ),
    )
    parser.add_argument(
        '--effort', default='', metavar='TOPIC', help='take the measured effort from this topic'
    )
    parser.add_argument(
        '--base',
        default='',
        metavar='TOPIC',
        help=(
            'nav_msgs/Odometry with the motion of the base (default: base_motion, where the base '
            'of the robot floats)'
        ),
    )
    parser.add_argument(
        '--rename',
        action='append',
        default=[],
        metavar='OLD=NEW',
        help='beginning of joint names in the bag, and its replacement in the robot; repeatable',
    )
    parser.add_argument(
        '--derivative',
        choices=('filter', 'kalman'),
        default='filter',
        help='method for velocities and accelerations: local polynomials, or a Kalman smoother',
    )
    parser.add_argument(
        '--cutoff',
        type=float,
        default=20.0,
        metavar='HZ',
        help='bandwidth of this method, default 20',
    )
    add_stamp(parser)
    parser.add_argument(
        '--fit-friction',
        action='store_true',
        help='fit viscous and Coulomb friction and an offset per joint to the measured effort',
    )


def _add_adaptation(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group('tracked numbers, as `adapt` of the predictor')
    group.add_argument(
        '--adapt',
        action='append',
        default=[],
        metavar='PATH',
        help=(
            'number of the model that is tracked over time: payload.tool.mass, beam.*.ei; '
            'repeatable'
        ),
    )
    group.add_argument(
        '--adapt-bounds',
        action='append',
        default=[],
        metavar='PATH=LOW:HIGH',
        help='its bounds (default: half to one and a half of its value); repeatable',
    )
    for row in TRACKER.rows():
        add_setting(group, row)


def run(args: argparse.Namespace) -> int:
    """Run the verb and return the exit status; errors are raised."""
    settings = ReplaySettings(
        topic=args.topic,
        joints=tuple(args.joint),
        effort=args.effort,
        base=args.base,
        rename=_renames(args.rename),
        derivative=args.derivative,
        cutoff=args.cutoff,
        stamp=args.stamp,
        fit_friction=args.fit_friction,
    )
    adapt = _adapt_settings(args)
    bag = find_bag(args.bag)
    output = args.output or _default_output(args.bag, bag)
    report = args.report or unused(output.with_name(f'{recording_name(output)}.html'))
    require_new(None if args.no_output else output)
    robot = _robot(args, bag, read_session(args.bag))
    with _as_bag(args, bag, robot) as recorded, share_bar(quiet=args.json) as bar:
        replay = replay_bag(
            recorded, robot, None if args.no_output else output, settings, bar.update, adapt
        )
    summary = {
        'output': None if args.no_output else str(output),
        **summarize(replay),
        'bag': str(bag),
    }
    sources = {'bag': named_file(bag), 'robot': named_text(_robot_name(args), robot.tree.source)}
    shown = page(replay, summary, robot, provenance(args.command, sources))
    replaced = ' (replaced)' if report.exists() else ''
    write_text(report, shown.html())
    if args.json:
        print(json.dumps({**summary, 'report': str(report)}, indent=2, allow_nan=False))
    else:
        print('\n'.join(lines(summary)))
        print(f'report  {report}{replaced}')
    return DOUBTFUL if summary['doubts'] else 0


@contextmanager
def _as_bag(args: argparse.Namespace, path: Path, robot: Robot) -> Iterator[Path]:
    """Yield the bag to be read: the one that was given, or one made of a table for now."""
    findings: list[str] = []
    columns = named_values('--column', args.column, 'JOINT.FIELD=COLUMN', str, findings)
    require(findings + times_findings(args))
    if not is_table(path):
        if columns:
            raise BagError(f'{path}: --column must come with a table, got a bag')
        yield path
        return
    times = TableTimes(args.time, args.time_unit, args.rate)
    with TemporaryDirectory(prefix='denoc-') as folder:
        yield bag_of_table(path, robot.joint_names, Path(folder, 'table.mcap'), columns, times)


def _robot_name(args: argparse.Namespace) -> str:
    return Path(args.robot).name if args.robot else 'the one in the bag'


def _default_output(run: Path, bag: Path) -> Path:
    return Path(f'{recording_name(run)}_replay') if run == bag else run / 'replay'


def _renames(texts: list[str]) -> dict[str, str]:
    findings: list[str] = []
    names = named_values('--rename', texts, 'OLD=NEW', str, findings)
    require(findings)
    return names


def _adapt_settings(args: argparse.Namespace) -> AdaptSettings:
    findings: list[str] = []
    bounds = named_values(
        '--adapt-bounds', args.adapt_bounds, 'PATH=LOW:HIGH', number_range, findings
    )
    given = {field: getattr(args, name) for field, name in TRACKER.names.items()}
    given = {field: value for field, value in given.items() if value is not None}
    if (bounds or given) and not args.adapt:
        findings.append('--adapt must name what is tracked where its settings are given, got none')
    require(findings)
    return AdaptSettings(tuple(args.adapt), bounds, TrackerSettings(**given))


def _robot(args: argparse.Namespace, bag: Path, session: dict[str, Any]) -> Robot:
    """Load the named robot, or the recorded one, with the wanted changes."""
    overrides = overrides_of(args.set, args.payload)
    source = robot_source(bag, args.robot)
    robot = load_robot(source, gravity=args.gravity or session.get('gravity', EARTH))
    return robot.with_overrides(overrides) if overrides else robot


def lines(summary: dict[str, Any]) -> Iterator[str]:
    """Yield a replay's numbers as lines of text for the terminal."""
    yield (
        f'{summary["bag"]}: {summary["samples"]} joint states in {summary["duration_s"]:.4g} s, '
        f'{summary["derivative"]} {summary["cutoff_hz"]:.3g} Hz'
    )
    for what in ('held_joints', 'ignored_joints'):
        if summary[what]:
            yield f'  {what.replace("_", " ")}: {", ".join(summary[what])}'
    if summary['torque']:
        yield 'torque: measured, and measured minus computed [N m, N]'
        yield text_table(_torque_rows(summary))
    of = 'measured effort' if summary['torque'] else 'computed torque (no effort was measured)'
    yield f'shares of the {of}, mean square [%]'
    yield text_table(_share_rows(summary))
    if summary['friction']:
        yield 'friction, fitted (SI units; standard errors by windows of a second)'
        yield text_table(_friction_rows(summary['friction']))
    if summary['adapted']:
        cause = summary['adapted']['cause']
        yield f'tracked numbers, SI units (95 %){f"; at the end: {cause}" if cause else ""}'
        yield text_table(_adapted_rows(summary['adapted']))
    if rows := _deflection_rows(summary):
        yield 'deflection (m or rad)'
        yield text_table(rows)
    if summary['output']:
        yield f'bag     {summary["output"]}'
    for doubt in summary['doubts']:
        yield f'doubtful: {doubt}'


def _torque_rows(summary: dict[str, Any]) -> list[Row]:
    rows = []
    for joint in summary['joints']:
        row: Row = {'joint': joint}
        for model, joints in summary['torque'].items():
            one = joints.get(joint, {})
            lag = one.get('lag')
            row['effort rms'] = one.get('measured_rms')
            row |= {f'{model} {what}': one.get(what) for what in ('rms', 'bias')}
            row[f'{model} lag [ms]'] = None if lag is None else 1e3 * lag
        rows.append(row)
    return rows


def _share_rows(summary: dict[str, Any]) -> list[Row]:
    return [
        {
            'joint': joint,
            **{
                name: None if share[joint] is None else f'{100.0 * share[joint]:.1f}'
                for name, share in summary['shares'].items()
            },
        }
        for joint in summary['joints']
    ]


def _friction_rows(friction: dict[str, Any]) -> list[Row]:
    rows = []
    for joint, fit in friction.items():
        row: Row = {'joint': joint}
        for term in ('viscous', 'coulomb', 'offset'):
            row[term] = fit[term]
            row['± ' + term] = fit['standard_error_by_window'][term]
        row |= {'rms before': fit['rms_before'], 'rms after': fit['rms_after']}
        row['explained %'] = round(100.0 * fit['explained'], 1)
        rows.append(row)
    return rows


def _adapted_rows(adapted: dict[str, Any]) -> list[Row]:
    return [
        {
            'number': path,
            'start': one['start'],
            'last': one['value'],
            '±': one['half_interval'],
            'supported': 'yes' if one['supported'] else 'no',
            'lowest': min(one['values'], default=None),
            'highest': max(one['values'], default=None),
        }
        for path, one in adapted['numbers'].items()
    ]


def _deflection_rows(summary: dict[str, Any]) -> list[Row]:
    return [
        {
            'deflection': name,
            'of': topic,
            'peak': one['measured_peak'],
            'replay off by, rms': one['rms'],
            '% of peak': 100.0 * one['rms'] / one['measured_peak'],
        }
        for topic, agreements in summary['deflection'].items()
        for name, one in agreements.items()
        if one['measured_peak']
    ]
