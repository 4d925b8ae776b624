"""Constraints and costs of a tip-exact motion: equations of motion and tip errors."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from denoc_ros.dynamics import constrained_dynamics as constraints
from denoc_ros.dynamics.robot import Robot
from denoc_ros.planning.tip.targets import Target
from denoc_ros.types import Array

Int = NDArray[np.int64]


SMOOTHER = 30.0  # times, where a problem is eased
UNREACHED = 10.0  # times the squared draw: errors times a lever that matter beside it
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


@dataclass(frozen=True)
class Equations:
    """Derivatives (k, p, n) and (k, p, m) of the equations (k, p) of a motion.

    First the forces on the coordinates without an actuator, over a stiffness [m, rad]; then the
    closure errors of loops and mimic joints [m, rad]. Zero in a motion that the driven joints can
    make. A floating base has a :class:`Momentum` instead.
    """

    by_q: Array
    by_qd: Array
    by_qdd: Array
    by_multipliers: Array


@dataclass(frozen=True)
class Momentum:
    """Derivatives (k, 6, n) by q and q' of the momentum (k, 6) of a robot whose base floats.

    Over the base's inertia, times the time of the motion [m, rad]: how far the base drifts.
    """

    by_q: Array
    by_qd: Array


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
    duration : float
        Of the motion [s].

    Attributes
    ----------
    undriven : int array
        Coordinates without an actuator, but those of a floating base.
    loops : LoopForces
        Its multipliers (k, m) are unknowns beside the coordinates, over `stiffness`.
    end : int array
        Coordinates that are unknown at the last node, too: joints and base of a robot that floats.
        Where it ends depends on the way.
    curved : bool
        Whether steps take the second derivatives of errors that stay: where the tip cannot be
        where it is asked, steps without them go to and fro.
    """

    def __init__(
        self,
        robot: Robot,
        driven: Int,
        targets: Sequence[Target],
        asked: Array,
        draw: float,
        smooth: float,
        duration: float,
    ) -> None:
        self.robot, self.driven, self.targets, self.asked = robot, driven, tuple(targets), asked
        self.base = robot.base_indices
        self.undriven = np.setdiff1d(np.arange(robot.n), np.union1d(driven, self.base))
        none = np.zeros(0, dtype=np.int64)
        self.end = np.union1d(robot.joint_indices, self.base) if len(self.base) else none
        self.draw, self.smooth = draw, smooth
        self.curved = False
        self._own_stiffness = self._stiffness(asked[0])
        self.stiffness = float(np.median(self._own_stiffness)) if len(self.undriven) else 1.0
        samples = np.unique(np.linspace(0, len(asked) - 1, 5).astype(int))
        self.loops = LoopForces(robot, asked[samples])
        inertia = robot.inertia_matrix(asked[0])[self.base, self.base]
        self._drift = duration / inertia[:, None]

    def eased(self, factor: float) -> TipProblem:
        """Return the problem with smoother joints, so many times more drawn to the asked ones."""
        other = copy(self)
        other.draw, other.smooth = factor * self.draw, SMOOTHER * self.smooth
        return other

    def equations(self, q: Array, qd: Array, qdd: Array, multipliers: Array) -> Equations:
        """Return the derivatives of the equations of a motion (k, n) with multipliers (k, m)."""
        by_q, by_qd, by_qdd = self.robot.inverse_dynamics_derivatives(q, qd, qdd)
        rows, scale = self.undriven, 1.0 / self._own_stiffness[:, None]
        by_q, by_qd, by_qdd = (part[:, rows] * scale for part in (by_q, by_qd, by_qdd))
        if not self.loops.count:
            none = np.zeros((len(q), len(rows), 0))
            return Equations(by_q, by_qd, by_qdd, none)
        jacobian = self.loops.jacobian(q)
        change, rate_change = self.loops.force_derivative(q, qd, self.stiffness * multipliers)
        none = np.zeros_like(jacobian)
        share = self.stiffness * scale * jacobian[:, :, rows].transpose(0, 2, 1)
        closed = np.zeros((len(q), self.loops.count, self.loops.count))
        return Equations(
            np.concatenate([by_q - change[:, rows] * scale, jacobian], axis=1),
            np.concatenate([by_qd - rate_change[:, rows] * scale, none], axis=1),
            np.concatenate([by_qdd, none], axis=1),
            np.concatenate([-share, closed], axis=1),
        )

    def residual(self, q: Array, qd: Array, qdd: Array, multipliers: Array) -> Array:
        """Return the equations' values (k, p)."""
        force = self.robot.inverse_dynamics(q, qd, qdd)
        if not self.loops.count:
            return np.asarray(force[:, self.undriven] / self._own_stiffness)
        force = force - self.loops.forces(q, qd, self.stiffness * multipliers)
        parts = [force[:, self.undriven] / self._own_stiffness, self.loops.errors(q)]
        return np.concatenate(parts, axis=1)

    def momentum(self, q: Array, qd: Array) -> Momentum:
        """Return the derivatives of a motion's momentum; none without such a base."""
        if not len(self.base):
            none = np.zeros((len(q), 0, self.robot.n))
            return Momentum(none, none)
        rest = np.zeros_like(q)
        by_q, _, by_qd = self.robot.inverse_dynamics_derivatives(q, rest, qd)
        return Momentum(*(part[:, self.base] * self._drift for part in (by_q, by_qd)))

    def drift(self, q: Array, qd: Array) -> Array:
        """Return the momentum (k, 6); (k, 0) without a floating base.

        Notes
        -----
        The base's rows of I q' are what inverse dynamics without velocities gives for
        accelerations q'; they vanish with the momentum.
        """
        if not len(self.base):
            return np.zeros((len(q), 0))
        force = self.robot.inverse_dynamics(q, np.zeros_like(q), qd)
        return np.asarray(force[:, self.base] * self._drift[:, 0])

    def torque(self, q: Array, qd: Array, qdd: Array, multipliers: Array) -> Array:
        """Return the driven joints' torque (k, driven) [N m, N]."""
        force = self.robot.inverse_dynamics(q, qd, qdd)
        if self.loops.count:
            force = force - self.loops.forces(q, qd, self.stiffness * multipliers)
        return np.asarray(force[:, self.driven])

    def torque_change(
        self, q: Array, qd: Array, qdd: Array, multipliers: Array, by: tuple[Array, ...]
    ) -> Array:
        """Return the change (k, driven, p) of the torque with those of its arguments.

        `by` has the changes (k, n, p) of coordinates, rates and accelerations and (k, m, p) of the
        multipliers.
        """
        driven, parts = self.driven, self.robot.inverse_dynamics_derivatives(q, qd, qdd)
        found = sum(part[:, driven] @ change for part, change in zip(parts, by[:3], strict=True))
        if self.loops.count:
            by_q, by_qd = self.loops.force_derivative(q, qd, self.stiffness * multipliers)
            jacobian = self.stiffness * self.loops.jacobian(q)[:, :, driven]
            found = found - by_q[:, driven] @ by[0] - by_qd[:, driven] @ by[1]
            found = found - jacobian.transpose(0, 2, 1) @ by[3]
        return np.asarray(found)

    def errors(self, q: Array, rows: slice = slice(None)) -> Array:
        """Return the weighed errors (k, 6 targets) of all frames [m]."""
        found = [target.weighed(self.robot, q, rows) for target in self.targets]
        return np.concatenate(found, axis=1)

    def error_derivatives(self, q: Array, errors: Array) -> Array:
        """Return the derivatives (k, 6 targets, n) of the weighed errors."""
        parts = np.split(errors, len(self.targets), axis=1)
        pairs = zip(self.targets, parts, strict=True)
        return np.concatenate([t.derivative(self.robot, q, part) for t, part in pairs], axis=1)

    def unreached(self, errors: Array) -> Int:
        """Return the nodes whose position is out of reach, by errors (k, 6 targets).

        What is left there matters beside the draw; a bent arm does not reach as far as a straight
        one.
        """
        reach = max(float(np.abs(target.poses[:, :3, 3]).max()) for target in self.targets)
        left = np.abs(errors.reshape(len(errors), -1, 6)[:, :, :3]).max(axis=(1, 2))
        return np.flatnonzero(left * reach > UNREACHED * self.draw**2)

    def hessian(self, q: Array, errors: Array, jacobian: Array) -> Array:
        """Return the Hessian (k, n, n) of half the squared errors, without concave parts.

        `jacobian` has the errors' derivatives; at nodes that are :meth:`unreached` their second
        ones count as well.
        """
        found = jacobian.transpose(0, 2, 1) @ jacobian
        rows = self.unreached(errors)
        if self.curved and len(rows):
            parts = np.split(errors[rows], len(self.targets), axis=1)
            pairs = zip(self.targets, parts, strict=True)
            bends = sum(t.curvature(self.robot, q[rows], part) for t, part in pairs)
            sizes, axes = np.linalg.eigh(bends)
            found[rows] += (axes * np.maximum(sizes, 0.0)[:, None]) @ axes.transpose(0, 2, 1)
        return np.asarray(found)

    def _stiffness(self, q: Array) -> Array:
        """Return a stiffness (p,) of each undriven coordinate; the largest where it has none."""
        zero = np.zeros(self.robot.n)
        stiffness = self.robot.inverse_dynamics_derivatives(q, zero, zero)[0]
        own = np.abs(stiffness[self.undriven, self.undriven])
        largest = own.max(initial=0.0) or 1.0
        return np.where(own > 1e-6 * largest, own, largest)
