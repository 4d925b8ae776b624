"""`denoc shape` for robots whose base floats."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from denoc_ros.cli.main import main
from denoc_ros.planning import shape_page as shape_comparison

FLOATING = 'config/robots/canadarm_10t.urdf'
FIXED = 'config/robots/canadarm.urdf'
BOOK = {'kind': 'book', 'start': [0.2, 0.7, 0.5], 'rate': [0.1, 0.04, 0.02], 'period': 5.0}


@pytest.fixture
def motion(tmp_path: Path) -> Path:
    file = tmp_path / 'motion.yaml'
    file.write_text(yaml.safe_dump({'gravity': [0, 0, 0], 'reference': BOOK}))
    return file


@pytest.fixture(autouse=True)
def no_wrong_models(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out of pages what takes them long."""
    monkeypatch.setattr(shape_comparison, 'variations', lambda _robot: {})


@pytest.mark.long
def test_a_plan_on_a_spacecraft_is_simulated_with_its_torque(
    capsys: pytest.CaptureFixture[str], motion: Path, tmp_path: Path
) -> None:
    plan, page, run = (tmp_path / name for name in ('plan.yaml', 'plan.html', 'run.mcap'))
    arguments = ['shape', FLOATING, str(motion), '-o', str(plan), '--page', str(page), '--json']
    assert main(arguments) == 0
    told = json.loads(capsys.readouterr().out)
    assert told['tip_error_m'] < 1e-6
    assert 'base_force_N' not in told
    simulated = told['simulated']
    for figure in ('swing_m', 'moving_rms_m'):
        assert simulated['shaped'][figure] < 1e-3 * simulated['plain'][figure]
    scenario = tmp_path / 'scenario.yaml'
    scenario.write_text('gravity: [0, 0, 0]\nreference: plan.yaml\nduration: 10\n')
    assert main(['simulate', FLOATING, str(scenario), '-o', str(run), '--json']) == 0
    by_run = json.loads(capsys.readouterr().out)['largest_torque']
    for name, largest in told['largest_torque'].items():
        # a plan's rows of 20 ms, quintics between them
        assert by_run[name] == pytest.approx(largest, rel=5e-3, abs=0.1)


def test_the_wrench_of_thrusters_is_told_and_written(
    capsys: pytest.CaptureFixture[str], motion: Path, tmp_path: Path
) -> None:
    plan, page = tmp_path / 'plan.csv', tmp_path / 'plan.html'
    more = ['--base', 'free_flying', '--interval', '0.005', '--page', str(page)]
    assert main(['shape', FLOATING, str(motion), '-o', str(plan), *more]) == 0
    said = capsys.readouterr().out
    with plan.open(newline='') as file:
        head, *rows = list(csv.reader(file))
    values = np.array(rows, dtype=float)
    force = values[:, [head.index(f'base/force_{axis}') for axis in 'xyz']]
    assert np.linalg.norm(force, axis=1).max() > 10.0
    (told,) = (line for line in said.splitlines() if 'thrusters hold the base' in line)
    assert float(told.split('up to ')[1].split(' N')[0]) == pytest.approx(
        np.linalg.norm(force, axis=1).max(), rel=1e-2
    )
    assert np.abs(values[:, head.index('spacecraft/x/position')]).max() == 0.0
    assert 'The tip goes where it should' in page.read_text()


def test_a_fixed_base_needs_no_thrusters(
    capsys: pytest.CaptureFixture[str], motion: Path, tmp_path: Path
) -> None:
    more = ['-o', str(tmp_path / 'no.csv'), '--base', 'free_flying']
    assert main(['shape', FIXED, str(motion), *more]) == 1
    assert 'base must be None for canadarm, whose base does not float' in capsys.readouterr().err
