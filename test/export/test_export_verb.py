"""`denoc export`: the file, what it says beside it, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest

from denoc_ros.cli.main import main

ROBOTS = Path(__file__).resolve().parents[2] / 'config' / 'robots'


def test_an_exported_robot_has_its_joints_motors_and_frames(tmp_path: Path) -> None:
    file = tmp_path / 'arm.xml'
    robot = ROBOTS / 'canadarm_gauges.urdf'
    assert main(['export', 'mjcf', str(robot), '-o', str(file), '--segments', '5']) == 0
    root = ElementTree.parse(file).getroot()
    joints = {joint.get('name') for joint in root.iter('joint') if joint.get('name')}
    assert {'joint_1', 'joint_2', 'joint_3', 'link_2/rod5/y'} <= joints
    assert [motor.get('joint') for motor in root.iter('motor')] == [
        'joint_1',
        'joint_2',
        'joint_3',
    ]
    assert {'tool', 'link_1/tip'} <= {site.get('name') for site in root.iter('site')}
    described = ElementTree.parse(robot).getroot().iter('sensor')
    assert [s.get('name') for s in root.iter('tendonpos')] == [s.get('name') for s in described]


def test_an_sdf_is_written_and_is_not_verified(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = str(ROBOTS / 'canadarm.urdf')
    command = ['export', 'sdf', robot, '-o', str(tmp_path / 'arm.sdf'), '--segments', '4']
    assert main([*command, '--verify']) == 1
    assert '--verify must come with mjcf' in capsys.readouterr().err
    assert main(command) == 0
    assert 'note: gravity: that of the world' in capsys.readouterr().err
    root = ElementTree.parse(tmp_path / 'arm.sdf').getroot()
    assert {'joint_1', 'link_2/rod4/y'} <= {joint.get('name') for joint in root.iter('joint')}


def test_verify_prints_frequencies_and_sag_beside_ours(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ['export', 'mjcf', str(ROBOTS / 'ship_boom.urdf'), '--verify', '-o']
    assert main([*command, str(tmp_path / 'a.xml')]) == 0
    said = capsys.readouterr()
    assert 'model_hz' in said.out
    assert 'mujoco_m' in said.out
    assert 'note: modal damping' in said.err
    assert (
        main([*command, str(tmp_path / 'b.xml'), '--json', '--at', 'luff=0', '--at', 'luff=1'])
        == 0
    )
    verified = json.loads(capsys.readouterr().out)['verified']
    assert [found['at'] for found in verified] == ['0, 0', '0, 1']
    for found in verified:
        assert len(found['natural_frequencies']) == 4
        assert all(abs(row['segments_percent']) < 0.3 for row in found['natural_frequencies'])
        assert all(abs(row['segments_percent']) < 0.1 for row in found['sag'])


def test_a_payload_of_the_command_line_is_exported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lowest = []
    for mass in ('1', '30'):
        out = str(tmp_path / f'{mass}.xml')
        payload = ['--payload', f'tool={mass}', '--verify', '--json']
        assert main(['export', 'mjcf', str(ROBOTS / 'canadarm.urdf'), '-o', out, *payload]) == 0
        found = json.loads(capsys.readouterr().out)['verified'][0]
        lowest.append(found['natural_frequencies'][0]['mujoco_hz'])
    assert lowest[1] < 0.95 * lowest[0]


@pytest.mark.parametrize('form', ['mjcf', 'sdf'])
def test_a_payload_of_the_file_is_exported_as_that_of_the_command_line(
    tmp_path: Path, form: str
) -> None:
    source = ROBOTS / 'canadarm.urdf'
    text = source.read_text()
    element = '<payload link="tool" mass="7.5" com="0.1 0 0.2"/></flexibility>'
    (tmp_path / 'canadarm.urdf').write_text(text.replace('</flexibility>', element))
    made = []
    for name, robot, given in (
        ('of_file', tmp_path / 'canadarm.urdf', []),
        ('of_line', source, ['--payload', 'tool=7.5,0.1,0,0.2']),
        ('without', source, []),
    ):
        out = tmp_path / name
        assert main(['export', form, str(robot), '-o', str(out), *given]) == 0
        made.append(out.read_text())
    assert made[0] == made[1] != made[2]


def test_a_rigid_robot_has_nothing_to_verify(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / 'a.xml')
    assert main(['export', 'mjcf', str(ROBOTS / 'ur10.urdf'), '-o', out, '--verify']) == 0
    assert 'no beam bends' in capsys.readouterr().out


def test_an_existing_file_stays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / 'arm.xml'
    file.write_text('mine')
    assert main(['export', 'mjcf', str(ROBOTS / 'ur10.urdf'), '-o', str(file)]) == 1
    assert file.read_text() == 'mine'
    assert 'must not exist yet' in capsys.readouterr().err


def test_what_cannot_be_exported_leaves_no_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'arm.xml'
    assert main(['export', 'mjcf', str(ROBOTS / 'puma.urdf'), '-o', str(file)]) == 1
    assert "link 'link_5': inertia must be that of a real body" in capsys.readouterr().err
    assert not file.exists()


def test_visuals_are_drawn_and_what_is_not_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (ROBOTS / 'rigid_pendulum.urdf').read_text()
    mesh = '<visual><geometry><mesh filename="{}"/></geometry></visual></link>'
    (tmp_path / 'cube.obj').write_text(
        'v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n'
    )
    drawn = text.replace('</link>', mesh.format('cube.obj'), 2)
    drawn = drawn.replace('</link>', mesh.format('gone.dae'), 2)
    (tmp_path / 'robot.urdf').write_text(drawn)
    out = tmp_path / 'arm.xml'
    assert main(['export', 'mjcf', str(tmp_path / 'robot.urdf'), '-o', str(out), '--verify']) == 0
    geoms = list(ElementTree.parse(out).getroot().iter('geom'))
    assert any(geom.get('type') == 'mesh' for geom in geoms)
    assert "visual 'gone.dae' is left out" in capsys.readouterr().err
