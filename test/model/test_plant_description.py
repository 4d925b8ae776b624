"""Laws of a plant that is described otherwise than its model."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from segmented_robots import spatial_text

import denoc_ros as dn
from denoc_ros.model.plant_description import (
    PlantDescription,
    description_in_words,
    read_plant,
)

CANADARM = Path(__file__).parents[2] / 'config' / 'robots' / 'canadarm_gauges.urdf'


def plant(robot: dn.Robot, **described: Any) -> dn.Robot:
    return robot.with_overrides(PlantDescription(**described).overrides(robot.tree))


@pytest.fixture(scope='module')
def canadarm() -> dn.Robot:
    text = CANADARM.read_text().replace('clamped-free', 'craig-bampton')
    return dn.load_robot(text, gravity=(0.0, -1.0, 0.0))


@pytest.mark.parametrize(
    'described',
    [{'modes': 2}, {'shape': 'craig-bampton'}, {'segments': 1}, {'modes': 2, 'segments': 1}],
)
def test_plant_described_as_its_model_is_the_model(
    canadarm: dn.Robot, described: dict[str, Any]
) -> None:
    same = plant(canadarm, **described)
    q, qd, tau = np.random.default_rng(1).uniform(-0.1, 0.1, (3, canadarm.n))
    assert same.coordinate_names == canadarm.coordinate_names
    np.testing.assert_array_equal(
        same.forward_dynamics(q, qd, tau), canadarm.forward_dynamics(q, qd, tau)
    )
    np.testing.assert_array_equal(same.sensor_values(q, qd), canadarm.sensor_values(q, qd))


def test_plant_without_a_description_changes_nothing(canadarm: dn.Robot) -> None:
    assert not PlantDescription()
    assert PlantDescription().overrides(canadarm.tree) == {}


@pytest.mark.parametrize(
    ('described', 'coordinates', 'words'),
    [
        ({'modes': 4}, 3 + 2 * 4, 'craig-bampton, 4 modes'),
        ({'modes': 4, 'shape': 'clamped-free'}, 3 + 2 * 4, 'clamped-free, 4 modes'),
        ({'segments': 8}, 3 + 2 * 8 * 2, '8 segments per beam'),
        ({'segments': 8, 'modes': 1}, 3 + 2 * 8, '8 segments per beam'),
    ],
)
def test_richer_plants_keep_joints_masses_and_damping(
    canadarm: dn.Robot, described: dict[str, Any], coordinates: int, words: str
) -> None:
    rich = plant(canadarm, **described)
    assert rich.n == coordinates
    assert rich.joint_names == canadarm.joint_names
    assert description_in_words(rich.tree) == words
    own, theirs = (
        robot.inertia_matrix(np.zeros(robot.n))[np.ix_(robot.joint_indices, robot.joint_indices)]
        for robot in (canadarm, rich)
    )
    np.testing.assert_allclose(theirs, own, rtol=1e-12)
    # segments damp in proportion to stiffness, modes of one beam each by its own ratio
    posture = np.zeros(rich.n)
    damped = rich.natural_modes(posture).damping_ratios[0]
    assert damped == pytest.approx(
        canadarm.natural_modes(np.zeros(canadarm.n)).damping_ratios[0], rel=0.3
    )


def test_richer_plants_are_softer(canadarm: dn.Robot) -> None:
    """Every description bounds the lowest frequency from above."""
    model = canadarm.natural_frequencies(np.zeros(canadarm.n))[0]
    for described in ({'modes': 4}, {'segments': 8}):
        rich = plant(canadarm, **described)
        assert rich.natural_frequencies(np.zeros(rich.n))[0] < model
    crude = plant(canadarm, shape='clamped-free')
    assert crude.natural_frequencies(np.zeros(crude.n))[0] > 1.02 * model


def test_torsion_gets_as_many_modes_and_a_rigid_direction_none() -> None:
    robot = dn.load_robot(spatial_text(1))
    rich = plant(robot, modes=3)
    for before, after in zip(robot.tree.bodies, rich.tree.bodies, strict=True):
        if before.beam is not None:
            assert after.beam is not None
            assert after.beam.modes == tuple(3 if modes else 0 for modes in before.beam.modes)


def test_segments_and_shapes_that_do_not_go_together_are_refused(canadarm: dn.Robot) -> None:
    with pytest.raises(dn.ModelError, match=r'shape must be craig-bampton .* got .clamped-free'):
        plant(canadarm, segments=4, shape='clamped-free')
    with pytest.raises(dn.ModelError, match=r'modes \(direction y\) must be >= 2 with'):
        plant(canadarm, modes=1)


@pytest.mark.parametrize(
    ('values', 'message'),
    [
        ({'modes': -1}, r'plant modes must be a whole number from 0 .* to 50, got -1'),
        ({'segments': 2.5}, r'plant segments must be a whole number from 0 .* to 200, got 2.5'),
        ({'segments': True}, 'plant segments must be a whole number'),
        ({'shape': 'round'}, "plant shape must be one of clamped-free, .*, got 'round'"),
    ],
)
def test_bad_descriptions_are_found(values: dict[str, Any], message: str) -> None:
    findings: list[str] = []
    assert not read_plant(values, findings.append)
    (finding,) = findings
    assert re.match(message, finding)


def test_a_mapping_is_read_beside_other_keys() -> None:
    values = {'modes': 4, 'shape': 'clamped-free', 'noise.position': 1e-5}
    assert read_plant(values, lambda text: pytest.fail(text)) == PlantDescription(
        4, 'clamped-free'
    )
