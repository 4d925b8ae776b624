"""Tetrahedra of a link: from its closed surface by fTetWild, or from a volume mesh's file."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from trimesh import Trimesh, triangles

from denoc_ros.child_arrays import MEMORY_BYTES, arrays_of
from denoc_ros.errors import ModelError
from denoc_ros.model.reading.mesh_files import MESH_READER, read_surface
from denoc_ros.reduction import mesher
from denoc_ros.reduction.body import Rows, within
from denoc_ros.reduction.elements import Elasticity, Solid
from denoc_ros.types import Array

UNITS = {'m': 1.0, 'cm': 0.01, 'mm': 0.001, 'in': 0.0254}
# what meshing may move the surface by: of the box's diagonal, of the wall; at least, of the first
ENVELOPE, THIN_ENVELOPE, LEAST_ENVELOPE = 2e-3, 0.02, 1e-5
COARSE = 20_000  # nodes that the default edge is chosen for, where walls are thick
NODES_PER_VOLUME = 13.0  # nodes of ten-node elements in a cube of an edge's length
ON_FACE = 0.05  # of an edge: nearer to the surface is on it
LEVEL = 0.996  # cosine between a patch's face and those that continue it: 5 degrees
SIZES = (1e-3, 100.0)  # m, of a link
BARE = 8  # nodes of a patch where only nodes are known
LOST_VOLUME = 0.01  # by which the tetrahedra may miss the surface's volume, untold


@dataclass(frozen=True)
class ClosedSurface:
    """A link's surface in the link frame [m]."""

    where: str
    mesh: Trimesh
    doubts: tuple[str, ...]

    @property
    def volume(self) -> float:
        """Volume [m^3]; nan where it is not closed."""
        return float(self.mesh.volume) if self.mesh.is_watertight else np.nan

    @property
    def wall(self) -> float:
        """Mean thickness [m]: twice the volume over the area."""
        return 2.0 * abs(float(self.mesh.volume)) / float(self.mesh.area)

    def default_edge(self) -> float:
        """Return the edge's length [m] for two elements through a wall, or COARSE nodes."""
        coarse = (NODES_PER_VOLUME * abs(float(self.mesh.volume)) / COARSE) ** (1.0 / 3.0)
        return float(max(0.5 * self.wall, coarse))


def closed_surface(file: Path, pose: Array, scale: Array, close: bool) -> ClosedSurface:
    """Read a surface mesh.

    Parameters
    ----------
    file : Path
        One of `denoc_ros.model.reading.mesh_files.SURFACE_FORMATS`.
    pose : ndarray (4, 4)
        The mesh seen from the link frame [m].
    scale : ndarray (3,)
        Metres per unit of the mesh.
    close : bool
        Whether one that is not closed is taken: the mesher fills its holes.

    Raises
    ------
    ModelError
        For a file that is no mesh, a mesh that is not closed, a size that no link has.
    """
    where, mesh, doubts = str(file), read_surface(file), []
    mesh.apply_transform(pose @ np.diag([*scale, 1.0]))
    mesh.merge_vertices()
    size = float(np.linalg.norm(mesh.extents))
    if not SIZES[0] <= size <= SIZES[1]:
        rule = f'mesh must be {SIZES[0]:g} to {SIZES[1]:g} m across'
        raise ModelError(where, [f'{rule}, got {size:.4g} m; are its units right?'])
    if not mesh.is_watertight:
        _, counts = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
        loose = int(np.count_nonzero(counts != 2))
        if not close:
            rule = 'mesh must be closed: each edge must have two faces'
            got = f'{loose} of {len(counts)} edges that do not'
            raise ModelError(where, [f'{rule}, got {got}; --close lets the mesher fill holes'])
        doubts.append(f'the mesh is not closed ({loose} edges): the mesher filled its holes')
    elif mesh.volume < 0.0:
        mesh.invert()
        doubts.append('the faces of the mesh pointed inwards: turned')
    return ClosedSurface(where, mesh, tuple(doubts))


def fill(surface: ClosedSurface, edge: float, elasticity: Elasticity) -> Solid:
    """Fill a surface with tetrahedra of about an edge's length [m].

    Raises
    ------
    ModelError
        If the mesher makes none.
    """
    diagonal = float(np.linalg.norm(surface.mesh.extents))
    if not 1e-4 * diagonal < edge < diagonal:
        rule = f'edge must be > {1e-4 * diagonal:.2g} and < {diagonal:.2g} m'
        raise ModelError(surface.where, [f'{rule}, got {edge:g}'])
    envelope = min(ENVELOPE, THIN_ENVELOPE * surface.wall / diagonal)
    with tempfile.TemporaryDirectory(prefix='denoc-') as folder:
        given = Path(folder, 'surface.npz')
        np.savez(
            given,
            vertices=np.asarray(surface.mesh.vertices, dtype=np.float64),
            faces=np.asarray(surface.mesh.faces, dtype=np.int32),
            edge=edge,
            envelope=max(envelope, LEAST_ENVELOPE),
        )
        rule = 'mesh must be one that the mesher can fill'
        made = arrays_of(mesher.__file__, given, surface.where, rule)
    tetrahedra = np.asarray(made['tetrahedra'], dtype=np.int64)
    return Solid(surface.where, made['corners'], tetrahedra, elasticity)


def volume_doubts(surface: ClosedSurface, solid: Solid) -> list[str]:
    """Return a warning where tetrahedra miss the surface's volume."""
    off = solid.volume / surface.volume - 1.0
    said = f'tetrahedra have {off:+.1%} of the surface mesh’s volume: use a smaller edge'
    return [said] if abs(off) > LOST_VOLUME else []


def read_volume(file: Path, pose: Array, scale: float, elasticity: Elasticity) -> Solid:
    """Read tetrahedra of any order from a volume mesh's file; ten-node elements are made.

    Raises
    ------
    ModelError
        For a file that is no mesh, or one without tetrahedra.
    """
    where = str(file)
    rule = 'file must be a volume mesh that meshio reads'
    found = arrays_of(MESH_READER, file, where, rule, MEMORY_BYTES)
    if len(found['other']):
        rule = 'elements must be tetrahedra'
        raise ModelError(where, [f'{rule}, got {", ".join(found["other"])} among them'])
    if not len(found['tetrahedra']):
        raise ModelError(where, ['mesh must have tetrahedra, got none'])
    corners = found['points'] * scale
    return Solid(
        where,
        corners @ pose[:3, :3].T + pose[:3, 3],
        found['tetrahedra'],
        elasticity,
    )


def patch_nodes(
    nodes: Array, solid: Solid | None, radii: Mapping[str, float]
) -> Callable[[str, Array], tuple[Rows, float]]:
    """Return the chooser of the nodes of a frame's patch.

    Parameters
    ----------
    nodes : ndarray (n, 3)
        Of the body [m].
    solid : Solid or None
        Its elements, where known.
    radii : mapping
        Frame -> radius [m], '' the root's, '*' that of all others. All nodes within are taken.
        Without one: the plane face that the frame's origin is on; else nodes within the distance
        of the surface and half an edge; for bare nodes the fewest that hold a rigid body.
    """

    def choose(name: str, origin: Array) -> tuple[Rows, float]:
        radius = radii.get(name, radii.get('*'))
        if radius is not None:
            return within(nodes, origin, radius), radius
        if solid is None:
            far = np.sort(np.linalg.norm(nodes - origin, axis=1))
            radius = float(far[min(BARE, len(far)) - 1])
            return within(nodes, origin, radius), radius
        face = _Faces.of(solid)
        on, distance = face.nearest(origin)
        if distance <= ON_FACE * face.edge:
            chosen = face.level_with(on)
            return chosen, float(np.linalg.norm(nodes[chosen] - origin, axis=1).max())
        radius = distance + 0.5 * face.edge
        return within(nodes, origin, radius), radius

    return choose


@dataclass(frozen=True)
class _Faces:
    """The surface of a solid: its triangles and their normals."""

    solid: Solid
    corners: Array  # (f, 3, 3)
    normals: Array  # (f, 3)
    edge: float  # m, mean

    @classmethod
    def of(cls, solid: Solid) -> _Faces:
        corners = solid.nodes[solid.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        sides = corners - np.roll(corners, 1, axis=1)
        return cls(solid, corners, normals, float(np.linalg.norm(sides, axis=2).mean()))

    def nearest(self, point: Array) -> tuple[int, float]:
        """Return the triangle next to a point, and its distance [m]."""
        foot = triangles.closest_point(self.corners, np.tile(point, (len(self.corners), 1)))
        far = np.linalg.norm(foot - point, axis=1)
        return int(np.argmin(far)), float(far.min())

    def level_with(self, face: int) -> Rows:
        """Return the nodes of the plane region that a triangle belongs to."""
        plane = np.abs((self.corners - self.corners[face, 0]) @ self.normals[face]).max(axis=1)
        level = (self.normals @ self.normals[face] > LEVEL) & (plane < 0.2 * self.edge)
        reached = np.isin(np.arange(len(level)), face)
        while True:
            touched = np.isin(self.solid.faces, self.solid.faces[reached]).any(axis=1) & level
            if (touched == reached).all():
                break
            reached = touched
        return self._nodes(np.flatnonzero(reached))

    def _nodes(self, faces: Rows) -> Rows:
        """Return vertices of triangles and the middles of their edges."""
        facets = self.solid.mesh.boundary_facets()[faces]
        return np.asarray(np.unique(self.solid.basis.get_dofs(facets).flatten()))
