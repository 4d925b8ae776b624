"""Columns out of tables: CSV, MATLAB files, JSON."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from denoc_ros.errors import BagError

Floats = NDArray[np.float64]

DELIMITERS = ',;\t '


def read_table(path: Path) -> dict[str, Floats]:
    """Return the columns of a file of numbers by name, each (k,).

    Parameters
    ----------
    path : Path
        `.csv` (with a row of names, else columns 0, 1, …), `.mat` (up to version 7.2: variables,
        those of several columns as `name[0]`, `name[1]`, …) or `.json` (a list of objects
        somewhere in it, or lists of numbers by name). What is no column of numbers is left out.

    Raises
    ------
    BagError
        When it cannot be read, or holds no column of numbers.
    """
    try:
        reader = READERS[path.suffix.lower()]
    except KeyError:
        raise BagError(f'{path}: table must be one of {", ".join(READERS)}') from None
    try:
        columns = reader(path)
    except OSError:
        raise
    except Exception as error:  # scipy's reader of damaged files ends in nearly every kind
        reason = str(error) or type(error).__name__
        raise BagError(f'{path}: table must be readable, got: {reason}') from error
    if not columns:
        raise BagError(f'{path}: table must have a column of numbers, got none')
    return columns


def _read_csv(path: Path) -> dict[str, Floats]:
    text = path.read_text(encoding='utf-8-sig')
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith('#')]
    if not lines:
        return {}
    delimiter = max(DELIMITERS, key=lines[-1].count)
    rows = list(csv.reader(lines, delimiter=delimiter, skipinitialspace=True))
    first = [_number(cell) for cell in rows[0]]
    named = None in first
    names = [cell.strip() for cell in rows[0]] if named else [str(k) for k in range(len(first))]
    body = [row for row in rows[named:] if len(row) == len(names)]
    columns = {}
    for k, name in enumerate(names):
        numbers = [_number(row[k]) for row in body]
        if any(number is not None for number in numbers):
            columns[name] = np.array([np.nan if n is None else n for n in numbers])
    return columns


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def _read_mat(path: Path) -> dict[str, Floats]:
    from scipy.io import loadmat

    columns: dict[str, Floats] = {}
    for name, value in loadmat(path).items():
        if name.startswith('__') or value.dtype.kind not in 'fiub' or value.ndim != 2:
            continue
        if 1 in value.shape:
            columns[name] = value.ravel().astype(np.float64)
        else:
            columns |= {
                f'{name}[{k}]': column.astype(np.float64) for k, column in enumerate(value.T)
            }
    return columns


def _read_json(path: Path) -> dict[str, Floats]:
    columns: dict[str, Floats] = {}
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


def _add(columns: dict[str, Floats], name: str, values: list[Any]) -> None:
    if all(isinstance(value, (int, float)) for value in values):
        columns[name] = np.array(values, dtype=np.float64)


READERS: dict[str, Callable[[Path], dict[str, Floats]]] = {
    '.csv': _read_csv,
    '.mat': _read_mat,
    '.json': _read_json,
}
