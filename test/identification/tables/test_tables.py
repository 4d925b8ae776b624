"""Tables of other programs: the same numbers come out, whatever stands around them."""

from __future__ import annotations

import sys
import zipfile
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import openpyxl
import pytest
from numpy.typing import NDArray
from scipy.io import savemat

from denoc_ros.cli.main import main
from denoc_ros.errors import BagError
from denoc_ros.identification.decay.channel import Channel, channels_of, read_record
from denoc_ros.identification.tables import tables
from denoc_ros.identification.tables.tables import read_table

T = np.asarray(np.arange(24) * 0.01, dtype=np.float64)
Y = np.asarray(np.cos(7.0 * T), dtype=np.float64)
ROWS = list(zip(T.tolist(), Y.tolist(), strict=True))
BEGIN = datetime(2024, 3, 1, 9, 59, 59, 900_000)


def lines(template: str, comma: bool = False) -> str:
    """Return one line per sample, its number, time and value filled in."""
    made = [
        template.format(k=k, t=t, y=y, ms=1e3 * t, us=1e6 * t, at=BEGIN + timedelta(seconds=t))
        for k, (t, y) in enumerate(ROWS)
    ]
    text = ''.join(f'{line}\n' for line in made)
    return text.replace('.', ',') if comma else text


TIMED = {
    'names in a comment': '%Time (ms)\tTip (mm)\n' + lines('{ms:.1f}\t{y:.9f}'),
    'names in a comment, commas': '# made by X\n# time,Tip (mm)\n' + lines('{t:.2f},{y:.9f}'),
    'names of rostopic': '%time,Tip (mm)\n' + lines('17000000{us:08.0f}000,{y:.9f}'),
    'one title': 'Beam test 7\ntime;Tip (mm)\n' + lines('{t:.2f};{y:.9f}'),
    'titles with commas': 'Beam, 5 kg, blue\nBy us, then\ntime,Tip (mm)\n'
    + lines('{t:.2f},{y:.9f}'),
    'titles with numbers': 'Test 5\nRate 100 Hz\n\nTime [s]\tTip (mm)\n'
    + lines('{t:.2f}\t{y:.9f}'),
    'titles of cells': 'Beam;test;\nGain;3,5;\ntime;Tip (mm)\n' + lines('{t:.2f};{y:.9f}', True),
    'units below': 'Beam test\nTime,Tip (mm)\nms,mm\n' + lines('{ms:.1f},{y:.9f}'),
    'units in brackets': 'Time;Tip (mm)\n[us];[mm]\n' + lines('{us:.0f};{y:.9f}'),
    'a text column': 'state,time,Tip (mm)\n' + lines('ok,{t:.2f},{y:.9f}'),
    'bars': 'time | Tip (mm)\n' + lines('{t:.2f} | {y:.9f}'),
    'blanks': 'time     "Tip (mm)"\n' + lines('  {t:.2f}   {y:.9f}  '),
    'blanks, decimal commas': 'time "Tip (mm)"\n' + lines('{t:.2f} {y:.9f}', True),
    'quoted decimal commas': '"time","Tip (mm)"\n'
    + lines('"{t:.2f}","{y:.9f}"').replace('.', ','),
    'dates': 'Zeit;Tip (mm)\n' + lines('{at:%Y-%m-%d %H:%M:%S.%f};{y:.9f}'),
    'dates of a zone': 'timestamp,Tip (mm)\n' + lines('{at:%Y-%m-%dT%H:%M:%S.%f}+01:00,{y:.9f}'),
    'a footer': 'time,Tip (mm)\n' + lines('{t:.2f},{y:.9f}') + 'end of file\n',
    'a quotation mark': '"Beam of 5 inch\ntime,Tip (mm)\n' + lines('{t:.2f},{y:.9f}'),
    'comments behind': 'time,Tip (mm)  # of the tip\n' + lines('{t:.2f},{y:.9f}'),
}
TIMED['since 1970'] = 'stamp,Tip (mm)\n' + ''.join(
    f'{1.7e12 + 1e3 * t:.1f},{y:.9f}\n' for t, y in ROWS
)
TIMED['days first'] = 'Datum;Zeit;Tip (mm)\n' + ''.join(
    f'01.03.2024;10:00:0{t:.3f};{y:.9f}\n'.replace('.', ',').replace('01,03,', '01.03.')
    for t, y in ROWS
)


@pytest.mark.parametrize('kind', TIMED)
@pytest.mark.parametrize('encoding', ['utf-8', 'utf-16', 'cp1252'])
def test_names_times_and_all_rows_are_found(tmp_path: Path, kind: str, encoding: str) -> None:
    path = tmp_path / 'record.csv'
    path.write_bytes(TIMED[kind].replace('\n', '\r\n').encode(encoding))
    record = read_record(path, Channel(field='Tip (mm)')).record
    np.testing.assert_allclose(record.t, T, atol=1e-6)
    np.testing.assert_allclose(record.y, Y, atol=1e-8)
    assert [one.field for one in channels_of(path)] == ['Tip (mm)']


def test_a_table_without_names_keeps_its_first_row(tmp_path: Path) -> None:
    path = tmp_path / 'record.txt'
    for template, field in (
        ('ok,{t:.2f},{y:.9f}', '2'),
        ('{t:.2f};left;{y:.9f}', '2'),
        ('{t:.2f} {y:.9f} run', '1'),
    ):
        for title in ('', 'Beam test\n'):
            path.write_text(title + lines(template))
            np.testing.assert_allclose(read_table(path)[field], Y, atol=1e-8)


def test_columns_of_one_name_are_both_there(tmp_path: Path) -> None:
    path = tmp_path / 'record.csv'
    path.write_text('time,y,y\n' + lines('{t:.2f},{y:.9f},1'))
    table = read_table(path)
    assert list(table) == ['time', 'y', 'y_2']
    np.testing.assert_allclose(table['y'], Y, atol=1e-8)


def book(path: Path, *rows: list[object]) -> None:
    workbook = openpyxl.Workbook()
    assert workbook.active is not None
    workbook.active.append(['nothing here'])
    sheet = workbook.create_sheet('data')
    for row in rows:
        sheet.append(row)
    workbook.save(path)


def test_a_spreadsheet_is_a_table(tmp_path: Path) -> None:
    path = tmp_path / 'record.xlsx'
    heads: list[list[object]] = [['Beam test'], [], [None, 'Time (ms)', 'Tip', 'note']]
    book(path, *heads, *([None, 1e3 * t, y, 'ok'] for t, y in ROWS))
    record = read_record(path, Channel(field='Tip')).record
    np.testing.assert_allclose(record.t, T, atol=1e-9)
    np.testing.assert_allclose(record.y, Y, rtol=1e-14)  # written with 16 digits
    book(path, ['Zeit', 'Tip'], *([BEGIN + timedelta(seconds=t), y] for t, y in ROWS))
    np.testing.assert_allclose(read_record(path, Channel(field='Tip')).record.t, T, atol=1e-3)


def test_a_small_file_of_a_large_table_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, 'LARGEST', 4 << 20)
    savemat(tmp_path / 'a.mat', {'t': T, 'y': np.zeros(3 << 17)}, do_compression=True)
    assert read_table(tmp_path / 'a.mat')['y'].size == 3 << 17
    savemat(tmp_path / 'b.mat', {'t': T, 'y': np.zeros(5 << 17)}, do_compression=True)
    assert (tmp_path / 'b.mat').stat().st_size < 100_000
    cells: list[object] = [0.0]
    book(tmp_path / 'b.xlsx', ['y'], *[cells] * 100)
    with zipfile.ZipFile(tmp_path / 'b.xlsx', 'a', zipfile.ZIP_DEFLATED) as archive:
        archive.writestr('xl/more.xml', bytes(5 << 20))
    for name in ('b.mat', 'b.xlsx'):
        with pytest.raises(BagError, match=f'{name}: table must unpack to at most 4 MiB, got'):
            read_table(tmp_path / name)


def test_a_spreadsheet_without_its_reader_says_how(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / 'record.xlsx'
    book(path, ['t', 'y'], *map(list, ROWS))
    monkeypatch.setitem(sys.modules, 'openpyxl', None)
    with pytest.raises(BagError, match=r'pip install openpyxl.* or save the sheet as \.csv'):
        read_table(path)


@pytest.mark.parametrize(
    ('raw', 'said'),
    [
        (b'\xd0\xcf\x11\xe0' + bytes(600), r'an old spreadsheet \(\.xls\)'),
        (b'PK\x03\x04' + bytes(600), r'a damaged archive \(\.zip\)'),
        (b'\x89HDF\r\n\x1a\n' + bytes(600), 'an HDF5 file'),
        (bytes(600), 'bytes of no text'),
    ],
)
def test_files_that_are_no_tables_are_named(tmp_path: Path, raw: bytes, said: str) -> None:
    path = tmp_path / 'record.csv'
    path.write_bytes(raw)
    with pytest.raises(BagError, match=said):
        read_table(path)


@pytest.mark.parametrize('command', [['identify', 'modal'], ['identify', 'segment']])
def test_missing_times_name_the_columns_and_both_ways_out(
    tmp_path: Path, command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'record.csv'
    path.write_text('lap,tip\n' + lines('{k},{y:.9f}'))
    assert main([*command, str(path), '--field', 'tip']) == 1
    said = capsys.readouterr().err
    assert 'got lap, tip' in said
    assert '--time COLUMN' in said
    assert '--rate HZ' in said


def spoiled(draw: np.random.Generator, text: str) -> str:
    """Return a text with characters lost, doubled and swapped, and lines cut."""
    letters = list(text)
    for _ in range(int(draw.integers(1, 40))):
        k = int(draw.integers(len(letters)))
        letters[k] = str(draw.choice(list('",;\t\n#%0.e-:Z ') + ['', 'NaN', '1e999', 'µ']))
    return ''.join(letters)[: int(draw.integers(1, len(letters) + 1))]


@pytest.mark.parametrize('reader', [read_table, channels_of])
def test_spoiled_texts_are_tables_or_errors(
    tmp_path: Path, reader: Callable[[Path], object]
) -> None:
    draw = np.random.default_rng(5)
    path = tmp_path / 'record.csv'
    for text in TIMED.values():
        for _ in range(8):
            path.write_text(spoiled(draw, text))
            try:
                reader(path)
            except BagError:
                continue


def test_units_and_values_survive_together(tmp_path: Path) -> None:
    path = tmp_path / 'record.csv'
    path.write_text('Time,Tip,Load\nms,mm,N\n' + lines('{ms:.1f},{y:.9f},3'))
    table = read_table(path)
    assert table.units == {'Time': 'ms', 'Tip': 'mm', 'Load': 'N'}
    values: NDArray[np.float64] = table['Load']
    np.testing.assert_array_equal(values, 3.0)


@pytest.mark.parametrize('suffix', ['.json', '.jsonl', '.ndjson'])
def test_a_json_object_in_each_line_is_a_row(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f'record{suffix}'
    path.write_text(''.join(f'{{"time": {t}, "tip": {y}}}\n' for t, y in ROWS))
    record = read_record(path, Channel()).record
    np.testing.assert_array_equal(record.t, T)
    np.testing.assert_array_equal(record.y, Y)
