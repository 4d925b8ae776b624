"""Which of a model's numbers a dotted path changes, and by how much per unit of its value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.robot_model import RobotModel
from denoc_ros.errors import ConfigError
from denoc_ros.kernels import layout
from denoc_ros.model.arrays import inertia_row
from denoc_ros.model.inertia import from_centre, moved
from denoc_ros.model.override_elements import SPRING_FIELDS, joint_fields
from denoc_ros.model.override_values import critical_damping
from denoc_ros.model.overrides import carrying_links, damping_names
from denoc_ros.model.segments import whole_beams
from denoc_ros.model.tree import Beam, Deformation, RigidInertia
from denoc_ros.types import Array

Int = NDArray[np.int64]

WHERE = 'torque regressor'
# in the order of the rows of a model's diagonals
DIAGONAL_TERMS = ('stiffness', 'damping', 'friction', 'armature')
MOMENTS = {
    'ixx': (0, 0),
    'ixy': (0, 1),
    'ixz': (0, 2),
    'iyy': (1, 1),
    'iyz': (1, 2),
    'izz': (2, 2),
}
OF_SPRINGS = {'stiffness': 'stiffness', 'spring_damping': 'damping'}
AXES = ('x', 'y', 'z')
PARTS = ('y', 'z', 'torsion')
NOT_LINEAR = 'be a number in which torque is linear'


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
    names, columns, findings = damping_names(robot.tree), [], []
    finders = {
        'beam': _beam,
        'flexible': _flexible,
        'joint': _joint,
        'payload': _payload,
        'link': _link,
    }
    for path in paths:
        kind, _, rest = names.get(path, path).partition('.')
        try:
            if kind not in finders:
                starts = ', '.join(f'{name}.' for name in (*finders, 'damping'))
                raise _Unfit(f'start with one of {starts}, got {path!r}')
            columns.append(finders[kind](robot, rest))
        except _Unfit as unfit:
            findings.append(f'path {path!r}: must {unfit}')
    ConfigError.raise_any(WHERE, findings)
    return columns


def beam_constants(row: Int) -> slice:
    """Return the offset of a body's beam in `constants`, by its row of `topology`."""
    ny, nz, nt = (int(row[k]) for k in (layout.NY, layout.NZ, layout.NT))
    size = 1 + nt + nt * nt + int(row[layout.POINTS]) * (2 + ny + nz + ny * ny + nz * nz)
    start = int(row[layout.BEAM])
    return slice(start, start + size)


def _known(exist: Sequence[str]) -> _Unfit:
    listed = ', '.join(exist) if exist else 'none of this kind'
    return _Unfit(f'be one that the robot has ({listed}), got another')


def _diagonal(robot: RobotModel, term: str, index: int | slice, values: Array | float) -> Column:
    column = np.zeros(robot.n)
    column[index] = values
    return Column(term, column, np.zeros(0, dtype=np.int64))


# joints -----------------------------------------------------------------------------------------


def _joint(robot: RobotModel, rest: str) -> Column:
    name, _, field = rest.rpartition('.')
    described = {body.joint.name: body.joint for body in robot.tree.bodies if body.joint}
    joint = described.get(name)
    spring = None if joint is None else joint.spring
    if name not in robot.joint_names or field not in joint_fields(spring):
        known = [(joint, joint_fields(described[joint].spring)) for joint in robot.joint_names]
        raise _known([f'joint.{joint}.<{"|".join(fields)}>' for joint, fields in known])
    index = int(robot.joint_indices[robot.joint_names.index(name)])
    if spring is not None and field in SPRING_FIELDS:
        if field not in OF_SPRINGS or (field == 'stiffness' and spring.backlash > 0.0):
            raise _Unfit(f'{NOT_LINEAR}, got {field} of a spring with backlash or stiffness3')
        return _diagonal(robot, OF_SPRINGS[field], index + 1, 1.0)
    return _diagonal(robot, field, index, 1.0)


# beams ------------------------------------------------------------------------------------------


def _beam(robot: RobotModel, rest: str) -> Column:
    """Return the column of `<link>.<y|z|torsion>.<field>[.<mode>]` or `<link>.mass_per_length`."""
    for whole in whole_beams(robot.tree):
        if not rest.startswith(f'{whole.link}.'):
            continue
        parts = rest[len(whole.link) + 1 :].split('.')
        bodies = list(enumerate(whole.beams, whole.first))
        if parts == ['mass_per_length']:
            return _together([_mass_per_length(robot, i, beam) for i, beam in bodies])
        bent = parts[0] in PARTS and getattr(whole.segment, parts[0]) is not None
        if bent and len(parts) > 1:
            return _together([_deformation(robot, i, beam, parts) for i, beam in bodies])
    raise _known(_beam_paths(robot))


def _flexible(robot: RobotModel, rest: str) -> Column:
    """Return the column of `<link>.<stiffness|damping|damping_ratio>` of component modes."""
    link, _, field = rest.rpartition('.')
    for index, body in enumerate(robot.tree.bodies):
        if body.name != link or (modes := body.modes) is None:
            continue
        row = robot.arrays.topology[robot.arrays.body_rows[index]].astype(int)
        first = int(row[layout.COORDINATE] + row[layout.JOINT])
        own = slice(first, first + modes.count)
        if field == 'stiffness':
            return _diagonal(robot, 'stiffness', own, modes.link.stiffness)
        if field == 'damping':
            return _diagonal(robot, 'damping', own, 1.0)
        if field == 'damping_ratio':
            return _diagonal(robot, 'damping', own, modes.critical_damping)
    flexible = [body.name for body in robot.tree.bodies if body.modes is not None]
    raise _known([f'flexible.{each}.<stiffness|damping|damping_ratio>' for each in flexible])


def _together(columns: Sequence[Column]) -> Column:
    """Return the column of a number that a link's segments have in common."""
    if columns[0].term != 'inertia':
        return replace(columns[0], values=np.sum([each.values for each in columns], axis=0))
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


def _deformation(robot: RobotModel, i: int, beam: Beam, parts: Sequence[str]) -> Column:
    name, field = parts[0], parts[1]
    part: Deformation = getattr(beam, name)
    if field == 'modes':
        raise _Unfit(f'{NOT_LINEAR}, got the number of modes')
    if name == 'torsion' and field == 'polar_inertia' and len(parts) == 2:
        return _polar_inertia(robot, i, beam)
    row = robot.arrays.topology[robot.arrays.body_rows[i]].astype(int)
    before = sum(beam.modes[: PARTS.index(name)])
    first = int(row[layout.COORDINATE] + row[layout.JOINT]) + before
    per_unit = part.modal_stiffness / part.stiffness
    if field == ('gj' if name == 'torsion' else 'ei') and len(parts) == 2:
        return _diagonal(robot, 'stiffness', slice(first, first + part.modes), per_unit)
    if field not in ('damping', 'damping_ratio') or len(parts) > 3:
        raise _known(_beam_paths(robot))
    per_unit = np.ones(part.modes)
    if field == 'damping_ratio':
        per_unit = next(each for found, _, each in critical_damping(beam) if found == name)
        if beam.segments > 1 and len(parts) == 3:
            raise _Unfit("end with damping_ratio, one for a link of segments, got a mode's")
    if len(parts) == 3:
        per_unit = per_unit * _mode(parts[2], part.modes)
    return _diagonal(robot, 'damping', slice(first, first + part.modes), per_unit)


def _mode(text: str, modes: int) -> Array:
    """Return the flags (modes,) of one mode, given as in the names of coordinates."""
    if not text.isdecimal() or not 1 <= int(text) <= modes:
        raise _Unfit(f'end with a mode from 1 to {modes}, got {text!r}')
    return np.asarray(np.arange(1, modes + 1) == int(text), dtype=np.float64)


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


# rigid bodies -----------------------------------------------------------------------------------


def _rigid(robot: RobotModel, link: str, inertia: RigidInertia) -> Column:
    """Return the column of an inertia about a link frame's origin."""
    attachment = robot.tree.frames[link]
    seen = moved(inertia, attachment.placement)
    row = robot.arrays.topology[robot.arrays.body_rows[attachment.body]].astype(int)
    at = int(row[layout.BODY_CONSTANTS]) + layout.MASS
    values = inertia_row(seen, robot.arrays.body_axes(attachment.body))
    return Column('inertia', values, np.arange(at, at + 10))


def _moment(name: str) -> RigidInertia:
    """Return a unit of one of the six moments and products of inertia."""
    matrix = np.zeros((3, 3))
    r, c = MOMENTS[name]
    matrix[r, c] = matrix[c, r] = 1.0
    return RigidInertia(inertia=matrix)


def _split(
    robot: RobotModel, rest: str, kind: str, fields: Sequence[str]
) -> tuple[str, list[str]]:
    """Return the link and the field's parts of a path."""
    links = carrying_links(robot.tree)
    for link in sorted(links, key=len, reverse=True):
        if rest.startswith(f'{link}.'):
            return link, rest[len(link) + 1 :].split('.')
    raise _known([f'{kind}.{link}.<{"|".join(fields)}>' for link in sorted(links)])


def _payload(robot: RobotModel, rest: str) -> Column:
    fields = ('mass', *(f'inertia.{name}' for name in MOMENTS))
    link, parts = _split(robot, rest, 'payload', fields)
    if parts == ['com']:
        raise _Unfit(
            f'{NOT_LINEAR}, got a centre of mass (inertia has its square): take '
            f'link.{link}.first_moment.<x|y|z>'
        )
    if parts == ['mass']:
        return _rigid(robot, link, from_centre(1.0, _centre(robot, link), np.zeros((3, 3))))
    if len(parts) == 2 and parts[0] == 'inertia' and parts[1] in MOMENTS:
        return _rigid(robot, link, _moment(parts[1]))
    raise _known([f'payload.{link}.<{"|".join(fields)}>'])


def _centre(robot: RobotModel, link: str) -> Array:
    """Return the centre of mass of a link's payload in the link's frame, 0 without one."""
    held = robot.payload_centre(link)
    if held is not None:
        return held
    given = robot.tree.overrides.get(f'payload.{link}.com')
    return np.zeros(3) if given is None else np.ravel(np.asarray(given, dtype=np.float64))


def _link(robot: RobotModel, rest: str) -> Column:
    moments = [f'first_moment.{axis}' for axis in AXES]
    fields = ('mass', *moments, *(f'inertia.{name}' for name in MOMENTS))
    link, parts = _split(robot, rest, 'link', fields)
    units = {'mass': RigidInertia(1.0)}
    units.update(
        (axis, RigidInertia(first_moment=unit))
        for axis, unit in zip(moments, np.eye(3), strict=True)
    )
    units.update((f'inertia.{name}', _moment(name)) for name in MOMENTS)
    field = '.'.join(parts)
    if field == 'com':
        raise _Unfit(f'{NOT_LINEAR}, got a centre of mass: take link.{link}.first_moment.<x|y|z>')
    if field not in units:
        raise _known([f'link.{link}.<{"|".join(fields)}>'])
    return _rigid(robot, link, units[field])
