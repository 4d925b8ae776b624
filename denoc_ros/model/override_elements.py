"""Numbers of single elements of a description, changed in place by their dotted paths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from lxml import etree

from denoc_ros.model.findings import Element, Findings
from denoc_ros.model.tree import Spring
from denoc_ros.types import Array

Value = float | int | str | Sequence[float]

DAMPING = ('damping_ratio', 'damping')
JOINT_FIELDS = ('damping', 'friction', 'armature')
# of an elastic joint, and the attributes of <spring> they are
SPRING_FIELDS = {
    'stiffness': 'stiffness',
    'spring_damping': 'damping',
    'stiffness3': 'stiffness3',
    'backlash': 'backlash',
}


def joint_fields(spring: Spring | Element | None) -> tuple[str, ...]:
    """Return the fields of a joint's paths; a spring adds its own."""
    return JOINT_FIELDS if spring is None else (*JOINT_FIELDS, *SPRING_FIELDS)


def unknown_path(path: str, known: Sequence[str], findings: Findings) -> None:
    """Note a path that the robot does not have, with those that it has."""
    exist = ', '.join(known) if known else 'none of this kind'
    findings.add(f'path {path!r}', f'must be one that the robot has ({exist}), got another')


def set_attribute(
    element: Element, attribute: str, path: str, value: Value | Array, findings: Findings
) -> None:
    """Set an attribute to the value of a path, unless it is neither number nor text."""
    if attribute in ('modes', 'segments') and isinstance(value, float) and value.is_integer():
        value = int(value)  # parameters of nodes are doubles
    text = as_text(value)
    if text is None:
        findings.add(f'path {path!r}', f'value must be a number, or numbers, got {value!r}')
        return
    element.set(attribute, text)
    if attribute in DAMPING and element.tag in ('bending', 'torsion', 'flexible'):
        (other,) = set(DAMPING) - {attribute}
        element.attrib.pop(other, None)


def as_text(value: Any) -> str | None:
    """Return a value as an attribute's text, None if it is neither number, text nor numbers."""
    if isinstance(value, str):
        return value
    if isinstance(value, bool) or value is None:
        return None
    if isinstance(value, int | float | np.integer | np.floating):
        return str(value)
    if isinstance(value, Sequence | np.ndarray):
        parts = [as_text(part) for part in np.ravel(np.asarray(value, dtype=object))]
        return None if None in parts else ' '.join(str(part) for part in parts)
    return None


def override_joint(
    root: Element, path: str, rest: str, value: Value | Array, findings: Findings
) -> None:
    """Change a number of a joint, of its actuator or of its spring."""
    joints = [joint for joint in root.findall('joint') if joint.get('type') != 'fixed']
    name, _, field = rest.rpartition('.')
    springs = {spring.get('joint'): spring for spring in root.iterfind('flexibility/spring')}
    found = [joint for joint in joints if joint.get('name') == name]
    if not found or field not in joint_fields(springs.get(name)):
        names = [joint.get('name') for joint in joints]
        known = [f'joint.{name}.<{"|".join(joint_fields(springs.get(name)))}>' for name in names]
        unknown_path(path, known, findings)
        return
    if field in SPRING_FIELDS:
        element, field = springs[name], SPRING_FIELDS[field]
    elif field == 'armature':
        element = _actuator(root, name)
    else:
        element = _child(found[0], 'dynamics')
    set_attribute(element, field, path, value, findings)


def _child(element: Element, tag: str) -> Element:
    found = element.find(tag)
    return etree.SubElement(element, tag) if found is None else found


def _actuator(root: Element, joint: str) -> Element:
    block = _child(root, 'flexibility')
    for actuator in block.findall('actuator'):
        if actuator.get('joint') == joint:
            return actuator
    return etree.SubElement(block, 'actuator', joint=joint)
