"""Settings that all pictures of a run share: camera, exaggeration, colour scale of strain."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import StateError
from denoc_ros.types import Array
from denoc_ros.viewer.bending import Bending, exaggerated, strain_colours
from denoc_ros.viewer.outline import joined_faces, reach

Indices = NDArray[np.int64]

LOOKED_AT = 48  # instants that decide what the pictures have to hold
STRAINS_LOOKED_AT = 500  # instants that the largest strain is taken from
SCALES = (1, 2, 5, 10, 20, 50, 100)
SHOWN = 0.1  # of the robot's reach: what a chosen scale exaggerates the deflection to, at most
NEGLIGIBLE = 1e-9  # of the reach: rounding, no deflection
FARTHEST = 1e6  # m
CLOSED = 1e-6  # of a surface's area: what the sum of its area vectors may be
TINY = 1e-300
AMBIENT = 0.55  # of the light: what comes from everywhere
LIGHT = np.array([-0.34, 0.54, 0.77])  # where the rest comes from: right, up, towards the eye
FLAT = 0.2  # of the second widest extent: what is narrower than that is seen from its flat side
AUTO = 'auto'
# What is to the right and what is up, base axes.
VIEWS = {
    'side': ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    'top': ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    'front': ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    'iso': ((0.8, 0.6, 0.0), (-0.3, 0.4, 0.75**0.5)),
}
LOOKS_ALONG = ('front', 'side', 'top')  # x, y, z


@dataclass(frozen=True)
class Triangles:
    """Triangles of a robot in a picture, the rearmost first."""

    corners: Array  # (f, 3, 2) right and up [m]
    colours: Array  # (f, 3) red, green, blue of 0 .. 1, shaded.


class SceneSetup:
    """How a robot is put in the picture.

    Parameters
    ----------
    robot : Robot
        Its workspace is used.
    states : (k, n) array
        All that is to be shown; some of it decides what is left open.
    scale : float
        What deflections are drawn larger by; 0: chosen so that they are seen.

    Attributes
    ----------
    low, high : (3,) arrays
        The box around all that is shown: right, up, towards the eye [m].
    box : pair of (3,) arrays
        The same along the base axes, with the base in it [m].
    strain : float
        Largest bending strain [-]; 0 where nothing bends.

    Raises
    ------
    StateError
        The robot comes too far from its base for a picture.
    """

    def __init__(
        self,
        robot: Robot,
        states: Array,
        scale: float = 0.0,
        view: str = AUTO,
        folder: Path | None = None,
    ) -> None:
        self._robot = robot
        self._bending = Bending(robot, folder)
        self._faces, self._outward = self._all_faces()
        some = states[np.linspace(0, len(states) - 1, min(LOOKED_AT, len(states))).astype(int)]
        straight = np.array([self.vertices(q, 0.0) for q in some])
        self.scale = scale or self._chosen_scale(some, straight)
        bent = np.array([self.vertices(q) for q in some])
        instants = np.concatenate([straight, bent])
        every = instants.reshape(-1, 3)
        if not np.abs(every).max(initial=0.0) <= FARTHEST:
            raise StateError(
                f'{robot.tree.name}: what is drawn must be within {FARTHEST:g} m of the base, '
                f'got {np.abs(every).max():g} m'
            )
        self.box = (np.minimum(every.min(axis=0), 0.0), np.maximum(every.max(axis=0), 0.0))
        self.camera: Camera = camera(view, instants)
        seen = self.camera.project(every)
        self.low, self.high = seen.min(axis=0), seen.max(axis=0)
        more = states[:: max(1, len(states) // STRAINS_LOOKED_AT)]
        strains = [strain for q in more for strain in self._bending.strains(q)]
        self.strain = max((float(np.abs(each).max(initial=0.0)) for each in strains), default=0.0)

    @property
    def flexible(self) -> bool:
        """Whether anything can bend."""
        return bool(self._bending.flexible)

    def vertices(self, q: Array, scale: float | None = None) -> Array:
        """Return all vertices (v, 3) [m, base frame] at coordinates (n,).

        `scale` is what deflections are drawn larger by, by default that of the staging.
        """
        factor = self.scale if scale is None else scale
        shape = self._bending.at(exaggerated(self._robot, q, factor))
        rigid = [
            part.vertices @ pose[:3, :3].T + pose[:3, 3]
            for part, pose in zip(self._bending.rigid, shape.poses, strict=True)
        ]
        return np.concatenate([*rigid, *shape.surfaces])

    def robot(self, q: Array) -> Triangles:
        """Return the robot at coordinates (n,), flexible links in the colour of their strain.

        A triangle has that of the corner that is strained most.
        """
        strains = self._bending.strains(q)
        colours = [np.broadcast_to(part.colour, part.faces.shape) for part in self._bending.rigid]
        colours += [
            strain_colours(_strongest(strain[part.faces]), self.strain)
            for part, strain in zip(self._bending.flexible, strains, strict=True)
        ]
        seen = self.camera.project(self.vertices(q))[self._faces]
        normals = _normals(seen)
        # the far side of a closed surface is hidden by its near side
        shown = np.flatnonzero(self._outward * normals[:, 2] >= 0.0)
        shown = shown[np.argsort(seen[shown, :, 2].mean(axis=1))]
        tint = np.concatenate(colours)[shown] / 255.0
        shaded = np.minimum(_shade(normals[shown])[:, np.newaxis] * tint, 1.0)
        return Triangles(seen[shown, :, :2], shaded)

    def tip(self, q: Array) -> Array:
        """Return right and up (2,) [m] of the last frame of the robot at coordinates (n,)."""
        robot = self._robot
        pose = robot.frame_pose(list(robot.tree.frames)[-1], exaggerated(robot, q, self.scale))
        return self.camera.project(pose[:3, 3])[:2]

    def ghost(self, q: Array) -> Array:
        """Return the triangles (f, 3, 2) of the undeflected robot with the joints of q (n,)."""
        return self.camera.project(self.vertices(q, 0.0))[self._faces][:, :, :2]

    def _all_faces(self) -> tuple[Indices, Array]:
        """Return all triangles, and for each +1 or -1 where its corners go round seen from outside
        or inside of a closed surface, 0 where the surface is open.
        """
        flexible = self._bending.at(np.zeros(self._robot.n)).surfaces
        surfaces = [part.vertices for part in self._bending.rigid] + list(flexible)
        parts = [part.faces for part in self._bending.rigid]
        parts += [part.faces for part in self._bending.flexible]
        sides = [
            np.full(len(part), _side(surface[part]))
            for part, surface in zip(parts, surfaces, strict=True)
        ]
        return joined_faces(parts, list(map(len, surfaces))), np.concatenate(sides)

    def _chosen_scale(self, states: Array, straight: Array) -> float:
        size = reach(self._robot)
        bent = np.array([self.vertices(q, 1.0) for q in states])
        largest = float(np.linalg.norm(bent - straight, axis=2).max(initial=0.0))
        if largest <= NEGLIGIBLE * size:
            return 1.0
        return float(max((s for s in SCALES if s * largest <= SHOWN * size), default=1))


def _strongest(strains: Array) -> Array:
    """Return the strain (f,) of largest magnitude of each triangle's corners (f, 3)."""
    corner = np.argmax(np.abs(strains), axis=1)
    return np.asarray(strains[np.arange(len(strains)), corner])


def _side(corners: Array) -> float:
    """Return the sign of the volume within triangles (f, 3, 3), 0 where they enclose none."""
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if np.linalg.norm(areas.sum(axis=0)) > CLOSED * np.linalg.norm(areas, axis=1).sum():
        return 0.0
    middle = corners.mean(axis=(0, 1))
    return float(np.sign(np.sum((corners[:, 0] - middle) * areas)))


def _normals(corners: Array) -> Array:
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1), TINY)[:, np.newaxis])


def _shade(normals: Array) -> Array:
    """Return the brightness (f,) of triangles by their normals, whichever way these point."""
    brightness = AMBIENT + (1.0 - AMBIENT) * np.abs(normals @ LIGHT)
    # what faces the eye has the colours of the colour bar
    return np.asarray(brightness / (AMBIENT + (1.0 - AMBIENT) * LIGHT[2]))


@dataclass(frozen=True)
class Camera:
    """A parallel projection."""

    view: str  # one of `VIEWS`
    axes: Array  # (3, 3) rows: right, up, and towards the eye; base axes, a proper rotation

    @property
    def flat(self) -> bool:
        """Whether it looks along a base axis, so that the picture has true coordinates."""
        return self.view != 'iso'

    def project(self, points: Array) -> Array:
        """Return (..., 3): right and up in the picture, and depth towards the eye [m]."""
        return np.asarray(points @ self.axes.T)


def camera(view: str, instants: Array) -> Camera:
    """Return the camera of a view.

    Parameters
    ----------
    view : {'auto', 'side', 'top', 'front', 'iso'}
        auto: onto the plane of a motion that stays in one, or of a robot that does; else iso.
    instants : (k, v, 3) array
        Where points of the robot are at some instants [m, base frame].
    """
    chosen = best_view(instants) if view == AUTO else view
    right, up = (np.array(axis) for axis in VIEWS[chosen])
    return Camera(chosen, np.array([right, up, np.cross(right, up)]))


def best_view(instants: Array) -> str:
    """Return the view that shows the motion of points at some instants, (k, v, 3)."""
    moved = (instants - instants.mean(axis=0)).reshape(-1, 3)
    for points in (moved, instants.reshape(-1, 3)):
        extent = np.ptp(points, axis=0)
        narrow, second, _ = np.argsort(extent)
        if extent[narrow] < FLAT * extent[second]:
            return LOOKS_ALONG[narrow]
    return 'iso'
