"""Readers of foreign meshes and outlines, for a process of their own.

Read by `denoc_ros.child_reader`. No file that another file names is opened: readers get an open
file, and nothing that finds others.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np

VOLUME_FORMATS = ('.msh', '.inp', '.bdf', '.nas', '.mesh')  # text or plain bytes
OUTLINE_FORMATS = ('.dxf',)


def read(file: str) -> dict[str, Any]:
    """Return the arrays of a file, by its suffix."""
    logging.disable(logging.CRITICAL)
    suffix = Path(file).suffix.lower()
    if suffix in OUTLINE_FORMATS:
        return _outline(file, suffix)
    return _volume(file) if suffix in VOLUME_FORMATS else _surface(file, suffix)


def _surface(file: str, suffix: str) -> dict[str, Any]:
    """Return vertices (v, 3) and triangles (f, 3); the parts of a scene are one mesh."""
    import trimesh

    with open(file, 'rb') as opened:
        mesh: Any = trimesh.load(
            opened, file_type=suffix[1:], force='mesh', skip_materials=True, resolver=None
        )
    if not isinstance(mesh, trimesh.Trimesh):
        return {'vertices': np.zeros((0, 3)), 'faces': np.zeros((0, 3), dtype=np.int64)}
    return {
        'vertices': np.asarray(mesh.vertices, dtype=np.float64),
        'faces': np.asarray(mesh.faces, dtype=np.int64),
    }


def _outline(file: str, suffix: str) -> dict[str, Any]:
    """Return corners (k, 2) of closed lines, one line behind another, and how many each has."""
    import trimesh

    with open(file, 'rb') as opened:
        path: Any = trimesh.load_path(opened, file_type=suffix[1:])
    rings = [
        np.asarray(ring.coords)[:-1, :2]
        for each in path.polygons_full  # closed lines, holes found
        for ring in (each.exterior, *each.interiors)
    ]
    return {
        'corners': np.vstack([np.zeros((0, 2)), *rings]),
        'counts': np.array([len(ring) for ring in rings], dtype=np.int64),
    }


def _volume(file: str) -> dict[str, Any]:
    """Return points, tetrahedra by their corners, and the kinds of all other solids."""
    import meshio

    mesh: Any = meshio.read(file)
    kinds = ('tetra', 'tetra10')
    blocks = [block.data[:, :4] for block in mesh.cells if block.type in kinds]
    other = {block.type for block in mesh.cells if block.dim == 3} - set(kinds)
    return {
        'points': np.asarray(mesh.points, dtype=np.float64),
        'tetrahedra': np.vstack([np.zeros((0, 4), dtype=np.int64), *blocks]).astype(np.int64),
        'other': np.array(sorted(other), dtype=np.str_),
    }
