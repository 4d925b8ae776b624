"""Closed loops and mimic joints in a plan: their errors, and the forces that close them."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from denoc_ros.dynamics import constraints
from denoc_ros.dynamics.robot import Robot
from denoc_ros.types import Array

STEP = 1e-7  # of a difference of Jacobians [rad, m]: exact to seven digits, as Newton steps need


class LoopForces:
    """The independent rows of a robot's loops and mimic joints.

    Parameters
    ----------
    robot : Robot
    postures : (k, n) array
        Closed ones in which the rows are compared.

    Attributes
    ----------
    count : int
        Rows, and multipliers.
    """

    def __init__(self, robot: Robot, postures: Array) -> None:
        self._robot = robot
        self._rows = np.zeros(0, dtype=np.int64)
        if robot.constraint_names:
            beside = np.concatenate(list(robot.closure_jacobian(postures)), axis=1)
            _, r, order = scipy.linalg.qr(beside.T, mode='economic', pivoting=True)
            size = np.abs(np.diag(r))
            self._rows = np.sort(order[: int((size > constraints.RANK * size[0]).sum())])
        self.count = len(self._rows)

    def errors(self, q: Array) -> Array:
        """Return the closure errors (k, count) of postures (k, n) [m, rad]."""
        if not self.count:
            return np.zeros((len(q), 0))
        return np.asarray(self._robot.closure(q)[:, self._rows])

    def jacobian(self, q: Array) -> Array:
        """Return the derivative (k, count, n) of the errors."""
        if not self.count:
            return np.zeros((len(q), 0, self._robot.n))
        return np.asarray(self._robot.closure_jacobian(q)[:, self._rows])

    def forces(self, q: Array, qd: Array, multipliers: Array) -> Array:
        """Return the forces of loops (k, n): J^T multipliers minus friction of the loops' axes."""
        force = np.zeros_like(q)
        if not self.count:
            return force
        resisting = np.zeros(self._robot.n)
        for k, row in enumerate(q):
            rows, axes = constraints.jacobian(self._robot, row)
            resisting[:] = 0.0
            constraints.add_loop_friction(self._robot, qd[k], axes, resisting)
            force[k] = rows[self._rows].T @ multipliers[k] - resisting
        return force

    def force_derivative(self, q: Array, qd: Array, multipliers: Array) -> tuple[Array, Array]:
        """Return the derivatives of :meth:`forces` by q and q', (k, n, n) each."""
        n = self._robot.n
        by_q, by_qd = np.zeros((2, len(q), n, n))
        if not self.count:
            return by_q, by_qd
        here = self.forces(q, qd, multipliers)
        for j in range(n):
            moved = q.copy()
            moved[:, j] += STEP
            by_q[:, :, j] = (self.forces(moved, qd, multipliers) - here) / STEP
        if any(loop.damping > 0.0 or loop.friction > 0.0 for loop in self._robot.tree.loops):
            for j in range(n):
                moved = qd.copy()
                moved[:, j] += STEP
                by_qd[:, :, j] = (self.forces(q, moved, multipliers) - here) / STEP
        return by_q, by_qd
