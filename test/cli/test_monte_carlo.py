"""`denoc simulate --vary`: drawn runs that can be repeated, added to, and checked one by one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as parquet
import pytest

from denoc_ros.cli.main import main
from denoc_ros.cli.simulate_verb import draw

RANGES = {'beam.link_1.y.ei': (300.0, 400.0), 'joint.joint_1.damping': (0.0, 1.0)}
SETTINGS = [f'--vary={path}={low}:{high}' for path, (low, high) in RANGES.items()]
SCENARIO = (
    'gravity: [0, 0, 0]\ntorque: {kind: step, values: {joint_1: 5.0}}\n'
    'duration: 0.05\noutput_rate: 100\n'
)


def test_runs_are_those_of_the_drawn_models_and_can_be_added_to(
    repository: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:

    robot = str(repository / 'config/robots/single_link.urdf')
    scenario, folder = tmp_path / 'short.yaml', tmp_path / 'rows'
    scenario.write_text(SCENARIO)
    common = ['simulate', robot, str(scenario), '-o', str(folder), '--json', *SETTINGS]
    assert main([*common, '--runs', '2']) == 0
    assert main([*common, '--runs', '3']) == 0
    assert json.loads(capsys.readouterr().out.split('\n}\n')[1] + '\n}')['runs'] == 3
    assert main([*(each for each in common if each != '--json'), '--runs', '3']) == 0
    assert '\n  largest deflection link_1/uy: ' in capsys.readouterr().out
    files = sorted(folder.iterdir())
    assert [parquet.read_table(file).num_rows for file in files] == [2, 1]
    (row,) = parquet.read_table(files[1]).to_pylist()
    drawn = draw(RANGES, 0, 2)
    assert {path: row[path] for path in RANGES} == drawn
    # the same run by hand
    model = '\n'.join(f'  {path}: {value!r}' for path, value in drawn.items())
    scenario.write_text(f'{SCENARIO}model:\n{model}\n')
    bag = str(tmp_path / 'one.mcap')
    assert main(['simulate', robot, str(scenario), '-o', bag, '--json']) == 0
    alone = json.loads(capsys.readouterr().out)['largest_deflection']['link_1/uy']
    assert row['largest_deflection.link_1/uy'] == alone


def test_draws_fill_their_ranges_evenly() -> None:
    drawn = np.array([list(draw(RANGES, 7, run).values()) for run in range(400)])
    for values, (low, high) in zip(drawn.T, RANGES.values(), strict=True):
        assert low <= values.min() <= values.max() <= high
        # mean of 400 even draws: 5 standard deviations of 0.289 / 20
        assert abs((values.mean() - low) / (high - low) - 0.5) < 0.075
    assert len(np.unique(drawn)) == drawn.size


def test_bad_ranges_are_one_message_each(capsys: pytest.CaptureFixture[str]) -> None:
    ranges = ['--vary=a=1:2', '--vary=b=2:1', '--vary=c=1', '--vary==1:2']
    assert main(['simulate', 'robot.urdf', 'scenario.yaml', '-o', 'rows', *ranges]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert [line.count('--vary must be PATH=LOW:HIGH') for line in lines] == [1, 1, 1]
