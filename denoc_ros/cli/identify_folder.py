"""`denoc identify modal` and `model` on many recordings: one row each."""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from denoc_ros.cli.batch import FAILURE, Row, RowStore, WorkerConfig, run_batch
from denoc_ros.cli.exit_statuses import DOUBTFUL
from denoc_ros.cli.identify_decay import identify
from denoc_ros.errors import BagError
from denoc_ros.reports.text_table import text_table

OF_MODAL: dict[str, type] = {
    'file': str,
    'verdict': str,
    'modes': int,
    'frequency_hz': list,
    'damping_ratio': list,
    'interval_low': list,
    'interval_high': list,
    'bound': list,
    'amplitude': list,
    'snr_db': list,
    'begin_s': float,
    'end_s': float,
    'reasons': str,
    'processor_s': float,
}
OF_MODES = ('frequency_hz', 'damping_ratio', 'bound', 'amplitude', 'snr_db')
# what does not change a row
APART = (
    *('paths', 'bags', 'output', 'json', 'each', 'workers', 'scheduler'),
    *('verb', 'action', 'act', 'execute', 'command'),
)


@dataclass(frozen=True)
class RowKind:
    """Content of a recording's row.

    Attributes
    ----------
    task : callable
        Importable by name; of an item (options, path) the row.
    columns : mapping of str to type
        As of a `RowStore`.
    shown : callable
        Of a row its line on a terminal.
    depends : str
        What else rows depend on: others are worked out anew.
    """

    task: Callable[[tuple[argparse.Namespace, Path]], Row]
    columns: Mapping[str, type]
    shown: Callable[[Row], Row]
    depends: str = ''


def run_folder(
    args: argparse.Namespace,
    paths: Sequence[Path],
    workers: WorkerConfig,
    kind: RowKind | None = None,
) -> int:
    """Identify each recording; exit status 0 all good, 2 some not, 1 none could be read."""
    kind = kind or MODAL
    rows = identify_all(args, paths, workers, not args.json, kind)
    good = [row for row in rows if not row[FAILURE]]
    if args.json:
        print(json.dumps({'output': str(args.output or ''), 'rows': rows}, indent=2))
    else:
        if good:
            print(text_table([kind.shown(row) for row in good]))
        for row in rows:
            if row[FAILURE]:
                print(f'  skipped: {row[FAILURE]}')
        print(f'{len(good)} of {len(rows)} recordings', f'in {args.output}' if args.output else '')
    if not good:
        raise BagError(f'none of {len(rows)} recordings could be read')
    return 0 if all(row.get('verdict') == 'good' for row in rows) else DOUBTFUL


def identify_all(
    args: argparse.Namespace,
    paths: Sequence[Path],
    workers: WorkerConfig,
    progress: bool = False,
    kind: RowKind | None = None,
) -> list[Row]:
    """Return a row for each recording, as `denoc_ros.cli.batch.run_batch` does.

    Parameters
    ----------
    args : Namespace
        Of `denoc identify modal` or `model`: the signals, the robot, `output`.
    paths : sequence of Path
        The recordings; the workers must see them under the same paths.
    workers : WorkerConfig
        Who works.
    progress : bool
        Whether there is a progress bar, on a terminal.
    kind : RowKind, optional
        Of rows; default: modes.
    """
    kind = kind or MODAL
    options = argparse.Namespace(
        **{name: value for name, value in vars(args).items() if name not in APART}
    )
    told = repr(sorted(vars(options).items())) + kind.depends
    asked = hashlib.sha256(told.encode()).hexdigest()[:12]
    store = RowStore(args.output, kind.columns) if args.output else None
    items = {f'{asked}/{_state_of(path)}': (options, path.resolve()) for path in paths}
    return run_batch(kind.task, items, store, workers, 'recordings', progress)


def modal_row(item: tuple[argparse.Namespace, Path]) -> Row:
    """Return one recording's row."""
    options, path = item
    began = time.thread_time()
    document, _ = identify(options, path)
    modes = document['modes']
    row: Row = {
        'file': str(path),
        'verdict': document['verdict'],
        'modes': len(modes),
        'begin_s': document['window']['begin_s'],
        'end_s': document['window']['end_s'],
        'reasons': '; '.join(document['reasons']),
        'processor_s': time.thread_time() - began,
    }
    row |= {name: [mode[name] for mode in modes] for name in OF_MODES}
    for k, name in enumerate(('interval_low', 'interval_high')):
        row[name] = [mode['interval'][k] for mode in modes]
    return row


def _state_of(path: Path) -> str:
    """Return a recording's path, size and time of change: a changed one is another."""
    try:
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        state = [(file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    except OSError:
        state = []
    digest = hashlib.sha256(repr(state).encode()).hexdigest()[:12]
    return f'{path.resolve()}/{digest}'


def _shown(row: Row) -> Row:
    return {
        'file': Path(row['file']).name,
        'verdict': row['verdict'],
        'f [Hz]': ' '.join(f'{value:.4g}' for value in row['frequency_hz']) or '-',
        'zeta': ' '.join(f'{value:.4g}' for value in row['damping_ratio']) or '-',
    }


MODAL = RowKind(modal_row, OF_MODAL, _shown)
