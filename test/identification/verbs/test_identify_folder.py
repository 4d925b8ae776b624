"""`denoc identify modal` on a folder: a row per recording, bad ones reported and skipped."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from book.selftest import Defects, Truth, synthetic_decay

from denoc_ros.cli.main import main
from denoc_ros.errors import BagError
from denoc_ros.identification.verbs.identify_rows import recordings

ZETAS = (0.01, 0.02)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    bags = tmp_path / 'bags'
    for k, zeta in enumerate(ZETAS):
        record = synthetic_decay([Truth(3.0, zeta)], 60.0, 3.0, Defects(45.0), k).record
        path = bags / f'day-{k}' / 'decay.csv'
        path.parent.mkdir(parents=True)
        np.savetxt(
            path, np.column_stack((record.t, record.y)), delimiter=',', header='t,y', comments=''
        )
    (bags / 'day-0' / 'bad.mcap').write_bytes(b'no bag')
    return bags


def test_each_recording_has_a_row_and_bad_ones_are_skipped(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ['identify', 'modal', str(folder), '-o', str(tmp_path / 'rows'), '--field', 'y']
    assert main([*command, '--json']) == 2
    rows = json.loads(capsys.readouterr().out)['rows']
    good = [row for row in rows if not row['failure']]
    assert [Path(row['file']).parent.name for row in good] == ['day-0', 'day-1']
    for row, zeta in zip(good, ZETAS, strict=True):
        assert row['verdict'] == 'good'
        assert row['damping_ratio'] == pytest.approx([zeta], rel=0.05)
        assert row['interval_low'][0] < row['damping_ratio'][0] < row['interval_high'][0]
    (bad,) = (row for row in rows if row['failure'])
    assert 'bad.mcap: bag must be readable' in bad['failure']
    # again: nothing is done twice, what failed is tried again
    files = sorted((tmp_path / 'rows').iterdir())
    assert main(command) == 2
    assert '2 of 3 recordings' in capsys.readouterr().out
    assert sorted((tmp_path / 'rows').iterdir()) == files


def test_paths_patterns_and_folders_stand_for_recordings(folder: Path, tmp_path: Path) -> None:
    tables = [folder / f'day-{k}' / 'decay.csv' for k in range(len(ZETAS))]
    assert recordings([f'{folder}/**/*.csv']) == tables
    assert recordings([str(tables[1]), str(folder / 'day-1'), str(tables[0])]) == tables[::-1]
    bag = tmp_path / 'bag'
    bag.mkdir()
    (bag / 'metadata.yaml').touch()
    (bag / 'bag_0.mcap').touch()
    assert recordings([str(bag)]) == [bag]
    assert recordings([str(tmp_path)])[-1] in (bag, *tables)
    with pytest.raises(BagError, match='must be that of a bag, or of some, got none there'):
        recordings([f'{folder}/*.db3'])


def test_the_folder_of_a_session_stands_for_its_bag(tmp_path: Path) -> None:
    for name in ('run-1', 'run-2'):
        bag = tmp_path / name / 'bag'
        bag.mkdir(parents=True)
        for file in ('metadata.yaml', 'bag_0.mcap', '../session.json', '../summary.json'):
            (bag / file).touch()
        (tmp_path / name / 'configuration.yaml').touch()
        (tmp_path / name / 'report.html').touch()
    bags = [tmp_path / name / 'bag' for name in ('run-1', 'run-2')]
    assert recordings([str(tmp_path / 'run-1')]) == bags[:1]
    assert recordings([f'{tmp_path}/run-*']) == bags
    assert recordings([str(tmp_path)]) == bags


@pytest.mark.parametrize('name', ['session.json', 'summary.json', 'configuration.yaml'])
def test_a_file_beside_the_bag_of_a_session_is_no_recording(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text('{"y": [1, 2, 3]}')
    (tmp_path / 'other.json').touch()
    for asked in (str(tmp_path / name), f'{tmp_path}/{name[:-1]}?'):
        with pytest.raises(BagError, match='must be that of a bag, or of some, got none there'):
            recordings([asked])
    assert recordings([str(tmp_path)]) == [tmp_path / 'other.json']
