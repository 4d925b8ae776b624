"""Springs proposed for joints by the gears that they are taken to have."""

from __future__ import annotations

import json

import numpy as np
import pytest
from geared_arm import arm_text
from small_robots import block, joint, link

import denoc_ros as dn
from denoc_ros.cli.main import main
from denoc_ros.reduction.suggest.gears import GEARS

LIMIT = '<limit lower="-3" upper="3" velocity="2" effort="{effort}"/>'


def limited(name: str, parent: str, child: str, effort: float, kind: str = 'revolute') -> str:
    limit = LIMIT.format(effort=effort)
    return joint(name, parent, child, kind=kind).replace('</joint>', f'{limit}</joint>')


def robot_text(*extra: str) -> str:
    links = ''.join(link(name) for name in ('base', 'a', 'b', 'c', 'd', 'e'))
    parts = (
        limited('turn', 'base', 'a', 204.0),
        limited('slide', 'a', 'b', 50.0, 'prismatic'),
        limited('slack', 'b', 'c', 0.0),
        joint('held', 'c', 'd', kind='fixed'),
        limited('follow', 'd', 'e', 10.0).replace('</joint>', '<mimic joint="turn"/></joint>'),
    )
    return f'<robot name="r">{links}{"".join(parts)}{"".join(extra)}</robot>'


@pytest.mark.parametrize('name', GEARS)
def test_a_gear_is_the_stiffer_the_larger_it_is(name: str) -> None:
    family = GEARS[name]
    np.testing.assert_allclose(
        [family.of_torque(torque) for torque in family.torque], family.stiffness, rtol=1e-12
    )
    torque = np.geomspace(1.0, 1e5, 200)
    stiffness = np.array([family.of_torque(value) for value in torque])
    assert (np.diff(stiffness) > 0.0).all()
    # of one torque, gears wind up by minutes of arc: neither tenths of a minute nor degrees
    angle = np.degrees(torque / stiffness) * 60.0
    assert (angle > 2.0).all()
    assert (angle < 60.0).all()


def test_joints_with_an_effort_get_springs_and_rotors() -> None:
    found = dn.suggest_flexibility(robot_text(), gears='strain_wave')
    (spring,) = found.springs
    assert (spring.joint, spring.effort) == ('turn', 204.0)
    assert spring.stiffness == pytest.approx(5e4)
    assert spring.armature == pytest.approx(2.04)
    assert found.stiff.keys() == {'slide', 'slack', 'follow'}
    assert 'has no effort' in found.stiff['slack']
    assert 'Assumed: strain wave gears' in found.text
    robot = dn.load_robot(found.text)
    assert 'turn/spring' in robot.coordinate_names
    assert not any('armature' in warning for warning in robot.tree.warnings)


def test_what_a_robot_says_of_its_joints_stays() -> None:
    actuator = block('<actuator joint="turn" armature="0.7"/>')
    (spring,) = dn.suggest_flexibility(robot_text(actuator), gears='cycloidal').springs
    assert spring.armature is None
    found = dn.suggest_flexibility(arm_text(), gears='planetary')
    assert found.springs == ()
    assert found.stiff == {}
    assert dn.suggest_flexibility(robot_text()).gears is None


def test_joints_of_loops_are_left_stiff() -> None:
    loop = '<loop name="pin" type="spherical"><parent link="base"/><child link="a"/></loop>'
    found = dn.suggest_flexibility(robot_text(block(loop)), gears='strain_wave')
    assert found.stiff['turn'] == 'a loop closes over it'


def test_unknown_gears_are_refused() -> None:
    with pytest.raises(dn.ConfigError, match=r'gears must be one of strain_wave, .*, got .worm.'):
        dn.suggest_flexibility(robot_text(), gears='worm')


def test_check_proposes_springs(
    tmp_path: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = f'{tmp_path}/plain.urdf', f'{tmp_path}/geared.urdf'
    with open(file, 'w', encoding='utf-8') as stream:
        stream.write(robot_text())
    given = ['check', file, '--suggest', '--gears', 'strain_wave']
    assert main([*given, '-o', out]) == 0
    shown = capsys.readouterr().out
    assert 'springs, assumed: strain wave gears' in shown
    assert 'joints left stiff' in shown
    assert dn.load_robot(out).n == 5
    assert main([*given, '--json']) == 0
    row = json.loads(capsys.readouterr().out)
    assert [spring['joint'] for spring in row['springs']] == ['turn']
    assert main(['check', file, '--gears', 'strain_wave']) == 1
    assert '--gears must come with --suggest' in capsys.readouterr().err
