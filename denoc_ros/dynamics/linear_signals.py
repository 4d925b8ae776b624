"""Inputs and outputs of linear models, by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from denoc_ros.dynamics.sensor_values import SensorValues
from denoc_ros.errors import StateError
from denoc_ros.types import Array

WRENCH = ('fx', 'fy', 'fz', 'mx', 'my', 'mz')
POSE = ('x', 'y', 'z', 'rx', 'ry', 'rz')
VELOCITY = ('vx', 'vy', 'vz', 'wx', 'wy', 'wz')
ACCELERATION = ('ax', 'ay', 'az', 'alx', 'aly', 'alz')
DEFLECTION = ('ux', 'uy', 'uz')
GROUPS = ('joints', 'rates', 'states', 'sensors')
KINDS = ('pose', 'velocity', 'acceleration', 'deflection')


@dataclass(frozen=True)
class Outputs:
    """Names, and derivatives (outputs, n) by q, q' and q''."""

    names: tuple[str, ...]
    by_q: Array
    by_qd: Array
    by_qdd: Array


def read_inputs(
    robot: SensorValues, q: Array, inputs: Sequence[str] | None
) -> tuple[tuple[str, ...], Array]:
    """Return names and the generalized forces (n, inputs) per unit of each input.

    Raises
    ------
    StateError
        For a name that the robot does not have.
    """
    if inputs is None:
        inputs = robot.tree.non_mimic_joints
    names: list[str] = []
    columns = [np.zeros((robot.n, 0))]
    for given in inputs:
        kind, _, frame = given.partition(':')
        if kind == 'wrench':
            names += [f'{given}/{part}' for part in WRENCH]
            columns.append(robot.frame_jacobian(frame, q).T)
        elif given in robot.coordinate_names:
            names.append(given)
            columns.append(np.eye(robot.n)[:, [robot.coordinate_names.index(given)]])
        else:
            known = ', '.join(robot.coordinate_names)
            raise StateError(f'input must be wrench:<frame> or one of {known}, got {given!r}')
    return tuple(names), np.hstack(columns)


def read_outputs(
    robot: SensorValues, state: tuple[Array, Array, Array], outputs: Sequence[str]
) -> Outputs:
    """Return the outputs of a linear model about a state q, q', q''.

    Raises
    ------
    StateError
        For a name that the robot does not have.
    """
    parts = [_read(robot, state, given) for given in outputs]
    empty = np.zeros((0, robot.n))
    return Outputs(
        tuple(name for part in parts for name in part.names),
        np.concatenate([empty, *(part.by_q for part in parts)]),
        np.concatenate([empty, *(part.by_qd for part in parts)]),
        np.concatenate([empty, *(part.by_qdd for part in parts)]),
    )


def _read(robot: SensorValues, state: tuple[Array, Array, Array], given: str) -> Outputs:
    kind, colon, name = given.partition(':')
    if colon and kind in KINDS:
        return _measured(robot, state, kind, name, given)
    zero = np.zeros((robot.n, robot.n))
    unit = np.eye(robot.n)
    coordinates = robot.coordinate_names
    rates = tuple(f'{coordinate}_rate' for coordinate in coordinates)
    joints = robot.joint_indices
    if given == 'joints':
        return Outputs(robot.joint_names, unit[joints], zero[joints], zero[joints])
    if given == 'rates':
        return Outputs(tuple(rates[k] for k in joints), zero[joints], unit[joints], zero[joints])
    if given == 'states':
        two, none = np.concatenate([unit, zero]), np.concatenate([zero, unit])
        return Outputs((*coordinates, *rates), two, none, np.zeros_like(two))
    if given in coordinates:
        k = [coordinates.index(given)]
        return Outputs((given,), unit[k], zero[k], zero[k])
    if given in rates:
        k = [rates.index(given)]
        return Outputs((given,), zero[k], unit[k], zero[k])
    return _sensors(robot, state, given)


def _sensors(robot: SensorValues, state: tuple[Array, Array, Array], given: str) -> Outputs:
    names = robot.sensor_names
    rows = robot.sensor_derivatives(*state, by_shapes=True)
    if given == 'sensors':
        return Outputs(names, *rows)
    if given in names:
        k = [names.index(given)]
        return Outputs((given,), *(row[k] for row in rows))
    groups = ', '.join((*GROUPS, *(f'{kind}:<name>' for kind in KINDS)))
    known = ', '.join((*robot.coordinate_names, *names))
    raise StateError(f'output must be {groups} or one of {known}, got {given!r}')


def _measured(
    robot: SensorValues, state: tuple[Array, Array, Array], kind: str, name: str, given: str
) -> Outputs:
    """Outputs of frames and beams."""
    q, qd, qdd = state
    if kind == 'deflection':
        by_q = robot.tip_deflection_jacobian(name, q)
        zero = np.zeros_like(by_q)
        return Outputs(tuple(f'{given}/{part}' for part in DEFLECTION), by_q, zero, zero)
    if kind == 'pose':
        by_q = robot.frame_jacobian(name, q)
        zero = np.zeros_like(by_q)
        return Outputs(tuple(f'{given}/{part}' for part in POSE), by_q, zero, zero)
    if kind == 'velocity':
        by_q, by_qd = robot.frame_velocity_derivatives(name, q, qd)
        parts = tuple(f'{given}/{part}' for part in VELOCITY)
        return Outputs(parts, by_q, by_qd, np.zeros_like(by_q))
    parts = tuple(f'{given}/{part}' for part in ACCELERATION)
    return Outputs(parts, *robot.frame_acceleration_derivatives(name, q, qd, qdd))
