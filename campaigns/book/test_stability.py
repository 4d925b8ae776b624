"""The stability study: one page, numbers for machines, a status that says what to trust."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from book.__main__ import main
from page_look import require_one_look
from planar_chains import PlanarLink, planar_chain

SWING = """gravity: [0, -9.81, 0]
torque:
  kind: rigid_inverse_dynamics
  reference: {kind: book, rate: 0.52359877, period: 6}
method: RK45
"""


@pytest.fixture
def pendulum(tmp_path: Path) -> Path:
    robot = tmp_path / 'pendulum.urdf'
    robot.write_text(planar_chain([PlanarLink(1.3, 5.0)]))
    return robot


@pytest.mark.long_cases('6.0-2')
@pytest.mark.parametrize(('duration', 'status'), [(1.0, 0), (6.0, 2)])
def test_status_says_whether_the_run_stays_with_the_solution(
    pendulum: Path, capsys: pytest.CaptureFixture[str], duration: float, status: int
) -> None:
    scenario, page = pendulum.with_name('swing.yaml'), pendulum.with_name('swing.html')
    scenario.write_text(f'{SWING}duration: {duration}\n')
    arguments = ['stability', str(pendulum), str(scenario), '-o', str(page), '--json']
    assert main(arguments) == status
    summary = json.loads(capsys.readouterr().out)
    assert summary['acceptable'] is (status == 0)
    assert set(summary['algorithms']) == {'recursion', 'cholesky'}
    for one in summary['algorithms'].values():
        assert one['reached_s'] == duration
        assert one['processor_s'] > 0.0
        assert 0.0 < one['forward_dynamics_us'] < 1e4
    assert summary['solution'] == 'desired motion'


def test_page_stands_alone(pendulum: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario, page = pendulum.with_name('swing.yaml'), pendulum.with_name('swing.html')
    scenario.write_text(f'{SWING}duration: 0.5\n')
    assert main(['stability', str(pendulum), str(scenario), '-o', str(page)]) == 0
    text = page.read_text()
    for heading in (
        'Zero-eigenvalue deviation',
        'Power difference',
        'Accelerations',
        'What the motion itself does',
        'Cost',
    ):
        assert f'<h2>{heading}</h2>' in text
    # of one joint: two deviations, accelerations; power, its difference, growth, condition number
    assert text.count('<figure>') == 7
    require_one_look(text, str(page.parent))
    shown = capsys.readouterr().out
    assert 'recursion: acceptable to 0.5 s' in shown
    assert 'cholesky: acceptable to 0.5 s' in shown


def test_prescribed_joints_are_a_message(
    pendulum: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = pendulum.with_name('prescribed.yaml')
    scenario.write_text('reference: {kind: book, rate: 0.1, period: 1}\n')
    assert main(['stability', str(pendulum), str(scenario)]) == 1
    assert 'must drive the robot by torques' in capsys.readouterr().err
