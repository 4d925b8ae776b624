"""The inertia of a payload on a robot's frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics.validation import as_vector
from denoc_ros.errors import StateError
from denoc_ros.model.joint_rows import cross_matrix
from denoc_ros.model.tree import RigidInertia
from denoc_ros.types import Array


def payload_inertia(
    placement: Array, mass: float, com: ArrayLike, inertia: ArrayLike | None
) -> RigidInertia:
    """Return a payload's inertia about the body origin, from its frame's placement on the body.

    Raises
    ------
    StateError
        The mass is negative or not finite, or the inertia is not symmetric positive semidefinite.
    """
    centre = as_vector('com', com, (3,))
    about = np.zeros((3, 3)) if inertia is None else as_vector('inertia', inertia, (3, 3))
    if not (np.isfinite(mass) and mass >= 0.0):
        raise StateError(f'payload mass must be >= 0 kg, got {mass}')
    moments = np.linalg.eigvalsh(about)
    scale = 1e-9 * max(1.0, float(np.abs(about).max()))
    if not np.allclose(about, about.T, atol=scale) or moments[0] < -scale:
        raise StateError(
            f'payload inertia must be symmetric positive semidefinite, got {about.tolist()}'
        )
    rotation = placement[:3, :3]
    centre = rotation @ centre + placement[:3, 3]
    arm = cross_matrix(centre)
    total = rotation @ about @ rotation.T - mass * arm @ arm
    return RigidInertia(float(mass), mass * centre, total)
