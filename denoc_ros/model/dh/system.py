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
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from denoc_ros.errors import ConfigError
from denoc_ros.model.dh.links import CHAIN_KEYS, DHLink, section_rigidity
from denoc_ros.model.dh.mechanism import (
    MECHANISM_KEYS,
    DHChain,
    DHLoop,
    DHPoint,
    angle_keys,
    read_chains,
    read_loops,
    read_tool,
)
from denoc_ros.model.dh.table import Table
from denoc_ros.model.findings import Findings
from denoc_ros.model.flexibility import MOST_MODES
from denoc_ros.model.shapes import SHAPES
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
    reader = Table(table, f'system {name!r}', findings)
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


def _kinds(reader: Table, kinds: object, links: list[DHLink]) -> list[bool]:
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


def _modes(reader: Table, needed: bool) -> int:
    modes = reader.table.get('modes', None if needed else 0)
    if isinstance(modes, bool) or not isinstance(modes, int) or not 0 <= modes <= MOST_MODES:
        reader.fail('modes', f'be a whole number from 0 to {MOST_MODES}', modes)
        return 0
    return modes


def _shape(reader: Table) -> str:
    shape = reader.table.get('shape', 'clamped-free')
    if shape not in SHAPES:
        reader.fail('shape', f'be one of {", ".join(SHAPES)}', shape)
    return str(shape)


def _damping_ratio(reader: Table) -> tuple[float, ...]:
    value = reader.table.get('damping_ratio', 0.0)
    entries = value if isinstance(value, list) else [value]
    return tuple(reader.as_number('damping_ratio', entry, '-', least=0.0) for entry in entries)


def _armature(reader: Table, joints: int) -> tuple[float, ...]:
    """Return the rotor inertia that each joint's gear reflects."""
    if 'armature' not in reader.table:
        return ()
    entries = reader.list_of('armature', joints)
    return tuple(reader.as_number('armature', entry, 'kg m^2', least=0.0) for entry in entries)


def _limits(reader: Table) -> dict[str, float]:
    given = reader.table.get('limits', {})
    if not isinstance(given, dict):
        reader.fail('limits', 'be a mapping', given)
        return dict(DEFAULT_LIMITS)
    limits = Table(given, f'{reader.whose} limits', reader.findings)
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
