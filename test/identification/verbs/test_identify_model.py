"""`denoc identify model` on bags that `denoc simulate` leaves."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from page_look import require_one_look

from denoc_ros.cli.main import main
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.model.overrides import edited_description

ROBOT = Path(__file__).resolve().parents[3] / 'config' / 'robots' / 'canadarm_gauges.urdf'
SCENARIO = """
gravity: [0, 0, 0]
torque:
  kind: rigid_inverse_dynamics
  reference: {kind: book, form: half, rate: [0.3, 0.2, 0.4], period: [3, 2, 2], duration: 3}
duration: 3
output_rate: 250
"""
TRUTH = {'beam.link_1.y.ei': 1.2, 'beam.link_2.y.ei': 0.8}  # times what the file says


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('bag')
    changed = {path: factor * stiffness()[path] for path, factor in TRUTH.items()}
    (folder / 'true.urdf').write_text(edited_description(ROBOT, changed))
    (folder / 'scenario.yaml').write_text(SCENARIO)
    run = folder / 'run.mcap'
    words = ['simulate', str(folder / 'true.urdf'), str(folder / 'scenario.yaml'), '-o', str(run)]
    assert main(words) == 0
    return run


def stiffness(path: Path = ROBOT) -> dict[str, float]:
    return {
        f'beam.{body.name}.y.ei': body.beam.y.stiffness
        for body in load_robot(path).tree.bodies
        if body.beam is not None and body.beam.y is not None
    }


def test_stiffness_is_found_and_written(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ['identify', 'model', str(bag), '--robot', str(ROBOT), '--gravity', '0', '0', '0']
    new = tmp_path / 'new.urdf'
    asked = ['--free', 'beam.*.ei', '--json', '-o', str(tmp_path / 'result'), '--apply', str(new)]
    assert main([*words, *asked]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said['not_identifiable'] == []
    assert [one['path'] for one in said['parameters']] == list(TRUTH)
    for one in said['parameters']:
        wanted = TRUTH[one['path']] * stiffness()[one['path']]
        assert one['verdict'] == 'found'
        assert one['value'] == pytest.approx(wanted, rel=0.02)
        assert one['interval'][0] < one['value'] < one['interval'][1]
        assert stiffness(new)[one['path']] == pytest.approx(one['value'], rel=1e-9)
    page = (tmp_path / 'result' / 'report.html').read_text()
    require_one_look(page)
    assert 'beam.link_1.y.ei' in page
    assert main([*words, *asked]) == 1
    assert '--apply must be a new file' in capsys.readouterr().err


def test_what_nothing_is_seen_of_ends_with_three(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ['identify', 'model', str(bag), '--robot', str(ROBOT), '--gravity', '0', '0', '0']
    path = 'payload.tool.com.z'
    assert main([*words, '--free', path, '--held-out', '0', '--json']) == 3
    said = json.loads(capsys.readouterr().out)
    # an arm in a plane tells nothing of a centre of mass across it
    assert [one['verdict'] for one in said['parameters']] == ['not identifiable']
    assert said['parameters'][0]['interval'] == [None, None]
    never = f'no measurement of this robot depends on {path}, whatever the motion'
    assert said['not_identifiable'] == [never]


def test_what_no_motion_shows_spoils_no_verdict_of_the_whole(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ['identify', 'model', str(bag), '--robot', str(ROBOT), '--gravity', '0', '0', '0']
    path = 'payload.tool.com.z'
    assert main([*words, '--free', 'beam.*.ei', path, '--json']) == 0
    said = json.loads(capsys.readouterr().out)
    verdicts = {one['path']: one['verdict'] for one in said['parameters']}
    assert verdicts == {**dict.fromkeys(TRUTH, 'found'), path: 'not identifiable'}
    assert said['without_effect'] == [path]
    assert said['verdict'] == 'good'


@pytest.mark.parametrize(
    ('words', 'says'),
    [
        (['nowhere.mcap', '--free', 'beam.*.ei'], 'nowhere.mcap'),
        (['BAG', '--free', 'beam.none.ei'], "--free 'beam.none.ei' must be of one of"),
        (['BAG', '--free', 'beam.*.ei', '--held-out', '1.5'], r'held_out must be in [0, 1)'),
    ],
)
def test_bad_input_is_told(
    bag: Path, words: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    given = [str(bag) if word == 'BAG' else word for word in words]
    assert main(['identify', 'model', *given, '--robot', str(ROBOT)]) == 1
    assert says in capsys.readouterr().err
