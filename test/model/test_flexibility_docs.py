"""The reference for users: its example loads, its lists are complete."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from denoc_ros.errors import ModelError
from denoc_ros.model.overrides import with_overrides
from denoc_ros.model.reading.urdf import load_tree

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / 'docs' / 'flexibility.md').read_text()
EXAMPLE, VARYING, DIVIDED, IMU, LOOP = re.findall(r'```xml\n(.*?)```', TEXT, re.DOTALL)


def test_the_example_loads_without_a_warning() -> None:
    tree = load_tree(EXAMPLE)
    assert tree.warnings == ()
    assert [body.name for body in tree.bodies] == ['upper_arm', 'forearm', 'gripper']
    modes = [body.beam.modes for body in tree.bodies if body.beam is not None]
    assert modes == [(2, 2, 1), (2, 0, 0)]
    assert [sensor.name for sensor in tree.sensors] == ['upper_arm_root', 'forearm_root']


def test_the_varying_beam_loads() -> None:
    boom = (
        '<link name="boom"><inertial><origin xyz="3 0 0"/><mass value="25"/>'
        '<inertia ixx="0.1" ixy="0" ixz="0" iyy="70" iyz="0" izz="70"/></inertial></link>'
    )
    tree = load_tree(f'<robot name="r">{boom}<flexibility>{VARYING}</flexibility></robot>')
    beam = tree.bodies[0].beam
    assert beam is not None
    assert beam.varies
    assert beam.modes == (3, 3, 1)


def test_the_divided_beam_loads() -> None:
    boom = (
        '<link name="boom"><inertial><origin xyz="3 0 0"/><mass value="12"/>'
        '<inertia ixx="0" ixy="0" ixz="0" iyy="36" iyz="0" izz="36"/></inertial></link>'
    )
    imu = IMU.replace('link="gripper"', 'link="boom" station="6"')
    block = f'<flexibility>{DIVIDED}{imu}</flexibility>'
    tree = load_tree(f'<robot name="r">{boom}{block}</robot>')
    assert tree.inertial_sensors[0].mount.station == 6.0 / 8
    assert [body.name for body in tree.bodies] == ['boom', *(f'boom/{k}' for k in range(2, 9))]


def test_the_payload_loads() -> None:
    (payload,) = re.findall(r'`(<payload .*/>)`', TEXT)
    tree = load_tree(EXAMPLE.replace('</flexibility>', f'{payload}</flexibility>'))
    assert tree.payloads['gripper'].mass == 2.5


def test_the_loop_loads() -> None:
    links = '<link name="coupler"/><link name="rocker"/>'
    joint = (
        '<joint name="j" type="continuous"><parent link="coupler"/><child link="rocker"/></joint>'
    )
    tree = load_tree(f'<robot name="r">{links}{joint}<flexibility>{LOOP}</flexibility></robot>')
    assert tree.loops[0].name == 'tip_pin'
    assert {'tip_pin/parent', 'tip_pin/child'} <= set(tree.frames)


@pytest.mark.parametrize('element', ['beam', 'sensor', 'actuator', 'loop', 'spring'])
def test_every_attribute_of_the_block_is_in_the_reference(element: str) -> None:
    """An unknown attribute is refused with a list of those there are."""
    spoiled = (
        f'<robot name="r"><link name="a"/><flexibility><{element} x="1"/></flexibility></robot>'
    )
    with pytest.raises(ModelError, match='attribute of') as caught:
        load_tree(spoiled)
    known = re.search(rf'attribute of <{element}> must be one of (.*?), got', str(caught.value))
    assert known is not None
    for name in known.group(1).split(', '):
        assert re.search(rf'`{name}`|{name}="', TEXT), name


def names_taken() -> set[str]:
    """Return the attributes and elements that the readers of the block let pass."""
    found = set()
    for name in ('reading/flexibility', 'beams/beam_sections', 'sensors'):
        source = (ROOT / 'denoc_ros' / 'model' / f'{name}.py').read_text(encoding='utf-8')
        for call in ast.walk(ast.parse(source)):
            if isinstance(call, ast.Call) and getattr(call.func, 'attr', '') == 'only':
                parts = (part for argument in call.args for part in ast.walk(argument))
                found |= {str(part.value) for part in parts if isinstance(part, ast.Constant)}
    return found


def test_every_name_that_a_reader_takes_is_in_the_reference() -> None:
    names = names_taken()
    assert {'armature', 'gj', 'density', 'axis2', 'field', 'material'} <= names
    missing = [
        name for name in names if not re.search(rf'`<?{name}\b|`[^`]*\b{name}\b|{name}="', TEXT)
    ]
    assert missing == []


def test_the_dotted_paths_of_the_reference_work() -> None:
    odd: dict[str, float | str] = {
        'polar_inertia': 1e-4,
        'modes': 2,
        'shape': 'craig-bampton',
        'segments': 2,
        'com': '0 0 0',
        'inertia': '1 0 0 1 0 1',
    }
    paths = [path.replace('\\|', '|') for path in re.findall(r'\| `([a-z]+\.<[^`]*)`', TEXT)]
    assert len(paths) == 10
    paths.remove('flexible.<link>.<stiffness|damping_ratio|damping>')  # in test_component_links.py
    robot = EXAMPLE.replace('<actuator', f'{IMU}<actuator', 1)
    for path in paths:
        stem, fields = path.rsplit('.', 1)
        stem = stem.replace('<y|z>', 'y').replace('<link>', 'upper_arm')
        sensor = 'tip_imu' if 'gyro' in fields else 'upper_arm_root'
        stem = stem.replace('sensor.<name>', f'sensor.{sensor}').replace('<name>', 'shoulder')
        fields = fields.replace('<joint>', 'shoulder').strip('<>')
        for field in fields.split('|'):
            with_overrides(robot, {f'{stem}.{field}': odd.get(field, 0.01)})
