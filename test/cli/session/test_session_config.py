"""The file of `denoc up`: what it must hold, found all at once."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from denoc_ros.bags.run import RecordedPhase
from denoc_ros.cli.session.node_parameters import (
    changed_parameters,
    check_parameters,
    node_parameters,
    plant_numbers,
    session_plant,
)
from denoc_ros.cli.session.session_config import KEYS, NODES, flatten, load_config
from denoc_ros.cli.session.session_file import SessionFile
from denoc_ros.errors import ConfigError
from denoc_ros.model.plant_description import PlantDescription
from denoc_ros.simulation.recorded.run_files import recorded_phases

ROOT = Path(__file__).resolve().parents[3]
GOOD = """
robot: arm.urdf
gravity: [0, 0, 0]
reference: {kind: book, period: [10], rate: [0.1]}
duration: 10
nodes: {feedforward: {update_rate: 500.0, terms: {gravity: false}}}
plant: {position_noise: 0.0, beam.arm.y.ei: 9.0e4}
phases:
  - {name: rigid, feedforward: {model: rigid}}
  - {name: flexible, feedforward: {model: flexible}, shape: {method: tip, tip: tool}}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / 'arm.urdf').write_text('<robot/>')
    (tmp_path / 'good.yaml').write_text(GOOD)
    return tmp_path


def write(folder: Path, text: str) -> Path:
    path = folder / 'bad.yaml'
    path.write_text(text)
    return path


def test_a_good_file_gives_its_values(folder: Path) -> None:
    config = load_config(folder / 'good.yaml')
    assert config.robot == folder / 'arm.urdf'
    assert config.nodes['feedforward'] == {'update_rate': 500.0, 'terms.gravity': False}
    assert config.nodes['plant'] == {'position_noise': 0.0}
    assert config.plant_model == {'beam.arm.y.ei': 9.0e4}
    assert [phase.name for phase in config.phases] == ['rigid', 'flexible']
    assert config.phases[0].nodes == {'feedforward': {'model': 'rigid'}}
    assert not config.phases[0].shape
    assert config.phases[1].shape == {'method': 'tip', 'tip': 'tool'}


def test_all_findings_come_in_one_error(folder: Path) -> None:
    text = """
robot: none.urdf
gravity: [0, 0, .nan]
reference: {kind: circle}
duration: -1
record: perhaps
colour: red
nodes: {visor: {}, plant: 3}
model: {beam.arm.y.ei: much, mass: 1}
phases: [{name: a}, {name: a}, {feedforward: {}}]
"""
    with pytest.raises(ConfigError) as caught:
        load_config(write(folder, text))
    for message in (
        "keys must be of robot, gravity, .*, got 'colour'",
        "robot must be a file .*, got 'none.urdf'",
        'gravity must be three finite numbers .*, got .*nan',
        "reference's kind must be of book, points, sine, got 'circle'",
        r'duration must be a number >= 0 s .*, got -1',
        "record must be true or false, got 'perhaps'",
        "nodes's keys must be of .*, got 'visor'",
        'nodes.plant must be a mapping, got 3',
        "model beam.arm.y.ei must be a finite number or some, got 'much'",
        "model's paths must start with .*, got 'mass'",
        'phases must have different names',
        r'phases\[2\].name must be a text, got None',
    ):
        assert caught.match(message)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('robot: [', 'the text must be YAML, got .*line 1'),
        ('- 1', 'the file must be a mapping, got list'),
        ('robot: arm.urdf\nreference: none.yaml', 'reference must be .* existing YAML file'),
        ('robot: arm.urdf\nphases: []', 'phases must be a list with at least one entry'),
        (
            'robot: arm.urdf\nphases: [{name: a, identify: b}, {name: b}]',
            r"phases\[0\].identify must be an earlier phase \(none\), got 'b'",
        ),
        (
            'robot: arm.urdf\nphases: [{name: a, model: {mass: 1}}]',
            r"phases\[0\].model's paths must start with .*, got 'mass'",
        ),
    ],
)
def test_a_bad_file_says_what_must_hold(folder: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_config(write(folder, text))


def test_a_missing_file_is_named() -> None:
    with pytest.raises(ConfigError, match=r'absent.yaml: the configuration must be a file'):
        load_config('absent.yaml')


def test_settings_reach_their_place(folder: Path) -> None:
    settings = ['duration=3', 'nodes.feedforward.update_rate=250.0', 'beam.arm.z.ei=5']
    config = load_config(folder / 'good.yaml', settings)
    assert config.duration == 3.0
    assert config.nodes['feedforward']['update_rate'] == 250.0
    assert config.model == {'beam.arm.z.ei': 5.0}
    assert config.plant_model == {'beam.arm.y.ei': 9.0e4, 'beam.arm.z.ei': 5.0}


@pytest.mark.parametrize('setting', ['duration', '=3', 'nodes..rate=3', 'duration.x=3'])
def test_a_bad_setting_is_refused(folder: Path, setting: str) -> None:
    with pytest.raises(ConfigError, match=f'--set must .*, got {setting!r}'):
        load_config(folder / 'good.yaml', [setting])


@pytest.mark.parts('viewer')
def test_the_viewer_is_started_only_where_the_file_has_it(folder: Path) -> None:
    assert 'viewer' in load_config(folder / 'good.yaml').without
    for setting, started in (('{}', True), ('{port: 0}', True), ('false', False)):
        config = load_config(folder / 'good.yaml', [f'nodes.viewer={setting}'])
        assert ('viewer' not in config.without) == started


def test_flatten_joins_names() -> None:
    assert flatten({'a': {'b': {'c': 1}}, 'd.e': 2}) == {'a.b.c': 1, 'd.e': 2}


@pytest.mark.parametrize('name', ['canadarm', 'ssrms', 'ur10'])
def test_the_configurations_of_the_package_are_good(name: str) -> None:
    config = load_config(f'config/{name}.yaml')
    assert config.robot.is_file()
    check_parameters(config, list(NODES))


def test_every_key_is_explained_in_the_demo_s_configuration() -> None:
    explained = re.findall(r'^# {3}(\w+) ', (ROOT / 'config' / 'canadarm.yaml').read_text(), re.M)
    assert sorted(explained) == sorted(KEYS)


def test_a_configuration_is_checked_without_ros() -> None:
    """Tables of the nodes' parameters and validation need no middleware."""
    script = (
        'import sys; from denoc_ros.cli.session.session_config import NODES, load_config; '
        'from denoc_ros.cli.session.node_parameters import check_parameters; '
        'check_parameters(load_config("canadarm.yaml"), list(NODES)); '
        'ros = {"rclpy", "rcl_interfaces", "sensor_msgs", "denoc_ros.nodes"} & set(sys.modules); '
        'assert not ros, ros'
    )
    subprocess.run([sys.executable, '-c', script], check=True, timeout=120)


def test_plant_of_a_session_is_described_by_the_node_s_parameters(folder: Path) -> None:
    text = 'robot: arm.urdf\nplant: {segments: 8, beam: {a.y.ei: 2.0}}\n'
    config = load_config(write(folder, text))
    assert session_plant(config) == PlantDescription(segments=8)
    assert node_parameters(config, 'plant', config.phases[0], folder)['segments'] == 8
    for node in ('predictor', 'feedforward'):
        assert 'segments' not in node_parameters(config, node, config.phases[0], folder)
    for bad, message in (
        ('{segments: 300}', "parameter 'segments' must be >= 0, <= 200, got 300"),
        ('{shape: round}', "parameter 'shape' must be .*, got 'round'"),
    ):
        config = load_config(write(folder, f'robot: arm.urdf\nplant: {bad}\n'))
        with pytest.raises(ConfigError, match=message):
            check_parameters(config, ['plant'])


def test_numbers_of_a_phase_s_plant_are_those_of_the_session_and_the_phase(folder: Path) -> None:
    text = (
        'robot: arm.urdf\nplant: {segments: 8, beam: {a.y.ei: 2.0}}\nphases:\n'
        '- {name: right}\n- {name: wrong, plant: {payload.b.mass: 1, beam: {a.y.ei: 1.5}}}\n'
    )
    config = load_config(write(folder, text))
    right, wrong = (plant_numbers(config, phase) for phase in config.phases)
    assert right == {'beam.a.y.ei': 2.0}
    assert wrong == {'beam.a.y.ei': 1.5, 'payload.b.mass': 1}
    file = SessionFile(folder, {'name': 'arm'})
    file.begin_phase('wrong', 10, plant=wrong)
    file.end_phase(20)
    (found,) = recorded_phases(folder)
    assert found == RecordedPhase('wrong', 10, 20, wrong)


def test_a_plant_in_mujoco_has_a_scene_beside_the_configuration(folder: Path) -> None:
    (folder / 'wall.xml').write_text('<mujoco/>')
    plant = 'plant: {engine: mujoco, segments: 8, scene: wall.xml}'
    config = load_config(write(folder, f'robot: arm.urdf\n{plant}\n'))
    assert session_plant(config) == PlantDescription()  # segments are hinges there
    given = node_parameters(config, 'plant', config.phases[0], folder)
    assert given['scene'] == str(folder / 'wall.xml')
    with pytest.raises(ConfigError, match=r"plant scene must be a file .*, got 'gone.xml'"):
        load_config(write(folder, 'robot: arm.urdf\nplant: {scene: gone.xml}\n'))


def test_live_parameters_need_no_new_start() -> None:
    now = {'update_rate': 500.0, 'model': 'rigid', 'payload.tool.mass': 1.0}
    assert changed_parameters('feedforward', now, now) == {}
    # without a value a parameter goes back to its default
    assert changed_parameters('feedforward', now, {**now, 'model': 'flexible'}) == {
        'model': 'flexible'
    }
    without = {key: value for key, value in now.items() if key != 'model'}
    assert changed_parameters('feedforward', now, without) == {'model': 'flexible'}
    assert changed_parameters('feedforward', now, {**now, 'update_rate': 250.0}) is None
    no_payload = {key: value for key, value in now.items() if key != 'payload.tool.mass'}
    assert changed_parameters('feedforward', now, no_payload) is None


def test_the_model_of_a_phase_is_that_of_all_nodes_but_the_plant(folder: Path) -> None:
    text = """
robot: arm.urdf
model: {beam.arm.y.ei: 1.0, payload.tip.mass: 2.0}
plant: {beam.arm.y.ei: 3.0}
phases:
  - {name: a}
  - {name: b, model: {beam.arm.y.ei: 4.0}, plant: {payload.tip.mass: 5.0}}
"""
    config = load_config(write(folder, text))
    first, second = config.phases
    assert config.model_in(first) == {'beam.arm.y.ei': 1.0, 'payload.tip.mass': 2.0}
    assert config.model_in(second) == {'beam.arm.y.ei': 4.0, 'payload.tip.mass': 2.0}
    assert plant_numbers(config, first) == {'beam.arm.y.ei': 3.0}
    assert plant_numbers(config, second) == {'beam.arm.y.ei': 3.0, 'payload.tip.mass': 5.0}
    given = node_parameters(config, 'predictor', second, folder)
    assert given['beam.arm.y.ei'] == 4.0
    given = node_parameters(config, 'plant', second, folder)
    assert given['beam.arm.y.ei'] == 3.0
    assert given['payload.tip.mass'] == 5.0
