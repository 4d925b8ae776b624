"""A beam's integrals and sections as the constants of the kernels.

Beam integrals are exact to rounding without quadrature points at run time: every integrand is a
product of two functions out of 1, x, s_j and H_jk, so these are replaced by vectors whose inner
products are the integrals (a QR factorization of their values at many Gauss points). The kernels
then sum over as many `points` as there are independent functions, seven for two modes per plane.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy.linalg

from denoc_ros.model.along import Along
from denoc_ros.model.shapes import ShapeFunctions, gauss_rule, merged_edges, panels
from denoc_ros.model.tree import Beam
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
