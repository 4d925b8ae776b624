"""A beam's integrals and sections as the constants of the kernels.

Beam integrals are exact to rounding without quadrature points at run time: every integrand is a
product of two functions out of 1, x, s_j and H_jk, so these are replaced by vectors whose inner
products are the integrals (a QR factorization of their values at many Gauss points). The kernels
then sum over as many `points` as there are independent functions, seven for two modes per plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.linalg

from denoc_ros.kernels.layout.derivative_layout import whole_lanes
from denoc_ros.model.beams.along import Along
from denoc_ros.model.beams.link_file import ReducedLink
from denoc_ros.model.beams.shapes import ShapeFunctions, gauss_rule, merged_edges, panels
from denoc_ros.model.tree import Beam, ComponentModes, Joint, JointKind
from denoc_ros.types import Array

GAUSS_POINTS = 16


def foreshortening(shapes: ShapeFunctions, x: Array) -> Array:
    """Return H(x) = int_0^x s' s'^T, shape (k, m, m) [1/m], at stations x (k,)."""
    if len(shapes.edges) > 2:
        return _piecewise_foreshortening(shapes, x)
    node, weight = gauss_rule(GAUSS_POINTS)
    count = 2 + 2 * shapes.modes
    share = (np.arange(count)[:, None] + 0.5 * (node + 1.0)) / count  # of [0, x]
    stations = np.outer(x, share.ravel())
    slope = shapes.slopes(stations.ravel()).reshape(len(x), -1, shapes.modes)
    weights = np.outer(x, np.tile(weight / (2.0 * count), count))
    product: Array = np.einsum('kp,kpi,kpj->kij', weights, slope, slope)
    return product


def _piecewise_foreshortening(shapes: ShapeFunctions, x: Array) -> Array:
    """Return H(x) (k, m, m) of shapes that are smooth between edges only."""
    edges, (node, weight) = shapes.length * np.array(shapes.edges), gauss_rule(GAUSS_POINTS)

    def between(start: Array, end: Array) -> Array:
        half = 0.5 * (end - start)
        slope = shapes.slopes((start[:, None] + half[:, None] * (node + 1.0)).ravel())
        slope = slope.reshape(len(start), len(node), shapes.modes)
        weights = half[:, None] * weight
        product: Array = np.einsum('kp,kpi,kpj->kij', weights, slope, slope)
        return product

    up_to = np.concatenate(
        [np.zeros((1, shapes.modes, shapes.modes)), np.cumsum(between(edges[:-1], edges[1:]), 0)]
    )
    place = np.clip(np.searchsorted(edges, x, side='right') - 1, 0, len(edges) - 2)
    return np.asarray(up_to[place] + between(edges[place], x))


def _plane(shapes: ShapeFunctions | None, x: Array, geometric: bool) -> tuple[Array, Array]:
    """Return values (k, m) and H (k, m, m) of a bending plane at stations x."""
    if shapes is None:
        return np.zeros((len(x), 0)), np.zeros((len(x), 0, 0))
    values = shapes.values(x)
    if not geometric:
        return values, np.zeros((len(x), shapes.modes, shapes.modes))
    return values, foreshortening(shapes, x)


def _gauss_rule(
    length: float, modes: int, along: Along, shapes: tuple[ShapeFunctions | None, ...]
) -> tuple[Array, Array]:
    """Return stations and weights of a rule that integrates the beam's products to rounding."""
    smooth = [each.edges for each in shapes if each is not None]
    edges = merged_edges(along.breaks, *smooth)
    if len(edges) == 2 or not all(len(each) > 2 for each in smooth):
        count = 4 + 4 * modes
        edges = merged_edges(edges, np.arange(count + 1) / count)
    return panels(length, edges, GAUSS_POINTS)


def beam_points(beam: Beam, geometric: bool) -> Array:
    """Return the rows (points, 2 + ny + nz + ny^2 + nz^2) that stand for a beam's functions.

    Beams that differ in stiffness and damping alone share them: they are not to be written.
    """
    planes = [None if part is None else part.shapes for part in (beam.y, beam.z)]
    modes, along = max(beam.modes), beam.mass_along
    return _points(*planes, beam.length, beam.mass_per_length, along, modes, geometric)


@lru_cache(maxsize=64)
def _points(
    shapes_y: ShapeFunctions | None,
    shapes_z: ShapeFunctions | None,
    length: float,
    mass_per_length: float,
    along: Along,
    modes: int,
    geometric: bool,
) -> Array:
    x, weight = _gauss_rule(length, modes, along, (shapes_y, shapes_z))
    weight = weight * along.values(x / length)
    y, h_y = _plane(shapes_y, x, geometric)
    z, h_z = _plane(shapes_z, x, geometric)
    functions = np.concatenate(
        [np.ones((len(x), 1)), x[:, None], y, z, h_y.reshape(len(x), -1), h_z.reshape(len(x), -1)],
        axis=1,
    )
    weighted = np.sqrt(mass_per_length * weight)[:, None] * functions
    norm = np.linalg.norm(weighted, axis=0)
    norm[norm == 0.0] = 1.0
    upper, order = scipy.linalg.qr(weighted / norm, mode='r', pivoting=True)
    rank = int(np.sum(np.abs(np.diag(upper)) > 1e-15 * len(x)))
    rows = np.empty((rank, functions.shape[1]))
    rows[:, order] = upper[:rank]
    result: Array = rows * norm
    result.setflags(write=False)
    return result


def polar_constants(beam: Beam) -> list[Array]:
    """Return the torsion constants int rho J [1; s; s s^T]."""
    if beam.torsion is None:
        return [np.zeros(1)]
    shapes = beam.torsion.shapes
    x, weight = _gauss_rule(beam.length, max(beam.modes), beam.polar_along, (shapes,))
    s = shapes.values(x)
    weight = weight * beam.polar_along.values(x / beam.length)
    scaled = beam.polar_inertia * weight
    return [
        np.array([beam.polar_inertia * beam.length * beam.polar_along.moment(0)]),
        scaled @ s,
        ((s * scaled[:, None]).T @ s).ravel(),
    ]


def section_constants(beam: Beam, station: float, geometric: bool) -> Array:
    """Return the constants of the section at a station."""
    x = np.array([station])
    planes = [None if part is None else part.shapes for part in (beam.y, beam.z)]
    (y, h_y), (z, h_z) = (_plane(shapes, x, geometric) for shapes in planes)
    slopes = [part.shapes.slopes(x).ravel() if part else np.zeros(0) for part in (beam.y, beam.z)]
    twist = beam.torsion.shapes.values(x).ravel() if beam.torsion else np.zeros(0)
    return np.concatenate([x, y.ravel(), z.ravel(), *slopes, twist, h_y.ravel(), h_z.ravel()])


# links reduced from finite elements -------------------------------------------------------------

NO_CURVE = 1e-12  # of the largest second-order displacement: what arithmetic leaves of none


@dataclass(frozen=True)
class ComponentPoints:
    """The points of a link's modes, in axes that the kernels have the least work with."""

    axes: Array  # (3, 3) seen from the link frame
    count: int  # points, in whole lanes
    modes: int
    bent: int  # of how many numbers of the points there is a Gamma, in whole vectors of lanes
    constants: Array  # as the kernels' layout says


def second_order(link: ReducedLink, values: Array) -> Array:
    """Return Gamma (..., m, m, 3) from the columns (..., 3 g) of a link's pairs."""
    m = link.modes
    gamma = np.zeros((*values.shape[:-1], m, m, 3))
    for k, (i, j) in enumerate(link.pairs):
        gamma[..., i, j, :] = gamma[..., j, i, :] = values[..., 3 * k : 3 * k + 3]
    return gamma


def kernel_axes(link: ReducedLink, joint: Joint | None) -> tuple[Array, int]:
    """Return axes (3, 3), seen from the link frame, and how many of them Gamma has.

    Those come first. A revolute joint across a Gamma along a line gets the z axis: that is what
    costs the kernels least.
    """
    values = link.points[:, 4 + 3 * link.modes :].reshape(-1, 3)
    sizes, rows = np.linalg.svd(np.concatenate([values, np.zeros((3, 3))]), full_matrices=False)[
        1:
    ]
    bent = int(np.sum(sizes > NO_CURVE * sizes[0]))
    first = rows.T if bent else np.eye(3)
    turns = joint is not None and joint.kind is JointKind.REVOLUTE
    if bent <= 1 and turns and joint is not None:
        z = joint.axis
        x = first[:, 0] - z * (z @ first[:, 0])
        if bent == 1 and np.linalg.norm(x) < 1.0 - NO_CURVE:
            x = first[:, 0]
            y = np.cross(z, x) if np.linalg.norm(np.cross(z, x)) > 0.1 else first[:, 1]
            z = np.cross(x, y / np.linalg.norm(y))
        elif np.linalg.norm(x) < 0.1:
            x = first[:, 1] - z * (z @ first[:, 1])
        x = x / np.linalg.norm(x)
        return np.column_stack([x, np.cross(z, x), z]), bent
    x, y = first[:, 0], first[:, 1]
    return np.column_stack([x, y, np.cross(x, y)]), bent


def component_points(
    modes: ComponentModes, joint: Joint | None, geometric: bool
) -> ComponentPoints:
    """Return the points of a link's modes.

    Parameters
    ----------
    joint : Joint or None
        The one before the link.
    geometric : bool
        Whether the second-order displacement counts.
    """
    link, m = modes.link, modes.count
    axes, bent = kernel_axes(link, joint)
    rows = link.points
    count = whole_lanes(len(rows))
    padded = np.zeros((count, rows.shape[1]))
    padded[: len(rows)] = rows
    phi = padded[:, 4 : 4 + 3 * m].reshape(count, m, 3) @ axes
    first, second = np.tril_indices(m)
    curves = (second_order(link, padded[:, 4 + 3 * m :]) @ axes)[:, first, second]
    drawn = 3 * whole_lanes(-(-bent * count // 3)) if geometric else 0
    parts = (
        padded[:, 0],
        (padded[:, 1:4] @ axes).T,
        phi.transpose(1, 2, 0),
        curves.transpose(1, 2, 0).reshape(-1, 3 * count)[:, :drawn],
    )
    return ComponentPoints(axes, count, m, drawn, np.concatenate([part.ravel() for part in parts]))


def section_of_modes(modes: ComponentModes, name: str, axes: Array, geometric: bool) -> Array:
    """Return the constants of the section at a frame of a link with component modes."""
    frame = modes.link.frames[name]
    gamma = second_order(modes.link, frame.quadratic.T.ravel()) @ axes
    parts = (
        frame.origin @ axes,
        frame.phi.T @ axes,
        frame.theta.T @ axes,
        gamma if geometric else np.zeros_like(gamma),
    )
    return np.concatenate([np.ravel(part) for part in parts])
