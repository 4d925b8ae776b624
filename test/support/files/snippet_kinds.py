"""What each kind of snippet is held to: commands run, files are read by what reads them."""

from __future__ import annotations

import itertools
import re
import shlex
import shutil
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import yaml
from campaign_table import CAMPAIGNS
from data_files import DATA
from launch_files import arguments as launch_arguments
from launch_stand_in import flat
from pages import Snippet

from denoc_ros.cli.main import build_parser, completed, main
from denoc_ros.cli.session.session_config import NODES, find_file, load_config
from denoc_ros.cli.simulate_verb import prepare
from denoc_ros.export.dh_system import load_system
from denoc_ros.model.mode_table import read_mode_table
from denoc_ros.model.reading.urdf import load_tree
from denoc_ros.parts import node_main, parameter_table
from denoc_ros.simulation.scenario import KEYS as SCENARIO_KEYS
from denoc_ros.yaml_text import load_yaml

ROOT = Path(__file__).resolve().parents[3]
OTHERS = {'source', 'rosdep', 'colcon', 'git', 'touch', 'sudo', '.', 'cd', 'apt', 'apt-get'}
CONTROLLERS = DATA / 'ros2_controllers_jazzy.yaml'


def run_command(words: list[str], snippet: Snippet) -> None:
    """Run a command of this package; look up what another one names."""
    program = words[0].rpartition('/')[2]
    if program == 'denoc':
        run_denoc(words[1:], snippet)
    elif program in CHECKS:
        CHECKS[program](words[1:])
    else:
        assert program in OTHERS, f'nobody knows how to check {words}'


def run_denoc(arguments: list[str], snippet: Snippet) -> None:
    """Run a verb as its user does; `parse` in the directive: only understand it."""
    if 'parse' in snippet.directive:
        arguments = completed(arguments)
        args = build_parser(arguments).parse_args(arguments)
        if args.verb == 'up' and find_file(Path(args.config), Path()):
            check_session(args.config, args.set)
        return
    arguments = [*arguments, *shlex.split(snippet.directive.get('add', ''))]
    expected = int(snippet.directive.get('status', 0))
    status = main(arguments)
    assert status == expected, f'denoc {shlex.join(arguments)}: exit status {status}'


def check_make(words: list[str]) -> None:
    """A target of the Makefile."""
    makefile = (ROOT / 'Makefile').read_text(encoding='utf-8')
    for target in words:
        assert re.search(rf'^{target}:', makefile, re.MULTILINE), f'no make {target}'


def check_python(words: list[str]) -> None:
    """A campaign or module that has the options given, a venv, or a file."""
    name = words[1] if words[0] == '-m' else ''
    if name == 'venv':
        return
    if name == 'campaigns':
        assert words[2] in CAMPAIGNS, f'no campaign {words[2]}'
        name = CAMPAIGNS[words[2]].command.replace(' ', '.')  # `book bench` is in book/bench.py
        if name.startswith('pytest'):
            return
    file = Path(name.replace('.', '/') + '.py') if name else Path(words[0])
    found = [base / file for base in (ROOT / 'campaigns', ROOT) if (base / file).is_file()]
    assert found, f'there is no {file}'
    # a command line may be shared with the modules beside it
    source = ''.join(file.read_text(encoding='utf-8') for file in found[0].parent.glob('*.py'))
    for option in (word for word in words if re.match(r'--[a-z]', word) and name):
        assert f"'{option}'" in source or option == '--ros-args', f'{file} has no {option}'


def check_pip(words: list[str]) -> None:
    """Extras and requirements that setup.py has too."""
    setup = (ROOT / 'setup.py').read_text(encoding='utf-8')
    for word in words[1:]:
        extras = re.search(r'(?:^\.|^denoc_ros)\[(.*)\]', word)
        if extras:
            for extra in extras[1].split(','):
                assert f"'{extra}': " in setup, f'setup.py has no extra {extra}'
        elif not word.startswith(('-', '.')):
            name = re.split(r'[<>=]', word)[0]
            assert f"'{name}" in setup or name in NOT_OURS, f'setup.py does not ask for {name}'


NOT_OURS = {'colcon-ros'}


def check_pytest(words: list[str]) -> None:
    """Files of the tests."""
    for word in words:
        assert word.startswith('-') or (ROOT / word.partition('::')[0]).exists(), word


def check_copy(words: list[str]) -> None:
    """Copy."""
    shutil.copy(*words)


def check_ros2(words: list[str]) -> None:
    """A command of ROS that names nodes, launch files, topics and parameters of ours."""
    verb, rest = words[0], words[1:]
    if verb == 'run':
        if rest[0] != 'controller_manager':
            assert rest[0] == 'denoc_ros', rest
            if rest[1] == 'denoc':
                try:
                    build_parser(rest[2:]).parse_args(rest[2:])
                except SystemExit as error:
                    raise AssertionError(rest) from error
                return
            assert rest[1] in NODES, rest
            check_ros_arguments(rest[1], rest[2:])
    elif verb == 'launch':
        check_launch(rest)
    elif verb == 'param' and rest[0] in ('set', 'get'):
        node, name = rest[1].strip('/'), rest[2]
        if node in NODES:
            check_parameters(node, {name: yaml.safe_load(rest[3])} if rest[0] == 'set' else {name})
    elif verb == 'topic' and rest[0] == 'pub':
        *_, kind, message = rest
        check_message(kind, yaml.safe_load(message))
    else:
        assert verb in ('param', 'topic', 'service', 'lifecycle', 'bag', 'control', 'node'), verb
    for word in words:
        check_ros_name(word)


def check_message(kind: str, fields: dict[str, Any]) -> None:
    """A message has these fields."""
    package, _, name = kind.split('/')
    known = getattr(import_module(f'{package}.msg'), name).get_fields_and_field_types()
    assert fields.keys() <= known.keys(), f'{kind} has no {sorted(fields.keys() - known.keys())}'


def check_ros_arguments(node: str, words: list[str]) -> None:
    """`-p name:=value` after `--ros-args` are parameters of the node."""
    for flag, value in itertools.pairwise(words):
        if flag == '-p':
            name, _, text = value.partition(':=')
            check_parameters(node, {name: yaml.safe_load(text)})


def check_parameters(node: str, values: Any) -> None:
    """The node's table has them and takes their values."""
    table = parameter_table(node)
    if isinstance(values, dict):
        table.settings(values, node)
    for name in values:
        assert table.row(name) is not None, f'{node} has no parameter {name}'


def check_launch(words: list[str]) -> None:
    """The launch file exists and declares the arguments."""
    assert words[0] == 'denoc_ros', words
    declared = launch_arguments(ROOT / 'launch' / words[1])
    for word in words[2:]:
        name = word.partition(':=')[0]
        assert name in declared, f'{words[1]} has no argument {name}'


def check_ros_name(word: str) -> None:
    """A topic or service `/NODE/name` is one that the node's sources have as `~/name`."""
    match = re.fullmatch(r'/(\w+)/(\w+)', word)
    if match and match[1] in NODES:
        folder = node_main(match[1]).rpartition('.')[0].replace('.', '/')
        sources = (ROOT / folder).glob('*.py')
        assert any(f'~/{match[2]}' in file.read_text() for file in sources), f'no {word}'


CHECKS: dict[str, Callable[[list[str]], None]] = {
    'make': check_make,
    'python': check_python,
    'python3': check_python,
    'pip': check_pip,
    'pytest': check_pytest,
    'cp': check_copy,
    'ros2': check_ros2,
    'denoc-feedforward': lambda words: check_ros_arguments('feedforward', words),
}


def check_yaml(snippet: Snippet, folder: Path) -> None:
    """Have it read by what reads it: `denoc up`, nodes, `denoc simulate`, `denoc dh`."""
    values = load_yaml(snippet.text)
    file = folder / snippet.directive.get('file', 'snippet.yaml')
    file.write_text(snippet.text, encoding='utf-8')
    keys = set(values)
    if 'robot' in keys:
        check_session(file)
    elif any(isinstance(v, dict) and 'ros__parameters' in v for v in values.values()):
        check_parameter_file(values)
    elif keys <= set(SCENARIO_KEYS):
        if 'robot' in snippet.directive:
            prepare(folder / snippet.directive['robot'], values, snippet.where)
    elif keys & {'chains', 'dh', 'links'}:
        load_system(str(file), None, None)
    elif keys == {'joints', 'postures'}:
        read_mode_table(file)
    else:
        raise AssertionError(f'{snippet.where}: nothing reads a file with {sorted(keys)}')


def check_session(file: str | Path, settings: Sequence[str] = ()) -> None:
    """A file of `denoc up`, and every parameter in it."""
    from denoc_ros.cli.session.node_parameters import check_parameters as check_all

    config = load_config(file, settings)
    check_all(config, [name for name in NODES if name not in config.without])


def check_parameter_file(values: dict[str, Any]) -> None:
    """ROS parameters: of our nodes by their tables, of ros2_controllers by a list of theirs."""
    theirs = load_yaml(CONTROLLERS.read_text(encoding='utf-8'))
    for section, value in values.items():
        parameters, node = value['ros__parameters'], section.removeprefix('/**/')
        if node in NODES:
            check_parameters(node, flat(parameters))
            continue
        if section == '/**':  # what every ROS node has
            assert set(parameters) <= {'use_sim_time'}, section
            continue
        kinds = [values['controller_manager']['ros__parameters'].get(node, {}).get('type')]
        known = theirs[node if node == 'controller_manager' else kinds[0]]
        for name in flat(parameters):
            assert any(re.fullmatch(pattern, name) for pattern in known), f'{node}: {name}'


def check_xml(snippet: Snippet, folder: Path) -> None:
    """Load a robot, or a part of its block on the links that the part names."""
    text = snippet.text
    if '<robot' not in text:
        text = around(text)
    tree = load_tree(text)
    assert tree.warnings == (), snippet.where
    if 'file' in snippet.directive:
        (folder / snippet.directive['file']).write_text(snippet.text, encoding='utf-8')


def around(part: str) -> str:
    """Return a robot with the links and joints that a part of a `<flexibility>` names."""
    joints = dict.fromkeys(re.findall(r'joint="(\w+)"', part))
    named = dict.fromkeys(re.findall(r'link="(\w+)"', part))
    links = [*named] or [f'link_{k}' for k in range(len(joints))]
    names = [*joints, *(f'joint_{k}' for k in range(len(links)))]
    heavy = (  # whatever beam is taken out of it, what is left is possible
        '<inertial><origin xyz="0 0 0"/><mass value="1e4"/>'
        '<inertia ixx="1e6" iyy="1e6" izz="1e6" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    rows = ['<link name="the_base"/>']
    for parent, link, joint in zip(['the_base', *links], links, names, strict=False):
        rows.append(f'<link name="{link}">{heavy}</link>')
        rows.append(
            f'<joint name="{joint}" type="continuous"><parent link="{parent}"/>'
            f'<child link="{link}"/><axis xyz="0 0 1"/></joint>'
        )
    block = part if '<flexibility' in part else f'<flexibility>{part}</flexibility>'
    return f'<robot name="part">{"".join(rows)}{block}</robot>'
