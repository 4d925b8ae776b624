"""Tables of Denavit-Hartenberg parameters, masses and rigidities: read and validated.

The convention is T(i -> i+1) = Rz(theta_i) Tz(b_i) Tx(a_i) Rx(alpha_i); joint i turns about, or
slides along, Z_i. A rigid link is a slender uniform rod along Z_i (length b_i), then along X_i+1
(length a_i). A flexible link's X part is its beam, its Z part stays rigid. A prismatic joint's
variable b carries no mass. Planar systems move in X-Y, with Y up. A mechanism is several chains
on the base, and loops that join their links.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from denoc_ros.errors import ConfigError
from denoc_ros.model.beams.cross_sections import round_section
from denoc_ros.model.beams.shapes import SHAPES
from denoc_ros.model.reading.findings import Findings, finite
from denoc_ros.model.reading.flexibility import MOST_MODES
from denoc_ros.yaml_text import read_yaml_file

SYSTEM_KEYS = frozenset(
    ('planar', 'section', 'modes', 'shape', 'kinds', 'damping_ratio', 'limits', 'armature')
)
# What tables of systems say besides, about gravity and runs: no part of the robot.
OTHER_KEYS = frozenset(('g', 'torque', 'rate', 'trajectory', 'start_deg', 'book_says', 'note'))
DEFAULT_LIMITS = {
    'effort': 1000.0,
    'velocity': 10.0,
    'lower': -2.0 * math.pi,
    'upper': 2.0 * math.pi,
}


@dataclass(frozen=True)
class DHSystem:
    """A robot given by a table: one chain, or several and loops."""

    name: str
    planar: bool
    chains: tuple[DHChain, ...]
    loops: tuple[DHLoop, ...]
    tool: DHPoint | None
    modes: int  # per bending plane
    shape: str
    damping_ratio: tuple[float, ...]
    limits: Mapping[str, float]
    armature: tuple[float, ...] = ()  # kg m^2 or kg, of the joint before each link; (): none

    @property
    def links(self) -> tuple[DHLink, ...]:
        """The links of all chains, in the order of `kinds`."""
        return tuple(link for chain in self.chains for link in chain.links)


def load_system(
    path: str | os.PathLike[str], system: str | None = None, kinds: str | None = None
) -> DHSystem:
    """Return a system from a YAML table.

    Parameters
    ----------
    path : str or path
        A file with one system, or with several by name.
    system : str, optional
        Which one of several; its name is the robot's. Default: the file's only one.
    kinds : str, optional
        R (rigid) or F (flexible) for each link, instead of the table's own. Default: flexible
        where the table gives a rigidity.
    """
    where = os.fspath(path)
    content = read_yaml_file(Path(where))
    if not isinstance(content, dict):
        raise ConfigError(where, [f'the file must hold a mapping, got {type(content).__name__}'])
    if system is None:
        return read_system(where, Path(where).stem, content, kinds)
    if not isinstance(content.get(system), dict):
        known = ', '.join(str(key) for key in content)
        raise ConfigError(where, [f'system must be one of {known}, got {system!r}'])
    return read_system(where, system, content[system], kinds)


def read_system(
    where: str, name: str, table: Mapping[str, Any], kinds: str | None = None
) -> DHSystem:
    """Return a system from a mapping; parameters and errors as `load_system`."""
    findings = Findings()
    reader = TableReader(table, f'system {name!r}', findings)
    reader.only(SYSTEM_KEYS | MECHANISM_KEYS | CHAIN_KEYS | OTHER_KEYS | angle_keys(reader))
    planar = table.get('planar', False)
    if not isinstance(planar, bool):
        reader.fail('planar', 'be true or false', planar)
    chains = read_chains(reader, section_rigidity(reader))
    links = [link for chain in chains for link in chain.links]
    flexible = _kinds(reader, kinds if kinds is not None else table.get('kinds'), links)
    system = DHSystem(
        name,
        planar is True,
        _of_kinds(chains, flexible),
        read_loops(reader, chains),
        read_tool(reader, chains),
        _modes(reader, any(flexible)),
        _shape(reader),
        _damping_ratio(reader),
        _limits(reader),
        _armature(reader, len(links)),
    )
    ConfigError.raise_any(where, findings.items)
    return system


def _kinds(reader: TableReader, kinds: object, links: list[DHLink]) -> list[bool]:
    """Return which links are flexible."""
    if kinds is None:
        flexible = [link.ei is not None for link in links]
    elif isinstance(kinds, str) and re.fullmatch(f'[RF]{{{len(links)}}}', kinds):
        flexible = [kind == 'F' for kind in kinds]
    else:
        rule = f'be {len(links)} letters R (rigid) or F (flexible)'
        reader.fail('kinds', rule, kinds)
        return [False] * len(links)
    for index, (link, bends) in enumerate(zip(links, flexible, strict=True), 1):
        if bends and link.ei is None:
            reader.fail(f'link {index}', 'have a rigidity EI to be flexible', None)
        if bends and not link.can_bend:
            reader.fail(f'link {index}', 'have a > 0 m and m > 0 kg to be flexible', link.a)
    return flexible


def _of_kinds(chains: tuple[DHChain, ...], flexible: list[bool]) -> tuple[DHChain, ...]:
    kinds = iter(flexible)
    return tuple(
        DHChain(chain.base, tuple(link.of_kind(next(kinds, False)) for link in chain.links))
        for chain in chains
    )


def _modes(reader: TableReader, needed: bool) -> int:
    modes = reader.table.get('modes', None if needed else 0)
    if isinstance(modes, bool) or not isinstance(modes, int) or not 0 <= modes <= MOST_MODES:
        reader.fail('modes', f'be a whole number from 0 to {MOST_MODES}', modes)
        return 0
    return modes


def _shape(reader: TableReader) -> str:
    shape = reader.table.get('shape', 'clamped-free')
    if shape not in SHAPES:
        reader.fail('shape', f'be one of {", ".join(SHAPES)}', shape)
    return str(shape)


def _damping_ratio(reader: TableReader) -> tuple[float, ...]:
    value = reader.table.get('damping_ratio', 0.0)
    entries = value if isinstance(value, list) else [value]
    return tuple(reader.as_number('damping_ratio', entry, '-', least=0.0) for entry in entries)


def _armature(reader: TableReader, joints: int) -> tuple[float, ...]:
    """Return the rotor inertia that each joint's gear reflects."""
    if 'armature' not in reader.table:
        return ()
    entries = reader.list_of('armature', joints)
    return tuple(reader.as_number('armature', entry, 'kg m^2', least=0.0) for entry in entries)


def _limits(reader: TableReader) -> dict[str, float]:
    given = reader.table.get('limits', {})
    if not isinstance(given, dict):
        reader.fail('limits', 'be a mapping', given)
        return dict(DEFAULT_LIMITS)
    limits = TableReader(given, f'{reader.whose} limits', reader.findings)
    limits.only(frozenset(DEFAULT_LIMITS))
    found = {
        key: limits.number(
            key, 'SI', above=0.0 if key in ('effort', 'velocity') else None, default=default
        )
        for key, default in DEFAULT_LIMITS.items()
    }
    if found['lower'] > found['upper']:
        limits.fail('lower', f'be at most upper ({found["upper"]:g})', found['lower'])
    return found


class TableReader:
    """Reads the entries of a mapping; each violated condition becomes a finding."""

    def __init__(self, table: Mapping[str, Any], whose: str, findings: Findings) -> None:
        self.table = table
        self.whose = whose
        self.findings = findings

    def fail(self, key: str, rule: str, got: object) -> None:
        """Add a finding."""
        self.findings.add(self.whose, f'{key} must {rule}, got {got!r}')

    def only(self, keys: frozenset[str]) -> None:
        """Find keys that are not known."""
        for key in self.table:
            if key not in keys:
                self.fail('key', f'be one of {", ".join(sorted(keys))}', key)

    def number(
        self,
        key: str,
        unit: str,
        *,
        above: float | None = None,
        least: float | None = None,
        default: float | None = None,
    ) -> float:
        """Return an entry's number, NaN where it is none."""
        if key not in self.table and default is not None:
            return default
        return self.as_number(key, self.table.get(key), unit, above=above, least=least)

    def as_number(
        self,
        key: str,
        value: object,
        unit: str,
        *,
        above: float | None = None,
        least: float | None = None,
    ) -> float:
        """Return a value as a number, NaN where it is none."""
        number = as_finite(value)
        if (
            number is None
            or (above is not None and number <= above)
            or (least is not None and number < least)
        ):
            bound = '' if above is None else f' > {above:g}'
            bound = bound if least is None else f' >= {least:g}'
            self.fail(key, f'be a finite number{bound} {unit}', value)
            return math.nan
        return number

    def list_of(self, key: str, count: int | None, default: object = None) -> list[Any]:
        """Return a list of some length."""
        if key not in self.table and count is not None and default is not None:
            return [default] * count
        value = self.table.get(key)
        if not isinstance(value, list) or not value or (count is not None and len(value) != count):
            self.fail(key, f'be a list of {count or "one or more"} entries', value)
            return [default] * (count or 0)
        return value

    def tables(self, key: str, whose: str) -> list[TableReader]:
        """Return a list's mappings, named `whose` and their number in findings."""
        found = []
        for index, entry in enumerate(self.list_of(key, None), 1):
            if isinstance(entry, dict):
                found.append(TableReader(entry, f'{self.whose} {whose} {index}', self.findings))
            else:
                self.fail(f'{whose} {index}', 'be a mapping', entry)
        return found

    def point(self, key: str, least: int) -> tuple[float, ...]:
        """Return the coordinates of a point [m]: `least` of them (the rest is zero) or three."""
        value = self.table.get(key)
        if not isinstance(value, list) or len(value) not in (least, 3):
            rule = '3 numbers' if least == 3 else f'{least} or 3 numbers'
            self.fail(key, f'be {rule} [m]', value)
            return (0.0,) * 3
        given = [self.as_number(key, entry, 'm') for entry in value]
        return (*given, *[0.0] * (3 - len(given)))

    def name(self) -> str:
        """Return a text that may be left out, then empty."""
        value = self.table.get('name', '')
        if not isinstance(value, str) or ('name' in self.table and not value.strip()):
            self.fail('name', 'be a text', value)
            return ''
        return value


def as_finite(value: object) -> float | None:
    """Return a number, also one that YAML 1.1 takes for text, such as 1.0e5."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    return finite(str(value))


CHAIN_KEYS = frozenset(('links', 'dh', 'joints', 'm', 'flexible_m', 'hub_izz', 'EI'))
ROD_KEYS = frozenset(('name', 'a', 'm', 'mass_per_length', 'EI', 'E', 'I', 'hub_inertia'))
PLATE_KEYS = frozenset(('name', 'm', 'com', 'inertia'))


@dataclass(frozen=True)
class DHLink:
    """One link with the joint before it: a rod, or a rigid plate where `plate` is given."""

    a: float  # m
    b: float  # m, 0 for a prismatic joint
    alpha: float  # rad
    theta: float  # rad, constant angle of a prismatic joint
    prismatic: bool
    mass: float  # kg
    hub_inertia: float  # kg m^2, about Z; a plate's about its centre of mass
    ei: float | None  # N m^2, None for a rigid link
    flexible_mass: float | None = None  # kg, of the link where it is flexible; None: mass
    name: str = ''
    plate: tuple[float, ...] | None = None  # (3,) m, centre of mass

    @property
    def rod_length(self) -> float:
        """Length that carries the mass [m]."""
        return abs(self.a) + abs(self.b)

    @property
    def can_bend(self) -> bool:
        """Whether it has a beam to be flexible."""
        return self.plate is None and self.a > 0.0 and self.mass > 0.0

    def of_kind(self, flexible: bool) -> DHLink:
        """Return the link made flexible (with the mass it then has) or rigid."""
        if not flexible:
            return replace(self, ei=None)
        return self if self.flexible_mass is None else replace(self, mass=self.flexible_mass)


def read_links(reader: TableReader, shared: float | None) -> list[DHLink]:
    """Return the links of a chain.

    Parameters
    ----------
    reader : TableReader
        `links` of a planar chain, or `dh` with its columns beside it.
    shared : float or None
        EI of links that give none [N m^2].
    """
    if 'links' in reader.table:
        return _planar_links(reader, shared)
    links = _spatial_links(reader, shared)
    if 'EI' in reader.table:
        return links
    return [link if link.can_bend else replace(link, ei=None) for link in links]


def section_rigidity(system: TableReader) -> float | None:
    """Return EI of a section that all links share, None without one."""
    if 'section' not in system.table:
        return None
    if not isinstance(system.table['section'], dict):
        system.fail('section', 'be a mapping', system.table['section'])
        return None
    section = TableReader(system.table['section'], f'{system.whose} section', system.findings)
    section.only(frozenset(('round_diameter', 'E')))
    diameter = section.number('round_diameter', 'm', above=0.0)
    return section.number('E', 'Pa', above=0.0) * round_section(diameter).moment_y


def _planar_links(reader: TableReader, shared: float | None) -> list[DHLink]:
    return [
        _plate(link) if 'com' in link.table else _rod(link, shared)
        for link in reader.tables('links', 'link')
    ]


def _plate(link: TableReader) -> DHLink:
    link.only(PLATE_KEYS)
    centre = link.point('com', 2)
    mass = link.number('m', 'kg', above=0.0)
    inertia = link.number('inertia', 'kg m^2', above=0.0)
    name = link.name()
    return DHLink(0.0, 0.0, 0.0, 0.0, False, mass, inertia, None, name=name, plate=centre)


def _rod(link: TableReader, shared: float | None) -> DHLink:
    link.only(ROD_KEYS)
    entry = link.table
    a = link.number('a', 'm', above=0.0)
    if ('m' in entry) == ('mass_per_length' in entry):
        link.fail('m or mass_per_length', 'be given, one of them', sorted(entry))
    mass = link.number('m', 'kg', least=0.0, default=math.nan)
    if 'mass_per_length' in entry:
        mass = a * link.number('mass_per_length', 'kg/m', least=0.0)
    hub = link.number('hub_inertia', 'kg m^2', least=0.0, default=0.0)
    ei = _rigidity(link, shared)
    return DHLink(a, 0.0, 0.0, 0.0, False, mass, hub, ei, name=link.name())


def _rigidity(link: TableReader, shared: float | None) -> float | None:
    if 'EI' in link.table:
        return link.number('EI', 'N m^2', above=0.0)
    if 'E' in link.table or 'I' in link.table:
        return link.number('E', 'Pa', above=0.0) * link.number('I', 'm^4', above=0.0)
    return shared


def _spatial_links(reader: TableReader, shared: float | None) -> list[DHLink]:
    table = reader.table.get('dh')
    if not isinstance(table, dict):
        reader.fail('dh (or links)', 'be a mapping of a, b and alpha_over_pi', table)
        return []
    dh = TableReader(table, f'{reader.whose} dh', reader.findings)
    dh.only(frozenset(('a', 'b', 'alpha_over_pi')))
    count = len(dh.list_of('a', None))
    joints = reader.table.get('joints', 'R' * count)
    if not isinstance(joints, str) or not re.fullmatch(f'[RP]{{{count}}}', joints):
        reader.fail('joints', f'be {count} letters R (revolute) or P (prismatic)', joints)
        joints = 'R' * count
    masses = reader.list_of('m', count)
    lighter = reader.list_of('flexible_m', count) if 'flexible_m' in reader.table else masses
    columns = (
        dh.list_of('a', count, 0.0),
        dh.list_of('b', count, 0.0),
        dh.list_of('alpha_over_pi', count, 0.0),
        masses,
        lighter,
        reader.list_of('hub_izz', count, 0.0),
        reader.list_of('EI', count) if 'EI' in reader.table else [shared] * count,
    )
    return [
        _spatial_link(reader, dh, index, joints[index - 1] == 'P', row)
        for index, row in enumerate(zip(*columns, strict=True), 1)
    ]


def _spatial_link(
    reader: TableReader, dh: TableReader, index: int, prismatic: bool, row: tuple[Any, ...]
) -> DHLink:
    a, b, alpha, mass, lighter, hub, ei = row
    theta = 0.0
    if prismatic:
        if as_finite(b) is not None:
            dh.fail(f'b[{index}]', 'be the name of a variable (the joint is prismatic)', b)
        theta = math.pi * reader.number(f'theta{index}_over_pi', '-', default=0.0)
        b = 0.0
    rigidity = None
    if ei is not None:
        rigidity = reader.as_number(f'EI[{index}]', ei, 'N m^2', above=0.0)
    flexible_mass = None
    if lighter is not mass:
        flexible_mass = reader.as_number(f'flexible_m[{index}]', lighter, 'kg', least=0.0)
    return DHLink(
        dh.as_number(f'a[{index}]', a, 'm'),
        dh.as_number(f'b[{index}]', b, 'm'),
        math.pi * dh.as_number(f'alpha_over_pi[{index}]', alpha, '-'),
        theta,
        prismatic,
        reader.as_number(f'm[{index}]', mass, 'kg', least=0.0),
        reader.as_number(f'hub_izz[{index}]', hub, 'kg m^2', least=0.0),
        rigidity,
        flexible_mass,
    )


MECHANISM_KEYS = frozenset(('chains', 'loops', 'tool'))
# A loop joins two links by a joint about Z, by a ball or rigidly.
LOOP_TYPES = ('revolute', 'spherical', 'fixed')


@dataclass(frozen=True)
class DHChain:
    """Links one behind the other; the first joint stands at `base`."""

    base: tuple[float, ...]  # (3,) m
    links: tuple[DHLink, ...]


@dataclass(frozen=True)
class DHPoint:
    """A point of a link, axes as the link's; `at` None: the end, with the next joint's axes."""

    link: str
    at: tuple[float, ...] | None = None  # (3,) m, in the link's frame


@dataclass(frozen=True)
class DHLoop:
    """A joint between two points, about Z where it has an axis."""

    name: str
    type: str
    parent: DHPoint
    child: DHPoint


def read_chains(reader: TableReader, shared: float | None) -> tuple[DHChain, ...]:
    """Return the chains of a system, their links named; a serial robot is one chain at the base.

    Parameters
    ----------
    shared : float or None
        EI of links that give none [N m^2].
    """
    if 'chains' not in reader.table:
        return _named(reader, [((0.0, 0.0, 0.0), read_links(reader, shared))])
    for key in sorted(CHAIN_KEYS & set(reader.table)):
        reader.fail(key, 'be given in the chains, if there are some', reader.table[key])
    chains = []
    for chain in reader.tables('chains', 'chain'):
        chain.only(CHAIN_KEYS | angle_keys(chain) | {'base'})
        base = chain.point('base', 2 if reader.table.get('planar') else 3)
        chains.append((base, read_links(chain, shared)))
    return _named(reader, chains)


def angle_keys(reader: TableReader) -> frozenset[str]:
    """Return the keys of prismatic joints' constant angles."""
    pattern = r'theta[1-9]\d?_over_pi'
    return frozenset(str(key) for key in reader.table if re.fullmatch(pattern, str(key)))


def read_loops(reader: TableReader, chains: Collection[DHChain]) -> tuple[DHLoop, ...]:
    """Return the loops of a system."""
    if 'loops' not in reader.table:
        return ()
    loops = []
    for index, loop in enumerate(reader.tables('loops', 'loop'), 1):
        loop.only(frozenset(('name', 'type', 'parent', 'child')))
        type_ = loop.table.get('type')
        if type_ not in LOOP_TYPES:
            loop.fail('type', f'be one of {", ".join(LOOP_TYPES)}', type_)
        ends = [read_point(loop, key, chains) for key in ('parent', 'child')]
        loops.append(DHLoop(loop.name() or f'loop_{index}', str(type_), *ends))
    return tuple(loops)


def read_tool(reader: TableReader, chains: tuple[DHChain, ...]) -> DHPoint | None:
    """Return the position of the tool: by default at the end of a serial robot."""
    if 'tool' in reader.table:
        return read_point(reader, 'tool', chains)
    if len(chains) == 1 and chains[0].links:
        return DHPoint(chains[0].links[-1].name)
    return None


def read_point(reader: TableReader, key: str, chains: Collection[DHChain]) -> DHPoint:
    """Return a point: a link's name for its end, or a mapping of `link` and `at`."""
    value = reader.table.get(key)
    links = {link.name: link for chain in chains for link in chain.links}
    if isinstance(value, str) and value in links and links[value].plate is None:
        return DHPoint(value)
    if isinstance(value, dict) and value.get('link') in {*links, 'base'}:
        point = TableReader(value, f'{reader.whose} {key}', reader.findings)
        point.only(frozenset(('link', 'at')))
        return DHPoint(value['link'], point.point('at', 2))
    known = ', '.join(links)
    reader.fail(key, f'be a rod (its end) or {{link, at}}, of {known} and base', value)
    return DHPoint('base', (0.0, 0.0, 0.0))


def _named(
    reader: TableReader, chains: list[tuple[tuple[float, ...], list[DHLink]]]
) -> tuple[DHChain, ...]:
    """Return the chains with links named link_1, link_2, ... where the table gives no names."""
    named, taken = [], {'base', 'tool'}
    count = 0
    for base, links in chains:
        own = []
        for link in links:
            count += 1
            name = link.name or f'link_{count}'
            if name in taken:
                reader.fail('name', 'be unique', name)
            taken.add(name)
            own.append(replace(link, name=name))
        named.append(DHChain(base, tuple(own)))
    return tuple(named)
