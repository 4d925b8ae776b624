"""Sessions that cannot go on: their bag is closed, their report is written, the cause on top."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from bench.loops.rates_blocks import domain
from node_robots import two_links
from trust.endings.session_failures import spoil

pytestmark = pytest.mark.ros

CASES = [
    pytest.param(('plant', 'killed', 1), marks=pytest.mark.long),
    pytest.param(('recorder', 'killed', 1), marks=pytest.mark.long),
    ('feedforward', 'stopped', 0),
]
# the phase ends before the plant's next report
DIVERGING = """
robot: arm.urdf
time: simulated
reference: {kind: points, times: [0, 0.4], positions: [[0, 0], [0.3, 0.1]]}
duration: 0.5
nodes: {predictor: false, plant: {update_rate: 100}, feedforward: {update_rate: 100}}
plant: {position_limit: 0.2}
"""
UNBUILDABLE = 'time: real\nreference: {kind: sine, amplitude: 0.2, frequency: 0.5, duration: 2}\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / 'arm.urdf').write_text(two_links())
    return tmp_path


@pytest.fixture
def environment() -> Iterator[dict[str, str]]:
    with domain() as environment:
        yield environment


def up(folder: Path, run: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, '-m', 'denoc_ros.cli.main', 'up', str(folder / 'session.yaml')]
    return subprocess.run(
        [*command, '--output', str(run)],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=240.0,
        check=False,
    )


@pytest.mark.parametrize('case', CASES, ids=lambda case: ' '.join(map(str, case)))
def test_a_failure_in_a_phase_leaves_a_report_of_what_came_before(
    folder: Path, environment: dict[str, str], case: tuple[str, str, int]
) -> None:
    assert spoil(folder, 'run', environment, case, without='predictor') == ''


def test_a_node_that_does_not_start_leaves_a_report_of_why(
    folder: Path, environment: dict[str, str]
) -> None:
    mesh = '<visual><geometry><mesh filename="package://none/arm.stl"/></geometry></visual>'
    arm = folder / 'arm.urdf'
    arm.write_text(arm.read_text().replace('<inertial>', f'{mesh}<inertial>', 1))
    (folder / 'session.yaml').write_text(
        f'robot: arm.urdf\n{UNBUILDABLE}'
        'nodes: {predictor: false, feedforward: {effort_limits: [1, 2, 3]}}\n'
    )
    run = folder / 'run'
    done = up(folder, run, environment)
    assert done.returncode == 1, done.stderr
    assert 'denoc up: feedforward: process must keep running, got exit status 1' in done.stderr
    # told once, before anything is started
    assert done.stderr.count('package://none/arm.stl') == 1
    assert done.stderr.index('package://none/arm.stl') < done.stderr.index('starting recorder')
    page = (run / 'report.html').read_text()
    assert 'The session ended before its end: feedforward: process must keep running' in page
    assert 'effort_limits' in page  # its last words
    assert signal.SIGKILL.name not in done.stderr


def test_a_plant_that_diverges_ends_the_session_with_its_cause(
    folder: Path, environment: dict[str, str]
) -> None:
    (folder / 'session.yaml').write_text(DIVERGING)
    run = folder / 'run'
    done = up(folder, run, environment)
    assert done.returncode == 1, done.stderr
    cause = 'plant: state must be one that the robot can have, got: the simulated state diverged'
    assert f'denoc up: {cause}' in done.stderr
    assert 'position must be from -0.2 to 0.2' in done.stderr
    assert f'before its end: {cause}' in (run / 'report.html').read_text()
