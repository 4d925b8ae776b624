"""The topic and service tables of docs/nodes.md are what the running nodes have."""

from __future__ import annotations

import re
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from node_robots import GRAVITY, two_links

from denoc_ros.parts import node_main

pytestmark = pytest.mark.ros

PAGE = Path(__file__).resolve().parents[2] / 'docs' / 'nodes.md'
CLASSES = {
    'feedforward': 'FeedforwardNode',
    'predictor': 'PredictorNode',
    'recorder': 'Recorder',
    'plant': 'PlantNode',
}
# with these a node has every topic that it can have
EVERYTHING: dict[str, dict[str, Any]] = {
    'feedforward': {'publish_joint_trajectory': True, 'impedance.stiffness': [1.0]},
    'predictor': {
        'source': 'torque',
        'effort_source': 'commanded',
        'horizon': 0.05,
        'adapt': ['beam.one.y.ei'],
    },
    'plant': {'feedback.kp': [1.0]},
}
OF_EVERY_NODE = re.compile(
    r'/(rosout|parameter_events|robot_description|\w+/(transition_event|(?!model_)\w*parameter\w*'
    r'|change_state|get_\w+|\w+_type_description))$'
)


def section(node: str) -> str:
    """Return the page's section of a node."""
    found = re.search(rf'^## {node}\n(.*?)(?=^## )', PAGE.read_text(), re.DOTALL | re.MULTILINE)
    assert found is not None, f'docs/nodes.md must have a section of {node}'
    return found[1]


def described(node: str, columns: int) -> dict[str, str]:
    """Return name -> kind (what type begins the cell) of the rows of tables with `columns`."""
    names: dict[str, str] = {}
    kind = ''
    for cells in re.findall(r'^\| (`.*) \|$', section(node), re.MULTILINE):
        row = cells.split(' | ')
        if len(row) != columns:
            continue
        kind = re.split(r'[,:; ]', row[1])[0] if '/' in row[1] else kind
        for name in re.findall(r'`([~/][\w/]*|joint_states|reference|feedforward/\w+)`', row[0]):
            names[name.replace('~', f'/{node}') if '~' in name else f'/{name.strip("/")}'] = kind
    return names


@pytest.mark.parametrize('node', CLASSES)  # the viewer subscribes while somebody looks
def test_topics_and_services_of_the_page_are_the_node_s(
    node: str, graph: Any, tmp_path: Path
) -> None:
    robot = tmp_path / 'arm.urdf'
    robot.write_text(two_links())
    more: dict[str, Any] = {'urdf_path': str(robot)}
    more.update(EVERYTHING.get(node, {}))
    more.update({'output': str(tmp_path / 'bag')} if node == 'recorder' else {'gravity': GRAVITY})
    made = graph.add(getattr(import_module(node_main(node)), CLASSES[node]), parameters=more)
    sensors = {'/strain', '/loads', '/named'}  # the robot's own topics: one row for all

    def topics() -> dict[str, str]:
        found = {
            **dict(made.get_publisher_names_and_types_by_node(node, '/')),
            **dict(made.get_subscriber_names_and_types_by_node(node, '/')),
        }
        return {
            name: kinds[0]
            for name, kinds in found.items()
            if not OF_EVERY_NODE.match(name) and name not in sensors
        }

    def services() -> dict[str, str]:
        found = dict(made.get_service_names_and_types_by_node(node, '/'))
        return {name: each[0] for name, each in found.items() if not OF_EVERY_NODE.match(name)}

    shown = described(node, 3)
    shown.pop('/recorder/marks', None)
    shown.pop('/feedforward/base_wrench', None)  # of robots whose base floats
    shown = {name: kind.replace('/', '/msg/') for name, kind in shown.items()}
    offered = {name: kind.replace('/', '/srv/') for name, kind in described(node, 2).items()}
    with suppress(AssertionError):  # the graph's cache follows creation by a moment
        graph.until(lambda: topics() == shown and services() == offered)
    assert topics() == shown
    assert services() == offered
