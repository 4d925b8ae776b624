"""The robot's surface on a page: few meshes, sent only as far as they move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.rotations import quaternion
from denoc_ros.types import Array
from denoc_ros.viewer.bending import Bending, Shape, strain_colours
from denoc_ros.viewer.outline import STEEL, Colour, LinkSurface

BANDS = 15  # of colour; a mesh of the page has one colour
BLOCK = 32  # triangles that a band grows by: its buffers seldom change their size
LIGHT = 500  # triangles of an outline up to which moving its vertices costs less than its pose
GHOST: Colour = (120, 140, 165)
GHOST_OPACITY = 0.22
GHOST_SIZE = 0.985  # of the link: out of sight where it does not bend


class Surfaces:
    """The robot and its undeflected ghost.

    Parameters
    ----------
    robot : Robot
        Not shared with another thread.
    folder : path, optional
        Where relative names of mesh files start.
    """

    def __init__(self, scene: Any, robot: Robot, folder: Path | None = None) -> None:
        self.bending = Bending(robot, folder)
        self._bands = _Bands(scene, self.bending) if self.bending.flexible else None
        self._rigid = _RigidLinks(scene, 'links', self.bending.rigid)
        self._ghost = None
        if self.bending.flexible:
            self._everything = (
                *self.bending.rigid,
                *(part.outline for part in self.bending.flexible),
            )
            smaller = [_shrunk(outline) for outline in self._everything]
            self._ghost = _RigidLinks(scene, 'ghost', smaller, GHOST, GHOST_OPACITY)
        self._ghost_drawn = True

    def draw(self, shape: Shape, strains: Sequence[Array], limit: float | None) -> None:
        """Move everything; strains (v,) are coloured up to a limit, None: not coloured."""
        self._rigid.move(shape.poses)
        if self._bands is not None:
            self._bands.draw(shape.surfaces, strains, limit)

    def draw_ghost(self, still: Mapping[str, Array] | None) -> None:
        """Move the ghost to the poses of undeflected links; None: it is not shown."""
        if self._ghost is None:
            return
        if (still is not None) != self._ghost_drawn:
            self._ghost_drawn = still is not None
            self._ghost.show(self._ghost_drawn)
        if still is not None:
            self._ghost.move(np.array([still[part.link] for part in self._everything]))


class _Bands:
    """Bent surfaces as one mesh per colour: a triangle is in that of its strain."""

    def __init__(self, scene: Any, bending: Bending) -> None:
        first = np.cumsum([0, *(part.vertices for part in bending.flexible)])
        parts = zip(bending.flexible, first, strict=False)
        self._faces = np.vstack([part.faces + k for part, k in parts])
        levels = strain_colours(np.linspace(-1.0, 1.0, BANDS), 1.0)
        colours: list[Colour] = [(int(r), int(g), int(b)) for r, g, b in levels]
        colours.append(STEEL)
        self._meshes = [
            _Mesh(scene, f'/robot/band_{k}', colour) for k, colour in enumerate(colours)
        ]

    def draw(
        self, surfaces: Sequence[Array], strains: Sequence[Array], limit: float | None
    ) -> None:
        corners = np.concatenate(surfaces).astype(np.float32)[self._faces]
        band = np.full(len(corners), BANDS)
        if limit is not None:
            strain = np.concatenate(strains)[self._faces].mean(axis=1)
            share = np.clip(strain / limit, -1.0, 1.0) if limit > 0.0 else 0.0 * strain
            band = np.round(0.5 * (share + 1.0) * (BANDS - 1)).astype(int)
        order = np.argsort(band, kind='stable')
        ends = np.searchsorted(band[order], np.arange(BANDS + 2))
        for k, mesh in enumerate(self._meshes):
            mesh.draw(corners[order[ends[k] : ends[k + 1]]])


class _Mesh:
    """Triangles of one colour whose number changes."""

    def __init__(self, scene: Any, name: str, colour: Colour) -> None:
        self._size = 0
        corners, faces = np.zeros((3, 3), np.float32), np.array([[0, 1, 2]])
        self._handle = scene.add_mesh_simple(
            name, corners, faces, color=colour, flat_shading=True, side='double'
        )

    def draw(self, corners: NDArray[np.float32]) -> None:
        count = len(corners)
        if not count and not self._size:
            return
        size = -(-count // BLOCK) * BLOCK
        padded = np.zeros((size or 1, 3, 3), np.float32)
        padded[:count] = corners
        if count:
            padded[count:] = corners[-1, 0]  # no area, and within the rest
        self._handle.vertices = padded.reshape(-1, 3)
        if size != self._size:
            self._handle.faces = np.arange(3 * len(padded), dtype=np.uint32).reshape(-1, 3)
            self._size = size


class _RigidLinks:
    """Outlines that only move: light ones together by their colour, heavy ones by their pose."""

    def __init__(
        self,
        scene: Any,
        name: str,
        parts: Sequence[LinkSurface],
        colour: Colour | None = None,
        opacity: float | None = None,
    ) -> None:
        light: dict[Colour, list[int]] = {}
        self._heavy = []
        self._handles = []
        for k, part in enumerate(parts):
            own = colour or part.colour
            if len(part.faces) <= LIGHT:
                light.setdefault(own, []).append(k)
                continue
            handle = scene.add_mesh_simple(
                f'/{name}/{k}', part.vertices, part.faces, color=own, opacity=opacity
            )
            self._heavy.append((k, handle))
            self._handles.append(handle)
        self._light = [
            _Together(scene, f'/{name}/together_{k}', parts, members, own, opacity)
            for k, (own, members) in enumerate(light.items())
        ]
        self._handles += [group.handle for group in self._light]

    def move(self, poses: Array) -> None:
        for group in self._light:
            group.move(poses)
        for k, handle in self._heavy:
            handle.position = poses[k, :3, 3]
            handle.wxyz = quaternion(poses[k, :3, :3])[[3, 0, 1, 2]]

    def show(self, visible: bool) -> None:
        for handle in self._handles:
            handle.visible = visible


class _Together:
    """Light outlines as one mesh."""

    def __init__(
        self,
        scene: Any,
        name: str,
        parts: Sequence[LinkSurface],
        members: Sequence[int],
        colour: Colour,
        opacity: float | None,
    ) -> None:
        self._own = np.repeat(members, [len(parts[k].vertices) for k in members])
        self._vertices = np.vstack([parts[k].vertices for k in members])
        first = np.cumsum([0, *(len(parts[k].vertices) for k in members)])
        pairs = zip(members, first, strict=False)
        faces = np.vstack([parts[k].faces + start for k, start in pairs])
        self.handle = scene.add_mesh_simple(
            name, self._vertices, faces, color=colour, opacity=opacity, flat_shading=True
        )

    def move(self, poses: Array) -> None:
        own = poses[self._own]
        placed = np.einsum('vij,vj->vi', own[:, :3, :3], self._vertices) + own[:, :3, 3]
        self.handle.vertices = placed.astype(np.float32)


def _shrunk(outline: LinkSurface) -> LinkSurface:
    middle = 0.5 * (outline.vertices.min(axis=0) + outline.vertices.max(axis=0))
    return replace(outline, vertices=middle + GHOST_SIZE * (outline.vertices - middle))
