"""`denoc calibrate`: tables and bags in, a calibrated description out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from lxml import etree
from node_robots import two_links

from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.main import main
from denoc_ros.model.reading.urdf import load_tree

GAIN, OFFSET = 3.0e-6, -2.0e-5
LEVELS = [0.0, 1e-3, 2e-3, 1e-3, 0.0]


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    file = tmp_path / 'arm.urdf'
    file.write_text(f'<?xml version="1.0"?>\n<!-- mine -->\n{two_links()}\n')
    return file


def table(folder: Path, *rows: str) -> Path:
    file = folder / 'table.csv'
    file.write_text('\n'.join(rows))
    return file


def good_rows() -> list[str]:
    rows = ['load,reference,raw  # up and down']
    rows += [f'x, {level}, {(level - OFFSET) / GAIN}' for level in LEVELS]
    return rows


def test_a_table_calibrates_the_file_in_place(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = robot.read_text()
    arguments = [str(table(tmp_path, *good_rows())), '--robot', str(robot), '--sensor', 'gauge']
    assert main(['calibrate', *arguments, '--json', '--write']) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['gain'] == pytest.approx(GAIN, rel=1e-9)
    assert found['hysteresis'] == pytest.approx(0.0, abs=1e-9)
    sensor = load_tree(robot).sensors[0]
    # the file has twelve digits or more
    assert (sensor.gain, sensor.offset) == pytest.approx(
        (found['gain'], found['offset']), rel=1e-11
    )
    after = robot.read_text()
    assert after.startswith('<?xml version="1.0"?>\n<!-- mine -->')
    # nothing but those two attributes has changed
    element = etree.fromstring(after.encode()).find('flexibility/sensor')
    assert element is not None
    element.set('gain', '2.0e-6')
    element.set('offset', '1.0e-5')
    plain = etree.tostring(element.getroottree(), encoding='unicode')
    wanted = etree.tostring(etree.fromstring(before.encode()).getroottree(), encoding='unicode')
    assert plain == wanted


@pytest.mark.parametrize('separator', [';', '\t'])
def test_a_table_of_a_spreadsheet_is_read(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], separator: str
) -> None:
    levels = [(f'{level:.9f}', f'{(level - OFFSET) / GAIN:.9f}') for level in LEVELS]
    rows = [separator.join(pair).replace('.', ',') for pair in (('reference', 'raw'), *levels)]
    file = tmp_path / 'table.csv'
    file.write_bytes('\r\n'.join(rows).encode('utf-8-sig'))
    assert (
        main(['calibrate', str(file), '--robot', str(robot), '--sensor', 'gauge', '--json']) == 0
    )
    assert json.loads(capsys.readouterr().out)['gain'] == pytest.approx(GAIN, rel=1e-5)


def bag(folder: Path, levels: list[float]) -> Path:
    """Plateaus of 1.5 s with noise; the gauge's raw values on /strain."""
    rng = np.random.default_rng(4)
    with BagWriter(folder / 'bag') as writer:
        writer.add_topic('/strain', 'std_msgs/msg/Float64')
        row = 0
        for level in levels:
            for _ in range(300):
                raw = (level - OFFSET) / GAIN + 2.0 * rng.standard_normal()
                writer.write_message('/strain', 10**9 + row * 5_000_000, data=raw)
                row += 1
    return folder / 'bag'


def test_plateaus_of_a_bag_calibrate_a_new_file(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new = tmp_path / 'new.urdf'
    arguments = [str(bag(tmp_path, LEVELS)), '--robot', str(robot), '--sensor', 'gauge']
    levels = ['--levels', *map(str, LEVELS)]
    assert main(['calibrate', *arguments, *levels, '-o', str(new)]) == 0
    assert 'hysteresis' in capsys.readouterr().out
    sensor = load_tree(new).sensors[0]
    # five plateaus of 240 readings with deviation 2 of a range of 667
    assert sensor.gain == pytest.approx(GAIN, rel=2e-3)
    assert sensor.noise == pytest.approx(2.0 * GAIN, rel=0.1)
    assert main(['calibrate', *arguments, *levels, '-o', str(new)]) == 1
    assert 'new.urdf: output must not exist yet, got an existing one' in capsys.readouterr().err
    assert main(['calibrate', *arguments, '--levels', '1', '2']) == 3
    assert 'plateaus must be as many as levels (2), got 5' in capsys.readouterr().err
    assert main(['calibrate', *arguments]) == 1
    assert 'levels must be given for the plateaus of a bag' in capsys.readouterr().err


def test_doubtful_and_bad_tables_have_their_statuses(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ['--robot', str(robot), '--sensor', 'gauge']
    bent = table(tmp_path, '0 0', '1 1', '2 4', '3 9', '4 16')
    assert main(['calibrate', str(bent), *options]) == 2
    assert 'doubtful: curvature must be <= 2%' in capsys.readouterr().err
    flat = table(tmp_path, '0;5', '1;5', '2;5')
    assert main(['calibrate', str(flat), *options]) == 3
    assert 'readings must not be all the same' in capsys.readouterr().err
    bad = table(tmp_path, '0\t5', '1\tfive', 'nan\t7')
    assert main(['calibrate', str(bad), *options]) == 1
    error = capsys.readouterr().err
    assert 'line 2 must have a reference and a reading' in error
    assert 'line 3 must have a reference and a reading' in error
    assert main(['calibrate', str(flat), *options[:2], '--sensor', 'none']) == 1
    assert "sensor must be one of gauge, moment, bend, got 'none'" in capsys.readouterr().err
    assert main(['calibrate', str(tmp_path / 'no.csv'), *options, '--levels', '1']) == 1
    assert 'bag must exist' in capsys.readouterr().err
