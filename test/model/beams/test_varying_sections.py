"""Sections that vary along a beam, against closed forms, published values and uniform beams."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from denoc_ros.dynamics.elastic.deflection import TipDeflections
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ModelError
from denoc_ros.types import Array

LENGTH = 2.0
E, DENSITY = 7.0e10, 2700.0
MATERIAL = f'<material e="{E}" g="2.6e10" density="{DENSITY}"/>'
Y, Z = '<bending direction="y" {}/>', '<bending direction="z" {}/>'


def description(beam: str, child: str = '') -> str:
    return (
        '<robot name="r"><link name="base"/><link name="arm"><inertial><origin xyz="1 0 0"/>'
        '<mass value="200"/><inertia ixx="5" iyy="120" izz="120" ixy="0" ixz="0" iyz="0"/>'
        '</inertial></link><joint name="j" type="revolute"><parent link="base"/>'
        '<child link="arm"/><axis xyz="0 0 1"/>'
        '<limit lower="-3" upper="3" effort="100" velocity="5"/></joint>'
        f'{child}<flexibility>{beam}</flexibility></robot>'
    )


def numbers(x: float, ei: float, mass: float = 5.0, polar: float = 0.02) -> str:
    return (
        f'<at x="{x}" ei_y="{ei}" ei_z="{2 * ei}" gj="{0.5 * ei}" mass_per_length="{mass}" '
        f'polar_inertia="{polar}"/>'
    )


def beam(stations: str, deformations: str, attributes: str = '') -> str:
    return f'<beam link="arm" length="{LENGTH}" {attributes}>{stations}{deformations}</beam>'


def robot(stations: str, deformations: str, attributes: str = '') -> Robot:
    return load_robot(
        description(beam(stations, deformations, attributes)), gravity=(0.0, 0.0, 0.0)
    )


def rectangles(first: tuple[float, float], last: tuple[float, float]) -> str:
    return MATERIAL + ''.join(
        f'<at x="{x}"><section type="rectangle" y="{y}" z="{z}"/></at>'
        for x, (y, z) in ((0.0, first), (LENGTH, last))
    )


def held(found: Robot) -> Array:
    """Frequencies [rad/s], the joint held."""
    return 2.0 * np.pi * np.asarray(found.natural_frequencies(np.zeros(found.n)))


def test_a_wedge_has_the_bessel_function_s_frequencies() -> None:
    stations = rectangles((0.06, 0.05), (0.0, 0.05))
    found = held(robot(stations, Y.format('modes="3" damping_ratio="0"')))
    unit = np.sqrt(E / DENSITY * 0.06**2 / 12.0) / LENGTH**2
    np.testing.assert_allclose(found / unit, [5.3151, 15.2072, 30.0198], rtol=1e-5)


def test_a_cone_has_the_bessel_function_s_frequencies() -> None:
    stations = MATERIAL + (
        f'<at x="0"><section type="round" diameter="0.08"/></at>'
        f'<at x="{LENGTH}"><section type="round" diameter="0"/></at>'
    )
    found = held(robot(stations, Z.format('modes="3"')))
    unit = np.sqrt(E / DENSITY * 0.08**2 / 16.0) / LENGTH**2
    np.testing.assert_allclose(found / unit, [8.7193, 21.1457, 38.4538], rtol=1e-5)


@pytest.mark.parametrize(
    ('width', 'published'),
    [
        (4.0, [23.289, 73.9, 165.23, 299.7, 478.1]),
        (5.0, [24.308, 75.56, 167.21, 301.9, 480.4]),
    ],
)
def test_a_beam_tapered_both_ways_is_code_aster_s_sdll09(
    width: float, published: list[float]
) -> None:
    thick, thin = 0.04, 0.01
    stations = rectangles((thick, 0.05), (thin, 0.05 / width))
    found = held(robot(stations, Y.format('modes="5"')))
    unit = thin / LENGTH**2 * np.sqrt(E / (12.0 * DENSITY))
    np.testing.assert_allclose(found / unit, published, rtol=5e-4)


@pytest.mark.parametrize('attributes', ['', 'shape="craig-bampton"', 'segments="3"'])
def test_constant_stations_are_a_uniform_beam(attributes: str) -> None:
    modes = Y.format('modes="3" damping_ratio="0.01"') + Z.format('modes="2"')
    varying = robot(
        ''.join(numbers(x, 1000.0) for x in (0.0, 0.7, 2.0)),
        modes + '<torsion modes="2"/>',
        attributes,
    )
    uniform = robot(
        '',
        Y.format('modes="3" damping_ratio="0.01" ei="1000"')
        + Z.format('modes="2" ei="2000"')
        + '<torsion modes="2" gj="500" polar_inertia="0.02"/>',
        f'mass_per_length="5" {attributes}',
    )
    q = 0.02 * np.cos(np.arange(uniform.n))
    assert varying.arrays.constants.shape == uniform.arrays.constants.shape
    np.testing.assert_allclose(
        varying.inverse_dynamics(q, q, q), uniform.inverse_dynamics(q, q, q), rtol=1e-13
    )


def stepped() -> str:
    rows = [(0.0, 2000.0, 6.0), (0.9, 1500.0, 5.0), (0.9, 800.0, 4.0), (2.0, 300.0, 2.0)]
    return ''.join(numbers(x, ei, mass, 0.004 * mass) for x, ei, mass in rows)


def rigidity(x: float) -> float:
    return 2000.0 - 500.0 * x / 0.9 if x < 0.9 else 800.0 - 500.0 * (x - 0.9) / 1.1


def test_a_load_at_the_tip_bends_it_as_the_integral_of_moment_over_rigidity() -> None:
    found = robot(stepped(), Y.format('modes="2"'), 'shape="craig-bampton"')
    load = found.static_deflection(np.zeros(1), {'arm': [0.0] * 6})
    np.testing.assert_allclose(load, 0.0, atol=1e-12)
    part = found.tree.bodies[0].beam
    assert part is not None
    assert part.y is not None
    tip = np.array([LENGTH])
    value, slope = part.y.shapes.values(tip)[0], part.y.shapes.slopes(tip)[0]
    bend, _ = quad(lambda x: (LENGTH - x) ** 2 / rigidity(x), 0.0, LENGTH, points=[0.9])
    turn, _ = quad(lambda x: 1.0 / rigidity(x), 0.0, LENGTH, points=[0.9])
    assert value @ (value / part.y.modal_stiffness) == pytest.approx(bend, rel=1e-9)
    assert slope @ (slope / part.y.modal_stiffness) == pytest.approx(turn, rel=1e-9)


@pytest.mark.parametrize('station', [0.4, 1.3])
def test_gauges_and_load_cells_see_the_section_at_their_place(station: float) -> None:
    """Under a tip force the moment is linear and the shear one number, whatever the section."""
    sensors = ''.join(
        f'<sensor name="{name}" link="arm" station="{station}" direction="y" topic="/t" {more}/>'
        for name, more in (
            ('gauge', 'type="strain_gauge" surface="0.02"'),
            ('moment', 'type="load_cell" component="moment"'),
            ('shear', 'type="load_cell" component="shear"'),
        )
    )
    text = description(beam(stepped(), Y.format('modes="2"'), 'shape="craig-bampton"') + sensors)
    found = load_robot(text, gravity=(0.0, 0.0, 0.0))
    part = found.tree.bodies[0].beam
    assert part is not None
    assert part.y is not None
    q = np.concatenate([[0.0], part.y.shapes.values(np.array([LENGTH]))[0]])
    q[1:] /= part.y.modal_stiffness  # a force of 1 N at the tip
    lever = LENGTH - station
    gauge, moment, shear = found.sensor_values(q, 0.0 * q)
    assert gauge == pytest.approx(-0.02 * lever / rigidity(station), rel=1e-6)
    assert abs(moment) == pytest.approx(lever, rel=1e-6)
    assert abs(shear) == pytest.approx(1.0, rel=1e-4)


def test_more_segments_come_to_the_same_frequencies() -> None:
    modes = Y.format('modes="2"') + Z.format('modes="2"')
    whole = robot(stepped(), Y.format('modes="6"') + Z.format('modes="6"'))
    divided = robot(stepped(), modes, 'segments="8"')
    np.testing.assert_allclose(held(divided)[:4], held(whole)[:4], rtol=2e-4)


@pytest.mark.parametrize('attributes', ['', 'segments="3"'])
def test_forward_undoes_inverse_and_the_mass_is_the_link_s(attributes: str) -> None:
    modes = Y.format('modes="2"') + Z.format('modes="2"') + '<torsion modes="1"/>'
    found = robot(stepped(), modes, attributes)
    q = 0.02 * np.cos(np.arange(found.n))
    back = found.forward_dynamics(q, q, found.inverse_dynamics(q, q, q))
    np.testing.assert_allclose(back, q, atol=1e-7)
    zero = np.zeros(found.n)
    # about the joint: the link's own 120 + 200 kg m^2, the beam's share taken out and put back
    assert found.inertia_matrix(zero)[0, 0] == pytest.approx(320.0, rel=1e-12)


def test_an_override_scales_the_whole_profile() -> None:
    found = robot(stepped(), Y.format('modes="2"') + '<torsion modes="1"/>')
    part = found.tree.bodies[0].beam
    assert part is not None
    assert part.y is not None
    mean = part.y.stiffness
    integral, _ = quad(rigidity, 0.0, LENGTH, points=[0.9])
    assert mean == pytest.approx(integral / LENGTH, rel=1e-12)
    stiffer = found.with_overrides({'beam.arm.y.ei': 4.0 * mean})
    np.testing.assert_allclose(
        stiffer.natural_frequencies(np.zeros(4))[0],
        2.0 * found.natural_frequencies(np.zeros(4))[0],
        rtol=1e-9,
    )


def test_a_parameter_of_the_profile_is_a_column_of_the_regressor() -> None:
    found = robot(stepped(), Y.format('modes="2"'), 'segments="2"')
    part = found.tree.bodies[0].beam
    assert part is not None
    assert part.y is not None
    q = 0.02 * np.cos(np.arange(found.n))
    for path, value in (
        ('beam.arm.y.ei', part.y.stiffness),
        ('beam.arm.mass_per_length', part.mass_per_length),
    ):
        column = found.torque_regressor(q, q, q, [path])[:, 0]
        if path.endswith('ei'):
            more = found.with_overrides({path: value * 1.5})
            change = more.inverse_dynamics(q, q, q) - found.inverse_dynamics(q, q, q)
            np.testing.assert_allclose(column * 0.5 * value, change, atol=1e-9)
        assert np.isfinite(column).all()


SECTION = '<section type="round" diameter="0.02"/>'


@pytest.mark.parametrize(
    ('stations', 'message'),
    [
        (numbers(0.0, 100.0), r'number of <at> stations must be 2 to 1000, got 1'),
        (numbers(0.1, 9.0) + numbers(2.0, 9.0), r'x of <at> must begin at 0 and end at'),
        (numbers(0.0, 9.0) + numbers(1.9, 9.0), r'x of <at> must begin at 0 and end at'),
        (
            numbers(0, 9.0) + numbers(1.2, 9.0) + numbers(1.0, 9.0) + numbers(2, 9.0),
            r'x of <at> must rise',
        ),
        (numbers(0, 9.0) + 3 * numbers(1.0, 9.0) + numbers(2, 9.0), r'equal for two stations'),
        (2 * numbers(0, 9.0) + numbers(2, 9.0), r'must not step at the root or the tip'),
        (numbers(0, -1.0) + numbers(2, 9.0), r"ei_y of <at x='0'> must be > 0 N m\^2, got -1"),
        (numbers(0, 0.0) + numbers(2, 9.0), r"ei_y of <at x='0'> must be > 0"),
        (numbers(0, 9.0, float('nan')) + numbers(2, 9.0), r"mass_per_length of <at x='0'>"),
        (
            '<at x="0" ei_y="1"/><at x="1"/><at x="2" ei_y="1"/>',
            r'ei_y of <at> must be given at each station',
        ),
        ('<at x="0"/><at x="2"/>', r'must have a <section> or numbers'),
        ('<at x="0" ei_y="1" ea="3"/><at x="2" ei_y="1"/>', r'ea .* the beam does not stretch'),
        ('<at x="0" ei_y="1" angle="3"/><at x="2" ei_y="1"/>', r'angle .* principal axes'),
        (
            '<at x="0" ei_y="1" shear_center_y="0.1"/><at x="2" ei_y="1"/>',
            r'shear_center_y .* on the beam axis',
        ),
        ('<at x="0" eiy="1"/><at x="2" ei_y="1"/>', r'attribute of <at> of <at .* must be one of'),
        (
            f'{MATERIAL}<at x="0">{SECTION}</at><at x="2" ei_y="1"/>',
            r'must have a <section> each, or none',
        ),
        (f'<at x="0">{SECTION}</at><at x="2">{SECTION}</at>', r'must have one <material>, got 0'),
        (
            f'{MATERIAL}<at x="0">{SECTION}</at>'
            '<at x="2"><section type="tube" diameter="0.02" wall="0.001"/></at>',
            r'type must be that of the station before',
        ),
    ],
)
def test_bad_stations_are_refused(stations: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        robot(stations, Y.format('modes="2"'))


@pytest.mark.parametrize(
    ('attributes', 'message'),
    [
        ('segments="2"', r'ei_y must be > 0 at the tip with segments > 1'),
        ('shape="craig-bampton"', r'ei_y must be > 0 at the tip with shape craig-bampton'),
        ('interpolation="spline"', r'interpolation must be one of linear, cubic'),
    ],
)
def test_a_point_at_the_tip_needs_free_modes(attributes: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        robot(rectangles((0.06, 0.05), (0.0, 0.05)), Y.format('modes="2"'), attributes)


def test_a_cubic_curve_is_smooth_and_between_its_stations() -> None:
    rows = [(0.0, 1000.0), (0.5, 900.0), (1.2, 500.0), (2.0, 450.0)]
    found = robot(
        ''.join(numbers(x, ei) for x, ei in rows), Y.format('modes="2"'), 'interpolation="cubic"'
    )
    part = found.tree.bodies[0].beam
    assert part is not None
    assert part.y is not None
    share = np.array([0.0, 0.25, 0.6, 1.0])
    np.testing.assert_allclose(part.y.stiffness_at(share), [ei for _, ei in rows], rtol=1e-12)
    fine = part.y.stiffness_at(np.linspace(0.0, 1.0, 200))
    assert (np.diff(fine) < 0.0).all()
    slopes = part.y.along.values(np.array([0.6 - 1e-9, 0.6 + 1e-9]), 1)
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-6)


def test_a_torque_at_the_tip_of_a_tapered_beam_that_carries_twists_it_rightly() -> None:
    child = (
        '<link name="tool"><inertial><mass value="2"/><inertia ixx="0.1" iyy="0.1" izz="0.1" '
        'ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="f" type="fixed">'
        '<parent link="arm"/><child link="tool"/><origin xyz="2 0 0"/></joint>'
    )
    text = description(beam(stepped(), '<torsion modes="1"/>'), child)
    part = load_robot(text).tree.bodies[0].beam
    assert part is not None
    assert part.torsion is not None
    value = part.torsion.shapes.values(np.array([LENGTH]))[0]
    turn, _ = quad(lambda x: 2.0 / rigidity(x), 0.0, LENGTH, points=[0.9])
    assert value @ (value / part.torsion.modal_stiffness) == pytest.approx(turn, rel=1e-9)


def test_the_tip_of_different_segments_is_that_of_its_section() -> None:
    modes = Y.format('modes="2"') + Z.format('modes="1"')
    found = robot(stepped(), modes, 'segments="3" shape="craig-bampton"')
    q, qd = np.random.default_rng(1).uniform(-0.2, 0.2, (2, found.n))
    section, own = found.section('arm')
    position, rate = TipDeflections(found).evaluate(q, qd)
    np.testing.assert_allclose(position, section.deflection(q[own]), atol=1e-13)
    np.testing.assert_allclose(rate, section.rate(q[own], qd[own]), atol=1e-13)
