"""Outer size of a link across an axis, from its visual and collision geometry."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from denoc_ros.model.inertia import inverse_transform
from denoc_ros.model.reading.findings import Element, Findings, Reader
from denoc_ros.model.reading.link_geometry import SHAPE_TAGS, mesh_of, placed_shapes
from denoc_ros.types import Array

ALIGNED = 0.98  # cosine: within 11 degrees of an axis is along it
COVERED = 0.5  # of the beam: a shorter shape is a motor or a flange, not the link
STATIONS = (0.35, 0.45, 0.55, 0.65)  # of the beam: where a mesh is cut, clear of its joints
ROUND = 0.2  # of the larger side: what a round mesh's sides may differ by
TAPER = (0.1, 0.3, 0.5, 0.7, 0.9)  # of the beam: where a taper is measured
BESIDE = 0.03  # of the beam: cuts on both sides of these, so that no rib is taken for it
TAPERED = 0.1  # of a side, between its largest and smallest: less is a prism
EVEN = 0.03  # of a side: by which a taper may widen on its way
ENDS = 0.5  # of the nearest side: what a taper keeps beyond the last cut


@dataclass(frozen=True)
class Outline:
    """Outer size across a beam."""

    # sides along the beam's y and z, of its middle [m]
    y: float
    z: float
    circular: bool
    origin: str  # cylinder | box | mesh
    # (share, y, z): sides at shares of the length, from 0 to 1; empty for a prism
    taper: tuple[tuple[float, float, float], ...] = ()


def outline(
    link: Element, frame: Array, length: float, surfaces: Mapping[str, Any]
) -> Outline | None:
    """Return a link's outer size across a beam.

    Parameters
    ----------
    frame : ndarray (4, 4)
        Beam frame seen from the link frame.
    length : float
        Of the beam [m].
    surfaces : mapping
        As of `link_surfaces`.

    Returns
    -------
    Outline or None
        Of the first shape that runs along most of the beam: visual before collision, primitives
        before meshes. None without one; meshes that cannot be read count as none.
    """
    back = inverse_transform(frame)
    shapes = [shape for tag in SHAPE_TAGS for shape in placed_shapes(link.findall(tag))]
    for readers in ((_cylinder, _box), (_mesh,)):
        for of_link, geometry in shapes:
            pose = back @ of_link
            for read in readers:
                found = read(geometry, pose, length, surfaces)
                if found is not None:
                    return found
    return None


def _cylinder(
    geometry: Element, pose: Array, length: float, surfaces: Mapping[str, Any]
) -> Outline | None:
    element = geometry.find('cylinder')
    if element is None or abs(pose[0, 2]) < ALIGNED:
        return None
    findings = Findings()
    reader = Reader(element, '', findings)
    diameter = 2.0 * reader.number('radius', 'm', above=0.0)
    if findings.items or reader.number('length', 'm', above=0.0) < COVERED * length:
        return None
    return Outline(diameter, diameter, True, 'cylinder')


def _box(
    geometry: Element, pose: Array, length: float, surfaces: Mapping[str, Any]
) -> Outline | None:
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


def _mesh(
    geometry: Element, pose: Array, length: float, surfaces: Mapping[str, Any]
) -> Outline | None:
    mesh = mesh_of(geometry, pose, surfaces)
    return None if mesh is None else _cut(mesh, length)


def _cut(mesh: Any, length: float) -> Outline | None:
    """Return the median outer size of cuts across the beam's middle, and its taper."""
    middle = _sides(mesh, length, STATIONS)
    if len(middle) < 0.5 * len(STATIONS):
        return None
    y, z = (float(side) for side in np.median(middle, axis=0))
    return Outline(y, z, abs(y - z) <= ROUND * max(y, z), 'mesh', _taper(mesh, length))


def _sides(mesh: Any, length: float, shares: Iterable[float]) -> Array:
    """Return the outer sides (k, 2) of the cuts that meet a mesh."""
    from trimesh import intersections

    sides = []
    for share in shares:
        cut: Any = intersections.mesh_plane
        lines = cut(mesh, (1.0, 0.0, 0.0), (share * length, 0.0, 0.0))
        if len(lines):
            sides.append(np.ptp(np.asarray(lines).reshape(-1, 3), axis=0)[1:])
    return np.reshape(sides, (-1, 2))


def _taper(mesh: Any, length: float) -> tuple[tuple[float, float, float], ...]:
    """Return the sides along a mesh that narrows, or widens, all along; () for another."""
    cuts = [_sides(mesh, length, (x - BESIDE, x, x + BESIDE)) for x in TAPER]
    if any(len(cut) < 2 for cut in cuts):
        return ()
    sides = np.array([np.median(cut, axis=0) for cut in cuts])
    largest, smallest = sides.max(axis=0), sides.min(axis=0)
    steps = np.diff(sides, axis=0)
    even = ((steps <= EVEN * largest).all(axis=0) | (steps >= -EVEN * largest).all(axis=0)).all()
    if not even or (smallest >= (1.0 - TAPERED) * largest).all():
        return ()
    near, far = TAPER[0] / (TAPER[1] - TAPER[0]), (1.0 - TAPER[-1]) / (TAPER[-1] - TAPER[-2])
    first = np.maximum(sides[0] - near * steps[0], ENDS * sides[0])
    last = np.maximum(sides[-1] + far * steps[-1], ENDS * sides[-1])
    rows = zip((0.0, *TAPER, 1.0), np.vstack([first, sides, last]).tolist(), strict=True)
    return tuple((share, y, z) for share, (y, z) in rows)
