"""Batches: a row for every item, whoever works; what is done is not done again."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import pytest

from denoc_ros.cli.many_runs import FAILURE, KEY, RowStore, WorkerConfig, run_batch
from denoc_ros.errors import ConfigError
from denoc_ros.text_table import Row

COLUMNS = {'x': float, 'name': str, 'several': list}
ITEMS: dict[str, object] = {
    'a': {'x': 1.0, 'name': 'one', 'several': [1.0, 2.0]},
    'b': 3,  # dict(3) is an error: a bad item
    'c': {'x': 2.5, 'name': 'two', 'several': []},
}


def failing(item: object) -> dict[str, object]:
    raise AssertionError(f'{item} was to be left alone')


@pytest.mark.long_cases('2')
@pytest.mark.parametrize('workers', [0, 2])
def test_every_item_has_a_row_and_bad_ones_say_why(tmp_path: Path, workers: int) -> None:
    store = RowStore(tmp_path / 'rows', COLUMNS)
    rows = run_batch(dict, ITEMS, store, WorkerConfig(workers), progress=False)
    assert [row[KEY] for row in rows] == list(ITEMS)
    assert rows[1][FAILURE] == "TypeError: 'int' object is not iterable"
    good = [rows[0], rows[2]]
    assert good == [{KEY: key, FAILURE: '', **dict(ITEMS[key])} for key in 'ac']  # type: ignore[call-overload]
    stored = RowStore(tmp_path / 'rows', COLUMNS).rows()
    assert sorted(stored, key=lambda row: str(row[KEY])) == good


class Watched(RowStore):
    """A store that keeps where this process imports from while rows come."""

    def append(self, row: Row) -> None:
        self.paths = list(sys.path)
        super().append(row)


@pytest.mark.long
def test_nothing_is_imported_from_a_folder_that_others_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask puts its folder in the temporary one first among those of imports, whoever made it."""
    shared = tmp_path / 'tmp'
    planted = shared / 'dask-scratch-space'
    planted.mkdir(parents=True)
    for folder in (shared, planted):
        folder.chmod(0o777)
    monkeypatch.setenv('TMPDIR', str(shared))
    monkeypatch.setattr(tempfile, 'tempdir', None)
    store = Watched(tmp_path / 'rows', {'paths': str})
    (row,) = run_batch(
        lambda _: {'paths': '\n'.join(sys.path)}, {'a': 0}, store, WorkerConfig(1), progress=False
    )
    for path in {*store.paths, *str(row['paths']).split('\n')}:
        assert not Path(path).is_relative_to(planted)
    assert not list(planted.iterdir())
    assert [path for path in shared.iterdir() if path != planted] == []


def test_what_is_stored_is_not_run_again_and_failures_are(tmp_path: Path) -> None:
    folder = tmp_path / 'rows'
    first = run_batch(dict, ITEMS, RowStore(folder, COLUMNS), WorkerConfig(), progress=False)
    mended = {**ITEMS, 'b': {'x': 0.0}}
    again = run_batch(failing, mended, RowStore(folder, COLUMNS), WorkerConfig(), progress=False)
    assert [again[0], again[2]] == [first[0], first[2]]
    assert 'was to be left alone' in again[1][FAILURE]
    last = run_batch(dict, mended, RowStore(folder, COLUMNS), WorkerConfig(), progress=False)
    assert last[1]['x'] == 0.0
    assert len(RowStore(folder, COLUMNS).rows()) == 3


def test_rows_of_other_columns_are_an_error(tmp_path: Path) -> None:
    run_batch(dict, ITEMS, RowStore(tmp_path, COLUMNS), WorkerConfig(), progress=False)
    with pytest.raises(ConfigError, match='columns must be key, failure, y, got key, failure, x'):
        RowStore(tmp_path, {'y': float}).rows()


def test_scheduler_that_does_not_answer_is_an_error() -> None:
    with pytest.raises(ConfigError, match='a Dask scheduler must answer at nowhere'):
        run_batch(dict, ITEMS, None, WorkerConfig(scheduler='nowhere'), progress=False)
