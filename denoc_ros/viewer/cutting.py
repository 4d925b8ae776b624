"""Surfaces cut along a beam, finely enough to follow its curve."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from denoc_ros.types import Array

Indices = NDArray[np.int64]

PANELS = 20  # of a beam's length
BOX = 8, 12  # vertices and triangles
RING = ((0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1))  # of y, z in threes


def cut_along(vertices: Array, faces: Indices, length: float) -> tuple[Array, Indices]:
    """Return a surface with edges across x at equal steps, and along y = 0 and z = 0.

    Parameters
    ----------
    vertices : (v, 3) array [m], beam frame
    faces : (f, 3) int array
    length : float [m], of the beam from x = 0

    Returns
    -------
    vertices, faces
        The same surface in more triangles, every vertex once.
    """
    steps = np.linspace(0.0, length, PANELS + 1)
    if _is_upright_box(vertices, faces):
        return _box(vertices.min(axis=0), vertices.max(axis=0), steps)
    bounds = [-np.inf, *steps[1:-1], np.inf]
    pieces = [
        _above(*_above(vertices, faces, 0, low, 1.0), 0, high, -1.0)
        for low, high in itertools.pairwise(bounds)
    ]
    for axis in (1, 2):
        pieces = [_above(*piece, axis, 0.0, sign) for piece in pieces for sign in (1.0, -1.0)]
    return _merged(pieces)


def _is_upright_box(vertices: Array, faces: Indices) -> bool:
    if (len(vertices), len(faces)) != BOX:
        return False
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    near = np.minimum(np.abs(vertices - low), np.abs(vertices - high))
    return bool(near.max() <= 1e-9 * np.ptp(vertices, axis=0).max())


def _box(low: Array, high: Array, steps: Array) -> tuple[Array, Indices]:
    """Return a box of rectangles: rings of eight points across x, closed at both ends."""
    inner = steps[(steps > low[0]) & (steps < high[0])]
    x = np.array([low[0], *inner, high[0]])
    y, z = (
        np.array([low[k], 0.0 if low[k] < 0.0 < high[k] else 0.5 * (low[k] + high[k]), high[k]])
        for k in (1, 2)
    )
    around = len(RING)
    vertices = np.array([(at, y[i], z[j]) for at in x for i, j in RING])
    ends = np.array([[x[0], y[1], z[1]], [x[-1], y[1], z[1]]])
    quads = []
    for k in range(len(x) - 1):
        for i in range(around):
            a, b = around * k + i, around * k + (i + 1) % around
            quads += [(a, b + around, b), (a, a + around, b + around)]
    last, centre = around * (len(x) - 1), around * len(x)
    for i in range(around):
        j = (i + 1) % around
        quads += [(centre, i, j), (centre + 1, last + j, last + i)]
    faces = np.array(quads)[:, [0, 2, 1]]
    return np.vstack([vertices, ends]), faces


def _above(
    vertices: Array, faces: Indices, axis: int, at: float, sign: float
) -> tuple[Array, Indices]:
    """Return the part of a surface on the side of a plane that the sign says."""
    from trimesh.intersections import slice_faces_plane

    side = sign * (vertices[:, axis] - at)
    if not len(faces) or (side >= 0.0).all():
        return vertices, faces
    unit = np.eye(3)[axis]
    cut = slice_faces_plane(vertices, faces, sign * unit, unit * at)
    return np.asarray(cut[0], np.float64), np.asarray(cut[1], np.int64)


def _merged(pieces: list[tuple[Array, Indices]]) -> tuple[Array, Indices]:
    from trimesh import Trimesh

    first = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    mesh = Trimesh(
        np.vstack([vertices for vertices, _ in pieces]),
        np.vstack([faces + k for (_, faces), k in zip(pieces, first, strict=False)]),
    )
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
