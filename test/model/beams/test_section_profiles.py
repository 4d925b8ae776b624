"""Sections of any outline against closed forms; sectionproperties does the finite elements."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from shapely import Polygon, box
from shapely.affinity import translate
from trimesh.path import Path2D
from trimesh.path.exchange.misc import polygon_to_path

import denoc_ros as dn
from denoc_ros.errors import ModelError
from denoc_ros.model.beams.cross_sections import (
    CrossSection,
    rectangle_section,
    rectangle_torsion_constant,
    tube_section,
)
from denoc_ros.model.beams.section_profiles import Loop, profile_section, read_outline
from denoc_ros.types import Array

E, G, DENSITY = 7.0e10, 2.6e10, 2700.0
MATERIAL = f'<material e="{E}" g="{G}" density="{DENSITY}"/>'
LENGTH = 2.0


def loop_of(polygon: Polygon) -> Loop:
    return tuple((float(y), float(z)) for y, z in polygon.exterior.coords[:-1])


def where(section: CrossSection) -> Array:
    assert section.axes is not None
    return np.asarray(section.axes.values(np.zeros(1))[0])


def lying(y: float, z: float, turn: float) -> Loop:
    cos, sin = np.cos(turn), np.sin(turn)
    corners = 0.5 * np.array([[-y, -z], [y, -z], [y, z], [-y, z]]) @ [[cos, sin], [-sin, cos]]
    return tuple((float(a) + 0.1, float(b) - 0.2) for a, b in corners)


@pytest.mark.long_cases('0.0', '-0.7')
@pytest.mark.parametrize('turn', [0.0, 0.3, -0.7])
def test_a_rectangle_has_its_closed_forms_however_it_lies(turn: float) -> None:
    found, closed = profile_section((lying(0.04, 0.01, turn),)), rectangle_section(0.04, 0.01)
    assert found.area == pytest.approx(closed.area, rel=1e-9)
    assert found.moment_y == pytest.approx(closed.moment_y, rel=1e-9)
    assert found.moment_z == pytest.approx(closed.moment_z, rel=1e-9)
    torsion = rectangle_torsion_constant(0.04, 0.01)
    assert found.torsion_constant == pytest.approx(torsion, rel=1e-3)
    assert where(found) == pytest.approx([turn, 0.1, -0.2, 0.1, -0.2], abs=1e-9)
    assert found.fibre == pytest.approx((0.02, 0.005), rel=1e-9)


def test_a_tube_has_its_closed_forms_in_a_table_with_a_hole(tmp_path: Path) -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)
    rings = [
        '\n'.join(f'{1e3 * r * np.cos(a)},{1e3 * r * np.sin(a)}' for a in turn)
        for r in (0.05, 0.046)
    ]
    file = tmp_path / 'tube.csv'
    file.write_text('# mm\n' + '\n\n'.join(rings) + '\n')
    found, closed = profile_section(read_outline(file, 1e-3)), tube_section(0.1, 0.004)
    assert found.area == pytest.approx(closed.area, rel=3e-4)  # a polygon of 240 corners
    assert found.moment_y == pytest.approx(closed.moment_y, rel=5e-4)
    assert found.torsion_constant == pytest.approx(closed.torsion_constant, rel=1e-3)
    assert where(found)[0] == 0.0


def test_an_angle_has_turned_axes_and_its_shear_centre_in_the_corner(tmp_path: Path) -> None:
    """Legs b, thin wall t: axes at 45 degrees, shear centre where the middle lines meet."""
    b, t = 0.1, 0.005
    outline = box(0, 0, b, t).union(box(0, 0, t, b))
    file = tmp_path / 'angle.dxf'
    Path2D(**polygon_to_path(outline)).export(str(file))
    found = profile_section(read_outline(file, 1.0))
    leg = b - 0.5 * t
    angle, *centre, shear_y, shear_z = where(found)
    assert abs(angle) == pytest.approx(np.pi / 4, abs=1e-6)
    centroid = (b * t * b / 2 + (b - t) * t * t / 2) / (b * t + (b - t) * t)
    assert centre == pytest.approx([centroid, centroid], rel=1e-9)
    assert [shear_y, shear_z] == pytest.approx([0.5 * t, 0.5 * t], abs=2e-3 * b)
    moments = sorted([found.moment_y, found.moment_z])
    assert moments == pytest.approx([t * leg**3 / 12.0, t * leg**3 / 3.0], rel=0.02)
    assert found.torsion_constant == pytest.approx(2.0 * leg * t**3 / 3.0, rel=0.02)


def test_a_channel_has_its_shear_centre_behind_the_web() -> None:
    """Thin walls: e = 3 b^2 / (h + 6 b), Gamma = t b^3 h^2 (3 b + 2 h) / (12 (6 b + h))."""
    h, b, t = 0.1, 0.05, 0.002  # of the middle lines
    outer = box(-t / 2, -(h + t) / 2, b, (h + t) / 2)
    found = profile_section((loop_of(outer.difference(box(t / 2, -(h - t) / 2, b, (h - t) / 2))),))
    angle, centroid_y, centroid_z, shear_y, shear_z = where(found)
    assert angle == pytest.approx(0.0, abs=1e-9)
    assert shear_y == pytest.approx(-3.0 * b**2 / (h + 6.0 * b), rel=0.02)
    assert [centroid_z, shear_z] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert centroid_y > 0.0
    warping = t * b**3 * h**2 / 12.0 * (3.0 * b + 2.0 * h) / (6.0 * b + h)
    assert found.warping_constant == pytest.approx(warping, rel=0.03)


def arm(section: str, stations: bool) -> str:
    inside = section
    if stations:
        inside = f'<at x="0">{section}</at><at x="{LENGTH}">{section}</at>'
    return (
        '<robot name="r"><link name="base"/><link name="arm"><inertial><origin xyz="1 0 0"/>'
        '<mass value="20"/><inertia ixx="1" iyy="20" izz="20" ixy="0" ixz="0" iyz="0"/>'
        '</inertial></link><joint name="j" type="revolute"><parent link="base"/>'
        '<child link="arm"/><axis xyz="0 0 1"/>'
        '<limit lower="-3" upper="3" effort="100" velocity="5"/></joint><flexibility>'
        f'<beam link="arm" length="{LENGTH}">{MATERIAL}{inside}<bending direction="y" modes="2"/>'
        '<bending direction="z" modes="2"/><torsion modes="1"/></beam></flexibility></robot>'
    )


def polygon(loop: Loop) -> str:
    points = ' '.join(f'{y!r} {z!r}' for y, z in loop)
    return f'<section type="polygon" points="{points}"/>'


@pytest.mark.parametrize('stations', [False, True])
def test_a_polygon_is_the_rectangle_that_it_is(stations: bool) -> None:
    loop = tuple((y - 0.1, z + 0.2) for y, z in lying(0.04, 0.03, 0.0))
    one = dn.load_robot(arm(polygon(loop), stations))
    other = dn.load_robot(arm('<section type="rectangle" y="0.04" z="0.03"/>', stations))
    q = 0.01 * np.arange(1.0, one.n + 1.0)
    assert one.inverse_dynamics(q, q, q) == pytest.approx(
        other.inverse_dynamics(q, q, q), rel=1e-4, abs=1e-9
    )


@pytest.mark.long
def test_a_file_beside_the_description_is_found_and_an_override_keeps_the_turn(
    tmp_path: Path,
) -> None:
    loop = lying(0.04, 0.03, 0.3)
    rows = '\n'.join(f'{1e3 * y},{1e3 * z}' for y, z in loop)
    (tmp_path / 'profile.csv').write_text(rows)
    path = tmp_path / 'arm.urdf'
    path.write_text(arm('<section file="profile.csv" scale="0.001"/>', False))
    one, other = dn.load_robot(path), dn.load_robot(arm(polygon(loop), False))
    q = 0.01 * np.arange(1.0, one.n + 1.0)
    expected = other.inverse_dynamics(q, q, q)
    assert one.inverse_dynamics(q, q, q) == pytest.approx(expected, rel=1e-9)
    same = other.with_overrides({'beam.arm.y.ei': E * 0.03 * 0.04**3 / 12.0})
    assert same.inverse_dynamics(q, q, q) == pytest.approx(expected, rel=1e-6)
    softer = [
        each.with_overrides({'beam.arm.y.ei': 1e3, 'beam.arm.y.modes': 3}) for each in (one, other)
    ]
    q = 0.01 * np.arange(1.0, softer[0].n + 1.0)
    assert softer[0].inverse_dynamics(q, q, q) == pytest.approx(
        softer[1].inverse_dynamics(q, q, q), rel=1e-9
    )


@pytest.mark.long
def test_warping_that_held_ends_would_stop_is_told() -> None:
    thin = box(-0.03, -0.03, 0.03, 0.03).difference(box(-0.029, -0.029, 0.029, 0.0301))
    found = profile_section((loop_of(thin),))
    assert found.axes is not None
    middle = loop_of(translate(thin, 0.0, -float(where(found)[4])))
    text = arm(polygon(middle), False)
    with pytest.raises(ModelError, match='denoc reduce'):  # its centroid is beside
        dn.load_robot(text)
    cross = box(-0.03, -0.0005, 0.03, 0.0005).union(box(-0.03, -0.03, -0.029, 0.03))
    cross = cross.union(box(0.029, -0.03, 0.03, 0.03))
    robot = dn.load_robot(arm(polygon(loop_of(cross)), False))
    assert any('stop its sections from warping' in each for each in robot.tree.warnings)


CROSSED = ((0.0, 0.0), (0.01, 0.01), (0.01, 0.0), (0.0, 0.01))


@pytest.mark.parametrize(
    ('section', 'message'),
    [
        (polygon(CROSSED), 'must not cross itself'),
        ('<section type="polygon" points="0 0 1 1"/>', 'y and z of three corners or more'),
        ('<section type="hexagon"/>', 'must be one of round, tube, rectangle, polygon'),
        ('<section file="/none.csv" scale="1"/>', 'must be a file'),
        ('<section file="profile.csv" scale="1"/>', 'an absolute path or a package:// address'),
        ('<section file="{folder}/torn.csv"/>', 'scale .* per unit of the file'),
        ('<section file="{folder}/torn.csv" scale="1"/>', 'must be an outline of y and z'),
        ('<section file="{folder}/torn.dxf" scale="1"/>', 'torn.dxf'),
        ('<section file="{folder}/two.csv" scale="1"/>', 'must be one piece, got 2'),
        ('<section file="{folder}/over.csv" scale="1"/>', 'must not cross each other'),
        ('<section file="{folder}/x.stl" scale="1"/>', 'must end in .dxf or .csv'),
        (polygon(lying(0.04, 0.03, 0.0)).replace('type', 'y="3" type'), 'must be one of type, p'),
    ],
)
def test_a_bad_outline_is_told(section: str, message: str, tmp_path: Path) -> None:
    (tmp_path / 'torn.csv').write_text('0,0\n1,zero\n')
    (tmp_path / 'torn.dxf').write_text('0\nSECTION\n2\n')
    (tmp_path / 'x.stl').write_text('')
    square, aside, over = '0,0\n1,0\n1,1\n0,1', '3,0\n4,0\n4,1\n3,1', '.5,.5\n2,.5\n2,2\n.5,2'
    (tmp_path / 'two.csv').write_text(f'{square}\n\n{aside}\n')
    (tmp_path / 'over.csv').write_text(f'{square}\n\n{over}\n')
    with pytest.raises(ModelError, match=message):
        dn.load_robot(arm(section.replace('{folder}', str(tmp_path)), False))


def test_the_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, 'denoc_ros.model.beams.section_profiles')
    monkeypatch.setitem(sys.modules, 'sectionproperties.analysis.section', None)
    with pytest.raises(ModelError, match=r"pip install 'denoc_ros\[sections\]'"):
        dn.load_robot(arm(polygon(lying(0.0411, 0.03, 0.0)), False))
