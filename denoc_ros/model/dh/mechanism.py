"""Chains of a table that stand on the base, and the loops that join them."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass, replace

from denoc_ros.model.dh.links import CHAIN_KEYS, DHLink, read_links
from denoc_ros.model.dh.table import Table

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


def read_chains(reader: Table, shared: float | None) -> tuple[DHChain, ...]:
    """Return the chains of a system, their links named; a serial robot is one chain at the base.

    Parameters
    ----------
    reader : Table
        The system.
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


def angle_keys(reader: Table) -> frozenset[str]:
    """Return the keys of prismatic joints' constant angles."""
    pattern = r'theta[1-9]\d?_over_pi'
    return frozenset(str(key) for key in reader.table if re.fullmatch(pattern, str(key)))


def read_loops(reader: Table, chains: Collection[DHChain]) -> tuple[DHLoop, ...]:
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
        loops.append(DHLoop(loop.name('name') or f'loop_{index}', str(type_), *ends))
    return tuple(loops)


def read_tool(reader: Table, chains: tuple[DHChain, ...]) -> DHPoint | None:
    """Return the position of the tool: by default at the end of a serial robot."""
    if 'tool' in reader.table:
        return read_point(reader, 'tool', chains)
    if len(chains) == 1 and chains[0].links:
        return DHPoint(chains[0].links[-1].name)
    return None


def read_point(reader: Table, key: str, chains: Collection[DHChain]) -> DHPoint:
    """Return a point: a link's name for its end, or a mapping of `link` and `at`."""
    value = reader.table.get(key)
    links = {link.name: link for chain in chains for link in chain.links}
    if isinstance(value, str) and value in links and links[value].plate is None:
        return DHPoint(value)
    if isinstance(value, dict) and value.get('link') in {*links, 'base'}:
        point = Table(value, f'{reader.whose} {key}', reader.findings)
        point.only(frozenset(('link', 'at')))
        return DHPoint(value['link'], point.point('at', 2))
    known = ', '.join(links)
    reader.fail(key, f'be a rod (its end) or {{link, at}}, of {known} and base', value)
    return DHPoint('base', (0.0, 0.0, 0.0))


def _named(
    reader: Table, chains: list[tuple[tuple[float, ...], list[DHLink]]]
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
