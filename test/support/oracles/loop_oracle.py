"""The dense oracle with loops and mimic joints: Lagrange's multipliers by a null space.

The closure of a loop is written as a function of positions, in power series: its Jacobian and its
acceleration bias follow by differentiation. The angular rows are the sine of the error between the
loop's frames, so Jacobian and bias are those of a loop that is closed, positions and rates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jets import Jet, stack
from oracles import SLIDE_SPEED, Oracle
from scipy.linalg import null_space

from denoc_ros.model.tree import JointKind, Loop
from denoc_ros.types import Array

# Singular values this far below the largest are rounding: a planar loop's are below 1e-15.
RANK = 1e-10


@dataclass(frozen=True)
class Rows:
    """Constraint rows of all loops in file order (linear rows first), then of mimic joints."""

    error: Array  # (rows,) [m, rad]
    jacobian: Array  # (rows, n)
    bias: Array  # (rows,) J' qd


def perpendicular(axis: Array) -> Array:
    """(2, 3) two unit vectors e1, e2 with e1 x e2 = axis."""
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(axis, first)])


def small_turn(turn: Jet) -> Jet:
    """(3,) sine of the angle times the axis of a rotation (3, 3)."""
    skew = turn - turn.transpose()
    return stack([skew[2, 1], skew[0, 2], skew[1, 0]]) * 0.5


class LoopOracle(Oracle):
    """The constrained verbs, dense. Reactions are wrenches, so no choice of axes enters."""

    def _relative(self, loop: Loop, series: Jet) -> tuple[Jet, Jet]:
        """Rotation (3, 3) and position (3,) of the child's loop frame seen from the parent's."""
        poses = self.poses(series)
        parent, child = (
            self._attached(self.tree.frames[side.frame], series, poses)
            for side in (loop.parent, loop.child)
        )
        back = parent[:3, :3].transpose()
        apart = child[:3, 3:] - parent[:3, 3:]
        return back @ child[:3, :3], (back @ apart)[:, 0]

    def _loop_rows(self, loop: Loop, series: Jet) -> tuple[Jet, Array]:
        """Errors (rows,) and the unit wrenches (6, rows) of their multipliers.

        Along a slide the wrench acts at the child's origin.
        """
        turn, offset = self._relative(loop, series)
        linear, angular = np.eye(3), np.zeros((0, 3))
        if loop.type == 'fixed':
            errors, angular = [small_turn(turn)], np.eye(3)
        elif loop.type == 'prismatic':
            assert loop.axis is not None
            linear, angular = perpendicular(loop.axis), np.eye(3)
            errors = [small_turn(turn)]
        elif loop.type == 'revolute':
            assert loop.axis is not None
            angular = perpendicular(loop.axis)
            # e1 . a' and e2 . a' of the child's axis a' turn as -e2 and e1
            tilt = (turn @ loop.axis) @ angular.T
            errors = [stack([-tilt[1], tilt[0]])]
        elif loop.type == 'universal':
            assert loop.axis is not None
            assert loop.axis2 is not None
            # wrenches are of real states, also while errors take a complex step
            cross = np.cross(loop.axis, turn.value.real @ loop.axis2)
            angular = cross[None] / np.linalg.norm(cross)
            errors = [stack([-((turn @ loop.axis2) @ loop.axis)])]
        else:
            errors = []
        force = np.zeros((6, len(linear) + len(angular)))
        force[:3, : len(linear)], force[3:, len(linear) :] = linear.T, angular.T
        rows = Jet(np.concatenate([part.c for part in [offset @ linear.T, *errors]], axis=2))
        return rows, force

    def _motion(self, q: Array, qd: Array) -> Jet:
        return self._series(q, qd, np.zeros(self.n))

    def _mimic_rows(self, q: Array) -> tuple[Array, Array]:
        """Errors and Jacobian of q - multiplier * leader - offset."""
        jacobian, offsets = np.zeros((0, self.n)), []
        places = {
            body.joint.name: span.joint.start
            for body, span in zip(self.tree.bodies, self.spans, strict=True)
            if body.joint is not None and body.joint.kind is not JointKind.FIXED
        }
        for body in self.tree.bodies:
            if body.joint is not None and body.joint.mimic is not None:
                row = np.zeros(self.n)
                row[places[body.joint.name]] += 1
                row[places[body.joint.mimic.leader]] -= body.joint.mimic.multiplier
                jacobian = np.vstack([jacobian, row])
                offsets.append(body.joint.mimic.offset)
        return jacobian @ q - np.array(offsets), jacobian

    def rows(self, q: Array, qd: Array) -> Rows:
        """All constraint rows at a state."""
        series = self._motion(q, qd)
        jets = [self._loop_rows(loop, series)[0] for loop in self.tree.loops]
        errors, jacobian = self._mimic_rows(q)
        return Rows(
            np.concatenate([*(jet.value for jet in jets), errors]),
            np.vstack([*(jet.c[0, 1 : 1 + self.n].T for jet in jets), jacobian]),
            np.concatenate([*(jet.acceleration for jet in jets), np.zeros(len(errors))]),
        )

    def reactions(self, q: Array, multipliers: Array) -> tuple[list[Array], Array]:
        """Wrench (6,) of each loop, parent's frame, on the child; the rest is mimic joints'."""
        series, wrenches, start = self._motion(q, np.zeros(self.n)), [], 0
        for loop in self.tree.loops:
            force = self._loop_rows(loop, series)[1]
            wrenches.append(force @ multipliers[start : start + force.shape[1]])
            start += force.shape[1]
        return wrenches, multipliers[start:]

    def loop_forces(self, q: Array, qd: Array) -> Array:
        """Generalized forces (n,) of damping and friction in the loops' own joints."""
        series, total = self._motion(q, qd), np.zeros(self.n, np.result_type(q, qd, float))
        for loop in self.tree.loops:
            if loop.damping == 0 and loop.friction == 0:
                continue
            assert loop.axis is not None
            turn, offset = self._relative(loop, series)
            row = (offset @ loop.axis).c[0, 1 : 1 + self.n]
            if loop.type == 'revolute':
                row = self._turning(turn, loop.axis)
            rate = row @ qd
            total -= row * (loop.damping * rate + loop.friction * np.tanh(rate / SLIDE_SPEED))
        return total

    def _turning(self, turn: Jet, axis: Array) -> Array:
        """(n,) rate of the child about an axis in the parent, by each coordinate's rate."""
        W = turn.c[0, 1 : 1 + self.n] @ turn.value.T
        return np.stack([W[:, 2, 1], W[:, 0, 2], W[:, 1, 0]], axis=1) @ axis

    def _forces(self, q: Array, qd: Array) -> tuple[Array, Array]:
        """Inertia (n, n) and h (n,) with the loops' own damping and friction."""
        return self.inertia_matrix(q), self.bias_forces(q, qd) - self.loop_forces(q, qd)

    def constrained_forward_dynamics(
        self, q: Array, qd: Array, tau: Array
    ) -> tuple[Array, list[Array], Array]:
        """Accelerations, the loops' wrenches, the mimic joints' multipliers: minimum norm."""
        M, h = self._forces(q, qd)
        rows = self.rows(q, qd)
        qdd = _constrained(M, tau - h, rows.jacobian, -rows.bias)
        multipliers = np.linalg.lstsq(rows.jacobian.T, M @ qdd + h - tau, rcond=RANK)[0]
        return qdd, *self.reactions(q, multipliers)

    def constrained_inverse_dynamics(
        self, q: Array, qd: Array, qdd: Array, actuated: Sequence[int]
    ) -> tuple[Array, list[Array], Array]:
        """Torques of the actuated coordinates, of minimum norm, and as forward dynamics."""
        M, h = self._forces(q, qd)
        J, need = self.rows(q, qd).jacobian, M @ qdd + h
        select = np.eye(self.n)[:, list(actuated)]
        N = null_space(J, rcond=RANK) if len(J) else np.eye(self.n)
        torque, _, _, _ = np.linalg.lstsq(N.T @ select, N.T @ need, rcond=RANK)
        multipliers = np.linalg.lstsq(J.T, need - select @ torque, rcond=RANK)[0]
        return torque, *self.reactions(q, multipliers)

    def constrained_hybrid_dynamics(
        self, q: Array, qd: Array, qdd_actuated: Array, actuated: Sequence[int]
    ) -> tuple[Array, Array, list[Array], Array]:
        """Torques and accelerations with the actuated accelerations given, and as forward."""
        M, h = self._forces(q, qd)
        rows, select = self.rows(q, qd), np.eye(self.n)[list(actuated)]
        J = np.vstack([rows.jacobian, select])
        qdd = _constrained(M, -h, J, np.concatenate([-rows.bias, qdd_actuated]))
        torque, wrenches, constraints = self.constrained_inverse_dynamics(q, qd, qdd, actuated)
        return torque, qdd, wrenches, constraints

    def assemble(self, q: Array, fixed: Sequence[int] = ()) -> Array:
        """A closed configuration near a guess, by Gauss-Newton steps of minimum norm."""
        q, free = np.array(q), np.setdiff1d(np.arange(self.n), list(fixed))
        for _ in range(50):
            rows = self.rows(q, np.zeros(self.n))
            if np.max(np.abs(rows.error)) < 1e-14:
                break
            step = np.linalg.lstsq(rows.jacobian[:, free], -rows.error, rcond=RANK)[0]
            q[free] += step
            if np.max(np.abs(step)) < 1e-15:
                break
        return q

    def assemble_rates(self, q: Array, qd: Array, fixed: Sequence[int] = ()) -> Array:
        """Rates that keep the loops closed, nearest to a guess."""
        qd, free = np.array(qd), np.setdiff1d(np.arange(self.n), list(fixed))
        J = self.rows(q, np.zeros(self.n)).jacobian
        qd[free] += np.linalg.lstsq(J[:, free], -J @ qd, rcond=RANK)[0]
        return qd


def _constrained(M: Array, force: Array, J: Array, value: Array) -> Array:
    """M qdd = force + J^T lambda with J qdd = value: the least-constrained acceleration."""
    if not len(J):
        return np.asarray(np.linalg.solve(M, force))
    particular = np.linalg.lstsq(J, value, rcond=RANK)[0]
    N = null_space(J, rcond=RANK)
    inside = np.linalg.solve(N.T @ M @ N, N.T @ (force - M @ particular))
    return np.asarray(particular + N @ inside)
