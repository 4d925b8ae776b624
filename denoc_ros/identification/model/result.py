"""An identified model as plain values, and the description that has it."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from lxml import etree

from denoc_ros.errors import IdentificationError
from denoc_ros.identification.model.fit import IdentifiedModel
from denoc_ros.identification.model.free_parameters import unit_of
from denoc_ros.identification.model.information import NOT_TOLD
from denoc_ros.identification.modes import DOUBTFUL, GOOD, NOT_IDENTIFIABLE, worst
from denoc_ros.model.findings import Findings
from denoc_ros.model.inertia import total
from denoc_ros.model.overrides import edited_description
from denoc_ros.model.poses import number_text
from denoc_ros.model.rigid_urdf import read_rigid_urdf
from denoc_ros.model.source import TEXT_NAME, parse_xml, read_source, written
from denoc_ros.model.tree import RigidInertia
from denoc_ros.model.urdf import tree_of

Document = dict[str, Any]
WORDS = {'found': GOOD, 'doubtful': DOUBTFUL, 'not identifiable': NOT_IDENTIFIABLE}


def result_of(found: IdentifiedModel) -> Document:
    """Result document of a model; infinite numbers are None."""
    return {
        'method': 'output error, maximum likelihood over all channels',
        'parameters': [
            {
                'path': path,
                'start': found.start[path],
                'value': value,
                'interval': [_finite(end) for end in found.interval[path]],
                'verdict': found.verdict[path],
                'size': found.size[path],
            }
            for path, value in found.values.items()
        ],
        'not_identifiable': found.combinations,
        'channels': [
            {
                'run': one.run,
                'channel': one.name,
                'unit': one.unit,
                'samples': one.samples,
                'rms_before': one.before,
                'rms_after': one.after,
                'rms_alone': one.alone * one.after,
                'held_out_before': _finite(one.held_out_before),
                'held_out_after': _finite(one.held_out_after),
            }
            for one in found.channels
        ],
        'verdict': worst(tuple(WORDS[word] for word in found.verdict.values())),
        'reasons': list(found.reasons),
        'seconds': found.seconds,
        'evaluations': found.evaluations,
    }


def verdict_text(one: Mapping[str, Any]) -> str:
    """Return a number's verdict, with half its interval where that is no share of the number."""
    low, high = one['interval']
    if 'size' not in one or None in (low, high) or one['size'] == abs(one['value']):
        return str(one['verdict'])
    return f'{one["verdict"]}, ± {0.5 * (high - low):.2g} {unit_of(one["path"])}'.rstrip()


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def applied_description(
    source: str | os.PathLike[str], found: IdentifiedModel
) -> tuple[str, dict[str, float | list[float]]]:
    """Description with the found numbers, and the overrides that it has no place for.

    Parameters
    ----------
    source : str or path
        A file's path or XML text.
    found : IdentifiedModel
        Of that robot. Numbers that are not identifiable stay as they are in the file, and all ten
        of a rigid body where one of them is not.
    """
    of_file = {p: v for p, v in found.overrides.items() if not p.startswith('payload.')}
    left = {p: v for p, v in found.overrides.items() if p.startswith('payload.')}
    text = edited_description(source, of_file)
    bodies = {name: change for name, change in found.bodies.items() if _is_told(found, name)}
    where, _ = read_source(source)
    folder = '' if where == TEXT_NAME else os.path.dirname(where)
    return (_with_bodies(text, bodies, folder) if bodies else text), left


def not_applied(found: IdentifiedModel) -> list[str]:
    """Return the numbers of the robot that `applied_description` leaves as they are in the file.

    Of a rigid body with a number that is not identifiable the path of all ten.
    """
    bodies = [name for name in found.bodies if not _is_told(found, name)]
    left = [f'link.{name}.inertial' for name in bodies]
    of_robot = ('beam.', 'joint.', 'sensor.', 'payload.')
    left += [
        path
        for path, verdict in found.verdict.items()
        if verdict == NOT_TOLD and path.startswith(of_robot)
    ]
    return left


def _is_told(found: IdentifiedModel, body: str) -> bool:
    numbers = (v for p, v in found.verdict.items() if p.startswith(f'link.{body}.'))
    return all(verdict != NOT_TOLD for verdict in numbers)


def _with_bodies(text: str, changes: Mapping[str, RigidInertia], folder: str) -> str:
    """Description with changed link inertias; bodies fixed to the links keep theirs."""
    root = parse_xml('description', text, whole=True)
    inertias = read_rigid_urdf(parse_xml('description', text), Findings(), []).links
    for link in root.iterfind('link'):
        name = str(link.get('name'))
        if name in changes:
            _write_inertial(link, total(inertias[name] or RigidInertia(), changes[name]))
    edited = written(root, text)
    tree_of(parse_xml('identified', edited), 'identified', edited, folder)
    return edited


def _write_inertial(link: Any, body: RigidInertia) -> None:
    """Replace a link's <inertial>: axes of the link frame, about the centre of mass."""
    if body.mass <= 0.0:
        raise IdentificationError(
            f'link {link.get("name")!r}: identified mass without what is fixed to it must be '
            f'> 0 kg, got {body.mass:.4g}'
        )
    centre = body.first_moment / body.mass
    shift = float(centre @ centre) * np.eye(3) - np.outer(centre, centre)
    inertia = body.inertia - body.mass * shift
    element = link.find('inertial')
    if element is None:
        element = etree.SubElement(link, 'inertial')
    for child in list(element):
        element.remove(child)
    etree.SubElement(element, 'origin', xyz=number_text(*centre), rpy='0 0 0')
    etree.SubElement(element, 'mass', value=number_text(body.mass))
    names = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')
    values = inertia[np.triu_indices(3)]
    etree.SubElement(element, 'inertia', dict(zip(names, map(number_text, values), strict=True)))
