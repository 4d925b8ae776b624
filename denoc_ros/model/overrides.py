"""Change a description by dotted paths: those of numbers, and some that are of none.

Beside those of :mod:`denoc_ros.model.numbers` there are `beam.<link>.<shape|segments>`,
`beam.<link>.<y|z|torsion>.modes` and `beam.<link>.torsion.polar_inertia`. Beams and joints are
changed in the description, so that the changed robot passes every check of a new one.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from lxml import etree

from denoc_ros.errors import ConfigError
from denoc_ros.model.beams.beam_sections import expand_section
from denoc_ros.model.numbers import (
    DAMPING,
    FAMILIES,
    FLEXIBLE_FIELDS,
    JOINT_FIELDS,
    SENSOR_FIELDS,
    SPRING_FIELDS,
    WHERE,
    merged_overrides,
    other_names,
    plain_paths,
)
from denoc_ros.model.payloads import moving_links, payload_text
from denoc_ros.model.reading.findings import Element, Findings, as_text, unknown_path
from denoc_ros.model.reading.poses import number_text, rotation_rpy, rpy_of
from denoc_ros.model.reading.source import parse_xml, read_source, written
from denoc_ros.model.reading.urdf import tree_of
from denoc_ros.model.sensors import deviation_fields
from denoc_ros.model.tree import INERTIAL_SENSORS, Tree
from denoc_ros.types import Array

WHOLE_BEAM_FIELDS = ('shape', 'segments')
BEAM_FIELDS = {
    'y': ('ei', 'modes', *DAMPING),
    'z': ('ei', 'modes', *DAMPING),
    'torsion': ('gj', 'polar_inertia', 'modes', *DAMPING),
}


def with_overrides(source: Tree | str | os.PathLike[str], overrides: Mapping[str, Any]) -> Tree:
    """Return a robot with some of its numbers changed.

    Parameters
    ----------
    source : Tree, str or path
        A robot, a file's path or XML text. A tree's own overrides stay, unless given anew.
    overrides : mapping of str to number, text or sequence of numbers
        By dotted path; a payload is added rigidly to its link.

    Raises
    ------
    ConfigError
        For a path that the robot does not have, with those it has, a value of a wrong kind, or
        different values under two names of one number.
    ModelError
        If the changed description does not give a robot.
    """
    folder = None
    if isinstance(source, Tree):
        where, text, folder = 'robot with overrides', source.source, source.folder
    else:
        where, text = read_source(source)
    description = _Description(parse_xml(where, text), folder)
    plain = plain_paths(description.paths, overrides)
    if isinstance(source, Tree):
        plain = merged_overrides(source, plain)
    description.change(plain)
    return replace(tree_of(description.root, where, text, folder), overrides=plain)


def edited_description(source: str | os.PathLike[str], overrides: Mapping[str, Any]) -> str:
    """Return a description's text with some numbers changed as `with_overrides` changes them.

    The rest is as it was.
    """
    where, text = read_source(source)
    description = _Description(parse_xml(where, text, whole=True))
    description.change(plain_paths(description.paths, overrides))
    edited = written(description.root, text)
    tree_of(parse_xml(where, edited), where, edited)
    return edited


class _Description:
    """The elements of a description that dotted paths change."""

    def __init__(self, root: Element, folder: str | None = None) -> None:
        self.root, self._folder = root, folder or ''
        self._fields: dict[str, tuple[Element, tuple[str, ...]]] = {}
        for beam in root.iterfind('flexibility/beam'):
            path = f'beam.{beam.get("link")}'
            for part in beam.findall('bending') + beam.findall('torsion'):
                name = part.get('direction', 'torsion')
                self._fields[f'{path}.{name}'] = part, BEAM_FIELDS.get(name, ())
            self._fields[path] = beam, WHOLE_BEAM_FIELDS
        for flexible in root.iterfind('flexibility/flexible'):
            self._fields[f'flexible.{flexible.get("link")}'] = flexible, FLEXIBLE_FIELDS
        self._springs = {each.get('joint'): each for each in root.iterfind('flexibility/spring')}
        for joint in root.findall('joint'):
            if joint.get('type') != 'fixed':
                name = joint.get('name')
                more = tuple(SPRING_FIELDS) if name in self._springs else ()
                self._fields[f'joint.{name}'] = joint, (*JOINT_FIELDS, *more)
        for sensor in root.iterfind('flexibility/sensor'):
            type_ = sensor.get('type', '')
            fields = deviation_fields(type_) if type_ in INERTIAL_SENSORS else SENSOR_FIELDS
            self._fields[f'sensor.{sensor.get("name")}'] = sensor, fields
        self.paths = [
            f'{start}.{field}' for start, (_, fields) in self._fields.items() for field in fields
        ]
        self._moving = moving_links(root)
        self._links = {end.get('link') for end in root.iterfind('joint/child')} | self._moving

    def change(self, plain: Mapping[str, Any]) -> None:
        """Change the elements.

        Raises
        ------
        ConfigError
            With every path and value that is wrong.
        """
        findings = Findings()
        for path, value in plain.items():
            if path.startswith('payload.'):
                self._set_payload(path, value, findings)
            else:
                self._set(path, value, findings)
        ConfigError.raise_any(WHERE, findings.items)

    def _set(self, path: str, value: Any, findings: Findings) -> None:
        kind = path.partition('.')[0]
        if kind not in FAMILIES:
            rule = 'start with beam., flexible., joint., payload., sensor. or damping.'
            findings.add(f'path {path!r}', f'must {rule}, got {kind!r}')
            return
        start, _, field = path.rpartition('.')
        element, fields = self._fields.get(start, (None, ()))
        if field not in fields:
            known = [
                f'{each}.<{"|".join(fields)}>'
                for each, (_, fields) in self._fields.items()
                if each.startswith(f'{kind}.')
            ]
            known = list(other_names(self.paths)) if kind == 'damping' else known
            unknown_path(path, known, findings)
            return
        if kind == 'beam' and element.tag != 'beam' and field not in DAMPING:
            expand_section(
                element.getparent(), self._folder
            )  # all other numbers may come from a section
        name = start.partition('.')[2]
        if kind == 'joint' and field in SPRING_FIELDS:
            element, field = self._springs[name], SPRING_FIELDS[field]
        elif kind == 'joint':
            element = self._actuator(name) if field == 'armature' else _child(element, 'dynamics')
        _set_attribute(element, field, path, value, findings)
        if kind == 'beam' and field == 'segments':
            _fit_to_segments(element)

    def _set_payload(self, path: str, value: Any, findings: Findings) -> None:
        found = payload_text(self._links, self._moving, path, value, findings)
        if found is not None:
            link, field, text = found
            self._in_block('payload', {'link': link}, {'mass': '0'}).set(field, text)

    def _actuator(self, joint: str) -> Element:
        return self._in_block('actuator', {'joint': joint}, {})

    def _in_block(self, tag: str, of: Mapping[str, str], more: Mapping[str, str]) -> Element:
        """Return the block's element of a link or joint, a new one with more attributes."""
        block = _child(self.root, 'flexibility')
        for element in block.findall(tag):
            if of.items() <= dict(element.attrib).items():
                return element
        return _appended(block, tag, {**of, **more})


def _child(element: Element, tag: str) -> Element:
    found = element.find(tag)
    return _appended(element, tag, {}) if found is None else found


def _appended(parent: Element, tag: str, attributes: Mapping[str, str]) -> Element:
    """Return a new last child, with the white space between those before it."""
    last = parent[-1] if len(parent) else None
    element = etree.SubElement(parent, tag, attributes)
    if last is not None:
        element.tail, last.tail = last.tail, parent.text
    return element


def _set_attribute(
    element: Element, attribute: str, path: str, value: Any, findings: Findings
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


def _fit_to_segments(beam: Element) -> None:
    """Drop the shape and further modes' damping ratios of a beam that is divided now."""
    if beam.get('segments') == '1':
        return
    beam.attrib.pop('shape', None)
    for part in beam.findall('bending') + beam.findall('torsion'):
        if len(ratios := part.get('damping_ratio', '').split()) > 1:
            part.set('damping_ratio', ratios[0])


# other edits of a description -------------------------------------------------------------------


def with_held_base(text: str) -> str:
    """Return a description whose floating joint is fixed: the base of all that it carries."""
    root = parse_xml('robot description', text, whole=True)
    for joint in root.findall('joint'):
        if joint.get('type') == 'floating':
            joint.set('type', 'fixed')
    return str(etree.tostring(root, encoding='unicode'))


def remounted_description(source: str | os.PathLike[str], sensor: str, rotation: Array) -> str:
    """Return a description's text with a sensor's `rpy` turned, the rest as it was.

    Parameters
    ----------
    sensor : str
        Name of an IMU or accelerometer.
    rotation : (3, 3) array
        Its true axes, seen from those that the description says.

    Raises
    ------
    ConfigError, ModelError
        The description has no such sensor, or is no robot.
    """
    where, text = read_source(source)
    root = parse_xml(where, text, whole=True)
    for element in root.findall('flexibility/sensor'):
        if element.get('name') == sensor and element.get('type') in INERTIAL_SENSORS:
            said = np.array([float(part) for part in element.get('rpy', '0 0 0').split()])
            element.set('rpy', number_text(*rpy_of(rotation_rpy(said) @ rotation)))
            edited = written(root, text)
            tree_of(parse_xml(where, edited), where, edited)
            return edited
    raise ConfigError(where, [f'sensor {sensor!r} must be an IMU or accelerometer, got none'])
