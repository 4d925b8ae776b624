"""Bad input never gives a model: each kind of finding, and all of a file's at once."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings, strategies
from small_robots import ARM, beam, block, link, robot

from denoc_ros.errors import ModelError
from denoc_ros.model.reading.urdf import load_tree

Spoil = Callable[[str, str], str]

# What stands in the good file, what is put there, what the message says.
PLAIN = [
    ('<robot name="arm">', '<robot>', 'robot: name must be given, got nothing'),
    ('<link name="forearm">', '<link>', 'link: name must be given, got nothing'),
    ('<link name="tool">', '<link name="base">', "link 'base': name must be unique, got it twice"),
    ('<mass value="140"/>', '', "link 'upper_arm': <inertial> must have <mass>, got none"),
    (
        '<mass value="140"/>',
        '<mass value="nan"/>',
        "link 'upper_arm': value of <mass> must be >= 0 kg, got 'nan'",
    ),
    ('<mass value="140"/>', '<mass value="-1"/>', 'value of <mass> must be >= 0 kg, got -1'),
    ('<mass value="140"/>', '<mass/>', 'value of <mass> must be >= 0 kg, got nothing'),
    ('iyy="421" ', '', 'iyy of <inertia> must be a finite number kg m\\^2, got nothing'),
    ('iyy="421"', 'iyy="4_21"', "iyy of <inertia> must be a finite number .*, got '4_21'"),
    ('ixy="0"', 'ixy="inf"', "ixy of <inertia> must be a finite number .*, got 'inf'"),
    (
        '<origin xyz="3 0 0" rpy',
        '<origin xyz="3 0" rpy',
        r"xyz of <inertial> must be three finite numbers \[m\], got '3 0'",
    ),
    (
        '</inertial>\n    <visual>',
        '</inertial><inertial/>\n    <visual>',
        "link 'upper_arm': <inertial> must occur once, got 2",
    ),
    ('type="revolute"', 'type="ball"', "joint 'shoulder': type must be one of .*, got 'ball'"),
    (
        'type="revolute"',
        'type="floating"',
        "damping of <dynamics> must be 0 in a floating joint, got '0.1'",
    ),
    ('type="revolute"', 'type="planar"', "not supported yet.*, got 'planar'"),
    ('<joint name="shoulder" type="revolute">', '<joint name="shoulder">', 'type .* got nothing'),
    (
        '<joint name="grip"',
        '<joint name="elbow"',
        "joint 'elbow': name must be unique, got it twice",
    ),
    (
        '<parent link="base"/>',
        '<parent link="bass"/>',
        "joint 'shoulder': parent must be a link of the robot, got 'bass'",
    ),
    ('<child link="upper_arm"/>', '', 'child must be a link of the robot, got None'),
    ('<axis xyz="0 0 2"/>', '<axis xyz="0 0 0"/>', "xyz of <axis> must not be zero, got '0 0 0'"),
    ('<axis xyz="0 0 2"/>', '<axis xyz="0 nan 1"/>', 'xyz of <axis> must be three finite'),
    ('<origin xyz="0 0 1" rpy="0 0 0"/>', '<origin rpy="0 x 0"/>', r'rpy of <origin> .*\[rad\]'),
    ('effort="10"', 'effort="-1"', 'effort of <limit> must be >= 0, got -1'),
    ('velocity="1"', 'velocity="inf"', "velocity of <limit> must be >= 0, got 'inf'"),
    ('lower="-2"', 'lower="3"', r'lower of <limit> must be at most upper \(2\), got 3'),
    ('damping="0.1"', 'damping="-0.1"', 'damping of <dynamics> must be >= 0, got -0.1'),
    ('friction="0.2"', 'friction="x"', "friction of <dynamics> must be >= 0, got 'x'"),
    (
        '<mimic joint="shoulder"',
        '<mimic joint="grip"',
        "joint of <mimic> must be a movable joint of the robot, got 'grip'",
    ),
    ('<mimic joint="shoulder"', '<mimic joint="elbow"', "must not follow themselves.*'elbow'"),
    ('multiplier="0.5"', 'multiplier="nan"', 'multiplier of <mimic> must be a finite number'),
    (
        '<child link="tool"/>',
        '<child link="upper_arm"/>',
        "link 'upper_arm': must be the child of one joint, got two",
    ),
    (
        '<parent link="base"/><child link="upper_arm"/><origin',
        '<parent link="tool"/><child link="upper_arm"/><origin',
        "links must form a tree, got a circle of 'upper_arm', 'tool', 'forearm'",
    ),
    (
        '<link name="base"/>',
        '<link name="base"/><link name="lost"/>',
        "root link must be one, got 'base', 'lost'",
    ),
]

BLOCK = [
    ('</flexibility>', '</flexibility><flexibility/>', 'flexibility: block must occur once'),
    ('</flexibility>', '</flexibility><Flexibility/>', 'must be called <flexibility>, got <Flex'),
    ('<flexibility>', '<flexibility on="1">', 'attribute of <flexibility> must not occur here'),
    ('<actuator', '<rotor/><actuator', "element in <flexibility> must be one of .*, got 'rotor'"),
    ('beam link="upper_arm"', 'beam link="arm"', "link must be a link of the robot, got 'arm'"),
    ('beam link="upper_arm"', 'beam', "beam '': link must be given, got nothing"),
    (
        'beam link="forearm"',
        'beam link="upper_arm"',
        "beam 'upper_arm': link must have one beam, got two",
    ),
    ('length="6.0"', 'length="0"', "beam 'upper_arm': length must be > 0 m, got 0"),
    ('length="6.0"', '', 'length must be > 0 m, got nothing'),
    ('length="6.0"', 'length="6.0" width="1"', "attribute of <beam> must be one of .*'width'"),
    ('length="6.0"', 'length="6.0" mass_per_length="0"', 'mass_per_length must be > 0 kg/m'),
    (
        'length="6.0" shape="clamped-free"',
        'length="6.0" shape="free"',
        "shape must be one of clamped-free.*'free'",
    ),
    (
        '<bending direction="y" ei',
        '<spring/><bending direction="y" ei',
        "element in <beam> must be one of .*'spring'",
    ),
    (
        '<origin xyz="0 0 0" rpy="0 0 0"/>\n      <bending',
        '<origin xyz="0 0 0 0"/>\n      <bending',
        "beam 'upper_arm': xyz of <origin> must be three finite numbers",
    ),
    (
        '<origin xyz="0 0 0" rpy="0 0 0"/>\n      <bending',
        '<origin/><origin/>\n      <bending',
        "beam 'upper_arm': <origin> must occur once, got 2",
    ),
    ('direction="y" ei', 'direction="x" ei', '<bending>: direction must be one of y, z'),
    ('direction="z" ei', 'direction="y" ei', r'direction \(direction y\) must occur once'),
    (
        'ei="1.0e5"',
        'ei="-3.2"',
        r"beam 'upper_arm': ei \(direction y\) must be > 0 N m\^2, got -3.2",
    ),
    ('ei="1.0e5"', 'ei="inf"', r"ei \(direction y\) must be > 0 N m\^2, got 'inf'"),
    ('ei="1.0e5"', '', r'ei \(direction y\) must be > 0 N m\^2, got nothing'),
    ('ei="1.0e5"', 'EI="1.0e5"', "attribute of <bending> .* must be one of direction, ei.*'EI'"),
    ('modes="2"', 'modes="-1"', r'modes \(direction y\) must be a whole number from 0 to 50'),
    ('modes="2"', 'modes="2.0"', "modes .* must be a whole number .*'2.0'"),
    ('modes="2"', 'modes="9999999999999999"', 'modes .* must be a whole number'),
    ('damping_ratio="0.005 0.008"', 'damping_ratio="-0.1"', 'damping_ratio .* must be >= 0 -'),
    ('damping_ratio="0.005 0.008"', 'damping_ratio=""', 'damping_ratio .* must be >= 0'),
    (
        'damping_ratio="0.005 0.008"',
        'damping_ratio="0 0 0"',
        "damping_ratio .* must have one number, or one for each of 2 modes, got '0 0 0'",
    ),
    (
        'damping_ratio="0.005 0.008"',
        'damping_ratio="0" damping="0"',
        'damping .* must not come with damping_ratio',
    ),
    ('gj="4.0e4"', 'gj="0"', r'gj \(torsion\) must be > 0 N m\^2, got 0'),
    ('polar_inertia="0.02"', 'polar_inertia="-1"', r'polar_inertia \(torsion\) must be > 0'),
    ('</beam>', '<torsion gj="1" modes="1"/></beam>', '<torsion> must occur once, got 2'),
    ('type="tube"', 'type="oval"', r'type of <section> must be one of round, tube, rectangle'),
    ('wall="0.004"', 'wall="0.03"', 'wall of <section> must be at most half the diameter'),
    ('wall="0.004"', '', 'wall of <section> must be > 0 m, got nothing'),
    ('wall="0.004"', 'wall="0.004" y="1"', 'attribute of <section> of <section> must be|y'),
    ('density="2700"', 'density="0"', r'density of <material> must be > 0 kg/m\^3, got 0'),
    ('e="7.0e10"', '', 'e of <material> must be > 0 Pa, got nothing'),
    (
        '<material e="7.0e10" g="2.6e10" density="2700"/>',
        '',
        '<section> must have one <material>, got 0',
    ),
    (
        '<section type="tube" diameter="0.05" wall="0.004"/>',
        '',
        '<material> must come with a <section>, got none',
    ),
    (
        '<bending direction="y" modes="2"/>',
        '<bending direction="y" modes="2" ei="1"/>',
        r"ei \(direction y\) must not come with a <section>, got '1'",
    ),
    (
        'length="2.0"',
        'length="2.0" mass_per_length="1"',
        'mass_per_length must not come with a <section>, got 1',
    ),
    (
        '<bending direction="y" modes="2"/>',
        '<torsion modes="1" polar_inertia="1"/>',
        r'polar_inertia \(torsion\) must not come with a <section>',
    ),
    (
        'length="2.0" shape="clamped-free"',
        'length="2.0" shape="craig-bampton"',
        None,
    ),
    (
        '<bending direction="y" modes="2"/>',
        '<bending direction="y" modes="1" ei="1"/>',
        'must not come with',
    ),
    ('joint="shoulder" armature', 'joint="grip" armature', 'movable joint of the robot.*grip'),
    ('armature="0.5"', 'armature="-0.5"', 'armature must be >= 0 kg m\\^2 or kg, got -0.5'),
    ('armature="0.5"', '', 'armature must be >= 0 .*, got nothing'),
    (
        '</flexibility>',
        '<actuator joint="shoulder" armature="1"/></flexibility>',
        "actuator of joint 'shoulder': must occur once, got it twice",
    ),
]

LOOPS = [
    ('loop name="pin"', 'loop', "loop '': name must be given, got nothing"),
    ('loop name="cardan"', 'loop name="pin"', "loop 'pin': name must be unique"),
    ('"pin" type="revolute"', '"pin" type="hinge"', "type must be one of revolute, .*'hinge'"),
    (
        '<child link="forearm" xyz="1 0 0"/>',
        '<child link="fore" xyz="1 0 0"/>',
        "loop 'pin': link of <child> must be a link of the robot, got 'fore'",
    ),
    ('<child link="forearm" xyz="1 0 0"/>', '', '<child> must occur once, got 0'),
    (
        '<child link="forearm" xyz="1 0 0"/>',
        '<child link="upper_arm"/>',
        "parent and child must be two links, got 'upper_arm' twice",
    ),
    ('<axis xyz="0 0 3"/>', '', "loop 'pin': <axis> must occur once, got 0"),
    ('<axis xyz="0 0 3"/>', '<axis xyz="0 0 0"/>', 'xyz of <axis> must not be zero'),
    ('<axis2 xyz="0 1 0"/>', '', "loop 'cardan': <axis2> must occur once, got 0"),
    ('<axis xyz="0 0 3"/>', '<axis xyz="0 0 3"/><axis2 xyz="1 0 0"/>', '<axis2> must not occur'),
    (
        '<axis2 xyz="0 1 0"/>',
        '<axis2 xyz="0 1 0"/><dynamics/>',
        '<dynamics> must not occur in a universal loop',
    ),
    (
        '<axis xyz="0 0 3"/><dynamics damping="0.1"',
        '<axis xyz="0 0 3"/><dynamics damping="-1"',
        "loop 'pin': damping of <dynamics> must be >= 0, got -1",
    ),
    ('xyz="3 0 0.1" rpy', 'xyz="3 0" rpy', 'xyz of <parent> must be three finite numbers'),
    ('<link name="tool">', '<link name="pin/child"/><link name="tool">', "got 'pin/child'"),
]

SENSORS = [
    ('sensor name="gauge"', 'sensor', "sensor '': name must be given, got nothing"),
    ('sensor name="cell"', 'sensor name="gauge"', "sensor 'gauge': name must be unique"),
    ('type="strain_gauge"', 'type="fbg"', "type must be one of strain_gauge, .*'fbg'"),
    (
        'type="strain_gauge" link="upper_arm"',
        'type="strain_gauge" link="tool"',
        "sensor 'gauge': link must be a link with a <beam> or a <flexible>, got 'tool'",
    ),
    ('station="0.05"', 'station="-1"', 'station must be >= 0 m, got -1'),
    ('station="0.05" direction="y"', 'station="0.05"', 'direction must be one of y, z'),
    ('surface="0.02"', '', 'surface must be a finite number m, got nothing'),
    ('gain="2.0"', 'gain="0"', 'gain must not be zero, got 0'),
    ('offset="0.5"', 'offset="nan"', "offset must be a finite number, got 'nan'"),
    ('noise="1e-6"', 'noise="-1"', 'noise must be >= 0, got -1'),
    ('component="shear"', 'component="x"', "component must be one of moment, shear, got 'x'"),
    ('component="shear"', 'component="shear" surface="1"', 'attribute of <sensor> must be one'),
    (
        'station="2" direction="y"',
        'station="2" direction="z"',
        "direction must be one in which beam 'forearm' bends, got 'z'",
    ),
]

SHARES = [
    (
        'length="6.0"',
        'length="6.0" mass_per_length="40"',
        "beam 'upper_arm': rest of the link .*leaves mass -100 kg.*"
        r'largest admissible mass_per_length is 23\.33 kg/m',
    ),
    ('<mass value="140"/>', '<mass value="0"/>', 'link must have a mass.*, got mass 0 kg'),
    (
        'ixx="1.0" iyy="421"',
        'ixx="0" iyy="421"',
        'leaves mass 0 kg and -0.12 kg m.2 about the beam axis',
    ),
]


@pytest.mark.parametrize(('old', 'new', 'message'), [*PLAIN, *BLOCK, *LOOPS, *SENSORS, *SHARES])
def test_a_bad_file_gives_a_finding(
    spoiled: Spoil, old: str, new: str, message: str | None
) -> None:
    if message is None:
        load_tree(spoiled(old, new))
        return
    with pytest.raises(ModelError, match=message):
        load_tree(spoiled(old, new))


def test_all_findings_come_at_once(arm_text: str) -> None:
    text = arm_text
    for old, new in (
        ('<mass value="140"/>', '<mass value="-1"/>'),
        ('<axis xyz="0 1 0"/>\n', '<axis xyz="0 0 0"/>\n'),
        ('ei="2.0e5"', 'ei="nan"'),
        ('<section type="tube" diameter="0.05"', '<section type="tube" diameter="0.5"'),
        ('armature="0.5"', 'armature="x"'),
        ('noise="1e-6"', 'noise="-2"'),
    ):
        assert old in text
        text = text.replace(old, new)
    with pytest.raises(ModelError) as caught:
        load_tree(text)
    found = '\n'.join(caught.value.findings)
    for part in ("link 'upper_arm'", "joint 'elbow'", 'ei (direction z)', 'armature', 'noise'):
        assert part in found
    assert "beam 'forearm': rest of the link" in found, 'a share is checked beside other findings'
    assert len(caught.value.findings) == 6


def test_a_beam_without_an_inertial_is_a_finding() -> None:
    text = """<robot name="r"><link name="a"/><flexibility>
      <beam link="a" length="1"><bending direction="y" ei="1" modes="1"/></beam>
    </flexibility></robot>"""
    with pytest.raises(ModelError, match=r'must have a mass.*, got none'):
        load_tree(text)


def test_a_link_without_extent_cannot_have_a_beam() -> None:
    text = """<robot name="r"><link name="a"><inertial><mass value="1"/>
      <inertia ixx="0" iyy="0" izz="0"/></inertial></link><flexibility>
      <beam link="a" length="1"><bending direction="y" ei="1" modes="1"/></beam>
    </flexibility></robot>"""
    with pytest.raises(ModelError, match="link's mass is not spread along the beam axis"):
        load_tree(text)


def test_torsion_without_polar_inertia_is_a_finding(spoiled: Spoil) -> None:
    text = spoiled(' polar_inertia="0.02"', '').replace('ixx="1.0"', 'ixx="0"')
    with pytest.raises(ModelError, match=r'polar_inertia \(torsion\) must be > 0 .*, got 0'):
        load_tree(text)


def test_craig_bampton_needs_two_modes(spoiled: Spoil) -> None:
    text = spoiled('shape="clamped-free"', 'shape="craig-bampton"')
    text = text.replace('modes="3" damping_ratio="0.005"', 'modes="1"')
    with pytest.raises(ModelError, match=r'modes \(direction z\) must be >= 2 with shape craig'):
        load_tree(text)


def test_mimic_joints_in_a_circle_are_a_finding(spoiled: Spoil) -> None:
    text = spoiled('<dynamics', '<mimic joint="elbow"/><dynamics')
    with pytest.raises(ModelError, match="got a circle of 'shoulder', 'elbow'"):
        load_tree(text)


def test_numbers_whose_products_overflow_are_refused(spoiled: Spoil) -> None:
    with pytest.raises(ModelError, match=r"ei \(direction y\) must be > 0 N m\^2, got '1e41'"):
        load_tree(spoiled('ei="1.0e5"', 'ei="1e41"'))
    with pytest.raises(ModelError, match='length must be > 0 m, got 1e-31'):
        load_tree(spoiled('length="6.0"', 'length="1e-31"'))
    heavy = '<inertial><mass value="1e40"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
    stiff = (
        '<section type="rectangle" y="1e40" z="1e40"/><material e="1e40" density="1e-30"/>'
        '<bending direction="y" modes="50" damping_ratio="1"/>'
    )
    with pytest.raises(ModelError, match='modal stiffness and damping must be finite'):
        robot(link('a', heavy), block(beam('a', 1e-30, stiff)))


VALUES = re.split(r'("[^"]*")', ARM)
ODD = ('0', '-1', 'nan', '1e308', '1e-308', '', 'x', '1 2 3', '0 0 0', 'base', 'tool', '9')


@settings(max_examples=150, deadline=None, derandomize=True)
@given(strategies.data())
def test_damage_gives_a_finite_model_or_findings(data: strategies.DataObject) -> None:
    parts = list(VALUES)
    for _ in range(data.draw(strategies.integers(1, 3))):
        place = 2 * data.draw(strategies.integers(0, len(parts) // 2 - 1)) + 1
        other = 2 * data.draw(strategies.integers(0, len(parts) // 2 - 1)) + 1
        odd = data.draw(strategies.sampled_from((*ODD, None)))
        parts[place] = VALUES[other] if odd is None else f'"{odd}"'
    try:
        tree = load_tree(''.join(parts))
    except ModelError:
        return
    for body in tree.bodies:
        assert np.isfinite(body.inertia.inertia).all()
        deformations = () if body.beam is None else (body.beam.y, body.beam.z, body.beam.torsion)
        for part in deformations:
            if part is not None:
                assert np.isfinite([part.modal_stiffness, part.damping]).all()
