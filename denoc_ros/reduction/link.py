"""A reduced body as the file of a link: points, frames, strain points, surface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from scipy.linalg import lapack

from denoc_ros.errors import ModelError
from denoc_ros.model.beams.link_file import LinkFrame, ReducedLink, StrainPoint, Surface
from denoc_ros.reduction.body import FiniteElementBody, Patch
from denoc_ros.reduction.craig_bampton import Craigs, LinkModes, Report, link_modes, reduce_body
from denoc_ros.reduction.elements import Solid
from denoc_ros.reduction.quadratic import Quadratic, foreshortening, modal_derivatives
from denoc_ros.reduction.suggest.materials import ASSUMED_DAMPING
from denoc_ros.types import Array

GRAM_ROUNDING = 1e-14  # of a function's square: what the factor leaves out
MOST_NODES = 3000  # of the surface in the file
NEAR_PATCH = 2.0  # radii of a patch: energy of elements within is that of its surroundings

QuadraticTerms = Literal['derivatives', 'line', 'none']


@dataclass(frozen=True)
class Wishes:
    """How a body is reduced.

    `modes` number of modes; `tip_mass` [kg] at outer frames; `gauges` name -> (place (3,),
    direction (3,)); `quadratic` how the second order is found.
    """

    modes: int = 6
    damping_ratio: float = ASSUMED_DAMPING
    tip_mass: Mapping[str, float] = field(default_factory=dict)
    gauges: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    quadratic: QuadraticTerms = 'derivatives'


@dataclass(frozen=True)
class Reduction:
    """A reduced link, and the figures of its page.

    `compliance` per outer frame (6,): static compliance along and about x, y, z [m/N, rad/(N m)];
    `patch_share` per frame, the root under '': share of the strain energy within two radii of it
    under a unit force at the last frame, the worst of three directions; empty without elements.
    """

    link: ReducedLink
    patches: Sequence[Patch]
    static: Sequence[str]
    compliance: Mapping[str, Array]
    patch_share: Mapping[str, float]
    quadratic: str
    nodes: int
    doubts: Sequence[str]


def reduce_link(
    body: FiniteElementBody,
    solid: Solid | None,
    patches: Sequence[Patch],
    wishes: Wishes,
    source: str,
    report: Report = lambda share: None,
) -> Reduction:
    """Reduce a body to the modes of a link whose root patch is the link frame.

    Parameters
    ----------
    body : FiniteElementBody
        In the link frame.
    solid : Solid or None
        Its elements, where they are known: without them there are no modal derivatives, strains
        and surface.
    patches : sequence of Patch
        The root's first.
    source : str
        Mesh, material and program, for the file.
    report : callable
        Takes the share of the work that is done.

    Raises
    ------
    ModelError
        For matrices that are no body's, or a gauge off the surface.
    SolverError
        If modes do not converge.
    """
    craigs = reduce_body(body, patches, wishes.modes, lambda share: report(0.7 * share))
    found = link_modes(craigs, wishes.modes, wishes.tip_mass)
    values = craigs.expand(found.coordinates)
    modes = body.displacement(values)
    quadratic = _quadratic(solid, craigs, found, wishes, lambda s: report(0.7 + 0.25 * s))
    points = _points(body, modes, quadratic)
    second = points[:, :4].T @ points[:, :4]
    link = ReducedLink(
        mass=float(second[0, 0]),
        com=second[0, 1:] / second[0, 0],
        inertia=np.trace(second[1:, 1:]) * np.eye(3) - second[1:, 1:],
        points=points,
        stiffness=found.stiffness,
        pairs=quadratic.pairs,
        frames={
            patch.name: LinkFrame(
                patch.origin,
                patch.rotation,
                found.coordinates[6 * k : 6 * k + 3],
                found.coordinates[6 * k + 3 : 6 * k + 6],
                quadratic.frames[k],
            )
            for k, patch in enumerate(patches[1:])
        },
        damping_ratio=np.full(wishes.modes, wishes.damping_ratio),
        strain=_gauges(body, solid, values, wishes.gauges),
        surface=None if solid is None else _surface(solid, modes),
        frequencies=found.frequencies,
        frequencies_left_out=found.left_out,
        left_out=found.lost,
        source=f'{source}; quadratic terms: {quadratic.kind}',
    )
    report(1.0)
    outer = craigs.outer
    compliance = np.linalg.inv(craigs.stiffness[:outer, :outer])
    return Reduction(
        link,
        patches,
        found.static,
        {p.name: np.diag(compliance)[6 * k : 6 * k + 6] for k, p in enumerate(patches[1:])},
        {} if solid is None else _patch_shares(solid, craigs, compliance),
        quadratic.kind,
        len(body.nodes),
        body.doubts(),
    )


def _quadratic(
    solid: Solid | None, craigs: Craigs, found: LinkModes, wishes: Wishes, report: Report
) -> Quadratic:
    if wishes.quadratic == 'none':
        return Quadratic.none(craigs.body, len(craigs.patches) - 1)
    if wishes.quadratic == 'derivatives' and solid is not None:
        return modal_derivatives(solid, craigs, found.coordinates, found.stiffness, report)
    return foreshortening(craigs.body, craigs, found.coordinates, found.stiffness)


def _points(body: FiniteElementBody, modes: Array, quadratic: Quadratic) -> Array:
    """Return rows of a factor of the Gram matrix, (k, 4 + 3 m + 3 g).

    Quadratic terms are projected on the other functions: what they lose of inertia is of the
    fourth order, and the rows are no more than 4 + 3 m.
    """
    count = len(body.places)
    columns = np.hstack(
        [
            np.ones((count, 1)),
            body.places,
            modes.transpose(0, 2, 1).reshape(count, -1),
            quadratic.nodes.transpose(0, 2, 1).reshape(count, -1),
        ]
    )
    gram = columns.T @ (body.measure @ columns)
    gram = 0.5 * (gram + gram.T)
    first = 4 + 3 * modes.shape[2]
    scale = np.sqrt(np.diag(gram)[:first])
    factor, pivot, rank, _ = lapack.dpstrf(
        gram[:first, :first] / np.outer(scale, scale), tol=GRAM_ROUNDING
    )
    spanning = pivot[:rank] - 1
    rows = np.zeros((rank, len(gram)))
    rows[:, pivot - 1] = np.triu(factor)[:rank] * scale[pivot - 1]
    rows[:, first:] = np.linalg.solve(rows[:, spanning].T, gram[spanning, first:])
    return rows


def _gauges(
    body: FiniteElementBody,
    solid: Solid | None,
    values: Array,
    gauges: Mapping[str, tuple[Array, Array]],
) -> dict[str, StrainPoint]:
    """Return strain points; of a solid at the surface's vertices next to where they are wished."""
    if solid is None:
        return {
            name: StrainPoint(
                place,
                direction / np.linalg.norm(direction),
                body.strain(place, direction) @ values,
            )
            for name, (place, direction) in gauges.items()
        }
    if not gauges:
        return {}
    modes = body.displacement(values)
    strain = np.stack([solid.strain(modes[:, :, k]) for k in range(modes.shape[2])], axis=2)
    vertices = np.unique(solid.faces)
    size = float(np.ptp(solid.nodes, axis=0).max())
    found = {}
    for name, (place, direction) in gauges.items():
        far = np.linalg.norm(solid.nodes[vertices] - place, axis=1)
        if far.min() > 0.1 * size:
            rule = f'strain point {name!r} must be on the surface'
            raise ModelError(body.where, [f'{rule}, got one {far.min():.3g} m off it'])
        at = vertices[int(np.argmin(far))]
        d = direction / np.linalg.norm(direction)
        row = np.array([d[0] ** 2, d[1] ** 2, d[2] ** 2])
        row = np.concatenate([row, 2.0 * np.array([d[1] * d[2], d[0] * d[2], d[0] * d[1]])])
        found[name] = StrainPoint(solid.nodes[at], d, row @ strain[at])
    return found


def _surface(solid: Solid, modes: Array) -> Surface:
    """Return the surface, thinned to MOST_NODES by merging vertices in cells of a grid."""
    faces = solid.faces
    vertices, flat = np.unique(faces, return_inverse=True)
    faces = flat.reshape(-1, 3)
    places = solid.nodes[vertices]
    cell = float(np.ptp(places, axis=0).max()) / 400.0
    kept = np.arange(len(places))
    while len(kept) > MOST_NODES:
        cell *= 1.2
        grid = np.floor((places - places.min(axis=0)) / cell).astype(np.int64)
        _, kept, owner = np.unique(grid, axis=0, return_index=True, return_inverse=True)
        faces = owner.ravel()[flat.reshape(-1, 3)]
    whole = (np.diff(np.sort(faces, axis=1), axis=1) > 0).all(axis=1)
    faces = faces[whole]
    _, once = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    chosen = vertices[kept]
    strain = [solid.strain(modes[:, :, k])[chosen] for k in range(modes.shape[2])]
    return Surface(
        solid.nodes[chosen], faces[np.sort(once)], modes[chosen], np.stack(strain, axis=2)
    )


def _patch_shares(solid: Solid, craigs: Craigs, compliance: Any) -> dict[str, float]:
    """Return the share of strain energy around each patch under forces at the last frame."""
    last = craigs.outer - 6
    centres = solid.nodes[solid.mesh.t.T].mean(axis=1)
    shares = {patch.name: 0.0 for patch in craigs.patches}
    for load in range(last, last + 3):
        coordinates = np.zeros((len(craigs.stiffness), 1))
        coordinates[: craigs.outer, 0] = compliance[:, load]
        field = craigs.body.displacement(craigs.expand(coordinates))[:, :, 0]
        energy = solid.strain_energy(field)
        for patch in craigs.patches:
            reach = NEAR_PATCH * patch.radius
            near = np.linalg.norm(centres - patch.origin, axis=1) < reach
            shares[patch.name] = max(shares[patch.name], float(energy[near].sum() / energy.sum()))
    return shares
