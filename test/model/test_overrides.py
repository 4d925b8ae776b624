"""Dotted paths change what they name, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from denoc_ros.errors import ConfigError, ModelError
from denoc_ros.model.numbers import values_of
from denoc_ros.model.overrides import edited_description, with_overrides
from denoc_ros.model.reading.urdf import load_tree
from denoc_ros.model.tree import Beam, Body, Joint, Tree

Spoil = Callable[[str, str], str]


def beam_of(tree: Tree, link: str) -> Beam:
    found = body_of(tree, link).beam
    assert found is not None
    return found


def body_of(tree: Tree, link: str) -> Body:
    return next(body for body in tree.bodies if body.name == link)


def joint_of(tree: Tree, link: str) -> Joint:
    joint = body_of(tree, link).joint
    assert joint is not None
    return joint


def test_a_rigidity_changes_and_the_damping_ratio_stays(arm_text: str) -> None:
    tree = load_tree(arm_text)
    changed = beam_of(with_overrides(tree, {'beam.upper_arm.y.ei': 4.0e5}), 'upper_arm')
    before = beam_of(tree, 'upper_arm')
    assert changed.y is not None
    assert before.y is not None
    assert changed.y.stiffness == 4.0e5
    np.testing.assert_allclose(changed.y.modal_stiffness, 4.0 * before.y.modal_stiffness)
    np.testing.assert_allclose(changed.y.damping, 2.0 * before.y.damping)
    assert changed.z is not None
    assert changed.z.stiffness == 2.0e5


@pytest.mark.parametrize('value', [[1.0, 2.0], (1, 2), '1 2', np.array([1.0, 2.0])])
def test_damping_replaces_the_damping_ratio_and_back(arm_text: str, value: Any) -> None:
    damped = with_overrides(arm_text, {'beam.upper_arm.y.damping': value})
    y = beam_of(damped, 'upper_arm').y
    assert y is not None
    np.testing.assert_array_equal(y.damping, [1.0, 2.0])
    undamped = with_overrides(damped, {'beam.upper_arm.y.damping_ratio': 0})
    y = beam_of(undamped, 'upper_arm').y
    assert y is not None
    np.testing.assert_array_equal(y.damping, [0.0, 0.0])


def test_a_sensor_is_calibrated_anew(arm_text: str) -> None:
    tree = load_tree(arm_text)
    name = tree.sensors[0].name
    paths = {f'sensor.{name}.gain': 3.0, f'sensor.{name}.offset': -1.0, f'sensor.{name}.noise': 2}
    sensor = with_overrides(tree, paths).sensors[0]
    assert (sensor.gain, sensor.offset, sensor.noise) == (3.0, -1.0, 2.0)
    np.testing.assert_array_equal(sensor.row, tree.sensors[0].row)
    with pytest.raises(ModelError, match='gain must not be zero'):
        with_overrides(tree, {f'sensor.{name}.gain': 0.0})


def test_damping_is_another_name(arm_text: str) -> None:
    by_name = with_overrides(arm_text, {'damping.shoulder': 3.0, 'damping.upper_arm.z': 0.04})
    paths = {'joint.shoulder.damping': 3.0, 'beam.upper_arm.z.damping_ratio': 0.04}
    assert by_name.overrides == paths
    by_path = beam_of(with_overrides(arm_text, paths), 'upper_arm').z
    z = beam_of(by_name, 'upper_arm').z
    assert z is not None
    assert by_path is not None
    np.testing.assert_array_equal(z.damping, by_path.damping)
    assert joint_of(by_name, 'upper_arm').damping == 3.0
    with pytest.raises(ConfigError, match=r"must be that of 'joint\.shoulder\.damping'"):
        with_overrides(arm_text, {'damping.shoulder': 3.0, 'joint.shoulder.damping': 4.0})


def test_the_values_of_a_robot_leave_it_as_it_is(arm_text: str) -> None:
    tree = load_tree(arm_text)
    values = values_of(tree)
    same = with_overrides(tree, values)
    for body, other in zip(tree.bodies, same.bodies, strict=True):
        if body.joint is not None:
            assert body.joint.damping == values[f'joint.{body.joint.name}.damping']
        if body.beam is None:
            continue
        assert other.beam is not None
        for part in ('y', 'z', 'torsion'):
            before, after = getattr(body.beam, part), getattr(other.beam, part)
            if before is not None:
                assert before.stiffness == after.stiffness
                np.testing.assert_allclose(after.damping, before.damping, rtol=1e-11)


def test_modes_change_the_coordinates(arm_text: str) -> None:
    overrides: Mapping[str, Any] = {
        'beam.upper_arm.z.modes': 5.0,
        'beam.upper_arm.torsion.gj': 7.0,
    }
    beam = beam_of(with_overrides(arm_text, overrides), 'upper_arm')
    assert beam.modes == (2, 5, 1)
    assert beam.torsion is not None
    assert beam.torsion.stiffness == 7.0


def test_a_section_is_expanded_when_one_of_its_numbers_changes(arm_text: str) -> None:
    before = beam_of(load_tree(arm_text), 'forearm')
    tree = with_overrides(arm_text, {'beam.forearm.y.ei': 123.0})
    beam = beam_of(tree, 'forearm')
    assert beam.y is not None
    assert beam.y.stiffness == 123.0
    assert beam.mass_per_length == before.mass_per_length
    same = beam_of(with_overrides(arm_text, {'beam.forearm.y.modes': 2}), 'forearm')
    assert same.y is not None
    assert before.y is not None
    assert same.y.stiffness == before.y.stiffness


def test_joints_take_damping_friction_and_armature(arm_text: str) -> None:
    overrides = {
        'joint.shoulder.damping': 1.5,
        'joint.shoulder.armature': 2.5,
        'joint.elbow.friction': np.float64(3.5),
        'joint.elbow.armature': 4,
    }
    tree = with_overrides(arm_text, overrides)
    shoulder, elbow = joint_of(tree, 'upper_arm'), joint_of(tree, 'forearm')
    assert (shoulder.damping, shoulder.friction, shoulder.armature) == (1.5, 0.2, 2.5)
    assert (elbow.damping, elbow.friction, elbow.armature) == (0.0, 3.5, 4.0)


def test_armature_needs_no_flexibility_block() -> None:
    text = (
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous">'
        '<parent link="a"/><child link="b"/></joint></robot>'
    )
    tree = with_overrides(text, {'joint.j.armature': 2})
    assert joint_of(tree, 'b').armature == 2.0


def test_a_payload_adds_to_the_links_body(arm_text: str) -> None:
    tree = load_tree(arm_text)
    overrides: Mapping[str, Any] = {
        'payload.tool.mass': 3.0,
        'payload.tool.com': [0.0, 0.1, 0.0],
        'payload.tool.inertia': np.diag([1.0, 2.0, 3.0]),
    }
    changed = with_overrides(tree, overrides)
    before, after = body_of(tree, 'tool').inertia, body_of(changed, 'tool').inertia
    assert after.mass - before.mass == pytest.approx(3.0)
    np.testing.assert_allclose(after.first_moment - before.first_moment, [0.0, 0.3, 0.0])
    np.testing.assert_allclose(
        np.diag(after.inertia - before.inertia), [1.03, 2.0, 3.03], rtol=1e-14
    )
    assert beam_of(changed, 'upper_arm').mass_per_length == pytest.approx(140.0 / 6.0)


def test_a_payload_on_a_flexible_link_leaves_the_beam(arm_text: str) -> None:
    tree = load_tree(arm_text)
    changed = with_overrides(tree, {'payload.upper_arm.mass': 50})
    assert body_of(changed, 'upper_arm').inertia.mass == pytest.approx(50.0)
    assert beam_of(changed, 'upper_arm').mass_per_length == pytest.approx(140.0 / 6.0)


def test_six_numbers_are_an_inertia_row_by_row(arm_text: str) -> None:
    tree = with_overrides(arm_text, {'payload.tool.inertia': '2 0.1 0.2 2 0.3 3'})
    added = body_of(tree, 'tool').inertia.inertia - 0.1 * np.eye(3)
    expected = [[2.0, 0.1, 0.2], [0.1, 2.0, 0.3], [0.2, 0.3, 3.0]]
    np.testing.assert_allclose(added, expected, rtol=1e-14)


def test_overrides_of_a_tree_stay_until_given_anew(arm_text: str) -> None:
    once = with_overrides(arm_text, {'payload.tool.mass': 3, 'joint.shoulder.damping': 9})
    twice = with_overrides(once, {'payload.tool.mass': 1})
    assert body_of(twice, 'tool').inertia.mass == 3.0
    assert joint_of(twice, 'upper_arm').damping == 9.0
    assert dict(twice.overrides) == {'payload.tool.mass': 1, 'joint.shoulder.damping': 9}
    assert twice.source == arm_text


def test_the_source_is_not_changed(arm_text: str, tmp_path: Path) -> None:
    path = tmp_path / 'arm.urdf'
    path.write_text(arm_text)
    with_overrides(path, {'joint.shoulder.damping': 9})
    assert path.read_text() == arm_text
    tree = load_tree(arm_text)
    with_overrides(tree, {'payload.tool.mass': 3})
    assert body_of(tree, 'tool').inertia.mass == 2.0


@pytest.mark.parametrize(
    ('path', 'value', 'message'),
    [
        (
            'foo',
            1,
            r"path 'foo': must start with beam\., .* sensor\. or damping\., got 'foo'",
        ),
        ('beam.arm.y.ei', 1, r'must be one that the robot has \(beam\.upper_arm\.y\.<ei\|'),
        ('beam.forearm.z.ei', 1, r'beam\.forearm\.y\.<ei\|modes'),
        ('beam.upper_arm.y.gj', 1, 'must be one that the robot has'),
        ('beam.upper_arm', 1, 'must be one that the robot has'),
        ('joint.grip.damping', 1, r'joint\.shoulder\.<damping\|friction\|armature>'),
        ('joint.elbow.limit', 1, 'must be one that the robot has'),
        ('damping.grip', 1, r'damping\.upper_arm\.y, .*damping\.shoulder'),
        ('sensor.nowhere.gain', 1, r'must be one that the robot has \(sensor\.'),
        ('payload.base.mass', 1, r'payload\.forearm\.<mass\|com\|inertia>'),
        ('payload.tool.size', 1, 'must be one that the robot has'),
        ('payload.tool.mass', -1, 'value must be >= 0 kg, got -1'),
        ('payload.tool.mass', 'nan', "value must be 1 finite numbers, got 'nan'"),
        ('payload.tool.com', [1.0, 2.0], 'value must be 3 finite numbers'),
        ('payload.tool.inertia', 1.0, 'value must be 6 or 9 finite numbers'),
        ('joint.elbow.damping', True, 'value must be a number, or numbers, got True'),
        ('joint.elbow.damping', None, 'value must be a number, or numbers, got None'),
    ],
)
def test_what_the_robot_does_not_have_is_refused(
    arm_text: str, path: str, value: Any, message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        with_overrides(arm_text, {path: value})


def test_all_bad_paths_come_at_once(arm_text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        with_overrides(arm_text, {'a': 1, 'joint.b.damping': 1, 'payload.tool.mass': 'x'})
    assert len(caught.value.findings) == 3


def test_a_changed_robot_passes_the_checks_of_a_new_one(arm_text: str) -> None:
    with pytest.raises(ModelError, match=r'ei \(direction y\) must be > 0 N m\^2, got -1'):
        with_overrides(arm_text, {'beam.upper_arm.y.ei': -1})
    with pytest.raises(ModelError, match='one for each of 4 modes'):
        with_overrides(arm_text, {'beam.upper_arm.y.modes': 4})


def test_a_payload_on_the_base_is_refused() -> None:
    text = (
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="fixed">'
        '<parent link="a"/><child link="b"/></joint></robot>'
    )
    with pytest.raises(ConfigError, match='must be on a link that moves'):
        with_overrides(text, {'payload.b.mass': 1})


def test_names_may_have_dots(spoiled: Spoil) -> None:
    text = spoiled('', '').replace('shoulder', 'arm.shoulder').replace('upper_arm', 'arm.upper')
    tree = with_overrides(text, {'joint.arm.shoulder.damping': 2, 'beam.arm.upper.y.ei': 5.0})
    assert joint_of(tree, 'arm.upper').damping == 2.0
    y = beam_of(tree, 'arm.upper').y
    assert y is not None
    assert y.stiffness == 5.0


def test_an_edited_description_is_the_changed_robot_and_keeps_the_rest(arm_text: str) -> None:
    text = arm_text.replace('<flexibility>', '<flexibility><!-- measured in May -->')
    changes: dict[str, Any] = {
        'beam.upper_arm.y.damping_ratio': [0.01, 0.02],
        'beam.forearm.y.damping_ratio': 0.03,
        'joint.shoulder.damping': 0.3,
    }
    edited = edited_description(text, changes)
    assert '<!-- measured in May -->' in edited
    assert values_of(load_tree(edited)) == values_of(with_overrides(text, changes))
    # the forearm keeps its section: its damping is no number of it
    assert edited.count('<section') == text.count('<section') > 0
    again = edited_description(edited, changes)
    assert again == edited


def test_an_edited_description_is_checked(arm_text: str) -> None:
    with pytest.raises(ModelError, match='damping_ratio'):
        edited_description(arm_text, {'beam.upper_arm.y.damping_ratio': -0.1})


def test_a_divided_beam_keeps_the_damping_of_its_first_mode(arm_text: str) -> None:
    arm_text = arm_text.replace('damping_ratio="0.005"', 'damping_ratio="0.005 0.009"')
    assert '0.005 0.009' in arm_text
    divided = beam_of(with_overrides(arm_text, {'beam.upper_arm.segments': 3}), 'upper_arm')
    said = arm_text.replace('shape="clamped-free"', 'segments="3"', 1)
    said = said.replace('damping_ratio="0.005 0.008"', 'damping_ratio="0.005"')
    said = said.replace('damping_ratio="0.005 0.009"', 'damping_ratio="0.005"')
    written = beam_of(load_tree(said), 'upper_arm')
    assert divided.segments == written.segments == 3
    for part in ('y', 'z', 'torsion'):
        one, other = getattr(divided, part), getattr(written, part)
        np.testing.assert_array_equal(one.damping, other.damping)


def test_another_shape_is_that_of_the_attribute(arm_text: str) -> None:
    tree = with_overrides(arm_text, {'beam.upper_arm.shape': 'craig-bampton'})
    said = load_tree(arm_text.replace('clamped-free', 'craig-bampton', 1))
    one, other = beam_of(tree, 'upper_arm').y, beam_of(said, 'upper_arm').y
    assert one is not None
    assert other is not None
    np.testing.assert_array_equal(one.modal_stiffness, other.modal_stiffness)


def test_a_shape_that_is_none_is_refused(arm_text: str) -> None:
    with pytest.raises(ModelError, match='shape must be one of'):
        with_overrides(arm_text, {'beam.upper_arm.shape': 'round'})
