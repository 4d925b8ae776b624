"""Identification of a whole model: its options, its result as plain values, the description."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from denoc_ros.bags.digest import file_hash
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import IdentificationError
from denoc_ros.identification.decay.modes import DOUBTFUL, GOOD, NOT_IDENTIFIABLE, worst
from denoc_ros.identification.model.excitation import Excitation
from denoc_ros.identification.model.free_parameters import unit_of
from denoc_ros.identification.model.information import NOT_TOLD
from denoc_ros.identification.model.model_fit import IdentifiedModel, identify_model
from denoc_ros.identification.model.sources import RecordingSettings
from denoc_ros.identification.model.sources import read_source as read_recording_source
from denoc_ros.model.inertia import total
from denoc_ros.model.numbers import values_of
from denoc_ros.model.overrides import edited_description
from denoc_ros.model.reading.findings import Findings
from denoc_ros.model.reading.poses import number_text
from denoc_ros.model.reading.rigid_urdf import read_rigid_urdf
from denoc_ros.model.reading.source import TEXT_NAME, parse_xml, read_source, written
from denoc_ros.model.reading.urdf import tree_of
from denoc_ros.model.tree import RigidInertia
from denoc_ros.output_files import Document, plain

WORDS = {'found': GOOD, 'doubtful': DOUBTFUL, 'not identifiable': NOT_IDENTIFIABLE}


@dataclass(frozen=True)
class ModelOptions:
    """Numbers of a robot to identify, and the recordings."""

    robot: str  # name of the robot's file
    file: Path  # where that file is
    gravity: tuple[float, float, float]  # in the base frame [m/s^2]
    # numbers of the model where the search starts, in place of the file's
    overrides: Mapping[str, Any]
    recording: RecordingSettings  # how recordings are read
    free: Sequence[str]  # paths of what is free, as `identify_model` takes them
    cutoff: float  # above it effort is not compared [Hz]
    held_out: float  # last part of each run that a first fit does not see

    def start(self) -> Robot:
        """Return the robot where the search starts."""
        robot = load_robot(self.file, gravity=self.gravity)
        return robot.with_overrides(self.overrides) if self.overrides else robot

    def identify(self, paths: Sequence[Path]) -> tuple[Document, IdentifiedModel]:
        """Return the result of recordings, of plain values, and the model that fits them best."""
        robot = self.start()
        read = [read_recording_source(path, robot, self.recording) for path in paths]
        found = identify_model(robot, read, self.free, cutoff=self.cutoff, held_out=self.held_out)
        source = {
            'file': str(paths[0]),
            'sha256': file_hash(paths[0]),
            'others': {str(path): file_hash(path) for path in paths[1:]},
        }
        model = {'file': self.robot, 'free': self.free}
        document = {'kind': 'model', 'source': source, 'model': model, **result_of(found)}
        return dict(plain(document)), found


def result_of(found: IdentifiedModel) -> Document:
    """Return an identified model as plain values; infinite numbers are None."""
    document = {
        'method': 'output error, maximum likelihood over all channels',
        'parameters': [
            {
                'path': path,
                'start': found.start[path],
                'value': value,
                'interval': found.interval[path],
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
                'held_out_before': one.held_out_before,
                'held_out_after': one.held_out_after,
            }
            for one in found.channels
        ],
        'without_effect': found.without_effect,
        'verdict': WORDS[found.whole_verdict],
        'reasons': found.reasons,
        'seconds': found.seconds,
        'evaluations': found.evaluations,
    }
    return dict(plain(document))


def excitation_result(found: Excitation) -> Document:
    """Return a motion that identifies and its expected accuracy as plain values."""
    document = {
        'duration_s': found.duration,
        'parameters': [
            {
                'path': path,
                'value': value,
                'interval': found.interval[path],
                'verdict': found.verdict[path],
            }
            for path, value in found.values.items()
        ],
        'not_identifiable': found.combinations,
        'not_by_any_motion': found.never,
        'combinations_seen': found.seen,
        'limits': [
            {'what': e.what, 'name': e.name, 'value': e.value, 'limit': e.limit, 'unit': e.unit}
            for e in found.extremes
        ],
        'noise': found.noise,
        'rate_hz': found.rate,
        'gain': found.gain,
        'verdict': worst(tuple(WORDS[word] for word in found.verdict.values())),
        'seconds': found.seconds,
        'evaluations': found.evaluations,
    }
    return dict(plain(document))


def verdict_text(one: Mapping[str, Any]) -> str:
    """Return a number's verdict, with half its interval where that is no share of the number."""
    low, high = one['interval']
    if 'size' not in one or None in (low, high) or one['size'] == abs(one['value']):
        return str(one['verdict'])
    return f'{one["verdict"]}, ± {0.5 * (high - low):.2g} {unit_of(one["path"])}'.rstrip()


def applied_description(source: str | os.PathLike[str], found: IdentifiedModel) -> str:
    """Return the description with the found numbers.

    Parameters
    ----------
    found : IdentifiedModel
        Of that robot. Numbers that are not identifiable stay as they are in the file, and all ten
        of a rigid body where one of them is not. Of a payload that was found, the numbers that
        were not free are those of the search.
    """
    text = edited_description(source, {**_fixed_of_payloads(found), **found.overrides})
    bodies = {name: change for name, change in found.bodies.items() if _is_told(found, name)}
    where, _ = read_source(source)
    folder = '' if where == TEXT_NAME else os.path.dirname(where)
    return _with_bodies(text, bodies, folder) if bodies else text


def _fixed_of_payloads(found: IdentifiedModel) -> dict[str, Any]:
    """Return the numbers that were not free of payloads of which others were found."""
    changed = {path.rpartition('.')[0] for path in found.overrides if path.startswith('payload.')}
    return {
        path: value
        for path, value in values_of(found.robot.tree).items()
        if path.rpartition('.')[0] in changed
        and not any(free.startswith(path) for free in found.values)
    }


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
