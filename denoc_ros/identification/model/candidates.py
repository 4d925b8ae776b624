"""Robots of the search's points, without building a model for each of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics.parameter_columns import DIAGONAL_TERMS, Column, find_columns
from denoc_ros.dynamics.robot import Robot
from denoc_ros.identification.model.free_numbers import payload_of
from denoc_ros.identification.model.free_parameters import (
    INERTIAL,
    FreeParameters,
    SearchPoint,
)
from denoc_ros.model.arrays import inertia_row
from denoc_ros.model.inertia import difference, from_centre
from denoc_ros.model.override_values import override_values
from denoc_ros.types import Array

RIGIDITIES = ('ei', 'gj')
OF_JOINTS = ('damping', 'friction', 'armature', 'stiffness')


class Candidates:
    """The robots that a search looks at.

    Numbers that act along one coordinate and inertias that are added change in a copy of the
    robot's arrays; any other number makes a new model. A robot with load cells is built anew
    where a rigidity is free: what they show has it as a factor.

    Parameters
    ----------
    parameters : FreeParameters
    """

    def __init__(self, parameters: FreeParameters) -> None:
        self._parameters, self._robot = parameters, parameters.robot
        self._values = override_values(self._robot.tree)
        self._columns: dict[str, Column] = {}
        self._by_link: dict[str, Array] = {}
        self._bodies = {body.name: k for k, body in enumerate(self._robot.tree.bodies)}
        self._has_load_cells = any(s.type == 'load_cell' for s in self._robot.tree.sensors)

    def at(self, point: SearchPoint) -> Robot:
        """Return the robot of a point; numbers of its sensors stay those of the start."""
        if not all(self._is_live(path) for path in point.overrides):
            return self._parameters.robot_at(point)
        robot = self._robot.copy()
        self._add_inertias(robot, point)
        diagonals = self._robot.diagonals()
        paths = [path for path in point.overrides if not path.startswith('payload.')]
        # a rigidity comes last: what a damping ratio gives goes with its root
        for path in sorted(paths, key=lambda path: not path.endswith('.damping_ratio')):
            self._move(diagonals, path, first_number(point.overrides[path]))
        robot.set_diagonals(diagonals)
        return robot

    def _is_live(self, path: str) -> bool:
        kind, _, rest = path.partition('.')
        field = rest.rpartition('.')[2]
        if kind == 'payload':
            return field in ('mass', 'com')
        if kind == 'joint':
            return field in OF_JOINTS
        if kind != 'beam' or (self._has_load_cells and field in RIGIDITIES):
            return False
        value = np.asarray(self._values[path])
        return field in RIGIDITIES or (field == 'damping_ratio' and float(np.ptp(value)) == 0.0)

    def _move(self, diagonals: Array, path: str, value: float) -> None:
        """Add the change of a number to its diagonal terms."""
        column = self._column(path)
        before = first_number(self._values[path])
        diagonals[DIAGONAL_TERMS.index(column.term)] += (value - before) * column.values
        if path.startswith('beam.') and path.rpartition('.')[2] in RIGIDITIES:
            # the description keeps a damping ratio, whose coefficient goes with the root
            damped = diagonals[DIAGONAL_TERMS.index('damping')]
            damped[column.values != 0.0] *= np.sqrt(value / before)

    def _column(self, path: str) -> Column:
        if path not in self._columns:
            self._columns[path] = find_columns(self._robot, [path])[0]
        return self._columns[path]

    def _add_inertias(self, robot: Robot, point: SearchPoint) -> None:
        loaded = {path.removeprefix('payload.').rpartition('.')[0] for path in point.overrides}
        for link in loaded:
            if any(f'payload.{link}.{part}' in point.overrides for part in ('mass', 'com')):
                robot.add_payload(link, self._load(link, point))
        for name, inertia in point.bodies.items():
            place = self._bodies[name]
            change = difference(inertia, self._robot.tree.bodies[place].inertia)
            robot.add_payload(name, inertia_row(change, self._robot.arrays.body_axes(place)))

    def _load(self, link: str, point: SearchPoint) -> Array:
        """Change of a link's payload from the robot's (10,), in the kernels' order."""
        if link not in self._by_link:
            columns = find_columns(self._robot, [f'link.{link}.{number}' for number in INERTIAL])
            self._by_link[link] = np.array([column.values for column in columns])
        own_mass, own_centre = payload_of(self._robot, link)
        mass = point.overrides.get(f'payload.{link}.mass', own_mass)
        centre = point.overrides.get(f'payload.{link}.com', own_centre)
        numbers = [
            _numbers(float(np.asarray(m)), np.asarray(c, dtype=np.float64))
            for m, c in ((mass, centre), (own_mass, own_centre))
        ]
        row: Array = (numbers[0] - numbers[1]) @ self._by_link[link]
        return row


def first_number(value: ArrayLike) -> float:
    """Return a number, or the first of several."""
    return float(np.ravel(value)[0])


def _numbers(mass: float, centre: Array) -> Array:
    """Return the ten numbers of a point mass about a link frame's origin (10,)."""
    point = from_centre(mass, centre, np.zeros((3, 3)))
    return np.concatenate([[point.mass], point.first_moment, point.inertia[np.triu_indices(3)]])
