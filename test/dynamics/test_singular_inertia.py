"""A joint that moves no inertia is named wherever an acceleration is asked of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from strategies import seeded_robot

from denoc_ros.cli.main import main
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.dynamics.singular_inertia import coordinates_without_inertia
from denoc_ros.errors import SolverError

BODY = (
    '<inertial><origin xyz="0.1 0.02 0"/><mass value="1"/>'
    '<inertia ixx="0.01" iyy="0.01" izz="0.01"/></inertial>'
)
POINT = '<inertial><mass value="0.012"/><inertia ixx="0" iyy="0" izz="0"/></inertial>'


def chain(*links: tuple[str, str], more: str = '') -> str:
    """Return a chain of joints from each link's inertial and its joint's axis, 0.2 m apart."""
    text = '<link name="l0"/>'
    for k, (inertial, axis) in enumerate(links, 1):
        text += (
            f'<link name="l{k}">{inertial}</link><joint name="j{k}" type="continuous">'
            f'<parent link="l{k - 1}"/><child link="l{k}"/><origin xyz="{0.2 * (k > 1)} 0 0"/>'
            f'<axis xyz="{axis}"/></joint>'
        )
    return f'<robot name="arm">{text}{more}</robot>'


WRIST = chain((BODY, '0 0 1'), (BODY, '0 1 0'), (POINT, '1 0 0'))
COAXIAL = chain(('', '1 0 0'), (BODY, '1 0 0'))


@pytest.mark.parametrize(('text', 'joint'), [(WRIST, 'j3'), (COAXIAL, 'j1')])
def test_the_joint_without_inertia_is_in_the_error(text: str, joint: str) -> None:
    robot = load_robot(text)
    zero = np.zeros(robot.n)
    assert list(coordinates_without_inertia(robot)) == [joint]
    named = rf"arm: the inertia must be positive definite, got none of '{joint}': .*<actuator"
    for verb in (robot.forward_dynamics, robot.forward_dynamics_derivatives):
        for q in (zero, np.zeros((3, robot.n))):
            with pytest.raises(SolverError, match=named):
                verb(q, q, q)


@pytest.mark.parametrize(
    'text',
    [
        chain((BODY, '0 0 1'), (BODY, '0 1 0'), (BODY, '1 0 0')),
        WRIST.replace('name="j3" type="continuous"', 'name="j3" type="fixed"'),
        chain(
            (BODY, '0 0 1'),
            (BODY, '0 1 0'),
            (POINT, '1 0 0'),
            more='<flexibility><actuator joint="j3" armature="1e-6"/></flexibility>',
        ),
    ],
    ids=['inertia', 'fixed', 'armature'],
)
def test_each_remedy_gives_an_acceleration(text: str) -> None:
    robot = load_robot(text)
    zero = np.zeros(robot.n)
    assert not coordinates_without_inertia(robot)
    assert np.isfinite(robot.forward_dynamics(zero, zero, zero)).all()


@pytest.mark.parametrize('seed', range(12))
def test_robots_that_accelerate_lack_nothing(seed: int) -> None:
    robot: Robot = load_robot(seeded_robot(seed))
    zero = np.zeros(robot.n)
    assert np.isfinite(robot.forward_dynamics(zero, zero, zero)).all()
    assert not coordinates_without_inertia(robot)


def test_a_posture_without_inertia_is_named_and_the_others_are_free() -> None:
    """A rod along the axis has none about it; a turned one has."""
    rod = (
        '<inertial><origin xyz="0.1 0 0"/><mass value="1"/>'
        '<inertia ixx="0" iyy="0.01" izz="0.01"/></inertial>'
    )
    robot = load_robot(chain(('', '1 0 0'), (rod, '0 0 1')))
    assert not coordinates_without_inertia(robot)
    zero = np.zeros(2)
    assert list(coordinates_without_inertia(robot, zero)) == ['j1']
    with pytest.raises(SolverError, match="got none of 'j1'"):
        robot.forward_dynamics(zero, zero, zero)


def test_a_simulation_names_the_joint(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / 'arm.urdf').write_text(WRIST)
    (tmp_path / 'fall.yaml').write_text('duration: 0.1\n')
    command = ['simulate', str(tmp_path / 'arm.urdf'), str(tmp_path / 'fall.yaml')]
    assert main([*command, '-o', str(tmp_path / 'run.mcap')]) == 1
    said = capsys.readouterr().err
    assert "denoc simulate: arm: the inertia must be positive definite, got none of 'j3'" in said
