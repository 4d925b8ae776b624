"""The layouts for Foxglove and RViz open topics that our nodes publish, as the type they have."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

# What a display of RViz subscribes to.
DISPLAYS = {
    'MarkerArray': 'visualization_msgs/MarkerArray',
    'Pose': 'geometry_msgs/PoseStamped',
    'RobotModel': 'std_msgs/String',
}
JOINT_STATE_FIELDS = {'position', 'velocity', 'effort'}
PANELS = {'3D', 'Plot', 'DiagnosticSummary', 'DiagnosticStatusPanel'}


@pytest.fixture(scope='module')
def published(repository: Path) -> dict[str, str]:
    """Topics that the nodes publish by their documentation, with their types."""
    found: dict[str, str] = {}
    node = kind = ''
    for line in (repository / 'docs/nodes.md').read_text(encoding='utf-8').splitlines():
        if line.startswith('## '):
            node = line[3:].strip()
        cells = [cell.strip() for cell in line.strip('|').split('|')]
        if len(cells) != 3 or not cells[2].startswith('out'):
            continue
        kind = kind if cells[1].startswith('the same') else re.split(r'[:,; ]', cells[1])[0]
        for name in re.findall(r'`([~/\w]+)`', cells[0]):
            found[name.replace('~', f'/{node}') if name[0] in '~/' else f'/{name}'] = kind
    return found


@pytest.fixture(scope='module')
def layout(repository: Path) -> dict[str, Any]:
    text = (repository / 'config/foxglove_layout.json').read_text(encoding='utf-8')
    return dict(json.loads(text))


def leaves(tree: Any) -> Iterator[str]:
    """Yield the panels of a layout's tree."""
    if isinstance(tree, str):
        yield tree
        return
    assert tree['direction'] in ('row', 'column')
    assert 0 < tree['splitPercentage'] < 100
    yield from leaves(tree['first'])
    yield from leaves(tree['second'])


def test_foxglove_shows_each_panel_once(layout: dict[str, Any]) -> None:
    assert sorted(leaves(layout['layout'])) == sorted(layout['configById'])
    assert {name.partition('!')[0] for name in layout['configById']} == PANELS
    assert layout['globalVariables'] == layout['userNodes'] == {}


def test_foxglove_opens_topics_that_are_published(
    layout: dict[str, Any], published: dict[str, str]
) -> None:
    for name, panel in layout['configById'].items():
        if name.startswith('3D!'):
            assert panel['topics']['/predictor/markers']['visible']
            assert set(panel['topics']) <= set(published)
        elif name.startswith('Diagnostic'):
            assert published[panel['topicToRender']] == 'diagnostic_msgs/DiagnosticArray'
        for path in panel.get('paths', ()):
            topic, field, index = re.fullmatch(
                r'(/[\w/]+)\.(\w+)\[(\d+)\]', path['value']
            ).groups()  # type: ignore[union-attr]
            assert published[topic] == 'sensor_msgs/JointState'
            assert field in JOINT_STATE_FIELDS
            assert int(index) >= 0
            assert path['enabled']


def test_foxglove_plots_what_matters(layout: dict[str, Any]) -> None:
    shown = json.dumps(layout)
    for topic in (
        '/predictor/markers',
        '/predictor/tip_deflection.position',
        '/plant/true_deflection.position',
        '/feedforward/effort.effort',
        '/predictor/sensor_residual.position',
        '/diagnostics',
    ):
        assert topic in shown


def test_foxglove_labels_are_the_components(layout: dict[str, Any]) -> None:
    """Six numbers stand for a flexible link: ux, uy, uz, rx, ry, rz."""
    components = ('ux', 'uy', 'uz', 'rx', 'ry', 'rz')
    for path in layout['configById']['Plot!deflection']['paths']:
        index = int(re.findall(r'\[(\d+)\]', path['value'])[0])
        link, component = re.findall(r'flexible link (\d+) (\w+) \[m\]', path['label'])[0]
        assert (int(link) - 1, component) == (index // 6, components[index % 6])
        assert path['label'].startswith('true' if 'true' in path['value'] else 'predicted')


def test_rviz_displays_topics_that_are_published(
    repository: Path, published: dict[str, str]
) -> None:
    config = yaml.safe_load((repository / 'config/denoc.rviz').read_text(encoding='utf-8'))
    displays = config['Visualization Manager']['Displays']
    classes = [display['Class'].partition('/')[2] for display in displays]
    assert {'Grid', 'MarkerArray', 'Pose', 'RobotModel'} <= set(classes)
    for display, kind in zip(displays, classes, strict=True):
        topic = display.get('Topic') or display.get('Description Topic')
        if topic is not None:
            assert published[topic['Value']] == DISPLAYS[kind]
        assert display['Enabled'] == display['Value']
