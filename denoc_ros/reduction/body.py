"""A body's nodes with mass and stiffness, and the rigid patches at its frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from denoc_ros.errors import ModelError
from denoc_ros.types import Array

Rows = NDArray[np.signedinteger[Any]]

ASYMMETRY = 1e-6  # of the largest entry: what rounding to the digits of a text file leaves
PARALLEL = 1e-3  # of a patch's size across its longest line: less is a line, which turns freely
OFF = 0.5  # of the body's size: a frame farther off is not of it
SLICES = 24  # at most, along the line
FEWEST = 4  # places of a slice
ANISOTROPY = 0.01  # of the mass, between directions: more is told


@dataclass(frozen=True)
class FiniteElementBody:
    """Nodes with mass and stiffness; sparse matrices [kg, kg m^2; N/m, N, N m].

    `dof_nodes` and `dof_axes` (N,) say what a row of the matrices is: a node, and 0 to 2 for a
    displacement along x, y, z, 3 to 5 for a turn; by default all nodes' x, then y, then z.
    `interpolation` (n, c) gives a value at all nodes from those at the vertices, which come first;
    None for matrices whose elements are not known.
    """

    where: str
    nodes: Array  # (n, 3) [m]
    stiffness: Any  # (N, N) csr
    mass: Any  # (N, N) csr
    dof_nodes: Rows = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    dof_axes: Rows = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    interpolation: Any = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        count = len(self.nodes)
        if not len(self.dof_nodes):
            object.__setattr__(self, 'dof_nodes', np.tile(np.arange(count), 3))
            object.__setattr__(self, 'dof_axes', np.repeat(np.arange(3), count))

    def check(self) -> None:
        """Raise ModelError with everything that no body's matrices are."""
        size = len(self.dof_nodes)
        findings = []
        if not np.isfinite(self.nodes).all():
            findings.append('nodes must be finite, got some that are not')
        for name, unit in (('stiffness', 'N/m'), ('mass', 'kg')):
            matrix = getattr(self, name)
            if matrix.shape != (size, size):
                rule = f'{name} matrix must be {size} x {size}, a row per degree of freedom'
                findings.append(f'{rule}, got {matrix.shape[0]} x {matrix.shape[1]}')
                continue
            if not np.isfinite(matrix.data).all():
                findings.append(f'{name} matrix must be finite, got entries that are not')
                continue
            largest = float(abs(matrix).max()) if matrix.nnz else 0.0
            if largest == 0.0:
                findings.append(f'{name} matrix must have entries, got zeros only')
                continue
            off = float(abs(matrix - matrix.T).max()) / largest
            if off > ASYMMETRY:
                rule = f'{name} matrix must be symmetric'
                findings.append(f'{rule}, got {off:.3g} of its largest entry off')
            lowest = float(matrix.diagonal().min())
            if lowest < 0.0:
                rule = f'{name} of each degree of freedom must be >= 0 {unit}'
                findings.append(f'{rule}, got {lowest:.3g}')
        ModelError.raise_any(self.where, findings)

    @property
    def places(self) -> Array:
        """Places (n, 3) that `measure` and `displacement` are of: the nodes [m]."""
        return self.nodes

    @cached_property
    def measure(self) -> Any:
        """Mass of the displacements as a scalar measure (n, n) [kg]: the mean of x, y and z."""
        x, y, z = (self.mass[rows][:, rows] for rows in map(self.rows, range(3)))
        return (x + y + z) / 3.0

    def rows(self, axis: int) -> Rows:
        """Return the rows (n,) of one axis, in the order of nodes."""
        rows = np.flatnonzero(self.dof_axes == axis)
        order = rows[np.argsort(self.dof_nodes[rows], kind='stable')]
        if len(order) != len(self.nodes) or (self.dof_nodes[order] != np.arange(len(order))).any():
            rule = f'each node must have a displacement along {"xyz"[axis]}'
            raise ModelError(self.where, [f'{rule}, got {len(order)} of {len(self.nodes)} nodes'])
        return np.asarray(order)

    def displacement(self, values: Array) -> Array:
        """Return the nodes' displacement (n, 3, ...) of values (N, ...) of all rows."""
        return np.stack([values[self.rows(axis)] for axis in range(3)], axis=1)

    def values(self, displacement: Array) -> Array:
        """Return values (N,) of all rows, turns zero, from nodal displacements (n, 3)."""
        found = np.zeros(len(self.dof_nodes))
        moves = self.dof_axes < 3
        found[moves] = displacement[self.dof_nodes[moves], self.dof_axes[moves]]
        return found

    def slices(self, along: Array) -> list[Rows]:
        """Return the places of each slice across a line, by their x (n,) along it [m].

        Slices are quantiles, of enough places each.
        """
        count = int(np.clip(len(along) // (4 * FEWEST), 2, SLICES))
        edges = np.unique(np.quantile(along, np.linspace(0.0, 1.0, count + 1)))
        return [np.flatnonzero((along >= low) & (along <= high)) for low, high in pairwise(edges)]

    def line(self, patches: Sequence[Patch]) -> tuple[Array, Array]:
        """Return the ends (3,) of the line that the body lies along: root and last frame [m]."""
        return patches[0].origin, patches[-1].origin

    def strain(self, place: Array, direction: Array) -> Array:
        """Return the strain at a place in a direction, (N,) per unit of each row.

        Raises
        ------
        ModelError
            For a body whose elements are not known.
        """
        rule = 'strain points must have elements, got matrices alone'
        raise ModelError(self.where, [rule])

    def doubts(self) -> list[str]:
        """Return a warning for a mass that differs between directions."""
        totals = np.array([self.mass[rows][:, rows].sum() for rows in map(self.rows, range(3))])
        spread = float(np.ptp(totals) / totals.mean())
        said = f'mass differs by {spread:.1%} between x, y and z; their mean is taken'
        return [said] if spread > ANISOTROPY else []

    def rigid(self, rows: Rows, origin: Array) -> Array:
        """Return the motion (r, 6) of rows as of a rigid body: displacement of a point, turn."""
        arm = self.nodes[self.dof_nodes[rows]] - origin
        axes = self.dof_axes[rows]
        motion = np.zeros((len(rows), 6))
        motion[np.arange(len(rows)), axes] = 1.0
        for turn in range(3):
            moved = np.cross(np.eye(3)[turn], arm)
            moves = axes < 3
            motion[moves, 3 + turn] = moved[moves, axes[moves]]
        return motion


@dataclass(frozen=True)
class Patch:
    """Nodes that move as one rigid body with a frame of the link."""

    name: str  # of the frame; '' for the root
    origin: Array  # (3,) [m]
    rotation: Array  # (3, 3)
    nodes: Rows
    radius: float  # m, within which they lie


def patches_of(
    where: str,
    nodes: Array,
    frames: Sequence[tuple[str, Array, Array]],
    choose: Callable[[str, Array], tuple[Rows, float]],
) -> list[Patch]:
    """Return the rigid patch of each frame, the root's first.

    Parameters
    ----------
    where : str
        Of the body, for errors.
    nodes : ndarray (n, 3)
        Of the body [m].
    frames : sequence of (name, origin (3,), rotation (3, 3))
        The root first, its name empty.
    choose : callable
        Returns the nodes of a patch and its radius [m] from a frame's name and origin.

    Raises
    ------
    ModelError
        For a frame off the body, a patch that could turn about a line, two that overlap.
    """
    check_places(where, nodes, frames)
    findings, patches, owner = [], [], dict[int, str]()
    for name, origin, rotation in frames:
        whose = _whose(name)
        chosen, radius = choose(name, origin)
        if not _holds(nodes[chosen]):
            rule = f'{whose} must have nodes around it that are no line'
            place = ', '.join(f'{value:.4g}' for value in origin)
            findings.append(
                f'{rule}, got {len(chosen)} within {radius:.3g} m of ({place}): give a '
                'larger radius or a finer mesh, or check units and poses'
            )
            continue
        shared = {owner[node] for node in chosen.tolist() if node in owner}
        for other in sorted(shared):
            rule = f'{whose} must have a patch of its own'
            findings.append(f'{rule}, got nodes of {other} in it: give a smaller radius')
        owner.update(dict.fromkeys(chosen.tolist(), whose))
        patches.append(Patch(name, origin, rotation, chosen, radius))
    ModelError.raise_any(where, findings)
    return patches


def check_places(where: str, nodes: Array, frames: Sequence[tuple[str, Array, Array]]) -> None:
    """Raise ModelError with each frame far off the nodes (n, 3) of a body [m]."""
    findings = []
    lowest, highest = nodes.min(axis=0), nodes.max(axis=0)
    reach = float(np.linalg.norm(highest - lowest))
    for name, origin, _ in frames:
        outside = np.maximum(np.maximum(lowest - origin, origin - highest), 0.0)
        if (far := float(np.linalg.norm(outside))) > OFF * reach:
            rule = f'{_whose(name)} must be at the mesh, whose size is {reach:.3g} m'
            findings.append(f'{rule}, got {far:.3g} m off it; are units and poses right?')
    ModelError.raise_any(where, findings)


def _whose(name: str) -> str:
    return f'frame {name!r}' if name else 'the root'


def within(nodes: Array, origin: Array, radius: float) -> Rows:
    """Return the nodes no farther from a point than a radius [m]."""
    return np.flatnonzero(np.linalg.norm(nodes - origin, axis=1) <= radius * (1.0 + 1e-9))


def _holds(points: Array) -> bool:
    """Say whether points fix a rigid body: three that are no line."""
    if len(points) < 3:
        return False
    sizes = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(sizes[1] > PARALLEL * sizes[0])
