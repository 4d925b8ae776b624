"""The beam's share of a link, what is left, and the beam's own numbers in both forms."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from small_robots import ROD, beam, block, body_index, joint, link, robot

from denoc_ros.errors import ModelError
from denoc_ros.model.beams.beams import flexible_link
from denoc_ros.model.inertia import beam_inertia, moved, total
from denoc_ros.model.reading.findings import Findings
from denoc_ros.model.reading.flexibility import BeamElement
from denoc_ros.model.tree import Deformation, RigidInertia, Tree

Spoil = Callable[[str, str], str]


def test_beam_and_rest_are_the_whole_link() -> None:
    """What the beam takes and what is left add up, in any beam frame."""
    tree_text = (
        '<inertial><origin xyz="0.9 0.1 0.05" rpy="0.3 0.2 0.1"/><mass value="5"/>'
        '<inertia ixx="0.3" iyy="2.6" izz="2.7" ixy="0.01" ixz="-0.02" iyz="0.03"/></inertial>'
    )
    inner = (
        '<origin xyz="0.1 0.05 0" rpy="0.1 -0.05 0.02"/>'
        '<bending direction="z" ei="100" modes="2"/>'
        '<torsion gj="50" polar_inertia="0.01" modes="1"/>'
    )
    rigid = robot(link('base', ''), link('arm', tree_text), joint('j', 'base', 'arm')).bodies[0]
    flexible = robot(
        link('base', ''),
        link('arm', tree_text),
        joint('j', 'base', 'arm'),
        block(beam('arm', 1.5, inner, 'mass_per_length="0.8"')),
    ).bodies[0]
    share = beam_inertia(0.8, 1.5, 0.01)
    whole = moved(total(flexible.inertia, share), flexible.frame)
    assert whole.mass == pytest.approx(rigid.inertia.mass, rel=1e-15)
    np.testing.assert_allclose(whole.first_moment, rigid.inertia.first_moment, atol=1e-15)
    np.testing.assert_allclose(whole.inertia, rigid.inertia.inertia, atol=2e-15)


def test_beam_inertia_is_the_integral_over_the_rod() -> None:
    share = beam_inertia(2.0, 3.0, 0.1)
    assert share.mass == 6.0
    np.testing.assert_allclose(share.first_moment, [9.0, 0.0, 0.0])
    np.testing.assert_allclose(np.diag(share.inertia), [0.3, 18.0, 18.0])


def test_default_mass_per_length_is_the_links_mass_over_the_length() -> None:
    tree = robot(link('base', ''), link('arm', ROD), joint('j', 'base', 'arm'), block(beam('arm')))
    arm = tree.bodies[0]
    assert arm.beam is not None
    assert arm.beam.mass_per_length == 1.5
    assert arm.inertia.mass == 0.0
    assert tree.warnings == ()


def test_default_polar_inertia_is_the_links_about_the_beam_axis() -> None:
    inertial = ROD.replace('ixx="0"', 'ixx="0.02"').replace('xyz="1 0 0"', 'xyz="1 0.1 0"')
    twists = '<origin xyz="0 0.1 0"/><torsion gj="1" modes="1"/>'
    tree = robot(
        link('base', ''),
        link('arm', inertial),
        joint('j', 'base', 'arm'),
        block(beam('arm', inner=twists)),
    )
    assert tree.bodies[0].beam is not None
    assert tree.bodies[0].beam.polar_inertia == pytest.approx(0.02 / 2.0)


@pytest.mark.parametrize(('excess', 'verdict'), [(0.0, 'good'), (5e-4, 'warned'), (2e-3, 'bad')])
def test_a_rest_is_doubtful_up_to_a_thousandth(excess: float, verdict: str) -> None:
    given = block(beam('arm', attributes=f'mass_per_length="{1.5 * (1.0 + excess)}"'))
    parts = (link('base', ''), link('arm', ROD), joint('j', 'base', 'arm'), given)
    if verdict == 'bad':
        with pytest.raises(ModelError, match=r'largest admissible mass_per_length is 1[.]5 kg/m'):
            robot(*parts)
        return
    warnings = robot(*parts).warnings
    assert bool(warnings) == (verdict == 'warned')
    assert all("beam 'arm'" in warning for warning in warnings)


def test_the_largest_admissible_share_is_admissible() -> None:
    """A real link becomes flexible at the second try."""
    lumpy = (
        '<inertial><origin xyz="0.7 0.02 0"/><mass value="8"/>'
        '<inertia ixx="0.05" iyy="0.9" izz="0.92" ixz="0.01"/></inertial>'
    )
    parts = (link('base', ''), link('arm', lumpy), joint('j', 'base', 'arm'))
    with pytest.raises(ModelError, match='largest admissible') as caught:
        robot(*parts, block(beam('arm')))
    largest = str(caught.value).rsplit('mass_per_length is ', 1)[1].split()[0]
    given = f'mass_per_length="{largest}"'
    assert robot(*parts, block(beam('arm', attributes=given))).warnings == ()
    more = f'mass_per_length="{1.02 * float(largest)}"'
    with pytest.raises(ModelError, match='largest admissible'):
        robot(*parts, block(beam('arm', attributes=more)))


def test_polar_inertia_beyond_the_links_is_refused() -> None:
    inertial = ROD.replace('ixx="0"', 'ixx="0.02"')
    parts = (link('base', ''), link('arm', inertial), joint('j', 'base', 'arm'))
    inner = '<torsion gj="1" polar_inertia="{}" modes="1"/>'
    rest = 'mass_per_length="0.5"'
    robot(*parts, block(beam('arm', inner=inner.format(0.01), attributes=rest)))
    with pytest.raises(ModelError, match=r'unless polar_inertia is below 0[.]01 kg'):
        robot(*parts, block(beam('arm', inner=inner.format(0.011), attributes=rest)))


def test_a_link_far_from_its_beam_is_refused() -> None:
    """The measure of a possible rest does not fade with the distance of the mass."""
    findings = Findings()
    far = moved(RigidInertia(3.0, np.zeros(3), np.eye(3)), np.eye(4) + np.eye(4, k=3) * 200.0)
    element = BeamElement('arm', np.eye(4), 2.0, None, None, 'clamped-free', None, None, None)
    assert flexible_link(element, far, findings, []) is None
    assert 'rest of the link' in findings.items[0]


def deformations(tree: Tree, name: str) -> list[Deformation | None]:
    found = tree.bodies[body_index(tree, name)].beam
    assert found is not None
    return [found.y, found.z, found.torsion]


@pytest.mark.parametrize(
    ('section', 'e_iy', 'e_iz', 'g_j', 'area', 'polar'),
    [
        (
            'type="round" diameter="0.04"',
            *(math.pi * 0.04**4 / k for k in (64, 64, 32)),
            math.pi * 0.02**2,
            math.pi * 0.04**4 / 32,
        ),
        (
            'type="rectangle" y="0.03" z="0.02"',
            0.02 * 0.03**3 / 12,
            0.03 * 0.02**3 / 12,
            0.1957607089 * 0.03 * 0.02**3,  # St-Venant's constant for sides 1.5 : 1
            0.03 * 0.02,
            0.03 * 0.02 * (0.03**2 + 0.02**2) / 12,
        ),
    ],
)
def test_section_form_and_explicit_form_give_the_same_model(
    section: str, e_iy: float, e_iz: float, g_j: float, area: float, polar: float
) -> None:
    mass = 2700 * area * 2.0
    inertial = (
        f'<inertial><origin xyz="1 0 0"/><mass value="{mass!r}"/>'
        f'<inertia ixx="{2700 * polar * 2!r}" iyy="{mass / 2!r}" izz="{mass / 2!r}"/></inertial>'
    )
    parts = (link('base', ''), link('arm', inertial), joint('j', 'base', 'arm'))
    material = '<material e="7e10" g="2.6e10" density="2700"/>'
    modes = (
        '<bending direction="y" modes="2" damping_ratio="0.01" {}/>'
        '<bending direction="z" modes="3" damping_ratio="0.01" {}/>'
        '<torsion modes="1" damping_ratio="0.02" {}/>'
    )
    bare = modes.format('', '', '')
    beside, inside = f'<section {section}/>{material}', f'<section {section}>{material}</section>'
    by_section = robot(*parts, block(beam('arm', inner=beside + bare)))
    nested = robot(*parts, block(beam('arm', inner=inside + bare)))
    numbers = (
        f'ei="{7e10 * e_iy!r}"',
        f'ei="{7e10 * e_iz!r}"',
        f'gj="{2.6e10 * g_j!r}" polar_inertia="{2700 * polar!r}"',
    )
    explicit = robot(
        *parts,
        block(
            beam(
                'arm',
                inner=modes.format(*numbers),
                attributes=f'mass_per_length="{2700 * area!r}"',
            )
        ),
    )
    for other in (nested, explicit):
        one, two = by_section.bodies[0].beam, other.bodies[0].beam
        assert one is not None
        assert two is not None
        assert one.mass_per_length == pytest.approx(two.mass_per_length, rel=1e-14)
        assert one.polar_inertia == pytest.approx(two.polar_inertia, rel=1e-14)
        for a, b in zip(deformations(by_section, 'arm'), deformations(other, 'arm'), strict=True):
            assert a is not None
            assert b is not None
            np.testing.assert_allclose(a.modal_stiffness, b.modal_stiffness, rtol=1e-9)
            np.testing.assert_allclose(a.damping, b.damping, rtol=1e-9)


def test_modal_stiffness_is_that_of_the_clamped_beam() -> None:
    tree = robot(link('base', ''), link('arm', ROD), joint('j', 'base', 'arm'), block(beam('arm')))
    y = deformations(tree, 'arm')[0]
    assert y is not None
    mass = 1.5 * np.diag(y.shapes.gram(0))
    omega = np.sqrt(y.modal_stiffness / mass)
    beta = np.array([1.8751040687119611, 4.694091132974175])
    np.testing.assert_allclose(omega, beta**2 * np.sqrt(100 / (1.5 * 2.0**4)), rtol=1e-13)


def test_damping_ratio_is_of_the_critical_damping_at_a_fixed_root() -> None:
    inner = (
        '<bending direction="y" ei="100" modes="2" damping_ratio="0.01 0.03"/>'
        '<bending direction="z" ei="100" modes="2" damping="0.5"/>'
        '<torsion gj="9" polar_inertia="0.01" modes="2" damping_ratio="0.1"/>'
    )
    inertial = ROD.replace('ixx="0"', 'ixx="0.03"')
    parts = (link('base', ''), link('arm', inertial), joint('j', 'base', 'arm'))
    y, z, torsion = deformations(robot(*parts, block(beam('arm', inner=inner))), 'arm')
    assert y is not None
    assert z is not None
    assert torsion is not None
    critical = 2.0 * np.sqrt(y.modal_stiffness * 1.5 * np.diag(y.shapes.gram(0)))
    np.testing.assert_allclose(y.damping, critical * [0.01, 0.03], rtol=1e-14)
    np.testing.assert_array_equal(z.damping, [0.5, 0.5])
    mass = 0.01 * 2.0 / 2.0  # int sin^2 = l / 2
    stiffness = 9.0 * (np.array([0.5, 1.5]) * math.pi / 2.0) ** 2
    np.testing.assert_allclose(torsion.modal_stiffness, stiffness, rtol=1e-13)
    expected = 0.1 * 2.0 * np.sqrt(stiffness * mass)
    np.testing.assert_allclose(torsion.damping, expected, rtol=1e-13)


def test_no_modes_leave_a_rigid_deformation() -> None:
    inner = '<bending direction="y" ei="100" modes="0"/><bending direction="z" ei="9" modes="1"/>'
    tree = robot(
        link('base', ''),
        link('arm', ROD),
        joint('j', 'base', 'arm'),
        block(beam('arm', inner=inner)),
    )
    assert tree.bodies[0].beam is not None
    assert tree.bodies[0].beam.modes == (0, 1, 0)
