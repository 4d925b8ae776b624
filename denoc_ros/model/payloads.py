"""Payloads: rigid bodies that links carry, by paths `payload.<link>.<mass|com|inertia>`.

Mass [kg], com (3,) [m] in the link frame, inertia about that centre in axes of the link frame
[kg m^2], (3, 3) or ixx ixy ixz iyy iyz izz; what is not given is 0.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from denoc_ros.errors import ConfigError
from denoc_ros.model.inertia import from_centre, moved, total
from denoc_ros.model.reading.findings import Findings, as_text, finite, unknown_path
from denoc_ros.model.tree import Tree
from denoc_ros.types import Array

PAYLOAD_SIZES = {'mass': (1,), 'com': (3,), 'inertia': (6, 9)}
WHERE = 'overrides'


@dataclass(frozen=True)
class Payload:
    """A rigid payload: mass [kg], com (3,) [m], inertia (3, 3) [kg m^2] about it, link axes."""

    mass: float
    com: Array
    inertia: Array


def carrying_links(tree: Tree) -> list[str]:
    """Return the links that a payload can hang on: those that move or are flexible."""
    of_loops = {side.frame for loop in tree.loops for side in (loop.parent, loop.child)}
    return [link for link, at in tree.frames.items() if at.body >= 0 and link not in of_loops]


def payloads_of(overrides: Mapping[str, Any], tree: Tree) -> dict[str, Payload]:
    """Payloads by link from paths `payload.*`; numbers left out are 0.

    Raises
    ------
    ConfigError
        For a link that the robot does not have, or a value of a wrong kind; every finding.
    """
    findings, links = Findings(), carrying_links(tree)
    given: dict[str, dict[str, Array]] = {}
    for path, value in overrides.items():
        if path.startswith('payload.'):
            read_payload(links, path, value, given, findings)
    ConfigError.raise_any(WHERE, findings.items)
    return {link: _payload(numbers) for link, numbers in given.items()}


def read_payload(
    links: Collection[str],
    path: str,
    value: Any,
    payloads: dict[str, dict[str, Array]],
    findings: Findings,
) -> None:
    """Put the numbers of a path into payloads by link and field, one of `links`."""
    link, _, field = path.removeprefix('payload.').rpartition('.')
    if link not in links or field not in PAYLOAD_SIZES:
        fields = '|'.join(PAYLOAD_SIZES)
        known = [f'payload.{name}.<{fields}>' for name in sorted(filter(None, links))]
        unknown_path(path, known, findings)
        return
    numbers = [finite(part) for part in (as_text(value) or '').split()]
    if len(numbers) not in PAYLOAD_SIZES[field] or None in numbers:
        sizes = ' or '.join(str(size) for size in PAYLOAD_SIZES[field])
        findings.add(f'path {path!r}', f'value must be {sizes} finite numbers, got {value!r}')
        return
    array = np.array(numbers, dtype=np.float64)
    if field == 'mass' and array[0] < 0.0:
        findings.add(f'path {path!r}', f'value must be >= 0 kg, got {array[0]:g}')
    payloads.setdefault(link, {})[field] = array


def with_payloads(tree: Tree) -> Tree:
    """Return a tree whose bodies carry the payloads of its overrides, and no others."""
    bodies = [
        body if body.unloaded is None else replace(body, inertia=body.unloaded, unloaded=None)
        for body in tree.bodies
    ]
    for link, payload in payloads_of(tree.overrides, tree).items():
        at = tree.frames[link]
        added = moved(from_centre(payload.mass, payload.com, payload.inertia), at.placement)
        body = bodies[at.body]
        unloaded = body.unloaded or body.inertia
        bodies[at.body] = replace(body, inertia=total(body.inertia, added), unloaded=unloaded)
    return replace(tree, bodies=tuple(bodies))


def _payload(given: Mapping[str, Array]) -> Payload:
    inertia = given.get('inertia', np.zeros(6))
    if len(inertia) == 9:
        matrix = inertia.reshape(3, 3)
        matrix = np.asarray(0.5 * (matrix + matrix.T))
    else:  # ixx ixy ixz iyy iyz izz
        matrix = inertia[[[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    return Payload(float(given.get('mass', np.zeros(1))[0]), given.get('com', np.zeros(3)), matrix)
