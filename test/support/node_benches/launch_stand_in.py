"""The part of ROS's `launch` and `launch_ros` that launch files use, where ROS is not installed.

Argument names, which of them are keyword-only, what is required and what is refused are those of
ROS 2 Jazzy's packages, and so is what the sources of these do with it: scopes of groups,
namespaces and the names of nodes in them, parameter files, which nodes a section of them is for,
what happens when a process exits. Nothing is started.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import yaml

# what Node hands on to ExecuteProcess, and that to ExecuteLocal and Action
PROCESS_OPTIONS = frozenset(
    (
        *('name', 'prefix', 'cwd', 'env', 'additional_env', 'shell', 'condition'),
        *('sigterm_timeout', 'sigkill_timeout', 'emulate_tty', 'output', 'output_format'),
        *('cached_output', 'log_cmd', 'on_exit'),
        *('respawn', 'respawn_delay', 'respawn_max_retries'),
    )
)


class Context:
    """Launch configurations by name, and whether all is about to end."""

    def __init__(self, shares: Mapping[str, Path]) -> None:
        self.launch_configurations: dict[str, str] = {}
        self.shares = shares
        self.is_shutdown = False
        self._before: list[dict[str, str]] = []

    def push(self) -> None:
        self._before.append(dict(self.launch_configurations))

    def pop(self) -> None:
        self.launch_configurations = self._before.pop()


class Substitution:
    """Something that becomes a text."""

    def perform(self, context: Context) -> str:
        raise NotImplementedError


def text(context: Context, value: Any) -> str:
    """Return a text, a substitution or a list of these as text."""
    if isinstance(value, str):
        return value
    if isinstance(value, Substitution):
        return value.perform(context)
    assert isinstance(value, Sequence), f'must be text or substitutions, got {value!r}'
    return ''.join(text(context, part) for part in value)


class LaunchConfiguration(Substitution):
    def __init__(self, variable_name: Any, *, default: Any = None) -> None:
        self._name, self._default = variable_name, default

    def perform(self, context: Context) -> str:
        name = text(context, self._name)
        if name in context.launch_configurations:
            return context.launch_configurations[name]
        if self._default is None:
            raise LookupError(f"launch configuration '{name}' does not exist")
        return text(context, self._default)


class PathJoinSubstitution(Substitution):
    def __init__(self, substitutions: Sequence[Any]) -> None:
        self._parts = list(substitutions)

    def perform(self, context: Context) -> str:
        return str(Path(*(text(context, part) for part in self._parts)))


class FindPackageShare(Substitution):
    def __init__(self, package: Any) -> None:
        self._package = package

    def perform(self, context: Context) -> str:
        return str(context.shares[text(context, self._package)])


class Action:
    """What a launch description is made of."""

    execute: Callable[[Context], Any]

    def __init__(self, *, condition: Any = None) -> None:
        self.condition = condition


class DeclareLaunchArgument(Action):
    def __init__(
        self,
        name: str,
        *,
        default_value: Any = None,
        description: str | None = None,
        choices: list[str] | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__(**kwargs)
        if choices is not None and not choices:
            raise RuntimeError('choices must not be empty')
        if choices and isinstance(default_value, str) and default_value not in choices:
            raise RuntimeError(f'{default_value} must be of {choices}')
        self.name, self.default_value = name, default_value
        self.description, self.choices = description, choices

    def execute(self, context: Context) -> None:
        known = context.launch_configurations
        if self.name not in known:
            if self.default_value is None:
                raise RuntimeError(f'Required launch argument "{self.name}" was not provided.')
            known[self.name] = text(context, self.default_value)
        if self.choices is not None and known[self.name] not in self.choices:
            raise RuntimeError(f'Argument "{self.name}" must be of {self.choices}')


class OpaqueFunction(Action):
    def __init__(
        self,
        *,
        function: Callable[..., list[Any] | None],
        args: Sequence[Any] | None = None,
        kwargs: Mapping[str, Any] | None = None,
        **left_over_kwargs: Any,
    ) -> None:
        super().__init__(**left_over_kwargs)
        self._call = function, args or (), kwargs or {}

    def execute(self, context: Context) -> list[Any]:
        function, args, kwargs = self._call
        return function(context, *args, **kwargs) or []


class Shutdown(Action):
    def __init__(self, *, reason: Any = 'reason not given', **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.reason = reason

    def execute(self, context: Context) -> None:
        if context.is_shutdown:
            raise RuntimeError('a second shutdown: ros2 launch ends with status 1')
        context.is_shutdown = True


class Scope(Action):
    """The beginning or the end of a group's configurations."""

    def __init__(self, act: Callable[[Context], None]) -> None:
        super().__init__()
        self.execute = act


class GroupAction(Action):
    def __init__(self, actions: Sequence[Any], *, scoped: bool = True, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._actions, self._scoped = list(actions), scoped

    def execute(self, _context: Context) -> list[Any]:
        if not self._scoped:
            return self._actions
        return [Scope(Context.push), *self._actions, Scope(Context.pop)]


class PushRosNamespace(Action):
    def __init__(self, namespace: Any, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._namespace = namespace

    def execute(self, context: Context) -> None:
        known = context.launch_configurations
        below = known.get('ros_namespace')
        known['ros_namespace'] = prefixed(below, text(context, self._namespace))


def prefixed(base: str | None, namespace: str | None) -> str:
    """Return a namespace below another, absolute, as launch_ros joins them."""
    if not namespace:
        joined = base or ''
    elif namespace.startswith('/') or not base:
        joined = namespace
    else:
        joined = f'{base.rstrip("/")}/{namespace}'
    return '/' + joined.strip('/')


class ExecuteProcess(Action):
    def __init__(self, *, cmd: Sequence[Any], **kwargs: Any) -> None:
        unknown = set(kwargs) - PROCESS_OPTIONS
        if unknown:
            raise TypeError(f'unexpected keyword arguments {sorted(unknown)}')
        super().__init__(condition=kwargs.get('condition'))
        self.cmd, self.options = list(cmd), kwargs

    def execute(self, context: Context) -> None:
        """Take what holds where it is executed."""

    def command(self, context: Context) -> list[str]:
        return [text(context, part) for part in self.cmd]

    def exits(self, context: Context, returncode: int = 0) -> None:
        """Do what launch does when the process has ended."""
        wanted = self.options.get('on_exit')
        if callable(wanted):
            wanted = wanted(SimpleNamespace(action=self, returncode=returncode), context)
        for action in [wanted] if isinstance(wanted, Action) else wanted or ():
            action.execute(context)


class ParameterValue:
    def __init__(self, value: Any, *, value_type: type | None = None) -> None:
        scalar = isinstance(value, (int, float, bool, str))
        if value_type is not None and scalar and not isinstance(value, value_type):
            raise TypeError(f"value='{value}' is not an instance of {value_type}")
        self._value, self._type = value, value_type

    def evaluate(self, context: Context) -> Any:
        if not isinstance(self._value, Substitution):
            return self._value
        performed = self._value.perform(context)
        return yaml.safe_load(performed) if self._type is None else self._type(performed)


class Node(ExecuteProcess):
    def __init__(
        self,
        *,
        executable: Any,
        package: Any = None,
        name: Any = None,
        namespace: Any = None,
        exec_name: Any = None,
        parameters: Sequence[Any] | None = None,
        remappings: Sequence[Any] | None = None,
        ros_arguments: Sequence[Any] | None = None,
        arguments: Sequence[Any] | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__(cmd=[executable, *(arguments or ())], **kwargs)
        if parameters is not None and not isinstance(parameters, list):
            raise TypeError('parameters must be a list')
        self.package, self.executable, self.node_name = package, executable, name
        self._namespace, self.namespace = namespace, '/'
        self._parameters = parameters or []

    def execute(self, context: Context) -> None:
        own = None if self._namespace is None else text(context, self._namespace)
        self.namespace = prefixed(context.launch_configurations.get('ros_namespace'), own)

    @property
    def full_name(self) -> str:
        return f'{self.namespace.rstrip("/")}/{self.node_name}'

    def ros_arguments(self, context: Context, folder: Path) -> list[str]:
        """Return what is put behind the command; dictionaries are written into a folder."""
        words = ['--ros-args', '-r', f'__node:={self.node_name}', '-r', f'__ns:={self.namespace}']
        for number, given in enumerate(self._parameters):
            if isinstance(given, Mapping):
                file = folder / f'{self.full_name.strip("/").replace("/", "_")}_{number}.yaml'
                values = {text(context, k): evaluated(context, v) for k, v in given.items()}
                file.write_text(yaml.dump({self.full_name: {'ros__parameters': values}}))
            else:
                file = Path(text(context, given))
            if file.is_file():  # launch_ros warns of others, and starts the node without
                words += ['--params-file', str(file)]
        return words

    def parameters(self, context: Context) -> dict[str, Any]:
        """Return what the node's parameters are, as ROS takes files and dictionaries."""
        values: dict[str, Any] = {}
        for given in self._parameters:
            if isinstance(given, Mapping):
                for key, value in given.items():
                    values[text(context, key)] = evaluated(context, value)
                continue
            file = Path(text(context, given))
            found = yaml.safe_load(file.read_text(encoding='utf-8')) if file.is_file() else {}
            for section, held in found.items():
                if is_for(section, self.full_name):
                    values.update(flat(held.get('ros__parameters', {})))
        return values


def is_for(section: str, node: str) -> bool:
    """Say whether rcl takes a section of a parameter file for a node."""
    words = section.strip('/').split('/')
    kinds = {'*': '/[^/]+', '**': '(/[^/]+)*'}
    return re.fullmatch(''.join(kinds.get(w, f'/{re.escape(w)}') for w in words), node) is not None


class LifecycleNode(Node):
    def __init__(
        self, *, name: Any, namespace: Any, autostart: bool = False, **kwargs: Any
    ) -> None:
        super().__init__(name=name, namespace=namespace, **kwargs)


class LaunchDescription:
    def __init__(self, initial_entities: Sequence[Any] | None = None) -> None:
        self.entities = list(initial_entities or [])


def evaluated(context: Context, value: Any) -> Any:
    """Return a parameter of a dictionary: texts are read as YAML, as launch_ros does."""
    if isinstance(value, ParameterValue):
        return value.evaluate(context)
    if isinstance(value, (str, Substitution)):
        read = yaml.safe_load(text(context, value))
        if not isinstance(read, (bool, int, float, str, list)):
            raise TypeError(f'a parameter must not be {type(read)}')
        return read
    return value


def flat(values: Mapping[str, Any], prefix: str = '') -> dict[str, Any]:
    """Return nested parameters by dotted names."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        inner = flat(value, f'{prefix}{key}.') if isinstance(value, Mapping) else None
        found.update(inner if inner is not None else {f'{prefix}{key}': value})
    return found


MODULES: dict[str, tuple[Any, ...]] = {
    'launch': (LaunchDescription,),
    'launch.actions': (
        DeclareLaunchArgument,
        ExecuteProcess,
        GroupAction,
        OpaqueFunction,
        Shutdown,
    ),
    'launch.substitutions': (LaunchConfiguration, PathJoinSubstitution),
    'launch_ros': (),
    'launch_ros.actions': (LifecycleNode, Node, PushRosNamespace),
    'launch_ros.parameter_descriptions': (ParameterValue,),
    'launch_ros.substitutions': (FindPackageShare,),
}


@contextmanager
def installed() -> Iterator[None]:
    """Have the stand-in imported as `launch` and `launch_ros`."""
    before = {name: sys.modules.get(name) for name in MODULES}
    for name, classes in MODULES.items():
        module = ModuleType(name)
        for each in classes:
            setattr(module, each.__name__, each)
        sys.modules[name] = module
    try:
        yield
    finally:
        for name, module_before in before.items():
            if module_before is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module_before
