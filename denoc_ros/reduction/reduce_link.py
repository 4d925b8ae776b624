"""From a source, a mesh or matrices, to the file of a link: the function behind `denoc reduce`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from denoc_ros.errors import ConfigError, ModelError
from denoc_ros.reduction.body import FiniteElementBody, check_places, patches_of
from denoc_ros.reduction.craig_bampton import FACTORED, Report
from denoc_ros.reduction.elements import Elasticity, Solid
from denoc_ros.reduction.link import Reduction, Wishes, reduce_link
from denoc_ros.reduction.mesh import ClosedSurface, fill, patch_nodes, volume_doubts
from denoc_ros.reduction.suggest.materials import MATERIALS
from denoc_ros.types import Array

COARSER = 1.6  # edge of the mesh that the result is compared with
BASE_MEGABYTES = 250.0
# seconds and megabytes a n^b of n nodes, measured on one core with thick blocks: by a factor; and
# on two grids, 20,000 nodes 20 s, 0.6 GB, 204,000 nodes 314 s, 5.6 GB
FACTOR = (2e-6, 1.5), (1.2e-3, 4.0 / 3.0)
TWO_GRIDS = (1e-4, 1.23), (0.03, 1.0)
UNLIKE = 0.01  # between the two meshes' first frequency: more is told


@dataclass(frozen=True)
class Estimate:
    """Time [s] and memory [MB] that a reduction takes, about."""

    nodes: int
    seconds: float
    megabytes: float

    @classmethod
    def of(cls, nodes: int, modes: int, elements: bool = True) -> Estimate:
        """Return that of a number of nodes and modes; on two grids where elements are known."""
        share = 0.5 + 0.5 * modes / 6.0
        seconds, megabytes = (
            factor * nodes**power
            for factor, power in (TWO_GRIDS if elements and 3 * nodes > FACTORED else FACTOR)
        )
        return cls(nodes, share * seconds, BASE_MEGABYTES + megabytes)


@dataclass(frozen=True)
class Frames:
    """Frames of a link: outer ones by name, pose (4, 4) each; radii of patches by name."""

    outer: Mapping[str, Array]
    radii: Mapping[str, float]

    def rows(self) -> list[tuple[str, Array, Array]]:
        """Return the root and all outer frames as name, origin, rotation."""
        root = ('', np.zeros(3), np.eye(3))
        return [root, *((n, pose[:3, 3], pose[:3, :3]) for n, pose in self.outer.items())]


@dataclass(frozen=True)
class ReducedMesh:
    """A reduction, and the frequencies [Hz] of a coarser mesh, empty without one."""

    reduction: Reduction
    coarser: Array
    coarser_nodes: int
    doubts: tuple[str, ...]


def elasticity_of(
    material: str | None,
    young: float | None = None,
    poisson: float | None = None,
    density: float | None = None,
) -> tuple[Elasticity, str]:
    """Return an isotropic material, and its name, from the catalogue and numbers on top.

    Raises
    ------
    ConfigError
        For an unknown one, numbers that no material has, or numbers missing without a name.
    """
    findings = []
    if material is not None and material not in MATERIALS:
        findings.append(f'material must be one of {", ".join(MATERIALS)}, got {material!r}')
    numbers = {'young': young, 'poisson': poisson, 'density': density}
    missing = [name for name, value in numbers.items() if value is None]
    if material is None and missing:
        rule = 'material must be given by name, or by young, poisson and density'
        findings.append(f'{rule}, got no {", ".join(missing)}')
    for name, unit in (('young', 'Pa'), ('density', 'kg/m^3')):
        value = numbers[name]
        if value is not None and not 0.0 < value < np.inf:
            findings.append(f'{name} must be > 0 {unit} and finite, got {value:g}')
    if poisson is not None and not 0.0 <= poisson < 0.5:
        findings.append(f'poisson must be >= 0 and < 0.5, got {poisson:g}')
    ConfigError.raise_any('material', findings)
    known = None if material is None else MATERIALS[material]
    e = young if young is not None else known.e  # type: ignore[union-attr]
    if poisson is not None:
        g = e / (2.0 * (1.0 + poisson))
    else:
        assert known is not None
        g = known.g * e / known.e
    rho = density if density is not None else known.density  # type: ignore[union-attr]
    name = '' if known is None else f'{known.name} ({known.grade})'
    said = f'E {e:.4g} Pa, nu {e / (2.0 * g) - 1.0:.3g}, {rho:.5g} kg/m^3'
    if known is not None and known.name in ('cfrp', 'gfrp'):
        said += ', taken as isotropic'
    return Elasticity.of(e, g, rho), f'{name}: {said}' if name else said


def reduce_surface(
    surface: ClosedSurface,
    elasticity: Elasticity,
    frames: Frames,
    wishes: Wishes,
    source: str,
    edge: float | None = None,
    mass: float | None = None,
    compare: bool = True,
    told: Callable[[Estimate], None] = lambda estimate: None,
    report: Report = lambda share: None,
) -> ReducedMesh:
    """Reduce a link from its surface mesh.

    Parameters
    ----------
    source : str
        For the file: mesh and material.
    edge : float, optional
        Length of the tetrahedra's edges [m]; default: by the wall's thickness.
    mass : float, optional
        The density is scaled to this mass of the link [kg].
    compare : bool
        Whether a coarser mesh is reduced too.
    told : callable
        Takes time and memory before they are used.
    report : callable
        Takes the share of the work that is done.

    Raises
    ------
    ModelError
        For a mesh that cannot be filled, a frame off it, a gauge off its surface.
    SolverError
        If modes do not converge.
    """
    check_places(surface.where, np.asarray(surface.mesh.vertices), frames.rows())
    edge = surface.default_edge() if edge is None else edge
    solid = fill(surface, edge, elasticity)
    report(0.1)
    reduction = reduce_solid(
        solid, frames, wishes, source, mass, told, lambda share: report(0.1 + 0.7 * share)
    )
    coarser, nodes, doubts = np.zeros(0), 0, list(surface.doubts)
    if np.isfinite(surface.volume):
        doubts += volume_doubts(surface, solid)
    if compare:
        coarse = fill(surface, COARSER * edge, elasticity)
        report(0.85)
        try:
            other = reduce_solid(coarse, frames, replace(wishes, quadratic='none'), source, mass)
        except ModelError as error:
            doubts.append(f'a coarser mesh holds no frames: {error.findings[0]}')
        else:
            coarser, nodes = other.link.frequencies, other.nodes
            off = float(coarser[0] / reduction.link.frequencies[0] - 1.0)
            if abs(off) > UNLIKE:
                said = f'the first frequency is {off:+.1%} on a mesh {COARSER:g} times as coarse'
                doubts.append(f'{said}: use a smaller edge')
    report(1.0)
    return ReducedMesh(reduction, coarser, nodes, (*doubts, *reduction.doubts))


def reduce_solid(
    solid: Solid,
    frames: Frames,
    wishes: Wishes,
    source: str,
    mass: float | None = None,
    told: Callable[[Estimate], None] = lambda estimate: None,
    report: Report = lambda share: None,
) -> Reduction:
    """Reduce a body of tetrahedra; parameters as of `reduce_surface`."""
    if mass is not None:
        density = mass / solid.volume
        solid = solid.with_elasticity(replace(solid.elasticity, density=density))
    count = len(solid.nodes)
    told(Estimate.of(count, wishes.modes))
    said = f'{source}; {count} nodes of {len(solid.elements)} ten-node tetrahedra'
    patches = patches_of(
        solid.where, solid.nodes, frames.rows(), patch_nodes(solid.nodes, solid, frames.radii)
    )
    return reduce_link(solid.body(), solid, patches, wishes, said, report)


def reduce_matrices(
    body: FiniteElementBody,
    frames: Frames,
    wishes: Wishes,
    source: str,
    told: Callable[[Estimate], None] = lambda estimate: None,
    report: Report = lambda share: None,
) -> Reduction:
    """Reduce a body of another program's matrices; parameters as of `reduce_surface`."""
    told(Estimate.of(len(body.nodes), wishes.modes, elements=False))
    body.check()
    patches = patches_of(
        body.where, body.nodes, frames.rows(), patch_nodes(body.nodes, None, frames.radii)
    )
    said = f'{source}; {len(body.nodes)} nodes'
    return reduce_link(body, None, patches, wishes, said, report)
