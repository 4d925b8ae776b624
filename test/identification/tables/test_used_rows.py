"""Rows of a table that are not used: always told, and too many of them make a result doubtful."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.main import main
from denoc_ros.errors import BagError
from denoc_ros.identification.decay.channel import Channel, channels_of, read_record
from denoc_ros.identification.identification_result import DecayOptions, identify_decay
from denoc_ros.identification.servo.servo_runs import ServoOptions, identify_servos
from denoc_ros.identification.tables.joint_table import TableTimes, joints_of_table
from denoc_ros.identification.tables.tables import read_table

RATE, HERTZ, ZETA = 200.0, 4.1, 0.012
ROWS = 2000
T = np.arange(ROWS) / RATE
NOISE = 1e-3 * np.random.default_rng(4).standard_normal(ROWS)
Y = np.exp(-ZETA * 2 * np.pi * HERTZ * T) * np.cos(2 * np.pi * HERTZ * T) + NOISE
BREAKS = {
    'no number': lambda t, y: f'{t},overflow,x',
    'no time': lambda t, y: f'late,{y},x',
    'other cells': lambda t, y: f'{t}',
    'time of another': lambda t, y: f'{T[0] + np.floor(t * RATE / 2) * 2 / RATE},{y},x',
}


def written(path: Path, kind: str, broken: np.ndarray[Any, Any]) -> Path:
    lines = [
        BREAKS[kind](t, y) if is_broken else f'{t},{y},x'
        for t, y, is_broken in zip(T, Y, broken, strict=True)
    ]
    path.write_text('\n'.join(['time,tip,note', *lines]))
    return path


def identified(path: Path, channel: Channel) -> dict[str, Any]:
    options = DecayOptions(channel, (0.0, np.inf), None, '', None, {}, True, (0.0, 0.0, -9.81))
    return dict(identify_decay(path, options)[0])


@pytest.mark.parametrize('kind', BREAKS)
@pytest.mark.parametrize(('share', 'verdict'), [(0.02, 'good'), (0.1, 'doubtful')])
def test_the_share_of_the_rows_that_is_used_is_told(
    tmp_path: Path, kind: str, share: float, verdict: str, caplog: pytest.LogCaptureFixture
) -> None:
    """Rows at even distances are broken: each has a sound row with an even number before it."""
    broken = np.zeros(ROWS, bool)
    broken[1 :: 2 * round(0.5 / share)] = True
    lost = int(broken.sum())
    found = identified(written(tmp_path / 'a.csv', kind, broken), Channel(field='tip'))
    assert found['source']['rows'] == ROWS
    assert found['source']['used_rows'] == ROWS - lost
    assert f'{ROWS - lost} of {ROWS} rows are used' in caplog.text
    assert found['verdict'] == verdict
    said = [reason for reason in found['reasons'] if 'rows are used' in reason]
    assert bool(said) == (verdict == 'doubtful')


def test_nothing_is_said_of_a_table_of_which_all_rows_are_used(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = written(tmp_path / 'a.csv', 'no time', np.zeros(ROWS, bool))
    found = identified(path, Channel(field='tip'))
    assert found['source']['rows'] == found['source']['used_rows'] == ROWS
    assert not caplog.records


@pytest.mark.parametrize('per_stamp', [2, 75])
def test_many_rows_of_one_time_need_a_rate(tmp_path: Path, per_stamp: int) -> None:
    """The rate that the error names gives all rows."""
    stamps = 1_641_469_122 + np.arange(ROWS) // per_stamp
    rows = '\n'.join(f'{stamp},{y}' for stamp, y in zip(stamps, Y, strict=True))
    (tmp_path / 'a.csv').write_text(f'time,tip\n{rows}')
    said = f'got {per_stamp} rows per stamp .* use --rate, such as --rate {per_stamp}$'
    with pytest.raises(BagError, match=said):
        read_record(tmp_path / 'a.csv', Channel(field='tip'))
    reading = read_record(tmp_path / 'a.csv', Channel(field='tip', rate=per_stamp))
    assert reading.rows == len(reading.record.t) == ROWS


def test_many_messages_of_one_stamp_need_the_other_clock(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'run') as writer:
        writer.add_topic('/force', 'geometry_msgs/msg/WrenchStamped')
        for row in range(ROWS):
            header = {'stamp': {'sec': 5 + row // 200, 'nanosec': 0}}
            wrench = {'force': {'x': float(Y[row])}}
            writer.write_message('/force', 10**9 + row * 5_000_000, header=header, wrench=wrench)
    channel = Channel('/force', 'wrench.force.x')
    with pytest.raises(BagError, match=r'got 200 messages per stamp .* use --stamp log'):
        read_record(tmp_path / 'run', channel)
    channel = Channel('/force', 'wrench.force.x', stamp='log')
    assert len(read_record(tmp_path / 'run', channel).record.t) == ROWS


def test_a_cell_that_is_empty_at_the_end_of_a_row_keeps_the_row(tmp_path: Path) -> None:
    """Merged signals have a value in some rows only; the last signal is no other."""
    rows = [
        f'{t},{y},{t if k % 10 == 0 else ""}' for k, (t, y) in enumerate(zip(T, Y, strict=True))
    ]
    (tmp_path / 'a.csv').write_text('\n'.join(['time,tip,slow', *rows]))
    table = read_table(tmp_path / 'a.csv')
    assert table.left_out == 0
    assert len(table['tip']) == ROWS
    assert np.isfinite(table['slow']).sum() == ROWS / 10
    ended = [f'{row},' for row in ('time,tip', *(f'{t},{y}' for t, y in zip(T, Y, strict=True)))]
    (tmp_path / 'b.csv').write_text('\n'.join(ended))
    assert list(read_table(tmp_path / 'b.csv')) == ['time', 'tip']


def test_rows_of_joints_that_are_not_used_are_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    broken = np.arange(ROWS) % 50 == 1
    path = written(tmp_path / 'a.csv', 'no time', broken)
    joints_of_table(path, read_table(path), ['tip'], {}, TableTimes())
    assert f'{ROWS - int(broken.sum())} of {ROWS} rows are used' in caplog.text


def test_rows_outside_of_a_window_do_not_count(tmp_path: Path) -> None:
    broken = (np.arange(ROWS) % 20 == 1) & (T > 5.0)  # 2.5 % of all
    path = written(tmp_path / 'a.csv', 'other cells', broken)
    reading = read_record(path, Channel(field='tip', end=2.0))
    assert not reading.doubt
    assert len(reading.record.t) < reading.rows < 1.05 * len(reading.record.t)


@pytest.mark.parametrize(('each', 'is_doubtful'), [(50, False), (10, True)])
def test_a_servo_of_too_few_rows_is_doubtful(
    tmp_path: Path, each: int, is_doubtful: bool, caplog: pytest.LogCaptureFixture
) -> None:
    told = np.minimum(T, 1.0) * np.sin(T)
    rows = [
        f'{t},{c},{p}' if k % each != 1 else f'{t}'
        for k, (t, c, p) in enumerate(zip(T, told, np.interp(T - 0.1, T, told), strict=True))
    ]
    (tmp_path / 'a.csv').write_text('\n'.join(['time,elbow/command,elbow/position', *rows]))
    document, _ = identify_servos([tmp_path / 'a.csv'], ServoOptions(Channel()))
    lost = ROWS // each
    assert f'{ROWS - lost} of {ROWS} rows are used' in caplog.text
    assert any('rows are used' in reason for reason in document['reasons']) == is_doubtful
    assert not (is_doubtful and document['verdict'] == 'good')


HEADER = """LabVIEW Measurement\t
Writer_Version\t2
Reader_Version\t2
Separator\tTab
Decimal_Separator\t{point}
Multi_Headings\tYes
X_Columns\t{columns}
Time_Pref\tAbsolute
Date\t2026/11/28
Time\t10:11:12.3456789
***End_of_Header***\t
\t
Channels\t1\t\t
Samples\t{rows}\t\t
Date\t2026/11/28\t\t
Time\t10:11:12.3456789\t\t
Y_Unit_Label\tVolts\t\t
X_Dimension\t{dimension}\t\t
X0\t0.0000000000000000E+0\t\t
Delta_X\t{step}\t\t
***End_of_Header***\t\t\t
X_Value\tVoltage_0\tComment
"""


def labview(path: Path, columns: str, dimension: str = 'Time', point: str = '.') -> Path:
    text = HEADER.format(
        point=point, columns=columns, rows=ROWS, step=f'{1 / RATE:.6f}', dimension=dimension
    )
    text += ''.join(
        f'{t:.6f}\t{y:.9f}\n' if columns == 'One' else f'\t{y:.9f}\n'
        for t, y in zip(T, Y, strict=True)
    )
    if point == ',':
        head, body = text.split('X0\t')
        text = f'{head}X0\t{body.replace(".", ",")}'
    path.write_bytes(text.replace('\n', '\r\n').encode())
    return path


@pytest.mark.parametrize('point', ['.', ','])
@pytest.mark.parametrize('columns', ['One', 'No'])
def test_the_numbers_in_the_header_of_labview_are_no_samples(
    tmp_path: Path, columns: str, point: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = labview(tmp_path / 'a.lvm', columns, point=point)
    assert [channel.field for channel in channels_of(path)] == ['Voltage_0']
    record = read_record(path, Channel()).record
    np.testing.assert_allclose(record.y, Y, atol=1e-9)
    np.testing.assert_allclose(record.t, T, atol=1e-6)
    found = identified(path, Channel())
    assert found['modes'][0]['frequency_hz'] == pytest.approx(HERTZ, rel=1e-3)
    assert found['source']['stamp'] == ('X_Value' if columns == 'One' else f'{RATE:g} Hz')
    assert main(['identify', 'modal', str(path)]) == 0
    assert 'good' in capsys.readouterr().out


def test_another_dimension_of_labview_is_no_time(tmp_path: Path) -> None:
    path = labview(tmp_path / 'a.lvm', 'One', 'Frequency')
    with pytest.raises(BagError, match='table must have a column of times'):
        read_record(path, Channel(field='Voltage_0'))


@pytest.mark.parametrize('columns', ['x_value,y_value', 'X_Value,Y_Value'])
def test_a_column_named_x_value_of_another_program_is_a_signal(
    tmp_path: Path, columns: str
) -> None:
    rows = '\n'.join(f'{t},{y},{-y}' for t, y in zip(T, Y, strict=True))
    (tmp_path / 'a.csv').write_text(f'time,{columns}\n{rows}')
    assert [c.field for c in channels_of(tmp_path / 'a.csv')] == columns.split(',')
