"""`denoc check --suggest`: a plain URDF becomes flexible, or is told why not."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from suggested_robots import EI, tube_arm

from denoc_ros.cli.main import build_parser, main
from denoc_ros.reduction.suggest.materials import MATERIALS


@pytest.fixture
def boom(tmp_path: Path) -> Path:
    file = tmp_path / 'boom.urdf'
    file.write_text(tube_arm())
    return file


def test_file_written_passes_the_check(
    boom: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / 'flexible.urdf'
    assert main(['check', str(boom), '--suggest', '-o', str(output)]) == 0
    shown = capsys.readouterr()
    assert f'{output}: written' in shown.out
    assert 'high confidence' in shown.out
    assert 'damping ratio 0.005 is assumed' in shown.out
    assert 'no rotor inertia yet of shoulder' in shown.out
    assert shown.err == ''
    assert main(['check', str(output), '--json']) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary['warnings'] == []
    (beam,) = summary['beams']
    assert beam['ei_y'] == pytest.approx(EI, rel=0.02)


def test_what_was_edited_is_not_overwritten(
    repository: Path, boom: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = repository / 'config' / 'dh' / 'canadarm.yaml'
    before = boom.read_text(encoding='utf-8')
    for arguments in (['check', str(boom), '--suggest'], ['dh', str(table)]):
        assert main([*arguments, '-o', str(boom)]) == 1
        assert f'{boom}: output must not exist yet' in capsys.readouterr().err
    assert boom.read_text(encoding='utf-8') == before


def test_json_has_every_link_with_its_reason(
    boom: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['check', str(boom), '--suggest', '--json', '--material', 'steel']) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['material']['name'] == 'steel'
    (beam,) = found['beams']
    assert beam['proposed']
    assert beam['ei_low'] <= beam['ei_y'] <= beam['ei_high']
    assert [row['link'] for row in found['refused']] == ['tool']
    assert len(found['natural_frequencies_hz']) == sum(beam['modes'])
    assert found['written'] is None
    assert found['without_armature'] == ['shoulder']
    geared = '<flexibility><actuator joint="shoulder" armature="1"/></flexibility></robot>'
    boom.write_text(boom.read_text().replace('</robot>', geared))
    assert main(['check', str(boom), '--suggest', '--json']) == 0
    assert json.loads(capsys.readouterr().out)['without_armature'] == []


def test_stiff_robot_is_exit_status_2_and_writes_nothing(
    repository: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / 'flexible.urdf'
    robot = str(repository / 'config' / 'robots' / 'ur10.urdf')
    assert main(['check', robot, '--suggest', '-o', str(output)]) == 2
    assert 'stiff: bends by' in capsys.readouterr().out
    assert not output.exists()
    asked = ['--link', 'upper_arm_link', '--link', 'forearm_link']
    assert main(['check', robot, '--suggest', *asked, '-o', str(output)]) == 0
    assert output.read_text(encoding='utf-8').count('<beam ') == 2


def test_bad_wishes_are_exit_status_1(
    boom: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for arguments, message in (
        (['--material', 'steel'], '--material must come with --suggest, got it alone'),
        (['--suggest', '--material', 'cheese'], 'material must be one of aluminium'),
        (['--suggest', '--link', 'nobody'], 'link must be one of base, boom, tool'),
        (['--suggest', '-o', str(tmp_path / 'no' / 'x.urdf')], 'the file must be writable'),
    ):
        assert main(['check', str(boom), *arguments]) == 1
        shown = capsys.readouterr()
        assert message in shown.err
        assert 'Traceback' not in shown.err


def test_help_names_every_material(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        build_parser(['check']).parse_args(['check', '--help'])
    shown = capsys.readouterr().out
    assert [name for name in MATERIALS if name not in shown] == []
