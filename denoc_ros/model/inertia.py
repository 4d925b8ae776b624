"""Inertia of rigid bodies: change of frame, sums and physical possibility."""

from __future__ import annotations

import numpy as np

from denoc_ros.model.tree import RigidInertia
from denoc_ros.types import Array


def inverse_transform(transform: Array) -> Array:
    """Return the inverse of a homogeneous transform (4, 4)."""
    inverse = np.eye(4)
    inverse[:3, :3] = transform[:3, :3].T
    inverse[:3, 3] = -transform[:3, :3].T @ transform[:3, 3]
    return inverse


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

    Returns
    -------
    RigidInertia
        About the frame's origin.
    """
    about_origin = inertia + mass * (com @ com * np.eye(3) - np.outer(com, com))
    return RigidInertia(mass, mass * com, about_origin)


def moved(body: RigidInertia, transform: Array) -> RigidInertia:
    """Return the inertia of a body seen from another frame.

    Parameters
    ----------
    body : RigidInertia
        In its own frame.
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
        body.mass,
        turned + body.mass * shift,
        rotation @ body.inertia @ rotation.T + parallel,
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
