"""`denoc identify modal`: modes of free decays, of one recording or of whole folders."""

from __future__ import annotations

import argparse
import glob
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from denoc_ros.cli.batch import WorkerConfig, add_worker_options, worker_config
from denoc_ros.cli.identify_decay import identify
from denoc_ros.cli.identify_folder import run_folder
from denoc_ros.cli.identify_inputs import (
    add_channel_options,
    add_robot_options,
    add_verdict_options,
)
from denoc_ros.cli.identify_outputs import give_result
from denoc_ros.cli.verbs import ACTIONS
from denoc_ros.errors import BagError
from denoc_ros.reports.identify_modal import decay_page
from denoc_ros.reports.identify_result import interval_text, verdict_text
from denoc_ros.reports.pages import ReportPage
from denoc_ros.reports.text_table import text_table

Document = dict[str, Any]

RECORDINGS = ('.mcap', '.db3', '.csv', '.tsv', '.dat', '.mat', '.json')


def add_actions(actions: Any) -> None:
    """Declare the action's arguments."""
    parser = actions.add_parser(
        'modal',
        help=ACTIONS['modal'],
        description=(
            'Identify the modes of a free decay and their number. Several recordings, a folder'
            ' or a quoted pattern give one row each.'
        ),
    )
    parser.add_argument(
        'paths', metavar='BAG', nargs='+', help="bags, tables, folders, or 'bags/**/*.mcap'"
    )
    parser.add_argument(
        '-o',
        '--output',
        metavar='FOLDER',
        type=Path,
        help=(
            'folder for result.yaml, modes.csv and report.html of one recording, or for '
            'Parquet files of several, which grow'
        ),
    )
    parser.add_argument('--json', action='store_true', help='print machine-readable JSON')
    add_channel_options(parser)
    add_verdict_options(parser)
    add_robot_options(parser)
    add_worker_options(parser)
    parser.set_defaults(act=run_modal)


def run_modal(args: argparse.Namespace) -> int:
    """Identify; exit status of the modes asked for: 0 good, 2 doubtful, 3 not identifiable."""
    paths, workers = recordings(args.paths), worker_config(args)
    if len(paths) > 1 or str(paths[0]) not in args.paths or workers != WorkerConfig():
        return run_folder(args, paths, workers)
    document, analysis = identify(args, paths[0])

    def page() -> ReportPage:
        return decay_page(document, analysis, args.command)

    return give_result(args, document, as_text(document), page)


def recordings(names: Sequence[str]) -> list[Path]:
    """Return the recordings that match paths, folders and patterns, each once.

    Raises
    ------
    BagError
        When one of them stands for none.
    """
    found: dict[Path, None] = {}
    for name in names:
        paths = [Path(name)]
        if glob.has_magic(name) and not paths[0].exists():
            paths = [Path(match) for match in sorted(glob.glob(name, recursive=True))]
        elif paths[0].is_dir() and not _is_bag_folder(paths[0]):
            paths = sorted(_inside(paths[0]))
        if not paths:
            raise BagError(f'{name}: path must be that of a bag, or of some, got none there')
        found |= dict.fromkeys(paths)
    return list(found)


def as_text(document: Mapping[str, Any]) -> str:
    """Return a result's lines for a terminal."""
    source, window, quality = document['source'], document['window'], document['quality']
    signal = ' '.join(filter(None, (source['topic'], source['field'], source['quantity'])))
    lines = [
        f'{source["file"]}: {signal}',
        f'  {window["begin_s"]:.4g} … {window["end_s"]:.4g} s ({window["by"]}), '
        f'{quality["samples"]} samples at {quality["rate"]:.4g} Hz',
    ]
    rows = [
        {
            'f [Hz]': mode['frequency_hz'],
            'zeta': mode['damping_ratio'],
            '95 %': interval_text(mode['interval']).removeprefix('95 %: '),
            'bound': f'{100.0 * mode["bound"]:.2g} %' if mode['bound'] is not None else '-',
            'SNR [dB]': mode['snr_db'],
            'verdict': mode['verdict'],
        }
        for mode in document['modes']
    ]
    if rows:
        lines.append(text_table(rows))
    for mode in document['modes']:
        lines += [f'  {mode["frequency_hz"]:.4g} Hz: {reason}' for reason in mode['reasons']]
        lines += [
            f'  {mode["frequency_hz"]:.4g} Hz, {check["method"]}: {_check_text(check)}'
            for check in mode['checks']
        ]
        if one := mode.get('coefficient'):
            lines.append(
                f'  {mode["frequency_hz"]:.4g} Hz: {one["value"]:.4g} {one["unit"]} of '
                f'{one["of"]} ({one["scaling"]}), {one["path"]} '
                f'{one["damping_ratio_at_fixed_root"]:.4g}'
            )
    lines += [
        f'  no mode: {line["frequency"]:.4g} Hz, {line["origin"]}' for line in document['lines']
    ]
    lines += [f'  {remark}' for remark in document['remarks']]
    if note := document.get('model', {}).get('left_out'):
        lines.append(f'  coefficients left out: {note}')
    return '\n'.join([*lines, verdict_text(document)])


def _check_text(check: Mapping[str, Any]) -> str:
    found = [] if check['damping_ratio'] is None else [f'zeta {check["damping_ratio"]:.4g}']
    return ', '.join([*found, *filter(None, [check['reason']])])


def _is_bag_folder(folder: Path) -> bool:
    files = [file for file in folder.iterdir() if file.suffix in ('.mcap', '.db3')]
    return (folder / 'metadata.yaml').is_file() or len(files) == 1


def _inside(folder: Path) -> list[Path]:
    """Return the bags below a folder: bag folders as such, and tables."""
    found: dict[Path, None] = {}
    for file in folder.rglob('*'):
        if file.suffix in RECORDINGS and file.is_file():
            is_part = (file.parent / 'metadata.yaml').is_file()
            found[file.parent if is_part else file] = None
    return list(found)
