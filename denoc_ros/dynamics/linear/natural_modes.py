"""Natural modes at rest: of a robot, and of a mechanism whose loops stay closed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from denoc_ros.dynamics.assembling import rank_of
from denoc_ros.dynamics.constrained_dynamics import (
    RANK,
    jacobian,
    least_solution,
    transposed_change,
)
from denoc_ros.dynamics.dynamics_derivatives import DifferentiableModel
from denoc_ros.dynamics.validation import require_rotors
from denoc_ros.types import Array


class NaturalModes(NamedTuple):
    """Natural modes of the linearization at rest.

    frequencies (k,) [Hz] ascending, shapes (n, k) with unit modal mass, damping_ratios (k,).
    """

    frequencies: Array
    shapes: Array
    damping_ratios: Array


def stiffness(
    robot: DifferentiableModel, q: Array, wrenches: Mapping[str, ArrayLike] | None = None
) -> Array:
    """Return the symmetric tangent stiffness (n, n) at rest: elasticity, gravity and loads."""
    zero = np.zeros(robot.n)
    tangent = robot.inverse_dynamics_derivatives(q, zero, zero, wrenches)[0]
    return np.asarray(0.5 * (tangent + tangent.T))


def natural_modes(robot: DifferentiableModel, q: Array, held: bool) -> NaturalModes:
    """Return the natural modes at rest at q."""
    index = robot.free_indices if held else np.arange(robot.n)
    if not held:
        require_rotors(robot.tree)
    if not len(index):
        return NaturalModes(np.zeros(0), np.zeros((robot.n, 0)), np.zeros(0))
    block = np.ix_(index, index)
    tangent = stiffness(robot, q)
    squares, vectors = scipy.linalg.eigh(tangent[block], robot.inertia_matrix(q)[block])
    # rounding [rad^2/s^2]; a stiff robot's slow mode is neither
    rounding = max(1e-8, 1e-13 * float(np.abs(squares).max()))
    squares = np.where(np.abs(squares) < rounding, 0.0, squares)
    frequencies = np.sign(squares) * np.sqrt(np.abs(squares)) / (2.0 * np.pi)
    damping = robot.damping[index]
    modal = np.einsum('ij,i,ij->j', vectors, damping, vectors)
    omega = 2.0 * np.pi * np.abs(frequencies)
    ratios = np.divide(modal, 2.0 * omega, out=np.zeros_like(modal), where=omega > 0.0)
    shapes = np.zeros((robot.n, len(index)))
    shapes[index] = vectors
    return NaturalModes(frequencies, shapes, ratios)


def independent_joints(robot: DifferentiableModel, q: Array) -> tuple[str, ...]:
    """Return joints that, held, leave no other joint to move; those nearest to the base first.

    Parameters
    ----------
    q : (n,) array
        A closed configuration.

    Returns
    -------
    tuple of str
        In coordinate order; all joints where there are neither loops nor mimic joints.
    """
    rows = jacobian(robot, q)[0]
    bound = list(robot.joint_indices)
    rank = rank_of(rows[:, bound]) if len(rows) else 0
    followers = robot.tree.mimics
    held = []
    for name, index in sorted(
        zip(robot.joint_names, robot.joint_indices, strict=True),
        key=lambda pair: (pair[0] in followers, _depth(robot, pair[0])),
    ):
        others = [k for k in bound if k != index]
        if not len(rows) or (others and rank_of(rows[:, others]) == rank):
            bound = others
            held.append(name)
    return tuple(name for name in robot.joint_names if name in held)


def mechanism_modes(robot: DifferentiableModel, q: Array, held: Sequence[str]) -> NaturalModes:
    """Return the natural modes at rest at q with some joints held and the loops closed.

    Parameters
    ----------
    q : (n,) array
        A closed configuration at rest, in equilibrium for exact load stiffness.
    held : names of joints
        The others move as the loops let them.

    Notes
    -----
    Motion in the null space Z of the free coordinates' closure Jacobian: Z^T I Z and
    Z^T (K - d(J^T lambda)/dq) Z, with the multipliers lambda that balance gravity and elasticity.
    """
    fixed = robot.indices(held)
    free = np.setdiff1d(np.arange(robot.n), fixed)
    rows = jacobian(robot, q)[0]
    tangent = stiffness(robot, q)
    if len(rows):
        zero = np.zeros(robot.n)
        load = robot.inverse_dynamics(q, zero, zero)[free]
        multipliers = least_solution(rows[:, free].T, load)[0]
        turning = transposed_change(robot, q, multipliers, np.zeros(0))
        tangent = tangent - 0.5 * (turning + turning.T)
        allowed = scipy.linalg.null_space(rows[:, free], rcond=RANK)
    else:
        allowed = np.eye(len(free))
    basis = np.zeros((robot.n, allowed.shape[1]))
    basis[free] = allowed
    if not basis.size:
        return NaturalModes(np.zeros(0), basis, np.zeros(0))
    squares, vectors = scipy.linalg.eigh(
        basis.T @ tangent @ basis, basis.T @ robot.inertia_matrix(q) @ basis
    )
    shapes = basis @ vectors
    omega = np.sqrt(np.abs(squares))
    modal = np.einsum('ij,i,ij->j', shapes, robot.damping, shapes)
    ratios = np.divide(modal, 2.0 * omega, out=np.zeros_like(modal), where=omega > 0.0)
    return NaturalModes(np.sign(squares) * omega / (2.0 * np.pi), shapes, ratios)


def _depth(robot: DifferentiableModel, joint: str) -> int:
    """Return the number of bodies that carry a joint's body."""
    bodies = robot.tree.bodies
    at = next(k for k, body in enumerate(bodies) if body.joint and body.joint.name == joint)
    depth = 0
    while bodies[at].attachment.body >= 0:
        at = bodies[at].attachment.body
        depth += 1
    return depth
