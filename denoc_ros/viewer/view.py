"""One robot on a page: surfaces, arrows and loops at a moment, and the controls for them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.rotations import quaternion
from denoc_ros.simulation.recorded.snapshot import Snapshot
from denoc_ros.types import Array
from denoc_ros.units import round_up
from denoc_ros.viewer.bending import (
    PRESSED,
    STRETCHED,
    UNSTRAINED,
    Bending,
    Shape,
    exaggerated,
    strain_colours,
)
from denoc_ros.viewer.outline import STEEL, Colour, LinkSurface, joined_faces, reach
from denoc_ros.viewer.overlays import REACTION, REACTION_MOMENT, TORQUE, Overlays
from denoc_ros.viewer.page_text import boxed

BANDS = 15  # of colour; a mesh of the page has one colour
BLOCK = 32  # triangles that a band grows by: its buffers seldom change their size
LIGHT = 500  # triangles of an outline up to which moving its vertices costs less than its pose
GHOST: Colour = (120, 140, 165)
GHOST_OPACITY = 0.22
GHOST_SIZE = 0.985  # of the link: out of sight where it does not bend


class Surfaces:
    """The robot and its undeflected ghost."""

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
        parts = bending.flexible
        self._faces = joined_faces([p.faces for p in parts], [p.vertices for p in parts])
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
        counts = [len(parts[k].vertices) for k in members]
        self._own = np.repeat(members, counts)
        self._vertices = np.vstack([parts[k].vertices for k in members])
        faces = joined_faces([parts[k].faces for k in members], counts)
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


# the scene ---------------------------------------------------------------------------------------

LEAST_STRAIN = 1e-6
PARALLEL = 1e-6
DISTANCE = 0.95  # of the robot's reach, times the offset
FIELD = math.radians(40.0)  # of view, upright
ASIDE = 0.15  # of the robot's reach: it stands left of the middle, beside the controls
OBLIQUE, FACING = np.array([1.1, -1.5, 0.8]), np.array([0.25, -0.25, 1.9])
LARGEST = 100.0  # deflection scale


@dataclass(frozen=True)
class ViewOptions:
    """Parts of the picture to draw, and their scale."""

    scale: float = 1.0  # of the deflection
    strain: bool = True  # coloured
    ghost: bool = True
    torques: bool = True
    reactions: bool = False
    loops: bool = True


@dataclass(frozen=True)
class Legend:
    """Values of the colours' ends and of the longest arrows; 0 where there is none yet."""

    strain: float  # [-] at the ends of the colours
    torque: float  # [N m, N] of the longest arrow
    force: float  # [N]
    moment: float  # [N m]
    held: bool = False  # reactions are those of joints that stand still


class View:
    """A robot in viser's scene.

    Parameters
    ----------
    robot : Robot
        Not shared with another thread.
    """

    def __init__(self, server: Any, robot: Robot, folder: Path | None = None) -> None:
        self.robot = robot
        self._surfaces = Surfaces(server.scene, robot, folder)
        self._overlays = Overlays(server.scene, robot)
        self._limit = 0.0
        self._camera = server.initial_camera
        self._stand(server)

    @property
    def bends(self) -> bool:
        """Whether any link does."""
        return bool(self._surfaces.bending.flexible)

    def forget_strain(self) -> None:
        """Forget the largest strain: a mode bends the robot more than any motion before."""
        self._limit = 0.0

    def draw(self, moment: Snapshot, look: ViewOptions) -> Legend:
        """Draw a moment."""
        robot, bending = self.robot, self._surfaces.bending
        drawn = exaggerated(robot, moment.q, look.scale)
        strains = bending.strains(moment.q)
        largest = max((float(np.abs(strain).max(initial=0.0)) for strain in strains), default=0.0)
        self._limit = (
            max(self._limit, round_up(largest)) if largest > LEAST_STRAIN else self._limit
        )
        self._surfaces.draw(bending.at(drawn), strains, self._limit if look.strain else None)
        still = bending.poses(exaggerated(robot, moment.q, 0.0)) if look.ghost else None
        self._surfaces.draw_ghost(still)
        self._draw_overlays(moment, look, drawn)
        arrows = self._overlays
        return Legend(
            self._limit if look.strain else 0.0,
            arrows.torques.largest if look.torques else 0.0,
            arrows.forces.largest if look.reactions else 0.0,
            arrows.moments.largest if look.reactions else 0.0,
            look.reactions and moment.torque is None,
        )

    def _draw_overlays(self, moment: Snapshot, look: ViewOptions, drawn: Array) -> None:
        overlays = self._overlays
        if look.torques:
            overlays.draw_torques(moment, drawn)
        else:
            overlays.torques.hide()
        if look.reactions:
            overlays.draw_reactions(moment, drawn)
        else:
            overlays.hide_reactions()
        overlays.draw_loops(drawn if look.loops else None)

    def _stand(self, server: Any) -> None:
        """Put the ground under the robot and choose from where to look."""
        robot, size = self.robot, reach(self.robot)
        up = (
            -robot.gravity / np.linalg.norm(robot.gravity) if robot.gravity.any() else np.eye(3)[2]
        )
        axis = np.eye(3)[int(np.argmax(np.abs(up)))] * np.sign(up[np.argmax(np.abs(up))])
        server.scene.set_up_direction(tuple(float(x) for x in axis))
        facing = flat_direction(robot)
        if facing is None or abs(facing @ axis) > PARALLEL:
            turn = _turn_to(axis)
            offset = turn @ OBLIQUE
            server.scene.add_grid(
                '/ground',
                width=4.0 * size,
                height=4.0 * size,
                cell_size=round_up(size / 5.0),
                section_size=5.0 * round_up(size / 5.0),
                plane=('yz', 'xz', 'xy')[int(np.argmax(np.abs(axis)))],
                position=tuple(float(x) for x in -0.02 * size * axis),
            )
        else:
            side = np.cross(axis, facing)
            offset = FACING @ np.array([side, axis, facing])
        self._up, self._offset = axis, offset

    def face(self, configurations: Array) -> None:
        """Put the camera of browsers to come where it sees configurations (k, n)."""
        frames = list(self.robot.tree.frames)
        places = np.reshape(
            [[self.robot.frame_pose(frame, q)[:3, 3] for frame in frames] for q in configurations],
            (-1, 3),
        )
        low, high = places.min(axis=0), places.max(axis=0)
        size = max(reach(self.robot), float(np.linalg.norm(high - low)))
        sideways = np.cross(-self._offset, self._up)
        aim = (low + high) / 2.0 + ASIDE * size * sideways / np.linalg.norm(sideways)
        camera = self._camera
        camera.up = tuple(float(x) for x in self._up)
        camera.position = tuple(float(x) for x in aim + DISTANCE * size * self._offset)
        camera.look_at = tuple(float(x) for x in aim)
        camera.fov = FIELD


def flat_direction(robot: Robot) -> Array | None:
    """Return the common direction of a planar robot's joints, None for one that is not."""
    zero = np.zeros(robot.n)
    axes = [
        robot.frame_pose(body.name, zero)[:3, :3] @ body.joint.axis
        for body in robot.tree.bodies
        if body.joint is not None and body.joint.kind.name == 'REVOLUTE'
    ]
    if not axes or max(np.linalg.norm(np.cross(axes[0], axis)) for axis in axes) > PARALLEL:
        return None
    return np.asarray(axes[0])


def _turn_to(axis: Array) -> Array:
    """Return a rotation that takes z to one of the coordinate axes, or its opposite."""
    other = np.eye(3)[(int(np.argmax(np.abs(axis))) + 1) % 3]
    return np.column_stack([other, np.cross(axis, other), axis])


class Controls:
    """Slider, toggles and legend.

    Parameters
    ----------
    changed : callable
        Called, in a thread of viser's, when the user changes something.
    """

    def __init__(self, gui: Any, look: ViewOptions, changed: Callable[[], None]) -> None:
        def checkboxes(**texts: str) -> dict[str, Any]:
            return {
                name: gui.add_checkbox(text, getattr(look, name)) for name, text in texts.items()
            }

        with gui.add_folder('Deflection', order=10.0):
            scale = min(max(look.scale, 1.0), LARGEST)
            hint = 'Factor that enlarges the drawn deflections'
            slider = gui.add_slider('Scale', 1.0, LARGEST, 0.5, scale, hint=hint)
            shown = checkboxes(strain='Colour by strain', ghost='Undeflected ghost')
            self._legend = gui.add_html('')
        with gui.add_folder('Forces', order=20.0):
            shown |= checkboxes(
                torques='Joint torques', reactions='Reactions', loops='Loop joints'
            )
            self._arrows = gui.add_html('')
        self._handles = {'scale': slider, **shown}
        for handle in self._handles.values():
            handle.on_update(lambda _: changed())

    @property
    def look(self) -> ViewOptions:
        """View options that the user has chosen."""
        return ViewOptions(**{name: handle.value for name, handle in self._handles.items()})

    def explain(self, legend: Legend) -> None:
        """Explain the colours and arrows."""
        _put(self._legend, _colour_bar(legend.strain) if legend.strain else '')
        lines = [
            f'<div><span style="color:{_css(colour)}">➜</span> {text.format(value)}</div>'
            for colour, text, value in (
                (TORQUE, 'torque, longest {:.3g} N m (N)', legend.torque),
                (REACTION, 'force, longest {:.3g} N', legend.force),
                (REACTION_MOMENT, 'moment, longest {:.3g} N m', legend.moment),
            )
            if value
        ]
        if legend.held:
            lines.append('<div>no torques are known: reactions are those of held joints</div>')
        _put(self._arrows, boxed(''.join(lines)) if lines else '')


def _put(handle: Any, text: str) -> None:
    if handle.content != text:
        handle.content = text


def _css(colour: tuple[int, int, int]) -> str:
    return f'rgb{colour}'


def _colour_bar(limit: float) -> str:
    ends = f'{limit * 1e6:g}'
    bar = (
        f'<div style="height:0.8em;border-radius:3px;background:linear-gradient(to right,'
        f'{_css(PRESSED)},{_css(UNSTRAINED)},{_css(STRETCHED)})"></div>'
    )
    row = '<div style="display:flex;justify-content:space-between">{}</div>'
    numbers = ''.join(f'<span>{text}</span>' for text in (f'−{ends}', '0', f'+{ends}'))
    return boxed('bending strain [µm/m]' + bar + row.format(numbers))
