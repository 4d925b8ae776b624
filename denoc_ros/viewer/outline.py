"""Undeformed shape of links: the URDF's visuals, or simple bodies without visuals."""

from __future__ import annotations

import io
import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ModelError
from denoc_ros.model.arrays import is_flexible
from denoc_ros.model.reading.mesh_files import mesh_file, named_surfaces
from denoc_ros.model.reading.source import TEXT_NAME, parse_xml
from denoc_ros.types import Array

Indices = NDArray[np.int64]
Colour = tuple[int, int, int]

STEEL: Colour = (146, 161, 178)  # of links without a material
DARK: Colour = (92, 101, 112)  # of links without a visual
SLENDERNESS = 40.0  # of a beam without a visual: length over thickness
SLIGHT = 0.012  # of the robot's reach: radius of a rigid link without a visual

SHOWN_MISSING = 3  # names of meshes that are nowhere

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LinkSurface:
    """The surface of a link."""

    link: str
    vertices: Array  # (v, 3) [m], in the link frame
    faces: Indices  # (f, 3) int triangles of vertices
    colour: Colour


def joined_faces(faces: Sequence[Indices], vertices: Sequence[int]) -> Indices:
    """Return triangles of surfaces of so many vertices each, one behind another."""
    first = np.cumsum([0, *vertices])
    return np.vstack([part + start for part, start in zip(faces, first, strict=False)])


def outlines(robot: Robot, folder: Path | None = None) -> list[LinkSurface]:
    """Return the surfaces of a robot's links.

    Parameters
    ----------
    folder : path, optional
        Where relative names of mesh files start. `package://` is looked for in the prefixes of
        AMENT_PREFIX_PATH and above that folder; nothing is fetched from a network.

    Returns
    -------
    list of LinkSurface
        One per visual, in file order. A link without a visual that can be drawn gets a beam of its
        length, or rods to the joints that it carries.
    """
    tell_missing_meshes(robot, folder)
    root = parse_xml(TEXT_NAME, robot.tree.source)
    surfaces = named_surfaces(_mesh_names(root), folder)
    drawn: list[LinkSurface] = []
    for link in root.findall('link'):
        name = link.get('name')
        found = list(_visuals(root, link, surfaces))
        drawn += found or _substitute(robot, root, name)
    return drawn


def tell_missing_meshes(robot: Robot, folder: Path | None = None) -> None:
    """Log in one line, once per robot, which visuals' meshes are nowhere; arguments as above."""
    root = parse_xml(TEXT_NAME, robot.tree.source)
    names = _mesh_names(root)
    missing = tuple(name for name in names if mesh_file(name, folder) is None)
    if missing:
        _tell_missing(len(names), missing)


def _mesh_names(root: Any) -> dict[str, None]:
    """Return the names of all visuals' meshes, each once, in file order."""
    meshes = root.iterfind('link/visual/geometry/mesh')
    return dict.fromkeys(mesh.get('filename') or '' for mesh in meshes)


@cache
def _tell_missing(count: int, missing: tuple[str, ...]) -> None:
    shown = ', '.join(missing[:SHOWN_MISSING]) + (', …' if len(missing) > SHOWN_MISSING else '')
    log.warning(
        'meshes must be files here, got none for %d of %d, drawn as beams and rods: %s',
        len(missing), count, shown,
    )  # fmt: skip


def reach(robot: Robot) -> float:
    """Return the size of a robot [m]: of the box around its frames and beams, undeformed."""
    zero = np.zeros(robot.n)
    points = [np.zeros(3)]
    for frame in robot.tree.frames:
        points.append(robot.frame_pose(frame, zero)[:3, 3])
    for body in robot.tree.bodies:
        if body.beam is not None and body.segment == 1:
            pose = robot.frame_pose(body.name, zero) @ body.frame
            points.append(pose[:3, 3] + body.beam.whole_length * pose[:3, 0])
    return float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0


def _visuals(root: Any, link: Any, surfaces: Mapping[str, Any]) -> Iterator[LinkSurface]:
    from yourdfpy import URDF  # as in model.rigid_urdf: it takes most of a second

    bare = etree.Element('robot', name='visuals')
    bare.extend(_copies(root.findall('material')))
    own = etree.SubElement(bare, 'link', name=link.get('name'))
    own.extend(_copies(link.findall('visual')))
    text = io.BytesIO(etree.tostring(bare, encoding='utf-8'))
    try:
        robot = URDF.load(text, build_scene_graph=False, load_meshes=False).robot
        colours = {m.name: m.color for m in robot.materials if m.color is not None}
        for visual in robot.links[0].visuals:
            mesh = _mesh(visual.geometry, surfaces)
            if mesh is None or not len(mesh.faces):
                continue
            if visual.origin is not None:
                mesh.apply_transform(visual.origin)
            vertices = np.asarray(mesh.vertices, dtype=np.float64)
            faces = np.asarray(mesh.faces, dtype=np.int64)
            yield LinkSurface(own.get('name'), vertices, faces, _colour(visual.material, colours))
    except Exception as error:  # what a picture is made of is nothing to fail for
        log.warning('link %r: its visual cannot be drawn: %s', own.get('name'), error)


def _copies(elements: list[Any]) -> list[Any]:
    return [etree.fromstring(etree.tostring(element)) for element in elements]


def _mesh(geometry: Any, surfaces: Mapping[str, Any]) -> Any:
    """Return a visual's trimesh, None for one that is nowhere; ModelError for a bad one."""
    import trimesh

    if geometry.box is not None:
        return trimesh.creation.box(extents=geometry.box.size)
    if geometry.cylinder is not None:
        shape = geometry.cylinder
        return trimesh.creation.cylinder(radius=shape.radius, height=shape.length, sections=24)
    if geometry.sphere is not None:
        return trimesh.creation.icosphere(subdivisions=2, radius=geometry.sphere.radius)
    surface = surfaces.get(geometry.mesh.filename)
    if surface is None:  # told once for all
        return None
    if isinstance(surface, ModelError):
        raise surface
    mesh = surface.copy()
    if geometry.mesh.scale is not None:
        mesh.apply_scale(geometry.mesh.scale)
    return mesh


def _colour(material: Any, known: dict[str, Any]) -> Colour:
    if material is None:
        return STEEL
    colour = material.color or known.get(material.name)
    if colour is None:
        return STEEL
    red, green, blue = (round(255.0 * min(max(float(x), 0.0), 1.0)) for x in colour.rgba[:3])
    return red, green, blue


def _substitute(robot: Robot, root: Any, link: str) -> list[LinkSurface]:
    """Substitute surfaces of a link without visuals."""
    import trimesh

    for body in robot.tree.bodies:
        if body.name == link and is_flexible(body) and body.beam is not None:
            length = body.beam.whole_length
            box = trimesh.creation.box(extents=(length, *[length / SLENDERNESS] * 2))
            box.apply_translation((length / 2.0, 0.0, 0.0))
            box.apply_transform(body.frame)
            return [_plain(link, box)]
    radius = SLIGHT * reach(robot)
    pose = np.linalg.inv(robot.frame_pose(link, np.zeros(robot.n)))
    rods = []
    for child in _children(root, link):
        end = (pose @ robot.frame_pose(child, np.zeros(robot.n)))[:3, 3]
        if np.linalg.norm(end) > radius:
            rods.append(
                trimesh.creation.cylinder(radius=radius, segment=[np.zeros(3), end], sections=16)
            )
    knob = trimesh.creation.icosphere(subdivisions=2, radius=1.6 * radius)
    return [_plain(link, mesh) for mesh in (*rods, knob)]


def _children(root: Any, link: str) -> list[str]:
    """Return the links whose joints hang on a link, and the loop frames that do."""
    joints = [
        joint.find('child').get('link')
        for joint in root.findall('joint')
        if joint.find('parent').get('link') == link
    ]
    loops = [
        f'{loop.get("name")}/{side}'
        for loop in root.findall('flexibility/loop')
        for side in ('parent', 'child')
        if loop.find(side).get('link') == link
    ]
    return joints + loops


def _plain(link: str, mesh: Any) -> LinkSurface:
    return LinkSurface(link, np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int64), DARK)
