"""The numbers of a robot: one catalogue of dotted paths, values, units and ways to change them.

`beam.<link>.<y|z>.<ei|damping_ratio|damping>`, `beam.<link>.torsion.<gj|damping_ratio|damping>`,
`flexible.<link>.<stiffness|damping_ratio|damping>` (stiffness: a factor on the file's),
`joint.<name>.<damping|friction|armature>`, of an elastic joint
`joint.<name>.<stiffness|spring_damping|stiffness3|backlash>`,
`sensor.<name>.<gain|offset|noise>` and `payload.<link>.<mass|com|inertia>`;
`damping.<joint>` is another name for `joint.<joint>.damping`, `damping.<link>.<y|z|torsion>` for
`beam.<link>.<y|z|torsion>.damping_ratio`. All of them change without the description being read
again; what changes the coordinates, such as `beam.<link>.segments`, is no number.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any, NamedTuple, TypeVar

import numpy as np

from denoc_ros.errors import ConfigError
from denoc_ros.model.beams.segments import (
    critical_damping,
    damping_ratios,
    deformations,
    inertia_of,
    locate,
)
from denoc_ros.model.coordinates import PARTS as FLOATING
from denoc_ros.model.coordinates import diagonals
from denoc_ros.model.inertia import possible
from denoc_ros.model.payloads import (
    NO_PAYLOAD,
    PAYLOAD_SIZES,
    carrying_links,
    six_numbers,
    symmetric,
    with_payloads,
)
from denoc_ros.model.reading.findings import LARGEST, SMALLEST, Findings
from denoc_ros.model.sensors import deviation_fields, sensor_row
from denoc_ros.model.tree import INERTIAL_UNITS, Body, Joint, Sensor, Tree
from denoc_ros.types import Array

Given = TypeVar('Given')
Value = float | list[float]
Values = dict[str, Value]

FAMILIES = ('beam', 'flexible', 'joint', 'payload', 'sensor', 'damping')
DAMPING = ('damping_ratio', 'damping')  # one of a part: the other then does not hold
RIGIDITIES = ('ei', 'gj')
FLEXIBLE_FIELDS = ('stiffness', *DAMPING)
JOINT_FIELDS = ('damping', 'friction', 'armature')
# of an elastic joint, and the attributes of <spring> they are
SPRING_FIELDS = {
    'stiffness': 'stiffness',
    'spring_damping': 'damping',
    'stiffness3': 'stiffness3',
    'backlash': 'backlash',
}
SENSOR_FIELDS = ('gain', 'offset', 'noise')
PAYLOAD_UNITS = {'mass': 'kg', 'com': 'm', 'inertia': 'kg m^2'}
SHOWN = 12  # paths in a message
WHERE = 'overrides'
HELD = 'numbers'  # name of a tree's catalogue among its cached properties


@dataclass(frozen=True)
class Place:
    """Where an element of a robot stands: a tuple of the tree, an index in it, fields below."""

    among: str  # bodies | sensors | inertial_sensors
    index: int
    fields: tuple[str, ...] = ()

    def element(self, tree: Tree) -> Any:
        """Return the element."""
        found = getattr(tree, self.among)[self.index]
        for field in self.fields:
            found = getattr(found, field)
        return found

    def put(self, tree: Tree, element: Any) -> Tree:
        """Return the robot with another element here."""
        elements = list(getattr(tree, self.among))
        elements[self.index] = _with(elements[self.index], self.fields, element)
        among: dict[str, Any] = {self.among: tuple(elements)}
        return replace(tree, **among)


def _with(holder: Any, fields: tuple[str, ...], element: Any) -> Any:
    if not fields:
        return element
    inner = _with(getattr(holder, fields[0]), fields[1:], element)
    return replace(holder, **{fields[0]: inner})


class Number(NamedTuple):
    """A number of a robot, or several of one kind such as the damping of each mode of a beam."""

    path: str
    unit: str
    place: Place  # of the element that has it as an attribute
    attribute: str
    # the term of the dynamics that is linear in it: one of `coordinates.TERMS`, or `inertia`; ''
    # for none
    term: str = ''
    coordinates: tuple[int, ...] = ()  # those that it acts along
    # whether it must be > 0; whether it may be < 0
    positive: bool = False
    signed: bool = False
    counts: tuple[int, ...] = (1,)  # how many numbers may be given
    segments: int = 1  # of a beam's, how many bodies have it, one after another

    def get(self, tree: Tree) -> Value:
        """Return the value that a robot has."""
        return float(getattr(self.place.element(tree), self.attribute))

    def set(self, tree: Tree, values: Array) -> Tree:
        """Return the robot with other values (k,), one of `counts`."""
        changed = {self.attribute: values.item()}
        return self.place.put(tree, replace(self.place.element(tree), **changed))

    def per_unit(self, tree: Tree) -> Array | float:
        """Return the change of the term, along its coordinates, by one unit."""
        del tree
        return 1.0

    def allows(self, tree: Tree, values: Array) -> bool:
        """Say whether the checks of a description are sure to accept values (k,)."""
        least = SMALLEST if self.positive else -LARGEST if self.signed else 0.0
        if len(values) not in self.counts or not np.all((values >= least) & (values <= LARGEST)):
            return False
        if self.attribute == 'armature':  # readers warn of a spring without a rotor
            joint = self.place.element(tree)
            return joint.spring is None or (values[0] > 0.0) == (joint.armature > 0.0)
        return self.attribute != 'gain' or values[0] != 0.0


class ElasticNumber(Number):
    """Stiffness, damping ratios or damping of component modes, or of a beam's deformation."""

    def get(self, tree: Tree) -> Value:
        """Return the stiffness, or the damping of each mode."""
        modes = self.place.element(tree)
        found = getattr(modes, self.attribute)
        if self.positive:
            return float(found)
        if found is None:
            return damping_ratios(modes.damping, _critical(tree, self.place, modes))[
                : self.counts[-1]
            ]
        return list((found * np.ones(self.counts[-1])).tolist())

    def set(self, tree: Tree, values: Array) -> Tree:
        """Return the robot with other modes; a damping ratio that was given stays."""
        for place in self._places:
            modes = place.element(tree)
            ratio = values if self.attribute == 'damping_ratio' else modes.damping_ratio
            if self.positive:
                modes = modes.with_stiffness(values.item())
            if self.attribute == 'damping':
                damping, ratio = values * np.ones(modes.damping.shape), None
            else:
                given = ratio is not None
                damping = ratio * _critical(tree, place, modes) if given else modes.damping
            tree = place.put(tree, replace(modes, damping=damping, damping_ratio=ratio))
        return _with_rigidities(tree, self._places) if self.positive else tree

    def per_unit(self, tree: Tree) -> Array:
        """Return the modes' stiffness by the number, their critical damping, or ones."""
        if self.attribute == 'damping':
            return np.ones(len(self.coordinates))
        if self.positive:
            return np.concatenate([place.element(tree).unit_stiffness for place in self._places])
        return np.concatenate([_critical(tree, p, p.element(tree)) for p in self._places])

    @property
    def _places(self) -> list[Place]:
        first = self.place.index
        return [replace(self.place, index=first + k) for k in range(self.segments)]


def _critical(tree: Tree, place: Place, modes: Any) -> Array:
    """Return the critical damping (modes,) of component modes, or of a beam's deformation."""
    body: Body = tree.bodies[place.index]
    if body.beam is None:
        return np.asarray(modes.critical_damping)
    return critical_damping(modes, *inertia_of(body.beam, place.fields[-1]), body.beam.segments)


def _with_rigidities(tree: Tree, places: Sequence[Place]) -> Tree:
    """Return a robot whose sensors of loads and sections of beams fit the places' EI and GJ."""
    for place in places:
        beam = tree.bodies[place.index].beam
        if beam is not None and beam.has_section:
            # as in a description whose section has become numbers
            depth = max(beam.surface) * (2.0**0.5 if beam.corners else 1.0)
            depth = depth if np.isfinite(beam.strain_limit) else 0.0
            beam = replace(beam, surface=(depth, depth), corners=False, has_section=False)
            tree = replace(place, fields=('beam',)).put(tree, beam)
    return replace(tree, sensors=tuple(_of_beams(sensor, tree) for sensor in tree.sensors))


def _of_beams(sensor: Sensor, tree: Tree) -> Sensor:
    """Return a sensor whose row fits the beams as they are."""
    beam = tree.bodies[sensor.body].beam
    if sensor.quantity not in ('moment', 'shear') or beam is None:
        return sensor
    _, station = locate(beam.whole_length, beam.segments, sensor.station)
    return replace(sensor, row=sensor_row(sensor, beam, station))


class PayloadNumber(Number):
    """Mass, centre of mass or inertia of a link's payload."""

    @property
    def link(self) -> str:
        """The link that carries the payload."""
        return self.path.removeprefix('payload.').removesuffix(f'.{self.attribute}')

    def get(self, tree: Tree) -> Value:
        """Return the payload's, 0 without one; of an inertia ixx ixy ixz iyy iyz izz."""
        value = getattr(tree.payloads.get(self.link, NO_PAYLOAD), self.attribute)
        if self.attribute == 'mass':
            return float(value)
        return list((six_numbers(value) if self.attribute == 'inertia' else value).tolist())

    def set(self, tree: Tree, values: Array) -> Tree:
        """Return the robot with another payload."""
        value: Any = values
        if self.attribute == 'mass':
            value = values.item()
        elif self.attribute == 'inertia':
            value = symmetric(values)
        payload = replace(tree.payloads.get(self.link, NO_PAYLOAD), **{self.attribute: value})
        return with_payloads(replace(tree, payloads={**tree.payloads, self.link: payload}))

    def allows(self, tree: Tree, values: Array) -> bool:
        """Say whether the checks of a description are sure to accept values (k,)."""
        if not super().allows(tree, values):
            return False
        return self.attribute != 'inertia' or possible(symmetric(values))


# the catalogue ----------------------------------------------------------------------------------


def numbers_of(tree: Tree) -> dict[str, Number]:
    """Return the numbers of a robot by their paths; the tree keeps them."""
    held: dict[str, Number] | None = tree.__dict__.get(HELD)
    if held is None:
        held = tree.__dict__[HELD] = {number.path: number for number in _all_numbers(tree)}
    return held


def _all_numbers(tree: Tree) -> list[Number]:
    found: list[Number] = []
    first = 0
    for index, body in enumerate(tree.bodies):
        first += len(FLOATING) if body.floating else 0
        if body.joint is not None:
            found += _of_joint(index, body.joint, first)
            first += 1 + (body.joint.spring is not None)
        found += _of_elastic(index, body, first)
        first += body.amplitudes
    for k, sensor in enumerate(tree.sensors):
        place, path = Place('sensors', k), f'sensor.{sensor.name}'
        found += [
            Number(f'{path}.{field}', '', place, field, signed=field != 'noise')
            for field in SENSOR_FIELDS
        ]
    for k, inertial in enumerate(tree.inertial_sensors):
        place, path = Place('inertial_sensors', k), f'sensor.{inertial.name}'
        for field in deviation_fields(inertial.type):
            unit = INERTIAL_UNITS[field.partition('_')[0]]
            found.append(Number(f'{path}.{field}', unit, place, field))
    for link in carrying_links(tree):
        place = Place('bodies', tree.frames[link].body)
        for field, counts in PAYLOAD_SIZES.items():
            unit, signed = PAYLOAD_UNITS[field], field != 'mass'
            path = f'payload.{link}.{field}'
            found.append(
                PayloadNumber(path, unit, place, field, 'inertia', signed=signed, counts=counts)
            )
    return found


def _of_joint(index: int, joint: Joint, first: int) -> Iterator[Number]:
    path, place, units = (
        f'joint.{joint.name}',
        Place('bodies', index, ('joint',)),
        joint.kind.units,
    )
    for field in JOINT_FIELDS:
        yield Number(f'{path}.{field}', units[field], place, field, field, (first,))
    if joint.spring is None:
        return
    place = Place('bodies', index, ('joint', 'spring'))
    for field, attribute in SPRING_FIELDS.items():
        stiff = attribute == 'stiffness'
        linear = attribute == 'damping' or (stiff and not joint.spring.backlash)
        term = attribute if linear else ''
        number = Number(f'{path}.{field}', units[field], place, attribute, term, (first + 1,))
        yield number._replace(positive=stiff)


def _of_elastic(index: int, body: Body, first: int) -> Iterator[Number]:
    if body.modes is not None:
        own: Sequence[int] = range(first, first + body.modes.count)
        place, path = Place('bodies', index, ('modes',)), f'flexible.{body.name}'
        yield from _of_modes(path, place, ('stiffness', 'factor', '', 'N s/m'), own, 1)
    if body.beam is None or body.segment > 1:  # all have the numbers of the first
        return
    size, segments = sum(body.beam.modes), body.beam.segments
    for name, part, _ in deformations(body.beam):
        own = [
            first + k + size * segment for segment in range(segments) for k in range(part.modes)
        ]
        first += part.modes
        place, path = Place('bodies', index, ('beam', name)), f'beam.{body.name}.{name}'
        rigidity, damping = ('gj', 'N m s/rad') if name == 'torsion' else ('ei', 'N s/m')
        names = rigidity, 'stiffness', 'N m^2', damping
        yield from _of_modes(path, place, names, own, segments)


def _of_modes(
    path: str, place: Place, names: tuple[str, str, str, str], own: Sequence[int], segments: int
) -> Iterator[Number]:
    """Yield stiffness, damping and damping ratio; names: field, attribute and units."""
    field, attribute, unit, of_damping = names
    modes = (1, len(own) // segments)
    along: dict[str, Any] = {'coordinates': tuple(own), 'segments': segments}

    def number(last: str, unit: str, attribute: str, term: str, **rest: Any) -> ElasticNumber:
        return ElasticNumber(f'{path}.{last}', unit, place, attribute, term, **along, **rest)

    yield number(field, unit, attribute, 'stiffness', positive=True)
    yield number('damping', of_damping, 'damping', 'damping', counts=modes)
    counts = modes if segments == 1 else (1,)
    yield number('damping_ratio', '-', 'damping_ratio', 'damping', counts=counts)


def values_of(tree: Tree) -> Values:
    """Return the values of all numbers of a robot by their paths; no payload is 0."""
    return {path: number.get(tree) for path, number in numbers_of(tree).items()}


def with_numbers(tree: Tree, changes: Mapping[str, Any]) -> Tree | None:
    """Return a robot with other numbers, whose bodies, frames and coordinates are the same.

    Parameters
    ----------
    changes : mapping of str to number or sequence of numbers
        By dotted path, as :func:`denoc_ros.model.overrides.with_overrides` takes them.

    Returns
    -------
    Tree or None
        The robot that `with_overrides` returns. None where that has to be asked: for paths that
        are of no number, and values that it may refuse.

    Raises
    ------
    ConfigError
        For different values under two names of one number.
    """
    numbers = numbers_of(tree)
    plain = plain_paths(numbers, changes)
    given = merged_overrides(tree, plain)
    with np.errstate(over='ignore', invalid='ignore'):
        for path, value in plain.items():
            number, values = numbers.get(path), _floats(value)
            if number is None or values is None or not number.allows(tree, values):
                return None
            tree = number.set(tree, values)
        if not np.isfinite(diagonals(tree)).all():
            return None
    tree = replace(tree, overrides=given)
    if not any(path.endswith('.backlash') for path in plain):  # a spring with play is not linear
        tree.__dict__[HELD] = numbers
    return tree


def _floats(value: Any) -> Array | None:
    """Return numbers (k,); None for anything else."""
    parts = np.ravel(np.asarray(value, dtype=object)).tolist()
    if not all(type(part) in (int, float) for part in parts):
        return None
    return np.array(parts, dtype=np.float64)


# paths ------------------------------------------------------------------------------------------


def own_path(path: str, known: Collection[str]) -> str:
    """Return the path that `damping.*` is another name for; other paths as they are."""
    kind, _, rest = path.partition('.')
    named = (f'joint.{rest}.damping', f'beam.{rest}.damping_ratio') if kind == 'damping' else ()
    return next((other for other in named if other in known), path)


def other_names(known: Iterable[str]) -> dict[str, str]:
    """Return the paths `damping.*` and those that they are other names for."""
    ends = {'beam': '.damping_ratio', 'joint': '.damping'}
    return {
        f'damping.{path.partition(".")[2].removesuffix(end)}': path
        for kind, end in ends.items()
        for path in known
        if path.startswith(f'{kind}.') and path.endswith(end)
    }


def plain_paths(known: Collection[str], overrides: Mapping[str, Given]) -> dict[str, Given]:
    """Return overrides under their own paths, those that still hold.

    Of a beam's damping and damping_ratio the one given later holds.

    Raises
    ------
    ConfigError
        For different values under two names of one number.
    """
    plain: dict[str, Given] = {}
    findings = Findings()
    for path, value in overrides.items():
        name = own_path(path, known)
        other = plain.pop(name, value)
        if not np.array_equal(np.ravel(np.asarray(other)), np.ravel(np.asarray(value))):
            findings.add(f'path {path!r}', f'value must be that of {name!r}, got another')
        plain.pop(_instead_of(name), None)
        plain[name] = value
    ConfigError.raise_any(WHERE, findings.items)
    return plain


def merged_overrides(tree: Tree, plain: Mapping[str, Any]) -> dict[str, Any]:
    """Return the overrides of a tree with others, which hold where both are given."""
    gone = {*plain, *map(_instead_of, plain)}
    return {**{path: old for path, old in tree.overrides.items() if path not in gone}, **plain}


def _instead_of(path: str) -> str:
    """Return the path of the other of a beam's damping and damping_ratio, '' for other paths."""
    start, _, field = path.rpartition('.')
    if not path.startswith(('beam.', 'flexible.')) or field not in DAMPING:
        return ''
    (other,) = set(DAMPING) - {field}
    return f'{start}.{other}'


def match(known: Iterable[str], *patterns: str) -> list[str]:
    """Return the paths that are, or match, one of some patterns of `*` and `?`."""
    return [
        path for path in known if any(path == each or fnmatchcase(path, each) for each in patterns)
    ]


def some_of(known: Collection[str], pattern: str, others: Collection[str] = ()) -> str:
    """Return the known paths of a pattern's kind, else others, as a message lists them."""
    kind = pattern.partition('.')[0]
    alike = [path for path in known if path.startswith(f'{kind}.')] or list(others)
    return ', '.join(alike[:SHOWN]) + (', ...' if len(alike) > SHOWN else '')
