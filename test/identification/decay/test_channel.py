"""Records come out of bags and tables as they went in, calibrated, with their stamps."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat

from denoc_ros.bags.writer import BagWriter
from denoc_ros.errors import BagError, IdentificationError
from denoc_ros.identification.decay.channel import (
    Channel,
    channels_of,
    joint_positions,
    read_record,
)
from denoc_ros.identification.decay.records import Record, doubtful_rate
from denoc_ros.identification.tables.time_columns import is_time, unit_of_times

START_NS = 1_700_000_000_000_000_000
DELAY_NS = 2_000_000  # from stamp to recording
T = np.asarray(np.arange(20) * 0.01, dtype=np.float64)
Y = np.asarray(np.cos(T), dtype=np.float64)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    path = tmp_path / 'run.mcap'
    with BagWriter(path) as writer:
        writer.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
        writer.add_topic('/tip', 'sensor_msgs/msg/JointState')
        writer.add_topic('/gauges', 'std_msgs/msg/Float64MultiArray')
        writer.add_topic('/cell', 'geometry_msgs/msg/WrenchStamped')
        for t, y in zip(T, Y, strict=True):
            stamp = START_NS + round(t * 1e9)
            header = {'stamp': {'sec': stamp // 10**9, 'nanosec': stamp % 10**9}}
            log = stamp + DELAY_NS
            layout = {'dim': [{'label': 'left,right', 'size': 2, 'stride': 2}]}
            for topic, fields in (
                ('/joint_states', {'name': ['j1'], 'position': [0.5 + t]}),
                ('/tip', {'name': ['a/ux', 'a/uy'], 'position': [0.0, y], 'velocity': [1.0, -y]}),
                ('/cell', {'wrench': {'force': {'x': 3.0 * y}}}),
            ):
                writer.write_message(topic, log, header=header, **fields)
            writer.write_message('/gauges', log, layout=layout, data=[y, 2.0 * y])
    return path


@pytest.mark.parametrize(
    ('channel', 'factor', 'unit'),
    [
        (Channel('/tip', 'a/uy'), 1.0, 'm'),
        (Channel('/tip', 'a/uy', 'velocity'), -1.0, ''),
        (Channel('/gauges', 'right'), 2.0, ''),
        (Channel('/cell', 'wrench.force.x', unit='N'), 3.0, 'N'),
        (Channel('/tip', 'a/uy', gain=1e-6, unit='strain'), 1e-6, 'strain'),
    ],
)
def test_a_signal_is_read_from_its_place(
    bag: Path, channel: Channel, factor: float, unit: str
) -> None:
    reading = read_record(bag, channel)
    np.testing.assert_allclose(reading.record.t, T, atol=1e-9)  # stamps are whole ns
    np.testing.assert_allclose(reading.record.y, factor * Y)
    assert reading.channel.unit == unit


def test_stamps_are_those_that_were_asked_for(bag: Path) -> None:
    header = read_record(bag, Channel('/tip', 'a/uy'))
    log = read_record(bag, Channel('/tip', 'a/uy', stamp='log'))
    assert (header.origin_ns, log.origin_ns) == (START_NS, START_NS + DELAY_NS)
    # joints at the middle of the record, by the same clock
    assert joint_positions(header, 0.045, 0.055) == pytest.approx({'j1': 0.55})


def test_window_and_calibration_make_the_record(bag: Path) -> None:
    channel = Channel('/tip', 'a/uy', gain=2.0, offset=1.0, begin=0.035, end=0.155)
    record = read_record(bag, channel).record
    np.testing.assert_allclose(record.t, T[4:16], atol=1e-9)
    np.testing.assert_allclose(record.y, 2.0 * Y[4:16] + 1.0)


def test_every_signal_is_listed(bag: Path) -> None:
    listed = {(one.topic, one.field, one.quantity) for one in channels_of(bag)}
    assert {
        ('/joint_states', 'j1', 'position'),
        ('/tip', 'a/uy', 'velocity'),
        ('/gauges', 'left', 'position'),
        ('/cell', 'wrench.force.x', 'position'),
    } <= listed
    assert len(listed) == 1 + 4 + 2 + 6


@pytest.mark.parametrize('kind', ['csv', 'plain csv', 'mat', 'json'])
def test_tables_are_read_like_bags(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f'record.{kind.split()[-1]}'
    channel = Channel(field='y')
    if kind == 'csv':
        path.write_text(
            'time;y;note\n' + ''.join(f'{t};{y};a\n' for t, y in zip(T + 5.0, Y, strict=True))
        )
    elif kind == 'plain csv':
        np.savetxt(path, Y)
        channel = Channel(rate=100.0)
    elif kind == 'mat':
        savemat(path, {'both': np.column_stack((T, Y)), 'gain': 3.0})
        channel = Channel(field='both[1]', time='both[0]')
    else:
        rows = [{'timestamp': t, 'y': y, 'on': True} for t, y in zip(T, Y, strict=True)]
        path.write_text(json.dumps({'made': 'here', 'entries': rows}))
    record = read_record(path, channel).record
    np.testing.assert_allclose(record.t, T, atol=1e-12)  # 5 s are taken off the stamps
    np.testing.assert_allclose(record.y, Y)


def test_what_a_file_does_not_have_is_said_with_what_it_has(bag: Path, tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r'topic must be given, one of .*/tip'):
        read_record(bag, Channel())
    with pytest.raises(BagError, match='field of /tip must be given, one of a/ux, a/uy'):
        read_record(bag, Channel('/tip'))
    with pytest.raises(BagError, match='field of /gauges must be one of left, right'):
        read_record(bag, Channel('/gauges', 'middle'))
    with pytest.raises(BagError, match=r'\(wrench.force.x, .*got .wrench.force.w'):
        read_record(bag, Channel('/cell', 'wrench.force.w'))
    table = tmp_path / 'table.csv'
    table.write_text('a,b\n1,2\n3,4\n')
    with pytest.raises(BagError, match='field must be given, one of a, b'):
        read_record(table, Channel(rate=1.0))
    with pytest.raises(BagError, match='table must have a column of times'):
        read_record(table, Channel(field='a'))
    with pytest.raises(BagError, match=r'field must be a column of numbers \(a, b\)'):
        read_record(table, Channel(field='c', rate=1.0))
    for name, text in (
        ('empty.csv', ''),
        ('words.csv', 'a\nb\n'),
        ('bad.json', '{'),
        ('bad.mat', 'x'),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(BagError, match='table must'):
            read_record(tmp_path / name, Channel(field='a'))


def lines(template: str) -> str:
    """Return one line per sample, its number, time and value filled in."""
    samples = enumerate(zip(T, Y, strict=True))
    return ''.join(template.format(k=k, t=t, y=y, ms=1e3 * t) + '\n' for k, (t, y) in samples)


def row(name: str, values: NDArray[np.float64]) -> str:
    return ','.join([name, *map(str, values)]) + '\n'


@pytest.mark.parametrize(
    ('name', 'text', 'channel'),
    [
        ('a.csv', 't;y\n' + lines('{t:.2f};{y:.9f}').replace('.', ','), Channel(field='y')),
        ('names_missing.csv', 't\n' + lines('{t},{y}'), Channel(field='1')),
        ('counted.csv', 't,y\n' + lines('{k},{t},{y}'), Channel(field='y')),
        ('trailing.csv', 't,y\n' + lines('{t},{y},'), Channel(field='y')),
        ('blanks.asc', '% made here\n' + lines('{t} {y}'), Channel(field='1', time='0')),
        ('rows.txt', row('t', T) + row('y', Y), Channel(field='y')),
        ('named.tsv', 'time_ms\ty\n' + lines('{ms}\t{y}'), Channel(field='y')),
        (
            'row_of_units.csv',
            'Zeit;y\nms;mm\n' + lines('{ms:.1f};{y:.9f}').replace('.', ','),
            Channel(field='y', time='Zeit', time_unit='ms'),
        ),
        ('told.csv', 'time,y\n' + lines('{ms},{y}'), Channel(field='y', time_unit='ms')),
    ],
)
def test_texts_of_other_programs_are_read(
    tmp_path: Path, name: str, text: str, channel: Channel
) -> None:
    (tmp_path / name).write_text(text)
    record = read_record(tmp_path / name, channel).record
    np.testing.assert_allclose(record.t, T, atol=1e-12)
    np.testing.assert_allclose(record.y, Y, atol=1e-9)


def test_structs_and_rows_of_matlab_are_read(tmp_path: Path) -> None:
    path = tmp_path / 'run.mat'
    savemat(path, {'run': {'t': T, 'tip': {'y': Y}}, 'wide': np.vstack((T, Y))})
    for channel in (
        Channel(field='run.tip.y', time='run.t'),
        Channel(field='wide[1]', time='wide[0]'),
    ):
        np.testing.assert_allclose(read_record(path, channel).record.y, Y)


def test_table_of_very_many_columns_is_refused(tmp_path: Path) -> None:
    path = tmp_path / 'wide.csv'
    path.write_text((','.join(map(str, range(2000))) + '\n') * 3000)
    with pytest.raises(BagError, match='at most 1000 columns, got 2000'):
        read_record(path, Channel(field='0', rate=1.0))


def test_quantity_that_messages_lack_is_said_with_what_they_have(tmp_path: Path) -> None:
    path = tmp_path / 'effort.mcap'
    with BagWriter(path) as writer:
        writer.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
        for k, y in enumerate(Y):
            writer.write_message('/joint_states', START_NS + 10**7 * k, name=['j1'], effort=[y])
    with pytest.raises(
        BagError,
        match='position of j1 on /joint_states must be in the messages, which have effort',
    ):
        read_record(path, Channel('/joint_states', 'j1'))
    np.testing.assert_allclose(
        read_record(path, Channel('/joint_states', 'j1', 'effort')).record.y, Y
    )


def test_times_in_other_units_are_doubted() -> None:
    assert doubtful_rate(Record(T, Y)) == ''
    assert '--time-unit ms' in doubtful_rate(Record(1e3 * T, Y))
    assert '--time-unit ns' in doubtful_rate(Record(1e9 * T, Y))
    units = [unit_of_times(name, T) for name in ('Time [ms]', 'stamp_ns', 't', 'ts')]
    assert units == ['ms', 'ns', 's', 's']
    assert not is_time('ts')
    with pytest.raises(IdentificationError, match=r'at least 8 samples .* got 0'):
        Record(np.empty(0), np.empty(0))
