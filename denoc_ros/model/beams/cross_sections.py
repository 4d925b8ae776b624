"""Cross-sections of beams: their moments, where their axes lie, and closed forms of both."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from denoc_ros.model.beams.along import Along
from denoc_ros.model.reading.poses import pose_of, rotation_rpy
from denoc_ros.types import Array

AXES = {
    'angle': 'rad',
    'centroid_y': 'm',
    'centroid_z': 'm',
    'shear_center_y': 'm',
    'shear_center_z': 'm',
}
ON_AXIS = 1e-12  # m


@dataclass(frozen=True)
class SectionAxes:
    """Where the sections of a beam lie in its frame, by the share of the length.

    `angle` of the principal axes about x [rad], from y towards z; centroid and shear centre [m].
    """

    angle: Along
    centroid_y: Along
    centroid_z: Along
    shear_center_y: Along
    shear_center_z: Along

    @classmethod
    def of(cls, *numbers: float) -> SectionAxes:
        """Return those of five numbers that do not vary."""
        return cls(*(Along(pieces=((number,),)) for number in numbers))

    def values(self, share: Array) -> Array:
        """Return angle, centroid and shear centre, (k, 5), at shares of the length."""
        return np.stack([getattr(self, name).values(share) for name in AXES], axis=1)

    @cached_property
    def straight(self) -> bool:
        """Whether a beam that lies turned and aside has them, its planes and twist uncoupled."""
        _, *centre = self.values(np.zeros(1))[0]
        same = abs(centre[0] - centre[2]) + abs(centre[1] - centre[3]) <= ON_AXIS
        return same and all(getattr(self, name).uniform for name in AXES)

    @property
    def pose(self) -> Array:
        """The principal axes at the root (4, 4), at the centroid, seen from the beam frame."""
        angle, y, z, _, _ = self.values(np.zeros(1))[0]
        return pose_of((0.0, y, z), rotation_rpy(np.array([angle, 0.0, 0.0])))


CENTRED = SectionAxes.of(*[0.0] * len(AXES))


@dataclass(frozen=True)
class CrossSection:
    """A cross-section of a beam along X: moments along its principal axes, y and z of it."""

    area: float  # [m^2]
    # second moment of area for deflection along y, and along z [m^4]
    moment_y: float
    moment_z: float
    torsion_constant: float  # St-Venant's [m^4]
    axes: SectionAxes | None = None  # None: centred on the beam axis
    warping_constant: float = 0.0  # Vlasov's [m^6], where it is known
    fibre: tuple[float, float] = (0.0, 0.0)  # farthest along the principal axes [m], likewise

    @property
    def polar_moment(self) -> float:
        """Polar second moment of area [m^4]."""
        return self.moment_y + self.moment_z


def round_section(diameter: float) -> CrossSection:
    """Return a full circle of a diameter [m]."""
    return tube_section(diameter, 0.5 * diameter)


def tube_section(diameter: float, wall: float) -> CrossSection:
    """Return a ring of an outer diameter and a wall thickness [m]."""
    inner = diameter - 2.0 * wall
    moment = math.pi / 64.0 * (diameter**4 - inner**4)
    return CrossSection(math.pi / 4.0 * (diameter**2 - inner**2), moment, moment, 2.0 * moment)


def rectangle_section(y: float, z: float) -> CrossSection:
    """Return a full rectangle of sides y and z [m] along the beam's axes."""
    return CrossSection(y * z, z * y**3 / 12.0, y * z**3 / 12.0, rectangle_torsion_constant(y, z))


def rectangle_tube_section(y: float, z: float, wall: float) -> CrossSection:
    """Return a hollow rectangle of outer sides y and z and a wall thickness [m].

    Notes
    -----
    Torsion: Bredt's closed wall and the open wall's own share, J = 4 A_m^2 t / p + p t^3 / 3 with
    the middle line's area A_m and perimeter p; at most that of the full rectangle.
    """
    outer = rectangle_section(y, z)
    if 2.0 * wall >= min(y, z):
        return outer
    inner = rectangle_section(y - 2.0 * wall, z - 2.0 * wall)
    perimeter = 2.0 * (y + z - 2.0 * wall)
    enclosed = (y - wall) * (z - wall)
    constant = 4.0 * enclosed**2 * wall / perimeter + perimeter * wall**3 / 3.0
    return CrossSection(
        outer.area - inner.area,
        outer.moment_y - inner.moment_y,
        outer.moment_z - inner.moment_z,
        min(constant, outer.torsion_constant),
    )


def rectangle_torsion_constant(y: float, z: float) -> float:
    """Return St-Venant's torsion constant of a rectangle.

    Parameters
    ----------
    y, z : float
        Sides [m].

    Returns
    -------
    float
        [m^4].

    Notes
    -----
    J = a b^3 (1/3 - 64 b / (pi^5 a) sum_{n odd} tanh(n pi a / (2 b)) / n^5), a >= b. With
    sum 1 / n^5 = 31/32 zeta(5) taken out, the terms 1 - tanh left fall exponentially.
    """
    a, b = max(y, z), min(y, z)
    if b == 0.0:
        return 0.0
    n = np.arange(1.0, 40.0, 2.0)
    odd_zeta = 31.0 / 32.0 * 1.0369277551433699263
    argument = np.minimum(n * np.pi * a / b, 600.0)
    lack = float(np.sum(2.0 / (n**5 * (np.exp(argument) + 1.0))))
    return a * b**3 * (1.0 / 3.0 - 64.0 * b / (math.pi**5 * a) * (odd_zeta - lack))
