"""`<loop>`: a joint that closes a kinematic loop, read and validated."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from denoc_ros.model.findings import Element, Findings, Reader
from denoc_ros.types import Array

WITH_AXIS = ('revolute', 'prismatic', 'universal')
WITH_DYNAMICS = ('revolute', 'prismatic')
TYPES = (*WITH_AXIS, 'spherical', 'fixed')


@dataclass(frozen=True)
class LoopElement:
    """`<loop>` as the file says it."""

    name: str
    type: str
    parent: str  # link
    parent_origin: Array  # (4, 4) loop frame seen from the link frame
    child: str
    child_origin: Array  # (4, 4)
    axis: Array | None  # (3,) unit
    axis2: Array | None  # (3,) unit
    damping: float
    friction: float


def read_loop(
    element: Element, links: Collection[str], names: set[str], findings: Findings
) -> LoopElement | None:
    """Return a loop, None if it has findings.

    Parameters
    ----------
    element : lxml element
        `<loop>`.
    links : collection of str
        The robot's links.
    names : set of str
        Names of the loops before it; its own is added.
    findings : Findings
        Gathers what is wrong.

    Returns
    -------
    LoopElement or None
        As the file says it, axes made unit.
    """
    before, name = len(findings.items), element.get('name', '')
    reader = Reader(element, f'loop {name!r}', findings)
    reader.only(('name', 'type'), ('parent', 'child', 'axis', 'axis2', 'dynamics'))
    reader.unique_name(names)
    type_ = reader.choice('type', TYPES)
    parent, parent_origin = _read_end(reader, 'parent', links)
    child, child_origin = _read_end(reader, 'child', links)
    if parent and parent == child:
        findings.add(reader.whose, f'parent and child must be two links, got {child!r} twice')
    axis = _read_axis(reader, 'axis', type_, WITH_AXIS)
    axis2 = _read_axis(reader, 'axis2', type_, ('universal',))
    damping, friction = _read_dynamics(reader, type_)
    if len(findings.items) > before:
        return None
    return LoopElement(
        name, type_, parent, parent_origin, child, child_origin, axis, axis2, damping, friction
    )


def _one(reader: Reader, tag: str, needed: bool) -> Element | None:
    found = reader.element.findall(tag)
    if len(found) > 1 or (needed and not found):
        reader.findings.add(reader.whose, f'<{tag}> must occur once, got {len(found)}')
    return found[0] if found else None


def _read_end(reader: Reader, tag: str, links: Collection[str]) -> tuple[str, Array]:
    element = _one(reader, tag, needed=True)
    if element is None:
        return '', np.eye(4)
    end = Reader(element, reader.whose, reader.findings, f' of <{tag}>')
    end.only(('link', 'xyz', 'rpy'))
    link = end.text('link')
    if link and link not in links:
        end.fail('link', 'be a link of the robot', link)
    return link, end.pose()


def _read_axis(reader: Reader, tag: str, type_: str, types: Collection[str]) -> Array | None:
    element = _one(reader, tag, needed=type_ in types)
    if element is None:
        return None
    if type_ and type_ not in types:
        reader.findings.add(reader.whose, f'<{tag}> must not occur in a {type_} loop, got one')
    axis = Reader(element, reader.whose, reader.findings, f' of <{tag}>')
    axis.only(('xyz',))
    return axis.axis()


def _read_dynamics(reader: Reader, type_: str) -> tuple[float, float]:
    element = _one(reader, 'dynamics', needed=False)
    if element is None:
        return 0.0, 0.0
    if type_ and type_ not in WITH_DYNAMICS:
        reader.findings.add(reader.whose, f'<dynamics> must not occur in a {type_} loop, got one')
    dynamics = Reader(element, reader.whose, reader.findings, ' of <dynamics>')
    dynamics.only(('damping', 'friction'))
    damping = dynamics.number('damping', least=0.0, default=0.0)
    return damping, dynamics.number('friction', least=0.0, default=0.0)
