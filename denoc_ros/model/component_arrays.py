"""A link's component modes as the constants of the kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from denoc_ros.kernels.derivative_layout import whole_lanes
from denoc_ros.model.link_file import ReducedLink
from denoc_ros.model.tree import ComponentModes, Joint, JointKind
from denoc_ros.types import Array

NO_CURVE = 1e-12  # of the largest second-order displacement: what arithmetic leaves of none


@dataclass(frozen=True)
class ComponentPoints:
    """The points of a link's modes, in axes that the kernels have the least work with."""

    axes: Array  # (3, 3) seen from the link frame
    count: int  # points, in whole lanes
    modes: int
    bent: int  # of how many components of the points there is a Gamma
    constants: Array  # as the kernels' layout says


def second_order(link: ReducedLink, values: Array) -> Array:
    """Return Gamma (..., m, m, 3) from the columns (..., 3 g) of a link's pairs."""
    m = link.modes
    gamma = np.zeros((*values.shape[:-1], m, m, 3))
    for k, (i, j) in enumerate(link.pairs):
        gamma[..., i, j, :] = gamma[..., j, i, :] = values[..., 3 * k : 3 * k + 3]
    return gamma


def kernel_axes(link: ReducedLink, joint: Joint | None) -> tuple[Array, int]:
    """Return axes (3, 3), seen from the link frame, and how many of them Gamma has.

    Those come first. A revolute joint across a Gamma along a line gets the z axis: that is what
    costs the kernels least.
    """
    values = link.points[:, 4 + 3 * link.modes :].reshape(-1, 3)
    sizes, rows = np.linalg.svd(np.concatenate([values, np.zeros((3, 3))]), full_matrices=False)[
        1:
    ]
    bent = int(np.sum(sizes > NO_CURVE * sizes[0]))
    first = rows.T if bent else np.eye(3)
    turns = joint is not None and joint.kind is JointKind.REVOLUTE
    if bent <= 1 and turns and joint is not None:
        z = joint.axis
        x = first[:, 0] - z * (z @ first[:, 0])
        if bent == 1 and np.linalg.norm(x) < 1.0 - NO_CURVE:
            x = first[:, 0]
            y = np.cross(z, x) if np.linalg.norm(np.cross(z, x)) > 0.1 else first[:, 1]
            z = np.cross(x, y / np.linalg.norm(y))
        elif np.linalg.norm(x) < 0.1:
            x = first[:, 1] - z * (z @ first[:, 1])
        x = x / np.linalg.norm(x)
        return np.column_stack([x, np.cross(z, x), z]), bent
    x, y = first[:, 0], first[:, 1]
    return np.column_stack([x, y, np.cross(x, y)]), bent


def component_points(
    modes: ComponentModes, joint: Joint | None, geometric: bool
) -> ComponentPoints:
    """Return the points of a link's modes.

    Parameters
    ----------
    modes : ComponentModes
    joint : Joint or None
        The one before the link.
    geometric : bool
        Whether the second-order displacement counts.
    """
    link, m = modes.link, modes.count
    axes, bent = kernel_axes(link, joint)
    bent = bent if geometric else 0
    rows = link.points
    count = whole_lanes(len(rows))
    padded = np.zeros((count, rows.shape[1]))
    padded[: len(rows)] = rows
    phi = padded[:, 4 : 4 + 3 * m].reshape(count, m, 3) @ axes
    gamma = second_order(link, padded[:, 4 + 3 * m :]) @ axes
    parts = (
        padded[:, 0],
        (padded[:, 1:4] @ axes).T,
        phi.transpose(1, 2, 0),
        gamma[..., :bent].transpose(1, 2, 3, 0),
    )
    return ComponentPoints(axes, count, m, bent, np.concatenate([part.ravel() for part in parts]))


def section_of_modes(modes: ComponentModes, name: str, axes: Array, geometric: bool) -> Array:
    """Return the constants of the section at a frame of a link with component modes."""
    frame = modes.link.frames[name]
    gamma = second_order(modes.link, frame.quadratic.T.ravel()) @ axes
    parts = (
        frame.origin @ axes,
        frame.phi.T @ axes,
        frame.theta.T @ axes,
        gamma if geometric else np.zeros_like(gamma),
    )
    return np.concatenate([np.ravel(part) for part in parts])
