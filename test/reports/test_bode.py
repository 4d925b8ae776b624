"""`denoc check --bode` and `--at`: would a loop ring, at which postures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from beam_closed_forms import HubBeam, roots
from beam_robots import beam_robot
from page_look import require_one_look

from denoc_ros.cli.main import main
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.reports.loop_response import loop_response

BEAM = HubBeam(ei=120.0, density=1.5, length=1.6, tip_mass=0.8, hub=0.35)
ROBOT = 'config/robots/canadarm_gauges.urdf'
FLAT = ('--gravity', '0', '0', '0')


def ways(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[dict[str, Any]]:
    assert main(['check', *arguments, '--json']) == 0
    found: list[dict[str, Any]] = json.loads(capsys.readouterr().out)['ways']
    return found


def test_a_stiff_loop_leaves_the_clamped_modes_and_a_tip_is_not_minimum_phase() -> None:
    robot = beam_robot(BEAM, 6, ratio=0.001)
    hub, tip, gauge = (
        loop_response(robot, np.zeros(robot.n), 'hub', output)
        for output in ('hub', 'tip', 'gauge')
    )
    clamped = roots(BEAM.clamped, 2, 0.3, -1) / (2 * np.pi)
    found = [zero.frequency for zero in hub.swinging_zeros[:2]]
    np.testing.assert_allclose(found, clamped, rtol=1e-3)
    assert hub.collocated
    assert hub.rings
    assert f'is expected to ring: stiff, it clamps the joint, and the links keep vibrating at ' \
        f'{found[0]:.3g} Hz' in hub.sentence()  # fmt: skip
    # damping moves it too
    assert tip.unstable_zero == pytest.approx(roots(BEAM.to_tip, 1, 0.3, 1)[0], rel=1e-2)
    assert tip.unit == 'm/(N m)'
    assert 'keeps it below about 3.1 Hz' in tip.sentence()
    # the tip answers its first mode against the hub's turn; all of the hub's modes answer alike
    assert tip.opposed[0].frequency == pytest.approx(tip.swinging_poles[0].frequency)
    assert not hub.opposed
    assert gauge.unit == '1/(N m)'
    assert not gauge.opposed or gauge.opposed[0].frequency > gauge.swinging_poles[0].frequency


def test_a_damped_or_rigid_link_does_not_ring(repository: Path) -> None:
    robot = beam_robot(BEAM, 2, ratio=0.5)
    way = loop_response(robot, np.zeros(robot.n), 'hub', 'hub')
    assert not way.rings
    assert 'is not expected to ring' in way.sentence()
    rigid = load_robot(repository / 'config/robots/ur10.urdf')
    joint = rigid.joint_names[1]
    way = loop_response(rigid, np.zeros(rigid.n), joint, joint)
    assert not way.rings
    assert way.sentence() == (
        f'A loop on {joint} alone cannot ring: no link vibrates while it is held.'
    )


def test_other_joints_are_held_unless_free(capsys: pytest.CaptureFixture[str]) -> None:
    held, free = (
        ways(capsys, ROBOT, *FLAT, '--bode', 'joint_1:joint_1', '-o', '/dev/null', *more)[0]
        for more in ((), ('--free',))
    )
    assert len(held['poles']) == len(free['poles']) == 4
    assert held['poles'][0]['frequency_hz'] < 0.5 * free['poles'][0]['frequency_hz']


def test_page_has_each_way_at_each_posture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / 'ring.html'
    bode = ['--bode', 'joint_1:joint_1', '--bode', 'joint_1:tool', '--bode', 'joint_2:tool/y']
    at = ['--at', '0.2', '0.5', '-0.4', '--at', '0,1.5,0']
    assert main(['check', ROBOT, *FLAT, *bode, *at, '-o', str(page)]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert shown[0] == str(page)
    assert len(shown) == 7
    assert shown[1].startswith('joint_1 to joint_1, joints at (0.2, 0.5, -0.4): A collocated loop')
    text = page.read_text()
    for heading in ('joint_1 to joint_1', 'joint_1 to tool', 'joint_2 to tool/y'):
        assert f'<h2>{heading}</h2>' in text
    assert text.count('<figure>') == 6
    assert text.count('Poles and zeros at (0, 1.5, 0)') == 3
    require_one_look(text, str(tmp_path))


def test_a_mechanism_keeps_its_loops_closed(capsys: pytest.CaptureFixture[str]) -> None:
    robot = 'config/robots/five_bar_ffff.urdf'
    (way,) = ways(capsys, robot, *FLAT, '--bode', 'joint_1:joint_1', '-o', '/dev/null')
    assert way['rings']
    assert way['zeros'][0]['frequency_hz'] > 10.0


def test_natural_frequencies_at_postures(capsys: pytest.CaptureFixture[str]) -> None:
    at = ['--at', '0', '1.5', '0', '--at', '0.2,0.5,-0.4']
    assert main(['check', ROBOT, *FLAT, *at, '--json']) == 0
    summary = json.loads(capsys.readouterr().out)
    robot = load_robot(ROBOT, gravity=(0, 0, 0))
    assert [row['at'] for row in summary['postures']] == [[0, 1.5, 0], [0.2, 0.5, -0.4]]
    for row in summary['postures']:
        q = robot.static_deflection(row['at'])
        np.testing.assert_allclose(row['natural_frequencies_hz'], robot.natural_frequencies(q))
    bent, straight = summary['postures'][0], summary['natural_frequencies_hz']
    assert bent['natural_frequencies_hz'][0] > 1.01 * straight[0]
    assert main(['check', ROBOT, *FLAT, *at]) == 0
    shown = capsys.readouterr().out
    assert 'natural frequencies [Hz], joints held at (0, 1.5, 0), in equilibrium' in shown


@pytest.mark.parametrize(
    ('arguments', 'says'),
    [
        (['--at', '1', '2'], "(joint_1, joint_2, joint_3) or JOINT=VALUE, got '1 2'"),
        (['--at', 'elbow=1'], "(joint_1, joint_2, joint_3) or JOINT=VALUE, got 'elbow=1'"),
        (['--at', 'joint_1=1', '2', '3'], "JOINT=VALUE, got 'joint_1=1 2 3'"),
        (
            ['--at', '1', 'x', '2'],
            "--at must be 3 numbers (joint_1, joint_2, joint_3) or JOINT=VALUE, got '1 x",
        ),
        (['--bode', 'joint_1'], "--bode must be IN:OUT, such as joint_2:tool, got 'joint_1'"),
        (['--bode', 'joint_9:tool'], "joints must be different ones of ('joint_1', 'joint_2'"),
        (['--bode', 'joint_1:nose'], 'output must be a joint or sensor (joint_1, joint_2, '),
        (['--free'], '--free must come with --bode, got it alone'),
        (['-o', 'x.html'], '--output must come with --suggest, got it alone'),
        (['--suggest', '--bode', 'a:b'], '--suggest must come without --bode and --at, got both'),
        (['--bode', 'joint_1:tool', '-o', 'no/x.html'], 'no/x.html: the file must be writable'),
    ],
)
def test_wrong_options_are_a_message(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['check', ROBOT, *arguments]) == 1
    assert says in capsys.readouterr().err
