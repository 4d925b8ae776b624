"""Data per coordinate: names, elasticity, damping, friction, armature.

The first slides along the joint frame's x axis and carries the second at a "section" that its two
modes displace along y and z. The second turns as a beam's section does: by the rotation vector
that its three modes make up, with the exact exponential and left Jacobian. So every recursion
takes the six coordinates [position; rotation vector] as it takes a joint and amplitudes; nothing
of it knows of a floating base. The rotation vector's rate is regular for angles below 2 pi;
:func:`denoc_ros.dynamics.base.floating_base.wrap_attitude` brings it back within pi.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from denoc_ros.model.tree import Attachment, Body, Joint, JointKind, RigidInertia, Tree
from denoc_ros.types import Array

# rows of the diagonals, in the kernels' order
TERMS = ('stiffness', 'damping', 'friction', 'armature', 'stiffness3', 'play')


def spring_name(joint: str) -> str:
    """Return the name of the coordinate that an elastic joint has beside its own."""
    return f'{joint}/spring'


def diagonals(tree: Tree) -> Array:
    """Return the terms (6, n) of all coordinates, in the order of `TERMS`."""
    columns = [np.zeros((0, len(TERMS)))]
    for body in tree.bodies:
        if body.floating:
            columns.append(np.zeros((len(PARTS), len(TERMS))))
        columns += [np.array(list(_joint_terms(body))).reshape(-1, len(TERMS))]
        if body.modes is not None:
            terms = np.zeros((body.modes.count, len(TERMS)))
            terms[:, 0], terms[:, 1] = body.modes.stiffness, body.modes.damping
            columns.append(terms)
        if body.beam is None:
            continue
        for part in (body.beam.y, body.beam.z, body.beam.torsion):
            if part is not None:
                terms = np.zeros((part.modes, len(TERMS)))
                terms[:, 0], terms[:, 1] = part.modal_stiffness, part.damping
                columns.append(terms)
    return np.ascontiguousarray(np.concatenate(columns).T)


def _joint_terms(body: Body) -> Iterator[tuple[float, ...]]:
    joint = body.joint
    if joint is None or joint.kind is JointKind.FIXED:
        return
    yield 0.0, joint.damping, joint.friction, joint.armature, 0.0, 0.0
    spring = joint.spring
    if spring is not None:
        half = 0.5 * spring.backlash
        yield spring.stiffness, spring.damping, 0.0, 0.0, spring.stiffness3, half


def names(tree: Tree) -> tuple[list[str], list[str], list[int]]:
    """Return coordinate names, joint names and the joints' indices."""
    coordinates: list[str] = []
    joints: list[str] = []
    indices: list[int] = []
    for body in tree.bodies:
        if body.floating:
            coordinates += coordinate_names(body.floating)
        joint = body.joint
        if joint is not None and joint.kind is not JointKind.FIXED:
            indices.append(len(coordinates))
            joints.append(joint.name)
            coordinates.append(joint.name)
            if joint.spring is not None:
                coordinates.append(spring_name(joint.name))
        if body.modes is not None:
            coordinates += [f'{body.name}/m{k + 1}' for k in range(body.modes.count)]
        if body.beam is not None:
            for letter, modes in zip('yzt', body.beam.modes, strict=True):
                coordinates += [f'{body.name}/{letter}{k + 1}' for k in range(modes)]
    return coordinates, joints, indices


# coordinates of a body that floats --------------------------------------------------------------

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


def base_indices(tree: Tree, coordinates: Sequence[str]) -> NDArray[np.int64]:
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
