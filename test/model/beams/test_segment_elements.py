"""`segments=` in the file: what it makes of a link, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from segmented_robots import spatial_text, strip_text

import denoc_ros as dn
from denoc_ros.errors import ModelError
from denoc_ros.model.beams.segments import locate, segment_shapes, segment_torsion_shapes
from denoc_ros.model.numbers import values_of
from denoc_ros.model.reading.urdf import load_tree

BENDING = '<bending direction="y" ei="1" modes="2"/>'
BAD = [
    ('segments="4"', 'segments="0"', "segments must be a whole number from 1 to 200, got '0'"),
    ('segments="4"', 'segments="-2"', "segments must be a whole number from 1 .*, got '-2'"),
    ('segments="4"', 'segments="2.5"', "segments must be a whole number from 1 .*, got '2.5'"),
    ('segments="4"', 'segments="many"', "segments must be a whole number .*, got 'many'"),
    ('segments="4"', 'segments=""', "segments must be a whole number .*, got ''"),
    ('segments="4"', 'segments="201"', "segments must be a whole number .*, got '201'"),
    (BENDING, '', 'segments must be 1 without a <bending> or <torsion>, got 4'),
    (
        'segments="4"',
        'segments="4" shape="clamped-free"',
        r"shape must be craig-bampton \(the default\) with segments > 1, got 'clamped-free'",
    ),
    (
        'modes="2"',
        'modes="2" damping_ratio="0.01 0.02"',
        r'damping_ratio \(direction y\) must be one number with segments > 1: the ratio of the '
        "link's first mode, got '0.01 0.02'",
    ),
    (
        '<link name="tip"/>',
        '<link name="tip"/><link name="strip/3"/><joint name="o" type="fixed">'
        '<parent link="tip"/><child link="strip/3"/></joint>',
        "names of its segments, strip/2 and on, must be no links, got 'strip/3'",
    ),
]


@pytest.mark.parametrize(('good', 'bad', 'message'), BAD)
def test_bad_segments_are_findings(good: str, bad: str, message: str) -> None:
    text = strip_text(4)
    assert text.count(good) == 1
    with pytest.raises(ModelError, match=message):
        load_tree(text.replace(good, bad))


def test_a_link_of_segments_is_as_many_bodies() -> None:
    tree = load_tree(spatial_text(3))
    names = [body.name for body in tree.bodies]
    assert names[:6] == ['upper', 'upper/2', 'upper/3', 'fore', 'fore/2', 'fore/3']
    upper = tree.bodies[:3]
    assert [body.link for body in upper] == ['upper'] * 3
    np.testing.assert_allclose([body.start for body in upper], [0.0, 0.95 / 3, 2 * 0.95 / 3])
    assert all(body.joint is None for body in upper[1:])
    # what hangs where two meet hangs rigidly on the outboard one
    assert (tree.frames['arm'].body, tree.frames['arm'].station) == (2, 0.0)
    # children from the tip inwards: the first in the file hangs on the first segment
    assert names[-1] == 'side'


def test_mass_is_that_of_the_link() -> None:
    for segments in (1, 3):
        robot = dn.load_robot(spatial_text(segments))
        assert robot.n == 3 + segments * 9
        # all falls at g: the energy's rate against a shift of gravity is the mass
        high = dn.load_robot(spatial_text(segments).replace('0 0 0.4"', '0 0 1.4"'))
        lift = high.energy(np.zeros(robot.n), np.zeros(robot.n))[1]
        lift -= robot.energy(np.zeros(robot.n), np.zeros(robot.n))[1]
        assert lift == pytest.approx(9.81 * (2.5 + 0.5 + 4 * 0.2), rel=1e-12)


@pytest.mark.parametrize(
    ('station', 'place'),
    [
        (0.0, (0, 0.0)),
        (0.2, (0, 0.2)),
        (0.5, (1, 0.0)),
        (0.5 - 1e-15, (1, 0.0)),
        (0.5 + 1e-15, (1, 0.0)),
        (1.75, (3, 0.25)),
        (2.0, (3, 0.5)),
        (2.3, (3, 0.5)),
        (-0.1, (0, 0.0)),
    ],
)
def test_a_station_is_on_one_segment(station: float, place: tuple[int, float]) -> None:
    index, local = locate(2.0, 4, station)
    assert index == place[0]
    assert local == pytest.approx(place[1], abs=1e-12)


def test_every_border_is_the_root_of_the_next_segment() -> None:
    for segments in range(2, 40):
        for k in range(1, segments):
            assert locate(0.7, segments, 0.7 * k / segments) == (k, 0.0)


def test_a_segment_hands_force_moment_and_torque_on() -> None:
    length, tip = 0.3, np.array([0.3])
    shapes = segment_shapes(2, length)
    compliance = np.diag(1.0 / np.diag(shapes.gram(2)))
    value, slope = shapes.values(tip)[0], shapes.slopes(tip)[0]
    assert value @ compliance @ value == pytest.approx(length**3 / 3.0, rel=1e-12)
    assert value @ compliance @ slope == pytest.approx(length**2 / 2.0, rel=1e-12)
    assert slope @ compliance @ slope == pytest.approx(length, rel=1e-12)
    bend = segment_shapes(1, length)
    assert bend.slopes(tip)[0, 0] ** 2 / bend.gram(2)[0, 0] == pytest.approx(length, rel=1e-12)
    for modes in (1, 2, 4):
        twist = segment_torsion_shapes(modes, length)
        end = twist.values(tip)[0]
        assert np.sum(end**2 / np.diag(twist.gram(1))) == pytest.approx(length, rel=1e-12)
        np.testing.assert_allclose(twist.gram(0) - np.diag(np.diag(twist.gram(0))), 0, atol=1e-14)
        grid = twist.values(np.linspace(0.0, length, 2001))
        np.testing.assert_allclose(np.abs(grid).max(axis=0), 1.0, rtol=1e-5)
        assert np.all(end > 0.0)


def test_damping_ratio_is_that_of_the_link_s_first_mode() -> None:
    text = strip_text(8).replace('modes="2"', 'modes="2" damping_ratio="0.02"')
    torsion = '<torsion gj="1" polar_inertia="1e-3" modes="1" damping_ratio="0.03"/></beam>'
    text = text.replace('<inertia ixx="0.0"', '<inertia ixx="1e-3"').replace('</beam>', torsion)
    robot = dn.load_robot(text, gravity=(0.0, 0.0, 0.0))
    modes = robot.natural_modes(np.zeros(robot.n))
    shapes = modes.shapes[:, :2]
    twists = [name[-2] == 't' for name in robot.coordinate_names]
    assert np.abs(shapes[twists]).max() < 1e-9  # the first two bend
    assert modes.damping_ratios[0] == pytest.approx(0.02, rel=1e-3)
    # in proportion to stiffness: of a higher mode as its frequency
    rise = modes.frequencies[1] / modes.frequencies[0]
    assert modes.damping_ratios[1] / modes.damping_ratios[0] == pytest.approx(rise, rel=1e-3)
    twisting = np.argmax(np.abs(modes.shapes[twists]).max(axis=0) > 1.0)
    assert modes.damping_ratios[twisting] == pytest.approx(0.03, rel=5e-3)


def test_overrides_are_of_the_whole_link() -> None:
    robot = dn.load_robot(strip_text(4).replace('modes="2"', 'modes="2" damping_ratio="0.02"'))
    values = values_of(robot.tree)
    assert [path for path in values if path.startswith('beam.')] == [
        'beam.strip.y.ei',
        'beam.strip.y.damping',
        'beam.strip.y.damping_ratio',
    ]
    assert values['beam.strip.y.damping_ratio'] == [0.02]
    stiff = robot.with_overrides({'beam.strip.y.ei': 4.0, 'beam.strip.y.damping_ratio': 0.01})
    rise = stiff.natural_frequencies(np.zeros(8))[0] / robot.natural_frequencies(np.zeros(8))[0]
    assert rise == pytest.approx(2.0, rel=1e-9)
    assert stiff.natural_modes(np.zeros(8)).damping_ratios[0] == pytest.approx(0.01, rel=1e-3)


def test_without_modes_a_link_is_one_rigid_body() -> None:
    tree = load_tree(strip_text(4).replace('modes="2"', 'modes="0"'))
    assert [body.name for body in tree.bodies] == ['strip', 'tip']


def test_gauges_and_cells_read_the_segment_that_holds_them() -> None:
    at = 'link="strip" direction="y"'
    sensors = ''.join(
        f'<sensor name="g{k}" type="strain_gauge" {at} station="{x}" surface="0.01"/>'
        f'<sensor name="m{k}" type="load_cell" {at} station="{x}" component="moment"/>'
        f'<sensor name="s{k}" type="load_cell" {at} station="{x}" component="shear"/>'
        for k, x in enumerate((0.0, 0.1, 0.25, 0.6, 0.9))
    )
    robot = dn.load_robot(strip_text(4, more=sensors), gravity=(0.0, 0.0, 0.0))
    force = 1e-3  # N, which bends it by 0.03 %
    q = robot.static_deflection(np.zeros(0), wrenches={'tip': (0, force, 0, 0, 0, 0)})
    values = robot.sensor_values(q).reshape(-1, 3)
    lever = 1.0 - np.array([0.0, 0.1, 0.25, 0.6, 0.9])
    # the lever shortens, and segments turn, by the square of the deflection
    np.testing.assert_allclose(values[:, 0], -0.01 * force * lever, rtol=1e-6)
    np.testing.assert_allclose(values[:, 1], -force * lever, rtol=1e-6)
    np.testing.assert_allclose(values[:, 2], -force, rtol=1e-6)
