"""A link as its URDF says it: frames of its joints, mesh, mass; and the block with its file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from lxml import etree

from denoc_ros.errors import ConfigError, ModelError
from denoc_ros.model.beams.cross_sections import SectionAxes
from denoc_ros.model.reading.findings import Element, Findings, Reader
from denoc_ros.model.reading.flexibility import BeamElement, read_flexibility
from denoc_ros.model.reading.mesh_files import mesh_file
from denoc_ros.model.reading.poses import number_text, rpy_of
from denoc_ros.model.reading.rigid_urdf import RigidUrdf, read_rigid_urdf
from denoc_ros.model.reading.source import parse_xml, read_source, written
from denoc_ros.model.tree import JointKind, RigidInertia
from denoc_ros.reduction.suggest.suggested_block import appended
from denoc_ros.types import Array

SAME_PLACE = 1e-6  # m: frames no farther apart share one patch


@dataclass(frozen=True)
class LinkDescription:
    """A link of a URDF.

    `frames` name -> pose (4, 4) of each joint that the link carries something by, in its frame;
    `meshes` (file, pose (4, 4), scale (3,)): collision before visual.
    """

    where: str
    link: str
    frames: dict[str, Array]
    meshes: list[tuple[Path, Array, Array]]
    lost: list[str]  # names of meshes that are not found
    inertia: RigidInertia | None
    beam: BeamElement | None = None  # its `<beam>`, which is reduced in place of a mesh
    # strain gauges of the beam: place (3,) and direction (3,), in the link frame
    gauges: dict[str, tuple[Array, Array]] = field(default_factory=dict)


def describe_link(file: Path, link: str) -> LinkDescription:
    """Read a link of a URDF.

    Raises
    ------
    ModelError
        With every finding of the file.
    ConfigError
        For a link that it does not have.
    """
    where, text = read_source(file)
    root = parse_xml(where, text)
    findings = Findings()
    robot = read_rigid_urdf(root, findings, [])
    ModelError.raise_any(where, findings.items)
    if link not in robot.links:
        known = ', '.join(robot.links)
        raise ConfigError(where, [f'link must be one of {known}, got {link!r}'])
    frames: dict[str, Array] = {}
    beam, hung, gauges = _beam_of(where, root, link, str(file.resolve().parent))
    for joint in robot.joints:
        taken = [pose[:3, 3] for pose in frames.values()]
        if joint.parent == link and (beam is not None or _carries(robot, joint.child)):
            place = joint.origin[:3, 3]
            if not any(np.linalg.norm(place - other) < SAME_PLACE for other in taken):
                frames[joint.name] = joint.origin
    frames |= hung
    (element,) = [found for found in root.findall('link') if found.get('name') == link]
    meshes, lost = _meshes(element, file.resolve().parent)
    return LinkDescription(where, link, frames, meshes, lost, robot.links[link], beam, gauges)


def _beam_of(
    where: str, root: Element, link: str, folder: str
) -> tuple[BeamElement | None, dict[str, Array], dict[str, tuple[Array, Array]]]:
    """Return a link's beam, the frames of loops and IMUs on it, and its strain gauges."""
    if not any(each.get('link') == link for each in root.iterfind('flexibility/beam')):
        return None, {}, {}
    findings = Findings()
    block = read_flexibility(root, findings, folder)
    ModelError.raise_any(where, findings.items)
    beam, frames, gauges = block.beams[link], dict[str, Array](), {}
    for loop in block.loops:
        if loop.parent == link:
            frames[f'{loop.name}/parent'] = loop.parent_origin
        if loop.child == link:
            frames[f'{loop.name}/child'] = loop.child_origin
    for imu in block.inertial_sensors:
        if imu.link == link:
            frames[imu.name] = _section(beam, imu.station or 0.0) @ imu.origin
    for sensor in block.sensors:
        if sensor.link != link:
            continue
        if sensor.quantity != 'strain':
            rule = f'sensor {sensor.name!r} must be a strain gauge to stay with a reduced beam'
            findings.add(f'link {link!r}', f'{rule}, got {sensor.type}')
        section = _section(beam, sensor.station, principal=True)
        aside = section[:3, 1 if sensor.direction == 'y' else 2]
        gauges[sensor.name] = (section[:3, 3] + sensor.surface * aside, section[:3, 0])
    ModelError.raise_any(where, findings.items)
    return beam, frames, gauges


def _section(beam: BeamElement, station: float, principal: bool = False) -> Array:
    """Return a section's pose (4, 4) in the link frame, on the axis or at its principal axes."""
    x = min(station, beam.length)
    pose = np.eye(4)
    if principal and beam.axes is not None:
        pose = SectionAxes.of(*beam.axes.values(np.array([x / beam.length]))[0]).pose
    pose[0, 3] = x
    return np.asarray(beam.origin @ pose)


def _carries(robot: RigidUrdf, link: str) -> bool:
    """Say whether a link, or a body fixed to it, has mass or a joint that moves."""
    inertia = robot.links[link]
    if inertia is not None and inertia.mass > 0.0:
        return True
    below = [joint for joint in robot.joints if joint.parent == link]
    return any(j.kind is not JointKind.FIXED or _carries(robot, j.child) for j in below)


def _meshes(link: Element, folder: Path) -> tuple[list[tuple[Path, Array, Array]], list[str]]:
    found, lost = [], []
    for tag in ('collision', 'visual'):
        for shape in link.findall(tag):
            mesh = shape.find('geometry/mesh')
            if mesh is None:
                continue
            findings = Findings()
            origin = shape.find('origin')
            pose = np.eye(4) if origin is None else Reader(origin, '', findings).pose()
            scale = Reader(mesh, '', findings).vector('scale', '1 1 1', '-')
            file = mesh_file(str(mesh.get('filename', '')), folder)
            if file is None:
                lost.append(str(mesh.get('filename', '')))
            elif not findings.items:
                found.append((file, pose, scale))
    return found, lost


def with_block(file: Path, described: LinkDescription, link_file: str) -> str:
    """Return a URDF's text with the link made flexible.

    Its `<beam>` gives way, and sensors on the beam name the file's strain points and frames.

    Raises
    ------
    ConfigError
        If it is a reduced link already.
    """
    where, text = read_source(file)
    root, link = parse_xml(where, text, whole=True), described.link
    if any(each.get('link') == link for each in root.iterfind('flexibility/flexible')):
        raise ConfigError(where, [f'link {link!r} must have no <flexible> yet, got one'])
    block = root.find('flexibility')
    if block is None:
        block = appended(root, etree.Element('flexibility'), 0)
    inertial = 'file' if described.beam is None else 'urdf'  # whose mass it has
    element = etree.Element('flexible', link=link, file=link_file, inertial=inertial)
    beams = [each for each in block.findall('beam') if each.get('link') == link]
    if not beams:
        appended(block, element, 1)
    for beam in beams:
        element.tail = beam.tail
        block.replace(beam, element)
        for sensor in block.findall('sensor'):
            if sensor.get('link') == link:
                _fit_sensor(sensor, described)
    return written(root, text)


def _fit_sensor(sensor: Element, described: LinkDescription) -> None:
    name = str(sensor.get('name'))
    for attribute in ('station', 'direction', 'surface', 'xyz', 'rpy'):
        sensor.attrib.pop(attribute, None)
    if name in described.gauges:
        sensor.set('point', name)
    else:
        pose = described.frames[name]
        sensor.set('xyz', number_text(*pose[:3, 3]))
        sensor.set('rpy', number_text(*rpy_of(pose[:3, :3])))
