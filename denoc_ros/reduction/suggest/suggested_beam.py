"""A link as a beam: its numbers from the plain URDF, and whether it bends enough."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from denoc_ros.model.inertia import (
    inverse_transform,
    largest_mass_per_length,
    largest_polar_inertia,
    moved,
)
from denoc_ros.model.reading.findings import SMALLEST, Element
from denoc_ros.model.reading.link_geometry import lost_mesh
from denoc_ros.model.tree import JointKind, RigidInertia
from denoc_ros.reduction.suggest.carried_bodies import SubtreeInertia
from denoc_ros.reduction.suggest.materials import ASSUMED_DAMPING, Material
from denoc_ros.reduction.suggest.outer_size import outline
from denoc_ros.reduction.suggest.slender import BeamLine, Stiffness, beam_line, stiffness

ROOTS = (1.8751041, 4.6940911, 7.8547574)  # of a cantilever's bending modes
VISIBLE = 1e-3  # deflection over length from which a link is worth it
FIRST_WITHIN, ALL_WITHIN = (
    5.0,
    10.0,
)  # times the bandwidth: a first mode, and all modes, below it count
STUBBY = 4.0  # length over width below which a link is no slender beam
LEAST_SHARE = 0.05  # of a link's mass: less spread along the beam makes no beam
UNCLEAR = 0.3  # of its mass, below which a link of unknown size is left rigid
SHORTEST = 1e-3  # m, to a next joint that is not beside the link's own


@dataclass(frozen=True)
class BeamSuggestion:
    """Proposal of a beam for a link."""

    link: str  # its name
    worth: bool  # whether it is proposed, or was asked for
    reason: str  # why, or why not
    line: BeamLine  # where the beam lies
    mass_per_length: float  # [kg/m]
    beam_share: float  # of the link's mass in the beam; the rest stays rigid at the link's joint
    stiffness: Stiffness  # EI and GJ, with what they rest on
    polar_inertia: float  # per length [kg m^2/m]
    modes: tuple[int, int, int]  # (y, z, torsion)
    damping_ratio: float  # assumed
    frequency: float  # first bending frequency with what the link carries as a tip mass [Hz]
    sag: float  # tip deflection of the link held level, under its weight and what it carries [m]
    # tip deflection under its joint's rated effort [m]; nan if none is rated
    effort_deflection: float


@dataclass(frozen=True)
class Wish:
    """Criteria for all links of a robot."""

    material: Material
    bandwidth: float  # Hz
    gravity: float  # m/s^2, its size
    surfaces: Mapping[str, Any]  # of `link_surfaces`


def suggested_beam(
    link: str, load: SubtreeInertia, element: Element, wish: Wish, asked: bool
) -> BeamSuggestion | str:
    """Return a link as a beam, or the reason why it cannot be one.

    Parameters
    ----------
    wish : Wish
        The material, and what is worth it.
    """
    if load.own.mass < SMALLEST:
        return 'it has no mass: a beam takes its share of the <inertial>'
    line = _line_of(load)
    if line is None:
        return 'it has no length: neither a joint nor its mass is away from its own joint'
    body = moved(load.own, inverse_transform(line.frame))
    most = largest_mass_per_length(body, line.length, 0.0)
    if most * line.length < LEAST_SHARE * load.own.mass:
        return 'its mass is not spread along the line from joint to joint'
    outer = outline(element, line.frame, line.length, wish.surfaces)
    stiff = stiffness(body, line, most, outer, wish.material)
    if stiff.stations:
        most = largest_mass_per_length(body, line.length, 0.0, stiff.mass_along)
        stiff = stiffness(body, line, most, outer, wish.material)
    if outer is None and (lost := lost_mesh(element, wish.surfaces)):
        stiff = replace(stiff, why=f'{stiff.why}; its mesh {lost} is not available')
    tip = _tip_load(load, line)
    mass_per_length, polar, modes = _shares(body, line, most, stiff, tip, wish.bandwidth)
    frequency = _first_frequency(stiff, line.length, most, tip)
    sag, by_effort = _deflections(stiff, line, most, tip, load, wish.gravity)
    worth, reason = _judge(line.length, stiff, frequency, sag, by_effort, wish.bandwidth)
    share = min(1.0, mass_per_length * line.length / load.own.mass)
    if outer is None and share < UNCLEAR:
        worth, reason = False, f'unclear: {1.0 - share:.0%} of its mass is no part of a beam'
    return BeamSuggestion(
        link,
        worth or asked,
        reason,
        line,
        mass_per_length,
        share,
        stiff,
        polar,
        modes,
        ASSUMED_DAMPING,
        frequency,
        sag,
        by_effort,
    )


def _line_of(load: SubtreeInertia) -> BeamLine | None:
    """Return the line to the farthest next joint, else link; a last link is twice its centre."""
    places = [place for place, _ in load.moving] or load.fixed
    places = [place for place in places if np.linalg.norm(place) > SHORTEST]
    end = max(places, key=lambda place: float(np.linalg.norm(place)), default=None)
    if end is None:
        end = 2.0 * load.own.first_moment / load.own.mass
    return beam_line(load.own, end, [load.axis, *(axis for _, axis in load.moving)])


@dataclass(frozen=True)
class _TipLoad:
    """Load on a beam's tip."""

    mass: float  # kg
    offset: float  # m, of its centre from the tip, all joints at zero
    about_axis: float  # kg m^2, inertia about the beam's axis


def _tip_load(load: SubtreeInertia, line: BeamLine) -> _TipLoad:
    carried = moved(load.carried, inverse_transform(line.frame))
    if carried.mass <= 0.0:
        return _TipLoad(0.0, 0.0, 0.0)
    centre = carried.first_moment / carried.mass - [line.length, 0.0, 0.0]
    return _TipLoad(carried.mass, float(np.linalg.norm(centre)), float(carried.inertia[0, 0]))


def _shares(
    body: RigidInertia,
    line: BeamLine,
    most: float,
    stiff: Stiffness,
    tip: _TipLoad,
    bandwidth: float,
) -> tuple[float, float, tuple[int, int, int]]:
    """Return mass per length, polar inertia per length, and the modes (y, z, torsion)."""
    heavy = tip.mass > most * line.length
    y, z = (
        _bending_modes(ei, most, line.length, heavy, bandwidth) for ei in (stiff.ei_y, stiff.ei_z)
    )
    admissible = largest_polar_inertia(body, line.length)
    polar = min(float(f'{stiff.polar_inertia:.4g}'), admissible)
    turning = tip.about_axis + polar * line.length / 3.0
    slow = turning > 0.0 and math.sqrt(stiff.gj / (line.length * turning)) <= (
        2.0 * math.pi * ALL_WITHIN * bandwidth
    )
    left = 0.0
    if slow and polar > 0.0:
        left = largest_mass_per_length(body, line.length, polar, stiff.mass_along)
    if left >= 0.9 * most:
        return left, polar, (y, z, 1)
    return most, polar, (y, z, 0)


def _bending_modes(
    ei: float, mass_per_length: float, length: float, heavy: bool, bandwidth: float
) -> int:
    """Return 1 to 3; at least 2 with a heavy tip, whose static sag one mode misses by 3 %."""
    unit = math.sqrt(ei / mass_per_length) / (2.0 * math.pi * length**2)
    below = sum(root**2 * unit <= ALL_WITHIN * bandwidth for root in ROOTS)
    return max(below, 2 if heavy else 1)


def _first_frequency(
    stiff: Stiffness, length: float, mass_per_length: float, tip: _TipLoad
) -> float:
    """Return the lower of the two first bending frequencies [Hz], by Rayleigh's quotient.

    Notes
    -----
    The tip's mass moves by its own offset times the slope 3/2 d / length of a tip force as well;
    33/140 of a cantilever's mass count at its tip.
    """
    moving = tip.mass * (1.0 + 1.5 * tip.offset / length) ** 2
    moving += 33.0 / 140.0 * mass_per_length * length
    stiffest = 3.0 * min(stiff.ei_y, stiff.ei_z) / length**3
    return math.sqrt(stiffest / moving) / (2.0 * math.pi)


def _deflections(
    stiff: Stiffness,
    line: BeamLine,
    mass_per_length: float,
    tip: _TipLoad,
    load: SubtreeInertia,
    gravity: float,
) -> tuple[float, float]:
    """Return the tip's deflection by weight, held level, and by the joint's effort [m]."""
    length, ei = line.length, min(stiff.ei_y, stiff.ei_z)
    own = mass_per_length * length**4 / 8.0
    hung = tip.mass * (length**3 / 3.0 + tip.offset * length**2 / 2.0)
    joint, by_effort = load.joint, math.nan
    if joint is not None and 0.0 < joint.limits.effort < math.inf:
        # along the beam it pulls or twists
        across = float(np.linalg.norm(np.cross(load.axis, line.frame[:3, 0])))
        lever = length if joint.kind is JointKind.REVOLUTE else 1.0
        by_effort = across * joint.limits.effort / lever * length**3 / (3.0 * ei)
    return gravity * (own + hung) / ei, by_effort


def _judge(
    length: float,
    stiff: Stiffness,
    frequency: float,
    sag: float,
    by_effort: float,
    bandwidth: float,
) -> tuple[bool, str]:
    if length < STUBBY * stiff.width:
        # rounded down: 3.99 is less than 4
        ratio = math.floor(100.0 * length / stiff.width) / 100.0
        return False, f'stubby: {ratio:g} times as long as wide, less than {STUBBY:g}'
    if sag >= VISIBLE * length:
        return True, f'sags by {sag / length:.2g} of its length'
    if by_effort >= VISIBLE * length:
        return True, f'bends by {by_effort / length:.2g} of its length at its rated effort'
    if frequency <= FIRST_WITHIN * bandwidth:
        return (
            True,
            f'vibrates at about {frequency:.2g} Hz, below {FIRST_WITHIN * bandwidth:g} Hz',
        )
    most = np.nanmax([sag, by_effort]) / length
    return False, f'stiff: bends by {most:.1g} of its length, vibrates at about {frequency:.2g} Hz'
