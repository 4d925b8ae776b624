"""`denoc replay BAG`: torque and deflection recomputed along a recorded run."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from denoc_ros.cli.arguments import (
    TIMES,
    add_gravity,
    add_json,
    add_option,
    add_output,
    add_overrides,
    add_pairs,
    add_phase,
    add_settings,
    overridden,
    settings_of,
    unused,
)
from denoc_ros.cli.progress import share_bar
from denoc_ros.cli.recorded_robot import robot_source
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.cli.verbs import DOUBTFUL
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import BagError
from denoc_ros.output_files import require_new, write_text
from denoc_ros.pages.provenance import named_file, named_text, provenance
from denoc_ros.parts import optional
from denoc_ros.simulation.recorded.replay_bag import replay_bag, replayed_phases
from denoc_ros.simulation.recorded.replay_settings import ReplaySettings
from denoc_ros.simulation.recorded.replay_summary import error_rows, lines, summarize
from denoc_ros.simulation.recorded.run_files import (
    find_bag,
    recording_name,
    robot_of_run,
)

TABLES, TABLE_FILES = 'identification.tables.joint_table', 'identification.tables.tables'
TRACKING = 'identification.verbs.replay_options'
DESCRIPTION = (
    'Read the joint states of a bag (MCAP or db3) or of a table, and compute the torque of the '
    'rigid and of the flexible model and the deflection along them. Write a new bag with these '
    'results beside all recorded messages, a table and one HTML page. Exit status 2: the '
    'numbers are doubtful.'
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_option(
        parser,
        'bag BAG',
        'a bag, the directory of a run, or a table of numbers with columns such as elbow/position',
        type=Path,
    )
    add_option(
        parser,
        '--robot ROBOT',
        'the URDF file, in this folder or in the installed package; default: the one in the bag',
    )
    add_output(
        parser,
        'BAG',
        'the new bag, a folder or a .mcap file (default: BAG_replay here, or replay in the '
        "run's directory)",
    )
    add_option(parser, '--no-output', 'write only table and page, no bag')
    add_option(
        parser, '--report FILE', "file of the page (default: the new bag's name .html)", type=Path
    )
    if tables := optional(TABLES):
        _add_table(parser, tables)
    add_phase(parser)
    _add_ways(parser)
    if tracking := optional(TRACKING):
        tracking.add_options(parser)
    add_overrides(parser)
    add_json(parser)


def _add_table(parser: argparse.ArgumentParser, tables: Any) -> None:
    group = parser.add_argument_group('tables')
    text = "column of a joint's position, velocity or effort"
    add_pairs(group, '--column JOINT.FIELD=COLUMN', text)
    add_settings(group, tables.TableTimes, *TIMES)


def _add_ways(parser: argparse.ArgumentParser) -> None:
    add_gravity(parser, None, "the run's, else 0 0 -9.81")
    add_option(
        parser,
        '--joint NAME',
        'a driven joint; in a mechanism the driven joints determine the motion (default: '
        'all); repeatable',
        [],
    )
    text = 'beginning of joint names in the bag, and its replacement in the robot'
    add_pairs(parser, '--rename OLD=NEW', text)
    own = ('--topic', '--effort TOPIC', '--base TOPIC', '--derivative', '--cutoff HZ')
    add_settings(parser, ReplaySettings, *own, '--stamp', '--fit-friction')


def run(args: argparse.Namespace) -> VerbResult:
    """Recompute a run, write bag and page; exit status 2 where the numbers are doubtful."""
    settings = settings_of(ReplaySettings, args, joints=tuple(args.joint))
    tracking = optional(TRACKING)
    adapt = tracking.adapt_settings(args) if tracking else None
    bag = find_bag(args.bag)
    output = args.output or _default_output(args.bag, bag)
    require_new(None if args.no_output else output)
    robot = _robot(args)
    with _as_bag(args, bag, robot) as recorded, share_bar(quiet=args.json) as bar:
        run = recorded if recorded != bag else args.bag
        phases = replayed_phases(run, recorded, args.phase, args.robot is None)
        written = None if args.no_output else output
        replay = replay_bag(recorded, robot, written, settings, bar.update, adapt, phases)
    summary = {
        'output': None if args.no_output else str(output),
        **summarize(replay),
        'bag': str(bag),
    }
    reports = optional('reports.replay_page')
    if reports is None:
        told = [*lines(summary, error_rows(summary))]
    else:
        report = args.report or unused(output.with_name(f'{recording_name(output)}.html'))
        name = Path(args.robot).name if args.robot else 'the one in the bag'
        sources = {'bag': named_file(bag), 'robot': named_text(name, robot.tree.source)}
        shown = reports.page(replay, summary, robot, provenance(args.command, sources))
        replaced = ' (replaced)' if report.exists() else ''
        write_text(report, shown.html())
        told = [*lines(summary, reports.tables(shown)), f'report  {report}{replaced}']
        summary['report'] = str(report)
    return VerbResult(summary, told, DOUBTFUL if summary['doubts'] else 0)


@contextmanager
def _as_bag(args: argparse.Namespace, path: Path, robot: Robot) -> Iterator[Path]:
    """Yield the bag to be read: the one that was given, or one made of a table for now."""
    tables, files = optional(TABLES), optional(TABLE_FILES)
    if tables is None or files is None or not files.is_table(path):
        if tables is not None and args.column:
            raise BagError(f'{path}: --column must come with a table, got a bag')
        yield path
        return
    times = settings_of(tables.TableTimes, args)
    with TemporaryDirectory(prefix='denoc-') as folder:
        made = Path(folder, 'table.mcap')
        yield tables.bag_of_table(path, robot.joint_names, made, args.column, times)


def _default_output(run: Path, bag: Path) -> Path:
    return Path(f'{recording_name(run)}_replay') if run == bag else run / 'replay'


def _robot(args: argparse.Namespace) -> Robot:
    given = None if args.robot is None else robot_source(find_bag(args.bag), args.robot)
    return overridden(robot_of_run(args.bag, given, args.gravity), args)
