"""Tables of mechanisms: chains and loops become URDFs that close."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from loop_oracle import LoopOracle
from mechanisms import CONFIG, DOWN, SHIPPED, START, mechanism

from denoc_ros.cli.main import main
from denoc_ros.errors import ConfigError
from denoc_ros.export.dh_system import load_system, read_system
from denoc_ros.export.dh_verb import urdf_text
from denoc_ros.model.reading.urdf import load_tree

ROD: dict[str, Any] = {'a': 1.0, 'm': 2.0, 'EI': 100.0}
TRIANGLE: dict[str, Any] = {
    'planar': True,
    'chains': [{'base': [0, 0], 'links': [ROD]}, {'base': [1, 0], 'links': [ROD]}],
    'loops': [{'type': 'revolute', 'parent': 'link_1', 'child': 'link_2'}],
    'modes': 1,
}


@pytest.mark.parametrize(('table', 'kind', 'links'), SHIPPED)
def test_shipped_mechanisms_are_what_the_command_makes(
    table: str, kind: str, links: str, tmp_path: Path
) -> None:
    made = tmp_path / 'made.urdf'
    source = str(CONFIG / 'dh' / f'{table}.yaml')
    assert main(['dh', source, '-o', str(made), '--kinds', links]) == 0
    shipped = CONFIG / 'robots' / f'{table}_{kind.lower()}.urdf'
    assert made.read_text() == shipped.read_text()
    tree = load_tree(shipped)
    assert tree.warnings == ()
    assert sum(body.beam is not None for body in tree.bodies) == links.count('F')


@pytest.mark.parametrize('table', ['four_bar', 'five_bar', 'planar_3dof', 'rssr'])
def test_mechanisms_close_at_the_books_start(table: str) -> None:
    kind = {name: kind for name, kind, links in SHIPPED if 'F' not in links}[table]
    oracle = LoopOracle(load_tree(mechanism(table, kind)), DOWN)
    error = oracle.rows(START[table], np.zeros(oracle.n)).error
    # nine digits are given: the worst sum of roundings of three angles and lengths
    assert np.max(np.abs(error)) < 1e-8


def test_platform_hangs_by_its_vertices_about_its_centre() -> None:
    oracle = LoopOracle(load_tree(mechanism('planar_3dof', '3RR')), DOWN)
    q = START['planar_3dof']
    np.testing.assert_allclose(
        oracle.frame_pose('tool', q)[:2, 3], [0.317768322, 0.288243574], atol=1e-8
    )
    body = next(body for body in oracle.tree.bodies if body.name == 'platform')
    np.testing.assert_allclose(body.inertia.first_moment, [8.0 * 0.0722, 0.0, 0.0])
    assert body.inertia.inertia[2, 2] == pytest.approx(0.01042568 + 8.0 * 0.0722**2)


def test_a_flexible_link_takes_its_own_mass() -> None:
    tables = CONFIG / 'dh' / 'rssr.yaml'
    rigid, flexible = (load_system(tables, kinds=kinds) for kinds in ('RRRR', 'FRFF'))
    assert [link.mass for link in rigid.links] == [15.4, 0.0, 17.3, 7.7]
    assert [link.mass for link in flexible.links] == [5.54, 0.0, 6.24, 2.77]
    assert [link.ei is not None for link in load_system(tables).links] == [True, False, True, True]


def test_a_loop_stands_at_ends_or_at_given_points() -> None:
    ends = [{'link': 'base', 'at': [0.5, 0.2]}, 'link_2']
    table = {
        **TRIANGLE,
        'loops': [dict(zip(('parent', 'child'), ends, strict=True), type='fixed')],
    }
    tree = load_tree(urdf_text(read_system('t', 'n', table)))
    loop = tree.loops[0]
    assert (loop.name, loop.type, loop.axis) == ('loop_1', 'fixed', None)
    np.testing.assert_allclose(tree.frames[loop.parent.frame].placement[:3, 3], [0.5, 0.2, 0.0])
    assert tree.frames[loop.child.frame].station == 1.0


def test_names_of_links_name_their_joints() -> None:
    named = {**ROD, 'name': 'crank'}
    table = {**TRIANGLE, 'chains': [{'base': [0, 0], 'links': [named, ROD]}]}
    table['loops'] = [{'type': 'revolute', 'parent': {'link': 'base', 'at': [1, 0]}}]
    table['loops'][0]['child'] = 'crank'
    tree = load_tree(urdf_text(read_system('t', 'n', table)))
    joints = [body.joint.name for body in tree.bodies if body.joint is not None]
    assert joints == ['crank_joint', 'joint_2']
    assert 'tool' in tree.frames  # at the end of the only chain


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'chains': 3}, 'chains must be a list of one or more entries, got 3'),
        ({'chains': [3]}, 'chain 1 must be a mapping, got 3'),
        ({'chains': [{'links': [ROD]}]}, r'chain 1: base must be 2 or 3 numbers \[m\], got None'),
        (
            {'chains': [{'base': [0, 'x'], 'links': [ROD]}]},
            "chain 1: base must be a finite number m, got 'x'",
        ),
        ({'planar': False}, r'base must be 3 numbers \[m\], got \[0, 0\]'),
        ({'m': [1.0]}, r'm must be given in the chains, if there are some, got \[1.0\]'),
        (
            {'chains': [{'base': [0, 0], 'links': [{**ROD, 'name': 'tool'}]}]},
            "name must be unique, got 'tool'",
        ),
        ({'chains': [{'base': [0, 0], 'links': [{**ROD, 'name': 3}]}]}, 'name must be a text'),
        ({'chains': [{'base': [0, 0], 'links': [{'com': [1, 0], 'm': 1}]}]}, 'inertia must be'),
        ({'loops': [3]}, 'loop 1 must be a mapping, got 3'),
        ({'loops': [{'type': 'screw'}]}, "type must be one of revolute, .*, got 'screw'"),
        (
            {'loops': [{'type': 'fixed', 'parent': 'link_1', 'child': 'link_9'}]},
            r"child must be a rod \(its end\) or .* of link_1, link_2 and base, got 'link_9'",
        ),
        (
            {'tool': {'link': 'link_1', 'on': [1, 0]}},
            "tool: key must be one of at, link, got 'on'",
        ),
    ],
)
def test_a_bad_mechanism_gives_a_finding(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        read_system('t.yaml', 'n', {**TRIANGLE, **change})


def test_a_mechanism_stands_in_a_file_of_several(tmp_path: Path) -> None:
    path = tmp_path / 'systems.yaml'
    path.write_text(yaml.safe_dump({'triangle': TRIANGLE}))
    assert load_system(path, 'triangle').loops[0].parent.link == 'link_1'
