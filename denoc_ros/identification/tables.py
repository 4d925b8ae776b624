"""Columns out of tables: text, MATLAB files, JSON."""

from __future__ import annotations

import csv
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.errors import BagError
from denoc_ros.types import Array

DECIMAL_COMMA = re.compile(r'[+-]?\d*,\d+([eE][+-]?\d+)?')
MOST_COLUMNS = 1000
MOST_SIGNALS = 64  # rows of a text that may be signals, one in each
FEWEST_SAMPLES = 8


def read_table(path: Path) -> dict[str, Array]:
    """Return the columns of a file of numbers by name, each (k,).

    Parameters
    ----------
    path : Path
        `.mat` (up to version 7.2: variables, and fields of structs as `run.tip`; those of several
        columns as `name[0]`, `name[1]`, …), `.json` (a list of objects somewhere in it, or lists
        of numbers by name), or text of any other name: commas, semicolons, tabs or blanks, with a
        row of names or columns 0, 1, …; decimal commas beside semicolons or tabs. Signals that
        stand in rows are taken as columns. What is no column of numbers is left out.

    Raises
    ------
    BagError
        When it cannot be read, or holds no column of numbers.
    """
    reader = READERS.get(path.suffix.lower(), _read_text)
    try:
        columns = reader(path)
    except (OSError, BagError):
        raise
    except Exception as error:  # scipy's reader of damaged files ends in nearly every kind
        reason = str(error) or type(error).__name__
        raise BagError(f'{path}: table must be readable, got: {reason}') from error
    if not columns:
        raise BagError(f'{path}: table must have a column of numbers, got none')
    if len(columns) > MOST_COLUMNS:
        raise BagError(
            f'{path}: table must have at most {MOST_COLUMNS} columns, got {len(columns)}'
        )
    return columns


def _read_text(path: Path) -> dict[str, Array]:
    text = path.read_text(encoding='utf-8-sig')
    lines = [
        line for line in text.splitlines() if line.strip() and not line.startswith(('#', '%'))
    ]
    if not lines:
        return {}
    delimiter = _delimiter(lines[-1])
    rows = [_trimmed(row) for row in csv.reader(lines, delimiter=delimiter, skipinitialspace=True)]
    if delimiter in ';\t' and _has_decimal_commas(rows[-1]):
        rows = [[cell.replace(',', '.') for cell in row] for row in rows]
    if _signals_in_rows(rows):
        rows = [list(column) for column in zip(*rows, strict=True)]
    return _columns(rows)


def _delimiter(line: str) -> str:
    for delimiter in ';\t':
        if delimiter in line:
            return delimiter
    return max(', ', key=line.count)


def _trimmed(row: list[str]) -> list[str]:
    """Leave out the empty cell behind a delimiter at the end of a line."""
    return row[:-1] if len(row) > 1 and not row[-1].strip() else row


def _has_decimal_commas(row: list[str]) -> bool:
    cells = [cell.strip() for cell in row]
    return any(DECIMAL_COMMA.fullmatch(cell) for cell in cells) and not any(
        '.' in cell for cell in cells
    )


def _signals_in_rows(rows: list[list[str]]) -> bool:
    """Say whether each row is a signal, its name before it or not."""
    width = len(rows[0])
    if not len(rows) <= MOST_SIGNALS or width < max(2 * len(rows), FEWEST_SAMPLES):
        return False
    return all(len(row) == width and None not in map(_number, row[1:]) for row in rows)


def _columns(rows: list[list[str]]) -> dict[str, Array]:
    named = None in map(_number, rows[0])
    body = rows[named:]
    if not body:
        return {}
    width = Counter(map(len, body)).most_common(1)[0][0]
    if width > MOST_COLUMNS:
        return {str(k): np.zeros(0) for k in range(width)}  # refused by their number
    body = [row for row in body if len(row) == width]
    names = _names([cell.strip() for cell in rows[0]] if named else [], body, width)
    columns = {}
    for k, name in enumerate(names):
        numbers = [_number(row[k]) for row in body]
        if any(number is not None for number in numbers):
            columns[name] = np.array([np.nan if n is None else n for n in numbers])
    return columns


def _names(given: list[str], body: list[list[str]], width: int) -> list[str]:
    """Return a name per column: those without one are called by their number.

    Where one is missing and the first column counts the rows, it is the first's, as in tables
    that statistics programs write.
    """
    if len(given) == width - 1 and _counts([row[0] for row in body]):
        given = ['0', *given]
    names = [*given[:width], *(str(k) for k in range(len(given), width))]
    return [name or str(k) for k, name in enumerate(names)]


def _counts(cells: list[str]) -> bool:
    numbers = [_number(cell.strip('"')) for cell in cells]
    first = numbers[0]
    return first in (0.0, 1.0) and numbers == [first + k for k in range(len(numbers))]


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def _read_mat(path: Path) -> dict[str, Array]:
    from scipy.io import loadmat

    columns: dict[str, Array] = {}
    for name, value in loadmat(path, simplify_cells=True).items():
        if not name.startswith('__'):
            columns |= _mat_columns(name, value)
    return columns


def _mat_columns(name: str, value: Any) -> dict[str, Array]:
    """Return a variable's columns: a vector's, a matrix's, or those of a struct's fields."""
    if isinstance(value, dict):
        found: dict[str, Array] = {}
        for field, inner in value.items():
            found |= _mat_columns(f'{name}.{field}', inner)
        return found
    if isinstance(value, list) and value and all(isinstance(entry, dict) for entry in value):
        columns: dict[str, Array] = {}
        for field in value[0]:
            _add(columns, f'{name}.{field}', [entry.get(field) for entry in value])
        return columns
    array = np.atleast_1d(np.asarray(value))
    if array.dtype.kind not in 'fiub' or array.ndim > 2 or array.size == 0:
        return {}
    if array.ndim == 1 or 1 in array.shape:
        return {name: array.ravel().astype(np.float64)}
    # signals are longer than there are of them
    longer = array.T if array.shape[0] < array.shape[1] else array
    return {f'{name}[{k}]': column.astype(np.float64) for k, column in enumerate(longer.T)}


def _read_json(path: Path) -> dict[str, Array]:
    columns: dict[str, Array] = {}
    for name, values in _lists(json.loads(path.read_text(encoding='utf-8')), ''):
        if all(isinstance(entry, dict) for entry in values):
            for key in values[0]:
                _add(columns, key, [entry.get(key) for entry in values])
        else:
            _add(columns, name, values)
    return columns


def _lists(value: Any, name: str) -> Iterator[tuple[str, list[Any]]]:
    if isinstance(value, list) and value:
        yield name, value
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield from _lists(inner, key)


def _add(columns: dict[str, Array], name: str, values: list[Any]) -> None:
    if all(isinstance(value, (int, float)) for value in values):
        columns[name] = np.array(values, dtype=np.float64)


READERS: dict[str, Callable[[Path], dict[str, Array]]] = {
    '.csv': _read_text,
    '.tsv': _read_text,
    '.txt': _read_text,
    '.dat': _read_text,
    '.mat': _read_mat,
    '.json': _read_json,
}
