"""The scenario of a simulation, from a mapping such as a YAML file; all findings gathered."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ConfigError
from denoc_ros.model.plant_description import KEYS as PLANT_KEYS
from denoc_ros.model.plant_description import PlantDescription, read_plant
from denoc_ros.model.reading.mapping_reader import MappingReader, is_number
from denoc_ros.simulation.equations_of_motion import Prescribed, Torque
from denoc_ros.simulation.reference_motion import Circle, follow, trajectory_from_config
from denoc_ros.simulation.simulate import METHODS, Run, simulate
from denoc_ros.simulation.time_functions import (
    SHIFTS,
    TURNS,
    Harmonic,
    SampledTorque,
    SpinUp,
    SwayingBase,
    TimeFunction,
    of_joint,
    rigid_loop_torque,
    rigid_robot,
    rigid_torque,
    step_torque,
)
from denoc_ros.trajectories import Trajectory
from denoc_ros.types import Array

TORQUE_KINDS = ('zero', 'step', 'rigid_inverse_dynamics')
TABLE_KINDS = ('hold', 'linear')
CIRCLE_NEEDS = ('radius', 'duration')
CIRCLE_KEYS = ('kind', 'frame', 'centre', 'start', 'turns', 'guess', *CIRCLE_NEEDS)
KEYS = (
    'gravity',
    'geometric_stiffness',
    'model',
    'plant',
    'start',
    'torque',
    'reference',
    'prescribed',
    'base',
    'duration',
    'output_rate',
    'rtol',
    'method',
)
START_KEYS = ('joints', 'rates', 'amplitudes')


class ScenarioReader(MappingReader):
    """Reader of a mapping's values; violations become findings."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        super().__init__()
        self.values = values

    def numbers(self, key: str, default: list[float]) -> list[float]:
        """Return a list of numbers."""
        value = self.values.get(key, default)
        if isinstance(value, (list, tuple)) and all(map(is_number, value)):
            return [float(entry) for entry in value]
        self.fail(key, 'be finite numbers', value)
        return default

    def positive(self, key: str, default: float | None) -> float:
        """Return a number > 0."""
        value = self.values.get(key, default)
        if value is None:
            return 1.0
        if is_number(value) and value > 0.0:
            return float(value)
        self.fail(key, 'be a number > 0', value)
        return 1.0

    def overrides(self, whose: str) -> dict[str, float | list[float]]:
        """Return a mapping of a number, or several, by dotted path."""
        found = dict(self.mapping(whose, self.values.get(whose)))
        for path, value in found.items():
            several = value if isinstance(value, list) and value else [value]
            if not all(map(is_number, several)):
                self.fail(f'{whose} {path}', 'be a finite number or some', value)
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
                self.fail(whose, f'name some of {", ".join(names)}', name)
            elif not is_number(number):
                self.fail(f'{whose} {name}', 'be a finite number', number)
            else:
                found[name] = number  # a number of modes stays whole
        return found

    def trajectory(
        self, value: Any, joints: Sequence[str], whose: str = 'reference'
    ) -> Trajectory | None:
        """Return the trajectory of a mapping, None where it has findings."""
        values = self.mapping(whose, value)
        try:
            return trajectory_from_config(values, joints, whose)
        except ConfigError as error:
            self.findings += [f'{whose}: {finding}' for finding in error.findings]
        return None


class ScenarioInputs:
    """Inputs of the robot: one of `torque`, `reference`, `prescribed`."""

    def __init__(self, reader: ScenarioReader, robot: Robot) -> None:
        self._reader = reader
        self._robot = robot
        self._ties = robot.tree.mimics
        self._joints = [name for name in robot.joint_names if name not in self._ties]
        self.torque: Torque | None = None
        self.prescribed: dict[str, Callable[[float], tuple[float, float, float]]] = {}
        self.reference: Trajectory | None = None

    def read(self) -> None:
        """Read whichever of the three the scenario has."""
        reader, values = self._reader, self._reader.values
        given = [key for key in ('torque', 'reference', 'prescribed') if values.get(key)]
        if len(given) > 1:
            reader.find(f'only one of torque, reference and prescribed must be given, got {given}')
        elif given == ['torque']:
            self._read_torque(reader.mapping('torque', values['torque']))
        elif given == ['reference']:
            self.reference = reader.trajectory(values['reference'], self._joints)
            if self.reference is not None:
                law = TimeFunction(self.reference)
                self.prescribed = {name: of_joint(law, k) for k, name in enumerate(self._joints)}
        elif given:
            self._read_prescribed(reader.mapping('prescribed', values['prescribed']))

    def _read_torque(self, values: Mapping[str, Any]) -> None:
        reader, robot = self._reader, self._robot
        kind = values.get('kind', 'zero')
        if kind not in TORQUE_KINDS:
            reader.fail("torque's kind", f'be one of {", ".join(TORQUE_KINDS)}', kind)
        elif kind == 'step':
            reader.only('torque', values, ('kind', 'values'))
            height = reader.named_numbers('torque values', self._joints, values.get('values', {}))
            self.torque = step_torque(robot, height)
        elif kind == 'rigid_inverse_dynamics':
            loops = ('actuated',) if robot.tree.loops else ()
            reader.only('torque', values, ('kind', 'reference', 'every', 'between', *loops))
            if loops:
                self._read_rigid_in_loops(values)
                return
            self.reference = reader.trajectory(values.get('reference'), self._joints)
            if self._ties:
                reader.find('rigid_inverse_dynamics must have a robot without mimic joints')
            elif self.reference is not None:
                self.torque = self._as_table(rigid_torque(robot, self.reference), values)
        else:
            reader.only('torque', values, ('kind',))

    def _read_rigid_in_loops(self, values: Mapping[str, Any]) -> None:
        reader, robot = self._reader, self._robot
        actuated = values.get('actuated')
        if not isinstance(actuated, list) or not set(actuated) <= set(self._joints):
            reader.fail(
                "torque's actuated",
                f'be some of {", ".join(self._joints)} where there are loops',
                actuated,
            )
            return
        reference = values.get('reference')
        if isinstance(reference, Mapping) and reference.get('kind') == 'circle':
            self.reference = self._read_circle(reference)
        else:
            self.reference = reader.trajectory(reference, self._joints)
        if self.reference is not None:
            self.torque = self._as_table(
                rigid_loop_torque(robot, self.reference, actuated), values
            )

    def _read_circle(self, values: Mapping[str, Any]) -> Trajectory | None:
        """Return the joints' motion that carries a frame along a circle."""
        reader, robot = self._reader, self._robot
        before = len(reader.findings)
        reader.only('circle', values, CIRCLE_KEYS)
        if values.get('frame') not in robot.tree.frames:
            reader.fail("circle's frame", "be one of the robot's", values.get('frame'))
        centre = values.get('centre')
        if not (isinstance(centre, list) and len(centre) == 3 and all(map(is_number, centre))):
            reader.fail("circle's centre", 'be three numbers [m]', centre)
        numbers: dict[str, Any] = {
            'start': 0.0,
            'turns': 1.0,
            **{key: values.get(key) for key in CIRCLE_NEEDS},
        }
        numbers |= {key: values[key] for key in ('start', 'turns') if key in values}
        for key, value in numbers.items():
            if not is_number(value) or (key in CIRCLE_NEEDS and value <= 0.0):
                reader.fail(f"circle's {key}", 'be a number (radius, duration > 0)', value)
        guess = reader.named_numbers("circle's guess", self._joints, values.get('guess', {}))
        if len(reader.findings) > before:
            return None
        circle = Circle(values['frame'], np.array(centre, dtype=float), **numbers)
        start = np.array([guess.get(name, 0.0) for name in robot.joint_names])
        return follow(rigid_robot(robot), circle, start)

    def _as_table(self, torque: Torque, values: Mapping[str, Any]) -> Torque:
        """Return the torques as entries every so often, where the scenario says so."""
        every, between = values.get('every'), values.get('between', 'hold')
        if between not in TABLE_KINDS:
            self._reader.fail("torque's between", f'be one of {", ".join(TABLE_KINDS)}', between)
        if every is None:
            if 'between' in values:
                self._reader.find("torque's between must come with every, got no every")
            return torque
        if not (is_number(every) and every > 0.0):
            self._reader.fail("torque's every", 'be a number > 0 s', every)
            return torque
        return SampledTorque(torque, float(every), str(between))

    def _read_prescribed(self, values: Mapping[str, Any]) -> None:
        for name, law in values.items():
            whose = f'prescribed {name}'
            if name not in self._joints:
                self._reader.fail('prescribed', f'name some of {", ".join(self._joints)}', name)
            elif isinstance(law, Mapping) and law.get('kind') == 'spin_up':
                self._read_spin_up(name, whose, law)
            else:
                trajectory = self._reader.trajectory(law, [name], whose)
                if trajectory is not None:
                    self.prescribed[name] = of_joint(TimeFunction(trajectory), 0)

    def _read_spin_up(self, name: str, whose: str, law: Mapping[str, Any]) -> None:
        self._reader.only(whose, law, ('kind', 'rate', 'time'))
        rate, time = law.get('rate', 0.0), law.get('time', 0.0)
        if is_number(rate) and is_number(time) and time > 0.0:
            self.prescribed[name] = SpinUp(float(rate), float(time))
        else:
            self._reader.find(
                f'{whose}: rate must be a number and time > 0 s, got {rate!r} and {time!r}'
            )


@dataclass(frozen=True)
class ModelSettings:
    """Settings of the model in a scenario."""

    gravity: tuple[float, float, float]  # base frame [m/s^2]
    geometric_stiffness: bool  # whether beams foreshorten
    overrides: Mapping[str, float | list[float]]  # by dotted path
    plant: PlantDescription  # how its beams are described, where not as in the file

    def load(
        self,
        robot: str | os.PathLike[str],
        overrides: Mapping[str, float | list[float] | str] | None = None,
    ) -> Robot:
        """Return the robot of a file or text, with further overrides above those of the scenario.

        Raises
        ------
        ConfigError, ModelError
            With every finding.
        """
        loaded = load_robot(robot, self.gravity, self.geometric_stiffness)
        changes = {**self.plant.overrides(loaded.tree), **self.overrides, **(overrides or {})}
        return loaded.with_overrides(changes) if changes else loaded


@dataclass(frozen=True)
class Scenario:
    """A simulation to be run."""

    # (n,) start
    q0: Array
    qd0: Array
    times: Array  # (k,) of the output [s]
    torque: Torque | None = None  # as `simulate` takes it
    prescribed: Prescribed = field(default_factory=dict)  # as `simulate` takes it
    reference: Trajectory | None = None  # desired motion of all joints
    rtol: float = 1e-8
    method: str = 'DOP853'
    base: SwayingBase | None = None  # its motion; None: at rest, or floating

    def run(self, robot: Robot, progress: bool = False) -> Run:
        """Simulate; raises the errors of `simulate`."""
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
            base=self.base,
        )


def model_settings(values: Mapping[str, Any], where: str) -> ModelSettings:
    """Read the model's settings of a scenario, before there is a model.

    Parameters
    ----------
    values : mapping
        The scenario; `gravity` (three numbers), `geometric_stiffness`, `model` (dotted paths) and
        `plant` (modes, shape, segments) are read.
    where : str
        Named in errors.

    Raises
    ------
    ConfigError
        With every finding.
    """
    reader = ScenarioReader(values)
    gravity = reader.numbers('gravity', [0.0, 0.0, -9.81])
    if len(gravity) != 3:
        reader.fail('gravity', 'be three numbers [m/s^2]', values['gravity'])
    stiffness = values.get('geometric_stiffness', True)
    if not isinstance(stiffness, bool):
        reader.fail('geometric_stiffness', 'be true or false', stiffness)
    overrides = reader.overrides('model')
    described = reader.mapping('plant', values.get('plant'))
    reader.only('plant', described, PLANT_KEYS)
    plant = read_plant(described, reader.find)
    reader.finish(where)
    return ModelSettings((gravity[0], gravity[1], gravity[2]), stiffness, overrides, plant)


def scenario_from_config(values: Mapping[str, Any], robot: Robot, where: str) -> Scenario:
    """Return the scenario of a mapping for a robot loaded with its `model_settings`.

    Parameters
    ----------
    values : mapping
        `duration` [s] and `output_rate` [Hz, default 100]; one of `torque` (kind zero, step or
        rigid_inverse_dynamics), `reference` (all joints follow it exactly) and `prescribed` (the
        joints named do); `base`, the harmonics of a base that sways; `start`, `rtol`, `method`.
    robot : Robot
        The robot.
    where : str
        Named in errors.

    Raises
    ------
    ConfigError
        With every finding.
    """
    reader = ScenarioReader(values)
    reader.only('the scenario', values, KEYS)
    inputs = ScenarioInputs(reader, robot)
    inputs.read()
    duration, rate = reader.positive('duration', None), reader.positive('output_rate', 100.0)
    rtol, method = reader.positive('rtol', 1e-8), values.get('method', 'DOP853')
    if method not in METHODS:
        reader.fail('method', f'be one of {", ".join(METHODS)}', method)
    base = _base(reader)
    start = _start(reader, robot, inputs)
    if 'duration' not in values:
        if inputs.reference is None:
            reader.find('duration must be given where no reference has one')
        else:
            duration = inputs.reference.duration
    reader.finish(where)
    count = max(1, round(duration * rate))
    return Scenario(
        *start,
        np.linspace(0.0, duration, count + 1),
        inputs.torque,
        inputs.prescribed,
        inputs.reference,
        rtol,
        str(method),
        base,
    )


def _base(reader: ScenarioReader) -> SwayingBase | None:
    """Return the motion of a base that sways, if one is given."""
    values = reader.mapping('base', reader.values.get('base'))
    reader.only('base', values, (*SHIFTS, *TURNS))
    motions = {}
    for name, given in values.items():
        motion = reader.mapping(f'base {name}', given)
        reader.only(f'base {name}', motion, ('amplitude', 'period', 'phase'))
        numbers = {'phase': 0.0, **motion}
        bad = [key for key in ('amplitude', 'period', 'phase') if not is_number(numbers.get(key))]
        if bad or numbers['period'] <= 0.0:
            reader.fail(
                f'base {name}', 'have numbers amplitude, period > 0 s and, if not 0, phase', given
            )
            continue
        motions[name] = Harmonic(*(float(numbers[k]) for k in ('amplitude', 'period', 'phase')))
    return SwayingBase(motions) if motions else None


def _start(reader: ScenarioReader, robot: Robot, inputs: ScenarioInputs) -> tuple[Array, Array]:
    """Initial q0 and qd0: as given, else at the start of the reference and the laws."""
    values = reader.mapping('start', reader.values.get('start'))
    reader.only('start', values, START_KEYS)
    q, qd = np.zeros(robot.n), np.zeros(robot.n)
    index = dict(zip(robot.joint_names, np.asarray(robot.joint_indices).tolist(), strict=True))
    free = list(robot.tree.non_mimic_joints)
    if inputs.reference is not None and len(free) == inputs.reference.n:
        law = TimeFunction(inputs.reference)
        for k, name in enumerate(free):
            q[index[name]], qd[index[name]], _ = of_joint(law, k)(0.0)
    for name, motion in inputs.prescribed.items():
        q[index[name]], qd[index[name]], _ = motion(0.0)
    for key, state in (('joints', q), ('rates', qd)):
        for name, value in reader.named_numbers(f'start {key}', free, values.get(key, {})).items():
            state[index[name]] = value
    for name, mimic in robot.tree.mimics.items():
        leader = index[mimic.leader]
        q[index[name]] = mimic.multiplier * q[leader] + mimic.offset
        qd[index[name]] = mimic.multiplier * qd[leader]
    amplitudes = values.get('amplitudes', 'zero')
    if amplitudes == 'static' and robot.tree.loops:
        reader.find('start amplitudes must be zero or given where there are loops, got static')
    elif amplitudes == 'static':
        return robot.static_deflection(q[robot.joint_indices]), qd
    elif isinstance(amplitudes, str) and amplitudes != 'zero':
        reader.fail('start amplitudes', 'be zero, static or numbers by name', amplitudes)
    elif amplitudes != 'zero':
        names = list(robot.coordinate_names)
        known = [name for name in names if name not in index]
        for name, value in reader.named_numbers('start amplitudes', known, amplitudes).items():
            q[names.index(name)] = value
    if robot.tree.loops and not reader.findings:
        held = tuple(inputs.prescribed)
        q = robot.assemble(q, held)
        qd = robot.assemble_rates(q, qd, held)
    return q, qd
