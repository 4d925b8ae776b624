"""Numbers of a robot in which its forces are linear: columns of the regressor, live changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.base.base_motion import Base
from denoc_ros.dynamics.robot_model import Held, RobotModel
from denoc_ros.dynamics.tree_dynamics import TreeDynamics
from denoc_ros.errors import ConfigError
from denoc_ros.kernels.layout import layout
from denoc_ros.model.arrays import inertia_row, is_flexible, rigid_inertia
from denoc_ros.model.beams.segments import PARTS, whole_beams
from denoc_ros.model.inertia import from_centre, moved
from denoc_ros.model.joint_friction import slip
from denoc_ros.model.numbers import (
    JOINT_FIELDS,
    RIGIDITIES,
    SPRING_FIELDS,
    ElasticNumber,
    Number,
    numbers_of,
    own_path,
    some_of,
)
from denoc_ros.model.payloads import carrying_links
from denoc_ros.model.tree import Beam, RigidInertia
from denoc_ros.types import Array

Int = NDArray[np.int64]

WHERE = 'torque regressor'
# in the order of the rows of a model's diagonals
DIAGONAL_TERMS = ('stiffness', 'damping', 'friction', 'armature')
NO_CONSTANTS: Int = np.zeros(0, dtype=np.int64)
NOT_LINEAR = 'be a number in which torque is linear'
KINDS = ('beam', 'flexible', 'joint', 'payload', 'link', 'damping')
INERTIAL = (
    'mass', 'first_moment.x', 'first_moment.y', 'first_moment.z',
    'inertia.ixx', 'inertia.ixy', 'inertia.ixz', 'inertia.iyy', 'inertia.iyz', 'inertia.izz',
)  # fmt: skip
OF_PAYLOADS = [field for field in INERTIAL if not field.startswith('first_moment')]
# of the numbers that change live, the last parts of their paths
LIVE_FIELDS = {
    'beam': (*RIGIDITIES, 'damping_ratio'),
    'joint': (*JOINT_FIELDS, 'stiffness'),
    'payload': ('mass',),
}


@dataclass(frozen=True)
class Column:
    """Change of the dynamics by one unit of a parameter.

    To a term along the coordinates: values (n,). To the inertia: values of the constants, which
    are indices of `constants`, all other masses being zero.
    """

    term: str  # one of DIAGONAL_TERMS, else 'inertia'
    values: Array
    constants: Int


class _Unfit(Exception):  # noqa: N818
    """A path without a column: the rule, and the reason."""


def find_columns(robot: RobotModel, paths: Sequence[str]) -> list[Column]:
    """Return the columns of dotted paths, in their order.

    Raises
    ------
    ConfigError
        With every path that gives none.
    """
    numbers, columns, findings = modelled_numbers(robot), [], []
    for path in paths:
        try:
            columns.append(_column(robot, numbers, own_path(path, numbers)))
        except _Unfit as unfit:
            findings.append(f'path {path!r}: must {unfit}')
    ConfigError.raise_any(WHERE, findings)
    return columns


def modelled_numbers(robot: RobotModel) -> dict[str, Number]:
    """Return the numbers of the part of a robot that is modelled, by path."""
    return numbers_of(robot._modelled(robot.tree))


def beam_constants(row: Int) -> slice:
    """Return the offset of a body's beam in `constants`, by its row of `topology`."""
    ny, nz, nt = (int(row[k]) for k in (layout.NY, layout.NZ, layout.NT))
    size = 1 + nt + nt * nt + int(row[layout.POINTS]) * (2 + ny + nz + ny * ny + nz * nz)
    start = int(row[layout.BEAM])
    return slice(start, start + size)


def _known(exist: Sequence[str]) -> _Unfit:
    listed = ', '.join(exist) if exist else 'none of this kind'
    return _Unfit(f'be one that the robot has ({listed}), got another')


def _column(robot: RobotModel, numbers: dict[str, Number], path: str) -> Column:
    kind, _, rest = path.partition('.')
    number = numbers.get(path)
    if number is not None and number.term in DIAGONAL_TERMS:
        return _diagonal(robot, number)
    if kind == 'beam':
        return _beam(robot, numbers, rest)
    if kind in ('link', 'payload'):
        return _inertial(robot, kind, rest)
    if kind == 'joint' and number is not None:
        field = rest.rpartition('.')[2]
        raise _Unfit(f'{NOT_LINEAR}, got {field} of a spring with backlash or stiffness3')
    if kind == 'joint':
        known = []
        for joint in robot.joint_names:
            springs = SPRING_FIELDS if robot.tree.joints[joint].spring is not None else ()
            known.append(f'joint.{joint}.<{"|".join((*JOINT_FIELDS, *springs))}>')
        raise _known(known)
    if kind == 'flexible':
        flexible = [body.name for body in robot.tree.bodies if body.modes is not None]
        raise _known([f'flexible.{each}.<stiffness|damping|damping_ratio>' for each in flexible])
    kinds = ', '.join(f'{name}.' for name in KINDS)
    raise _Unfit(f'start with one of {kinds}, got {path!r}')


def _diagonal(robot: RobotModel, number: Number) -> Column:
    column = np.zeros(robot.n)
    column[list(number.coordinates)] = number.per_unit(robot.tree)
    return Column(number.term, column, NO_CONSTANTS)


def _beam(robot: RobotModel, numbers: dict[str, Number], rest: str) -> Column:
    """Return the column of `<link>.mass_per_length`, a polar inertia, or of a single mode."""
    start, _, last = rest.rpartition('.')
    for whole in whole_beams(robot.tree):
        bodies = list(enumerate(whole.beams, whole.first))
        if rest == f'{whole.link}.mass_per_length':
            return _together([_mass_per_length(robot, i, beam) for i, beam in bodies])
        if rest == f'{whole.link}.torsion.polar_inertia' and whole.segment.torsion is not None:
            return _together([_polar_inertia(robot, i, beam) for i, beam in bodies])
        parts = [name for name in PARTS if getattr(whole.segment, name) is not None]
        if rest in [f'{whole.link}.{name}.modes' for name in parts]:
            raise _Unfit(f'{NOT_LINEAR}, got the number of modes')
    number = numbers.get(f'beam.{start}')
    if not isinstance(number, ElasticNumber) or number.term != 'damping':
        raise _known(_beam_paths(robot))
    if number.attribute == 'damping_ratio' and number.segments > 1:
        raise _Unfit("end with damping_ratio, one for a link of segments, got a mode's")
    modes = len(number.coordinates) // number.segments
    if not last.isdecimal() or not 1 <= int(last) <= modes:
        raise _Unfit(f'end with a mode from 1 to {modes}, got {last!r}')
    own = number.coordinates[int(last) - 1 :: modes]
    values = _diagonal(robot, number).values
    return Column('damping', np.where(np.isin(np.arange(robot.n), own), values, 0.0), NO_CONSTANTS)


def _together(columns: Sequence[Column]) -> Column:
    """Return the column of an inertia that a link's segments have in common."""
    values, constants = zip(*((each.values, each.constants) for each in columns), strict=True)
    return Column('inertia', np.concatenate(values), np.concatenate(constants))


def _beam_paths(robot: RobotModel) -> list[str]:
    known = []
    for whole in whole_beams(robot.tree):
        for name in PARTS:
            if getattr(whole.segment, name) is not None:
                own = 'gj|polar_inertia' if name == 'torsion' else 'ei'
                known.append(f'beam.{whole.link}.{name}.<{own}|damping|damping_ratio>')
        known.append(f'beam.{whole.link}.mass_per_length')
    return known


def _mass_per_length(robot: RobotModel, i: int, beam: Beam) -> Column:
    """Return the column of a beam's own mass: its points are in proportion to its root."""
    row = robot.arrays.topology[robot.arrays.body_rows[i]].astype(int)
    where = beam_constants(row)
    nt = int(row[layout.NT])
    values = robot.arrays.constants[where] / np.sqrt(beam.mass_per_length)
    values[: 1 + nt + nt * nt] = 0.0
    return Column('inertia', values, np.arange(where.start, where.stop))


def _polar_inertia(robot: RobotModel, i: int, beam: Beam) -> Column:
    """Return the column of a beam's inertia about its axis, which the rest of the link loses."""
    row = robot.arrays.topology[robot.arrays.body_rows[i]].astype(int)
    nt, start = int(row[layout.NT]), int(row[layout.BEAM])
    polar = np.arange(start, start + 1 + nt + nt * nt)
    if robot.tree.bodies[i].segment > 1:
        return Column('inertia', robot.arrays.constants[polar] / beam.polar_inertia, polar)
    rest = RigidInertia(inertia=np.diag([-beam.whole_length, 0.0, 0.0]))
    body = inertia_row(rest, robot.arrays.body_axes(i))
    at = int(row[layout.BODY_CONSTANTS]) + layout.MASS
    values = np.concatenate([robot.arrays.constants[polar] / beam.polar_inertia, body])
    return Column('inertia', values, np.concatenate([polar, np.arange(at, at + 10)]))


def _inertial(robot: RobotModel, kind: str, rest: str) -> Column:
    """Return the column of a rigid body's number, of a payload about its centre of mass."""
    fields = INERTIAL if kind == 'link' else OF_PAYLOADS
    links = sorted(carrying_links(robot.tree), key=len, reverse=True)
    link = next((each for each in links if rest.startswith(f'{each}.')), None)
    if link is None:
        raise _known([f'{kind}.{each}.<{"|".join(fields)}>' for each in sorted(links)])
    field = rest[len(link) + 1 :]
    if field == 'com':
        why = ' (inertia has its square)' if kind == 'payload' else ''
        way = f'take link.{link}.first_moment.<x|y|z>'
        raise _Unfit(f'{NOT_LINEAR}, got a centre of mass{why}: {way}')
    if field not in fields:
        raise _known([f'{kind}.{link}.<{"|".join(fields)}>'])
    inertia = rigid_inertia(np.eye(10)[INERTIAL.index(field)], np.eye(3))
    if kind == 'payload' and field == 'mass':
        inertia = from_centre(1.0, _centre(robot, link), np.zeros((3, 3)))
    at = robot.tree.frames[link]
    row = robot.arrays.topology[robot.arrays.body_rows[at.body]].astype(int)
    first = int(row[layout.BODY_CONSTANTS]) + layout.MASS
    values = inertia_row(moved(inertia, at.placement), robot.arrays.body_axes(at.body))
    return Column('inertia', values, np.arange(first, first + 10))


def _centre(robot: RobotModel, link: str) -> Array:
    """Return the centre of mass of a link's payload in the link's frame, 0 without one."""
    held = robot.payload_centre(link)
    if held is not None:
        return held
    modelled = robot.tree.payloads.get(link)
    return np.zeros(3) if modelled is None else modelled.com


# live changes -----------------------------------------------------------------------------------


def live_paths(robot: RobotModel) -> list[str]:
    """Return the dotted paths of the numbers that can change live.

    `payload.<link>.mass`, and of beams and joints what acts along one coordinate: rigidities,
    stiffness, damping, friction and armature.
    """
    return [
        path
        for path, number in modelled_numbers(robot).items()
        if path.rpartition('.')[2] in LIVE_FIELDS.get(path.partition('.')[0], ())
        # damping may differ from mode to mode
        and float(np.ptp(number.get(robot.tree))) == 0.0
    ]


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

    def __init__(self, robot: TreeDynamics, paths: Sequence[str]) -> None:
        known = live_paths(robot)
        self.paths = tuple(own_path(path, known) for path in paths)
        findings = [
            f'path {path!r}: must be one of {some_of(known, path, known)}; got another'
            for path in self.paths
            if path not in known
        ]
        ConfigError.raise_any('live numbers', findings)
        self._columns = find_columns(robot, self.paths)
        numbers = modelled_numbers(robot)
        self.values: Array = np.array([_value(robot, numbers[path]) for path in self.paths])
        self._loads = [
            _massive(robot, column) if column.term == 'inertia' else None
            for column in self._columns
        ]

    def move_base(self, base: Base | None) -> None:
        """Set the motion of the base that the columns are for."""
        for load in self._loads:
            if load is not None:
                load.move_base(base)

    def columns(self, q: Array, qd: Array, qdd: Array, out: Array) -> None:
        """Write the derivatives of the generalized forces by the numbers (n, p) at a state."""
        for place, (column, load) in enumerate(zip(self._columns, self._loads, strict=True)):
            if load is not None:
                out[:, place] = load.inverse_dynamics(q, qd, qdd)
                continue
            factor = {'stiffness': q, 'damping': qd, 'armature': qdd}.get(column.term)
            factor = slip(qd) if factor is None else factor
            np.multiply(factor, column.values, out=out[:, place])

    def set(self, robot: RobotModel, change: Array) -> None:
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


def _value(robot: RobotModel, number: Number) -> float:
    if number.term == 'inertia':
        return robot.payload_mass(number.path.removeprefix('payload.').removesuffix('.mass'))
    return float(np.ravel(number.get(robot.tree))[0])


def _massive(robot: Held, column: Column) -> Held:
    """Return the robot with one unit of a mass and nothing else."""
    bare = massless(robot)
    bare.constants[column.constants] = column.values
    return bare


def massless(robot: Held) -> Held:
    """Return the robot with neither mass nor elasticity, damping, friction and armature.

    Its inverse dynamics are those of the masses that are then put in.
    """
    bare = robot.copy()
    arrays = robot.arrays
    bare._adopt(arrays.with_diagonals(np.zeros_like(arrays.diagonals)).without_link_side())
    rows = arrays.topology[list(arrays.body_rows)].astype(int)
    for row, body in zip(rows, robot.tree.bodies, strict=True):
        mass = row[layout.BODY_CONSTANTS] + layout.MASS
        bare.constants[mass : mass + 10] = 0.0
        if is_flexible(body):
            bare.constants[beam_constants(row)] = 0.0
    bare.move_base(robot.base_motion)
    return bare
