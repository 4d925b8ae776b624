"""Visual and collision geometry of links: shapes, their meshes and the box around them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.errors import ModelError
from denoc_ros.model.reading.findings import Element, Findings, Reader
from denoc_ros.model.reading.mesh_files import named_surfaces
from denoc_ros.types import Array

SHAPE_TAGS = ('visual', 'collision')


def link_surfaces(root: Element, folder: Path | None) -> dict[str, Any]:
    """Return the meshes of all links that are found and readable, by `<mesh filename>`.

    Parameters
    ----------
    folder : Path, optional
        Where mesh files are looked for: that of the URDF, and those above it.
    """
    names = dict.fromkeys(_mesh_names(root))
    # A mesh is only a hint: one that cannot be read counts as none.
    found = named_surfaces(names, folder)
    return {name: mesh for name, mesh in found.items() if not isinstance(mesh, ModelError)}


def lost_mesh(link: Element, surfaces: Mapping[str, Any]) -> str:
    """Return the first of a link's meshes that is not found or not readable, '' if none is."""
    return next((name for name in _mesh_names(link) if name not in surfaces), '')


def _mesh_names(element: Element) -> list[str]:
    return [str(mesh.get('filename', '')) for mesh in element.iterfind('.//geometry/mesh')]


def placed_shapes(elements: list[Element]) -> Iterator[tuple[Array, Element]]:
    """Yield the geometry of each visual or collision with its pose seen from the link frame."""
    for element in elements:
        findings = Findings()
        origin, geometry = element.find('origin'), element.find('geometry')
        pose = np.eye(4) if origin is None else Reader(origin, '', findings).pose()
        if geometry is not None and not findings.items:
            yield pose, geometry


def mesh_of(geometry: Element, pose: Array, surfaces: Mapping[str, Any]) -> Any:
    """Return the mesh of a geometry, scaled and placed by a pose; None without one."""
    element = geometry.find('mesh')
    surface = None if element is None else surfaces.get(element.get('filename', ''))
    if surface is None:
        return None
    findings = Findings()
    scale = Reader(element, '', findings).vector('scale', '1 1 1', '-')
    if findings.items:
        return None
    mesh = surface.copy()
    mesh.apply_transform(pose @ np.diag([*scale, 1.0]))
    return mesh


def outer_box(link: Element, surfaces: Mapping[str, Any]) -> Array | None:
    """Return the sides (3,) [m] of the box around all shapes of a link, along its axes.

    Returns
    -------
    ndarray or None
        None if the link has no shapes, or one of them is not known.
    """
    corners: list[Array] = []
    for tag in SHAPE_TAGS:
        elements = link.findall(tag)
        found = [_ends(*shape, surfaces) for shape in placed_shapes(elements)]
        ends = [each for each in found if each is not None]
        if len(ends) < len(elements):
            return None
        corners += ends
    return np.ptp(np.vstack(corners), axis=0) if corners else None


def _ends(pose: Array, geometry: Element, surfaces: Mapping[str, Any]) -> Array | None:
    """Return the lowest and the highest corner (2, 3) of a shape, None if it is not known."""
    mesh = mesh_of(geometry, pose, surfaces)
    if mesh is not None:
        return np.asarray(mesh.bounds)
    half = _half_sides(geometry)
    if not np.isfinite(half).all():
        return None
    reach = np.abs(pose[:3, :3]) @ half
    return np.array([pose[:3, 3] - reach, pose[:3, 3] + reach])


def _half_sides(geometry: Element) -> Array:
    """Return half the sides (3,) of the box around a primitive; nan for anything else."""
    for tag in ('box', 'sphere', 'cylinder'):
        if (element := geometry.find(tag)) is not None:
            reader = Reader(element, '', Findings())
            if tag == 'box':
                return 0.5 * reader.vector('size')
            radius = reader.number('radius')
            height = radius if tag == 'sphere' else 0.5 * reader.number('length')
            return np.array([radius, radius, height])
    return np.full(3, np.nan)
