"""Tables of Denavit-Hartenberg parameters, masses and rigidities: read and validated.

The convention is T(i -> i+1) = Rz(theta_i) Tz(b_i) Tx(a_i) Rx(alpha_i); joint i turns about, or
slides along, Z_i. A rigid link is a slender uniform rod along Z_i (length b_i), then along X_i+1
(length a_i). A flexible link's X part is its beam, its Z part stays rigid. A prismatic joint's
variable b carries no mass. Planar systems move in X-Y, with Y up.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from denoc_ros.errors import ConfigError
from denoc_ros.model.findings import Findings, finite
from denoc_ros.model.flexibility import MOST_MODES
from denoc_ros.model.sections import round_section
from denoc_ros.model.shapes import SHAPES

SYSTEM_KEYS = frozenset(
    ('planar', 'links', 'dh', 'joints', 'm', 'hub_izz', 'EI', 'section', 'modes')
    + ('shape', 'kinds', 'damping_ratio', 'limits')
)
# What tables of systems say besides, about gravity and runs: no part of the robot.
OTHER_KEYS = frozenset(('g', 'torque', 'rate', 'trajectory', 'start_deg', 'book_says', 'note'))
LINK_KEYS = frozenset(('a', 'm', 'mass_per_length', 'EI', 'E', 'I', 'hub_inertia'))
DEFAULT_LIMITS = {
    'effort': 1000.0,
    'velocity': 10.0,
    'lower': -2.0 * math.pi,
    'upper': 2.0 * math.pi,
}


@dataclass(frozen=True)
class DHLink:
    """One link with the joint before it."""

    a: float  # m
    b: float  # m, 0 for a prismatic joint
    alpha: float  # rad
    theta: float  # rad, constant angle of a prismatic joint
    prismatic: bool
    mass: float  # kg
    hub_inertia: float  # kg m^2, about Z
    ei: float | None  # N m^2, None for a rigid link

    @property
    def rod_length(self) -> float:
        """Length that carries the mass [m]."""
        return abs(self.a) + abs(self.b)


@dataclass(frozen=True)
class DHSystem:
    """A serial robot given by a table."""

    name: str
    planar: bool
    links: tuple[DHLink, ...]
    modes: int  # per bending plane
    shape: str
    damping_ratio: tuple[float, ...]
    limits: Mapping[str, float]


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

    Returns
    -------
    DHSystem
        Validated.

    Raises
    ------
    ConfigError
        With every finding of the table.
    """
    where = os.fspath(path)
    try:
        content = yaml.safe_load(Path(where).read_text(encoding='utf-8'))
    except OSError as error:
        raise ConfigError(where, [f'the file must be readable, got: {error.strerror}']) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        flat = ' '.join(str(error).split())
        raise ConfigError(where, [f'the file must be YAML, got: {flat}']) from error
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
    reader = _Table(table, f'system {name!r}', findings)
    angles = frozenset(key for key in table if re.fullmatch(r'theta[1-9]\d?_over_pi', str(key)))
    reader.only(SYSTEM_KEYS | OTHER_KEYS | angles)
    planar = table.get('planar', False)
    if not isinstance(planar, bool):
        reader.fail('planar', 'be true or false', planar)
    shared = _section_rigidity(reader)
    chain = _planar_links if 'links' in table else _spatial_links
    links = chain(reader, shared)
    flexible = _kinds(reader, kinds if kinds is not None else table.get('kinds'), links)
    system = DHSystem(
        name,
        planar is True,
        tuple(_of_kind(link, bends) for link, bends in zip(links, flexible, strict=False)),
        _modes(reader, any(flexible)),
        _shape(reader),
        _damping_ratio(reader),
        _limits(reader),
    )
    if findings.items:
        raise ConfigError(where, findings.items)
    return system


class _Table:
    """Reads the entries of a mapping; what does not hold becomes a finding."""

    def __init__(self, table: Mapping[str, Any], whose: str, findings: Findings) -> None:
        self.table = table
        self.whose = whose
        self.findings = findings

    def fail(self, key: str, rule: str, got: object) -> None:
        self.findings.add(self.whose, f'{key} must {rule}, got {got!r}')

    def only(self, keys: frozenset[str]) -> None:
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
        number = _finite(value)
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
        if key not in self.table and count is not None and default is not None:
            return [default] * count
        value = self.table.get(key)
        if not isinstance(value, list) or not value or (count is not None and len(value) != count):
            self.fail(key, f'be a list of {count or "one or more"} entries', value)
            return [default] * (count or 0)
        return value


def _finite(value: object) -> float | None:
    """Return a number, also one that YAML 1.1 takes for text, such as 1.0e5."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    return finite(str(value))


def _planar_links(reader: _Table, shared: float | None) -> list[DHLink]:
    links = []
    for index, entry in enumerate(reader.list_of('links', None), 1):
        if not isinstance(entry, dict):
            reader.fail(f'link {index}', 'be a mapping', entry)
            continue
        link = _Table(entry, f'{reader.whose} link {index}', reader.findings)
        link.only(LINK_KEYS)
        a = link.number('a', 'm', above=0.0)
        if ('m' in entry) == ('mass_per_length' in entry):
            link.fail('m or mass_per_length', 'be given, one of them', sorted(entry))
        mass = link.number('m', 'kg', least=0.0, default=math.nan)
        if 'mass_per_length' in entry:
            mass = a * link.number('mass_per_length', 'kg/m', least=0.0)
        hub = link.number('hub_inertia', 'kg m^2', least=0.0, default=0.0)
        ei = _link_rigidity(link, shared)
        links.append(DHLink(a, 0.0, 0.0, 0.0, False, mass, hub, ei))
    return links


def _link_rigidity(link: _Table, shared: float | None) -> float | None:
    if 'EI' in link.table:
        return link.number('EI', 'N m^2', above=0.0)
    if 'E' in link.table or 'I' in link.table:
        return link.number('E', 'Pa', above=0.0) * link.number('I', 'm^4', above=0.0)
    return shared


def _section_rigidity(system: _Table) -> float | None:
    """Return EI of a section that all links share, None without one."""
    if 'section' not in system.table:
        return None
    if not isinstance(system.table['section'], dict):
        system.fail('section', 'be a mapping', system.table['section'])
        return None
    section = _Table(system.table['section'], f'{system.whose} section', system.findings)
    section.only(frozenset(('round_diameter', 'E')))
    diameter = section.number('round_diameter', 'm', above=0.0)
    return section.number('E', 'Pa', above=0.0) * round_section(diameter).moment_y


def _spatial_links(reader: _Table, shared: float | None) -> list[DHLink]:
    table = reader.table.get('dh')
    if not isinstance(table, dict):
        reader.fail('dh (or links)', 'be a mapping of a, b and alpha_over_pi', table)
        return []
    dh = _Table(table, f'{reader.whose} dh', reader.findings)
    dh.only(frozenset(('a', 'b', 'alpha_over_pi')))
    count = len(dh.list_of('a', None))
    joints = reader.table.get('joints', 'R' * count)
    if not isinstance(joints, str) or not re.fullmatch(f'[RP]{{{count}}}', joints):
        reader.fail('joints', f'be {count} letters R (revolute) or P (prismatic)', joints)
        joints = 'R' * count
    columns = (
        dh.list_of('a', count, 0.0),
        dh.list_of('b', count, 0.0),
        dh.list_of('alpha_over_pi', count, 0.0),
        reader.list_of('m', count),
        reader.list_of('hub_izz', count, 0.0),
    )
    ei = reader.list_of('EI', count) if 'EI' in reader.table else [shared] * count
    return [
        _spatial_link(reader, dh, index, joints[index - 1] == 'P', row, ei[index - 1])
        for index, row in enumerate(zip(*columns, strict=True), 1)
    ]


def _spatial_link(
    reader: _Table, dh: _Table, index: int, prismatic: bool, row: tuple[Any, ...], ei: Any
) -> DHLink:
    a, b, alpha, mass, hub = row
    theta = 0.0
    if prismatic:
        if _finite(b) is not None:
            dh.fail(f'b[{index}]', 'be the name of a variable (the joint is prismatic)', b)
        theta = math.pi * reader.number(f'theta{index}_over_pi', '-', default=0.0)
        b = 0.0
    rigidity = None
    if ei is not None:
        rigidity = reader.as_number(f'EI[{index}]', ei, 'N m^2', above=0.0)
    return DHLink(
        dh.as_number(f'a[{index}]', a, 'm'),
        dh.as_number(f'b[{index}]', b, 'm'),
        math.pi * dh.as_number(f'alpha_over_pi[{index}]', alpha, '-'),
        theta,
        prismatic,
        reader.as_number(f'm[{index}]', mass, 'kg', least=0.0),
        reader.as_number(f'hub_izz[{index}]', hub, 'kg m^2', least=0.0),
        rigidity,
    )


def _kinds(reader: _Table, kinds: object, links: list[DHLink]) -> list[bool]:
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
        if bends and (link.a <= 0.0 or link.mass <= 0.0):
            reader.fail(f'link {index}', 'have a > 0 m and m > 0 kg to be flexible', link.a)
    return flexible


def _of_kind(link: DHLink, flexible: bool) -> DHLink:
    ei = link.ei if flexible else None
    return DHLink(
        link.a, link.b, link.alpha, link.theta, link.prismatic, link.mass, link.hub_inertia, ei
    )


def _modes(reader: _Table, needed: bool) -> int:
    modes = reader.table.get('modes', None if needed else 0)
    if isinstance(modes, bool) or not isinstance(modes, int) or not 0 <= modes <= MOST_MODES:
        reader.fail('modes', f'be a whole number from 0 to {MOST_MODES}', modes)
        return 0
    return modes


def _shape(reader: _Table) -> str:
    shape = reader.table.get('shape', 'clamped-free')
    if shape not in SHAPES:
        reader.fail('shape', f'be one of {", ".join(SHAPES)}', shape)
    return str(shape)


def _damping_ratio(reader: _Table) -> tuple[float, ...]:
    value = reader.table.get('damping_ratio', 0.0)
    entries = value if isinstance(value, list) else [value]
    return tuple(reader.as_number('damping_ratio', entry, '-', least=0.0) for entry in entries)


def _limits(reader: _Table) -> dict[str, float]:
    given = reader.table.get('limits', {})
    if not isinstance(given, dict):
        reader.fail('limits', 'be a mapping', given)
        return dict(DEFAULT_LIMITS)
    limits = _Table(given, f'{reader.whose} limits', reader.findings)
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
