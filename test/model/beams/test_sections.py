"""Cross-sections against closed forms and an independent series."""

from __future__ import annotations

import math

import numpy as np
import pytest

from denoc_ros.model.beams.cross_sections import (
    rectangle_section,
    rectangle_torsion_constant,
    rectangle_tube_section,
    round_section,
    tube_section,
)


def test_round_section_has_the_textbooks_moments() -> None:
    section = round_section(0.02)
    assert section.area == pytest.approx(math.pi * 1e-4, rel=1e-14)
    assert section.moment_y == pytest.approx(math.pi * 0.02**4 / 64.0, rel=1e-14)
    assert section.torsion_constant == pytest.approx(section.polar_moment, rel=1e-14)


def test_tube_is_a_circle_less_its_bore() -> None:
    tube, outer, bore = tube_section(0.05, 0.004), round_section(0.05), round_section(0.042)
    assert tube.area == pytest.approx(outer.area - bore.area)
    assert tube.moment_z == pytest.approx(outer.moment_z - bore.moment_z)
    assert tube.torsion_constant == pytest.approx(tube.polar_moment)


def test_rectangle_bends_along_y_with_the_cube_of_y() -> None:
    section = rectangle_section(0.03, 0.01)
    assert section.moment_y == pytest.approx(0.01 * 0.03**3 / 12.0)
    assert section.moment_z == pytest.approx(0.03 * 0.01**3 / 12.0)


@pytest.mark.parametrize('ratio', [1.0, 1.5, 3.0, 10.0, 200.0])
def test_rectangle_torsion_is_st_venants_series(ratio: float) -> None:
    n = np.arange(1.0, 4001.0, 2.0)
    series = np.sum(np.tanh(np.minimum(n * math.pi * ratio / 2.0, 300.0)) / n**5)
    expected = ratio * (1.0 / 3.0 - 64.0 / (math.pi**5 * ratio) * series)
    assert rectangle_torsion_constant(ratio, 1.0) == pytest.approx(expected, rel=1e-13)
    assert rectangle_torsion_constant(1.0, ratio) == rectangle_torsion_constant(ratio, 1.0)


def test_square_torsion_constant_is_the_tables() -> None:
    assert rectangle_torsion_constant(1.0, 1.0) == pytest.approx(0.1406, abs=5e-5)


def test_hollow_rectangle_lies_between_its_thin_wall_and_the_full_one() -> None:
    y, z = 0.1, 0.06
    full = rectangle_section(y, z)
    assert rectangle_tube_section(y, z, 0.03) == full
    wall = 1e-5
    thin = rectangle_tube_section(y, z, wall)
    assert thin.area == pytest.approx(2.0 * (y + z) * wall, rel=1e-3)  # wall over side
    assert thin.torsion_constant == pytest.approx(2.0 * y**2 * z**2 * wall / (y + z), rel=1e-3)
    # two webs and two flanges
    assert thin.moment_y == pytest.approx(wall * (y**3 / 6.0 + z * y**2 / 2.0), rel=1e-3)
    walls = [rectangle_tube_section(y, z, wall) for wall in (0.001, 0.005, 0.02, 0.029)]
    for name in ('area', 'moment_y', 'moment_z', 'torsion_constant'):
        values = [getattr(section, name) for section in [*walls, full]]
        assert values == sorted(values), name


@pytest.mark.parametrize('wall', [0.002, 0.01, 0.02])
def test_cutting_a_bar_loose_inside_makes_it_softer_in_torsion(wall: float) -> None:
    # whatever the shape: the parts warp each as they like, the whole only together
    y, z = 0.1, 0.08
    shell, core = rectangle_tube_section(y, z, wall), rectangle_section(y - 2 * wall, z - 2 * wall)
    whole = rectangle_section(y, z).torsion_constant
    assert shell.torsion_constant + core.torsion_constant < whole
    # Bredt alone is softer than the wall is
    enclosed, around = (y - wall) * (z - wall), 2.0 * (y + z - 2.0 * wall)
    assert shell.torsion_constant > 4.0 * enclosed**2 * wall / around
