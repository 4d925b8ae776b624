"""The scenario of a simulation, from a mapping such as a YAML file; all findings gathered."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.model.mapping_reader import is_number
from denoc_ros.model.plant_description import KEYS as PLANT_KEYS
from denoc_ros.model.plant_description import PlantDescription, read_plant
from denoc_ros.simulation.motion import Prescribed, Torque
from denoc_ros.simulation.run import Run
from denoc_ros.simulation.scenario_inputs import ScenarioInputs
from denoc_ros.simulation.scenario_reader import ScenarioReader
from denoc_ros.simulation.simulate import METHODS, simulate
from denoc_ros.simulation.swaying_base import SHIFTS, TURNS, Harmonic, SwayingBase
from denoc_ros.simulation.time_functions import TimeFunction, of_joint
from denoc_ros.trajectories import Trajectory
from denoc_ros.types import Array

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


@dataclass(frozen=True)
class ModelSettings:
    """Settings of the model in a scenario.

    Attributes
    ----------
    gravity : tuple of float
        (3,) base frame [m/s^2].
    geometric_stiffness : bool
        Whether beams foreshorten.
    overrides : mapping
        Dotted path -> number, or several.
    plant : PlantDescription
        How its beams are described, where not as in the file.
    """

    gravity: tuple[float, float, float]
    geometric_stiffness: bool
    overrides: Mapping[str, float | list[float]]
    plant: PlantDescription

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
    base : SwayingBase or None
        The motion of the base; None: at rest, or floating.
    """

    q0: Array
    qd0: Array
    times: Array
    torque: Torque | None = None
    prescribed: Prescribed = field(default_factory=dict)
    reference: Trajectory | None = None
    rtol: float = 1e-8
    method: str = 'DOP853'
    base: SwayingBase | None = None

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
        reader.find(f'gravity must be three numbers [m/s^2], got {values["gravity"]!r}')
    stiffness = values.get('geometric_stiffness', True)
    if not isinstance(stiffness, bool):
        reader.find(f'geometric_stiffness must be true or false, got {stiffness!r}')
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
        reader.find(f'method must be one of {", ".join(METHODS)}, got {method!r}')
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
            reader.find(
                f'base {name} must have numbers amplitude, period > 0 s and, if not 0, phase, '
                f'got {given!r}'
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
        reader.find(
            f'start amplitudes must be zero, static or numbers by name, got {amplitudes!r}'
        )
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
