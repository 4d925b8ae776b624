"""Columns out of tables: text, spreadsheets, MATLAB files, JSON; and their times."""

from __future__ import annotations

import csv
import json
import re
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, time
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.bags.file_kinds import other_kind
from denoc_ros.bags.reader import BAG_SUFFIXES
from denoc_ros.child_arrays import child_arrays
from denoc_ros.decompression import inflated_size, require_bounded_archive
from denoc_ros.errors import BagError
from denoc_ros.identification.tables.time_columns import is_time, seconds_of
from denoc_ros.types import Array

DECIMAL_COMMA = re.compile(r'[+-]?\d*,\d+([eE][+-]?\d+)?')
DECIMAL_POINT = re.compile(r'[+-]?\d*\.\d+([eE][+-]?\d+)?')
BRACKETED = re.compile(r'[\[(][^\])]*[\])]')
UNITS_OF_COLUMNS = re.compile(
    r's|secs?|seconds?|m?sec|[mnuµμ]s|min|h|k?hz|[mckuµμ]?m|in|ft|m?rad|deg|°|k?g|[mk]?n|'
    r'n[·*. ]?m|[muµμ]?v|m?a|w|[km]?pa|bar|%|-|1|m?m/s|m?m/s(\^?2|²)|(rad|deg|°)/s((\^?2|²))?|'
    r'[uµμ]?strain|[uµμ]m/m|°c|counts|lsb'
)
COMMENT = ('#', '%')
BEHIND = re.compile(r'\s#\s.*')  # a comment behind the cells
DELIMITERS = ';\t|, '
MOST_COLUMNS = 1000
MOST_SIGNALS = 64  # rows of a text that may be signals, one in each
FEWEST_SAMPLES = 8
LOOKED_AT = 40  # lines that say how all are separated, and which cells are numbers
MOST_WORDS = 3  # of a column's name in a comment
LARGEST = 256 << 20  # bytes of a spreadsheet or .mat file, unpacked
CELL_BYTES = 8  # that a cell of a spreadsheet takes in memory, at least
MAT_HEADER, MAT_COMPRESSED = 128, 15  # bytes; type of an element
END_OF_HEADER = '***End_of_Header***'  # of LabVIEW's measurement files


class Table(dict[str, Array]):
    """Columns of numbers by name, each (k,).

    Attributes
    ----------
    units : dict of str to str
        By column, where there is a row of units.
    unread : dict of str to int
        Cells of each column that are neither empty nor a number.
    left_out : int
        Rows that are not in the columns: they have another number of cells.
    time : str
        The column of times, where the file says so by other means than its name.
    step : float
        Time between the rows by the head of the file [s]; 0 where it does not say.
    """

    def __init__(
        self,
        columns: dict[str, Array],
        units: dict[str, str] | None = None,
        unread: dict[str, int] | None = None,
        left_out: int = 0,
        time: str = '',
        step: float = 0.0,
    ) -> None:
        super().__init__(columns)
        self.units = dict(units or {})
        self.unread = dict(unread or {})
        self.left_out, self.time, self.step = left_out, time, step

    def is_time(self, name: str) -> bool:
        """Say whether a column has times, by what the file says or by its name."""
        return name == self.time or is_time(name)


@dataclass(frozen=True)
class Sheet:
    """Cells of a table."""

    # of its columns; [] where there is no such row
    names: list[str]
    units: list[str]
    # number of the line, and cells, from the first row of numbers on
    rows: list[tuple[int, list[str]]]
    commas: bool = False  # numbers have decimal commas
    width: int = 0  # cells of most rows
    time: str = ''  # column of times, where the head says so
    step: float = 0.0  # time between the rows by the head [s]

    def number(self, cell: str) -> float | None:
        """Return the number or the time [s] in a cell, None where it is neither."""
        return _number(cell.replace(',', '.') if self.commas else cell)


def read_table(path: Path) -> Table:
    """Return the columns of a file of numbers by name.

    Parameters
    ----------
    path : Path
        `.mat` (up to version 7.2: variables, and fields of structs as `run.tip`; those of several
        columns as `name[0]`, `name[1]`, …), `.json` (a list of objects somewhere in it, or lists
        of numbers by name), `.xlsx` (its first sheet with numbers), or text of any other name:
        commas, semicolons, tabs, bars or blanks, with a row of names, also in a comment and below
        titles, or columns 0, 1, …; a row of units below the names; decimal commas; dates and
        times of day, which become seconds. Signals that stand in rows are taken as columns. What
        is no column of numbers is left out; of names that repeat, the second gets `_2`.

    Raises
    ------
    BagError
        When it cannot be read, or holds no column of numbers.
    """
    reader = READERS.get(path.suffix.lower(), _read_text)
    try:
        table = reader(path)
    except (OSError, BagError):
        raise
    except Exception as error:  # scipy's reader of damaged files ends in nearly every kind
        reason = str(error) or type(error).__name__
        raise BagError(f'{path}: table must be readable, got: {reason}') from error
    if not table:
        raise BagError(f'{path}: table must have a column of numbers, got none')
    if len(table) > MOST_COLUMNS:
        raise BagError(f'{path}: table must have at most {MOST_COLUMNS} columns, got {len(table)}')
    return table


def read_sheet(path: Path) -> Sheet:
    """Return the cells of a text or a spreadsheet; errors as `read_table`."""
    if kind := other_kind(path):
        raise BagError(f'{path}: table must be text, .xlsx, .mat or .json, got {kind}')
    raw = path.read_bytes()
    if raw.startswith(b'PK\x03\x04') or path.suffix.lower() in SPREADSHEETS:
        return _read_workbook(path)
    return _text_sheet(_decoded(path, raw))


def _decoded(path: Path, raw: bytes) -> str:
    if raw.startswith((b'\xff\xfe', b'\xfe\xff')):
        return raw.decode('utf-16')
    if b'\0' in raw:
        raise BagError(f'{path}: table must be text, .xlsx, .mat or .json, got bytes of no text')
    try:
        return raw.decode('utf-8-sig')
    except UnicodeDecodeError:
        return raw.decode('cp1252', errors='replace')  # units such as ° and µ of older programs


def _read_text(path: Path) -> Table:
    return _columns(read_sheet(path))


def _text_sheet(text: str) -> Sheet:
    numbered = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
    plain = [line for _, line in numbered if not line.lstrip().startswith(COMMENT)]
    delimiter = _delimiter(plain[-LOOKED_AT:])
    lines = []
    for number, line in numbered:
        is_comment = line.lstrip().startswith(COMMENT)
        cells = line.lstrip().lstrip('#%').strip() if is_comment else BEHIND.sub('', line)
        lines.append((number, is_comment, cells))
    cells_of = _split([cells for _, _, cells in lines], delimiter)
    width = _usual_width(
        [cells for (_, c, _), cells in zip(lines, cells_of, strict=True) if not c]
    )
    widest = [cells for cells in cells_of if len(cells) == width]
    # A delimiter ends each line, or the last cell of some lines is empty.
    all_end = not any(cells[-1] for cells in widest)
    rows = [
        (number, is_comment, _trimmed(cells) if all_end or len(cells) > width else cells)
        for (number, is_comment, _), cells in zip(lines, cells_of, strict=True)
    ]
    return _sheet(rows, delimiter)


def _split(lines: list[str], delimiter: str) -> list[list[str]]:
    """Return the cells of each line; a quotation mark that is never closed is a character."""
    for quoting in (csv.QUOTE_MINIMAL, csv.QUOTE_NONE):
        reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True, quoting=quoting)
        rows = [[cell.strip() for cell in row] for row in reader]
        if len(rows) == len(lines):
            return rows
    return rows


def _delimiter(lines: Sequence[str]) -> str:
    """Delimiter that separates the most numeric cells in rows of one width."""
    best, chosen = 0.0, ','
    for delimiter in DELIMITERS:
        rows = [_trimmed(row) for row in _split([BEHIND.sub('', li) for li in lines], delimiter)]
        width = _usual_width(rows)
        if width < 2:
            continue
        cells = [cell for row in rows if len(row) == width for cell in row]
        told = [c for c in cells if _number(c.replace(',', '.')) is not None]
        score = len(told) / max(sum(bool(cell) for row in rows for cell in row), 1)
        if score > best + 1e-9:
            best, chosen = score, delimiter
    return chosen


def _usual_width(rows: Sequence[Sequence[str]]) -> int:
    return Counter(map(len, rows)).most_common(1)[0][0] if rows else 0


def _trimmed(row: list[str]) -> list[str]:
    return row[:-1] if len(row) > 1 and not row[-1].strip() else row


def _has_decimal_commas(rows: Sequence[Sequence[str]]) -> bool:
    cells = [cell for row in rows for cell in row]
    return any(DECIMAL_COMMA.fullmatch(cell) for cell in cells) and not any(
        DECIMAL_POINT.fullmatch(cell) for cell in cells
    )


def _sheet(rows: list[tuple[int, bool, list[str]]], delimiter: str) -> Sheet:
    """Return the cells of rows (number, whether a comment, cells): names, units, the rest."""
    body = [(number, cells) for number, is_comment, cells in rows if not is_comment]
    if not body:
        return Sheet([], [], [])
    last = [cells for _, cells in body[-LOOKED_AT:]]
    commas = _has_decimal_commas(last)
    if delimiter != ' ' and _signals_in_rows([cells for _, cells in body], commas):
        body = list(enumerate(map(list, zip(*(cells for _, cells in body), strict=True))))
        if _is_text(body[0][1]):
            return Sheet(body[0][1], [], body[1:], commas)
        return Sheet([], [], body, commas)
    blank = Sheet([], [], [], commas)
    width = _usual_width([cells for _, cells in body])
    of_width = [cells for cells in last if len(cells) == width]
    shares = [
        np.mean([blank.number(row[k]) is not None for row in of_width]) for k in range(width)
    ]
    numeric = [k for k, share in enumerate(shares) if share > 0.5]
    if not numeric:
        return Sheet([], [], [])
    unused = _unused(of_width)
    first = next(
        (
            n
            for n, cells in body
            if len(cells) == width
            and _has_numbers(blank, cells, numeric)
            and not any(cells[k] for k in unused)
        ),
        body[-1][0],
    )
    data = [(number, cells) for number, cells in body if number >= first]
    counted = _counts([cells[0] for _, cells in data if len(cells) == width])
    above = [row for row in rows if row[0] < first]
    names, units = _heading(above, width, counted, delimiter)
    if all(cells[0] != END_OF_HEADER for _, _, cells in above):
        return Sheet(names, units, data, commas, width)
    told = {cells[0]: cells[1] for _, _, cells in above if len(cells) > 1}
    is_time = told.get('X_Dimension', 'Time') == 'Time'
    step = (blank.number(told.get('Delta_X', '')) or 0.0) if is_time else 0.0
    time = 'X_Value' if is_time and 0 not in unused else ''
    return Sheet(names, units, data, commas, width, time, step)


def _unused(rows: Sequence[Sequence[str]]) -> list[int]:
    """Return the columns that are empty in rows: a row with a cell there is none of the data."""
    return [k for k in range(len(rows[0]) if rows else 0) if not any(row[k] for row in rows)]


def _is_text(cells: Sequence[str]) -> bool:
    return any(cell and _number(cell) is None for cell in cells)


def _has_numbers(sheet: Sheet, cells: Sequence[str], numeric: Sequence[int]) -> bool:
    """Say whether more than half of the columns of numbers have one in a row."""
    told = [k for k in numeric if sheet.number(cells[k]) is not None]
    return 2 * len(told) > len([k for k in numeric if cells[k]])


def _heading(
    above: list[tuple[int, bool, list[str]]], width: int, counted: bool, delimiter: str
) -> tuple[list[str], list[str]]:
    """Return the names and units of columns in the lines above the first row of numbers."""
    known = [
        cells
        for _, is_comment, cells in above
        if _are_names(cells, width, counted) and (not is_comment or _in_comment(cells, delimiter))
    ]
    if not known:
        return [], []
    units: list[str] = []
    if len(known) > 1 and _are_units(known[-1]) and len(known[-1]) == len(known[-2]):
        units = known.pop()
    names = known[-1]
    if len(names) == width - 1 and counted:
        # of statistics programs: the first column counts the rows and has no name
        return ['0', *names], ['', *units] if units else []
    return names, units


def _are_names(cells: list[str], width: int, counted: bool) -> bool:
    """Say whether cells can be the names of columns: not a title, not numbers."""
    if all(not cell or _number(cell) is not None for cell in cells):
        return False
    if len(cells) >= width or any(is_time(cell) for cell in cells):
        return True
    return counted and len(cells) == width - 1 > 1


def _in_comment(cells: list[str], delimiter: str) -> bool:
    """Say whether the cells of a comment are names, not a sentence."""
    if any(is_time(cell) for cell in cells):
        return True
    return delimiter != ' ' and all(0 < len(cell.split()) <= MOST_WORDS for cell in cells)


def _are_units(cells: Sequence[str]) -> bool:
    return any(cells) and all(
        not cell or BRACKETED.fullmatch(cell) or UNITS_OF_COLUMNS.fullmatch(cell.lower())
        for cell in cells
    )


def _signals_in_rows(rows: list[list[str]], commas: bool) -> bool:
    """Say whether each row is a signal, its name before it or not."""
    width = len(rows[0])
    if not len(rows) <= MOST_SIGNALS or width < max(2 * len(rows), FEWEST_SAMPLES):
        return False
    number = Sheet([], [], [], commas).number
    return all(len(row) == width and None not in map(number, row[1:]) for row in rows)


def _columns(sheet: Sheet) -> Table:
    body = [cells for _, cells in sheet.rows]
    width = sheet.width or _usual_width(body)
    if width > MOST_COLUMNS:
        return Table({str(k): np.zeros(0) for k in range(width)})  # refused by their number
    whole = [row for row in body if len(row) == width]
    unused = _unused(whole[-LOOKED_AT:])
    whole = [row for row in whole if not any(row[k] for k in unused)]
    columns, units, unread = {}, {}, {}
    names = _unlike([*sheet.names[:width], *map(str, range(len(sheet.names), width))])
    for k, name in enumerate(names):
        numbers = [sheet.number(row[k]) for row in whole]
        if any(number is not None for number in numbers):
            columns[name] = np.array([np.nan if n is None else n for n in numbers])
            unread[name] = sum(
                n is None and bool(row[k]) for n, row in zip(numbers, whole, strict=True)
            )
            if k < len(sheet.units):
                units[name] = sheet.units[k].strip('[]() ')
    time = sheet.time if sheet.time in columns else ''
    return Table(columns, units, unread, len(body) - len(whole), time, sheet.step)


def _unlike(names: Sequence[str]) -> list[str]:
    """Return names of columns: their number for none, `_2`, `_3`, … behind those that repeat."""
    found: list[str] = []
    for k, name in enumerate(names):
        known, count = name or str(k), 1
        while known in found:
            count += 1
            known = f'{name or k}_{count}'
        found.append(known)
    return found


def _counts(cells: list[str]) -> bool:
    numbers = [_number(cell.strip('"')) for cell in cells]
    first = numbers[0] if numbers else None
    return first in (0.0, 1.0) and numbers == [first + k for k in range(len(numbers))]


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return seconds_of(cell)


def _read_workbook(path: Path) -> Sheet:
    """Return the first sheet of a workbook that has numbers."""
    try:
        import openpyxl
    except ImportError as error:
        raise BagError(
            f'{path}: a spreadsheet must be read by openpyxl (pip install openpyxl, or '
            "'denoc_ros[tables]'), got none: install it, or save the sheet as .csv"
        ) from error
    try:
        require_bounded_archive(path, LARGEST)
    except ValueError as error:
        raise BagError(_too_large(path, str(error))) from error
    book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    try:
        for one in book.worksheets:
            # The declared size of a sheet is not that of its contents.
            one.reset_dimensions()
            rows = list(_bounded_rows(path, one.values))
            sheet = _sheet(_without_margins(rows), ';')
            if sheet.rows:
                return sheet
    finally:
        book.close()
    return Sheet([], [], [])


def _bounded_rows(path: Path, values: Iterable[Sequence[Any]]) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each row; a cell far right fills its row with empty ones."""
    left = LARGEST // CELL_BYTES
    for number, row in enumerate(values, 1):
        left -= len(row) + 1
        if left < 0:
            raise BagError(_too_large(path, f'{LARGEST // CELL_BYTES} cells or more'))
        yield number, list(map(_cell, row))


def _without_margins(rows: list[tuple[int, list[str]]]) -> list[tuple[int, bool, list[str]]]:
    """Leave out empty rows, the columns that are empty, and the cells behind a row's last."""
    width = max((len(cells) for _, cells in rows), default=0)
    used = [k for k in range(width) if any(cells[k] for _, cells in rows if k < len(cells))]
    found = []
    for number, cells in rows:
        kept = [cells[k] if k < len(cells) else '' for k in used]
        if any(kept):
            is_title = not any(kept[1:]) and _number(kept[0]) is None
            found.append((number, False, kept[:1] if is_title else kept))
    return found


def _cell(value: Any) -> str:
    if value is None:
        return ''
    if isinstance(value, (datetime, time)):
        return value.isoformat()
    return str(value).strip()


def _read_mat(path: Path) -> Table:
    _require_small_mat(path)
    script = str(Path(__file__).with_name('mat_reader.py'))
    (found,) = child_arrays(script, [path])
    if isinstance(found, str):
        raise BagError(f'{path}: table must be readable, got: {found}')
    return Table(found)


def _require_small_mat(path: Path) -> None:
    """Raise BagError where the compressed variables of a .mat file would fill the memory."""
    left = LARGEST
    with path.open('rb') as file:
        order = {b'IM': '<', b'MI': '>'}.get(file.read(MAT_HEADER)[-2:])
        while order and len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f'{order}2I', tag)
            packed = file.read(size)
            if kind == MAT_COMPRESSED:
                left -= inflated_size([packed], left)
                if left < 0:
                    raise BagError(_too_large(path, 'more'))


def _too_large(path: Path, got: str) -> str:
    rule = f'table must unpack to at most {LARGEST >> 20} MiB'
    return f'{path}: {rule}, got {got}: save it as .csv'


def _read_json(path: Path) -> Table:
    columns: dict[str, Array] = {}
    text = path.read_text(encoding='utf-8')
    try:
        content = json.loads(text)
    except json.JSONDecodeError:
        content = [json.loads(line) for line in text.splitlines() if line.strip()]
    for name, values in _lists(content, ''):
        if all(isinstance(entry, dict) for entry in values):
            for key in values[0]:
                _add(columns, key, [entry.get(key) for entry in values])
        else:
            _add(columns, name, values)
    return Table(columns)


def _lists(value: Any, name: str) -> Iterator[tuple[str, list[Any]]]:
    if isinstance(value, list) and value:
        yield name, value
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield from _lists(inner, key)


def _add(columns: dict[str, Array], name: str, values: list[Any]) -> None:
    if all(isinstance(value, (int, float)) for value in values):
        columns[name] = np.array(values, dtype=np.float64)


def is_table(path: Path) -> bool:
    """Say whether a path is that of a table: a file that is no bag."""
    suffix = path.suffix.lower()
    return suffix in READERS or (not path.name.lower().endswith(BAG_SUFFIXES) and path.is_file())


SPREADSHEETS = ('.xlsx', '.xlsm')
READERS: dict[str, Callable[[Path], Table]] = {
    '.csv': _read_text,
    '.tsv': _read_text,
    '.txt': _read_text,
    '.dat': _read_text,
    **dict.fromkeys(SPREADSHEETS, _read_text),
    '.mat': _read_mat,
    '.json': _read_json,
    '.jsonl': _read_json,
    '.ndjson': _read_json,
}
