"""Craig-Bampton reduction with rigid patches, and the modes of a link whose root is clamped.

The body's rows are those of rigid patches, six coordinates each, and the rest. Static columns of
the outer patches and modes with all patches clamped span the reduced space (Craig, Bampton, AIAA
Journal 6, 1968); its eigenvectors with the root clamped are the link's modes. Static columns for
forces at the outer frames take the places of the highest ones, so that sag is exact.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pymetis
import scipy.linalg as dense
import scipy.sparse as sparse
import scipy.sparse.linalg as sparse_linalg

from denoc_ros.errors import ModelError, SolverError
from denoc_ros.reduction.body import FiniteElementBody, Patch, Rows
from denoc_ros.types import Array

Ties = Sequence[tuple[Rows, Array]]

SPARE = 12  # modes with patches clamped beyond those kept: the kept ones are exact to 1e-4 or so
LOST = 1e-3  # of a frame's largest compliance: more, and the direction has a static column
FACTORED = 150_000  # rows: a stiffness of elements that has more is solved on two grids
REFINED, MOST_STEPS = 1e-10, 500  # residual, and steps to it
# of the smoothing: products with the matrix, high frequencies over low ones, steps to the highest
SMOOTHINGS, BAND, POWERS = 3, 6.0, 15
# vectors beyond those wanted, steps, residual of forces aimed at and the largest allowed: an
# eigenvalue is exact to its square
GUARDS, BLOCK_STEPS, BLOCK_RESIDUAL, LARGEST_RESIDUAL = 6, 40, 1e-6, 1e-4
BETTER = 'use another edge, for flat elements hinder them'
RESIDUAL = 1e-6  # of a load, in its equation: beyond it the stiffness is singular
SINGULAR = 1e-10  # of the largest stiffness of patches
TOLERANCE = 1e-10  # of eigenvalues

Report = Callable[[float], None]  # takes the share of the work that is done


class Factor:
    """Factor of a symmetric positive definite matrix (N, N), ordered by nested dissection.

    Parameters
    ----------
    where : str
        For errors.
    matrix : sparse matrix
    groups : ndarray (N,)
        Rows with the same number, those of a node, stay together.

    Raises
    ------
    ModelError
        For a matrix that is singular.
    """

    def __init__(self, where: str, matrix: Any, groups: Rows) -> None:
        self.where = where
        self.matrix = matrix.tocsr()
        self.order = _dissected(self.matrix, groups)
        try:
            self.factors = sparse_linalg.splu(
                self.matrix[self.order][:, self.order].tocsc(),
                permc_spec='NATURAL',
                diag_pivot_thresh=0.0,
                options={'SymmetricMode': True},
            )
        except RuntimeError as error:
            raise ModelError(where, [_singular(str(error))]) from error
        load = matrix @ np.random.default_rng(1).standard_normal(matrix.shape[0])
        off = np.linalg.norm(matrix @ self.solve(load) - load) / np.linalg.norm(load)
        if not off < RESIDUAL:
            raise ModelError(where, [_singular(f'a residual of {off:.3g}')])

    def solve(self, load: Array) -> Array:
        """Return the solution (N,) or (N, k) under loads of the same shape."""
        found = np.empty_like(load, dtype=np.float64)
        found[self.order] = self.factors.solve(np.ascontiguousarray(load[self.order]))
        return found

    def modes(self, mass: Any, count: int) -> tuple[Array, Array]:
        """Return the lowest eigenvalues (k,) and mass-orthonormal vectors (N, k)."""
        size = self.matrix.shape[0]
        count = min(count, size - 2)
        if count < 1:
            return np.zeros(0), np.zeros((size, 0))
        inverse = sparse_linalg.LinearOperator((size, size), matvec=self.solve, dtype=np.float64)
        start = np.random.default_rng(2).standard_normal(size)
        try:
            values, vectors = sparse_linalg.eigsh(
                self.matrix, count, mass, sigma=0.0, OPinv=inverse, tol=TOLERANCE, v0=start
            )
        except sparse_linalg.ArpackError as error:
            raise SolverError(f'{self.where}: modes must converge, got: {error}') from error
        return values, vectors


class TwoGrids:
    """Solver of a large stiffness of ten-node elements, whose memory grows with its nodes.

    Conjugate gradients, preconditioned by the factor of the four-node elements with the same
    vertices, between Chebyshev smoothings (Adams, Brezina, Hu, Tuminaro, J. Comput. Phys. 188,
    2003).

    Parameters
    ----------
    where, matrix
        As of :class:`Factor`, whose errors are those of this.
    interpolation : sparse matrix (N, c)
        Values of all rows from those of the four-node elements.
    coarse_groups : ndarray (c,)
    """

    def __init__(self, where: str, matrix: Any, interpolation: Any, coarse_groups: Rows) -> None:
        self.where, self.matrix, self.interpolation = where, matrix.tocsr(), interpolation.tocsr()
        self.coarse = Factor(where, self._coarse(self.matrix), coarse_groups)
        self.inverse = 1.0 / self.matrix.diagonal()
        vector = np.random.default_rng(1).standard_normal(matrix.shape[0])
        for _ in range(POWERS):
            vector = self.inverse * (self.matrix @ vector)
            self.largest = float(np.linalg.norm(vector))
            vector /= self.largest

    def _coarse(self, matrix: Any) -> Any:
        return (self.interpolation.T @ matrix @ self.interpolation).tocsr()

    def solve(self, load: Array) -> Array:
        """Return the solution (N,) or (N, k) under loads of the same shape."""
        if load.ndim > 1:
            return np.stack([self.solve(column) for column in load.T], axis=1)
        found, failed = sparse_linalg.cg(
            self.matrix, load, M=self._preconditioner(), rtol=REFINED, maxiter=MOST_STEPS
        )
        if failed:
            rule = f'conjugate gradients must converge for {len(load)} rows: {BETTER}'
            raise SolverError(f'{self.where}: {rule}, got none in {MOST_STEPS} steps')
        return np.asarray(found)

    def _preconditioner(self) -> Any:
        return sparse_linalg.LinearOperator(
            self.matrix.shape, matvec=self._nearly, matmat=self._nearly, dtype=np.float64
        )

    def _nearly(self, load: Array) -> Array:
        """Return nearly the solution for loads (N, ...)."""
        found = self._smoothed(load)
        left = self.interpolation.T @ (load - self.matrix @ found)
        found += self.interpolation @ self.coarse.solve(left)
        return found + self._smoothed(load - self.matrix @ found)

    def _smoothed(self, load: Array) -> Array:
        """Return the polynomial of the scaled matrix that solves for its high frequencies."""
        high = 1.1 * self.largest
        middle, half = 0.5 * high * (1.0 + 1.0 / BAND), 0.5 * high * (1.0 - 1.0 / BAND)
        inverse = self.inverse.reshape(-1, *[1] * (load.ndim - 1))
        step, rate = inverse * load / middle, half / middle
        found, left = step, load
        for _ in range(SMOOTHINGS - 1):
            left = left - self.matrix @ step
            before, rate = rate, 1.0 / (2.0 * middle / half - rate)
            step = rate * before * step + (2.0 * rate / half) * inverse * left
            found = found + step
        return np.asarray(found)

    def modes(self, mass: Any, count: int) -> tuple[Array, Array]:
        """Return the lowest eigenvalues (k,) and mass-orthonormal vectors (N, k), by LOBPCG."""
        values, start = self.coarse.modes(self._coarse(mass), count + GUARDS)
        start = self.interpolation @ start
        smallest = float(np.linalg.norm((mass @ start) * values, axis=0).min())
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # of the guards, which need not converge
            values, vectors = sparse_linalg.lobpcg(
                self.matrix,
                start,
                mass,
                self._preconditioner(),
                tol=BLOCK_RESIDUAL * smallest,
                maxiter=BLOCK_STEPS,
                largest=False,
            )
        values, vectors = values[:count], vectors[:, :count]
        force = self.matrix @ vectors
        off = np.linalg.norm(force - (mass @ vectors) * values, axis=0)
        worst = float((off / np.linalg.norm(force, axis=0)).max(initial=0.0))
        if not worst < LARGEST_RESIDUAL:
            rule = f'modes must converge: {BETTER}'
            raise SolverError(f'{self.where}: {rule}, got a residual of {worst:.3g}')
        return np.asarray(values), np.asarray(vectors)


def _singular(got: str) -> str:
    rule = 'stiffness must be positive definite with the patches clamped'
    return f'{rule}, got {got}; are all parts joined, and no node without an element?'


def _dissected(matrix: Any, groups: Rows) -> Rows:
    """Return the order of rows that keeps a factor small: nested dissection of the nodes."""
    names, group = np.unique(groups, return_inverse=True)
    graph = matrix.tocoo()
    pairs = sparse.coo_matrix(
        (np.ones(graph.nnz, dtype=np.int8), (group[graph.row], group[graph.col])),
        shape=(len(names), len(names)),
    ).tocsr()
    pairs.setdiag(0)
    pairs.eliminate_zeros()
    _, place = pymetis.nested_dissection(pymetis.CSRAdjacency(pairs.indptr, pairs.indices))
    return np.argsort(np.asarray(place)[group], kind='stable')


@dataclass(frozen=True)
class Craigs:
    """The reduced pair over the outer patches' coordinates and modes with patches clamped.

    `static` (I, 6 F) and `clamped` (I, k): interior rows per coordinate; `stiffness` and `mass`
    (6 F + k, 6 F + k).
    """

    body: FiniteElementBody
    patches: Sequence[Patch]  # the root first
    interior: Rows
    ties: Ties  # rows of a patch, their motion (r, 6)
    factor: Factor | TwoGrids
    static: Array
    clamped: Array
    stiffness: Array
    mass: Array

    @property
    def outer(self) -> int:
        """Number of coordinates of the outer patches, 6 F."""
        return int(self.static.shape[1])

    def expand(self, coordinates: Array) -> Array:
        """Return values (N, m) of all rows from coordinates (6 F + k, m)."""
        moved, local = coordinates[: self.outer], coordinates[self.outer :]
        values = np.zeros((len(self.body.dof_nodes), coordinates.shape[1]))
        values[self.interior] = self.static @ moved + self.clamped @ local
        for k, (rows, motion) in enumerate(self.ties[1:]):
            values[rows] = motion @ moved[6 * k : 6 * k + 6]
        return values

    def respond(self, load: Array, prescribed: Array) -> tuple[Array, Array]:
        """Static displacement under a load, beside a prescribed one of the patches' rows.

        Parameters
        ----------
        load, prescribed : ndarray (N,)
            Forces on all rows; displacements of the patches' rows that come on top of the
            patches' rigid motion, zero elsewhere.

        Returns
        -------
        values : ndarray (N,)
        moved : ndarray (6 F,)
            Displacement and turn of each outer patch without what is prescribed.
        """
        load = load - self.body.stiffness @ prescribed
        inner = self.factor.solve(load[self.interior])
        force = np.zeros(self.outer)
        for k, (rows, motion) in enumerate(self.ties[1:]):
            force[6 * k : 6 * k + 6] = motion.T @ load[rows]
        force += self.static.T @ load[self.interior]
        moved = dense.solve(self.stiffness[: self.outer, : self.outer], force, assume_a='pos')
        values = prescribed.copy()
        values[self.interior] += inner + self.static @ moved
        for k, (rows, motion) in enumerate(self.ties[1:]):
            values[rows] += motion @ moved[6 * k : 6 * k + 6]
        return values, moved


def reduce_body(
    body: FiniteElementBody, patches: Sequence[Patch], modes: int, report: Report
) -> Craigs:
    """Reduce a body to its outer patches and modes with all patches clamped.

    Parameters
    ----------
    patches : sequence of Patch
        The root's first, at least one more.
    modes : int
        Modes of the link that will be kept.
    report : callable
        Takes the share of the work that is done.

    Raises
    ------
    ModelError
        For matrices that are no body's.
    SolverError
        If modes do not converge.
    """
    body.check()
    ties = []
    bound = np.zeros(len(body.dof_nodes), dtype=bool)
    for patch in patches:
        rows = np.flatnonzero(np.isin(body.dof_nodes, patch.nodes))
        ties.append((rows, body.rigid(rows, patch.origin)))
        bound[rows] = True
    interior = np.flatnonzero(~bound)
    stiffness, mass = body.stiffness[interior][:, interior], body.mass[interior][:, interior]
    factor = _solver(body, stiffness, interior, ~bound)
    report(0.5)
    coupled = _projected(body.stiffness, interior, ties[1:])
    coupled_mass = _projected(body.mass, interior, ties[1:])
    static = -factor.solve(coupled)
    report(0.6)
    values, clamped = factor.modes(mass, modes + SPARE)
    report(0.9)
    if len(values) and not values[0] > 0.0:
        raise ModelError(body.where, [_singular(f'an eigenvalue of {values[0]:.3g}')])
    moved = mass @ static
    outer_mass = (
        _outer(body.mass, ties[1:])
        + static.T @ moved
        + coupled_mass.T @ static
        + static.T @ coupled_mass
    )
    outer_stiffness = _outer(body.stiffness, ties[1:]) + coupled.T @ static
    lowest, *_, highest = np.linalg.eigvalsh(_balanced(outer_stiffness))
    if not lowest > SINGULAR * highest:
        raise ModelError(body.where, [_singular('an outer frame that nothing holds')])
    between = clamped.T @ (moved + coupled_mass)
    zero = np.zeros_like(between)
    return Craigs(
        body,
        patches,
        interior,
        ties,
        factor,
        static,
        clamped,
        np.block([[outer_stiffness, zero.T], [zero, np.diag(values)]]),
        np.block([[outer_mass, between.T], [between, np.eye(len(values))]]),
    )


def _solver(
    body: FiniteElementBody, stiffness: Any, interior: Rows, free: Any
) -> Factor | TwoGrids:
    """Return the solver of the rows that are free."""
    if body.interpolation is None or len(interior) <= FACTORED:
        return Factor(body.where, stiffness, body.dof_nodes[interior])
    nodes, vertices = body.interpolation.shape
    rows = np.concatenate([np.arange(vertices) + axis * nodes for axis in range(3)])
    kept = np.flatnonzero(free[rows])
    between = sparse.block_diag([body.interpolation] * 3, 'csr')[interior][:, kept]
    return TwoGrids(body.where, stiffness, between, body.dof_nodes[rows[kept]])


def _balanced(matrix: Any) -> Array:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.asarray(scale[:, None] * matrix * scale)


def _projected(matrix: Any, rows: Rows, ties: Ties) -> Array:
    """Return the effect of the patches' coordinates on rows, (r, 6 F)."""
    below = matrix[rows]
    return np.hstack([below[:, columns] @ motion for columns, motion in ties])


def _outer(matrix: Any, ties: Ties) -> Array:
    """Return a matrix over the patches' coordinates, (6 F, 6 F)."""
    return np.vstack([motion.T @ _projected(matrix, rows, ties) for rows, motion in ties])


@dataclass(frozen=True)
class LinkModes:
    """The link's modes, mass-orthonormal, root clamped.

    `coordinates` (6 F + k, m) of the reduced space; `stiffness` (m,) [rad^2/s^2];
    `left_out` [Hz] the next eigenfrequencies; `static` which loads have a column of their own;
    `lost` per outer frame (6,): percent of its static compliance that the modes lack.
    """

    coordinates: Array
    stiffness: Array
    left_out: Array
    static: Sequence[str]
    lost: Mapping[str, Array]

    @property
    def frequencies(self) -> Array:
        """Natural frequencies (m,) [Hz], root clamped."""
        return np.asarray(np.sqrt(self.stiffness) / (2.0 * np.pi))


def link_modes(craigs: Craigs, count: int, tip_mass: Mapping[str, float]) -> LinkModes:
    """Choose the modes of a link whose root is clamped.

    Parameters
    ----------
    count : int
        Number of modes m.
    tip_mass : mapping of str to float
        Masses [kg] at outer frames that the eigenvectors are those of, points there.

    Raises
    ------
    ModelError
        If there are not as many modes.
    """
    outer, size = craigs.outer, len(craigs.stiffness)
    if count > size:
        rule = f'modes must be at most {size}, those that the mesh has'
        raise ModelError(craigs.body.where, [f'{rule}, got {count}'])
    loaded = craigs.mass.copy()
    frames = [patch.name for patch in craigs.patches[1:]]
    for k, name in enumerate(frames):
        at = slice(6 * k, 6 * k + 3)
        loaded[at, at] += tip_mass.get(name, 0.0) * np.eye(3)
    values, vectors = dense.eigh(craigs.stiffness, loaded)
    compliance = np.linalg.inv(craigs.stiffness[:outer, :outer])
    wanted: list[int] = []
    for kept in range(count, 0, -1):
        wanted = _static_loads(compliance, vectors[:outer, :kept], values[:kept])[: count - 1]
        if kept + len(wanted) <= count:
            break
    columns = np.zeros((size, len(wanted)))
    columns[:outer] = compliance[:, wanted]
    basis = np.hstack([vectors[:, : count - len(wanted)], columns])
    basis /= np.sqrt(np.einsum('ij,ij->j', basis, craigs.mass @ basis))
    stiffness, turned = dense.eigh(
        basis.T @ craigs.stiffness @ basis, basis.T @ craigs.mass @ basis
    )
    coordinates = basis @ turned
    found = coordinates[:outer]
    diagonal = np.diag(compliance)
    lost = 1.0 - np.einsum('im,im,m->i', found, found, 1.0 / stiffness) / diagonal
    own = dense.eigh(craigs.stiffness, craigs.mass, eigvals_only=True)
    return LinkModes(
        coordinates,
        stiffness,
        np.sqrt(own[count : count + 3]) / (2.0 * np.pi),
        [f'{frames[load // 6]}/{"xyz"[load % 6]}' for load in wanted],
        {name: 100.0 * np.maximum(lost[6 * k : 6 * k + 6], 0.0) for k, name in enumerate(frames)},
    )


def _static_loads(compliance: Any, vectors: Any, values: Any) -> list[int]:
    """Return the forces at frames whose sag the modes alone would not give, worst first."""
    lost = np.diag(compliance) - np.einsum('im,im,m->i', vectors, vectors, 1.0 / values)
    found = []
    for frame in range(0, len(lost), 6):
        largest = float(np.diag(compliance)[frame : frame + 3].max())
        found += [
            (float(lost[load]) / largest, load)
            for load in range(frame, frame + 3)
            if lost[load] > LOST * largest
        ]
    return [load for _, load in sorted(found, reverse=True)]
