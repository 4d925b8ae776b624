"""`denoc identify model` on the recordings of a fleet: one row each, in one table."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from denoc_ros.bags.digest import file_hash
from denoc_ros.cli.arguments import given_file
from denoc_ros.cli.batch import Row, WorkerConfig
from denoc_ros.cli.identify_folder import RowKind, run_folder
from denoc_ros.cli.model_fit import fitted_model, started_robot
from denoc_ros.cli.recording_options import recording_settings
from denoc_ros.errors import BagError
from denoc_ros.identification.model.free_parameters import FreeParameters
from denoc_ros.identification.model.result import result_of

OF_NUMBER: dict[str, type] = {'': float, ' from': float, ' to': float, ' verdict': str}
MARKS = {'found': '', 'doubtful': '?', 'not identifiable': '-'}


def run_fleet(args: argparse.Namespace, paths: Sequence[Path], workers: WorkerConfig) -> int:
    """Identify a model from each recording; exit status as of `run_folder`."""
    if args.apply is not None:
        raise BagError('--apply must come with one model, got --each, --workers or --scheduler')
    return run_folder(args, paths, workers, model_rows(args))


def model_rows(args: argparse.Namespace) -> RowKind:
    """Return which rows the models of recordings make: a column for each free number.

    The robot's file is named as a whole: workers may have another working directory.
    """
    args.robot = str(given_file(args.robot, 'robot').resolve())
    recording_settings(args)
    paths = FreeParameters(started_robot(args), args.free).paths
    columns: dict[str, type] = {
        'file': str,
        'verdict': str,
        **{f'{path}{end}': kind for path in paths for end, kind in OF_NUMBER.items()},
        'held_out': float,
        'not_identifiable': str,
        'reasons': str,
        'processor_s': float,
    }
    return RowKind(model_row, columns, _shown(paths), file_hash(Path(args.robot)))


def model_row(item: tuple[argparse.Namespace, Path]) -> Row:
    """Return the row of the model that one recording tells.

    `held_out` is the largest share of a channel's deviation that is left of the held-out part.
    """
    options, path = item
    began = time.thread_time()
    found = fitted_model(options, [path])
    document = result_of(found)
    row: Row = {'file': str(path), 'verdict': document['verdict']}
    for one in document['parameters']:
        values = (one['value'], *one['interval'], one['verdict'])
        row |= {f'{one["path"]}{end}': v for end, v in zip(OF_NUMBER, values, strict=True)}
    left = [one.held_out_after / one.size for one in found.channels if one.size > 0.0]
    return {
        **row,
        'held_out': max(left) if left and options.held_out else None,
        'not_identifiable': '; '.join(document['not_identifiable']),
        'reasons': '; '.join(document['reasons']),
        'processor_s': time.thread_time() - began,
    }


def _shown(paths: Sequence[str]) -> Callable[[Row], Row]:
    """Make a formatter of a row's line: numbers, `?` behind the doubtful, `-` for no number."""

    def line(row: Row) -> Row:
        shown: Row = {'file': Path(row['file']).name, 'verdict': row['verdict']}
        for path in paths:
            mark = MARKS[row[f'{path} verdict']]
            shown[path] = mark if mark == '-' else f'{row[path]:.4g}{mark}'
        return shown

    return line
