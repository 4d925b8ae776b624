"""Numbers of a robot that change while it is used: its payloads' masses and diagonal terms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from denoc_ros.dynamics.base_motion import Base
from denoc_ros.dynamics.measured_side import MeasuredRobot
from denoc_ros.dynamics.parameter_columns import DIAGONAL_TERMS, Column, find_columns
from denoc_ros.dynamics.regressor import massless
from denoc_ros.errors import ConfigError
from denoc_ros.model.link_side import is_measured_behind
from denoc_ros.model.override_values import override_values
from denoc_ros.model.overrides import damping_names
from denoc_ros.types import Array

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot

WHERE = 'live numbers'
OF_BEAMS = ('ei', 'gj', 'damping_ratio')
OF_JOINTS = ('damping', 'friction', 'armature', 'stiffness')


def live_paths(robot: Robot) -> list[str]:
    """Return the dotted paths of the numbers that can change live.

    `payload.<link>.mass`, and of beams and joints what acts along one coordinate: rigidities,
    stiffness, damping, friction and armature.
    """
    behind: set[str] = set()
    if isinstance(robot, MeasuredRobot):
        joints = [body.joint for body in robot.tree.bodies if body.joint]
        behind = {f'joint.{each.name}.stiffness' for each in joints if is_measured_behind(each)}
    values = override_values(robot.tree)
    return [path for path in values if path not in behind and _is_live(path, values[path])]


def _is_live(path: str, value: float | list[float]) -> bool:
    kind, field = path.partition('.')[0], path.rpartition('.')[2]
    if kind == 'payload':
        return field == 'mass'
    one = float(np.ptp(np.asarray(value))) == 0.0  # damping may differ from mode to mode
    return one and field in {'beam': OF_BEAMS, 'joint': OF_JOINTS}.get(kind, ())


class LiveNumbers:
    """Some numbers of a robot: their values, their columns of the regressor, their change.

    Parameters
    ----------
    robot : Robot
        Where the numbers stand now.
    paths : sequence of str
        Of `live_paths`; each once.

    Attributes
    ----------
    paths : tuple of str
    values : (p,) array
        As the robot has them at first.

    Raises
    ------
    ConfigError
        With every path that is not one of a number that can change live.

    Notes
    -----
    Damping is held where a rigidity changes, though the description may give it by a ratio.
    """

    def __init__(self, robot: Robot, paths: Sequence[str]) -> None:
        names, known = damping_names(robot.tree), set(live_paths(robot))
        self.paths = tuple(names.get(path, path) for path in paths)
        wrong = [path for path in self.paths if path not in known]
        if wrong:
            raise ConfigError(WHERE, [_finding(path, sorted(known)) for path in wrong])
        self._columns = find_columns(robot, self.paths)
        self.values: Array = np.array([_value(robot, path) for path in self.paths])
        self._loads = [
            _massive(robot, column) if column.term == 'inertia' else None
            for column in self._columns
        ]

    def move_base(self, base: Base | None) -> None:
        """Set the motion of the base that the columns are for."""
        for load in self._loads:
            if load is not None:
                load.move_base(base)

    def columns(self, q: Array, qd: Array, qdd: Array, slip_rate: float, out: Array) -> None:
        """Write the derivatives of the generalized forces by the numbers (n, p) at a state."""
        for place, (column, load) in enumerate(zip(self._columns, self._loads, strict=True)):
            if load is not None:
                out[:, place] = load.inverse_dynamics(q, qd, qdd)
                continue
            factor = {'stiffness': q, 'damping': qd, 'armature': qdd}.get(column.term)
            factor = np.tanh(qd / slip_rate) if factor is None else factor
            np.multiply(factor, column.values, out=out[:, place])

    def set(self, robot: Robot, change: Array) -> None:
        """Add a change (p,) of the numbers to a robot, live: no model is built.

        The robot is one whose numbers were the same as those of this object's at first, or that
        earlier changes were added to.
        """
        diagonals: Array | None = None
        for path, column, by in zip(self.paths, self._columns, change.tolist(), strict=True):
            if by == 0.0:
                continue
            if column.term == 'inertia':
                link = path.removeprefix('payload.').removesuffix('.mass')
                robot.add_payload(link, by * column.values)
                continue
            if diagonals is None:
                diagonals = robot.diagonals()
            diagonals[DIAGONAL_TERMS.index(column.term)] += by * column.values
        if diagonals is not None:
            robot.set_diagonals(diagonals)


def _value(robot: Robot, path: str) -> float:
    known = robot.tree.overrides.get(path, override_values(robot.tree)[path])
    value = float(np.ravel(np.asarray(known))[0])
    if path.startswith('payload.'):
        value += robot.payload_mass(path.removeprefix('payload.').removesuffix('.mass'))
    return value


def _massive(robot: Robot, column: Column) -> Robot:
    """Return the robot with one unit of a mass and nothing else."""
    bare = massless(robot)
    bare.constants[column.constants] = column.values
    return bare


def _finding(path: str, known: Sequence[str]) -> str:
    kind = path.partition('.')[0]
    alike = [other for other in known if other.startswith(f'{kind}.')] or list(known)
    return f'path {path!r}: must be one of {", ".join(alike)}; got another'
