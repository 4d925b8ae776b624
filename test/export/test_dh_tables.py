"""Tables of Denavit-Hartenberg parameters: kinematics, masses, validation, committed robots."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from denoc_ros.errors import ConfigError, ModelError
from denoc_ros.export import dh_verb as command
from denoc_ros.export.dh_system import DHLink, DHSystem, load_system, read_system
from denoc_ros.export.dh_verb import rod_inertia, urdf_text
from denoc_ros.model.beams.shapes import WaveShapes
from denoc_ros.model.inertia import inverse_transform
from denoc_ros.model.reading.urdf import load_tree
from denoc_ros.model.tree import Joint, JointKind, Tree
from denoc_ros.types import Array

CONFIG = Path(__file__).resolve().parents[2] / 'config'
# Committed robot, table, kinds.
ROBOTS = [
    ('single_link', 'single_link', None),
    ('spinning_beam', 'spinning_beam', None),
    ('two_link_rr', 'two_link', 'RR'),
    ('two_link_rf', 'two_link', 'RF'),
    ('two_link_fr', 'two_link', 'FR'),
    ('two_link_ff', 'two_link', 'FF'),
    ('canadarm', 'canadarm', None),
    ('canadarm_rrr', 'canadarm', 'RRR'),
    ('puma', 'puma', None),
    ('ssrms', 'ssrms', None),
    ('stanford', 'stanford', 'RRRRRR'),
    ('stanford_flexible', 'stanford', None),
]
PLANAR: dict[str, Any] = {'planar': True, 'links': [{'a': 1.0, 'm': 5.0, 'EI': 1e3}], 'modes': 2}
SPATIAL: dict[str, Any] = {
    'joints': 'RP',
    'dh': {'a': [0.3, 0.5], 'b': [0.2, 'b2'], 'alpha_over_pi': [0.5, -0.25]},
    'theta2_over_pi': 0.125,
    'm': [2.0, 3.0],
    'EI': [None, 10.0],
    'modes': 1,
}


def run_command(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    command.add_options(parser)
    return command.run(parser.parse_args(arguments))


@pytest.mark.parametrize(('robot', 'table', 'kinds'), ROBOTS)
def test_committed_robots_are_what_the_command_makes(
    robot: str, table: str, kinds: str | None, tmp_path: Path
) -> None:
    made = tmp_path / 'made.urdf'
    chosen = () if kinds is None else ('--kinds', kinds)
    assert run_command(str(CONFIG / 'dh' / f'{table}.yaml'), '-o', str(made), *chosen) == 0
    committed = CONFIG / 'robots' / f'{robot}.urdf'
    assert made.read_text() == committed.read_text()
    assert load_tree(committed).warnings == ()


def test_a_table_that_is_not_here_is_that_of_the_installed_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_command('dh/puma.yaml', '-o', 'made.urdf') == 0
    assert Path('made.urdf').read_text() == (CONFIG / 'robots' / 'puma.urdf').read_text()


def joint_transform(joint: Joint | None, q: float) -> Array:
    transform = np.eye(4)
    assert joint is not None
    if joint.kind is JointKind.PRISMATIC:
        transform[2, 3] = q
    else:
        c, s = math.cos(q), math.sin(q)
        transform[:2, :2] = [[c, -s], [s, c]]
    return transform


def tip_of(tree: Tree, q: Array) -> Array:
    """Return the undeformed pose of the tool by the tree's bodies."""
    poses: list[Array] = []
    values = iter(q)
    for body in tree.bodies:
        parent = np.eye(4) if body.attachment.body < 0 else poses[body.attachment.body]
        section = np.eye(4)
        section[0, 3] = body.attachment.station
        pose = parent @ section @ body.attachment.placement
        if body.joint is not None:
            pose = pose @ joint_transform(body.joint, next(values))
        poses.append(pose @ body.frame)
    at = tree.frames['tool']
    section = np.eye(4)
    section[0, 3] = at.station
    return np.asarray(poses[at.body] @ section @ at.placement)


def dh_transform(theta: float, b: float, a: float, alpha: float) -> Array:
    """Return Rz(theta) Tz(b) Tx(a) Rx(alpha), written out."""
    ct, st, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
    return np.array(
        [
            [ct, -st * ca, st * sa, a * ct],
            [st, ct * ca, -ct * sa, a * st],
            [0.0, sa, ca, b],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


@pytest.mark.parametrize(('robot', 'table', 'kinds'), ROBOTS)
def test_undeformed_kinematics_are_the_tables(robot: str, table: str, kinds: str | None) -> None:
    system = load_system(CONFIG / 'dh' / f'{table}.yaml', kinds=kinds)
    q = np.random.default_rng(7).uniform(-2.0, 2.0, len(system.links))
    expected = np.eye(4)
    for link, value in zip(system.links, q, strict=True):
        theta, b = (link.theta, value) if link.prismatic else (value, link.b)
        expected = expected @ dh_transform(theta, b, link.a, link.alpha)
    tip = tip_of(load_tree(CONFIG / 'robots' / f'{robot}.urdf'), q)
    np.testing.assert_allclose(tip, expected, atol=1e-13)


def test_kinematics_hold_for_general_twists_and_slides() -> None:
    system = read_system('t', 'general', SPATIAL)
    tip = tip_of(load_tree(urdf_text(system)), np.array([0.4, 0.7]))
    expected = dh_transform(0.4, 0.2, 0.3, 0.5 * math.pi) @ dh_transform(
        0.125 * math.pi, 0.7, 0.5, -0.25 * math.pi
    )
    np.testing.assert_allclose(tip, expected, atol=1e-13)


def test_a_rod_with_a_bend_has_the_integrals_of_its_points() -> None:
    link = DHLink(0.432, 0.1, 0.0, 0.0, False, 6.0, 0.02, None)
    rho = 6.0 / 0.532
    nodes, weights = np.polynomial.legendre.leggauss(4)
    first, second = np.zeros(3), np.zeros((3, 3))
    for start, rod in (((0, 0, 0), (0, 0, 0.1)), ((0, 0, 0.1), (0.432, 0, 0))):
        for node, weight in zip(nodes, weights, strict=True):
            point = np.array(start) + 0.5 * (node + 1.0) * np.array(rod)
            mass = 0.5 * weight * rho * float(np.linalg.norm(rod))
            first += mass * point
            second += mass * np.outer(point, point)
    com, inertia = rod_inertia(link)
    np.testing.assert_allclose(com, first / 6.0, rtol=1e-14)
    about = second - 6.0 * np.outer(com, com)
    expected = np.trace(about) * np.eye(3) - about + np.diag([0.0, 0.0, 0.02])
    np.testing.assert_allclose(inertia, expected, atol=1e-15)


def test_a_link_without_length_is_a_point_at_its_joint() -> None:
    com, inertia = rod_inertia(DHLink(0.0, 0.0, 0.0, 0.0, False, 0.5, 0.0141, None))
    np.testing.assert_array_equal(com, 0.0)
    np.testing.assert_array_equal(inertia, np.diag([0.0, 0.0, 0.0141]))


def test_planar_links_bend_in_the_plane_and_others_in_both() -> None:
    planar = load_tree(CONFIG / 'robots' / 'canadarm.urdf')
    spatial = load_tree(CONFIG / 'robots' / 'ssrms.urdf')
    modes = [body.beam.modes for body in planar.bodies if body.beam is not None]
    assert modes == [(2, 0, 0), (2, 0, 0)]
    modes = [body.beam.modes for body in spatial.bodies if body.beam is not None]
    assert modes == [(2, 2, 0), (2, 2, 0)]
    assert [body.name for body in spatial.bodies if body.beam is not None] == ['link_2', 'link_3']


def test_a_flexible_link_with_an_offset_keeps_it_rigid() -> None:
    tree = load_tree(CONFIG / 'robots' / 'stanford_flexible.urdf')
    link = tree.bodies[1]
    assert link.beam is not None
    assert link.beam.length == 0.432
    assert link.beam.mass_per_length == pytest.approx(6.0 / 0.532, rel=1e-14)
    assert link.inertia.mass == pytest.approx(6.0 * 0.1 / 0.532, rel=1e-12)
    np.testing.assert_allclose(inverse_transform(tree.frames['link_2'].placement)[2, 3], 0.1)


def test_damping_of_the_committed_robots_is_the_tables() -> None:
    """The robots that the demos move are damped a little; those of the comparisons are not."""
    for name in {robot for robot, _, _ in ROBOTS}:
        for body in load_tree(CONFIG / 'robots' / f'{name}.urdf').bodies:
            if body.beam is not None:
                assert body.beam.y is not None
                damped = bool(np.any(body.beam.y.damping > 0.0))
                assert damped == (name in ('canadarm', 'ssrms')), name


def test_rigidity_comes_from_modulus_or_section_as_well() -> None:
    modulus = {**PLANAR, 'links': [{'a': 1.0, 'mass_per_length': 2.0, 'E': '7.0e10', 'I': 2e-7}]}
    link = read_system('t', 'n', modulus).links[0]
    assert link.ei == pytest.approx(14000.0)
    assert link.mass == 2.0
    section = {
        'planar': True,
        'links': [{'a': 1.0, 'm': 1.0, 'hub_inertia': 0.1}],
        'section': {'round_diameter': 0.02, 'E': 2e11},
        'modes': 2,
    }
    link = read_system('t', 'n', section).links[0]
    assert link.ei == pytest.approx(2e11 * math.pi * 0.02**4 / 64.0)
    assert link.hub_inertia == 0.1


def test_one_of_several_systems_is_chosen_by_name(tmp_path: Path) -> None:
    path = tmp_path / 'systems.yaml'
    path.write_text(yaml.safe_dump({'one': PLANAR, 'two': SPATIAL}))
    assert load_system(path, 'two').name == 'two'
    with pytest.raises(ConfigError, match="system must be one of one, two, got 'three'"):
        load_system(path, 'three')


def test_other_shapes_and_dampings_are_passed_on() -> None:
    table = {**PLANAR, 'shape': 'craig-bampton', 'damping_ratio': [0.01, 0.02], 'g': 9.81}
    beam = load_tree(urdf_text(read_system('t', 'n', table))).bodies[0].beam
    assert beam is not None
    assert beam.y is not None
    assert isinstance(beam.y.shapes, WaveShapes)
    assert beam.y.shapes.cubics.shape == (2, 4)
    assert beam.y.damping[1] > 0.0


def spoil(table: dict[str, Any], path: str, value: Any) -> DHSystem:
    """Read a table with the entry of a path such as `dh.a` replaced."""
    first, _, rest = path.partition('.')
    inner = {**table[first], rest: value} if rest else value
    return read_system('t.yaml', 'n', {**table, first: inner})


@pytest.mark.parametrize(
    ('table', 'path', 'value', 'message'),
    [
        (PLANAR, 'colour', 1, "system 'n': key must be one of EI, .*, got 'colour'"),
        (PLANAR, 'planar', 'yes', "planar must be true or false, got 'yes'"),
        (PLANAR, 'links', [], r'links must be a list of one or more entries, got \[\]'),
        (PLANAR, 'links', [3], 'link 1 must be a mapping, got 3'),
        (PLANAR, 'links', [{'a': 0, 'm': 1}], 'link 1: a must be a finite number > 0 m, got 0'),
        (PLANAR, 'links', [{'a': 1}], 'm or mass_per_length must be given, one of them'),
        (PLANAR, 'links', [{'a': 1, 'm': 1, 'L': 2}], "key must be one of E, .*, got 'L'"),
        (PLANAR, 'links', [{'a': 1, 'm': -1}], 'm must be a finite number >= 0 kg, got -1'),
        (PLANAR, 'links', [{'a': 1, 'm': 1, 'EI': 'x'}], "EI must be a finite number > 0 .*'x'"),
        (PLANAR, 'links', [{'a': 1, 'm': 1, 'E': 1e9}], 'I must be a finite number > 0 m.4, got'),
        (PLANAR, 'section', 3, 'section must be a mapping, got 3'),
        (PLANAR, 'modes', -1, 'modes must be a whole number from 0 to 50, got -1'),
        (PLANAR, 'modes', True, 'modes must be a whole number'),
        (PLANAR, 'shape', 'round', "shape must be one of clamped-free, .*, got 'round'"),
        (PLANAR, 'kinds', 'X', "kinds must be 1 letters R .rigid. or F .flexible., got 'X'"),
        (PLANAR, 'kinds', 3, 'kinds must be 1 letters'),
        (PLANAR, 'damping_ratio', -1, 'damping_ratio must be a finite number >= 0 -, got -1'),
        (PLANAR, 'limits', {'effort': 0}, 'effort must be a finite number > 0 SI, got 0'),
        (PLANAR, 'limits', {'lower': 9}, r'lower must be at most upper \(6.28319\), got 9'),
        (PLANAR, 'limits', {'jerk': 9}, "limits: key must be one of effort, .*, got 'jerk'"),
        (PLANAR, 'limits', 3, 'limits must be a mapping, got 3'),
        (SPATIAL, 'dh', 3, r'dh \(or links\) must be a mapping of a, b and alpha_over_pi, got 3'),
        (SPATIAL, 'dh.a', [1.0, math.nan], r'a\[2\] must be a finite number m, got nan'),
        (SPATIAL, 'dh.b', [1.0], r'b must be a list of 2 entries, got \[1.0\]'),
        (SPATIAL, 'dh.b', [1.0, 2.0], r'b\[2\] must be the name of a variable'),
        (SPATIAL, 'dh.c', [1.0, 2.0], "dh: key must be one of a, alpha_over_pi, b, got 'c'"),
        (SPATIAL, 'joints', 'RX', r'joints must be 2 letters R .revolute. or P .prismatic.'),
        (SPATIAL, 'm', None, 'm must be a list of 2 entries, got None'),
        (SPATIAL, 'm', [1.0, -1.0], r'm\[2\] must be a finite number >= 0 kg, got -1.0'),
        (SPATIAL, 'hub_izz', [0.0, 'x'], r"hub_izz\[2\] must be a finite number .*, got 'x'"),
        (SPATIAL, 'EI', [None, -1.0], r'EI\[2\] must be a finite number > 0 N m\^2, got -1.0'),
        (SPATIAL, 'theta2_over_pi', 'x', 'theta2_over_pi must be a finite number'),
        (SPATIAL, 'kinds', 'FF', 'link 1 must have a rigidity EI to be flexible, got None'),
        (SPATIAL, 'm', [1.0, 0.0], 'link 2 must have a > 0 m and m > 0 kg to be flexible'),
    ],
)
def test_a_bad_table_gives_a_finding(
    table: dict[str, Any], path: str, value: Any, message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        spoil(table, path, value)


def test_all_findings_of_a_table_come_at_once() -> None:
    with pytest.raises(ConfigError) as caught:
        read_system('t', 'n', {**PLANAR, 'links': [{'a': 0, 'm': -1}], 'modes': -1, 'x': 1})
    assert len(caught.value.findings) == 4


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('[1, 2]', 'the file must hold a mapping, got list'),
        ('a: [1', 'the text must be YAML, got '),
        ('!!python/object:os.system {}', 'the text must be YAML, got '),
    ],
)
def test_a_bad_yaml_file_is_refused(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / 'bad.yaml'
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        load_system(path)


def test_the_command_says_what_cannot_be_read_or_written(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match='the file must be readable, got: No such file'):
        run_command(str(tmp_path / 'none.yaml'), '-o', str(tmp_path / 'out.urdf'))
    table = str(CONFIG / 'dh' / 'two_link.yaml')
    with pytest.raises(ConfigError, match='the file must be writable, got: No such file'):
        run_command(table, '-o', str(tmp_path / 'none' / 'out.urdf'))


def test_the_command_writes_only_robots_that_load(tmp_path: Path) -> None:
    path, out = tmp_path / 'bad.yaml', tmp_path / 'out.urdf'
    path.write_text(yaml.safe_dump({**PLANAR, 'damping_ratio': [0.1, 0.1, 0.1]}))
    with pytest.raises(ModelError, match='one for each of 2 modes'):
        run_command(str(path), '-o', str(out))
    assert not out.exists()
