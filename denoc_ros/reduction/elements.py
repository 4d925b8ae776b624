"""Ten-node tetrahedra of an isotropic material: mass, stiffness, strain and quadratic force.

Four-node tetrahedra are never used: they lock in bending. The stiffness is built of scalar forms,
a ninth of the memory that a vector form needs.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sparse
from skfem import Basis, BilinearForm, ElementTetP2, MeshTet

from denoc_ros.errors import ModelError
from denoc_ros.reduction.body import FiniteElementBody, Rows
from denoc_ros.types import Array

STIFFNESS_ORDER, MASS_ORDER = 2, 4  # degrees that the quadrature is exact to
FLAT = 1e-9  # volume of a tetrahedron over that of a regular one with its longest edge
VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))  # xx, yy, zz, yz, xz, xy


@dataclass(frozen=True)
class Elasticity:
    """Lamé's constants [Pa] and density [kg/m^3] of an isotropic material."""

    first: float
    shear: float
    density: float

    @classmethod
    def of(cls, e: float, g: float, density: float) -> Elasticity:
        """Return those of a Young's and a shear modulus [Pa]."""
        return cls(g * (e - 2.0 * g) / (3.0 * g - e), g, density)

    def stress(self, strain: Array) -> Array:
        """Return the stress [Pa] of symmetric strains (3, 3, ...)."""
        trace = np.trace(strain)
        stress = 2.0 * self.shear * strain
        for axis in range(3):
            stress[axis, axis] += self.first * trace
        return stress


class Solid:
    """A body of ten-node tetrahedra.

    Parameters
    ----------
    where : str
        What it was made from, for errors.
    corners : ndarray (c, 3)
        Vertices [m].
    tetrahedra : ndarray (t, 4)
        Indices of vertices; either orientation.

    Raises
    ------
    ModelError
        For a mesh without elements, or with flat ones.
    """

    def __init__(
        self,
        where: str,
        corners: Array,
        tetrahedra: Rows,
        elasticity: Elasticity,
    ) -> None:
        used, flat = np.unique(tetrahedra, return_inverse=True)
        corners = np.ascontiguousarray(corners[used], dtype=np.float64)
        tetrahedra = flat.reshape(-1, 4)
        if not len(tetrahedra):
            raise ModelError(where, ['mesh must have tetrahedra, got none'])
        edges = corners[tetrahedra[:, 1:]] - corners[tetrahedra[:, :1]]
        volumes = np.linalg.det(edges) / 6.0
        size = np.linalg.norm(edges, axis=2).max(axis=1) ** 3 / 8.485
        if not (np.abs(volumes) > FLAT * size).all():
            count = int(np.count_nonzero(~(np.abs(volumes) > FLAT * size)))
            raise ModelError(where, [f'tetrahedra must have a volume, got {count} flat ones'])
        self.where = where
        self.elasticity = elasticity
        self.volume = float(np.abs(volumes).sum())  # m^3
        self.mesh = MeshTet(corners.T, np.ascontiguousarray(tetrahedra.T))
        self.basis = Basis(self.mesh, ElementTetP2(), intorder=STIFFNESS_ORDER)

    def with_elasticity(self, elasticity: Elasticity) -> Solid:
        """Return the same elements of another material."""
        other = copy(self)
        other.elasticity = elasticity
        return other

    @property
    def nodes(self) -> Array:
        """Nodes (n, 3) [m]: vertices, then the middles of edges."""
        return np.asarray(self.basis.doflocs.T)

    @property
    def elements(self) -> Rows:
        """Nodes (t, 10) of each element."""
        return np.asarray(self.basis.element_dofs.T)

    @cached_property
    def faces(self) -> Rows:
        """Boundary triangles (f, 3) of vertices, seen anticlockwise from outside."""
        boundary = self.mesh.boundary_facets()
        faces = np.asarray(self.mesh.facets[:, boundary].T)
        x = self.nodes
        inside = x[self.mesh.t[:, self.mesh.f2t[0, boundary]]].mean(axis=0)
        a, b, c = (x[faces[:, k]] for k in range(3))
        inwards = np.einsum('fi,fi->f', np.cross(b - a, c - a), inside - a) > 0.0
        faces[inwards] = faces[inwards][:, ::-1]
        return faces

    def body(self) -> FiniteElementBody:
        """Return its nodes with mass and stiffness."""
        gradients = {}
        for a in range(3):
            for b in range(a, 3):
                form = BilinearForm(lambda u, v, _, a=a, b=b: v.grad[a] * u.grad[b])
                gradients[a, b] = form.assemble(self.basis)
                gradients[b, a] = gradients[a, b].T
        first, shear = self.elasticity.first, self.elasticity.shear
        laplace = gradients[0, 0] + gradients[1, 1] + gradients[2, 2]
        blocks: list[list[Any]] = [[None] * 3 for _ in range(3)]
        for p in range(3):
            for q in range(3):
                blocks[p][q] = first * gradients[p, q] + shear * gradients[q, p]
            blocks[p][p] = blocks[p][p] + shear * laplace
        gradients.clear()
        stiffness = sparse.bmat(blocks, format='csr')
        mass = self._mass()
        return FiniteElementBody(
            self.where,
            self.nodes,
            stiffness,
            sparse.block_diag([mass] * 3, 'csr'),
            interpolation=self._interpolation(),
        )

    def _interpolation(self) -> Any:
        """Return the values (n, c) at all nodes from those at vertices: means at middles."""
        count, edges = self.mesh.p.shape[1], self.mesh.edges
        middles = np.tile(np.arange(edges.shape[1]), 2)
        means = sparse.coo_matrix((np.full(len(middles), 0.5), (middles, edges.ravel())))
        return sparse.vstack([sparse.eye_array(count), means], format='csr')

    def _mass(self) -> Any:
        density = self.elasticity.density
        finer = Basis(self.mesh, ElementTetP2(), intorder=MASS_ORDER)
        return BilinearForm(lambda u, v, _: density * u * v).assemble(finer)

    def _gradients(self, basis: Any, field: Array) -> Array:
        """Return d u_i / d x_a (3, 3, t, q) of nodal displacements (n, 3)."""
        values = field[basis.element_dofs]  # (10, t, 3)
        shape = basis.basis[0][0].grad.shape[1:]
        found = np.zeros((3, 3, *shape))
        for node, function in zip(values, basis.basis, strict=True):
            found += node.T[:, None, :, None] * function[0].grad[None]
        return found

    def strain(self, field: Array) -> Array:
        """Return the strain (c, 6) at vertices of nodal displacements (n, 3).

        The mean over the elements around a vertex; xx, yy, zz, yz, xz, xy, none doubled.
        """
        corners = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
        basis = Basis(self.mesh, ElementTetP2(), quadrature=(corners, np.ones(4) / 24.0))
        gradient = self._gradients(basis, field)
        count = np.zeros(self.mesh.p.shape[1])
        found = np.zeros((len(count), 6))
        for corner in range(4):
            nodes = self.mesh.t[corner]
            count += np.bincount(nodes, minlength=len(count))
            for k, (i, a) in enumerate(VOIGT):
                value = 0.5 * (gradient[i, a, :, corner] + gradient[a, i, :, corner])
                found[:, k] += np.bincount(nodes, value, minlength=len(count))
        return found / count[:, None]

    def strain_energy(self, field: Array) -> Array:
        """Return the strain energy (t,) of each element [J] under displacements (n, 3) [m]."""
        strain = _symmetric(self._gradients(self.basis, field))
        density = 0.5 * np.einsum('iatq,iatq->tq', self.elasticity.stress(strain), strain)
        return np.asarray((density * self.basis.dx).sum(axis=1))

    def quadratic_force(self, first: Array, second: Array) -> Array:
        """Second derivative of the internal force along two displacement fields.

        Parameters
        ----------
        first, second : ndarray (n, 3)
            Nodal displacements per amplitude.

        Returns
        -------
        ndarray (n, 3)
            d^2 f / (d a d b) of the internal force f(a first + b second) at a = b = 0.

        Notes
        -----
        St. Venant-Kirchhoff material: with H = grad u, E = (H + H^T + H^T H) / 2, S = C E and
        f . w = int S : (H_w + H^T H_w), the second derivative is
        int H_w : (H_2 S_1 + H_1 S_2 + C sym(H_1^T H_2)).
        """
        one, two = (self._gradients(self.basis, field) for field in (first, second))
        stress = self.elasticity.stress
        total = np.einsum('iatq,abtq->ibtq', two, stress(_symmetric(one)))
        total += np.einsum('iatq,abtq->ibtq', one, stress(_symmetric(two)))
        total += stress(_symmetric(np.einsum('iatq,ibtq->abtq', one, two)))
        total *= self.basis.dx
        force = np.zeros((self.basis.N, 3))
        for nodes, function in zip(self.basis.element_dofs, self.basis.basis, strict=True):
            part = np.einsum('ibtq,btq->it', total, function[0].grad)
            for axis in range(3):
                force[:, axis] += np.bincount(nodes, part[axis], minlength=len(force))
        return force


def _symmetric(tensor: Array) -> Array:
    return np.asarray(0.5 * (tensor + tensor.swapaxes(0, 1)))
