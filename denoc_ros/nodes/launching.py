"""Parts that the launch files share; `launch` and `launch_ros` need a full ROS."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from denoc_ros.python_start import module_words

WITH_ROBOT = ('feedforward', 'predictor', 'plant', 'viewer', 'shaper')
SIMULATION = ('plant', 'predictor', 'feedforward')
WITH_RATE = ('feedforward', 'predictor', 'plant', 'shaper')
PACKAGE = 'denoc_ros'


@dataclass(frozen=True)
class Argument:
    """A launch argument; one without a default must be given."""

    name: str
    description: str
    default: str | None = None
    choices: tuple[str, ...] = ()


ROBOT = Argument('urdf', 'file of the robot')
URDF = Argument('urdf', 'file of the robot; empty: what params or robot_description say', '')
RECORD = Argument('record', 'record all topics into a bag', 'false', ('true', 'false'))
OUTPUT = Argument('output', "the bag's folder, which must not exist; empty: by the time", '')
FILES = ('urdf', 'params', 'bag')
VIEWER = Argument('viewer', 'show the robot in the browser', 'false', ('true', 'false'))
RVIZ = Argument('rviz', "start RViz with the package's configuration", 'false', ('true', 'false'))
RATE = Argument('update_rate', 'rate of the loops [Hz], > 0; empty: what params say', '')
CLOCK = Argument(
    'clock',
    "time of all nodes: real (none), or the plant's simulated time, told or in lockstep with all",
    'none',
    ('none', 'publish', 'lockstep'),
)
FACTOR = Argument(
    'real_time_factor',
    "of the plant's simulated time, at most; 0: as fast as it goes; empty: what params say",
    '',
)
PLAYED_CLOCK = Argument(
    'clock',
    "time of all nodes: real (none), or of the recording's joint states, in lockstep with all",
    'none',
    ('none', 'lockstep'),
)
BAG = Argument('bag', 'the recording whose joint states are played')
SPEED = Argument('speed', 'of the clock the recording is played by, > 0', '1.0')


def description(
    nodes: Sequence[str],
    *arguments: Argument,
    urdf: Argument = URDF,
    file: str = 'bringup.yaml',
) -> Any:
    """Return a launch description of nodes.

    Parameters
    ----------
    nodes : sequence of str
        Those that always run. Beside them run, where there are such arguments and they say so,
        the recorder, the viewer, RViz and the player of a bag.
    *arguments : Argument
        Of the launch file beside `urdf` and `params`.
    urdf : Argument
        The robot's.
    file : str
        The parameter file in config/ that is taken where `params` is empty.
    """
    return described(lambda given: actions(nodes, given, file), file, (urdf, *arguments))


def described(
    begin: Callable[[Mapping[str, str]], list[Any]], file: str, arguments: Sequence[Argument]
) -> Any:
    """Return a launch description with arguments, `params` among them.

    Parameters
    ----------
    begin : callable
        Returns what is started when the arguments are as given.
    file : str
        The parameter file in config/ that is taken where `params` is empty.
    arguments : sequence of Argument
        The others.
    """
    from launch.actions import DeclareLaunchArgument, OpaqueFunction
    from launch.substitutions import LaunchConfiguration

    from launch import LaunchDescription

    params = Argument('params', f'file of parameters; empty: config/{file} of the package', '')
    everything = (arguments[0], params, *arguments[1:])

    def start(context: Any) -> list[Any]:
        given = {each.name: LaunchConfiguration(each.name).perform(context) for each in everything}
        check(given)
        return begin(given)

    declared = [
        DeclareLaunchArgument(
            each.name,
            default_value=each.default,
            description=each.description,
            choices=list(each.choices) or None,
        )
        for each in everything
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def check(given: Mapping[str, str]) -> None:
    """Refuse arguments with which the nodes would start all the same, but not as was meant.

    ROS only warns of a parameter file that is not there: nodes that command torque would begin
    with what they have by default.

    Raises
    ------
    RuntimeError
        With every finding: `ros2 launch` prints it and ends with status 1.
    """
    findings = []
    for name in FILES:
        if given.get(name) and not Path(given[name]).exists():
            findings.append(f"argument '{name}' must be a file that exists, got {given[name]!r}")
    for name in ('speed', 'update_rate'):
        if given.get(name) and not _positive(given[name]):
            findings.append(f"argument '{name}' must be a number > 0, got {given[name]!r}")
    factor = given.get('real_time_factor')
    if factor and not (_positive(factor) or factor.strip('0.') == ''):
        findings.append(f"argument 'real_time_factor' must be a number >= 0, got {factor!r}")
    if on(given, 'record') and given.get('output') and Path(given['output']).exists():
        findings.append(f"argument 'output' must not exist yet, got {given['output']!r}")
    if findings:
        raise RuntimeError('; '.join(findings))


def _positive(text: str) -> bool:
    try:
        return 0.0 < float(text) < float('inf')
    except ValueError:
        return False


def simulation(record: str = 'false', output: str = '') -> Any:
    """Return the launch description of a simulated robot under control.

    Parameters
    ----------
    record : str
        Default of this argument.
    output : str
        The bag's folder by default; where that exists, the time is put behind it.
    """
    folder = f'{output}_{time.strftime("%Y%m%d-%H%M%S")}' if Path(output).exists() else output
    return description(
        SIMULATION,
        RATE,
        CLOCK,
        FACTOR,
        replace(RECORD, default=record),
        replace(OUTPUT, default=folder if output else ''),
        VIEWER,
        RVIZ,
        urdf=ROBOT,
    )


def simulations(namespaces: Sequence[str]) -> Any:
    """Return the launch description of simulated robots under control, each in a namespace.

    Parameters
    ----------
    namespaces : sequence of str
        One for each robot; the recorder takes the topics of all.
    """
    from launch.actions import GroupAction
    from launch_ros.actions import PushRosNamespace

    def begin(given: Mapping[str, str]) -> list[Any]:
        alone = {**given, 'record': 'false'}
        groups = [
            GroupAction([PushRosNamespace(each), *actions(SIMULATION, alone, 'bringup.yaml')])
            for each in namespaces
        ]
        return [*groups, *actions((), given, 'bringup.yaml')]

    return described(begin, 'bringup.yaml', (ROBOT, RATE, RECORD, OUTPUT))


def actions(nodes: Sequence[str], given: Mapping[str, str], file: str) -> list[Any]:
    """Actions of a launch file with the given arguments."""
    from launch.substitutions import PathJoinSubstitution
    from launch_ros.substitutions import FindPackageShare

    config = PathJoinSubstitution([FindPackageShare(PACKAGE), 'config'])
    switches = {'recorder': 'record', 'viewer': 'viewer'}
    wanted = [name for name, switch in switches.items() if on(given, switch)]
    params = given['params'] or PathJoinSubstitution([config, file])
    found = [node(name, params, given) for name in (*nodes, *wanted)]
    if on(given, 'rviz'):
        found.append(rviz(PathJoinSubstitution([config, 'denoc.rviz'])))
    if 'bag' in given:
        found.append(player(given, nodes))
    return found


def on(given: Mapping[str, str], switch: str) -> bool:
    """Say whether a switch is there and on."""
    return given.get(switch) == 'true'


def node(name: str, params: Any, given: Mapping[str, str]) -> Any:
    """Return a node with a file's parameters, and over them those that were given."""
    from launch_ros.actions import LifecycleNode
    from launch_ros.parameter_descriptions import ParameterValue

    own: dict[str, Any] = {}
    # a text stays a text: without its type it would be read as YAML
    if name in (*WITH_ROBOT, 'recorder') and given.get('urdf'):
        own['urdf_path'] = ParameterValue(given['urdf'], value_type=str)
    if name in WITH_RATE and given.get('update_rate'):
        own['update_rate'] = float(given['update_rate'])
    if name == 'recorder' and given.get('output'):
        own['output'] = ParameterValue(given['output'], value_type=str)
    own.update(time_parameters(name, given))
    return LifecycleNode(
        package=PACKAGE,
        executable=name,
        name=name,
        namespace='',
        output='screen',
        parameters=[params, own] if own else [params],
    )


def time_parameters(name: str, given: Mapping[str, str]) -> dict[str, Any]:
    """Return a node's parameters of the time that a simulation lives by."""
    own: dict[str, Any] = {}
    clock = given.get('clock', 'none')
    if name == 'plant' and given.get('real_time_factor'):
        own['real_time_factor'] = float(given['real_time_factor'])
    if clock == 'none':
        return own
    if name != 'plant':
        return {'use_sim_time': True}
    own['clock'] = clock
    if clock == 'lockstep':
        recorder = ['recorder'] if on(given, 'record') else []
        own['lockstep.partners'] = [each for each in SIMULATION if each != 'plant'] + recorder
    return own


def rviz(configuration: Any) -> Any:
    """Return RViz with a configuration file."""
    from launch_ros.actions import Node

    return Node(package='rviz2', executable='rviz2', name='rviz', arguments=['-d', configuration])


def player(given: Mapping[str, str], listeners: Sequence[str]) -> Any:
    """Player of a bag that waits for its listeners, and ends the launch with the bag.

    In real time it plays the joint states; in lockstep all that nobody publishes, with /clock, and
    a recorder is waited for as well.
    """
    from launch.actions import Shutdown
    from launch_ros.actions import Node

    words = [given['bag'], '--speed', given['speed'], '--listeners', *listeners]
    if given.get('clock') == 'lockstep':
        words += [*(['recorder'] if on(given, 'record') else []), '--clock']

    def end(_event: Any, context: Any) -> Any:
        # on Ctrl-C it ends as all do: to shut down once more would make the launch fail
        return None if context.is_shutdown else Shutdown(reason='the recording is over')

    return Node(
        executable=sys.executable,
        exec_name='player',
        name='player',
        arguments=module_words('denoc_ros.cli.player', *words),
        output='screen',
        on_exit=end,
    )
