"""A robot's surface, cut and bent along its beams: plain arrays for the page and for films."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.assembling import close_nearby, least_change
from denoc_ros.dynamics.elastic.deflection import CentreLine
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.structure import whole_beam
from denoc_ros.errors import StateError
from denoc_ros.kernels.constraints.closing import OPEN
from denoc_ros.model.beams.segments import whole_beams
from denoc_ros.model.tree import Body
from denoc_ros.types import Array
from denoc_ros.viewer.outline import STEEL, Colour, LinkSurface, joined_faces, outlines

Indices = NDArray[np.int64]

SAME = 1e-9  # of the beam's length: stations that are one
STEPS = 8  # of Gauss-Newton, each of which squares the error
PANELS = 20  # of a beam's length
BOX = 8, 12  # vertices and triangles
RING = ((0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1))  # of y, z in threes


def exaggerated(robot: Robot, q: Array, scale: float) -> Array:
    """Return coordinates with the amplitudes a number of times larger, loops kept closed.

    Parameters
    ----------
    scale : float
        1: as it is; 0: undeflected.

    Returns
    -------
    (n,) array
        Joints of loops move by the smallest change that closes these; they stay where they are if
        the drawn deflection is more than the mechanism can follow.
    """
    drawn: Array = q.copy()
    drawn[robot.flexible_indices] *= scale
    if scale == 1.0 or not robot.tree.loops:
        return drawn
    closed: Array = drawn.copy()
    joints = robot.joint_indices
    try:
        left = close_nearby(robot, closed, joints, least_change, OPEN, STEPS)
    except (StateError, np.linalg.LinAlgError):
        return drawn
    return closed if left <= OPEN else drawn


class BentLink:
    """The surface of a flexible link.

    Attributes
    ----------
    stations : (s,) array
        Of the cross-sections that vertices hang on [m].

    Notes
    -----
    A vertex hangs rigidly on the section of its station x (clamped to the beam): it stands at
    [x, 0, 0] + u(x) + Exp(phi(x)) r in the beam frame, with r what is left of its place. The
    bending strain there is -(r_y u_y'' + r_z u_z'').
    """

    def __init__(self, robot: Robot, outline: LinkSurface) -> None:
        self.outline, self.link, self.colour = outline, outline.link, outline.colour
        self._body = next(body for body in robot.tree.bodies if body.name == self.link)
        length = whole_beam(robot, self.link).length
        to_beam = np.linalg.inv(self._body.frame)
        vertices = outline.vertices @ to_beam[:3, :3].T + to_beam[:3, 3]
        vertices, self.faces = cut_along(vertices, outline.faces, length)
        self.vertices = len(vertices)
        on_beam = np.clip(vertices[:, 0], 0.0, length)
        self.stations, self._station = np.unique(
            np.round(on_beam / (SAME * length)) * SAME * length, return_inverse=True
        )
        self._arm = vertices - self.stations[self._station][:, None] * [1.0, 0.0, 0.0]
        self._line = CentreLine(robot, self.link, self.stations)
        self._strain = self._strain_rows()

    def _strain_rows(self) -> Array:
        """Return the strain per amplitude of its segment, (v, m)."""
        beam = self._body.beam
        assert beam is not None
        ny, nz, nt = beam.modes
        planes = [
            -arm[:, None] * part.shapes.curvatures(self._line.local)[self._station]
            for part, arm in ((beam.y, self._arm[:, 1]), (beam.z, self._arm[:, 2]))
            if part is not None and part.modes
        ]
        rows = np.hstack([*planes, np.zeros((len(self._arm), nt))])
        assert rows.shape[1] == ny + nz + nt
        return rows

    def place(self, pose: Array, q: Array) -> Array:
        """Return the vertices (v, 3) [m, base frame].

        Parameters
        ----------
        pose : (4, 4) array
            Of the link frame.
        q : (n,) array
            Coordinates, as drawn.
        """
        centre, turns = self._line.place(q)
        frame = pose @ self._body.frame
        turn = frame[:3, :3] @ turns
        at = centre @ frame[:3, :3].T + frame[:3, 3]
        arms = np.matmul(turn[self._station], self._arm[:, :, None])[:, :, 0]
        return np.asarray(at[self._station] + arms)

    def strain(self, q: Array) -> Array:
        """Return the bending strain (v,) [-] of the vertices, positive where stretched."""
        own = self._line.amplitudes(q)[self._station]
        return np.asarray(np.sum(self._strain * own, axis=1))


class MeshedLink:
    """The surface of a link reduced from finite elements, as its file has it.

    Parameters
    ----------
    body : Body
        With component modes whose file has a surface.

    Notes
    -----
    The strain is the principal one that is largest in size; without strains in the file it is 0.
    """

    def __init__(self, robot: Robot, body: Body, colour: Colour) -> None:
        assert body.modes is not None
        assert body.modes.link.surface is not None
        self._surface = body.modes.link.surface
        self.link, self.colour, self.faces = body.name, colour, self._surface.faces
        self.vertices = len(self._surface.nodes)
        self.outline = LinkSurface(body.name, self._surface.nodes, self.faces, colour)
        self._own = robot.amplitudes(body.name)

    def place(self, pose: Array, q: Array) -> Array:
        """Return the vertices (v, 3) [m, base frame]; pose (4, 4): of the link frame."""
        moved = self._surface.nodes + self._surface.phi @ q[self._own]
        return np.asarray(moved @ pose[:3, :3].T + pose[:3, 3])

    def strain(self, q: Array) -> Array:
        """Return the strain (v,) [-] of the vertices, positive where stretched."""
        if not len(self._surface.strain):
            return np.zeros(self.vertices)
        xx, yy, zz, yz, xz, xy = (self._surface.strain @ q[self._own]).T
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).transpose(2, 0, 1)
        principal = np.linalg.eigvalsh(tensor)
        return np.where(-principal[:, 0] > principal[:, 2], principal[:, 0], principal[:, 2])


@dataclass(frozen=True)
class Shape:
    """A robot as drawn at an instant."""

    poses: Array  # (k, 4, 4) of the links of `Bending.rigid`, base frame
    # tuple of (v, 3) arrays: vertices of `Bending.flexible` [m, base frame]
    surfaces: tuple[Array, ...]


class Bending:
    """The surface of a robot, rigid links apart from those that bend.

    Parameters
    ----------
    robot : Robot
        Not shared with another thread.
    """

    def __init__(self, robot: Robot, folder: Path | None = None) -> None:
        self._robot = robot
        bends = {beam.link for beam in whole_beams(robot.tree)}
        meshed = {
            body.name: body
            for body in robot.tree.bodies
            if body.modes is not None and body.modes.link.surface is not None
        }
        drawn = outlines(robot, folder)
        colours = {outline.link: outline.colour for outline in drawn}
        still = [outline for outline in drawn if outline.link not in bends | meshed.keys()]
        self.rigid = tuple(still)
        beams = [BentLink(robot, o) for o in drawn if o.link in bends]
        meshes = [
            MeshedLink(robot, body, colours.get(link, STEEL)) for link, body in meshed.items()
        ]
        self.flexible: tuple[BentLink | MeshedLink, ...] = (*beams, *meshes)
        self.links = tuple(dict.fromkeys(outline.link for outline in drawn))

    def poses(self, q: Array) -> dict[str, Array]:
        """Return the poses (4, 4) of the link frames by link at coordinates (n,)."""
        return {link: self._robot.frame_pose(link, q) for link in self.links}

    def at(self, q: Array) -> Shape:
        """Return where everything stands at coordinates (n,) (see :func:`exaggerated`)."""
        pose = self.poses(q)
        return Shape(
            np.reshape([pose[part.link] for part in self.rigid], (-1, 4, 4)),
            tuple(part.place(pose[part.link], q) for part in self.flexible),
        )

    def strains(self, q: Array) -> tuple[Array, ...]:
        """Return the bending strains (v,) of the vertices of `flexible` at coordinates (n,)."""
        return tuple(part.strain(q) for part in self.flexible)


def strain_colours(strain: Array, limit: float) -> NDArray[np.uint8]:
    """Return red, green, blue (v, 3) of strains: blue pressed, red stretched, full at a limit."""
    share = np.clip(strain / limit, -1.0, 1.0) if limit > 0.0 else np.zeros(len(strain))
    middle, ends = np.array(UNSTRAINED, float), np.array([PRESSED, STRETCHED], float)
    mixed = middle + np.abs(share)[:, None] * (ends[(share > 0.0).astype(int)] - middle)
    return np.asarray(np.round(mixed), dtype=np.uint8)


PRESSED: Colour = (33, 102, 190)
UNSTRAINED: Colour = (225, 228, 232)
STRETCHED: Colour = (200, 40, 40)


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

    vertices, faces = zip(*pieces, strict=True)
    mesh = Trimesh(np.vstack(vertices), joined_faces(faces, list(map(len, vertices))))
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
