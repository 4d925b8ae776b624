"""Many independent runs of one function: here, on local workers, or on a Dask cluster."""

from __future__ import annotations

import argparse
import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tqdm import tqdm

from denoc_ros.cli.arguments import add_settings, settings_of
from denoc_ros.cli.interrupts import deferred_interrupts, is_made_by_interrupt, noted_interrupts
from denoc_ros.errors import ConfigError, DenocError
from denoc_ros.runtime.loop.realtime import SINGLE_THREADED
from denoc_ros.settings import setting
from denoc_ros.text_table import Row

Task = Callable[[Any], Row]

STORE_EVERY = 5.0  # s between two files of rows: what an interruption loses at most
KEY, FAILURE = 'key', 'failure'
# of Dask's own: sampling of stacks, and memory given back after every small array
LEAN = {
    'distributed.worker.profile.enabled': False,
    'distributed.nanny.pre-spawn-environ': {'MALLOC_TRIM_THRESHOLD_': 1 << 28},
}


@dataclass(frozen=True)
class WorkerConfig:
    """Who does the work."""

    workers: int = setting(
        0, 'number of processes of a local Dask cluster; 0: this process alone', '', 0
    )
    scheduler: str = setting(
        '', 'address of a Dask scheduler, such as tcp://head:8786, whose workers do the work'
    )


class RowStore:
    """Rows in a folder of Parquet files, each written once and whole.

    Parameters
    ----------
    folder : Path
        Made when the first rows are written; rows that are there already count as done.
    columns : mapping
        Name -> float, int, str, or list for several floats. `key` and `failure` are added.

    Raises
    ------
    ConfigError
        When the optional pyarrow is not installed, or the folder holds rows of other columns.
    """

    def __init__(self, folder: Path, columns: Mapping[str, type]) -> None:
        self.folder = folder
        self._arrow = _required('pyarrow')
        types = {float: 'float64', int: 'int64', str: 'string'}
        several = self._arrow.list_(self._arrow.float64())
        self._schema = self._arrow.schema(
            [
                (name, several if kind is list else types[kind])
                for name, kind in {KEY: str, FAILURE: str, **columns}.items()
            ]
        )
        self._waiting: list[Row] = []
        self._stored = time.monotonic()

    def rows(self) -> list[Row]:
        """Return all rows written so far, in the order of writing."""
        parquet = _required('pyarrow.parquet')
        rows: list[Row] = []
        for file in sorted(self.folder.glob('rows-*.parquet')):
            table = parquet.read_table(file)
            if table.schema != self._schema:
                raise ConfigError(
                    str(file),
                    [
                        f'columns must be {", ".join(self._schema.names)}, '
                        f'got {", ".join(table.schema.names)}'
                    ],
                )
            rows += table.to_pylist()
        return rows

    def append(self, row: Row) -> None:
        """Take in a row; it is on the disk after `STORE_EVERY` s or `close`."""
        self._waiting.append(row)
        if time.monotonic() - self._stored > STORE_EVERY:
            self.flush()

    def flush(self) -> None:
        """Write the rows that wait."""
        if self._waiting:
            self.folder.mkdir(parents=True, exist_ok=True)
            number = len(list(self.folder.glob('rows-*.parquet')))
            final = self.folder / f'rows-{number:06d}.parquet'
            partial_file = final.with_suffix('.part')
            table = self._arrow.Table.from_pylist(self._waiting, schema=self._schema)
            _required('pyarrow.parquet').write_table(table, partial_file)
            partial_file.rename(final)
        self._waiting = []
        self._stored = time.monotonic()

    def close(self) -> None:
        """Write the waiting rows."""
        self.flush()


def add_worker_options(parser: Any) -> None:
    """Declare --workers and --scheduler."""
    add_settings(parser, WorkerConfig, '--workers N', '--scheduler ADDRESS')


def worker_config(args: argparse.Namespace) -> WorkerConfig:
    """Configuration by --workers and --scheduler; ConfigError where they contradict."""
    if args.workers and args.scheduler:
        raise ConfigError('--workers', ['it must not come with --scheduler, got both'])
    return settings_of(WorkerConfig, args)


def run_batch(
    task: Task,
    items: Mapping[str, Any],
    store: RowStore | None,
    workers: WorkerConfig,
    label: str = '',
    progress: bool = True,
) -> list[Row]:
    """Run a task over items and return a row for each, in the items' order.

    Parameters
    ----------
    task : callable
        Importable by name on the workers; takes an item, returns a row.
    items : mapping
        Key -> item. Keys whose rows the store has already are not run again.
    store : RowStore or None
        Takes the rows as they come; failures are not stored, so that they are tried again.

    Raises
    ------
    ConfigError
        When Dask is needed and not installed, or the scheduler does not answer.
    """
    stored = store.rows() if store else []
    done = {row[KEY]: row for row in stored if row[KEY] in items}
    todo = [(key, item) for key, item in items.items() if key not in done]
    guarded = partial(_guarded, task)
    with (
        closing(store) if store else nullcontext(),
        tqdm(
            total=len(items),
            initial=len(done),
            desc=label,
            disable=None if progress else True,
            leave=False,
        ) as bar,
    ):
        for row in _rows(guarded, todo, workers):
            done[row[KEY]] = row
            if store and not row[FAILURE]:
                store.append(row)
            bar.update()
    return [done[key] for key in items]


def _guarded(task: Task, keyed: tuple[str, Any]) -> Row:
    """Return a task's row; whatever stops one item must not stop the others."""
    key, item = keyed
    try:
        return {KEY: key, FAILURE: '', **task(item)}
    except (DenocError, OSError) as error:
        return {KEY: key, FAILURE: str(error)}
    except Exception as error:
        if is_made_by_interrupt(error):
            raise
        return {KEY: key, FAILURE: f'{type(error).__name__}: {error}'}


def _rows(
    guarded: Callable[[tuple[str, Any]], Row],
    todo: Sequence[tuple[str, Any]],
    workers: WorkerConfig,
) -> Iterator[Row]:
    if not todo:
        return
    if not (workers.workers or workers.scheduler):
        yield from map(guarded, todo)
        return
    with _client(workers, len(todo)) as client:
        futures = client.map(guarded, todo, pure=False)
        for _, row in _required('distributed').as_completed(futures, with_results=True):
            yield row


@contextmanager
def _client(workers: WorkerConfig, tasks: int) -> Iterator[Any]:
    distributed = _required('distributed')
    if workers.scheduler:
        try:
            client = distributed.Client(workers.scheduler, timeout='10s')
        except (OSError, ValueError) as error:
            raise ConfigError(
                '--scheduler',
                [f'a Dask scheduler must answer at {workers.scheduler}, got: {error}'],
            ) from error
        with closing(client):
            yield client
        return
    # Dask would take a folder in the temporary one that another user has made, and import from it
    with (
        TemporaryDirectory(prefix='denoc-', ignore_cleanup_errors=True) as own,
        _required('dask').config.set({**LEAN, 'temporary-directory': own}),
        ExitStack() as stack,
    ):
        # Ctrl-C is for this process, which ends the others in order
        with deferred_interrupts():
            cluster = stack.enter_context(
                distributed.LocalCluster(
                    n_workers=min(workers.workers, tasks),
                    threads_per_worker=1,
                    dashboard_address=None,
                    silence_logs=logging.CRITICAL,
                    env=SINGLE_THREADED,
                    local_directory=own,
                )
            )
            client = stack.enter_context(closing(distributed.Client(cluster)))
        yield client


def _required(module: str) -> Any:
    try:
        with noted_interrupts():
            return import_module(module)
    except ImportError as error:
        raise ConfigError(
            'denoc_ros[cluster]',
            [
                f'{module.partition(".")[0]} must be installed for whole folders and clusters: '
                "pip install 'denoc_ros[cluster]'"
            ],
        ) from error
