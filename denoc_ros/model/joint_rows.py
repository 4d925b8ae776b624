"""Arrays of a joint: its axes for the kernels, its pose as constants."""

from __future__ import annotations

import numpy as np

from denoc_ros.kernels import layout
from denoc_ros.model.tree import Body, JointKind
from denoc_ros.types import Array


def cross_matrix(v: Array) -> Array:
    """Return v x as a (3, 3) matrix."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def pose_rows(rotation: Array, translation: Array) -> Array:
    """Return a rotation (3, 3), row by row, and a translation (3,) as twelve numbers."""
    return np.concatenate([rotation.ravel(), translation])


def joint_axes(body: Body, flexible: bool) -> Array:
    """Return the (3, 3) turn from the body frame to axes with z along the joint of a rigid body.

    A body whose joint turns about z costs the kernels least; beams need their own axes.
    """
    joint = body.joint
    if joint is None or joint.kind is not JointKind.REVOLUTE or flexible:
        return np.eye(3)
    z = body.frame[:3, :3].T @ joint.axis
    if abs(z[0]) < abs(z[2]):
        x = np.array([z[2], 0.0, -z[0]])
    else:
        x = np.array([-z[1], z[0], 0.0])
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def motion_kind(body: Body, frame: Array) -> int:
    """Return the kind of motion of a body with its frame (4, 4) on the link frame."""
    kind = JointKind.FIXED if body.joint is None else body.joint.kind
    if kind is JointKind.REVOLUTE:
        assert body.joint is not None
        about_z = np.allclose(frame[:3, :3].T @ body.joint.axis, [0.0, 0.0, 1.0], 0.0, 1e-15)
        through = np.allclose(np.cross(body.joint.axis, frame[:3, 3]), 0.0, 0.0, 1e-15)
        return layout.REVOLUTE_Z if about_z and through else layout.REVOLUTE
    return {JointKind.FIXED: layout.FIXED, JointKind.PRISMATIC: layout.PRISMATIC}[kind]


def pose_constants(body: Body, placement: Array, frame: Array) -> list[Array]:
    """Return the still, first and second part of the body's pose, and its motion subspace."""
    still = placement @ frame
    rows = [pose_rows(still[:3, :3], still[:3, 3]), np.zeros(12), np.zeros(12), np.zeros(6)]
    joint = body.joint
    if joint is None or joint.kind is JointKind.FIXED:
        return rows
    rotation, offset = frame[:3, :3], frame[:3, 3]
    outer = placement[:3, :3]
    if joint.kind is JointKind.PRISMATIC:
        rows[1] = pose_rows(np.zeros((3, 3)), outer @ joint.axis)
        rows[3][:3] = rotation.T @ joint.axis
        return rows
    k = cross_matrix(joint.axis)
    rows[1] = pose_rows(outer @ k @ rotation, outer @ k @ offset)
    rows[2] = pose_rows(outer @ k @ k @ rotation, outer @ k @ k @ offset)
    rows[3] = np.concatenate([rotation.T @ (k @ offset), rotation.T @ joint.axis])
    return rows
