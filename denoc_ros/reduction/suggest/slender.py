"""A rigid link as a beam: its line, and the range of its stiffness."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from denoc_ros.model.beams.along import CONSTANT, Along, mean_and_along, sample_shares
from denoc_ros.model.beams.cross_sections import (
    CrossSection,
    rectangle_section,
    rectangle_tube_section,
    round_section,
    tube_section,
)
from denoc_ros.model.inertia import pseudo_inertia
from denoc_ros.model.reading.poses import pose_of
from denoc_ros.model.tree import RigidInertia
from denoc_ros.reduction.suggest.materials import Material
from denoc_ros.reduction.suggest.outer_size import Outline
from denoc_ros.types import Array

SLENDER = 0.5  # least over middle principal moment: below it the inertia has an axis of its own
ALONG = 0.85  # cosine between that axis and the line from joint to joint: 32 degrees
SNAPPED = 0.9994  # cosine: a line within 2 degrees of an axis of the link frame is along it
AGREED, DOUBTED = 1.3, 3.0  # ratio of two estimates of EI
THICK = 0.4  # area over the full section's: a tube's wall of 0.11 of its diameter
LEAST = 0.95  # of the least polar moment that an area can have: below it, no rounding
FLAT = 1e-4  # of one second moment to the other: a strip a hundred times as wide as thick
NO_SECTION = 'no section has this inertia about the axis'
FINE = 401  # points of an integral along a taper
WHOLE = 0.9  # of the link's mass in the beam: the link is a beam and little else


@dataclass(frozen=True)
class BeamLine:
    """Where a beam lies in its link."""

    frame: Array  # (4, 4) beam frame seen from the link frame
    length: float  # m


def beam_line(body: RigidInertia, end: Array, across: Iterable[Array]) -> BeamLine | None:
    """Return the line that a link extends along.

    Parameters
    ----------
    end : ndarray (3,)
        Where the next joint is, in the link frame [m].
    across : iterable of ndarray (3,)
        Wished directions of the beam's z; the first that is across the line is taken.

    Returns
    -------
    BeamLine or None
        Through the centre of mass along the least principal axis where the inertia has a clear
        one near the way to the next joint; else from the link's origin to that joint. Both ends
        are the feet of the joints on it. None if it has no length.
    """
    distance = float(np.linalg.norm(end))
    if distance < 1e-6:
        return None
    direction, through = end / distance, np.zeros(3)
    centre = body.first_moment / body.mass
    spread = pseudo_inertia(body, 1.0)[:3, :3] - body.mass * np.outer(centre, centre)
    moments, axes = np.linalg.eigh(np.trace(spread) * np.eye(3) - spread)
    longest = axes[:, 0] * np.sign(axes[:, 0] @ direction)
    if moments[0] < SLENDER * moments[1] and longest @ direction > ALONG:
        direction, through = longest, centre
    nearest = int(np.abs(direction).argmax())
    if abs(direction[nearest]) > SNAPPED:
        direction = np.sign(direction[nearest]) * np.eye(3)[nearest]
    direction = direction + 0.0  # no negative zeros
    length = float(f'{end @ direction:.6g}')
    if length <= 0.0:
        return None
    root = np.round(through - (through @ direction) * direction, 9)
    return BeamLine(pose_of(root, _turned(direction, across)), length)


def _turned(x: Array, across: Iterable[Array]) -> Array:
    """Return the rotation with a given X, and Z near the first direction that is across it."""
    for wish in (*across, *np.eye(3)):
        z = wish - (wish @ x) * x
        size = float(np.linalg.norm(z))
        if size > 0.5:
            z = z / size
            return np.column_stack([x, np.cross(z, x), z])
    raise AssertionError('one of three axes is across any line')


@dataclass(frozen=True)
class SectionNumbers:
    """Numbers of a beam at a share of its length: [N m^2], [kg/m], [kg m^2/m]."""

    share: float
    ei_y: float
    ei_z: float
    gj: float
    mass_per_length: float
    polar_inertia: float


@dataclass(frozen=True)
class Stiffness:
    """Stiffness of a link's beam."""

    # of a taper: of the uniform beam that bends and twists as much under a load at the tip [N m^2]
    ei_y: float
    ei_z: float
    gj: float
    # least and largest of EI that the file allows to think of [N m^2]
    ei_range: tuple[float, float]
    polar_inertia: float  # per length [kg m^2/m]
    width: float  # largest outer side [m]
    section: str  # the cross-section in words
    confidence: str  # high | medium | low
    why: str  # what the confidence rests on
    stations: tuple[SectionNumbers, ...] = ()  # of a taper; empty for a prism

    @property
    def mass_along(self) -> Along:
        """Shares of the mean mass per length along the beam."""
        breaks = np.array([station.share for station in self.stations])
        mass = [station.mass_per_length for station in self.stations]
        between = [a + (b - a) * sample_shares() for a, b in itertools.pairwise(mass)]
        return mean_and_along(breaks, between)[1] if between else CONSTANT


def stiffness(
    body: RigidInertia,
    line: BeamLine,
    mass_per_length: float,
    outer: Outline | None,
    material: Material,
) -> Stiffness:
    """Return the estimated stiffness of a beam, with its range and confidence.

    Parameters
    ----------
    mass_per_length : float
        What of the link is taken as the beam [kg/m].
    outer : Outline or None
        Its outer size, where the file says it.

    Returns
    -------
    Stiffness
        With an outer size: that of a hollow section of this size and mass. Else that of the
        inertia about the axis.

    Notes
    -----
    A prism of one material has int y^2 dm = density I_y length, so EI_y = (e / density)
    (int y^2 dm) / length: exact whatever its section. Motors inside make it too large. Of all
    sections of a mass the full circle is the softest (but for flat ones), the lower bound.
    """
    area = mass_per_length / material.density
    share = min(1.0, mass_per_length * line.length / body.mass)
    second = _second_moments(body) / (material.density * line.length)
    by_inertia = material.e * share * second
    full = round_section(2.0 * math.sqrt(area / math.pi))
    softest = material.e * full.moment_y
    if outer is None:
        return _by_inertia(area, share, second, softest, material)
    stations = _stations(outer, area, material)
    section, words, fullness = _hollow(outer, area)
    ei = material.e * np.array([section.moment_y, section.moment_z])
    if stations:
        words = f'{words} in the middle, tapered'
        mean = np.trapezoid([(s.ei_y, s.ei_z) for s in stations], _shares(stations), axis=0)
        ei = np.asarray(mean)
    if not _possible(second * share, area):
        by_inertia = np.full(2, softest)
        confidence, why = 'low', f'{NO_SECTION}: only the outer size is used'
    else:
        apart = float(np.max(np.maximum(ei, by_inertia) / np.minimum(ei, by_inertia)))
        confidence, why = _trust(outer, apart, share, fullness)
    gj, polar = material.g * section.torsion_constant, material.density * section.polar_moment
    if stations:
        ei = np.array([_as_uniform(stations, name, 2) for name in ('ei_y', 'ei_z')])
        gj = _as_uniform(stations, 'gj', 0)
        polar = float(np.trapezoid([s.polar_inertia for s in stations], _shares(stations)))
    return Stiffness(
        float(ei[0]),
        float(ei[1]),
        gj,
        (float(min(ei.min(), by_inertia.min())), float(max(ei.max(), by_inertia.max()))),
        polar,
        max(outer.y, outer.z),
        f'{words} ({outer.origin})',
        confidence,
        why,
        stations,
    )


def _shares(stations: Sequence[SectionNumbers]) -> list[float]:
    return [station.share for station in stations]


def _as_uniform(stations: Sequence[SectionNumbers], name: str, power: int) -> float:
    """Return the number of a uniform beam with the same compliance of its tip.

    A force at the tip bends by int (1 - x)^2 / EI dx, a torque twists by int 1 / GJ dx.
    """
    x = np.linspace(0.0, 1.0, FINE)
    along = np.interp(x, _shares(stations), [getattr(s, name) for s in stations])
    weight = (1.0 - x) ** power
    return float(np.trapezoid(weight, x) / np.trapezoid(weight / along, x))


def _stations(outer: Outline, area: float, material: Material) -> tuple[SectionNumbers, ...]:
    """Return the numbers along a taper whose wall is the same all along, of a mean area."""
    if not outer.taper:
        return ()

    def sections(wall: float) -> list[CrossSection]:
        if outer.circular:
            sides = [0.5 * (y + z) for _, y, z in outer.taper]
            return [tube_section(side, min(wall, 0.5 * side)) for side in sides]
        return [rectangle_tube_section(y, z, wall) for _, y, z in outer.taper]

    shares = [share for share, _, _ in outer.taper]

    def excess(wall: float) -> float:
        return float(np.trapezoid([s.area for s in sections(wall)], shares)) - area

    thickest = 0.5 * max(max(y, z) for _, y, z in outer.taper)
    if excess(thickest) <= 0.0:  # more mass than a full taper has
        return ()
    wall = float(brentq(excess, 0.0, thickest))
    return tuple(
        SectionNumbers(
            share,
            material.e * section.moment_y,
            material.e * section.moment_z,
            material.g * section.torsion_constant,
            material.density * section.area,
            material.density * section.polar_moment,
        )
        for share, section in zip(shares, sections(wall), strict=True)
    )


def _second_moments(body: RigidInertia) -> Array:
    """Return the integrals of y^2 and z^2 over the mass, about its centre [kg m^2]."""
    offset = body.first_moment[1:] / body.mass
    diagonal = np.diag(pseudo_inertia(body, 1.0))[1:3]
    return np.asarray(np.maximum(diagonal - body.mass * offset**2, 0.0))


def _possible(moments: Array, area: float) -> bool:
    """Return whether a section of an area can have second moments: no less than a full circle."""
    least = LEAST * area**2 / (2.0 * math.pi)
    return bool(moments.sum() >= least and moments.min() > FLAT * moments.max())


def _by_inertia(
    area: float, share: float, second: Array, softest: float, material: Material
) -> Stiffness:
    """Return the stiffness of the inertia about the axis; `second` is area moments [m^4]."""
    moments = share * second
    full = round_section(2.0 * math.sqrt(area / math.pi))
    if not _possible(moments, area):
        moments = np.array([full.moment_y, full.moment_z])
        confidence = 'low'
        why = f'{NO_SECTION}: taken as a solid rod'
    elif share >= WHOLE:
        confidence = 'medium'
        why = (
            'exact if the link is uniform and of this material alone; with motors in it, '
            'EI is too large'
        )
    else:
        confidence = 'low'
        why = f'{1.0 - share:.0%} of the mass is no part of the beam, its size is not known'
    radius = math.sqrt(moments.sum() / area + area / (2.0 * math.pi))
    inner = math.sqrt(max(moments.sum() / area - area / (2.0 * math.pi), 0.0))
    words = _tube_words(2.0 * radius, radius - inner)
    ei = material.e * moments
    return Stiffness(
        float(ei[0]),
        float(ei[1]),
        material.g * float(moments.sum()),
        (min(softest, float(ei.min())), max(material.e * float(second.max()), float(ei.max()))),
        material.density * float(moments.sum()),
        2.0 * radius,
        f'as a {words} (inertia)',
        confidence,
        why,
    )


def _hollow(outer: Outline, area: float) -> tuple[CrossSection, str, float]:
    """Return a hollow section of an outer size and area, in words, and area over the full."""
    if outer.circular:
        diameter = 0.5 * (outer.y + outer.z)
        full = 0.25 * math.pi * diameter**2
        inner = math.sqrt(max(0.0, 1.0 - area / full)) * diameter
        wall = 0.5 * (diameter - inner)
        return tube_section(diameter, wall), _tube_words(diameter, wall), area / full
    y, z = outer.y, outer.z
    around = y + z
    wall = 0.25 * (around - math.sqrt(max(around**2 - 4.0 * area, 0.0)))
    if area >= y * z:
        return rectangle_section(y, z), _box_words(y, z, None), area / (y * z)
    return rectangle_tube_section(y, z, wall), _box_words(y, z, wall), area / (y * z)


def _trust(outer: Outline, apart: float, share: float, fullness: float) -> tuple[str, str]:
    """Return the confidence and its grounds; `fullness` is area over that of a full section."""
    if fullness > 1.01:
        return 'low', f'the mass is {fullness:.3g} times that of a full section: motors are in it'
    between = f'outer size and inertia give EI within a factor of {apart:.3g}'
    if apart <= AGREED and share >= WHOLE and outer.origin != 'mesh':
        return 'high', between
    if fullness > THICK:
        return 'low', f'{between}, but so thick a wall is probably motors inside: EI too large'
    if apart > DOUBTED:
        return 'low', between
    rest = '' if share >= WHOLE else f', {1.0 - share:.0%} of the mass is no part of the beam'
    return 'medium', between + rest


def _tube_words(diameter: float, wall: float) -> str:
    if wall > 0.499 * diameter:
        return f'rod of {1e3 * diameter:.3g} mm'
    return f'tube of {1e3 * diameter:.3g} x {1e3 * wall:.3g} mm'


def _box_words(y: float, z: float, wall: float | None) -> str:
    hollow = '' if wall is None else f' x {1e3 * wall:.3g}'
    return f'{"bar" if wall is None else "box"} of {1e3 * y:.3g} x {1e3 * z:.3g}{hollow} mm'
