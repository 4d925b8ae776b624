"""Parameter files: what stands where, what is for others, and what a node says of itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from node_robots import GRAVITY
from remote_parameters import Remote

from denoc_ros.errors import ConfigError
from denoc_ros.nodes.feedforward import FeedforwardNode
from denoc_ros.nodes.plant import PlantNode
from denoc_ros.nodes.predictor import PredictorNode
from denoc_ros.nodes.recorder import Recorder
from denoc_ros.parts import parameter_table
from denoc_ros.runtime.parameters.parameter_table import shared_names
from denoc_ros.viewer.viewer import ViewerNode

pytestmark = pytest.mark.ros
CLASSES = {
    'feedforward': FeedforwardNode,
    'plant': PlantNode,
    'predictor': PredictorNode,
    'recorder': Recorder,
    'viewer': ViewerNode,
}


def from_file(file: Path, *more: str) -> list[str]:
    return ['--ros-args', '--params-file', str(file), *more]


def made(graph: Any, name: str, arguments: list[str]) -> Any:
    node = CLASSES[name](cli_args=arguments, use_global_arguments=False)
    graph.nodes.append(node)
    graph.executor.add_node(node)
    return node


def section(values: str) -> str:
    return f'{{ros__parameters: {{{values}}}}}'


@pytest.mark.parametrize(
    ('pattern', 'node', 'shared'),
    [
        ('/**', '/arm', True),
        ('/**', '/a/b/arm', True),
        ('/*', '/arm', True),
        ('/a/**', '/a/b/arm', True),
        ('/a/**', '/b/arm', False),  # of others altogether
        ('arm', '/arm', False),
        ('/**/arm', '/a/b/arm', False),
        ('/*/arm', '/a/arm', False),
    ],
)
def test_what_is_for_all_nodes_is_known_by_its_section(
    tmp_path: Path, pattern: str, node: str, shared: bool
) -> None:
    file = tmp_path / 'some.yaml'
    file.write_text(f'{pattern}: {section("x: 1, more: {y: 2}")}')
    found = shared_names(from_file(file), node)
    assert found == ({'x', 'more.y'} if shared else set())


def test_what_is_given_to_the_node_as_well_is_its_own(tmp_path: Path) -> None:
    file = tmp_path / 'some.yaml'
    file.write_text(f'/**: {section("x: 1, y: 2, z: 3")}\na: {{arm: {section("y: 5")}}}')
    assert shared_names(from_file(file, '-p', 'x:=1'), '/a/arm') == {'z'}
    assert shared_names(from_file(file, '-p', 'arm:x:=1'), '/a/arm') == {'z'}
    assert shared_names([*from_file(file), '--', '-p', 'x:=1'], '/arm') == {'x', 'y', 'z'}
    assert shared_names(['--params-file', str(file)], '/arm') == set()
    assert shared_names(from_file(tmp_path / 'none.yaml'), '/arm') == set()
    assert shared_names([], '/arm') == set()


def test_a_name_for_all_nodes_that_this_one_does_not_have_is_left_out(
    graph: Any, tmp_path: Path, urdf: str
) -> None:
    file = tmp_path / 'some.yaml'
    file.write_text(f'/**: {section(f"robot: r2, update_rate: 50.0, urdf_path: {urdf}")}')
    node = made(graph, 'plant', from_file(file))
    assert node.settings.number('update_rate') == 50.0
    assert not node.has_parameter('robot')
    for name in ('/**/plant', 'plant'):
        file.write_text(f'{name}: {section("robot: r2")}')
        with pytest.raises(ConfigError, match="'robot' must be one this node has"):
            made(graph, 'plant', from_file(file))
    file.write_text(f'/**: {section("update_rate: -1.0, robot: r2")}')
    with pytest.raises(ConfigError, match='update_rate') as caught:
        made(graph, 'plant', from_file(file))
    assert len(caught.value.findings) == 1


GIVEN: dict[str, dict[str, Any]] = {
    'feedforward': {'model': 'rigid', 'joint.j2.damping': 0.3, 'lead_time': 0, 'joints': ['j1']},
    'plant': {'payload.two.mass': 2, 'feedback.kp': [1.0, 2.0], 'damping.one.y': 0.05},
    'predictor': {'beam.one.y.ei': 280, 'horizon': 0.1},
    'recorder': {'topics': ['/joint_states']},
    'viewer': {'port': 0},
}


@pytest.mark.parametrize('name', sorted(CLASSES))
def test_a_node_starts_from_what_it_dumps(
    graph: Any, tmp_path: Path, urdf: str, name: str
) -> None:
    node = graph.add(
        CLASSES[name],
        start=False,
        parameters={
            **GIVEN[name],
            'urdf_path': urdf,
            **({} if name == 'recorder' else {'gravity': GRAVITY}),
        },
    )
    node.trigger_configure()
    assert node.state == 'inactive', node.failure
    file = tmp_path / 'dump.yaml'
    file.write_text(Remote(graph, name).dump())
    before = {key: node.settings[key] for key in node.settings}
    graph.remove(node)
    again = made(graph, name, from_file(file))
    again.trigger_configure()
    assert again.state == 'inactive', again.failure
    after = {key: again.settings[key] for key in again.settings}
    assert {key: after[key] for key in before} == before
    # the model's overrides are listed with what holds: nothing else comes along
    listed = {key for key in after if again.table.row(key).is_family}
    assert after.keys() - listed <= before.keys()
    assert Remote(graph, name).dump() == file.read_text()


@pytest.mark.parametrize('name', sorted(CLASSES))
def test_documented_defaults_can_be_given(graph: Any, tmp_path: Path, name: str) -> None:
    table = parameter_table(name)
    defaults = {row.name: row.default for row in table.rows if row.default is not None}
    file = tmp_path / 'defaults.yaml'
    file.write_text(yaml.dump({f'/**/{name}': {'ros__parameters': defaults}}))
    node = made(graph, name, from_file(file, '-r', '__ns:=/arm'))
    assert {key: node.settings[key] for key in node.settings} == defaults


def test_numbers_that_yaml_takes_for_text_can_be_set(graph: Any, urdf: str) -> None:
    node = graph.add(FeedforwardNode, start=False, urdf_path=urdf, gravity=GRAVITY, model='rigid')
    node.trigger_configure()
    remote = Remote(graph, 'feedforward')
    assert remote.give_text('beam.one.y.ei', '2e2') == ''
    assert remote.give_text('lead_time', '1e-3') == ''
    assert node.settings.number('lead_time') == 1e-3
    assert node.get_parameter('lead_time').value == 1e-3
    assert node.get_parameter('beam.one.y.ei').value == 200.0
    assert remote.give_text('beam.one.y.damping_ratio', '[2e-2, 3e-2]') == ''
    assert 'must be a double' in remote.give_text('lead_time', 'soon')
    assert 'one of rigid' in remote.give_text('model', '1e3')
