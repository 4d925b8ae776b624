"""Inertias that no body of a link's mass and size has are doubted, and all others are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.random import Generator

from denoc_ros.model.reading.inertia_doubts import inertia_doubts
from denoc_ros.model.reading.poses import number_text, rotation_rpy
from denoc_ros.model.reading.urdf import load_tree
from denoc_ros.types import Array

SIZES = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')
BOX = '<visual><origin xyz="{0}" rpy="{1}"/><geometry><box size="{2}"/></geometry></visual>'


def link(mass: float, inertia: Array, com: Array, rpy: Array, shape: str = '') -> str:
    six = zip(SIZES, inertia[np.triu_indices(3)].tolist(), strict=True)
    numbers = ' '.join(f'{name}="{value!r}"' for name, value in six)
    place = f'xyz="{number_text(*com)}" rpy="{number_text(*rpy)}"'
    return (
        f'<robot name="r"><link name="base"/><link name="l"><inertial><origin {place}/>'
        f'<mass value="{mass}"/><inertia {numbers}/></inertial>{shape}</link>'
        '<joint name="j" type="continuous"><parent link="base"/><child link="l"/></joint></robot>'
    )


def doubts(text: str) -> list[str]:
    return inertia_doubts(load_tree(text))


def body(rng: Generator) -> tuple[float, Array, Array, Array]:
    """Return mass, central inertia, centre and size of masses at random points of a box."""
    size, masses = rng.uniform(0.05, 0.5, 3), rng.uniform(0.1, 1.0, 6)
    points = rng.uniform(-0.5, 0.5, (6, 3)) * size
    points[:2] = [-0.5 * size, 0.5 * size]
    com = masses @ points / masses.sum()
    second = (points - com).T @ (masses[:, None] * (points - com))
    return masses.sum(), np.trace(second) * np.eye(3) - second, com, size


@pytest.mark.parametrize('seed', range(8))
def test_a_real_body_is_not_doubted_wherever_its_frames_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mass, inertia, com, size = body(rng)
    turn, place = rng.uniform(-1.0, 1.0, 3), rng.uniform(-0.3, 0.3, 3)
    rotation = rotation_rpy(turn)
    shape = BOX.format(*(number_text(*each) for each in (place, turn, size)))
    # the inertial frame is turned as the geometry is
    assert doubts(link(mass, inertia, place + rotation @ com, turn, shape)) == []


def test_the_extreme_body_of_a_box_is_not_doubted_and_a_larger_one_is() -> None:
    """Half of the mass in each of two opposite corners: no body of that box has more."""
    size = np.array([0.2, 0.3, 0.4])
    corner, zero = 0.5 * size, np.zeros(3)
    shape = BOX.format('0 0 0', '0 0 0', number_text(*size))
    for factor, count in ((1.0, 0), (0.99, 0), (1.02, 1)):
        far = factor * corner
        inertia = 2.0 * (far @ far * np.eye(3) - np.outer(far, far))
        found = doubts(link(2.0, inertia, zero, zero, shape))
        assert len(found) == count
    (doubt,) = found
    assert doubt.startswith("link 'l': radius of gyration about x should be at most 0.25 m, half")
    assert '(0.3 x 0.4 m), got 0.255 m' in doubt


@pytest.mark.parametrize(
    'geometry',
    [
        '<sphere radius="0.1"/>',
        '<cylinder radius="0.1" length="0.2"/>',
        '<box size="0.2 0.2 0.2"/>',
        '<mesh filename="box.stl" scale="0.001 0.001 0.001"/>',
    ],
)
def test_every_kind_of_geometry_bounds_the_inertia(tmp_path: Path, geometry: str) -> None:
    """Each is in a box with sides of 0.2 m."""
    trimesh.creation.box(extents=(200.0, 200.0, 200.0)).export(tmp_path / 'box.stl')
    shape = f'<collision><geometry>{geometry}</geometry></collision>'
    zero, path = np.zeros(3), tmp_path / 'r.urdf'
    for factor, count in ((0.99, 0), (1.01, 1)):
        inertia = 0.5 * 0.5 * (factor * 0.2) ** 2 * np.eye(3)
        path.write_text(link(0.5, inertia, zero, zero, shape))
        assert len(inertia_doubts(load_tree(path))) == count
    # a body whose other shape is not known may be larger
    shape += '<visual><geometry><mesh filename="none.stl"/></geometry></visual>'
    path.write_text(link(0.5, inertia, zero, zero, shape))
    assert inertia_doubts(load_tree(path)) == []


@pytest.mark.parametrize(('excess', 'count'), [(0.0, 0), (5e-4, 0), (2e-3, 1)])
def test_the_triangle_inequality_holds_to_a_thousandth(excess: float, count: int) -> None:
    rotation = rotation_rpy(np.array([0.3, 0.4, 0.5]))
    principal = np.diag([0.1, 0.2, 0.3 / (1.0 - excess)])
    found = doubts(link(1.0, rotation @ principal @ rotation.T, np.ones(3), np.zeros(3)))
    assert len(found) == count


def test_a_missing_decimal_point_is_named_with_the_numbers() -> None:
    inertia = np.diag([2661.9e-6, 2302.6e-6, 1676359e-6])
    (found,) = doubts(link(1.559, inertia, np.array([0, 0, 0.03]), np.zeros(3)))
    assert found == (
        "link 'l': the largest principal moment of <inertia> should be at most the sum of the "
        'others, got 0.002303, 0.002662 and 1.676 kg m^2: 99.7 % of it is too much'
    )


def test_an_inertia_without_mass_is_doubted_and_a_frame_is_not() -> None:
    zero = np.zeros(3)
    (found,) = doubts(link(0.0, 0.01 * np.eye(3), zero, zero))
    assert found.startswith("link 'l': mass of <inertial> should be > 0 where <inertia> is not")
    assert doubts(link(0.0, np.zeros((3, 3)), zero, zero)) == []
