"""Outer size of a link across an axis, from its visual and collision geometry."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.errors import ModelError
from denoc_ros.model.findings import Element, Findings, Reader
from denoc_ros.model.inertia import inverse_transform
from denoc_ros.model.mesh_files import mesh_file, read_surface
from denoc_ros.types import Array

ALIGNED = 0.98  # cosine: within 11 degrees of an axis is along it
COVERED = 0.5  # of the beam: a shorter shape is a motor or a flange, not the link
STATIONS = (0.35, 0.45, 0.55, 0.65)  # of the beam: where a mesh is cut, clear of its joints
ROUND = 0.2  # of the larger side: what a round mesh's sides may differ by


@dataclass(frozen=True)
class Outline:
    """Outer sides of a cross-section along the beam's y and z [m], and where they come from."""

    y: float
    z: float
    circular: bool
    origin: str  # cylinder | box | mesh


def outline(link: Element, frame: Array, length: float, folder: Path) -> Outline | None:
    """Return a link's outer size across a beam.

    Parameters
    ----------
    link : lxml element
        `<link>`.
    frame : ndarray (4, 4)
        Beam frame seen from the link frame.
    length : float
        Of the beam [m].
    folder : Path
        Where mesh files are looked for: that of the URDF, and those above it.

    Returns
    -------
    Outline or None
        Of the first shape that runs along most of the beam: visual before collision, primitives
        before meshes. None without one; meshes that cannot be read count as none.
    """
    shapes = [
        shape for tag in ('visual', 'collision') for shape in _shapes(link.findall(tag), frame)
    ]
    for readers in ((_cylinder, _box), (_mesh,)):
        for pose, geometry in shapes:
            for read in readers:
                found = read(geometry, pose, length, folder)
                if found is not None:
                    return found
    return None


def lost_mesh(link: Element, folder: Path) -> str:
    """Return the first of a link's meshes that is not found or not readable, '' if none is."""
    for mesh in link.iterfind('.//geometry/mesh'):
        filename = str(mesh.get('filename', ''))
        if _read_mesh(filename, folder) is None:
            return filename
    return ''


def _shapes(elements: list[Element], frame: Array) -> Iterator[tuple[Array, Element]]:
    """Yield each geometry with its pose seen from the beam frame."""
    for element in elements:
        findings = Findings()
        origin, geometry = element.find('origin'), element.find('geometry')
        pose = np.eye(4) if origin is None else Reader(origin, '', findings).pose()
        if geometry is not None and not findings.items:
            yield inverse_transform(frame) @ pose, geometry


def _cylinder(geometry: Element, pose: Array, length: float, folder: Path) -> Outline | None:
    element = geometry.find('cylinder')
    if element is None or abs(pose[0, 2]) < ALIGNED:
        return None
    findings = Findings()
    reader = Reader(element, '', findings)
    diameter = 2.0 * reader.number('radius', 'm', above=0.0)
    if findings.items or reader.number('length', 'm', above=0.0) < COVERED * length:
        return None
    return Outline(diameter, diameter, True, 'cylinder')


def _box(geometry: Element, pose: Array, length: float, folder: Path) -> Outline | None:
    element = geometry.find('box')
    if element is None:
        return None
    size = Reader(element, '', Findings()).vector('size')
    along = np.abs(pose[:3, :3])
    edges = along.argmax(axis=1)  # of the beam's x, y and z
    if len(set(edges)) < 3 or along.max(axis=1).min() < ALIGNED or not (size > 0.0).all():
        return None
    x, y, z = (float(size[edge]) for edge in edges)
    return Outline(y, z, False, 'box') if x >= COVERED * length else None


def _mesh(geometry: Element, pose: Array, length: float, folder: Path) -> Outline | None:
    element = geometry.find('mesh')
    if element is None:
        return None
    mesh = _read_mesh(element.get('filename', ''), folder)
    if mesh is None:
        return None
    findings = Findings()
    scale = Reader(element, '', findings).vector('scale', '1 1 1', '-')
    if findings.items:
        return None
    mesh.apply_transform(pose @ np.diag([*scale, 1.0]))
    return _cut(mesh, length)


def _read_mesh(filename: str, folder: Path) -> Any:
    """Return a mesh of trimesh, None where it is not found or not readable."""
    file = mesh_file(filename, folder)
    if file is None:
        return None
    try:
        return read_surface(file)
    except ModelError:  # a mesh is only a hint
        return None


def _cut(mesh: Any, length: float) -> Outline | None:
    """Return the median outer size of cuts across the beam's middle."""
    from trimesh import intersections

    sides = []
    for station in STATIONS:
        cut: Any = intersections.mesh_plane
        lines = cut(mesh, (1.0, 0.0, 0.0), (station * length, 0.0, 0.0))
        if len(lines):
            sides.append(np.ptp(np.asarray(lines).reshape(-1, 3), axis=0)[1:])
    if len(sides) < 0.5 * len(STATIONS):
        return None
    y, z = (float(side) for side in np.median(sides, axis=0))
    return Outline(y, z, abs(y - z) <= ROUND * max(y, z), 'mesh')
