"""Links of a table of Denavit-Hartenberg parameters, chain by chain."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import Any

from denoc_ros.model.beam_sections import round_section
from denoc_ros.model.dh.table import Table, as_finite

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


def read_links(reader: Table, shared: float | None) -> list[DHLink]:
    """Return the links of a chain.

    Parameters
    ----------
    reader : Table
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


def section_rigidity(system: Table) -> float | None:
    """Return EI of a section that all links share, None without one."""
    if 'section' not in system.table:
        return None
    if not isinstance(system.table['section'], dict):
        system.fail('section', 'be a mapping', system.table['section'])
        return None
    section = Table(system.table['section'], f'{system.whose} section', system.findings)
    section.only(frozenset(('round_diameter', 'E')))
    diameter = section.number('round_diameter', 'm', above=0.0)
    return section.number('E', 'Pa', above=0.0) * round_section(diameter).moment_y


def _planar_links(reader: Table, shared: float | None) -> list[DHLink]:
    return [
        _plate(link) if 'com' in link.table else _rod(link, shared)
        for link in reader.tables('links', 'link')
    ]


def _plate(link: Table) -> DHLink:
    link.only(PLATE_KEYS)
    centre = link.point('com', 2)
    mass = link.number('m', 'kg', above=0.0)
    inertia = link.number('inertia', 'kg m^2', above=0.0)
    name = link.name('name')
    return DHLink(0.0, 0.0, 0.0, 0.0, False, mass, inertia, None, name=name, plate=centre)


def _rod(link: Table, shared: float | None) -> DHLink:
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
    return DHLink(a, 0.0, 0.0, 0.0, False, mass, hub, ei, name=link.name('name'))


def _rigidity(link: Table, shared: float | None) -> float | None:
    if 'EI' in link.table:
        return link.number('EI', 'N m^2', above=0.0)
    if 'E' in link.table or 'I' in link.table:
        return link.number('E', 'Pa', above=0.0) * link.number('I', 'm^4', above=0.0)
    return shared


def _spatial_links(reader: Table, shared: float | None) -> list[DHLink]:
    table = reader.table.get('dh')
    if not isinstance(table, dict):
        reader.fail('dh (or links)', 'be a mapping of a, b and alpha_over_pi', table)
        return []
    dh = Table(table, f'{reader.whose} dh', reader.findings)
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
    reader: Table, dh: Table, index: int, prismatic: bool, row: tuple[Any, ...]
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
