"""Change single numbers of a robot by dotted paths.

`beam.<link>.<shape|segments>`, `beam.<link>.<y|z>.<ei|modes|damping_ratio|damping>`,
`beam.<link>.torsion.<gj|polar_inertia|modes|damping_ratio|damping>`,
`joint.<name>.<damping|friction|armature>`, of an elastic joint
`joint.<name>.<stiffness|spring_damping|stiffness3|backlash>`,
`flexible.<link>.<stiffness|damping_ratio|damping>` (stiffness: a factor on the file's),
`sensor.<name>.<gain|offset|noise>` and `payload.<link>.<mass|com|inertia>`;
`damping.<joint>` is another name for `joint.<joint>.damping`, `damping.<link>.<y|z|torsion>` for
`beam.<link>.<y|z|torsion>.damping_ratio`. Beams and joints are changed in the description, so
that the changed robot passes every check of a new one.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from denoc_ros.errors import ConfigError
from denoc_ros.model.beam_sections import expand_section
from denoc_ros.model.findings import Element, Findings, finite
from denoc_ros.model.inertia import from_centre, moved, total
from denoc_ros.model.override_elements import (
    DAMPING,
    Value,
    as_text,
    override_joint,
    set_attribute,
    unknown_path,
)
from denoc_ros.model.source import parse_xml, read_source, written
from denoc_ros.model.tree import Tree
from denoc_ros.model.urdf import tree_of
from denoc_ros.types import Array

Given = TypeVar('Given')

FAMILIES = ('beam', 'flexible', 'joint', 'payload', 'sensor', 'damping')
FLEXIBLE_FIELDS = ('stiffness', *DAMPING)
WHOLE_BEAM_FIELDS = ('shape', 'segments')
BEAM_FIELDS = {
    'y': ('ei', 'modes', *DAMPING),
    'z': ('ei', 'modes', *DAMPING),
    'torsion': ('gj', 'polar_inertia', 'modes', *DAMPING),
}
INERTIAL_FIELDS = {
    'imu': ('gyro_noise', 'accel_noise', 'gyro_bias', 'accel_bias'),
    'accelerometer': ('accel_noise', 'accel_bias'),
}
SENSOR_FIELDS = ('gain', 'offset', 'noise')
PAYLOAD_SIZES = {'mass': (1,), 'com': (3,), 'inertia': (6, 9)}
WHERE = 'overrides'


@dataclass(frozen=True)
class Payload:
    """A rigid payload: mass [kg], com (3,) [m], inertia (3, 3) [kg m^2] about it, link axes."""

    mass: float
    com: Array
    inertia: Array


def with_overrides(
    source: Tree | str | os.PathLike[str], overrides: Mapping[str, Value | Array]
) -> Tree:
    """Return a robot with some of its numbers changed.

    Parameters
    ----------
    source : Tree, str or path
        A robot, a file's path or XML text. A tree's own overrides stay, unless given anew.
    overrides : mapping of str to number, text or sequence of numbers
        By dotted path. Payload: mass [kg], com (3,) [m] in the link frame, inertia about that
        centre in axes of the link frame [kg m^2], (3, 3) or ixx ixy ixz iyy iyz izz; what is
        not given is 0. It is added rigidly to the link.

    Returns
    -------
    Tree
        The changed robot.

    Raises
    ------
    ConfigError
        For a path that the robot does not have, with those it has, a value of a wrong kind, or
        different values under two names of one number.
    ModelError
        If the changed description does not give a robot.
    """
    if isinstance(source, Tree):
        where, text, folder = 'robot with overrides', source.source, source.folder
        root = parse_xml(where, text)
        overrides = plain_paths(_damping_names(root), overrides)
        older = {path: old for path, old in source.overrides.items() if path not in overrides}
        overrides = plain_paths({}, {**older, **overrides})
    else:
        where, text = read_source(source)
        folder = None
        root = parse_xml(where, text)
        overrides = plain_paths(_damping_names(root), overrides)
    findings = Findings()
    payloads: dict[str, dict[str, Array]] = {}
    for path, value in overrides.items():
        _apply(root, path, value, payloads, findings)
    ConfigError.raise_any(WHERE, findings.items)
    tree = _with_payloads(tree_of(root, where, text, folder), payloads)
    return replace(tree, overrides=dict(overrides))


def edited_description(
    source: str | os.PathLike[str], overrides: Mapping[str, Value | Array]
) -> str:
    """Return a description's text with numbers of beams and joints changed, the rest as it was.

    Parameters
    ----------
    source : str or path
        A file's path or XML text.
    overrides : mapping
        As `with_overrides`, without payloads: a description has no place for them.

    Raises
    ------
    ConfigError, ModelError
        As `with_overrides`.
    """
    where, text = read_source(source)
    root = parse_xml(where, text, whole=True)
    plain = plain_paths(_damping_names(root), overrides)
    findings = Findings()
    for path, value in plain.items():
        if path.startswith('payload.'):
            findings.add(f'path {path!r}', 'must be of a beam, a joint or a sensor, got a payload')
        else:
            _apply(root, path, value, {}, findings)
    ConfigError.raise_any(WHERE, findings.items)
    edited = written(root, text)
    tree_of(parse_xml(where, edited), where, edited)
    return edited


def damping_names(tree: Tree) -> dict[str, str]:
    """Return the paths `damping.*` of a robot and those that they are other names for."""
    return _damping_names(parse_xml(tree.name, tree.source))


def payloads_of(overrides: Mapping[str, Value | Array], tree: Tree) -> dict[str, Payload]:
    """Payloads by link from paths `payload.*`; numbers left out are 0.

    Raises
    ------
    ConfigError
        For a link that the robot does not have, or a value of a wrong kind; every finding.
    """
    findings = Findings()
    payloads: dict[str, dict[str, Array]] = {}
    links = carrying_links(tree)
    for path, value in overrides.items():
        _override_payload(links, path, path.partition('.')[2], value, payloads, findings)
    ConfigError.raise_any(WHERE, findings.items)
    return {link: _payload(given) for link, given in payloads.items()}


def carrying_links(tree: Tree) -> list[str]:
    """Return the links that a payload can hang on: those that move or are flexible."""
    of_loops = {side.frame for loop in tree.loops for side in (loop.parent, loop.child)}
    return [link for link, at in tree.frames.items() if at.body >= 0 and link not in of_loops]


def _damping_names(root: Element) -> dict[str, str]:
    names = {}
    for beam in root.iterfind('flexibility/beam'):
        for part in beam.findall('bending') + beam.findall('torsion'):
            rest = f'{beam.get("link")}.{part.get("direction", "torsion")}'
            names[f'damping.{rest}'] = f'beam.{rest}.damping_ratio'
    for joint in root.findall('joint'):
        if joint.get('type') != 'fixed':
            names[f'damping.{joint.get("name")}'] = f'joint.{joint.get("name")}.damping'
    return names


def plain_paths(names: Mapping[str, str], overrides: Mapping[str, Given]) -> dict[str, Given]:
    """Return overrides under their own paths, those that still hold.

    Of a beam's damping and damping_ratio the one given later holds.

    Parameters
    ----------
    names : mapping of str to str
        Other names of paths, as `damping_names` returns them.
    overrides : mapping
        By either name.

    Raises
    ------
    ConfigError
        For different values under two names of one number.
    """
    plain: dict[str, Given] = {}
    findings = Findings()
    for path, value in overrides.items():
        name = names.get(path, path)
        other = plain.pop(name, value)
        if not np.array_equal(np.ravel(np.asarray(other)), np.ravel(np.asarray(value))):
            findings.add(f'path {path!r}', f'value must be that of {name!r}, got another')
        plain.pop(_instead_of(name), None)
        plain[name] = value
    ConfigError.raise_any(WHERE, findings.items)
    return plain


def _apply(
    root: Element,
    path: str,
    value: Value | Array,
    payloads: dict[str, dict[str, Array]],
    findings: Findings,
) -> None:
    kind, _, rest = path.partition('.')
    if kind == 'beam':
        _override_beam(root, path, rest, value, findings)
    elif kind == 'flexible':
        _override_flexible(root, path, rest, value, findings)
    elif kind == 'joint':
        override_joint(root, path, rest, value, findings)
    elif kind == 'sensor':
        _override_sensor(root, path, rest, value, findings)
    elif kind == 'payload':
        children = {end.get('link') or '' for end in root.iterfind('joint/child')}
        _override_payload(children, path, rest, value, payloads, findings)
    elif kind == 'damping':
        unknown_path(path, list(_damping_names(root)), findings)
    else:
        rule = 'start with beam., flexible., joint., payload., sensor. or damping.'
        findings.add(f'path {path!r}', f'must {rule}, got {kind!r}')


def _instead_of(path: str) -> str:
    """Return the path of the other of a beam's damping and damping_ratio, '' for other paths."""
    start, _, field = path.rpartition('.')
    if not path.startswith(('beam.', 'flexible.')) or field not in DAMPING:
        return ''
    (other,) = set(DAMPING) - {field}
    return f'{start}.{other}'


def _override_beam(
    root: Element, path: str, rest: str, value: Value | Array, findings: Findings
) -> None:
    for beam in root.iterfind('flexibility/beam'):
        for field in WHOLE_BEAM_FIELDS:
            if rest == f'{beam.get("link")}.{field}':
                set_attribute(beam, field, path, value, findings)
                _fit_to_segments(beam, field)
                return
        for part in beam.findall('bending') + beam.findall('torsion'):
            name = part.get('direction', 'torsion')
            for field in BEAM_FIELDS.get(name, ()):
                if rest == f'{beam.get("link")}.{name}.{field}':
                    if field not in DAMPING:  # all other numbers may come from a section
                        expand_section(beam)
                    set_attribute(part, field, path, value, findings)
                    return
    unknown_path(path, _known_beams(root), findings)


def _override_flexible(
    root: Element, path: str, rest: str, value: Value | Array, findings: Findings
) -> None:
    links = {each.get('link'): each for each in root.iterfind('flexibility/flexible')}
    link, _, field = rest.rpartition('.')
    if link in links and field in FLEXIBLE_FIELDS:
        set_attribute(links[link], field, path, value, findings)
        return
    fields = '|'.join(FLEXIBLE_FIELDS)
    unknown_path(path, [f'flexible.{each}.<{fields}>' for each in links], findings)


def _fit_to_segments(beam: Element, field: str) -> None:
    """Drop the shape and further modes' damping ratios of a beam that is divided now."""
    if field != 'segments' or beam.get('segments') == '1':
        return
    beam.attrib.pop('shape', None)
    for part in beam.findall('bending') + beam.findall('torsion'):
        if len(ratios := part.get('damping_ratio', '').split()) > 1:
            part.set('damping_ratio', ratios[0])


def _known_beams(root: Element) -> list[str]:
    known = []
    for beam in root.iterfind('flexibility/beam'):
        for part in beam.findall('bending') + beam.findall('torsion'):
            name = part.get('direction', 'torsion')
            fields = '|'.join(BEAM_FIELDS.get(name, ()))
            known.append(f'beam.{beam.get("link")}.{name}.<{fields}>')
        known.append(f'beam.{beam.get("link")}.<{"|".join(WHOLE_BEAM_FIELDS)}>')
    return known


def _override_sensor(
    root: Element, path: str, rest: str, value: Value | Array, findings: Findings
) -> None:
    name, _, field = rest.rpartition('.')
    sensors = root.findall('flexibility/sensor')
    found = [sensor for sensor in sensors if sensor.get('name') == name]
    if not found or field not in _sensor_fields(found[0]):
        known = [f'{each.get("name")}.<{"|".join(_sensor_fields(each))}>' for each in sensors]
        unknown_path(path, [f'sensor.{each}' for each in known], findings)
        return
    set_attribute(found[0], field, path, value, findings)


def _sensor_fields(sensor: Element) -> tuple[str, ...]:
    return INERTIAL_FIELDS.get(sensor.get('type', ''), SENSOR_FIELDS)


def _override_payload(
    links: Collection[str],
    path: str,
    rest: str,
    value: Value | Array,
    payloads: dict[str, dict[str, Array]],
    findings: Findings,
) -> None:
    link, _, field = rest.rpartition('.')
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


def _with_payloads(tree: Tree, payloads: Mapping[str, Mapping[str, Array]]) -> Tree:
    bodies = list(tree.bodies)
    for link, payload in payloads.items():
        at = tree.frames[link]
        if at.body < 0:
            rule = 'must be on a link that moves or is flexible, got one fixed to the base'
            raise ConfigError(WHERE, [f"path 'payload.{link}': {rule}"])
        given = _payload(payload)
        added = from_centre(given.mass, given.com, given.inertia)
        body = bodies[at.body]
        inertia = total(body.inertia, moved(added, at.placement))
        bodies[at.body] = replace(body, inertia=inertia)
    return replace(tree, bodies=tuple(bodies))


def _payload(given: Mapping[str, Array]) -> Payload:
    return Payload(
        float(given.get('mass', np.zeros(1))[0]),
        given.get('com', np.zeros(3)),
        _inertia(given.get('inertia', np.zeros(6))),
    )


def _inertia(numbers: Array) -> Array:
    """Return the (3, 3) matrix of nine numbers, or of ixx ixy ixz iyy iyz izz."""
    if len(numbers) == 9:
        matrix = numbers.reshape(3, 3)
        return np.asarray(0.5 * (matrix + matrix.T))
    xx, xy, xz, yy, yz, zz = numbers
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
