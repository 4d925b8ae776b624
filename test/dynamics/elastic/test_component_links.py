"""Links with component modes: a beam's own modes as three-component columns are that beam."""

from __future__ import annotations

import dataclasses
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from component_links import TURN, beam_as_link

import denoc_ros as dn
from denoc_ros.cli.session.node_parameters import node_table
from denoc_ros.errors import ModelError, StateError
from denoc_ros.model.beams import link_file
from denoc_ros.model.beams.beam_arrays import kernel_axes
from denoc_ros.model.numbers import numbers_of, values_of
from denoc_ros.model.overrides import with_overrides
from denoc_ros.model.reading.source import complete_text
from denoc_ros.types import Array

Pair = tuple[dn.Robot, dn.Robot]  # of beams, and of files
ROUNDING = 1e-12  # of the largest element


def robot_text(flexible: str, turned: bool) -> str:
    """Return an arm of two flexible links with a tool; the second link's beam lies turned."""
    tip = (TURN if turned else np.eye(3)) @ [1.0, 0.0, 0.0]
    return f"""<robot name="arm"><link name="base"/>
    <link name="a"><inertial><origin xyz="0.6 0 0"/><mass value="3"/>
      <inertia ixx="0.1" iyy="0.6" izz="0.6" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <link name="b"><inertial><origin xyz="{0.5 * tip[0]} {0.5 * tip[1]} {0.5 * tip[2]}"/>
      <mass value="2"/><inertia ixx="0.4" iyy="0.4" izz="0.4" ixy="0" ixz="0" iyz="0"/>
      </inertial></link>
    <link name="tool"><inertial><origin xyz="0.1 0 0.05"/><mass value="1"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
      <limit lower="-9" upper="9" effort="1" velocity="1"/></joint>
    <joint name="j2" type="revolute"><parent link="a"/><child link="b"/>
      <origin xyz="1.2 0 0.02" rpy="0.3 0 0"/><axis xyz="0 0.6 0.8"/>
      <limit lower="-9" upper="9" effort="1" velocity="1"/></joint>
    <joint name="j3" type="fixed"><parent link="b"/><child link="tool"/>
      <origin xyz="{tip[0]} {tip[1]} {tip[2]}"/></joint>
    <flexibility>{flexible}</flexibility></robot>"""


def beams(turned: bool) -> str:
    """Return the block of the beams."""
    origin = '<origin rpy="{} {} {}"/>'.format(*_rpy(TURN)) if turned else ''
    return f"""<beam link="a" length="1.2" mass_per_length="2">
      <bending direction="y" ei="300" modes="2" damping_ratio="0.01"/>
      <bending direction="z" ei="200" modes="2"/></beam>
    <beam link="b" length="1.0" mass_per_length="1.5">{origin}
      <bending direction="y" ei="100" modes="2"/>
      <bending direction="z" ei="120" modes="2" damping_ratio="0.02"/></beam>"""


def _rpy(turn: Array) -> tuple[float, float, float]:
    pitch = -np.arcsin(turn[2, 0])
    return np.arctan2(turn[2, 1], turn[2, 2]), pitch, np.arctan2(turn[1, 0], turn[0, 0])


GAUGE = '<sensor name="gauge" type="strain_gauge" link="b" {} gain="3"/>'
FILES = '<flexible link="a" file="a.npz"/><flexible link="b" file="b.npz"/>'


def write_files(robot: dn.Robot, folder: Path, turned: bool) -> None:
    """Write each beam as a file whose frame is called as the joint at its tip."""
    for body, joint in (('a', 'j2'), ('b', 'j3')):
        beam = next(each.beam for each in robot.tree.bodies if each.name == body)
        assert beam is not None
        link = beam_as_link(beam, TURN if turned and body == 'b' else None)
        link = dataclasses.replace(link, frames={joint: link.frames['tip']})
        link_file.write(folder / f'{body}.npz', link)


def twins(folder: Path, turned: bool, geometric: bool = True) -> tuple[dn.Robot, dn.Robot]:
    """Return the robot of beams, and the one of files."""
    block = beams(turned) + GAUGE.format('station="0" direction="y" surface="0.02"')
    beamed = dn.load_robot(robot_text(block, turned), geometric_stiffness=geometric)
    write_files(beamed, folder, turned)
    path = folder / 'arm.urdf'
    path.write_text(robot_text(FILES + GAUGE.format('point="root"'), turned))
    return beamed, dn.load_robot(path, geometric_stiffness=geometric)


@pytest.fixture(scope='module', params=[False, True], ids=['along x', 'turned'])
def pair(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Pair:
    return twins(tmp_path_factory.mktemp('twins'), request.param)


def state(robot: dn.Robot) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(3)
    q, qd, qdd = rng.normal(size=(3, robot.n))
    return 0.2 * q, qd, qdd


def assert_same(ours: object, theirs: object, tolerance: float = ROUNDING) -> None:
    one, other = np.asarray(ours), np.asarray(theirs)
    np.testing.assert_allclose(one, other, 0.0, tolerance * np.abs(other).max())


def test_coordinates_are_named_by_mode(pair: Pair) -> None:
    names = [f'b/m{k}' for k in range(1, 5)]
    assert pair[1].coordinate_names[-4:] == tuple(names)


def test_dynamics_are_those_of_the_beam(pair: Pair) -> None:
    beam, link = pair
    q, qd, qdd = state(beam)
    assert_same(link.inverse_dynamics(q, qd, qdd), beam.inverse_dynamics(q, qd, qdd))
    assert_same(link.forward_dynamics(q, qd, qdd), beam.forward_dynamics(q, qd, qdd), 1e-10)
    assert_same(link.inertia_matrix(q), beam.inertia_matrix(q))
    assert_same(link.energy(q, qd), beam.energy(q, qd))
    assert_same(link.momentum(q, qd), beam.momentum(q, qd))


def test_derivatives_are_those_of_the_beam(pair: Pair) -> None:
    beam, link = pair
    q, qd, qdd = state(beam)
    ours, theirs = (each.inverse_dynamics_derivatives(q, qd, qdd) for each in (link, beam))
    for one, other in zip(ours, theirs, strict=True):
        assert_same(one, other, 1e-11)


def test_frames_are_those_of_the_beam(pair: Pair) -> None:
    beam, link = pair
    q, _, _ = state(beam)
    assert_same(link.frame_pose('tool', q), beam.frame_pose('tool', q))
    assert_same(link.frame_jacobian('tool', q), beam.frame_jacobian('tool', q))
    ours, theirs = link.tip_deflection('b', q), beam.tip_deflection('b', q)
    frame = next(body.frame for body in beam.tree.bodies if body.name == 'b')
    assert_same(ours, frame[:3, :3] @ theirs)


def test_equilibrium_frequencies_and_gauges_are_those_of_the_beam(pair: Pair) -> None:
    beam, link = pair
    q, qd, _ = state(beam)
    assert_same(link.static_deflection(q[[0, 5]]), beam.static_deflection(q[[0, 5]]), 1e-9)
    assert_same(link.natural_frequencies(q), beam.natural_frequencies(q), 1e-10)
    assert_same(link.sensor_values(q, qd), beam.sensor_values(q, qd))


def test_second_order_terms_can_be_left_out(tmp_path: Path) -> None:
    beam, link = twins(tmp_path, True, geometric=False)
    q, qd, qdd = state(beam)
    assert_same(link.inverse_dynamics(q, qd, qdd), beam.inverse_dynamics(q, qd, qdd))
    assert_same(link.frame_pose('tool', q), beam.frame_pose('tool', q))


def test_a_line_of_second_order_terms_costs_one_component(pair: Pair) -> None:
    for body in pair[1].tree.bodies:
        assert body.modes is None or kernel_axes(body.modes.link, body.joint)[1] == 1


def test_a_falling_arm_keeps_its_energy(tmp_path: Path) -> None:
    _, link = twins(tmp_path, True)
    rest = link.with_overrides({f'flexible.{name}.damping': 0.0 for name in 'ab'})
    run = dn.simulate(
        rest, np.zeros(rest.n), np.zeros(rest.n), np.linspace(0.0, 0.1, 3), rtol=1e-11, atol=1e-13
    )
    total = run.energy.sum(axis=1)
    assert np.ptp(total) < 1e-9 * np.abs(run.energy).max()


def test_stiffness_is_a_factor_and_a_column_of_the_regressor(pair: Pair) -> None:
    link = pair[1]
    q, qd, qdd = state(link)
    column = link.torque_regressor(q, qd, qdd, ['flexible.b.stiffness'])[:, 0]
    stiffer = link.with_overrides({'flexible.b.stiffness': 2.0})
    changed = stiffer.inverse_dynamics(q, qd, qdd) - link.inverse_dynamics(q, qd, qdd)
    rates = np.zeros_like(qd)  # a damping ratio goes with the root of the stiffness
    still = stiffer.inverse_dynamics(q, rates, qdd) - link.inverse_dynamics(q, rates, qdd)
    assert_same(still, column)
    assert np.abs(changed[-4:]).max() > 0.0


@pytest.mark.parametrize(
    ('block', 'match'),
    [
        ('<flexible link="b" file="none.npz"/>', "file must be a file, .* got 'none.npz'"),
        ('<flexible link="c" file="b.npz"/>', "link must be a link of the robot, got 'c'"),
        ('<flexible link="b" file="b.npz" modes="2"/>', 'attribute of <flexible> must be one of'),
        ('<flexible link="b" file="b.npz" damping_ratio="1 2"/>', 'one for each of 4 modes'),
        ('<flexible link="b" file="b.npz" stiffness="0"/>', 'stiffness must be > 0, got 0'),
        ('<flexible link="tool" file="b.npz"/>', 'rest of the link beside the file'),
        ('<flexible link="b" file="a.npz" inertial="file"/>', "joint 'j3': .* got j2"),
        (FILES + GAUGE.format('point="tip"'), "point must be a strain point .* got 'tip'"),
        (FILES + GAUGE.format('station="0"'), "must be one of .*, got 'station'"),
        (FILES + '<flexible link="a" file="a.npz"/>', 'must have one <beam> or <flexible>'),
    ],
)
def test_a_bad_element_is_told(tmp_path: Path, block: str, match: str) -> None:
    write_files(dn.load_robot(robot_text(beams(False), False)), tmp_path, False)
    path = tmp_path / 'arm.urdf'
    path.write_text(robot_text(block, False))
    with pytest.raises(ModelError, match=match):
        dn.load_robot(path)


@pytest.mark.parametrize(('factor', 'told'), [(1.0 + 1e-9, False), (1.01, True)])
def test_a_mass_beside_that_of_the_file_is_told(tmp_path: Path, factor: float, told: bool) -> None:
    beamed = dn.load_robot(robot_text(beams(False), False))
    write_files(beamed, tmp_path, False)
    mass = factor * link_file.read(tmp_path / 'b.npz').mass
    text = robot_text(FILES.replace('b.npz"', 'b.npz" inertial="file"'), False)
    path = tmp_path / 'arm.urdf'
    path.write_text(text.replace('<mass value="2"/>', f'<mass value="{mass!r}"/>'))
    warnings = dn.load_robot(path).tree.warnings
    assert any('which the link takes' in each for each in warnings) is told


def test_a_text_needs_an_absolute_path(tmp_path: Path) -> None:
    write_files(dn.load_robot(robot_text(beams(False), False)), tmp_path, False)
    with pytest.raises(ModelError, match='absolute path or a package:// address'):
        dn.load_robot(robot_text(FILES, False))
    text = robot_text(FILES.replace('file="', f'file="{tmp_path}/'), False)
    assert dn.load_robot(text).n == 10


def test_the_text_of_a_robot_from_a_file_is_whole_everywhere(tmp_path: Path) -> None:
    folder = tmp_path / "links & 'arms'"
    folder.mkdir()
    write_files(dn.load_robot(robot_text(beams(False), False)), folder, False)
    file = folder / 'arm.urdf'
    file.write_text(robot_text(FILES, False), encoding='utf-8')
    robot = dn.load_robot(file)
    again = dn.load_robot(robot.tree.source)  # as a node takes it from /robot_description
    assert again.coordinate_names == robot.coordinate_names
    np.testing.assert_array_equal(again.stiffness, robot.stiffness)
    assert complete_text(file) == robot.tree.source == complete_text(robot.tree.source)


def test_every_number_of_a_link_is_a_parameter_of_a_node(pair: Pair) -> None:
    for node in ('plant', 'feedforward', 'predictor', 'shaper'):
        unknown = node_table(node).unknown(numbers_of(pair[1].tree))
        assert not unknown, node


def test_a_station_is_refused(pair: Pair) -> None:
    with pytest.raises(StateError, match='station must be left out'):
        pair[1].tip_deflection('b', np.zeros(10), station=0.5)


# the file ---------------------------------------------------------------------------------------


@pytest.fixture(scope='module')
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('file')
    write_files(dn.load_robot(robot_text(beams(False), False)), folder, False)
    return folder / 'b.npz'


def rewritten(good: Path, path: Path, **changes: object) -> Path:
    """Write the file with some arrays changed, or left out where None."""
    arrays = {**np.load(good), **changes}
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    return path


def test_a_file_reads_as_it_was_written(good: Path, tmp_path: Path) -> None:
    link = link_file.read(good)
    link_file.write(tmp_path / 'again.npz', link)
    again = link_file.read(tmp_path / 'again.npz')
    assert_same(again.points, link.points, 0.0)
    assert again.frames.keys() == link.frames.keys() == {'j3'}
    assert again.source == 'a beam'


@pytest.mark.parametrize(
    ('changes', 'match'),
    [
        ({'mass': np.float64(-1.0)}, 'mass must be > 0 kg, got -1'),
        ({'mass': np.float64(2.0)}, "mass must be the points', got"),
        ({'inertia': np.eye(3)}, "inertia must be the points', got"),
        ({'stiffness': np.array([1.0, 2.0, 3.0, 0.0])}, 'stiffness of each mode must be > 0'),
        ({'stiffness': np.full(4, np.nan)}, "'stiffness' must be finite, got 4"),
        ({'points': np.ones((4, 5))}, "'points' must have shape"),
        ({'units': np.array('mm')}, "'units' must be 'SI', got 'mm'"),
        ({'schema': np.int64(2)}, "'schema' must be 1, got 2"),
        ({'schema': None}, "'schema' must be 1, got none"),
        ({'frames/j3/phi': None}, "'frames/j3/phi' must be in the file"),
        ({'frames/j3/rotation': np.zeros((3, 3))}, "rotation of frame 'j3' must be a proper one"),
        ({'strain/root/direction': np.ones(3)}, "direction of strain point 'root'"),
        ({'quadratic/index': np.full((6, 2), 9)}, 'must name pairs of modes'),
        ({'damping_ratio': np.zeros(4)}, 'damping must stand alone'),
        ({'other': np.zeros(4)}, "'other' must be one that a link file has"),
        (
            {'source': np.array({}, dtype=object)},
            "'source' must hold numbers or text, got pickled",
        ),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else '',
)
def test_a_bad_file_is_told(
    good: Path, tmp_path: Path, changes: dict[str, object], match: str
) -> None:
    with pytest.raises(ModelError, match=re.escape(match) if '[' in match else match):
        link_file.read(rewritten(good, tmp_path / 'bad.npz', **changes))


def test_a_truncated_file_is_told(good: Path, tmp_path: Path) -> None:
    content = good.read_bytes()
    for size in (0, 10, len(content) // 2, len(content) - 5):
        path = tmp_path / f'{size}.npz'
        path.write_bytes(content[:size])
        with pytest.raises(ModelError, match='must be a whole'):
            link_file.read(path)


def test_a_gigabyte_of_zeros_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / 'bomb.npz'
    with (
        zipfile.ZipFile(path, 'w', zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open('points.npy', 'w', force_zip64=True) as file,
    ):
        for _ in range(257):
            file.write(bytes(1 << 20))
    with pytest.raises(ModelError, match='at most 256 MB, got 257'):
        link_file.read(path)


def test_an_array_larger_than_it_says_is_told(good: Path, tmp_path: Path) -> None:
    path = tmp_path / 'more.npz'
    with zipfile.ZipFile(good) as given, zipfile.ZipFile(path, 'w') as archive:
        for name in given.namelist():
            more = bytes(8) if name == 'stiffness.npy' else b''
            archive.writestr(name, given.read(name) + more)
    with pytest.raises(ModelError, match="'stiffness' must have the 32 bytes of its header"):
        link_file.read(path)


def test_numbers_change_as_in_the_description(pair: Pair) -> None:
    _, robot = pair
    for path, value in (
        ('flexible.a.stiffness', 1.7),
        ('flexible.b.damping_ratio', 0.03),
        ('flexible.b.damping', [0.1, 0.2, 0.3, 0.4]),
        ('payload.b.mass', 0.5),
        ('joint.j2.armature', 0.2),
    ):
        live, read = robot.with_overrides({path: value}), with_overrides(robot.tree, {path: value})
        assert_same(live.arrays.diagonals, dn.Robot(read).arrays.diagonals)
        assert_same(live.arrays.constants, dn.Robot(read).arrays.constants)
        wanted = values_of(read)
        for name, found in values_of(live.tree).items():
            assert found == pytest.approx(wanted[name])
        again = live.with_overrides({'flexible.b.stiffness': 0.5})
        both = dn.Robot(with_overrides(read, {'flexible.b.stiffness': 0.5}))
        assert_same(again.arrays.diagonals, both.arrays.diagonals)
