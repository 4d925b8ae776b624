"""`denoc check`: what a robot is made of, or everything that is wrong with it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from planar_chains import FLEXIBLE, RIGID, planar_chain

from denoc_ros.cli.main import main
from denoc_ros.dynamics.robot import load_robot


def test_every_shipped_robot_passes(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robots = sorted((repository / 'config' / 'robots').glob('*.urdf'))
    load_robot(robots[0])  # on a fresh machine this says that it compiles
    capsys.readouterr()
    for robot in robots:
        assert main(['check', str(robot)]) == 0, robot.name
        captured = capsys.readouterr()
        assert captured.err == '', robot.name
        assert '\njoints\n' in captured.out


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


def test_warning_of_a_rounded_inertia_is_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'arm.urdf'
    printed = planar_chain([FLEXIBLE]).replace('izz="0.4166666666666667"', 'izz="0.41660"')
    file.write_text(printed)
    assert main(['check', str(file)]) == 0
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
