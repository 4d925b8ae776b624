"""`denoc check`: what a robot is made of, or everything that is wrong with it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from planar_chains import FLEXIBLE, RIGID, planar_chain
from segmented_robots import spatial_text

from denoc_ros.cli.main import main
from denoc_ros.dynamics.robot import load_robot

TIP_JOINT = (
    '<joint name="tip_joint" type="continuous"><parent link="link_2"/><child link="tip"/>'
    '<axis xyz="0 0 1"/></joint>'
)


@pytest.mark.long
def test_every_shipped_robot_passes(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robots = sorted((repository / 'config' / 'robots').glob('*.urdf'))
    load_robot(robots[0])  # on a fresh machine this says that it compiles
    capsys.readouterr()
    for robot in robots:
        # the wrists of the book's robots have an inertia about their own joints alone
        doubtful = robot.stem in ('puma', 'stanford', 'stanford_flexible')
        assert main(['check', str(robot)]) == (2 if doubtful else 0), robot.name
        captured = capsys.readouterr()
        doubts = [line.partition(": link 'link_")[2][:1] for line in captured.err.splitlines()]
        assert set(doubts) == (set('456') if doubtful else set()), robot.name
        assert '\nlinks\n' in captured.out


def test_a_posture_is_given_in_order_or_by_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'arm.urdf'
    file.write_text(planar_chain([RIGID, FLEXIBLE]))
    given = [['0', '0.7'], ['joint_2=0.7'], ['joint_1=0,joint_2=0.7'], ['0', '-0.4']]
    said = []
    for at in given:
        assert main(['check', str(file), '--json', '--at', *at]) == 0
        said.append(json.loads(capsys.readouterr().out))
    assert said[0] == said[1] == said[2] != said[3]


def test_joints_of_beams_without_rotors_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, named = tmp_path / 'arm.urdf', []
    text = planar_chain([RIGID, FLEXIBLE, RIGID])
    rotor = '<actuator joint="joint_3" armature="1"/></flexibility>'
    for more in ('</flexibility>', rotor):
        file.write_text(text.replace('</flexibility>', more))
        assert main(['check', str(file)]) == 0
        (line,) = (x for x in capsys.readouterr().out.splitlines() if 'no rotor inertia' in x)
        named.append(line.partition(':')[0])
    assert named == ['no rotor inertia of joint_2, joint_3', 'no rotor inertia of joint_2']
    file.write_text(planar_chain([RIGID, RIGID]))
    assert main(['check', str(file)]) == 0
    assert 'rotor' not in capsys.readouterr().out


def test_json_has_masses_and_the_cantilever_frequency(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'arm.urdf'
    file.write_text(planar_chain([RIGID, FLEXIBLE]))
    assert main(['check', str(file), '--json', '--gravity', '0', '0', '0']) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary['mass_kg'] == pytest.approx(10.0)
    assert summary['coordinates'] == ['joint_1', 'joint_2', 'link_2/y1', 'link_2/y2']
    assert [row['link'] for row in summary['links']] == ['link_1', 'link_2']
    assert [row['on'] for row in summary['links']] == ['base', 'link_1']
    assert summary['links'][1]['beam_mass_kg'] == pytest.approx(5.0)
    assert summary['joints'][0]['type'] == 'continuous'
    assert summary['joints'][0]['upper'] is None
    assert summary['beams'] == [
        {
            'link': 'link_2',
            'length_m': 1.0,
            'mass_per_length': 5.0,
            'ei_y': 1000.0,
            'modes_y': 2,
            'ei_z': None,
            'modes_z': 0,
            'gj': None,
            'modes_torsion': 0,
        }
    ]
    # beta_1^2 sqrt(EI / (m l^4)) / (2 pi), beta_1 = 1.8751041
    assert summary['natural_frequencies_hz'][0] == pytest.approx(7.91379, rel=1e-5)


def test_text_shows_links_joints_beams_and_frequencies(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'arm.urdf'
    file.write_text(planar_chain([RIGID, FLEXIBLE]))
    assert main(['check', str(file)]) == 0
    text = capsys.readouterr().out
    assert 'chain: 10 kg, 4 coordinates' in text
    for title in ('links', 'joints', 'beams', 'natural frequencies [Hz]'):
        assert title in text


def test_observability_of_modes_and_biases_is_told(
    repository: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (repository / 'config' / 'robots' / 'canadarm.urdf').read_text()
    imu = (
        '<sensor name="imu" type="imu" link="link_1" station="6" gyro_noise="1e-3" '
        'accel_noise="0.02" gyro_bias="0.01" accel_bias="0.05"/></flexibility>'
    )
    file = tmp_path / 'arm.urdf'
    file.write_text(text.replace('</flexibility>', imu))
    # gravity as on the ground: what bends turns it in the sensor's axes
    command = ['check', str(file), '--gravity', '0', '-9.81', '0', '--at', '0.2', '0.5', '-0.4']
    assert main([*command, '--json']) == 0
    summary = json.loads(capsys.readouterr().out)
    for rows in (summary['observability'], summary['postures'][0]['observability']):
        told = {row['state']: row for row in rows}
        assert told['mode 1']['observed'] == 'yes'
        assert told['imu/gyro_z']['uncertainty_left'] < 0.01
        assert all(0.0 < row['uncertainty_left'] <= 1.0 for row in rows)
        assert told['imu/accel_x']['hz'] is None
    assert main(command) == 0
    assert capsys.readouterr().out.count('observability, joints held at') == 2
    assert main(['check', str(repository / 'config' / 'robots' / 'canadarm.urdf')]) == 0
    assert 'observability' not in capsys.readouterr().out


def test_loops_have_rank_redundant_rows_and_degrees_of_freedom(
    repository: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def summary(name: str) -> dict[str, Any]:
        file = repository / 'config' / 'robots' / f'{name}.urdf'
        assert main(['check', str(file), '--json']) == 0
        found: dict[str, Any] = json.loads(capsys.readouterr().out)
        return found

    # Gruebler: a plane four-bar has 1 degree of freedom, a five-bar 2, three legs on a plate 3;
    # RSSR has 1, its coupler hanging on two crossed axes and a ball
    freedoms = {'four_bar_rrr': 1, 'five_bar_ffff': 2, 'planar_3dof_3rr': 3, 'rssr_rrr': 1}
    for name, freedom in freedoms.items():
        (mechanism,) = summary(name)['mechanism']
        assert mechanism['degrees_of_freedom'] == freedom, name
        assert mechanism['failure'] == '', name
    (loop,) = summary('four_bar_rrr')['loops']
    # a plane says nothing of what is across it
    assert (loop['rows'], loop['rank'], loop['redundant_rows']) == (5, 2, 3)
    assert main(['check', str(repository / 'config' / 'robots' / 'four_bar_rrr.urdf')]) == 0
    assert 'redundant_rows' in capsys.readouterr().out


def test_loop_that_cannot_close_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'open.urdf'
    loop = (
        '<loop name="far" type="spherical"><parent link="base" xyz="9 0 0"/>'
        '<child link="link_2"/></loop></flexibility>'
    )
    file.write_text(planar_chain([RIGID, FLEXIBLE]).replace('</flexibility>', loop))
    assert main(['check', str(file), '--json']) == 2
    summary = json.loads(capsys.readouterr().out)
    assert summary['loops'][0]['error_at_zero'] == pytest.approx(8.0)
    assert "'far' must close" in summary['mechanism'][0]['failure']
    assert summary['warnings'] == [f'mechanism: {summary["mechanism"][0]["failure"]}']


def test_warning_of_a_rounded_inertia_is_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'arm.urdf'
    printed = planar_chain([FLEXIBLE]).replace('izz="0.4166666666666667"', 'izz="0.41660"')
    file.write_text(printed)
    assert main(['check', str(file)]) == 2
    assert 'denoc check: warning: ' in capsys.readouterr().err


def test_bad_file_is_exit_status_1_with_every_finding(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'arm.urdf'
    file.write_text(
        planar_chain([FLEXIBLE, FLEXIBLE])
        .replace('ei="1000.0"', 'ei="-1"', 1)
        .replace('link="link_2" length', 'link="nobody" length')
    )
    assert main(['check', str(file)]) == 1
    captured = capsys.readouterr()
    assert captured.out == ''
    assert 'ei' in captured.err
    assert 'nobody' in captured.err
    assert 'Traceback' not in captured.err


def test_json_has_errors_warnings_and_hints_and_the_status_is_of_the_worst(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'arm.urdf'
    text = planar_chain([RIGID, FLEXIBLE, RIGID])
    massless = text.replace('</flexibility>', '</flexibility>' + '<link name="tip"/>' + TIP_JOINT)
    counts = []
    for robot in (planar_chain([RIGID, RIGID]), text, massless, text.replace('ei="', 'ei="-')):
        file.write_text(robot)
        status = main(['check', str(file), '--json'])
        captured = capsys.readouterr()
        found = json.loads(captured.out)
        counts.append((status, *(len(found[key]) for key in ('errors', 'warnings', 'hints'))))
        assert (captured.err != '') == (status == 1)
    assert counts == [(0, 0, 0, 0), (0, 0, 0, 2), (2, 0, 1, 2), (1, 1, 0, 0)]
    assert found['errors'][0].startswith(f"{file}: beam 'link_2': ei (direction y) must be > 0")


def test_a_joint_that_moves_no_inertia_is_named_with_the_ways_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'arm.urdf'
    text = planar_chain([RIGID, RIGID])
    file.write_text(text.replace('</robot>', f'<link name="tip"/>{TIP_JOINT}</robot>'))
    assert main(['check', str(file)]) == 2
    said = capsys.readouterr().err
    assert "warning: joint 'tip_joint': should move an inertia" in said
    assert 'make it fixed, or add <actuator joint="tip_joint" armature="…"/>' in said


def test_payloads_are_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / 'arm.urdf'
    load = '<payload link="link_2" mass="2.5" com="0.1 0 0"/></flexibility>'
    file.write_text(planar_chain([RIGID, FLEXIBLE]).replace('</flexibility>', load))
    assert main(['check', str(file), '--json']) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary['mass_kg'] == pytest.approx(12.5)
    (row,) = summary['payloads']
    assert (row['link'], row['mass_kg'], row['com_m']) == ('link_2', 2.5, [0.1, 0.0, 0.0])
    assert main(['check', str(file)]) == 0
    assert '\npayloads\n' in capsys.readouterr().out


def test_a_link_of_segments_is_one_row(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / 'arm.urdf'
    file.write_text(spatial_text(3))
    assert main(['check', str(file), '--json']) == 0
    summary = json.loads(capsys.readouterr().out)
    rows = {row['link']: row for row in summary['links']}
    assert sorted(rows) == ['fore', 'hand', 'middle', 'side', 'upper']
    assert summary['mass_kg'] == pytest.approx(2.5 + 0.5 + 4 * 0.2)
    assert rows['upper']['beam_mass_kg'] == pytest.approx(0.6 * 0.95)
    assert rows['upper']['modes'] == 18
    assert (rows['middle']['on'], rows['fore']['on']) == ('fore', 'upper')
    assert rows['middle']['station_m'] == pytest.approx(0.6)
    beams = {row['link']: row for row in summary['beams']}
    assert (beams['upper']['length_m'], beams['upper']['segments']) == (0.95, 3)
