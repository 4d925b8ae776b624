"""A floating base: two massless bodies before it, whose six coordinates nothing drives.

The first slides along the joint frame's x axis and carries the second at a "section" that its two
modes displace along y and z. The second turns as a beam's section does: by the rotation vector
that its three modes make up, with the exact exponential and left Jacobian. So every recursion
takes the six coordinates [position; rotation vector] as it takes a joint and amplitudes; nothing
of it knows of a floating base. The rotation vector's rate is regular for angles below 2 pi;
:func:`denoc_ros.dynamics.floating.wrap` brings it back within pi.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from denoc_ros.model.tree import Attachment, Body, Joint, JointKind, RigidInertia, Tree
from denoc_ros.types import Array

PARTS = ('x', 'y', 'z', 'rx', 'ry', 'rz')  # m, rad: along the axes of the joint's frame

# numbers of modes (y, z, torsion)
SLIDING_MODES = (1, 1, 0)
TURNING_MODES = (1, 1, 1)
# what a section has per mode: station; s_y, s_z; s_y', s_z'; s_t; H_y, H_z
SLIDING_SECTION = np.array([0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
# a section turns by [s_t t, -s_z' z, s_y' y] in the second body's axes, which are -z, y, x of the
# joint's: so y, z and t are the rotation vector's components along x, y and z
TURNING_SECTION = np.array([0.0, 0.0, 0.0, 1.0, -1.0, -1.0, 0.0, 0.0])
TURNING_AXES = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])


def coordinate_names(joint: str) -> list[str]:
    """Return the names of a floating joint's coordinates."""
    return [f'{joint}/{part}' for part in PARTS]


def indices(tree: Tree, coordinates: Sequence[str]) -> NDArray[np.int64]:
    """Return the indices of a floating base's coordinates (6,), else (0,)."""
    own = [
        name for body in tree.bodies if body.floating for name in coordinate_names(body.floating)
    ]
    return np.array([coordinates.index(name) for name in own], dtype=np.int64)


def massless_modes(modes: tuple[int, int, int]) -> list[Array]:
    """Return the constants of a "beam" without mass: polar inertia, then one point of weight 0."""
    ny, nz, nt = modes
    return [np.zeros(1 + nt + nt * nt), np.zeros(2 + ny + nz + ny * ny + nz * nz)]


def massless_body(at: Attachment, slides: bool) -> Body:
    """Return one of the two bodies."""
    joint = Joint('', JointKind.PRISMATIC, np.array([1.0, 0.0, 0.0])) if slides else None
    return Body('', at, joint, np.eye(4), RigidInertia())


def turned(rotation: Array) -> Array:
    """Return a pose (4, 4) that only turns."""
    pose = np.eye(4)
    pose[:3, :3] = rotation
    return pose
