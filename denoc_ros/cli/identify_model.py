"""`denoc identify model`: a robot's numbers from recorded runs, all channels at once."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from denoc_ros.bags.digest import file_hash
from denoc_ros.cli.arguments import add_gravity
from denoc_ros.cli.batch import WorkerConfig, add_worker_options, worker_config
from denoc_ros.cli.identify_fleet import run_fleet
from denoc_ros.cli.identify_modal import recordings
from denoc_ros.cli.identify_numbers import numbers_text
from denoc_ros.cli.identify_outputs import give_result
from denoc_ros.cli.model_fit import fitted_model
from denoc_ros.cli.overrides import add_overrides
from denoc_ros.cli.progress import Progress
from denoc_ros.cli.recording_options import add_recording_settings
from denoc_ros.cli.verbs import ACTIONS
from denoc_ros.errors import BagError
from denoc_ros.identification.model.fit import IdentifiedModel
from denoc_ros.identification.model.result import applied_description, not_applied, result_of
from denoc_ros.identification.result import plain
from denoc_ros.output_files import write_text
from denoc_ros.reports.identify_model import model_page
from denoc_ros.reports.pages import ReportPage
from denoc_ros.reports.text_table import text_table
from denoc_ros.reports.versions import versions

Document = dict[str, Any]


def add_actions(actions: Any) -> None:
    """Declare the action's arguments."""
    parser = actions.add_parser(
        'model',
        help=ACTIONS['model'],
        description='Fit numbers of the robot to measured effort, gauges and other sensors of one '
        'run or several, by maximum likelihood. For each number: its value, a 95 %% interval, '
        'and whether it is found, doubtful or not identifiable; and which combinations are '
        'identifiable where single numbers are not.',
    )
    parser.add_argument(
        'bags',
        metavar='BAG',
        nargs='+',
        help="recorded runs: bags, tables, folders of them, or 'bags/**/*.mcap'",
    )
    parser.add_argument('--robot', metavar='URDF', required=True, help='where the search starts')
    parser.add_argument(
        '--free',
        metavar='PATH',
        nargs='+',
        action='extend',
        required=True,
        help='what is free: beam.<link>.<y|z>.ei, beam.<link>.torsion.gj, '
        'beam.<link>.<part>.damping_ratio, joint.<joint>.<stiffness|damping|friction|armature>, '
        'payload.<link>, link.<link>.inertial, sensor.<name>.<gain|offset>, '
        'effort.<joint>.<gain|offset>, pose.<frame>.offset, delay.effort, delay.<sensor>, '
        'delay.pose.<frame>; * stands for any name',
    )
    add_gravity(parser)
    add_overrides(parser)
    parser.add_argument(
        '--cutoff',
        metavar='HZ',
        type=float,
        default=20.0,
        help='above it effort is not compared; default: 20',
    )
    parser.add_argument(
        '--held-out',
        metavar='PART',
        type=float,
        default=0.25,
        help='last part of each run that a first fit does not see and is judged by; default: 0.25',
    )
    _add_outputs(parser)
    add_recording_settings(parser)
    add_worker_options(parser)
    parser.set_defaults(act=run_model)


def _add_outputs(parser: argparse.ArgumentParser) -> None:
    """Declare the options of outputs and recordings."""
    parser.add_argument(
        '--apply',
        metavar='URDF',
        type=Path,
        help='write the robot with what was found: a new file',
    )
    parser.add_argument(
        '-o',
        '--output',
        metavar='FOLDER',
        type=Path,
        help='folder for result.yaml and report.html, or with --each for Parquet files',
    )
    parser.add_argument('--json', action='store_true', help='print JSON for machines')
    parser.add_argument(
        '--each',
        action='store_true',
        help='fit each recording on its own: one row each, as of the robots of a fleet; so do '
        '--workers and --scheduler',
    )


def run_model(args: argparse.Namespace) -> int:
    """Identify; exit status 0 good, 2 doubtful, 3 not identifiable."""
    if args.apply is not None and args.apply.exists():
        raise BagError(f'{args.apply}: --apply must be a new file, got an existing one')
    paths, workers = recordings(args.bags), worker_config(args)
    if args.each or workers != WorkerConfig():
        return run_fleet(args, paths, workers)
    with Progress().step('identifying'):
        found = fitted_model(args, paths)
    document = model_result(args, paths, found)
    if args.apply is not None:
        _apply(args, found)

    def page() -> ReportPage:
        return model_page(document, args.command)

    return give_result(args, document, as_text(document), page)


def model_result(
    args: argparse.Namespace, paths: Sequence[Path], found: IdentifiedModel
) -> Document:
    """Return all that is kept of an identification of a whole model."""
    document = {
        'kind': 'model',
        'source': {
            'file': str(paths[0]),
            'sha256': file_hash(paths[0]),
            'others': {str(path): file_hash(path) for path in paths[1:]},
        },
        'model': {'file': str(args.robot), 'free': args.free},
        **result_of(found),
        'versions': versions(),
    }
    return dict(plain(document))


def as_text(document: Document) -> str:
    """Return a result's lines for a terminal."""
    channels = [
        {
            'run': one['run'],
            'channel': one['channel'],
            'unit': one['unit'],
            'rms before': one['rms_before'],
            'after': one['rms_after'],
            'held out before': one['held_out_before'],
            'held out after': one['held_out_after'],
        }
        for one in document['channels']
    ]
    numbers = numbers_text(document['parameters'], 'verdict')
    lines = [numbers, '', text_table(channels)]
    lines += [f'  {line}' for line in (*document['not_identifiable'], *document['reasons'])]
    return '\n'.join([*lines, f'verdict: {document["verdict"]}'])


def _apply(args: argparse.Namespace, found: IdentifiedModel) -> None:
    """Write the robot's description with the found numbers."""
    text, left = applied_description(args.robot, found)
    write_text(args.apply, text)
    if not args.json:
        print(f'{args.apply}: {args.robot} with what was found')
        for path in not_applied(found):
            print(f'  not identifiable, as in the file: {path}')
        for path, value in left.items():
            print(f'  not of a description, for --set: {path}={value}')
