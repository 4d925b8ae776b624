"""A link as its URDF says it: frames of its joints, mesh, mass; and the block with its file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lxml import etree

from denoc_ros.errors import ConfigError, ModelError
from denoc_ros.model.findings import Element, Findings, Reader
from denoc_ros.model.mesh_files import mesh_file
from denoc_ros.model.rigid_urdf import RigidUrdf, read_rigid_urdf
from denoc_ros.model.source import parse_xml, read_source, written
from denoc_ros.model.suggest.block import appended
from denoc_ros.model.tree import JointKind, RigidInertia
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
    for joint in robot.joints:
        taken = [pose[:3, 3] for pose in frames.values()]
        if joint.parent == link and _carries(robot, joint.child):
            place = joint.origin[:3, 3]
            if not any(np.linalg.norm(place - other) < SAME_PLACE for other in taken):
                frames[joint.name] = joint.origin
    (element,) = [found for found in root.findall('link') if found.get('name') == link]
    meshes, lost = _meshes(element, file.resolve().parent)
    return LinkDescription(where, link, frames, meshes, lost, robot.links[link])


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


def block_element(link: str, file: str) -> Element:
    """Return `<flexible>` for a link; its mass is that of the file."""
    return etree.Element('flexible', link=link, file=file, inertial='file')


def with_block(file: Path, link: str, link_file: str) -> str:
    """Return a URDF's text with the link made flexible.

    Raises
    ------
    ConfigError
        If it is flexible already.
    """
    where, text = read_source(file)
    root = parse_xml(where, text, whole=True)
    for tag in ('beam', 'flexible'):
        if any(each.get('link') == link for each in root.iterfind(f'flexibility/{tag}')):
            raise ConfigError(where, [f'link {link!r} must have no <{tag}> yet, got one'])
    block = root.find('flexibility')
    if block is None:
        block = appended(root, etree.Element('flexibility'), 0)
    appended(block, block_element(link, link_file), 1)
    return written(root, text)
