"""Proposed beams: closed forms come back, the rigid robot stays, doubts are said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
import pytest
from lxml import etree
from small_robots import ARM
from suggested_robots import ALUMINIUM, EI, GJ, LENGTH, MASS, inertial, tube_arm

import denoc_ros as dn
from denoc_ros.errors import ConfigError, ModelError
from denoc_ros.model.inertia import beam_inertia, moved, total
from denoc_ros.model.reading.poses import number_text, rotation_rpy
from denoc_ros.model.reading.urdf import load_tree
from denoc_ros.model.tree import RigidInertia
from denoc_ros.reduction.suggest.outer_size import Outline
from denoc_ros.reduction.suggest.slender import BeamLine, Stiffness, stiffness
from denoc_ros.reduction.suggest.suggested_beam import STUBBY, BeamSuggestion, _judge
from denoc_ros.reduction.suggest.suggestion import suggest_flexibility
from denoc_ros.types import Array

ROBOTS = Path(pinocchio.__file__).parents[4] / 'share' / 'example-robot-data' / 'robots'
AXES = [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.3, -0.5, 0.8)]
ROUNDED = 1e-3  # the file has four digits


def boom(text: str) -> BeamSuggestion:
    (beam,) = suggest_flexibility(text, links=['boom']).beams
    return beam


@pytest.mark.parametrize('axis', AXES)
@pytest.mark.parametrize('motor', [0.0, 2.0])
def test_tube_of_known_size_has_its_closed_form(
    axis: tuple[float, float, float], motor: float
) -> None:
    beam = boom(tube_arm(axis, motor=motor))
    # the mass that can lie along the axis beside a motor at the root is the tube's, nearly: the
    # motor's own size leaves room for a little more
    assert [beam.stiffness.ei_y, beam.stiffness.ei_z] == pytest.approx([EI, EI], rel=0.02)
    assert beam.stiffness.gj == pytest.approx(GJ, rel=0.02)
    assert beam.mass_per_length * LENGTH == pytest.approx(MASS, rel=0.02)
    assert beam.line.length == pytest.approx(LENGTH, rel=1e-6)
    assert beam.line.frame[:3, 0] == pytest.approx(np.array(axis) / np.linalg.norm(axis), abs=1e-6)
    assert beam.stiffness.confidence == ('medium' if motor else 'high')
    # the ball is as wide as the tube, or nearly: taking it for tube of its mass is no great error
    low, high = beam.stiffness.ei_range
    assert high < 1.2 * low


def test_tube_known_by_its_inertia_alone_is_exact() -> None:
    beam = boom(tube_arm(geometry=False))
    assert beam.stiffness.ei_y == pytest.approx(EI, rel=ROUNDED)
    assert beam.stiffness.gj == pytest.approx(GJ, rel=ROUNDED)
    assert 'tube of 60 x 2 mm' in beam.stiffness.section
    assert beam.stiffness.confidence == 'medium'


@pytest.mark.parametrize('motor', [0.2, 2.0, 5.0])
def test_truth_is_in_the_range_stated_where_a_motor_is_in_the_inertia(motor: float) -> None:
    stiff = boom(tube_arm(geometry=False, motor=motor)).stiffness
    low, high = stiff.ei_range
    assert low < EI < high
    assert low <= stiff.ei_y <= high


def test_torsion_comes_with_the_tube_s_own_polar_inertia() -> None:
    text = tube_arm(motor=2.0)
    (beam,) = suggest_flexibility(text, bandwidth=500.0).beams
    assert beam.modes[2] == 1
    assert beam.polar_inertia == pytest.approx(ALUMINIUM.density * GJ / ALUMINIUM.g, rel=0.02)
    (beam,) = suggest_flexibility(text, bandwidth=1.0).beams
    assert beam.modes[2] == 0


def test_stiffness_does_not_depend_on_where_the_line_runs() -> None:
    body = load_tree(tube_arm((1.0, 0.0, 0.0))).bodies[0].inertia
    own = RigidInertia(MASS, np.array([MASS, 0.0, 0.0]), body.inertia)
    line = BeamLine(np.eye(4), LENGTH)
    aside = np.eye(4)
    aside[:3, 3] = 0.0, 0.3, -0.1
    for outer in (None, Outline(0.06, 0.06, True, 'cylinder')):
        found, expected = (
            stiffness(where, line, MASS / LENGTH, outer, ALUMINIUM)
            for where in (moved(own, aside), own)
        )
        assert found.ei_y == pytest.approx(expected.ei_y)
        assert found.ei_range == pytest.approx(expected.ei_range)


def test_cylinder_across_the_link_says_nothing() -> None:
    hub = '<geometry><cylinder radius="0.06" length="2.5"/></geometry></visual>'
    text = tube_arm((1.0, 0.0, 0.0), geometry=False).replace(
        '</inertial></link><link name="tool">',
        f'</inertial><visual><origin xyz="1 0 0"/>{hub}</link><link name="tool">',
    )
    assert hub in text
    assert '(inertia)' in boom(text).stiffness.section


def test_sides_of_a_box_stay_apart() -> None:
    y, z, wall = 0.10, 0.05, 0.003
    area = y * z - (y - 2 * wall) * (z - 2 * wall)
    across = [(z * y**3 - (z - 2 * wall) * (y - 2 * wall) ** 3) / 12.0]
    across.append((y * z**3 - (y - 2 * wall) * (z - 2 * wall) ** 3) / 12.0)
    mass = ALUMINIUM.density * area * LENGTH
    polar = [ALUMINIUM.density * LENGTH * moment for moment in across]
    slender = mass * LENGTH**2 / 12.0
    inertia = np.diag([sum(polar), slender + polar[1], slender + polar[0]])
    shape = '<visual><origin xyz="1 0 0"/><geometry><box size="2 0.1 0.05"/></geometry></visual>'
    text = tube_arm((1.0, 0.0, 0.0))
    start, end = text.index('<inertial>'), text.index('</link><link name="tool">')
    for geometry in (shape, ''):
        own = inertial(mass, np.array([1.0, 0.0, 0.0]), inertia) + geometry
        beam = boom(text[:start] + own + text[end:])
        # z of the beam is along the joint's axis: whichever of the link's that is
        turned = np.abs(beam.line.frame[:3, :3])
        expected = ALUMINIUM.e * turned[1:, 1:].T @ across
        found = [beam.stiffness.ei_y, beam.stiffness.ei_z]
        assert found == pytest.approx(list(expected), rel=0.02)


def test_mesh_is_cut_at_its_middle(tmp_path: Path) -> None:
    import trimesh

    # a flange at the end does not count
    tube = trimesh.creation.cylinder(radius=30.0, height=2000.0, sections=64)
    flange = trimesh.creation.cylinder(radius=90.0, height=20.0, sections=64)
    flange.apply_translation([0.0, 0.0, 990.0])
    mesh: Any = trimesh.util.concatenate([tube, flange])
    (tmp_path / 'meshes').mkdir()
    mesh.export(tmp_path / 'meshes' / 'boom.stl')
    named = '<mesh filename="package://boom/meshes/boom.stl" scale="0.001 0.001 0.001"/>'
    file = tmp_path / 'boom.urdf'
    file.write_text(tube_arm().replace('<cylinder radius="0.03" length="2"/>', named))
    (beam,) = suggest_flexibility(file).beams
    assert '(mesh)' in beam.stiffness.section
    # a polygon of 64 corners is 0.2 % narrower at most, and its wall the thicker
    assert beam.stiffness.ei_y == pytest.approx(EI, rel=0.01)
    named = named.replace('boom.stl', 'missing.stl')
    file.write_text(tube_arm().replace('<cylinder radius="0.03" length="2"/>', named))
    (beam,) = suggest_flexibility(file).beams
    assert '(inertia)' in beam.stiffness.section
    assert 'missing.stl is not available' in beam.stiffness.why


def whole_links(text: str) -> RigidInertia:
    """Return the inertia of a robot whose joints are at zero, about its base."""
    tree = load_tree(text)
    whole, frames = RigidInertia(), list[Array]()
    for body in tree.bodies:
        at = np.eye(4) if body.attachment.body < 0 else frames[body.attachment.body].copy()
        section = np.eye(4)
        section[0, 3] = body.attachment.station
        frames.append(at @ section @ body.attachment.placement @ body.frame)
        own = body.inertia
        if body.beam is not None:
            polar = body.beam.polar_inertia
            own = total(own, beam_inertia(body.beam.mass_per_length, body.beam.length, polar))
        whole = total(whole, moved(own, frames[-1]))
    return whole


PLAIN = [
    ('ur_description/urdf/ur10_robot.urdf', ['upper_arm_link', 'forearm_link']),
    ('z1_description/urdf/z1.urdf', None),
    ('kinova_description/robots/kinova.urdf', None),
    ('talos_data/robots/talos_left_arm.urdf', ['arm_left_4_link']),
    ('panda_description/urdf/panda.urdf', ['panda_link4']),
]


@pytest.mark.parametrize(('file', 'links'), PLAIN)
@pytest.mark.parametrize('bandwidth', [10.0, 300.0])  # without torsion, and with
def test_robots_in_use_keep_mass_centre_and_inertia(
    file: str, links: list[str] | None, bandwidth: float
) -> None:
    plain = (ROBOTS / file).read_text(encoding='utf-8')
    suggestion = suggest_flexibility(ROBOTS / file, links=links, bandwidth=bandwidth)
    tree = load_tree(suggestion.text)
    proposed = {beam.link for beam in suggestion.beams if beam.worth}
    assert proposed
    assert proposed == {body.name for body in tree.bodies if body.beam is not None}
    assert tree.warnings == load_tree(plain).warnings  # none that are the beams'
    before, after = whole_links(plain), whole_links(suggestion.text)
    assert after.mass == pytest.approx(before.mass, rel=1e-9)
    assert after.first_moment == pytest.approx(before.first_moment, rel=1e-9, abs=1e-9)
    assert after.inertia == pytest.approx(before.inertia, rel=1e-9, abs=1e-9)


def test_effort_bends_by_what_of_it_is_across_the_link() -> None:
    plain = tube_arm()
    bent = boom(plain).effort_deflection
    # tau length^2 / (3 EI)
    assert bent == pytest.approx(60.0 * LENGTH**2 / (3.0 * EI), rel=ROUNDED)
    axis = plain[plain.index('<axis') : plain.index('<limit')]
    assert boom(plain.replace(axis, '<axis xyz="0 0 1"/>')).effort_deflection == 0.0
    half = '<axis xyz="0 0.6 0.8"/>'
    assert boom(plain.replace(axis, half)).effort_deflection == pytest.approx(0.6 * bent)
    # the same tube, fixed to a bracket that stands aslant on the joint
    bracket = (
        '<link name="bracket"/><joint name="bolts" type="fixed"><parent link="bracket"/>'
        '<child link="boom"/><origin rpy="0.3 -0.7 1.1"/></joint>'
    )
    turned = plain.replace('<child link="boom"/>', '<child link="bracket"/>').replace(
        '<link name="tool">', f'{bracket}<link name="tool">', 1
    )
    rotation = rotation_rpy(np.array([0.3, -0.7, 1.1]))
    hinge = number_text(*(rotation @ [float(x) for x in axis.split('"')[1].split()]))
    assert boom(turned.replace(axis, f'<axis xyz="{hinge}"/>')).effort_deflection == pytest.approx(
        bent
    )


def test_stiff_arm_is_left_rigid_and_a_long_one_is_not() -> None:
    file = ROBOTS / 'ur_description' / 'urdf' / 'ur10_robot.urdf'
    assert not any(beam.worth for beam in suggest_flexibility(file).beams)
    plain = suggest_flexibility(file)
    assert plain.text == file.read_text(encoding='utf-8')
    (beam,) = suggest_flexibility(tube_arm()).beams
    assert beam.worth
    assert 'sags' in beam.reason


def test_weight_counts_where_there_is_gravity() -> None:
    sags = [suggest_flexibility(tube_arm(), gravity=g).beams[0].sag for g in (0.0, 1.62, 9.81)]
    assert sags == pytest.approx([0.0, sags[2] * 1.62 / 9.81, sags[2]])
    stout = tube_arm(payload=0.0, effort=10.0)  # 15 Hz: above five times this bandwidth
    assert suggest_flexibility(stout, bandwidth=1.0, gravity=0.0).beams[0].worth is False
    assert 'effort' in suggest_flexibility(tube_arm(effort=120.0), gravity=0.0).beams[0].reason


def test_doubts_follow_what_the_file_does_not_say() -> None:
    rod = tube_arm(geometry=False)
    root = etree.fromstring(rod)
    for name in ('ixx', 'iyy'):
        assert float(root.find('link[@name="boom"]/inertial/inertia').get(name)) > 0.0
    root.find('link[@name="boom"]/inertial/inertia').set('izz', '0')
    thin = boom(etree.tostring(root, encoding='unicode')).stiffness
    assert thin.confidence == 'low'
    # a full rod of the tube's mass: E A^2 / (4 pi)
    full = ALUMINIUM.e * (MASS / LENGTH / ALUMINIUM.density) ** 2 / (4.0 * np.pi)
    assert thin.ei_y == pytest.approx(full, rel=ROUNDED)
    inertia = etree.fromstring(tube_arm())
    inertia.find('link[@name="boom"]/inertial/inertia').set('izz', '0')
    sized = boom(etree.tostring(inertia, encoding='unicode')).stiffness
    assert sized.ei_y == pytest.approx(EI, rel=ROUNDED)
    assert 'only the outer size is used' in sized.why
    assert sized.ei_range == pytest.approx((full, EI), rel=ROUNDED)
    # a plate without a thickness
    plate = etree.fromstring(tube_arm(geometry=False))
    about = plate.find('link[@name="boom"]/inertial/inertia')
    about.set('izz', '0.5')
    about.set('ixx', str(float(about.get('iyy')) + 0.5))
    assert 'no section has' in boom(etree.tostring(plate, encoding='unicode')).stiffness.why
    small = tube_arm().replace('radius="0.03"', 'radius="0.008"')
    assert 'motors are in it' in boom(small).stiffness.why


def test_modes_follow_the_bandwidth() -> None:
    counts = [
        sum(suggest_flexibility(tube_arm(), links=['boom'], bandwidth=hertz).beams[0].modes)
        for hertz in (1.0, 10.0, 30.0, 100.0)
    ]
    assert counts == sorted(counts)
    assert counts[-1] > counts[0]
    # below 50 Hz there is one; with a payload it would take two for a true sag
    counted = [
        suggest_flexibility(tube_arm(payload=mass), links=['boom'], bandwidth=5.0).beams[0].modes
        for mass in (0.0, 10.0)
    ]
    assert [modes[0] for modes in counted] == [1, 2]


def test_what_stands_in_the_file_stays() -> None:
    text = tube_arm().replace('</robot>', '<flexibility><!-- mine --></flexibility></robot>')
    found = suggest_flexibility(text).text
    assert '<!-- kept -->' in found
    assert '<!-- mine -->' in found
    assert found.count('<flexibility>') == 1
    head = '<?xml version="1.0"?>\n'
    assert suggest_flexibility(head + text).text == head + found
    assert suggest_flexibility(found).beams == ()  # it has its beam now
    assert suggest_flexibility(found).text == found


def test_bad_wishes_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"must be one of aluminium, .*, got 'cheese'"):
        suggest_flexibility(tube_arm(), material='cheese')
    with pytest.raises(ConfigError, match='bandwidth must be > 0 Hz and finite, got -1'):
        suggest_flexibility(tube_arm(), bandwidth=-1.0)
    with pytest.raises(ConfigError, match=r'gravity must be >= 0 m/s\^2 and finite, got nan'):
        suggest_flexibility(tube_arm(), gravity=float('nan'))
    with pytest.raises(ConfigError, match="link must be one of base, boom, tool, got 'bom'"):
        suggest_flexibility(tube_arm(), links=['bom'])
    with pytest.raises(ModelError, match="link 'base': it has no mass"):
        suggest_flexibility(tube_arm(), links=['base', 'boom'])
    with pytest.raises(ConfigError, match="link 'upper_arm' must have no <beam> yet"):
        suggest_flexibility(ARM, links=['upper_arm'])


@pytest.mark.parametrize('ratio', [3.9999999, 3.996, 3.5, 1.2345])
def test_a_stubby_link_is_said_to_be_less_than_the_rule_asks(ratio: float) -> None:
    """It said `4 times as long as wide` under a rule of `shorter than four times`."""
    stiff = Stiffness(EI, EI, GJ, (EI, EI), 1e-3, LENGTH / ratio, 'tube', 'high', '')
    flexible, said = _judge(LENGTH, stiff, 10.0, 0.0, 0.0, 5.0)
    number = float(said.split()[1])
    assert not flexible
    assert number < STUBBY
    assert ratio - 0.01 < number <= ratio


ROOT_DIAMETER, TIP_DIAMETER, TAPERED_WALL = 0.120, 0.050, 0.003  # m


def tapered_boom(folder: Path, share: float = 1.0) -> Path:
    """Write an arm whose boom is a tapered tube, known by its mesh and its inertia."""
    import trimesh

    x = np.linspace(0.0, LENGTH, 2001)
    outer = ROOT_DIAMETER + (TIP_DIAMETER - ROOT_DIAMETER) * x / LENGTH
    inner = outer - 2.0 * TAPERED_WALL
    per_length = ALUMINIUM.density * np.pi / 4.0 * (outer**2 - inner**2) * share
    turning = ALUMINIUM.density * np.pi / 64.0 * (outer**4 - inner**4) * share
    mass = np.trapezoid(per_length, x)
    centre = np.trapezoid(per_length * x, x) / mass
    across = np.trapezoid(per_length * (x - centre) ** 2 + turning, x)
    inertia = np.diag([across, across, 2.0 * np.trapezoid(turning, x)])
    profile = [[0.0, 0.0], [ROOT_DIAMETER / 2, 0.0], [TIP_DIAMETER / 2, LENGTH], [0.0, LENGTH]]
    trimesh.creation.revolve(profile, sections=96).export(folder / 'boom.stl')
    text = tube_arm()
    start, end = text.index('<inertial>'), text.index('</link><link name="tool">')
    shape = '<visual><geometry><mesh filename="boom.stl"/></geometry></visual>'
    own = inertial(float(mass), np.array([0.0, 0.0, centre]), inertia)
    file = folder / 'boom.urdf'
    file.write_text(text[:start] + own + shape + text[end:])
    return file


@pytest.mark.parametrize('bandwidth', [1.0, 100.0])
def test_a_mesh_that_tapers_is_proposed_by_stations(tmp_path: Path, bandwidth: float) -> None:
    suggestion = suggest_flexibility(tapered_boom(tmp_path), bandwidth=bandwidth, links=['boom'])
    (beam,) = suggestion.beams
    assert 'tapered' in beam.stiffness.section
    torsion = beam.modes[2] > 0
    assert torsion == (bandwidth > 10.0)
    stations = ''.join(
        f'<at x="{x:.6g}"><section type="tube" diameter="{diameter:.9g}" wall="{TAPERED_WALL}">'
        f'<material e="{ALUMINIUM.e}" g="{ALUMINIUM.g}" density="{ALUMINIUM.density}"/>'
        '</section></at>'
        for x in np.linspace(0.0, LENGTH, 11)
        for diameter in [ROOT_DIAMETER + (TIP_DIAMETER - ROOT_DIAMETER) * x / LENGTH]
    )
    element = etree.fromstring(suggestion.text.encode()).find('flexibility/beam')
    assert element is not None
    for at in element.findall('at'):
        element.remove(at)
    for at in etree.fromstring(f'<all>{stations}</all>'):
        element.append(at)
    exact = etree.tostring(element, encoding='unicode')
    start, end = suggestion.text.index('<beam'), suggestion.text.index('</beam>') + len('</beam>')
    robots = [
        dn.load_robot(text, gravity=(0.0, 0.0, 0.0))
        for text in (suggestion.text, suggestion.text[:start] + exact + suggestion.text[end:])
    ]
    # two digits of the tube that is left at the root: what the inertia allows at most
    found, expected = (r.natural_modes(np.zeros(r.n), held=True).frequencies for r in robots)
    assert found == pytest.approx(expected, rel=0.01)


def test_a_mesh_of_one_width_has_no_stations(tmp_path: Path) -> None:
    import trimesh

    file = tapered_boom(tmp_path)
    trimesh.creation.cylinder(radius=0.03, segment=[[0, 0, 0], [0, 0, LENGTH]]).export(
        tmp_path / 'boom.stl'
    )
    (beam,) = suggest_flexibility(file, links=['boom']).beams
    assert not beam.stiffness.stations
