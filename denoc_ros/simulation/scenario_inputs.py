"""Inputs of a scenario: torques, a reference or prescribed joints."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.model.mapping_reader import is_number
from denoc_ros.simulation.motion import Torque
from denoc_ros.simulation.path import Circle, follow
from denoc_ros.simulation.scenario_reader import ScenarioReader
from denoc_ros.simulation.time_functions import (
    SampledTorque,
    SpinUp,
    TimeFunction,
    of_joint,
    rigid_loop_torque,
    rigid_robot,
    rigid_torque,
    step_torque,
)
from denoc_ros.trajectories import Trajectory

TORQUE_KINDS = ('zero', 'step', 'rigid_inverse_dynamics')
TABLE_KINDS = ('hold', 'linear')
CIRCLE_NEEDS = ('radius', 'duration')
CIRCLE_KEYS = ('kind', 'frame', 'centre', 'start', 'turns', 'guess', *CIRCLE_NEEDS)


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
            reader.find(f"torque's kind must be one of {', '.join(TORQUE_KINDS)}, got {kind!r}")
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
            reader.find(
                f"torque's actuated must be some of {', '.join(self._joints)} where there are "
                f'loops, got {actuated!r}'
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
            reader.find(f"circle's frame must be one of the robot's, got {values.get('frame')!r}")
        centre = values.get('centre')
        if not (isinstance(centre, list) and len(centre) == 3 and all(map(is_number, centre))):
            reader.find(f"circle's centre must be three numbers [m], got {centre!r}")
        numbers: dict[str, Any] = {
            'start': 0.0,
            'turns': 1.0,
            **{key: values.get(key) for key in CIRCLE_NEEDS},
        }
        numbers |= {key: values[key] for key in ('start', 'turns') if key in values}
        for key, value in numbers.items():
            if not is_number(value) or (key in CIRCLE_NEEDS and value <= 0.0):
                reader.find(
                    f"circle's {key} must be a number (radius, duration > 0), got {value!r}"
                )
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
            self._reader.find(
                f"torque's between must be one of {', '.join(TABLE_KINDS)}, got {between!r}"
            )
        if every is None:
            if 'between' in values:
                self._reader.find("torque's between must come with every, got no every")
            return torque
        if not (is_number(every) and every > 0.0):
            self._reader.find(f"torque's every must be a number > 0 s, got {every!r}")
            return torque
        return SampledTorque(torque, float(every), str(between))

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
