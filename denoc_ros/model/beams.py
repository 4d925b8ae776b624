"""From a `<beam>` and its link's inertial to the beam and the rigid rest of the link."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from denoc_ros.model.along import Along
from denoc_ros.model.findings import SMALLEST, Findings
from denoc_ros.model.flexibility import BeamElement, DeformationElement
from denoc_ros.model.inertia import difference, inverse_transform, moved
from denoc_ros.model.residual_inertia import (
    ROUNDING,
    TOLERANCE,
    beam_inertia,
    inertia_violation,
    largest_mass_per_length,
    largest_polar_inertia,
)
from denoc_ros.model.segments import (
    critical_damping,
    segment_shapes,
    segment_torsion_shapes,
    with_stiffness,
)
from denoc_ros.model.shapes import ShapeFunctions, shape_functions, torsion_shapes
from denoc_ros.model.tree import Beam, Deformation, FlexibleLink, RigidInertia
from denoc_ros.model.varying_shapes import first_root, varying_shapes

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
    made = with_stiffness(made, element.stiffness)
    if element.damping is not None:
        return replace(made, damping=none + element.damping)
    if (ratio := element.damping_ratio) is not None:
        critical = critical_damping(made, inertia_per_length, own, segments)
        return replace(made, damping=ratio * critical, damping_ratio=ratio)
    return made
