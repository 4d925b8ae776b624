"""What a tip-exact motion must obey and what it should: equations and errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from denoc_ros.control.targets import Target
from denoc_ros.dynamics.robot import Robot

Array = NDArray[np.float64]
Int = NDArray[np.int64]


@dataclass(frozen=True)
class Equations:
    """Forces that nothing gives (k, p), over a stiffness, and their derivatives (k, p, n).

    In units of the amplitudes [m, rad]: zero in a motion that the driven joints can make.
    """

    value: Array
    by_q: Array
    by_qd: Array
    by_qdd: Array


class TipProblem:
    """Coordinates that make undriven forces vanish and bring frames to their targets.

    Parameters
    ----------
    robot : Robot
    driven : int array
        Coordinates that have an actuator.
    targets : sequence of Target
    asked : (k, n) array
        The motion of the undeformed robot, toward which the driven joints are drawn.
    draw, smooth : float
        Weights of the driven joints' distance from it, and of the second differences of that
        distance from node to node [m per rad or m].
    """

    def __init__(
        self,
        robot: Robot,
        driven: Int,
        targets: Sequence[Target],
        asked: Array,
        draw: float,
        smooth: float,
    ) -> None:
        self.robot, self.driven, self.targets, self.asked = robot, driven, tuple(targets), asked
        self.undriven = np.setdiff1d(np.arange(robot.n), driven)
        self.draw, self.smooth = draw, smooth
        self.rest_stiffness = self._stiffness(asked[0])

    def equations(self, q: Array, qd: Array, qdd: Array) -> Equations:
        """Return the undriven rows of the inverse dynamics with their derivatives."""
        by_q, by_qd, by_qdd = self.robot.inverse_dynamics_derivatives(q, qd, qdd)
        rows, scale = self.undriven, 1.0 / self.rest_stiffness[:, None]
        return Equations(
            self.residual(q, qd, qdd),
            by_q[:, rows] * scale,
            by_qd[:, rows] * scale,
            by_qdd[:, rows] * scale,
        )

    def residual(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Return the undriven rows (k, p) of the inverse dynamics alone, over a stiffness."""
        force = self.robot.inverse_dynamics(q, qd, qdd)
        return np.asarray(force[:, self.undriven] / self.rest_stiffness)

    def errors(self, q: Array, rows: slice = slice(None)) -> Array:
        """Return the weighed errors (k, 6 targets) of all frames [m]."""
        found = [target.weighed(self.robot, q, rows) for target in self.targets]
        return np.concatenate(found, axis=1)

    def error_derivatives(self, q: Array, errors: Array) -> Array:
        """Return the derivatives (k, 6 targets, n) of the weighed errors."""
        parts = np.split(errors, len(self.targets), axis=1)
        pairs = zip(self.targets, parts, strict=True)
        return np.concatenate([t.derivative(self.robot, q, part) for t, part in pairs], axis=1)

    def _stiffness(self, q: Array) -> Array:
        """Return a stiffness (p,) of each undriven coordinate; 1 where it has none."""
        zero = np.zeros(self.robot.n)
        stiffness = self.robot.inverse_dynamics_derivatives(q, zero, zero)[0]
        own = np.abs(stiffness[self.undriven, self.undriven])
        return np.where(own > 1e-9 * own.max(initial=1e-300), own, own.max(initial=1.0))
