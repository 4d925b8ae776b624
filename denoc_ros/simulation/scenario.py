"""What to simulate, from a mapping such as a YAML file's: checked, every finding gathered."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError
from denoc_ros.simulation.laws import Law, SpinUp, TableTorque, of_joint, rigid_torque, step_torque
from denoc_ros.simulation.motion import Prescribed, Torque, mimic_ties
from denoc_ros.simulation.reference import trajectory_from_config
from denoc_ros.simulation.run import Run
from denoc_ros.simulation.simulate import METHODS, simulate
from denoc_ros.simulation.trajectories import Trajectory

Array = NDArray[np.float64]

KEYS = (
    'gravity',
    'geometric_stiffness',
    'model',
    'start',
    'torque',
    'reference',
    'prescribed',
    'duration',
    'output_rate',
    'rtol',
    'method',
)
START_KEYS = ('joints', 'rates', 'amplitudes')
TORQUE_KINDS = ('zero', 'step', 'rigid_inverse_dynamics')
TABLE_KINDS = ('hold', 'linear')


@dataclass(frozen=True)
class ModelSettings:
    """What a scenario says of the model itself.

    Attributes
    ----------
    gravity : tuple of float
        (3,) base frame [m/s^2].
    geometric_stiffness : bool
        Whether beams foreshorten.
    overrides : mapping
        Dotted path -> number, or several.
    """

    gravity: tuple[float, float, float]
    geometric_stiffness: bool
    overrides: Mapping[str, float | list[float]]


@dataclass(frozen=True)
class Scenario:
    """A simulation to be run.

    Attributes
    ----------
    q0, qd0 : (n,) arrays
        Start.
    times : (k,) array
        Output times [s].
    torque : callable or None
        As `simulate` takes it.
    prescribed : mapping
        As `simulate` takes it.
    reference : Trajectory or None
        What the joints are meant to do, over all joint names.
    rtol : float
        Tolerance.
    method : str
        Integrator.
    """

    q0: Array
    qd0: Array
    times: Array
    torque: Torque | None = None
    prescribed: Prescribed = field(default_factory=dict)
    reference: Trajectory | None = None
    rtol: float = 1e-8
    method: str = 'DOP853'

    def run(self, robot: Robot, progress: bool = False) -> Run:
        """Simulate; raises what `simulate` raises."""
        return simulate(
            robot,
            self.q0,
            self.qd0,
            self.times,
            self.torque,
            self.prescribed,
            rtol=self.rtol,
            method=self.method,
            progress=progress,
        )


def model_settings(values: Mapping[str, Any], where: str) -> ModelSettings:
    """Return what a scenario says of the model, before there is one.

    Parameters
    ----------
    values : mapping
        The scenario; `gravity` (three numbers), `geometric_stiffness` and `model` (dotted paths)
        are read.
    where : str
        Named in errors.

    Raises
    ------
    ConfigError
        With every finding.
    """
    reader = _Reader(values)
    gravity = reader.numbers('gravity', [0.0, 0.0, -9.81])
    if len(gravity) != 3:
        reader.find(f'gravity must be three numbers [m/s^2], got {values["gravity"]!r}')
    stiffness = values.get('geometric_stiffness', True)
    if not isinstance(stiffness, bool):
        reader.find(f'geometric_stiffness must be true or false, got {stiffness!r}')
    overrides = reader.overrides('model')
    reader.finish(where)
    return ModelSettings((gravity[0], gravity[1], gravity[2]), stiffness, overrides)


def scenario_from_config(values: Mapping[str, Any], robot: Robot, where: str) -> Scenario:
    """Return the scenario of a mapping for a robot loaded with its `model_settings`.

    Parameters
    ----------
    values : mapping
        `duration` [s] and `output_rate` [Hz, default 100]; one of `torque` (kind zero, step or
        rigid_inverse_dynamics), `reference` (all joints follow it exactly) and `prescribed` (the
        joints named do); `start`, `rtol`, `method`.
    robot : Robot
        The robot.
    where : str
        Named in errors.

    Raises
    ------
    ConfigError
        With every finding.
    """
    reader = _Reader(values)
    reader.only('the scenario', values, KEYS)
    driver = _Driver(reader, robot)
    driver.read()
    duration, rate = reader.positive('duration', None), reader.positive('output_rate', 100.0)
    rtol, method = reader.positive('rtol', 1e-8), values.get('method', 'DOP853')
    if method not in METHODS:
        reader.find(f'method must be one of {", ".join(METHODS)}, got {method!r}')
    start = _start(reader, robot, driver)
    if 'duration' not in values:
        if driver.reference is None:
            reader.find('duration must be given where no reference has one')
        else:
            duration = driver.reference.duration
    reader.finish(where)
    count = max(1, round(duration * rate))
    return Scenario(
        *start,
        np.linspace(0.0, duration, count + 1),
        driver.torque,
        driver.prescribed,
        driver.reference,
        rtol,
        str(method),
    )


class _Reader:
    """Reads a mapping's values; what does not hold becomes a finding."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.values = values
        self.findings: list[str] = []

    def find(self, text: str) -> None:
        self.findings.append(text)

    def finish(self, where: str) -> None:
        if self.findings:
            raise ConfigError(where, self.findings)

    def only(self, whose: str, values: Mapping[Any, Any], known: Sequence[str]) -> None:
        for key in values:
            if key not in known:
                self.find(f"{whose}'s keys must be of {', '.join(known)}, got {key!r}")

    def mapping(self, whose: str, value: Any) -> Mapping[str, Any]:
        if value is None:
            return {}
        if isinstance(value, Mapping):
            return value
        self.find(f'{whose} must be a mapping, got {value!r}')
        return {}

    def numbers(self, key: str, default: list[float]) -> list[float]:
        value = self.values.get(key, default)
        if isinstance(value, (list, tuple)) and all(map(_is_number, value)):
            return [float(entry) for entry in value]
        self.find(f'{key} must be finite numbers, got {value!r}')
        return default

    def positive(self, key: str, default: float | None) -> float:
        value = self.values.get(key, default)
        if value is None:
            return 1.0
        if _is_number(value) and value > 0.0:
            return float(value)
        self.find(f'{key} must be a number > 0, got {value!r}')
        return 1.0

    def overrides(self, whose: str) -> dict[str, float | list[float]]:
        """Return a mapping of a number, or several, by dotted path."""
        found = dict(self.mapping(whose, self.values.get(whose)))
        for path, value in found.items():
            several = value if isinstance(value, list) and value else [value]
            if not all(map(_is_number, several)):
                self.find(f'{whose} {path} must be a finite number or some, got {value!r}')
        return found

    def named_numbers(
        self, whose: str, names: Sequence[str] | None, value: Any = None
    ) -> dict[str, float]:
        """Return a mapping of numbers by name; a list stands for all names in their order."""
        value = self.values.get(whose) if value is None else value
        if isinstance(value, (list, tuple)) and names is not None:
            if len(value) != len(names):
                self.find(f'{whose} must have {len(names)} numbers, got {len(value)}')
                return {}
            value = dict(zip(names, value, strict=True))
        found = {}
        for name, number in self.mapping(whose, value).items():
            if names is not None and name not in names:
                self.find(f'{whose} must name some of {", ".join(names)}, got {name!r}')
            elif not _is_number(number):
                self.find(f'{whose} {name} must be a finite number, got {number!r}')
            else:
                found[name] = number  # a number of modes stays whole
        return found

    def trajectory(
        self, value: Any, joints: Sequence[str], whose: str = 'reference'
    ) -> Trajectory | None:
        values = self.mapping(whose, value)
        try:
            return trajectory_from_config(values, joints, whose)
        except ConfigError as error:
            self.findings += [f'{whose}: {finding}' for finding in error.findings]
        return None


class _Driver:
    """What moves the robot: one of `torque`, `reference`, `prescribed`."""

    def __init__(self, reader: _Reader, robot: Robot) -> None:
        self._reader = reader
        self._robot = robot
        self._ties = mimic_ties(robot)
        self._joints = [name for name in robot.joint_names if name not in self._ties]
        self.torque: Torque | None = None
        self.prescribed: dict[str, Callable[[float], tuple[float, float, float]]] = {}
        self.reference: Trajectory | None = None

    def read(self) -> None:
        reader, values = self._reader, self._reader.values
        given = [key for key in ('torque', 'reference', 'prescribed') if values.get(key)]
        if len(given) > 1:
            reader.find(f'only one of torque, reference and prescribed must be given, got {given}')
        elif given == ['torque']:
            self._read_torque(reader.mapping('torque', values['torque']))
        elif given == ['reference']:
            self.reference = reader.trajectory(values['reference'], self._joints)
            if self.reference is not None:
                law = Law(self.reference)
                self.prescribed = {name: of_joint(law, k) for k, name in enumerate(self._joints)}
        elif given:
            self._read_prescribed(reader.mapping('prescribed', values['prescribed']))

    def _read_torque(self, values: Mapping[str, Any]) -> None:
        reader, robot = self._reader, self._robot
        kind = values.get('kind', 'zero')
        if kind not in TORQUE_KINDS:
            reader.find(f"torque's kind must be one of {', '.join(TORQUE_KINDS)}, got {kind!r}")
        elif kind == 'step':
            reader.only('torque', values, ('kind', 'values'))
            height = reader.named_numbers('torque values', self._joints, values.get('values', {}))
            self.torque = step_torque(robot, height)
        elif kind == 'rigid_inverse_dynamics':
            reader.only('torque', values, ('kind', 'reference', 'every', 'between'))
            self.reference = reader.trajectory(values.get('reference'), self._joints)
            if self._ties:
                reader.find('rigid_inverse_dynamics must have a robot without mimic joints')
            elif self.reference is not None:
                self.torque = self._as_table(rigid_torque(robot, self.reference), values)
        else:
            reader.only('torque', values, ('kind',))

    def _as_table(self, torque: Torque, values: Mapping[str, Any]) -> Torque:
        """Return the torques as entries every so often, where the scenario says so."""
        every, between = values.get('every'), values.get('between', 'hold')
        if between not in TABLE_KINDS:
            self._reader.find(
                f"torque's between must be one of {', '.join(TABLE_KINDS)}, got {between!r}"
            )
        if every is None:
            if 'between' in values:
                self._reader.find("torque's between must come with every, got no every")
            return torque
        if not (_is_number(every) and every > 0.0):
            self._reader.find(f"torque's every must be a number > 0 s, got {every!r}")
            return torque
        return TableTorque(torque, float(every), str(between))

    def _read_prescribed(self, values: Mapping[str, Any]) -> None:
        for name, law in values.items():
            whose = f'prescribed {name}'
            if name not in self._joints:
                self._reader.find(
                    f'prescribed must name some of {", ".join(self._joints)}, got {name!r}'
                )
            elif isinstance(law, Mapping) and law.get('kind') == 'spin_up':
                self._read_spin_up(name, whose, law)
            else:
                trajectory = self._reader.trajectory(law, [name], whose)
                if trajectory is not None:
                    self.prescribed[name] = of_joint(Law(trajectory), 0)

    def _read_spin_up(self, name: str, whose: str, law: Mapping[str, Any]) -> None:
        self._reader.only(whose, law, ('kind', 'rate', 'time'))
        rate, time = law.get('rate', 0.0), law.get('time', 0.0)
        if _is_number(rate) and _is_number(time) and time > 0.0:
            self.prescribed[name] = SpinUp(float(rate), float(time))
        else:
            self._reader.find(
                f'{whose}: rate must be a number and time > 0 s, got {rate!r} and {time!r}'
            )


def _start(reader: _Reader, robot: Robot, driver: _Driver) -> tuple[Array, Array]:
    """Return q0 and qd0: what is given, else where the reference and the laws begin."""
    values = reader.mapping('start', reader.values.get('start'))
    reader.only('start', values, START_KEYS)
    q, qd = np.zeros(robot.n), np.zeros(robot.n)
    index = dict(zip(robot.joint_names, np.asarray(robot.joint_indices).tolist(), strict=True))
    free = [name for name in index if name not in mimic_ties(robot)]
    if driver.reference is not None and len(free) == driver.reference.n:
        law = Law(driver.reference)
        for k, name in enumerate(free):
            q[index[name]], qd[index[name]], _ = of_joint(law, k)(0.0)
    for name, motion in driver.prescribed.items():
        q[index[name]], qd[index[name]], _ = motion(0.0)
    for key, state in (('joints', q), ('rates', qd)):
        for name, value in reader.named_numbers(f'start {key}', free, values.get(key, {})).items():
            state[index[name]] = value
    for name, (leader, multiplier, offset) in mimic_ties(robot).items():
        q[index[name]] = multiplier * q[index[leader]] + offset
        qd[index[name]] = multiplier * qd[index[leader]]
    amplitudes = values.get('amplitudes', 'zero')
    if amplitudes == 'static':
        return robot.static_deflection(q[robot.joint_indices]), qd
    if amplitudes != 'zero':
        names = list(robot.coordinate_names)
        known = [name for name in names if name not in index]
        for name, value in reader.named_numbers('start amplitudes', known, amplitudes).items():
            q[names.index(name)] = value
    return q, qd


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
