"""From a `<beam>` and its link's inertial to the beam and the rigid rest of the link.

The space is that of Hermite elements (bending: values and slopes of the nodes; twist: values) with
inner polynomials up to degree 8 in each. Elements end where a number of the section steps, where
curvature may jump. With a dozen elements the first modes are exact to 1e-9.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.linalg import eigh

from denoc_ros.model.beams.along import Along
from denoc_ros.model.beams.cross_sections import AXES
from denoc_ros.model.beams.segments import critical_damping, segment_shapes, segment_torsion_shapes
from denoc_ros.model.beams.shapes import (
    ShapeFunctions,
    merged_edges,
    panels,
    scaled_shapes,
    shape_functions,
    torsion_shapes,
)
from denoc_ros.model.inertia import (
    ROUNDING,
    TOLERANCE,
    beam_inertia,
    difference,
    inertia_violation,
    inverse_transform,
    largest_mass_per_length,
    largest_polar_inertia,
    moved,
)
from denoc_ros.model.reading.findings import SMALLEST, Findings
from denoc_ros.model.reading.flexibility import BeamElement, DeformationElement
from denoc_ros.model.tree import Beam, Deformation, FlexibleLink, RigidInertia
from denoc_ros.types import Array

WARPING = 0.05  # of the length: held ends farther felt are told
POINTED = 1e-12  # of a mean: what arithmetic leaves of a zero at the tip


def flexible_link(
    element: BeamElement,
    inertia: RigidInertia | None,
    findings: Findings,
    warnings: list[str],
    carries: bool = False,
) -> FlexibleLink | None:
    """Return a link's beam and rest, None if the link does not allow it.

    Parameters
    ----------
    element : BeamElement
        The beam as the file says it.
    inertia : RigidInertia or None
        The whole link about its link frame; None without an `<inertial>`.
    findings : Findings
        Gathers what is wrong.
    warnings : list of str
        Gathers what is doubtful.
    carries : bool
        Whether a mass or a loop hangs on the beam beyond its root.

    Returns
    -------
    FlexibleLink or None
        In the beam frame.
    """
    whose = f'beam {element.link!r}'
    if (coupled := _coupled(element)) is not None:
        findings.add(whose, coupled)
        return None
    warnings += warping_doubts(element)
    if inertia is None or inertia.mass < SMALLEST:
        got = 'none' if inertia is None else f'mass {inertia.mass:g} kg'
        rule = "must have a mass, of which the beam is a share: the link's <inertial>"
        findings.add(whose, f'link {rule}, got {got}')
        return None
    whole = moved(inertia, inverse_transform(element.origin))
    mass_per_length = element.mass_per_length
    if mass_per_length is None:
        mass_per_length = inertia.mass / element.length
    polar_inertia = _polar_inertia(element, whole)
    if polar_inertia is None:
        rule = "must be > 0 kg m^2/m, given or by the link's inertia about the beam axis"
        about = f'{whole.inertia[0, 0]:g} kg m^2'
        findings.add(whose, f'polar_inertia (torsion) {rule}, got {about}')
        return None
    if (found := _pointed(element, carries)) is not None:
        findings.add(whose, found)
        return None
    share = (mass_per_length, element.length)
    rest = difference(whole, beam_inertia(*share, polar_inertia, element.mass_along))
    # a torsion of no modes takes nothing, but its link may be flexible in torsion all the same
    polar = polar_inertia if element.torsion is None else element.polar_inertia or polar_inertia
    beside = difference(whole, beam_inertia(*share, polar, element.mass_along))
    if not _possible_rest(element, whole, beside, mass_per_length, polar, findings, warnings):
        return None
    with np.errstate(over='ignore', under='ignore', invalid='ignore'):
        beams = _beams(element, mass_per_length, polar_inertia, carries)
    for part in [part for beam in beams for part in (beam.y, beam.z, beam.torsion)]:
        if part is not None and not np.isfinite([part.modal_stiffness, part.damping]).all():
            findings.add(whose, 'modal stiffness and damping must be finite, got an overflow')
            return None
    return FlexibleLink(element.origin, beams, rest)


def _coupled(element: BeamElement) -> str | None:
    """Fault of a beam that bends, twists and stretches as one, None if there is none."""
    way = 'denoc reduce ROBOT.urdf --link LINK makes such a beam a <flexible> link'
    if (axes := element.axes) is not None:
        size = np.abs(axes.values(np.linspace(0.0, 1.0, 9))).max(axis=0)
        names = ', '.join(name for name, most in zip(AXES, size, strict=True) if most > 0.0)
        rule = (
            'must have their principal axes turned as one, and the shear centre and the centroid '
            'on the beam axis or one line beside it'
        )
        return f'sections with {names} {rule}, got others: {way}'
    if element.stretch is not None:
        return f'ea of <at> must be left out: the beam does not stretch; {way}'
    return None


def warping_doubts(element: BeamElement) -> list[str]:
    """Return a warning for a beam whose held ends would stop its sections from warping."""
    if element.torsion is None or element.torsion.modes == 0:
        return []
    reach = float(np.sqrt(element.warping_rigidity / element.torsion.stiffness))
    if reach < WARPING * element.length:
        return []
    said = f'held ends stop its sections from warping over {reach:.3g} m'
    return [f'beam {element.link!r}: {said}, which makes it stiffer in torsion than it is here']


def _polar_inertia(element: BeamElement, whole: RigidInertia) -> float | None:
    """Return the polar inertia per length, 0 without torsion, None if torsion has none."""
    if element.torsion is None or element.torsion.modes == 0:
        return 0.0
    if element.polar_inertia is not None:
        return element.polar_inertia
    about_axis = float(whole.inertia[0, 0])
    scale = float(np.abs(whole.inertia).max())
    return about_axis / element.length if about_axis > ROUNDING * scale else None


def _possible_rest(
    element: BeamElement,
    whole: RigidInertia,
    rest: RigidInertia,
    mass_per_length: float,
    polar_inertia: float,
    findings: Findings,
    warnings: list[str],
) -> bool:
    """Return whether the rest of a link is a possible body, or nearly one."""
    whose, length = f'beam {element.link!r}', element.length
    lack = inertia_violation(rest, whole)
    if lack <= ROUNDING:
        return True
    numbers = (
        f'mass_per_length {mass_per_length:g} kg/m x length {length:g} m of the link mass '
        f'{whole.mass:g} kg leaves mass {rest.mass:g} kg and {rest.inertia[0, 0]:g} kg m^2 about '
        f"the beam axis, and is {lack:.3g} of the link's below zero"
    )
    rule = (
        'rest of the link beside the beam must be physically possible (mass and inertia '
        'not negative)'
    )
    if lack <= TOLERANCE:
        warnings.append(f'{whose}: {rule}, got within rounding: {numbers}')
        return True
    findings.add(whose, f'{rule}, got: {numbers}; {_way_out(whole, element, polar_inertia)}')
    return False


def _way_out(whole: RigidInertia, element: BeamElement, polar_inertia: float) -> str:
    length, along = element.length, element.mass_along
    largest = largest_mass_per_length(whole, length, polar_inertia, along)
    if largest > 0.0:
        if along.uniform:
            return f'the largest admissible mass_per_length is {largest:.4g} kg/m'
        return f'the largest admissible mean mass_per_length is {largest:.4g} kg/m'
    if inertia_violation(whole, whole) > TOLERANCE:
        return "no mass_per_length is possible: the link's own inertia is physically impossible"
    if polar_inertia > 0.0 and largest_mass_per_length(whole, length, 0.0, along) > 0.0:
        polar = largest_polar_inertia(whole, length)
        return f'no mass_per_length is possible unless polar_inertia is below {polar:.4g} kg m^2/m'
    return "no mass_per_length is possible: the link's mass is not spread along the beam axis"


def shape_for(element: BeamElement, modes: int, carries: bool) -> str:
    """Return the shape of a beam's bending in a direction with so many modes.

    Where the file does not say: craig-bampton for a beam that carries something beyond its root,
    which bends it by forces and moments; clamped-free, whose frequencies are exact, for one that
    carries nothing, and where one mode is too few for the two static shapes.
    """
    if element.segments > 1:
        return 'craig-bampton' if modes > 1 else 'constant curvature'
    return element.shape or ('craig-bampton' if carries and modes > 1 else 'clamped-free')


def _pointed(element: BeamElement, carries: bool) -> str | None:
    """Fault of a beam whose section has nothing left at its tip, None if there is none."""
    parts = {'ei_y': element.y, 'ei_z': element.z, 'gj': element.torsion}
    for name, part in parts.items():
        if part is None or part.modes == 0 or part.along.values(np.ones(1))[0] > POINTED:
            continue
        if carries:
            return f'{name} must be > 0 at the tip of a beam that carries something, got 0'
        if element.segments > 1:
            return f'{name} must be > 0 at the tip with segments > 1, got 0'
        shape = shape_for(element, part.modes, carries)
        if name != 'gj' and shape != 'clamped-free':
            return f'{name} must be > 0 at the tip with shape {shape}, got 0'
    return None


def _beams(
    element: BeamElement, mass_per_length: float, polar_inertia: float, carries: bool
) -> tuple[Beam, ...]:
    """Return the beam, or its segments."""
    parts = (element.y, element.z, element.torsion)
    bends = any(part is not None and part.modes for part in parts)
    segments = element.segments if bends else 1
    length = element.length / segments
    mass, polar = element.mass_along, element.polar_along
    found = []
    for k in range(segments):
        span = (k / segments, (k + 1) / segments)
        y, z = (
            None
            if part is None or part.modes == 0
            else _deformation(
                part, 2, shape_for(element, part.modes, carries), element, mass_per_length, span
            )
            for part in parts[:2]
        )
        torsion = None
        if element.torsion is not None and element.torsion.modes > 0:
            # a torque at the tip twists a tapered beam most where it is thin: a shape of its own
            varying = not (element.torsion.along.uniform and polar.uniform)
            name = 'static twist' if carries and varying and segments == 1 else ''
            torsion = _deformation(element.torsion, 1, name, element, polar_inertia, span)
        own = (mass.part(*span), polar.part(*span))
        limit = element.strain
        beam = Beam(length, mass_per_length, polar_inertia, y, z, torsion, segments, *own)
        found.append(
            replace(
                beam,
                strain_limit=limit.strain,
                surface=limit.surface,
                corners=limit.corners,
                has_section=limit.of_section,
            )
        )
    return tuple(found)


def _shapes(
    name: str, order: int, modes: int, length: float, segments: int, along: tuple[Along, Along]
) -> ShapeFunctions:
    """Return the shapes of a beam, or of one of its segments, of given stiffness and inertia."""
    if not (along[0].uniform and along[1].uniform):
        if order == 1:
            name = 'static twist' if name or segments > 1 else 'twist'
        elif name == 'constant curvature':
            name = 'constant moment'
        return varying_shapes(name, modes, length, *along)
    if order == 1:
        return (torsion_shapes if segments == 1 else segment_torsion_shapes)(modes, length)
    return shape_functions(name, modes, length) if segments == 1 else segment_shapes(modes, length)


def _deformation(
    element: DeformationElement,
    order: int,
    name: str,
    beam: BeamElement,
    inertia_per_length: float,
    span: tuple[float, float],
) -> Deformation:
    """Return a deformation whose strain is the derivative of an order of the displacement."""
    segments = beam.segments
    inertia = beam.mass_along if order == 2 else beam.polar_along
    along, own = element.along.part(*span), inertia.part(*span)
    length = beam.length / segments
    shapes = _shapes(name, order, element.modes, length, segments, (along, own))
    none = np.zeros(element.modes)
    root = None
    if segments > 1 and not (element.along.uniform and inertia.uniform):
        root = first_root(order, element.along, inertia)
    made = Deformation(shapes, element.stiffness, none, none, name, along, order, root)
    made = made.with_stiffness(element.stiffness)
    if element.damping is not None:
        return replace(made, damping=none + element.damping)
    if (ratio := element.damping_ratio) is not None:
        critical = critical_damping(made, inertia_per_length, own, segments)
        return replace(made, damping=ratio * critical, damping_ratio=ratio)
    return made


# shapes of a beam whose section varies ----------------------------------------------------------

DEGREE = 8
LEAST_ELEMENTS = 12


@dataclass(frozen=True, eq=False)
class PiecewiseShapes(ShapeFunctions):
    """Shape functions that are a polynomial between each two edges."""

    length: float  # length of the beam [m]
    spans: tuple[float, ...]  # shares of the length, from 0 to 1
    coefficients: Array  # (DEGREE + 1, elements, modes) of Legendre polynomials

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
