"""Numbers that no measurement of a robot depends on count in no verdict of the whole."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import denoc_ros as dn
from denoc_ros.dynamics.robot import Robot
from denoc_ros.identification.model.free_parameters import FreeParameters
from denoc_ros.identification.model.information import Information, combinations
from denoc_ros.identification.model.model_fit import IdentifiedModel

ROBOTS = Path(__file__).parents[3] / 'config' / 'robots'


@pytest.fixture(scope='module')
def planar() -> Robot:
    return dn.load_robot(ROBOTS / 'canadarm_gauges.urdf', gravity=(0.0, 0.0, 0.0))


def idle(robot: Robot, free: list[str]) -> set[str]:
    """Return the paths without effect."""
    parameters = FreeParameters(robot, free)
    found = zip(parameters.paths, parameters.has_effect, strict=True)
    return {path for path, has_effect in found if not has_effect}


def test_a_load_may_lie_anywhere_across_the_plane_of_a_planar_robot(planar: Robot) -> None:
    free = ['payload.tool', 'beam.*.y.ei', 'beam.*.y.damping_ratio', 'joint.*.damping']
    assert idle(planar, free) == {'payload.tool.com.z'}


def test_in_a_tilted_joint_every_coordinate_of_the_load_counts(planar: Robot) -> None:
    text = (ROBOTS / 'canadarm_gauges.urdf').read_text(encoding='utf-8')
    last = text.index('<axis xyz="0 0 1"/>', text.index('name="joint_3"'))
    tilted = f'{text[:last]}<axis xyz="0 0.6 0.8"/>{text[last + len("<axis xyz=+0 0 1+/>") :]}'
    robot = dn.load_robot(tilted, gravity=(0.0, 0.0, 0.0))
    assert idle(robot, ['payload.tool']) == set()


@pytest.mark.parametrize(('gravity', 'is_idle'), [(0.0, True), (-9.81, False)])
def test_bending_across_the_plane_needs_a_force_across_it(gravity: float, is_idle: bool) -> None:
    """A beam that no motion bends across the plane shows neither rigidity nor damping there."""
    text = (ROBOTS / 'canadarm_gauges.urdf').read_text(encoding='utf-8')
    both = text.replace(
        '<bending direction="y" ei="200000" modes="2" damping_ratio="0.005"/>',
        '<bending direction="y" ei="200000" modes="2" damping_ratio="0.005"/>'
        '<bending direction="z" ei="200000" modes="2" damping_ratio="0.005"/>',
    )
    robot = dn.load_robot(both, gravity=(0.0, 0.0, gravity))
    across = {'beam.link_2.z.ei', 'beam.link_2.z.damping_ratio'}
    assert idle(robot, ['beam.*.ei', 'beam.*.damping_ratio']) == (across if is_idle else set())


def test_numbers_without_effect_are_the_zero_columns_of_the_regressor() -> None:
    puma = dn.load_robot(ROBOTS / 'puma.urdf')
    parameters = FreeParameters(puma, ['link.*.inertial'])
    states = np.random.default_rng(2).standard_normal((3, 100, puma.n))
    regressor = puma.torque_regressor(states[0], states[1], states[2], list(parameters.paths))
    sizes = np.abs(regressor).max(axis=(0, 1)) * parameters.scales(np.zeros(parameters.size))
    zero = {p for p, size in zip(parameters.paths, sizes, strict=True) if size < 1e-9}
    assert idle(puma, ['link.*.inertial']) == zero
    assert {'link.link_1.mass', 'link.link_1.inertia.ixx'} <= zero


def test_a_column_without_effect_needs_no_simulation(planar: Robot) -> None:
    parameters = FreeParameters(planar, ['payload.tool'])
    searched = dict(zip(parameters.paths, parameters.is_searched, strict=True))
    assert searched == {path: not path.endswith('.z') for path in parameters.paths}


def model(planar: Robot, verdict: dict[str, str], without: tuple[str, ...]) -> IdentifiedModel:
    nothing: dict[str, float] = {}
    return IdentifiedModel(
        nothing, nothing, {}, nothing, verdict, [], (), (), {}, {}, planar, 0.0, 0, without
    )


def test_the_whole_is_judged_by_the_numbers_that_can_be_told(planar: Robot) -> None:
    verdict = {'mass': 'found', 'com.x': 'doubtful', 'com.z': 'not identifiable'}
    found = model(planar, verdict, ('com.z',))
    assert found.whole_verdict == 'doubtful'
    assert replace(found, verdict={**verdict, 'com.x': 'found'}).whole_verdict == 'found'
    # what is merely badly excited counts
    assert replace(found, without_effect=()).whole_verdict == 'not identifiable'
    # nothing at all can be told
    assert replace(found, without_effect=tuple(verdict)).whole_verdict == 'not identifiable'


def test_numbers_without_effect_are_listed_apart_from_those_that_the_data_do_not_tell() -> None:
    names, factors = ['mass', 'com.y', 'com.z'], np.zeros(3, dtype=bool)
    info = Information(np.array([0.1, np.inf, np.inf]), np.eye(3)[:, 1:], np.zeros((3, 3)))
    assert combinations(info, names, factors, np.array([True, True, False])) == [
        'no measurement of this robot depends on com.z, whatever the motion',
        'nothing is seen of com.y',
    ]
