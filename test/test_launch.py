"""Launch files: arguments that are described, nodes and parameters that there are."""

from __future__ import annotations

import ast
import importlib.util
import py_compile
import re
import sys
from argparse import ArgumentParser
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import yaml
from launch_files import arguments, started
from launch_stand_in import Context, ExecuteProcess, LifecycleNode, Node

from denoc_ros.cli.session.session_config import NODES
from denoc_ros.parts import parameter_table
from denoc_ros.python_start import module_words

# What is written, packed or listed is the whole package.
pytestmark = pytest.mark.parts('all')

ROOT = Path(__file__).resolve().parent.parent
FILES = sorted((ROOT / 'launch').glob('*.launch.py'))
ROBOT = str(ROOT / 'config' / 'robots' / 'canadarm.urdf')
BAG = str(ROOT / 'config')  # any that there is
# what each starts when it is given no more than it needs
STARTS = {
    'bringup': {'predictor', 'feedforward'},
    'feedforward': {'feedforward'},
    'replay': {'predictor', 'feedforward', 'viewer', 'player'},
    'shaper': {'shaper'},
    'sim': {'plant', 'predictor', 'feedforward'},
    'simulation': {'plant', 'predictor', 'feedforward', 'recorder'},
    'two_robots': {f'arm{k}/{n}' for k in (1, 2) for n in ('plant', 'predictor', 'feedforward')},
}
OTHERS = {
    'params': str(ROOT / 'config' / 'plant.yaml'),
    'urdf': str(ROOT / 'config' / 'robots' / 'ur10.urdf'),
    'bag': str(ROOT / 'launch'),
}
NEEDED = {
    'bringup': {},
    'feedforward': {},
    'replay': {'bag': BAG, 'urdf': ROBOT},
    'shaper': {},
    'sim': {'urdf': ROBOT},
    'simulation': {'urdf': ROBOT},
    'two_robots': {'urdf': ROBOT},
}


def path(name: str) -> Path:
    return ROOT / 'launch' / f'{name}.launch.py'


def context() -> Context:
    return Context({'denoc_ros': ROOT})


def start(name: str, **given: str) -> dict[str, Any]:
    """Return what a launch file starts, by name."""
    found = started(path(name), {**NEEDED[name], **given}, context())
    named = {label(process): process for process in found}
    assert len(named) == len(found)
    return named


def label(process: ExecuteProcess) -> str:
    return process.full_name.strip('/') if isinstance(process, Node) else 'process'


def test_every_launch_file_is_tried() -> None:
    assert [file.name for file in FILES] == [f'{name}.launch.py' for name in sorted(STARTS)]


@pytest.mark.parametrize('file', FILES, ids=lambda file: file.stem)
def test_it_compiles_and_imports_nothing_that_is_not_there(file: Path, tmp_path: Path) -> None:
    py_compile.compile(str(file), str(tmp_path / 'compiled'), doraise=True)
    for statement in ast.walk(ast.parse(file.read_text(encoding='utf-8'))):
        if isinstance(statement, ast.ImportFrom) and statement.module:
            assert importlib.util.find_spec(statement.module), statement.module


@pytest.mark.parametrize('name', sorted(STARTS))
def test_it_starts_these_nodes_with_the_arguments_it_needs(name: str) -> None:
    assert set(start(name)) == STARTS[name]
    declared = arguments(path(name))
    required = {each.name for each in declared.values() if each.default_value is None}
    assert required == set(NEEDED[name])
    for argument in required:
        given = {key: value for key, value in NEEDED[name].items() if key != argument}
        with pytest.raises(RuntimeError, match=argument):
            started(path(name), given, context())


@pytest.mark.parametrize('name', sorted(STARTS))
def test_every_argument_is_described_and_has_an_effect(name: str) -> None:
    for argument in arguments(path(name)).values():
        assert argument.description
        base = {'record': 'true'} if argument.name == 'output' else {}
        if argument.choices is not None:
            other = next(each for each in argument.choices if each != argument.default_value)
        else:
            other = OTHERS.get(argument.name, '7.5')  # a folder, a rate or a speed
        after = shown(start(name, **base, **{argument.name: other}))
        assert after != shown(start(name, **base))


def shown(processes: dict[str, Any]) -> dict[str, Any]:
    where = context()
    return {
        name: (
            process.command(where),
            process.parameters(where) if isinstance(process, Node) else None,
        )
        for name, process in processes.items()
    }


@pytest.mark.ros
@pytest.mark.parametrize('name', sorted(STARTS))
def test_nodes_are_executables_of_ours_and_take_their_parameters(name: str) -> None:
    switches = {'record', 'viewer'} & set(arguments(path(name)))
    given = dict.fromkeys(switches, 'true')
    rates = {'update_rate': '500'} if 'update_rate' in arguments(path(name)) else {}
    outputs = {'output': '12'} if 'output' in arguments(path(name)) else {}
    for process in start(name, urdf=ROBOT, **given, **rates, **outputs).values():
        if not isinstance(process, LifecycleNode):
            continue
        node = process.node_name
        assert (process.package, process.executable) == ('denoc_ros', node)
        assert node in NODES
        assert (ROOT / 'scripts' / node).is_file()
        parameters = process.parameters(context())
        table = parameter_table(node)
        settings = table.settings(parameters, node)
        if node == 'recorder':
            assert settings.text('output') == '12'  # which YAML would take for a number
        assert settings.text('urdf_path') == ROBOT
        if rates and node not in ('viewer', 'recorder'):
            assert settings.number('update_rate') == 500.0


@pytest.mark.ros
def test_a_simulation_lives_by_the_plant_s_time() -> None:
    found = start('sim', clock='lockstep', real_time_factor='0.0', record='true')
    plant = found['plant'].parameters(context())
    table = import_module('denoc_ros.runtime.parameters.plant_parameters').TABLE
    settings = table.settings(plant, 'plant')
    assert settings.text('clock') == 'lockstep'
    assert settings.number('real_time_factor') == 0.0
    assert settings.texts('lockstep.partners') == ['predictor', 'feedforward', 'recorder']
    for partner in settings.texts('lockstep.partners'):
        assert found[partner].parameters(context())['use_sim_time'] is True


def test_what_params_say_stays_where_an_argument_is_empty(tmp_path: Path) -> None:
    file = tmp_path / 'mine.yaml'
    file.write_text('predictor: {ros__parameters: {urdf_path: mine.urdf, update_rate: 250.0}}')
    predictor = start('bringup', params=str(file))['predictor']
    assert predictor.parameters(context()) == {'urdf_path': 'mine.urdf', 'update_rate': 250.0}


def test_rviz_opens_the_package_s_configuration() -> None:
    rviz = start('bringup', rviz='true')['rviz']
    assert rviz.package == rviz.executable == 'rviz2'
    *_, flag, file = rviz.command(context())
    assert flag == '-d'
    assert Path(file).is_file()


@pytest.mark.ros
def test_the_player_is_called_as_its_command_line_is(monkeypatch: pytest.MonkeyPatch) -> None:
    from denoc_ros.cli import player

    processes = start('replay', speed='0.5')
    command = processes['player'].command(context())
    start_words = [sys.executable, *module_words('denoc_ros.cli.player')]
    assert command[: len(start_words)] == start_words
    seen: list[Any] = []
    parse = ArgumentParser.parse_args

    def stop(parser: Any, given: Any) -> Any:
        seen.append(parse(parser, given))
        raise KeyboardInterrupt

    monkeypatch.setattr(ArgumentParser, 'parse_args', stop)
    with pytest.raises(KeyboardInterrupt):
        player.main(
            [*command[len(start_words) :], *processes['player'].ros_arguments(context(), Path())]
        )
    options = seen[0]
    assert (str(options.bag), options.speed) == (BAG, 0.5)
    # those that the player waits for are there
    assert set(options.listeners) == {'predictor', 'feedforward'} <= set(processes)
    assert not options.clock


@pytest.mark.ros
def test_a_recording_is_played_in_lockstep_with_all_who_keep_its_time() -> None:
    processes = start('replay', clock='lockstep', record='true', rviz='false')
    words = processes['player'].command(context())
    assert '--clock' in words
    listeners = set(words[words.index('--listeners') + 1 : words.index('--clock')])
    assert listeners == {'predictor', 'feedforward', 'recorder'} <= set(processes)
    for name in (*listeners, 'viewer'):
        assert processes[name].parameters(context())['use_sim_time'] is True


@pytest.mark.ros
@pytest.mark.parametrize('speed', ['0', '-1', 'nan', 'inf', 'fast'])
def test_the_player_takes_no_speed_that_there_is_not(
    speed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    from denoc_ros.cli import player

    with pytest.raises(SystemExit) as caught:
        player.main(['bag', f'--speed={speed}'])
    assert caught.value.code == 2
    assert f"speed must be a number > 0, got '{speed}'" in capsys.readouterr().err


def test_a_switch_is_on_or_off() -> None:
    with pytest.raises(RuntimeError, match='viewer'):
        start('bringup', viewer='maybe')


@pytest.mark.parametrize(
    ('name', 'argument', 'value', 'says'),
    [
        ('bringup', 'params', 'nofile.yaml', "argument 'params' must be a file that exists"),
        ('bringup', 'urdf', 'nofile.urdf', "argument 'urdf' must be a file that exists"),
        ('replay', 'bag', 'nobag', "argument 'bag' must be a file that exists, got 'nobag'"),
        ('replay', 'speed', '0', "argument 'speed' must be a number > 0, got '0'"),
        ('replay', 'speed', '-1', "argument 'speed' must be a number > 0"),
        ('replay', 'speed', 'fast', "argument 'speed' must be a number > 0"),
        ('sim', 'update_rate', '-5', "argument 'update_rate' must be a number > 0"),
        ('sim', 'real_time_factor', '-1', "argument 'real_time_factor' must be a number >= 0"),
        ('two_robots', 'update_rate', 'nan', "argument 'update_rate' must be a number > 0"),
        ('simulation', 'output', str(ROOT), "argument 'output' must not exist yet"),
    ],
)
def test_what_would_start_otherwise_than_was_meant_is_refused(
    name: str, argument: str, value: str, says: str
) -> None:
    with pytest.raises(RuntimeError) as caught:
        start(name, **{argument: value})
    assert says in str(caught.value)


def test_the_simulation_is_recorded_once_more_into_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    def output() -> str:
        recorder = start('simulation')['recorder']
        return str(recorder.parameters(context())['output'])

    assert output() == 'run'
    (tmp_path / 'run').mkdir()
    assert re.fullmatch(r'run_\d{8}-\d{6}', output())


@pytest.mark.parametrize('interrupted', [False, True])
def test_the_end_of_the_recording_ends_all_once(interrupted: bool) -> None:
    where, player = context(), start('replay')['player']
    # Ctrl-C: launch is shutting down when the player ends
    where.is_shutdown = interrupted
    player.exits(where)
    assert where.is_shutdown


@pytest.mark.parametrize('namespace', ['', 'arm1', '/fleet/arm1'])
def test_nodes_in_a_namespace_have_the_parameters_and_the_player_of_it(namespace: str) -> None:
    where = context()
    where.launch_configurations['ros_namespace'] = namespace
    found = started(path('replay'), NEEDED['replay'], where)
    for process in found:
        assert isinstance(process, Node)
        assert process.namespace == '/' + namespace.strip('/')
        if process.node_name == 'predictor':
            assert process.parameters(where)['source'] == 'joints'  # of config/bringup.yaml
            assert process.parameters(where)['urdf_path'] == ROBOT


def test_several_robots_are_apart_and_recorded_together(tmp_path: Path) -> None:
    found = start('two_robots', record='true', update_rate='100')
    assert set(found) == {*STARTS['two_robots'], 'recorder'}
    words = found['arm2/plant'].ros_arguments(context(), tmp_path)
    assert words[:5] == ['--ros-args', '-r', '__node:=plant', '-r', '__ns:=/arm2']
    given = yaml.safe_load(Path(words[-1]).read_text(encoding='utf-8'))
    assert given['/arm2/plant']['ros__parameters']['update_rate'] == 100.0


def test_it_loads_with_the_launch_of_ros_where_that_is_installed() -> None:
    real = importlib.util.find_spec('launch_ros')
    for file in FILES if real else ():
        source = import_module('launch.launch_description_sources')
        loaded = source.PythonLaunchDescriptionSource(str(file))
        description = loaded.get_launch_description(import_module('launch').LaunchContext())
        declared = {each.name for each in description.get_launch_arguments()}
        assert declared == set(arguments(file))
