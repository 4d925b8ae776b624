"""From a file to the tree: order, stations, merged links, shares of inertia, both forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_robots import ROD, beam, block, body_index, joint, link, robot

from denoc_ros.model.inertia import inverse_transform
from denoc_ros.model.reading.urdf import load_tree
from denoc_ros.model.tree import JointKind

Spoil = Callable[[str, str], str]


def test_bodies_stand_depth_first_in_the_order_of_the_files_joints() -> None:
    names = ('root', 'a', 'b', 'a1', 'a2', 'b1')
    tree = robot(
        *(link(name) for name in reversed(names)),
        joint('j6', 'a', 'a2'),
        joint('j1', 'root', 'b'),
        joint('j2', 'root', 'a'),
        joint('j3', 'a', 'a1'),
        joint('j4', 'b', 'b1'),
    )
    assert [body.name for body in tree.bodies] == ['b', 'b1', 'a', 'a2', 'a1']
    assert [body.attachment.body for body in tree.bodies] == [-1, 0, -1, 2, 2]


def test_children_attach_at_the_station_of_their_origin() -> None:
    tree = robot(
        link('base', ''),
        link('arm', ROD),
        *(link(name) for name in ('behind', 'mid', 'beyond')),
        joint('j', 'base', 'arm'),
        joint('j1', 'arm', 'behind', '-0.5 0 0'),
        joint('j2', 'arm', 'mid', '0.5 0.1 0'),
        joint('j3', 'arm', 'beyond', '2.5 0 0'),
        block(beam('arm')),
    )
    stations = {body.name: body.attachment.station for body in tree.bodies}
    assert stations == {'arm': 0.0, 'behind': 0.0, 'mid': 0.5, 'beyond': 2.0}
    offsets = {body.name: body.attachment.placement[:3, 3].tolist() for body in tree.bodies}
    assert offsets['behind'] == [-0.5, 0.0, 0.0]
    assert offsets['mid'] == [0.0, 0.1, 0.0]
    assert offsets['beyond'] == [0.5, 0.0, 0.0]


def test_stations_are_measured_in_the_beam_frame() -> None:
    origin = '<origin xyz="0 0.3 0" rpy="0 0 1.5707963267948966"/>'
    inertial = (
        '<inertial><origin xyz="0 1.3 0"/><mass value="3"/>'
        '<inertia ixx="1" iyy="0" izz="1"/></inertial>'
    )
    bending = f'{origin}<bending direction="y" ei="100" modes="1"/>'
    tree = robot(
        link('base', ''),
        link('arm', inertial),
        link('tip'),
        joint('j', 'base', 'arm'),
        joint('j2', 'arm', 'tip', '0.2 1.5 0'),
        block(beam('arm', inner=bending)),
    )
    at = tree.bodies[1].attachment
    assert at.station == pytest.approx(1.2)
    np.testing.assert_allclose(at.placement[:3, 3], [0.0, -0.2, 0.0], atol=1e-15)
    np.testing.assert_allclose(at.placement[:3, 0], [0.0, -1.0, 0.0], atol=1e-15)
    # The undeformed section and the placement give the link frame back.
    arm = tree.frames['arm']
    section = np.eye(4)
    section[0, 3] = at.station
    in_link = inverse_transform(arm.placement) @ section @ at.placement
    np.testing.assert_allclose(in_link[:3, 3], [0.2, 1.5, 0.0], atol=1e-15)


def test_fixed_links_merge_at_the_root_and_are_lumps_along_the_beam() -> None:
    tree = robot(
        link('base', ''),
        link('arm', ROD),
        *(link(name) for name in ('hub', 'horn', 'payload', 'camera')),
        joint('j', 'base', 'arm'),
        joint('f1', 'arm', 'hub', '0 0 0.2', 'fixed'),
        joint('f2', 'hub', 'horn', '1 0 0', 'fixed'),
        joint('f3', 'arm', 'payload', '2 0 0', 'fixed'),
        joint('f4', 'payload', 'camera', '0.1 0 0', 'fixed'),
        block(beam('arm')),
    )
    assert [(body.name, body.joint is None) for body in tree.bodies] == [
        ('arm', False),
        ('payload', True),
    ]
    arm, payload = tree.bodies
    assert (arm.inertia.mass, payload.inertia.mass) == (2.0, 2.0)
    np.testing.assert_allclose(arm.inertia.first_moment, [1.0, 0.0, 0.4], atol=1e-15)
    np.testing.assert_allclose(payload.inertia.first_moment, [0.1, 0.0, 0.0], atol=1e-15)
    # A rigid link fixed at the root carries its children rigidly, however far out.
    assert tree.frames['horn'].station == 0.0
    np.testing.assert_allclose(tree.frames['horn'].placement[:3, 3], [1.0, 0.0, 0.2])
    assert tree.frames['camera'].body == body_index(tree, 'payload')


def test_flexible_links_on_fixed_joints_and_as_root_are_bodies() -> None:
    tree = robot(
        link('mast', ROD),
        link('boom', ROD),
        link('tip'),
        joint('f', 'mast', 'boom', '2 0 0', 'fixed'),
        joint('j', 'boom', 'tip', '2 0 0'),
        block(beam('mast'), beam('boom')),
    )
    assert [body.name for body in tree.bodies] == ['mast', 'boom', 'tip']
    mast, boom, tip = tree.bodies
    assert mast.joint is None
    assert boom.joint is None
    assert (mast.attachment.body, boom.attachment.body, tip.attachment.body) == (-1, 0, 1)
    assert boom.attachment.station == 2.0


def test_a_plain_urdf_is_a_rigid_tree() -> None:
    tree = robot(
        link('base'),
        link('a'),
        link('b'),
        joint('j', 'base', 'a'),
        joint('f', 'a', 'b', kind='fixed'),
    )
    assert [body.name for body in tree.bodies] == ['a']
    assert tree.bodies[0].inertia.mass == 2.0
    assert tree.frames['base'].body == -1
    assert tree.warnings == ()


def test_joints_are_read_as_urdf_means_them(arm_text: str) -> None:
    tree = load_tree(arm_text)
    shoulder, elbow = (body.joint for body in tree.bodies[:2])
    assert shoulder is not None
    assert elbow is not None
    np.testing.assert_array_equal(shoulder.axis, [0.0, 0.0, 1.0])
    assert (shoulder.damping, shoulder.friction, shoulder.armature) == (0.1, 0.2, 0.5)
    assert (shoulder.limits.lower, shoulder.limits.upper) == (-2.0, 2.0)
    assert (shoulder.limits.effort, shoulder.limits.velocity) == (10.0, 1.0)
    assert elbow.kind is JointKind.PRISMATIC
    assert elbow.mimic is not None
    assert (elbow.mimic.leader, elbow.mimic.multiplier, elbow.mimic.offset) == (
        'shoulder',
        0.5,
        0.1,
    )


def test_absent_limits_and_axes_have_urdfs_defaults() -> None:
    bare = '<joint name="j" type="{}"><parent link="base"/><child link="a"/></joint>'
    turning = robot(link('base'), link('a'), bare.format('continuous')).bodies[0].joint
    assert turning is not None
    np.testing.assert_array_equal(turning.axis, [1.0, 0.0, 0.0])
    assert turning.continuous
    assert turning.limits.upper == math.inf
    assert turning.limits.effort == math.inf


def test_loops_hang_on_the_beam_at_their_stations(arm_text: str) -> None:
    tree = load_tree(arm_text)
    pin, cardan = tree.loops
    assert pin.axis is not None
    np.testing.assert_array_equal(pin.axis, [0.0, 0.0, 1.0])
    assert (pin.damping, pin.friction) == (0.1, 0.2)
    parent = tree.frames[pin.parent.frame]
    assert (parent.body, parent.station) == (body_index(tree, 'upper_arm'), 3.0)
    np.testing.assert_allclose(parent.placement[:3, 3], [0.0, 0.0, 0.1])
    assert cardan.axis2 is not None
    assert tree.frames[cardan.parent.frame].body == -1


def test_missing_meshes_and_foreign_elements_do_not_matter(spoiled: Spoil) -> None:
    text = spoiled(
        '</robot>',
        '<transmission name="t"/><gazebo><x y="1"/></gazebo><material name="m"/>'
        '<!-- a comment --><?pi?></robot>',
    )
    assert len(load_tree(text).bodies) == len(load_tree(spoiled('ixx', 'ixx')).bodies)


def test_what_the_model_does_not_need_is_not_read(spoiled: Spoil) -> None:
    """A soft limit, or a fixed joint's axis, cannot spoil a model that has no use for it."""
    unread = '<safety_controller soft_lower_limit="x"/><calibration rising="x"/>'
    text = spoiled('<dynamics damping="0.1" friction="0.2"/>\n', f'{unread}\n')
    grip = '<parent link="forearm"/><child link="tool"/>'
    assert grip in text
    load_tree(text.replace(grip, f'{grip}<axis xyz="x"/><limit effort="x"/><mimic joint="no"/>'))


def test_text_and_file_give_the_same_tree(tmp_path: Path, arm_text: str) -> None:
    path = tmp_path / 'arm.urdf'
    path.write_text('\ufeff' + arm_text, encoding='utf-8')
    for source in (path, str(path), '\n ' + arm_text):
        tree = load_tree(source)
        assert [body.name for body in tree.bodies] == ['upper_arm', 'forearm', 'tool']
        assert tree.source.startswith('<?xml')


@pytest.mark.long
def test_a_long_chain_loads() -> None:
    count = 3000
    parts = [link(f'l{i}') for i in range(count)]
    parts += [joint(f'j{i}', f'l{i}', f'l{i + 1}') for i in reversed(range(count - 1))]
    tree = robot(*parts)
    assert [body.name for body in tree.bodies] == [f'l{i}' for i in range(1, count)]
