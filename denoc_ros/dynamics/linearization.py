"""Vibration about an equilibrium: tangent stiffness, natural frequencies and modes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from denoc_ros.dynamics.derivatives import DifferentiableModel
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
