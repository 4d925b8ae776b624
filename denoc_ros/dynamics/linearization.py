"""Vibration about an equilibrium: tangent stiffness, natural frequencies and modes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from denoc_ros.dynamics.derivatives import DifferentiableModel
from denoc_ros.dynamics.springs import elasticity
from denoc_ros.dynamics.structure import body_amplitudes
from denoc_ros.dynamics.validation import require_rotors
from denoc_ros.kernels import inverse_derivatives, load_derivatives
from denoc_ros.types import Array

STEP = 1e-3  # of a central difference of fourth order; rounding and truncation meet near 1e-11


class NaturalModes(NamedTuple):
    """Natural modes of the linearization at rest.

    frequencies (k,) [Hz] ascending, shapes (n, k) with unit modal mass, damping_ratios (k,).
    """

    frequencies: Array
    shapes: Array
    damping_ratios: Array


def difference_steps(robot: DifferentiableModel) -> Array:
    """Return the difference step of each coordinate: rad, or a share of the beam's length."""
    steps = np.full(robot.n, STEP)
    for k, body in enumerate(robot.tree.bodies):
        if body.amplitudes:  # of a link of several segments, each is a body
            steps[body_amplitudes(robot, k)] *= body.spans
    return steps


def derivative(function: Callable[[Array], Array], x: Array, steps: Array) -> Array:
    """Return the derivative (m, len(x)) of a vector function by central differences."""
    columns = []
    for j, step in enumerate(steps):
        shifted = [x.copy() for _ in range(4)]
        for state, factor in zip(shifted, (1.0, -1.0, 2.0, -2.0), strict=True):
            state[j] += factor * step
        a, b, c, d = (function(state) for state in shifted)
        columns.append((8.0 * (a - b) - (c - d)) / (12.0 * step))
    return np.column_stack(columns)


def derivatives_are_ready(loaded: bool = False) -> bool:
    """Say whether the kernel of analytical derivatives is compiled, and that of loads."""
    kernels = [inverse_derivatives.inverse_dynamics_derivatives]
    kernels += [load_derivatives.subtract_load_rows] if loaded else []
    return all(kernel.signatures for kernel in kernels)


def stiffness(
    robot: DifferentiableModel, q: Array, wrenches: Mapping[str, ArrayLike] | None = None
) -> Array:
    """Return the symmetric tangent stiffness (n, n) at rest: elasticity, gravity and loads.

    Analytical once a derivative was asked for in this process. Until then by differences, exact
    to 1e-11: a command or a node that wants a few of them would wait longer for the kernel.
    """
    zero = np.zeros(robot.n)
    if derivatives_are_ready(bool(wrenches)):
        exact: Array = robot.inverse_dynamics_derivatives(q, zero, zero, wrenches)[0]
        return np.asarray(0.5 * (exact + exact.T))
    slope = elasticity(robot, q)[1]

    def load(state: Array) -> Array:
        return robot.inverse_dynamics(state, zero, zero, wrenches) - elasticity(robot, state)[0]

    tangent: Array = derivative(load, q, difference_steps(robot))
    symmetric: Array = 0.5 * (tangent + tangent.T) + np.diag(slope)
    return symmetric


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
    # rounding of the differences [rad^2/s^2] or the solver; a stiff robot's slow mode is neither
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
