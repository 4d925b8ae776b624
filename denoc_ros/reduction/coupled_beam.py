"""A beam whose planes, twist and stretch are coupled, as finite elements in one dimension.

Each element has the offsets and the turn of its middle: Hermite polynomials for the deflection of
the shear centre, linear ones for twist and for the stretch of the centroid. Its mass is that of
four points per cross-section, which have the section's mass and its inertia about both principal
axes. Twist is free to warp.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse as sparse

from denoc_ros.errors import ModelError
from denoc_ros.model.beams.along import CONSTANT, Along
from denoc_ros.model.beams.beam_sections import SAME_STATION
from denoc_ros.model.beams.cross_sections import AXES, CENTRED, SectionAxes
from denoc_ros.model.beams.link_file import LinkFrame
from denoc_ros.model.beams.shapes import merged_edges
from denoc_ros.model.inertia import inverse_transform, moved
from denoc_ros.model.reading.flexibility import BeamElement
from denoc_ros.model.reading.poses import pose_of
from denoc_ros.model.tree import RigidInertia
from denoc_ros.reduction.body import FiniteElementBody, Patch, Rows
from denoc_ros.reduction.craig_bampton import Report
from denoc_ros.reduction.link import Reduction, Wishes, reduce_link
from denoc_ros.reduction.quadratic import turned_twice
from denoc_ros.types import Array

ELEMENTS = 128  # at least: twist of the first mode is exact to 6e-6
GAUSS = 4  # stations of an element: exact for cubics of a constant section
CORNERS = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
ON_AXIS = 1e-6  # of a direction: more is aside

RIGIDITIES, INERTIAS = ('ei_y', 'ei_z', 'gj', 'ea'), ('mass', 'polar_inertia')
# of an element's twelve rows: six of each end, displacements and turns about x, y, z
X, Y, Z, TWIST, TURN_Y, TURN_Z = (np.array([k, k + 6]) for k in range(6))


@dataclass(frozen=True)
class BeamSections:
    """Numbers of a beam's sections by the share of the length."""

    length: float
    ei_y: tuple[float, Along]
    ei_z: tuple[float, Along]
    gj: tuple[float, Along]
    mass: tuple[float, Along]
    polar_inertia: tuple[float, Along]
    ea: tuple[float, Along] | None
    axes: SectionAxes

    @classmethod
    def of(cls, element: BeamElement, inertia: RigidInertia | None) -> BeamSections:
        """Return those of a `<beam>` and its link's inertia, in the link frame.

        Raises
        ------
        ModelError
            For a beam that has not both bendings and torsion, or no mass.
        """
        whose, findings = f'beam {element.link!r}', []
        parts = {
            '<bending direction="y">': element.y,
            '<bending direction="z">': element.z,
            '<torsion>': element.torsion,
        }
        findings += [
            f'{name} must be given to reduce a beam, got none'
            for name, part in parts.items()
            if part is None
        ]
        mass, polar = element.mass_per_length, element.polar_inertia
        if inertia is not None and inertia.mass > 0.0:
            mass = inertia.mass / element.length if mass is None else mass
            whole = moved(inertia, inverse_transform(element.origin))
            polar = float(whole.inertia[0, 0]) / element.length if polar is None else polar
        for name, value, unit in (
            ('mass_per_length', mass, 'kg/m'),
            ('polar_inertia', polar, 'kg m^2/m'),
        ):
            if value is None or not value > 0.0:
                rule = f"{name} must be > 0 {unit}, given or by the link's <inertial>"
                findings.append(f'{rule}, got {value}')
        ModelError.raise_any(whose, findings)
        y, z, torsion = (
            (np.nan, CONSTANT) if part is None else (part.stiffness, part.along)
            for part in parts.values()
        )
        return cls(
            element.length,
            y,
            z,
            torsion,
            (float(mass or 0.0), element.mass_along),
            (float(polar or 0.0), element.polar_along),
            element.stretch,
            element.axes or CENTRED,
        )

    def values(self, name: str, share: Array) -> Array:
        """Return a number at shares of the length; EA that is not given is of one material."""
        if name == 'ea' and self.ea is None:
            bends = self.values('ei_y', share) + self.values('ei_z', share)
            square = self.values('polar_inertia', share) / self.values('mass', share)
            return np.asarray(bends / square)
        mean, along = getattr(self, name)
        return np.asarray(mean * along.values(share))

    @property
    def breaks(self) -> tuple[float, ...]:
        """Shares of the length where a number may jump, 0 and 1 too."""
        profiles = (self.ei_y, self.ei_z, self.gj, self.mass, self.polar_inertia)
        found: tuple[float, ...] = (0.0, 1.0)
        for along in (
            *(profile[1] for profile in profiles),
            CONSTANT if self.ea is None else self.ea[1],
            *(getattr(self.axes, name) for name in AXES),
        ):
            found = merged_edges(found, along.breaks)
        return found


@dataclass(frozen=True)
class BeamBody(FiniteElementBody):
    """A beam's nodes on its axis, whose mass is that of points of its sections.

    `motion` (3 p, N) is the displacement of the points; `pose` (4, 4) the beam frame.
    """

    points: Array = None  # type: ignore[assignment]  # (p, 3) [m]
    weights: Array = None  # type: ignore[assignment]  # (p,) [kg]
    motion: Any = None
    pose: Array = None  # type: ignore[assignment]
    sections: BeamSections = None  # type: ignore[assignment]

    @property
    def places(self) -> Array:
        """Places (p, 3) of the mass [m]."""
        return self.points

    @property
    def measure(self) -> Any:
        """Mass of the points (p, p) [kg]."""
        return sparse.diags_array(self.weights, format='csr')

    def displacement(self, values: Array) -> Array:
        """Return the points' displacement (p, 3, ...)."""
        found = np.asarray(self.motion @ values)
        return found.reshape(len(self.points), 3, *values.shape[1:])

    def slices(self, along: Array) -> list[Rows]:
        """Return the points of each cross-section."""
        return list(np.arange(len(along)).reshape(-1, len(CORNERS)))

    def line(self, patches: Sequence[Patch]) -> tuple[Array, Array]:
        """Return the ends (3,) of the beam axis."""
        origin = self.pose[:3, 3]
        return origin, origin + self.sections.length * self.pose[:3, 0]

    def strain(self, place: Array, direction: Array) -> Array:
        """Return the strain along the beam axis at a place, (N,) per unit of each row.

        Raises
        ------
        ModelError
            For a direction that is not along the axis, or a place beyond the ends.
        """
        x, y, z = (inverse_transform(self.pose) @ [*place, 1.0])[:3]
        share = x / self.sections.length
        if not -SAME_STATION <= share <= 1.0 + SAME_STATION:
            rule = f'a gauge of a beam must stand between 0 and {self.sections.length:g} m'
            raise ModelError(self.where, [f'{rule}, got {x:.4g} m along it'])
        aside = np.linalg.norm(np.cross(self.pose[:3, 0], direction)) / np.linalg.norm(direction)
        if aside > ON_AXIS:
            rule = 'a gauge of a beam must be along its axis'
            raise ModelError(self.where, [f'{rule}, got a direction {aside:.2g} aside'])
        nodes = (self.nodes - self.pose[:3, 3]) @ self.pose[:3, 0] / self.sections.length
        e = int(np.clip(np.searchsorted(nodes, share, side='right') - 1, 0, len(nodes) - 2))
        angle_y_z = self.sections.axes.values(np.array([0.5 * (nodes[e] + nodes[e + 1])]))[0]
        length = (nodes[e + 1] - nodes[e]) * self.sections.length
        shapes = _Shapes.of(angle_y_z, length, np.array([(share - nodes[e]) / np.diff(nodes)[e]]))
        centre = angle_y_z[1:3]
        row = shapes.stretch - (y - centre[0]) * shapes.curvature[0]
        row = row - (z - centre[1]) * shapes.curvature[1]
        found = np.zeros(len(self.dof_nodes))
        found[6 * e : 6 * e + 12] = row[0] @ np.kron(np.eye(4), self.pose[:3, :3].T)
        return found


@dataclass(frozen=True)
class _Shapes:
    """Motion of an element's sections at shares s (k,) of it, in the beam frame: (k, 12) each."""

    stretch: Array
    centre: tuple[Array, Array]  # deflection of the shear centre along y and z
    curvature: tuple[Array, Array]  # its second derivative
    slope: tuple[Array, Array]
    twist: Array
    twist_rate: Array
    axial: Array  # displacement of the centroid along x

    @classmethod
    def of(cls, axes: Array, length: float, s: Array) -> _Shapes:
        """Return those of an element with angle, centroid and shear centre (5,)."""
        _, centroid_y, centroid_z, shear_y, shear_z = axes
        linear = np.stack([1.0 - s, s], axis=1)
        rate = np.tile([-1.0, 1.0], (len(s), 1)) / length
        value = [1 - 3 * s**2 + 2 * s**3, 3 * s**2 - 2 * s**3]
        turn = [length * (s - 2 * s**2 + s**3), length * (s**3 - s**2)]
        value_1 = [(6 * s**2 - 6 * s) / length, (6 * s - 6 * s**2) / length]
        turn_1 = [1 - 4 * s + 3 * s**2, 3 * s**2 - 2 * s]
        value_2 = [(12 * s - 6) / length**2, (6 - 12 * s) / length**2]
        turn_2 = [(6 * s - 4) / length, (6 * s - 2) / length]

        def along_y(value: list[Array], turn: list[Array]) -> Array:
            rows = np.zeros((len(s), 12))
            rows[:, Y], rows[:, TURN_Z] = np.stack(value, axis=1), np.stack(turn, axis=1)
            rows[:, TWIST] = -shear_z * np.stack(value, axis=1)
            return rows

        def along_z(value: list[Array], turn: list[Array]) -> Array:
            rows = np.zeros((len(s), 12))
            rows[:, Z], rows[:, TURN_Y] = np.stack(value, axis=1), -np.stack(turn, axis=1)
            rows[:, TWIST] = shear_y * np.stack(value, axis=1)
            return rows

        def ends(values: Array, columns: Array) -> Array:
            rows = np.zeros((len(s), 12))
            rows[:, columns] = values
            return rows

        def of_centroid(values: Array) -> Array:
            turned = centroid_z * ends(values, TURN_Y) - centroid_y * ends(values, TURN_Z)
            return np.asarray(ends(values, X) + turned)

        return cls(
            of_centroid(rate),
            (along_y(value, turn), along_z(value, turn)),
            (along_y(value_2, turn_2), along_z(value_2, turn_2)),
            (along_y(value_1, turn_1), along_z(value_1, turn_1)),
            ends(linear, TWIST),
            ends(rate, TWIST),
            of_centroid(linear),
        )

    def at(self, axes: Array, y: Array, z: Array) -> Array:
        """Return the displacement (k, 3, 12) of points y, z (k,) of the sections."""
        _, centroid_y, centroid_z, shear_y, shear_z = axes
        aside_y, aside_z = (y - centroid_y)[:, None], (z - centroid_z)[:, None]
        along_x = self.axial - aside_y * self.slope[0] - aside_z * self.slope[1]
        along_y = self.centre[0] - (z - shear_z)[:, None] * self.twist
        along_z = self.centre[1] + (y - shear_y)[:, None] * self.twist
        return np.stack([along_x, along_y, along_z], axis=1)


def beam_body(
    where: str, sections: BeamSections, pose: Array, stations: Sequence[float]
) -> BeamBody:
    """Return a beam as finite elements.

    Parameters
    ----------
    where : str
        For errors.
    pose : ndarray (4, 4)
        The beam frame seen from the link frame.
    stations : sequence of float
        Where nodes must stand [m].
    """
    edges = merged_edges(sections.breaks, [x / sections.length for x in stations])
    x = np.concatenate(
        [
            np.linspace(a, b, int(np.ceil((b - a) * ELEMENTS - 1e-9)) + 1)[:-1]
            for a, b in pairwise(edges)
        ]
        + [np.ones(1)]
    )
    gauss, weight = np.polynomial.legendre.leggauss(GAUSS)
    share, weight = 0.5 * (gauss + 1.0), 0.5 * weight
    blocks, places, motions, masses = [], [], [], []
    for a, b in pairwise(x):
        length, at = (b - a) * sections.length, a + (b - a) * share
        axes = sections.axes.values(np.array([0.5 * (a + b)]))[0]
        shapes = _Shapes.of(axes, length, share)
        cos, sin = np.cos(axes[0]), np.sin(axes[0])
        number = {name: sections.values(name, at) for name in RIGIDITIES + INERTIAS}
        strains = (
            cos * shapes.curvature[0] + sin * shapes.curvature[1],
            cos * shapes.curvature[1] - sin * shapes.curvature[0],
            shapes.twist_rate,
            shapes.stretch,
        )
        blocks.append(
            length
            * sum(
                (strain * (weight * number[name])[:, None]).T @ strain
                for name, strain in zip(RIGIDITIES, strains, strict=True)
            )
        )
        # the inertia of a section of one material about its principal axes
        square = 2.0 * number['polar_inertia'] / number['mass']
        square = square / (number['ei_y'] + number['ei_z'])
        first, second = np.sqrt(square * number['ei_y']), np.sqrt(square * number['ei_z'])
        for corner in CORNERS:
            y = axes[1] + cos * corner[0] * first - sin * corner[1] * second
            z = axes[2] + sin * corner[0] * first + cos * corner[1] * second
            places.append(np.stack([sections.length * at, y, z], axis=1))
            motions.append(shapes.at(axes, y, z))
            masses.append(length * weight * number['mass'] / len(CORNERS))
    count = len(x)
    turned = sparse.kron(sparse.eye_array(2 * count), pose[:3, :3], format='csr')
    # points section by section, four each
    order = np.arange((count - 1) * len(CORNERS) * GAUSS).reshape(-1, len(CORNERS), GAUSS)
    order = order.transpose(0, 2, 1).ravel()
    moved_by = pose[:3, :3] @ np.concatenate(motions)[order]
    points = pose[:3, 3] + np.concatenate(places)[order] @ pose[:3, :3].T
    weights = np.concatenate(masses)[order]
    columns = 6 * np.arange(count - 1)[:, None] + np.arange(12)
    stiffness = _assembled(np.stack(blocks), columns[:, :, None], columns[:, None, :], 6 * count)
    per_point = np.repeat(columns, GAUSS * len(CORNERS), axis=0)[:, None, :]
    rows = np.arange(moved_by.size // 12).reshape(-1, 3, 1)
    displaced = _assembled(moved_by, rows, per_point, 6 * count) @ turned.T
    each = np.arange(6 * count)
    return BeamBody(
        where,
        pose[:3, 3] + np.outer(sections.length * x, pose[:3, 0]),
        sparse.csr_matrix(turned @ stiffness @ turned.T),
        sparse.csr_matrix(displaced.T @ sparse.diags_array(np.repeat(weights, 3)) @ displaced),
        each // 6,
        each % 6,
        points,
        weights,
        displaced.tocsr(),
        pose,
        sections,
    )


def _assembled(values: Array, rows: Rows, columns: Rows, width: int) -> Any:
    """Return the sparse sum of blocks."""
    at = np.broadcast_arrays(rows, columns)
    shape = (int(rows.max()) + 1, width)
    return sparse.coo_array((values.ravel(), [each.ravel() for each in at]), shape=shape).tocsr()


def reduce_beam(
    element: BeamElement,
    inertia: RigidInertia | None,
    outer: Mapping[str, Array],
    wishes: Wishes,
    source: str,
    report: Report = lambda share: None,
) -> Reduction:
    """Reduce a `<beam>`; other parameters and errors as of `link.reduce_link`.

    Parameters
    ----------
    inertia : RigidInertia or None
        The whole link, in its frame.
    outer : mapping
        Frames of the link by name, pose (4, 4); each is fixed to the section at its place along
        the beam. A beam with none beyond its root has the frame `tip`.
    """
    sections = BeamSections.of(element, inertia)
    backward = inverse_transform(element.origin)
    place = {
        name: float(np.clip((backward @ pose)[0, 3], 0.0, sections.length))
        for name, pose in outer.items()
    }
    near = SAME_STATION * sections.length
    outer = dict(outer)
    if not any(x > near for x in place.values()):
        tip = pose_of((sections.length, 0.0, 0.0))
        outer['tip'], place['tip'] = element.origin @ tip, sections.length
    body = beam_body(f'beam {element.link!r}', sections, element.origin, list(place.values()))
    along = (body.nodes - element.origin[:3, 3]) @ element.origin[:3, 0]

    def patch(name: str, pose: Array) -> Patch:
        node = int(np.argmin(np.abs(along - place.get(name, 0.0))))
        return Patch(name, pose[:3, 3], pose[:3, :3], np.array([node]), 0.0)

    patches = [patch('', np.eye(4))]
    aside: dict[str, Patch] = {}  # on a section that has a patch
    for name, pose in sorted(outer.items(), key=lambda each: place[each[0]]):
        made = patch(name, pose)
        if made.nodes[0] == patches[-1].nodes[0]:
            aside[name] = patches[-1]
        else:
            patches.append(made)
    found = reduce_link(body, None, patches, wishes, source, report)
    frames = dict(found.link.frames)
    for name, beside in aside.items():
        frames[name] = _carried(found, beside, outer[name])
    return replace(found, link=replace(found.link, frames=frames))


def _carried(found: Reduction, patch: Patch, pose: Array) -> LinkFrame:
    """Return a frame that a patch carries as a rigid arm."""
    link, arm = found.link, pose[:3, 3] - patch.origin
    if not patch.name:
        zero = np.zeros((3, link.modes))
        return LinkFrame(pose[:3, 3], pose[:3, :3], zero, zero, np.zeros((3, len(link.pairs))))
    own = link.frames[patch.name]
    second = [turned_twice(own.theta[:, j], own.theta[:, k], arm) for j, k in link.pairs]
    return LinkFrame(
        pose[:3, 3],
        pose[:3, :3],
        own.phi + np.cross(own.theta, arm, axis=0),
        own.theta,
        own.quadratic + np.array(second).reshape(-1, 3).T,
    )
