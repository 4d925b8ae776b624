"""Inertia of rigid bodies: change of frame, sums and physical possibility."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from denoc_ros.model.beams.along import CONSTANT, Along
from denoc_ros.model.reading.poses import pose_of
from denoc_ros.model.tree import RigidInertia
from denoc_ros.types import Array


def inverse_transform(transform: Array) -> Array:
    """Return the inverse of a homogeneous transform (4, 4)."""
    back = transform[:3, :3].T
    return pose_of(-back @ transform[:3, 3], back)


def from_centre(mass: float, com: Array, inertia: Array) -> RigidInertia:
    """Return the inertia about a frame's origin.

    Parameters
    ----------
    mass : float
        Mass [kg].
    com : ndarray (3,)
        Centre of mass in the frame [m].
    inertia : ndarray (3, 3)
        Inertia about the centre of mass, axes of the frame [kg m^2].
    """
    about_origin = inertia + mass * (com @ com * np.eye(3) - np.outer(com, com))
    return RigidInertia(mass, mass * com, about_origin)


def moved(body: RigidInertia, transform: Array) -> RigidInertia:
    """Return the inertia of a body seen from another frame.

    Parameters
    ----------
    transform : ndarray (4, 4)
        Its frame seen from the other frame.

    Returns
    -------
    RigidInertia
        In the other frame, about its origin. Needs no centre of mass, so mass may be 0.
    """
    rotation, shift = transform[:3, :3], transform[:3, 3]
    turned = rotation @ body.first_moment
    parallel = (2.0 * shift @ turned + body.mass * shift @ shift) * np.eye(3)
    cross = np.outer(shift, turned)
    parallel -= cross + cross.T + body.mass * np.outer(shift, shift)
    return RigidInertia(
        body.mass, turned + body.mass * shift, rotation @ body.inertia @ rotation.T + parallel
    )


def total(first: RigidInertia, second: RigidInertia) -> RigidInertia:
    """Return the inertia of two bodies given in the same frame."""
    return RigidInertia(
        first.mass + second.mass,
        first.first_moment + second.first_moment,
        first.inertia + second.inertia,
    )


def difference(whole: RigidInertia, part: RigidInertia) -> RigidInertia:
    """Return the rest of a body without a part, both in the same frame."""
    return RigidInertia(
        whole.mass - part.mass,
        whole.first_moment - part.first_moment,
        whole.inertia - part.inertia,
    )


def pseudo_inertia(body: RigidInertia, length: float) -> Array:
    """Return the pseudo-inertia matrix with lengths in a given unit.

    Parameters
    ----------
    body : RigidInertia
        In any frame.
    length : float
        The unit of length [m], which makes all entries a mass.

    Returns
    -------
    ndarray (4, 4)
        [[int r r^T dm, int r dm], [., m]] [kg]; positive semidefinite for every real body.
    """
    second_moment = 0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia
    pseudo = np.empty((4, 4))
    pseudo[:3, :3] = second_moment / length**2
    pseudo[:3, 3] = pseudo[3, :3] = body.first_moment / length
    pseudo[3, 3] = body.mass
    return pseudo


# of the largest principal moment, and of moments that are zero [kg m^2]: what rounding leaves
ROUNDED, ROUNDED_ZERO = 1e-3, 1e-12


def possible(inertia: Array, shifted: float = 0.0) -> bool:
    """Say whether some body has an inertia (3, 3) [kg m^2] about its centre of mass.

    Then no principal moment is above the sum of the others, so that none is negative either.

    Parameters
    ----------
    shifted : float
        Mass times the square of a distance [kg m^2] that was subtracted: its rounding counts as
        zero.
    """
    lowest, middle, highest = np.linalg.eigvalsh(inertia)
    size = max(abs(lowest), abs(highest))
    zero = ROUNDED_ZERO * max(1.0, shifted)
    return bool(highest - middle - lowest <= max(ROUNDED * size, zero))


# the rest of a link beside its beam -------------------------------------------------------------

ROUNDING = 1e-9  # of the link's pseudo-inertia: what arithmetic leaves of an exact zero
TINY = 1e-18  # m^2, of a link that is a point
TOLERANCE = 1e-3  # of the link's pseudo-inertia: what rounded numbers in a file leave


def beam_inertia(
    mass_per_length: float, length: float, polar_inertia: float, along: Along = CONSTANT
) -> RigidInertia:
    """Return the inertia of the undeformed beam in the beam frame.

    Parameters
    ----------
    mass_per_length : float
        [kg/m], of a slender rod along +X.
    length : float
        [m].
    polar_inertia : float
        About X, per length [kg m^2/m], the mean.
    along : Along, optional
        Shares of the mass per length, which is a mean then.

    Returns
    -------
    RigidInertia
        About the beam's root.
    """
    mass = mass_per_length * length * along.moment(0)
    across = mass_per_length * length**3 * along.moment(2)
    first = mass_per_length * length**2 * along.moment(1)
    return RigidInertia(
        mass, np.array([first, 0.0, 0.0]), np.diag([polar_inertia * length, across, across])
    )


def inertia_violation(body: RigidInertia, link: RigidInertia) -> float:
    """Return how far a body is from physically possible, as a part of the link's inertia.

    Parameters
    ----------
    body : RigidInertia
        The rest, in the beam frame.
    link : RigidInertia
        The whole link, in the beam frame; its mass is > 0.

    Returns
    -------
    float
        0 if mass, inertia about the beam axis and pseudo-inertia are not negative, else the
        largest of: the missing mass over the link's, the missing inertia about the axis over
        the link's, and the lowest eigenvalue's size over the link's largest.

    Notes
    -----
    Lengths are measured in the link's radius of gyration about the beam's root, which makes the
    entries of a pseudo-inertia comparable. The inertia about the axis stands by itself: it
    hardly shows in the eigenvalues of a slender link, but is what torsion moves.
    """
    radius = math.sqrt(max(0.5 * float(np.trace(link.inertia)) / link.mass, TINY))
    scale = float(np.linalg.eigvalsh(pseudo_inertia(link, radius))[-1])
    lowest = float(np.linalg.eigvalsh(pseudo_inertia(body, radius))[0])
    about_axis = _missing_about_axis(body, link)
    return max(0.0, -lowest / scale, -body.mass / link.mass, about_axis)


def _missing_about_axis(body: RigidInertia, link: RigidInertia) -> float:
    missing, whole = -float(body.inertia[0, 0]), float(link.inertia[0, 0])
    zero = ROUNDING * float(np.abs(link.inertia).max())
    if missing <= zero:
        return 0.0
    return missing / whole if whole > zero else math.inf


def largest_mass_per_length(
    link: RigidInertia, length: float, polar_inertia: float, along: Along = CONSTANT
) -> float:
    """Return the largest mass per length that leaves a physically possible rest.

    Parameters
    ----------
    link : RigidInertia
        The whole link, in the beam frame; its mass is > 0.
    length : float
        Of the beam [m].
    polar_inertia : float
        About the beam axis, per length [kg m^2/m].

    Returns
    -------
    float
        [kg/m], rounded down to four digits; 0 if there is none.
    """

    def possible(mass_per_length: float) -> bool:
        share = beam_inertia(mass_per_length, length, polar_inertia, along)
        return inertia_violation(difference(link, share), link) <= allowed

    allowed = _allowed(link)
    return _largest(possible, link.mass / length)


def largest_polar_inertia(link: RigidInertia, length: float) -> float:
    """Return the largest polar inertia per length of a massless beam that leaves a possible rest.

    Parameters
    ----------
    length : float
        Of the beam [m].

    Returns
    -------
    float
        [kg m^2/m], rounded down to four digits; 0 if there is none.
    """

    def possible(polar_inertia: float) -> bool:
        share = beam_inertia(0.0, length, polar_inertia)
        return inertia_violation(difference(link, share), link) <= allowed

    allowed = _allowed(link)
    return _largest(possible, max(float(link.inertia[0, 0]), 0.0) / length)


def _allowed(link: RigidInertia) -> float:
    """Admissible inertia_violation of a rest: that of the printed link itself."""
    return min(inertia_violation(link, link) + ROUNDING, TOLERANCE)


def _largest(possible: Callable[[float], bool], most: float) -> float:
    """Return the largest number from 0 to `most` that is possible, down to four digits."""
    if not possible(0.0):
        return 0.0
    low, high = 0.0, most * (1.0 + ROUNDING)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if possible(middle) else (low, middle)
    if low < ROUNDING * most or low == 0.0:
        return 0.0
    digit = 10.0 ** (math.floor(math.log10(low)) - 3)
    return math.floor(low / digit * (1.0 + ROUNDING)) * digit
