"""Shape functions of a beam whose section varies, by finite elements.

The space is that of Hermite elements (bending: values and slopes of the nodes; twist: values) with
inner polynomials up to degree 8 in each. Elements end where a number of the section steps, where
curvature may jump. With a dozen elements the first modes are exact to 1e-9.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.linalg import eigh

from denoc_ros.model.along import Along
from denoc_ros.model.shapes import ShapeFunctions, merged_edges, panels, scaled_shapes
from denoc_ros.types import Array

DEGREE = 8
LEAST_ELEMENTS = 12


@dataclass(frozen=True, eq=False)
class PiecewiseShapes(ShapeFunctions):
    """Shape functions that are a polynomial between each two edges.

    Attributes
    ----------
    length : float
        Length of the beam [m].
    spans : tuple of float
        Shares of the length, from 0 to 1.
    coefficients : ndarray (DEGREE + 1, elements, modes)
        Of Legendre polynomials.
    """

    length: float
    spans: tuple[float, ...]
    coefficients: Array

    @property
    def edges(self) -> tuple[float, ...]:
        """Shares of the length, from 0 to 1, between each two of which the shapes are smooth."""
        return self.spans

    @property
    def modes(self) -> int:
        """Number of shape functions."""
        return int(self.coefficients.shape[2])

    def derivatives(self, x: Array, order: int) -> Array:
        """Return the derivative of a given order [1/m^order], (k, modes), at stations x (k,).

        At an edge it is that of the outboard side.
        """
        share = np.atleast_1d(np.asarray(x, dtype=np.float64)) / self.length
        edges = np.array(self.edges)
        place = np.searchsorted(edges, share * (1.0 + 1e-15), side='right') - 1
        place = np.clip(place, 0, len(edges) - 2)
        width = edges[place + 1] - edges[place]
        local = 2.0 * (share - edges[place]) / width - 1.0
        table = legendre.legder(self.coefficients, order) if order else self.coefficients
        found = legendre.legval(local[:, None], table[:, place], tensor=False)
        return np.asarray(found * (2.0 / (width * self.length))[:, None] ** order)

    def combined(self, matrix: Array) -> PiecewiseShapes:
        """Return the combinations of the shapes that the columns of a matrix make."""
        return PiecewiseShapes(self.length, self.edges, self.coefficients @ matrix)


@dataclass(frozen=True)
class _Space:
    """Finite elements of a beam of length 1, with its stiffness and mass."""

    shapes: PiecewiseShapes  # one per degree of freedom
    stiffness: Array
    mass: Array
    nodes: NDArray[np.intp]  # (elements + 1, order): degrees of freedom of each node

    def reduced(self, basis: Array, count: int) -> PiecewiseShapes:
        """Return the lowest modes within a basis (columns), scaled."""
        _, mixing = eigh(basis.T @ self.stiffness @ basis, basis.T @ self.mass @ basis)
        return scaled_shapes(self.shapes.combined(basis @ np.asarray(mixing)[:, :count]))

    def free_of(self, held: list[int]) -> Array:
        """Return the columns of the identity for the degrees of freedom that are not held."""
        return np.asarray(np.delete(np.eye(len(self.mass)), held, axis=1))

    def modes(self, held: list[int], count: int) -> Array:
        """Return the lowest modes with degrees of freedom held, (dofs, count)."""
        free = self.free_of(held)
        _, vectors = eigh(free.T @ self.stiffness @ free, free.T @ self.mass @ free)
        return np.asarray(free @ vectors[:, :count])

    def static(self, held: list[int], moved: int) -> Array:
        """Return the displacement (dofs, 1) by 1 of one degree of freedom, others held."""
        free = self.free_of([*held, moved])
        start = np.zeros((len(self.mass), 1))
        start[moved] = 1.0
        inner = free.T @ self.stiffness
        return np.asarray(start - free @ np.linalg.solve(inner @ free, inner @ start))


def _bubbles(order: int) -> list[Array]:
    """Return the inner polynomials (Legendre coefficients), 0 to an order at both ends."""
    base = legendre.poly2leg([1.0, 0.0, -1.0])
    if order == 2:
        base = legendre.legmul(base, base)
    return [
        legendre.legmul(base, np.eye(DEGREE)[k][: k + 1]) for k in range(DEGREE - 2 * order + 1)
    ]


def _nodal(order: int) -> list[Array]:
    """Return the polynomials of the nodes: value (and slope, of an element of size 2)."""
    if order == 1:
        own = [[0.5, -0.5], [0.5, 0.5]]
    else:
        own = [[2, -3, 0, 1], [1, -1, -1, 1], [2, 3, 0, -1], [-1, -1, 1, 1]]
    scale = 4.0 if order == 2 else 1.0
    return [np.asarray(legendre.poly2leg(np.array(each) / scale), dtype=float) for each in own]


def _space(order: int, rigidity: Along, inertia: Along, modes: int) -> _Space:
    breaks = merged_edges(rigidity.breaks, inertia.breaks)
    most = 1.0 / max(LEAST_ELEMENTS, modes)
    edges = [0.0]
    for start, end in itertools.pairwise(breaks):
        count = int(np.ceil((end - start) / most - 1e-9))
        edges += [start + (end - start) * (k + 1) / count for k in range(count)]
    edges[-1] = 1.0
    elements, inner = len(edges) - 1, _bubbles(order)
    nodes = np.arange(order * (elements + 1), dtype=np.intp).reshape(elements + 1, order)
    table = np.zeros((DEGREE + 1, elements, nodes.size + elements * len(inner)))
    for e in range(elements):
        half = 0.5 * (edges[e + 1] - edges[e])
        for place, own in enumerate(_nodal(order)):
            node, derivative = divmod(place, order)
            table[: len(own), e, nodes[e + node, derivative]] = own * half**derivative
        for k, own in enumerate(inner):
            table[: len(own), e, nodes.size + e * len(inner) + k] = own
    shapes = PiecewiseShapes(1.0, tuple(edges), table)
    x, weight = panels(1.0, edges, 16)
    strain, moved = shapes.derivatives(x, order), shapes.derivatives(x, 0)
    stiffness = (strain * (weight * rigidity.values(x))[:, None]).T @ strain
    mass = (moved * (weight * inertia.values(x))[:, None]).T @ moved
    return _Space(shapes, stiffness, mass, nodes)


@lru_cache(maxsize=256)
def varying_shapes(
    shape: str,
    modes: int,
    length: float,
    rigidity: Along,
    inertia: Along,
) -> PiecewiseShapes:
    """Return shape functions of a beam whose section varies.

    Parameters
    ----------
    shape : str
        Of bending one of `SHAPES`, or 'constant moment' (the one that a moment at the tip makes);
        of twist 'twist', or 'static twist' (the one that a torque at the tip makes, and those
        with both ends held).
    modes : int
    length : float
        [m]
    rigidity, inertia : Along
        EI and mass per length, or GJ and polar inertia per length.

    Returns
    -------
    PiecewiseShapes
        Scaled and signed as those of a uniform beam.
    """
    order = 1 if shape.endswith('twist') else 2
    space = _space(order, rigidity, inertia, modes)
    root, end = [int(k) for k in space.nodes[0]], [int(k) for k in space.nodes[-1]]
    if shape == 'constant moment':
        basis = _loaded(space, root, end[1])
    elif shape == 'static twist':
        basis = np.hstack([space.static(root, end[0]), space.modes([*root, *end], modes - 1)])
    elif shape == 'craig-bampton':
        static = [space.static([*root, end[1 - k]], end[k]) for k in range(2)]
        basis = np.hstack([*static, space.modes([*root, *end], modes - 2)])
    else:
        held = {
            'twist': root,
            'clamped-free': root,
            'clamped-clamped': [*root, *end],
            'clamped-pinned': [*root, end[0]],
            'pinned-pinned': [root[0], end[0]],
        }[shape]
        basis = space.modes(held, modes)
    found = space.reduced(basis, modes)
    return PiecewiseShapes(length, found.edges, found.coefficients)


def _loaded(space: _Space, root: list[int], loaded: int) -> Array:
    """Return the displacement (dofs, 1) under a load on one degree of freedom."""
    free = space.free_of(root)
    load = free[loaded][:, None]
    return np.asarray(free @ np.linalg.solve(free.T @ space.stiffness @ free, load))


@lru_cache(maxsize=256)
def first_root(order: int, rigidity: Along, inertia: Along) -> float:
    """Return omega of the first mode, root held, of a beam of length 1 with means of 1."""
    shape = 'twist' if order == 1 else 'clamped-free'
    shapes = varying_shapes(shape, 1, 1.0, rigidity, inertia)
    return float(np.sqrt(shapes.gram(order, rigidity)[0, 0] / shapes.gram(0, inertia)[0, 0]))
