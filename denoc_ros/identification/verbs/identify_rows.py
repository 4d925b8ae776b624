"""`denoc identify modal` and `model` on many recordings: one row each, in one table."""

from __future__ import annotations

import glob
import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from denoc_ros.bags.reader import BAG_FOLDER
from denoc_ros.cli.many_runs import FAILURE, RowStore, WorkerConfig, run_batch
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.cli.verbs import BAD_INPUT, DOUBTFUL
from denoc_ros.errors import BagError
from denoc_ros.simulation.recorded.run_files import SESSION_FILE
from denoc_ros.text_table import Row, text_table

RECORDINGS = ('.mcap', '.db3', '.csv', '.tsv', '.dat', '.mat', '.json')
# Files beside the bag of a session: settings and results, no signals.
NO_RECORDINGS = (SESSION_FILE, 'summary.json', 'configuration.yaml')


@dataclass(frozen=True)
class RowKind:
    """Content of a recording's row, beside its file, verdict, reasons and processor time."""

    # importable by name; of an item (options, path) the row
    task: Callable[[tuple[Any, Path]], Row]
    own: Mapping[str, type]  # columns, as of a `RowStore`
    shown: Callable[[Row], Row]  # of a row the cells of its line on a terminal
    depends: str = ''  # what else rows depend on: others are worked out anew

    @property
    def columns(self) -> dict[str, type]:
        """Columns of a `RowStore`."""
        end: dict[str, type] = {'reasons': str, 'processor_s': float}
        return {'file': str, 'verdict': str, **self.own, **end}


def rows_result(
    kind: RowKind,
    options: Any,
    paths: Sequence[Path],
    output: Path | None,
    workers: WorkerConfig,
    progress: bool,
) -> VerbResult:
    """Identify each recording; exit status 0 all good, 2 some not, 1 none could be read."""
    rows = identify_all(kind, options, paths, workers, output, progress)
    good = [row for row in rows if not row[FAILURE]]
    told = [
        {'file': Path(row['file']).name, 'verdict': row['verdict'], **kind.shown(row)}
        for row in good
    ]
    lines = [text_table(told)] if good else []
    lines += [f'  skipped: {row[FAILURE]}' for row in rows if row[FAILURE]]
    lines.append(f'{len(good)} of {len(rows)} recordings {f"in {output}" if output else ""}')
    document = {'output': str(output or ''), 'rows': rows}
    if not good:
        note = f'denoc identify: none of {len(rows)} recordings could be read'
        return VerbResult(document, lines, BAD_INPUT, [note])
    all_good = all(row.get('verdict') == 'good' for row in rows)
    return VerbResult(document, lines, 0 if all_good else DOUBTFUL)


def identify_all(
    kind: RowKind,
    options: Any,
    paths: Sequence[Path],
    workers: WorkerConfig,
    output: Path | None = None,
    progress: bool = False,
) -> list[Row]:
    """Return a row for each recording, as `denoc_ros.cli.many_runs.run_batch` does.

    Parameters
    ----------
    paths : sequence of Path
        The recordings; the workers must see them under the same paths.
    """
    asked = hashlib.sha256(f'{options!r}{kind.depends}'.encode()).hexdigest()[:12]
    store = RowStore(output, kind.columns) if output else None
    items = {f'{asked}/{_state_of(path)}': (kind.task, options, path.resolve()) for path in paths}
    return run_batch(timed_row, items, store, workers, 'recordings', progress)


def timed_row(item: tuple[Callable[[tuple[Any, Path]], Row], Any, Path]) -> Row:
    """Return one recording's row, with its file and the processor time that it took."""
    task, options, path = item
    began = time.thread_time()
    row = task((options, path))
    return {'file': str(path), **row, 'processor_s': time.thread_time() - began}


def _state_of(path: Path) -> str:
    """Return a recording's path, size and time of change: a changed one is another."""
    try:
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        state = [(file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    except OSError:
        state = []
    digest = hashlib.sha256(repr(state).encode()).hexdigest()[:12]
    return f'{path.resolve()}/{digest}'


def recordings(names: Sequence[str]) -> list[Path]:
    """Return the recordings that match paths, folders and patterns, each once.

    The folder of a session stands for its bag.

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
        paths = [_bag_of_run(path) for path in paths if path.name not in NO_RECORDINGS]
        if not paths:
            raise BagError(f'{name}: path must be that of a bag, or of some, got none there')
        found |= dict.fromkeys(paths)
    return list(found)


def _is_run(path: Path) -> bool:
    return (path / SESSION_FILE).is_file() and (path / BAG_FOLDER).exists()


def _bag_of_run(path: Path) -> Path:
    """Return the bag of a session's folder, any other path as it is."""
    return path / BAG_FOLDER if _is_run(path) else path


def _is_bag_folder(folder: Path) -> bool:
    if _is_run(folder):
        return True
    files = [file for file in folder.iterdir() if file.suffix in ('.mcap', '.db3')]
    return (folder / 'metadata.yaml').is_file() or len(files) == 1


def _inside(folder: Path) -> list[Path]:
    """Return the bags below a folder: bag folders as such, and tables."""
    found: dict[Path, None] = {}
    for file in folder.rglob('*'):
        if file.suffix in RECORDINGS and file.name not in NO_RECORDINGS and file.is_file():
            is_part = (file.parent / 'metadata.yaml').is_file()
            found[file.parent if is_part else file] = None
    return list(found)
