"""Payloads: rigid bodies that links carry, as elements `<payload>` of a description.

Paths `payload.<link>.<mass|com|inertia>` change them: mass [kg], com (3,) [m] in the link frame,
inertia about that centre in axes of the link frame [kg m^2], (3, 3) or ixx ixy ixz iyy iyz izz. A
number that neither the description nor a path gives is 0.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np

from denoc_ros.model.inertia import from_centre, moved, possible, total
from denoc_ros.model.reading.findings import (
    Element,
    Findings,
    Reader,
    as_text,
    finite,
    unknown_path,
)
from denoc_ros.model.tree import Payload, Tree
from denoc_ros.types import Array

PAYLOAD_SIZES = {'mass': (1,), 'com': (3,), 'inertia': (6, 9)}
NO_PAYLOAD = Payload(0.0, np.zeros(3), np.zeros((3, 3)))
INERTIA_RULE = (
    'inertia must be symmetric positive semidefinite, with no principal moment above the sum '
    'of the other two'
)
CARRIER_RULE = 'on a link that moves or is flexible, got one fixed to the base'


def carrying_links(tree: Tree) -> list[str]:
    """Return the links that a payload can hang on: those that move or are flexible."""
    of_loops = {side.frame for loop in tree.loops for side in (loop.parent, loop.child)}
    return [link for link, at in tree.frames.items() if at.body >= 0 and link not in of_loops]


def moving_links(root: Element) -> set[str]:
    """Return the links of a description that move or are flexible, whatever else is wrong."""
    moving = {
        each.get('link', '')
        for tag in ('beam', 'flexible')
        for each in root.iterfind(f'flexibility/{tag}')
    }
    children: dict[str, list[str]] = {}
    for joint in root.findall('joint'):
        ends = (joint.find('parent'), joint.find('child'))
        parent, child = ('' if end is None else end.get('link', '') for end in ends)
        children.setdefault(parent, []).append(child)
        if joint.get('type') != 'fixed':
            moving.add(child)
    beyond = list(moving)
    while beyond:
        further = [link for link in children.get(beyond.pop(), ()) if link not in moving]
        moving.update(further)
        beyond += further
    return moving


def read_payload(
    element: Element,
    links: Collection[str],
    moving: Collection[str],
    payloads: dict[str, Payload],
    findings: Findings,
) -> None:
    """Put a `<payload>` into payloads by link; with findings its numbers may be nan.

    Parameters
    ----------
    links, moving : collection of str
        The robot's links, and those of them that move or are flexible.
    """
    link = element.get('link', '')
    reader = Reader(element, f'payload {link!r}', findings)
    reader.only(('link', *PAYLOAD_SIZES))
    if reader.text('link') and link not in links:
        reader.fail('link', 'be a link of the robot', link)
    elif link and link not in moving:
        findings.add(reader.whose, f'must be {CARRIER_RULE}')
    if link in payloads:
        findings.add(reader.whose, 'link must have one payload, got two')
    mass = reader.number('mass', 'kg', least=0.0)
    com = reader.vector('com', '0 0 0')
    inertia = symmetric(reader.vector('inertia', '0 0 0 0 0 0', 'kg m^2', 6))
    if np.isfinite(inertia).all() and not possible(inertia, mass * float(com @ com)):
        shown = ', '.join(f'{value:.4g}' for value in np.linalg.eigvalsh(inertia))
        findings.add(reader.whose, f'{INERTIA_RULE}, got principal moments {shown} kg m^2')
    payloads[link] = Payload(mass, com, inertia)


def payload_text(
    links: Collection[str], moving: Collection[str], path: str, value: Any, findings: Findings
) -> tuple[str, str, str] | None:
    """Return link, attribute and text of the value of a path; None with a finding."""
    link, _, field = path.removeprefix('payload.').rpartition('.')
    if link not in links or field not in PAYLOAD_SIZES:
        fields = '|'.join(PAYLOAD_SIZES)
        known = [f'payload.{name}.<{fields}>' for name in sorted(moving)]
        unknown_path(path, known, findings)
        return None
    numbers = [finite(part) for part in (as_text(value) or '').split()]
    given = [number for number in numbers if number is not None]
    if len(numbers) not in PAYLOAD_SIZES[field] or len(given) != len(numbers):
        sizes = ' or '.join(str(size) for size in PAYLOAD_SIZES[field])
        rule = f'value must be {sizes} finite numbers, got {value!r}'
    elif field == 'mass' and given[0] < 0.0:
        rule = f'value must be >= 0 kg, got {given[0]:g}'
    elif link not in moving:
        rule = f'must be {CARRIER_RULE}'
    else:
        values = np.array(given)
        return link, field, str(as_text(values if len(given) < 9 else six_numbers(values)))
    findings.add(f'path {path!r}', rule)
    return None


def six_numbers(inertia: Array) -> Array:
    """Return ixx ixy ixz iyy iyz izz of the symmetric part of an inertia, (3, 3) or (9,)."""
    matrix = inertia.reshape(3, 3)
    return np.asarray((0.5 * (matrix + matrix.T))[np.triu_indices(3)])


def symmetric(inertia: Array) -> Array:
    """Return the matrix (3, 3) of an inertia of 6 numbers or 9, row by row."""
    six = inertia if len(inertia) == 6 else six_numbers(inertia)
    return np.asarray(six[[[0, 1, 2], [1, 3, 4], [2, 4, 5]]])


def with_payloads(tree: Tree) -> Tree:
    """Return a tree whose bodies carry its payloads, and no others."""
    bodies = [
        body if body.unloaded is None else replace(body, inertia=body.unloaded, unloaded=None)
        for body in tree.bodies
    ]
    for link, payload in tree.payloads.items():
        at = tree.frames[link]
        added = moved(from_centre(payload.mass, payload.com, payload.inertia), at.placement)
        body = bodies[at.body]
        unloaded = body.unloaded or body.inertia
        bodies[at.body] = replace(body, inertia=total(body.inertia, added), unloaded=unloaded)
    return replace(tree, bodies=tuple(bodies))
