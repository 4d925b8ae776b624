"""The file of `denoc up`: read, checked with every finding gathered, and turned into a record."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from denoc_ros.errors import ConfigError
from denoc_ros.model.numbers import FAMILIES
from denoc_ros.model.reading.mapping_reader import MappingReader, are_numbers, is_number
from denoc_ros.parts import nodes as known_nodes
from denoc_ros.yaml_text import YamlError, load_yaml, read_yaml_file

REAL, SIMULATED, AUTO = TIMES = ('real', 'simulated', 'auto')
ALL_NODES = ('plant', 'feedforward', 'predictor', 'recorder', 'viewer', 'shaper')
# A node of a part that is not there is no node of a session.
NODES = tuple(name for name in ALL_NODES if name in known_nodes())
WHEN_ASKED = ('viewer', 'shaper')  # started only where the file has them
OF_ROBOTS = ('plant', 'feedforward', 'predictor', 'shaper')
KEYS = (
    'robot', 'gravity', 'reference', 'duration', 'record', 'time', 'tip', 'joints', 'posture',
    'model', 'nodes', 'plant', 'phases',
)  # fmt: skip
NO_REFERENCE = 'reference must be a mapping or an existing YAML file, got {!r}'
REFERENCE_KINDS = ('book', 'points', 'sine')
Parameters = dict[str, Any]


def parse_setting(setting: str, findings: list[str]) -> tuple[list[str], Any] | None:
    """Return the names and the value of `path=value`; None, with a finding, for another text."""
    path, equals, text = setting.partition('=')
    names = path.split('.')
    if not equals or not all(names):
        findings.append(f'--set must be path=value with a dotted path, got {setting!r}')
        return None
    try:
        return names, load_yaml(text)
    except YamlError as error:
        findings.append(f'--set {path}: {error}')
        return None


def apply_setting(raw: dict[str, Any], setting: str, findings: list[str]) -> None:
    """Put one `path=value` into the mapping; model paths go to the plant and to `model`."""
    parsed = parse_setting(setting, findings)
    if parsed is None:
        return
    names, value = parsed
    path = '.'.join(names)
    targets = [['model', path], ['plant', path]] if names[0] in FAMILIES else [names]
    for target in targets:
        _set(raw, target, value, findings, setting)


def _set(
    raw: dict[str, Any], names: Sequence[str], value: Any, findings: list[str], setting: str
) -> None:
    here = raw
    for name in names[:-1]:
        step = here.get(name)
        if step is None:
            step = here[name] = {}
        if not isinstance(step, dict):
            findings.append(f'--set must name a value below a mapping, got {setting!r}')
            return
        here = step
    here[names[-1]] = value


@dataclass(frozen=True)
class Phase:
    """One run of the reference."""

    name: str
    # what it changes in the nodes' parameters
    nodes: Mapping[str, Parameters] = field(default_factory=dict)
    # `method` and options of `denoc_ros.shape_motion` by which the reference is shaped; empty: it
    # is followed as it is
    shape: Parameters = field(default_factory=dict)
    # overrides of the model that every node but the plant works with, beside the session's
    model: Parameters = field(default_factory=dict)
    # an earlier phase: numbers of the robot that its recording tells go into `model`
    identify: str = ''


@dataclass(frozen=True)
class SessionConfig:
    """Configuration of a session of `denoc up`."""

    # the file itself, and the robot it names
    path: Path
    robot: Path
    gravity: tuple[float, float, float]  # (3,) base frame [m/s^2]
    reference: Mapping[str, Any]  # `kind` and what goes with it; empty where the file has none
    duration: float  # of each phase [s]; 0 where the file gives none
    record: bool  # whether a recorder runs
    # `real`; `simulated`: the plant makes the time, in lockstep with the others; `auto`: real
    # where the machine is fast enough, which a rehearsal tells
    time: str
    tip: str  # the frame whose tracking error is reported; '' for the end of the last chain
    # the driven joints of a robot with loops; () for all that are not mimics
    joints: tuple[str, ...]
    # overrides of the model that every node but the plant works with: dotted path -> number(s)
    model: Parameters
    nodes: Mapping[str, Parameters]  # node -> flat parameters, the plant's among them
    # nodes that are not started: `nodes: {NAME: false}`, and the viewer and the shaper where
    # `nodes` has none
    without: frozenset[str]
    plant_model: Parameters  # overrides of the model that are true of the plant only
    phases: tuple[Phase, ...]  # at least one

    def model_in(self, phase: Phase) -> Parameters:
        """Return the overrides of the model that the nodes work with in a phase."""
        return {**self.model, **phase.model}

    def has_state_feedback(self, phase: Phase) -> bool:
        """Say whether the feedforward has state feedback in a phase."""
        given = {**self.nodes.get('feedforward', {}), **phase.nodes.get('feedforward', {})}
        return bool(given.get('feedback.state', 'off') != 'off')


def load_config(path: str | os.PathLike[str], settings: Sequence[str] = ()) -> SessionConfig:
    """Read and check a configuration.

    Parameters
    ----------
    path : path
        A YAML file; one that is not here is looked for where the package is installed.
    settings : sequence of str
        `path=value` each: a dotted path of the file, or one of the model (`beam.`, `joint.`,
        `payload.`), which then holds for the plant and the other nodes alike.
    """
    file = find_file(Path(path), Path())
    if file is None:
        raise ConfigError(str(path), ['the configuration must be a file, got none of this name'])
    raw = read_yaml(file)
    findings: list[str] = []
    for setting in settings:
        apply_setting(raw, setting, findings)
    config = _Checker(file, findings).session(raw)
    ConfigError.raise_any(str(path), findings)
    return config


def read_yaml(file: Path) -> dict[str, Any]:
    """Return a YAML file's mapping; ConfigError with the line of the error."""
    value = read_yaml_file(file)
    if not isinstance(value, dict):
        raise ConfigError(str(file), [f'the file must be a mapping, got {_kind(value)}'])
    return value


def find_file(path: Path, folder: Path) -> Path | None:
    """Return the file relative to a folder, else below the installed share directory."""
    for base in (folder, share_directory(), share_directory() / 'config'):
        if (base / path).is_file():
            return base / path
    return None


def read_reference(name: str, folder: Path, where: str) -> dict[str, Any]:
    """Return a reference that stands in a file of its own; ConfigError where there is none."""
    found = find_file(Path(name), folder)
    if found is None:
        raise ConfigError(where, [NO_REFERENCE.format(name)])
    return read_yaml(found)


def share_directory() -> Path:
    """Return the package's config/ folder: in the source tree, else share/denoc_ros."""
    source = Path(__file__).resolve().parents[3]
    if (source / 'package.xml').is_file():
        return source
    here = Path(__file__).resolve()
    for prefix in (*here.parents, Path(sys.prefix)):
        if (prefix / 'share' / 'denoc_ros' / 'config').is_dir():
            return prefix / 'share' / 'denoc_ros'
    return Path(sys.prefix) / 'share' / 'denoc_ros'


def flatten(values: Mapping[Any, Any], prefix: str = '') -> Parameters:
    """Return nested mappings as one with dotted names: {'a': {'b': 1}} gives {'a.b': 1}."""
    flat: Parameters = {}
    for key, value in values.items():
        if isinstance(value, Mapping) and value:
            flat.update(flatten(value, f'{prefix}{key}.'))
        else:
            flat[f'{prefix}{key}'] = value
    return flat


class _Checker(MappingReader):
    """Checks one file's mapping; every finding goes into the list it was given."""

    def __init__(self, file: Path, findings: list[str]) -> None:
        super().__init__(findings)
        self._file = file

    def session(self, raw: Mapping[str, Any]) -> SessionConfig:
        self.only('the configuration', raw, KEYS)
        plant = flatten(self.mapping('plant', raw.get('plant')))
        listed = self.mapping('nodes', raw.get('nodes'))
        without = frozenset(
            name
            for name in ALL_NODES
            if name not in NODES or listed.get(name, name not in WHEN_ASKED) is False
        )
        nodes = self._nodes('nodes', {k: v for k, v in listed.items() if k not in without})
        nodes['plant'] = {**nodes.get('plant', {}), **_split(plant, FAMILIES)[1]}
        if scene := nodes['plant'].get('scene'):
            nodes['plant']['scene'] = self._scene(scene)
        mechanism = self._mechanism(raw)
        if mechanism:
            for name in OF_ROBOTS:
                nodes[name] = {**mechanism, **nodes.get(name, {})}
            shape = {name: value for name, value in mechanism.items() if name == 'posture'}
            nodes['viewer'] = {**shape, **nodes.get('viewer', {})}
        model = flatten(self.mapping('model', raw.get('model')))
        gravity = self._take(
            raw,
            'gravity',
            [0.0, 0.0, -9.81],
            lambda v: are_numbers(v) and len(v) == 3,
            'three finite numbers [m/s^2]',
        )
        duration = self._take(
            raw,
            'duration',
            0.0,
            lambda v: is_number(v) and v >= 0.0,
            'a number >= 0 s (0: that of the reference)',
        )
        return SessionConfig(
            path=self._file,
            robot=self._robot(raw.get('robot')),
            gravity=(float(gravity[0]), float(gravity[1]), float(gravity[2])),
            reference=self._reference(raw.get('reference')),
            duration=float(duration),
            record=self._take(raw, 'record', True, lambda v: isinstance(v, bool), 'true or false'),
            time=self._take(raw, 'time', AUTO, TIMES.__contains__, f'one of {", ".join(TIMES)}'),
            tip=self._take(raw, 'tip', '', lambda v: isinstance(v, str), 'a name'),
            joints=tuple(mechanism.get('joints', ())),
            model=self._overrides('model', model),
            nodes=nodes,
            without=without,
            plant_model=self._overrides('plant', _split(plant, FAMILIES)[0]),
            phases=self._phases(raw.get('phases')),
        )

    def _scene(self, value: Any) -> Any:
        """Return the path of a scene, which is relative to the configuration's folder."""
        found = find_file(Path(value), self._file.parent) if isinstance(value, str) else None
        if found is None:
            self.fail('plant scene', f'be a file (relative to {self._file.parent})', value)
            return value
        return str(found)

    def _robot(self, value: Any) -> Path:
        if not isinstance(value, str) or not value:
            self.fail('robot', 'be the path of a URDF', value)
            return Path()
        found = find_file(Path(value), self._file.parent)
        if found is None:
            near = f'{self._file.parent} or to the installed config directory'
            self.fail('robot', f'be a file (relative to {near})', value)
        return found or Path()

    def _take(
        self,
        raw: Mapping[str, Any],
        name: str,
        usual: Any,
        is_good: Callable[[Any], bool],
        rule: str,
    ) -> Any:
        """Return a value of the file, the usual one where it has none or a wrong one."""
        value = raw.get(name, usual)
        if is_good(value):
            return value
        self.fail(name, f'be {rule}', value)
        return usual

    def _mechanism(self, raw: Mapping[str, Any]) -> Parameters:
        """Return the parameters for the robot's loops, which all nodes share."""
        joints, posture = raw.get('joints', []), raw.get('posture', [])
        if not (isinstance(joints, list) and all(isinstance(name, str) for name in joints)):
            self.fail('joints', 'be a list of the driven joints', joints)
            joints = []
        if posture != [] and not are_numbers(posture):
            self.fail('posture', 'be a list of finite numbers [rad or m]', posture)
            posture = []
        given = {'joints': joints, 'posture': [float(value) for value in posture]}
        return {name: value for name, value in given.items() if value}

    def _reference(self, value: Any) -> Mapping[str, Any]:
        if isinstance(value, str):
            if find_file(Path(value), self._file.parent) is None:
                self.find(NO_REFERENCE.format(value))
                return {}
            return self._reference(read_reference(value, self._file.parent, str(self._file)))
        values = dict(self.mapping('reference', value))
        if values and values.get('kind') not in REFERENCE_KINDS:
            self.fail(
                "reference's kind", f'be of {", ".join(REFERENCE_KINDS)}', values.get('kind')
            )
        return values

    def _nodes(self, whose: str, value: Any) -> dict[str, Parameters]:
        values = self.mapping(whose, value)
        self.only(whose, values, NODES)
        return {
            name: flatten(self.mapping(f'{whose}.{name}', parameters))
            for name, parameters in values.items()
            if name in NODES
        }

    def _overrides(self, whose: str, flat: Parameters) -> Parameters:
        for path, value in flat.items():
            if path.split('.')[0] not in FAMILIES:
                self.fail(f"{whose}'s paths", f'start with one of {FAMILIES}', path)
            elif not (is_number(value) or are_numbers(value)):
                self.fail(f'{whose} {path}', 'be a finite number or some', value)
        return flat

    def _phases(self, value: Any) -> tuple[Phase, ...]:
        if value is None:
            return (Phase('run'),)
        if not isinstance(value, list) or not value:
            self.find(f'phases must be a list with at least one entry, got {_kind(value)}')
            return (Phase('run'),)
        phases = tuple(self._phase(f'phases[{k}]', entry) for k, entry in enumerate(value))
        names = [phase.name for phase in phases]
        if len(set(names)) < len(names):
            self.find(f'phases must have different names, got {names}')
        for k, phase in enumerate(phases):
            if phase.identify and phase.identify not in names[:k]:
                rule = f'be an earlier phase ({", ".join(names[:k]) or "none"})'
                self.fail(f'phases[{k}].identify', rule, phase.identify)
        return phases

    def _phase(self, whose: str, value: Any) -> Phase:
        values = self.mapping(whose, value)
        self.only(whose, values, ('name', 'shape', 'model', 'identify', *NODES))
        name = values.get('name')
        if not isinstance(name, str) or not name:
            self.fail(f'{whose}.name', 'be a text', name)
        nodes = self._nodes(whose, {k: v for k, v in values.items() if k in NODES})
        shape = self.mapping(f'{whose}.shape', values.get('shape'))
        if 'shape' in values and not isinstance(shape.get('method'), str):
            self.find(f'{whose}.shape must have a method, got {shape}')
        model = flatten(self.mapping(f'{whose}.model', values.get('model')))
        identify = values.get('identify', '')
        if not isinstance(identify, str):
            self.fail(f'{whose}.identify', 'be the name of an earlier phase', identify)
            identify = ''
        overrides = self._overrides(f'{whose}.model', model)
        return Phase(str(name), nodes, dict(shape), overrides, str(identify))


def _split(flat: Parameters, heads: Sequence[str]) -> tuple[Parameters, Parameters]:
    """Return the entries whose path starts with one of the heads, and the rest."""
    inside = {path: value for path, value in flat.items() if path.split('.')[0] in heads}
    return inside, {path: value for path, value in flat.items() if path not in inside}


def _kind(value: Any) -> str:
    return 'nothing' if value is None else f'{type(value).__name__} {value!r}'
