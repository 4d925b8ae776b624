"""Equilibrium of the undriven coordinates, followed along a motion; their response to forces."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from denoc_ros.dynamics.constrained_dynamics import RANK, closure_rows, jacobian
from denoc_ros.dynamics.dynamics_derivatives import DifferentiableModel
from denoc_ros.dynamics.linear.natural_modes import stiffness
from denoc_ros.dynamics.springs import half_play
from denoc_ros.dynamics.validation import as_vector
from denoc_ros.errors import SolverError
from denoc_ros.kernels.derivatives.inverse_derivatives import inverse_dynamics_derivatives
from denoc_ros.kernels.derivatives.load_derivatives import subtract_load_rows
from denoc_ros.kernels.jit.compiled import ready
from denoc_ros.types import Array

Int = NDArray[np.int64]

ITERATIONS = 50
FOLLOW_ITERATIONS = 3
SETTLED = 1e-12  # relative change that ends the iteration
FOLLOWED = 1e-7  # relative change above which the tangent no longer serves


def static_deflection(
    robot: DifferentiableModel,
    q_joints: ArrayLike,
    wrenches: Mapping[str, ArrayLike] | None,
    start: ArrayLike | None,
) -> Array:
    """Return the state (n,) whose amplitudes are in equilibrium at given joint positions."""
    q = np.zeros(robot.n) if start is None else as_vector('start', start, (robot.n,)).copy()
    q[robot.joint_indices] = as_vector('q_joints', q_joints, (len(robot.joint_indices),))
    if len(robot.flexible_indices):
        Equilibrium(robot, robot.flexible_indices, wrenches, closed=False).find(q)
    return q


class UnsettledError(SolverError):
    """No equilibrium is found in the time given; the next search goes on from there."""


class Equilibrium:
    """Coordinates at rest under gravity and elasticity, the others and the loops given.

    Parameters
    ----------
    robot : DifferentiableModel
        Its workspace is used: do not share it with another thread.
    free : (f,) int array
        The coordinates that settle: amplitudes, and joints that the loops bind.
    wrenches : mapping, optional
        External loads, as the robot's verbs take them.
    closed : bool
        Whether loops and mimic joints hold; False: the open tree's equilibrium.

    Notes
    -----
    Newton's iteration for f_F - J_F^T lambda = 0, e = 0 with the tangent [K_FF, -J_F^T; J_F, 0]
    without the change of J, which matters little where links are stiff.
    """

    def __init__(
        self,
        robot: DifferentiableModel,
        free: Int,
        wrenches: Mapping[str, ArrayLike] | None = None,
        closed: bool = True,
    ) -> None:
        self.robot = robot
        self._wrenches = wrenches
        self.free = np.ascontiguousarray(free)
        self._force, self._zero = np.zeros((2, robot.n))
        self._multipliers = np.zeros(len(robot.constraint_names) if closed else 0)
        size = len(free) + len(self._multipliers)
        self._inverse: Array = np.zeros((size, size))
        self._loose = np.flatnonzero(half_play(robot))
        self._found = self._unsettled = False
        # a search in a loop waits for no compiler
        ready(inverse_dynamics_derivatives, *([subtract_load_rows] if wrenches else []))

    def forget(self) -> None:
        """Discard the tangent: the followed equilibrium is no longer nearby."""
        self._found = self._unsettled = False

    def find(self, q: Array, patience: float = np.inf) -> None:
        """Put the free coordinates of q (n,) into equilibrium, from where they are.

        Parameters
        ----------
        q : (n,) array
            Changed in place.
        patience : float
            s of a processor's time after which no further Newton step begins.

        Raises
        ------
        UnsettledError
            The time is over; q is on its way.
        SolverError
            None was found nearby (a load beyond buckling).
        """
        self._found = False
        if not self._unsettled:
            self._multipliers[:] = 0.0
        self._unsettled = False
        self._take_up_play(q)
        share = np.inf
        end = time.thread_time() + patience
        for _ in range(ITERATIONS):
            try:
                self._linearize(q)
            except np.linalg.LinAlgError:
                break
            last, share = share, self._step(q)
            if share <= SETTLED or (share <= FOLLOWED and share >= 0.5 * last):
                self._found = True
                return
            if not np.isfinite(share):
                break
            if time.thread_time() > end:
                self._unsettled = True
                raise UnsettledError(
                    f'{self.robot.tree.name}: an equilibrium must be found in {patience:g} s'
                )
        raise SolverError(
            f'{self.robot.tree.name}: the undriven coordinates must have an equilibrium near '
            'their '
            f'start, got a relative change of {share:.3g} after {ITERATIONS} Newton steps '
            '(buckling?)'
        )

    def _take_up_play(self, q: Array) -> None:
        """Put springs that lie within their play where they begin to carry their load."""
        if not len(self._loose):
            return
        robot, at = self.robot, self._loose
        robot.inverse_dynamics(q, self._zero, self._zero, self._wrenches, out=self._force)
        play = half_play(robot)[at]
        within = np.abs(q[at]) < play
        q[at[within]] = -(np.sign(self._force[at]) * play)[within]

    def follow(self, q: Array) -> bool:
        """Move the free coordinates of q to the equilibrium nearby by the tangent kept.

        Says whether it did: not where none was found yet, or the tangent no longer serves.
        """
        if not self._found:
            return False
        for _ in range(FOLLOW_ITERATIONS):
            share = self._step(q)
            if share <= SETTLED:
                break
        self._found = share <= FOLLOWED
        return self._found

    def _linearize(self, q: Array) -> None:
        free, count = self.free, len(self.free)
        tangent = np.zeros_like(self._inverse)
        tangent[:count, :count] = stiffness(self.robot, q, self._wrenches)[np.ix_(free, free)]
        if len(self._multipliers):
            rows = jacobian(self.robot, q)[0][:, free]
            tangent[:count, count:] = -rows.T
            tangent[count:, :count] = rows
        # links are up to 1e12 times stiffer than rows are large
        scale = np.sqrt(1.0 / np.maximum(np.abs(tangent).max(axis=1), 1e-300))
        scaled = np.linalg.pinv(tangent * scale * scale[:, None], rcond=RANK**2)
        self._inverse = scaled * scale * scale[:, None]

    def _step(self, q: Array) -> float:
        """Take one step; return the change as a share of the free coordinates' size."""
        robot, free, count = self.robot, self.free, len(self.free)
        robot.inverse_dynamics(
            q, self._zero, self._zero, self._wrenches, out=self._force, check=False
        )
        residual = np.concatenate([self._force[free], np.zeros(len(self._multipliers))])
        if len(self._multipliers):
            rows = jacobian(robot, q)[0][:, free]
            residual[:count] -= self._multipliers @ rows
            residual[count:] = closure_rows(robot, q, self._zero)[0]
        change = self._inverse @ residual
        q[free] -= change[:count]
        self._multipliers -= change[count:]
        return float(np.abs(change[:count]).max() / (1e-3 + np.abs(q[free]).max()))


def response(robot: DifferentiableModel, q: Array, free: Int) -> Array:
    """Return the accelerations (f, f) of the free coordinates by unit forces on them.

    Loops stay closed and mimic joints on their leaders: the inverse of I_FF, less what the
    multipliers take back, I_FF^-1 J^T (J I_FF^-1 J^T)^+ J I_FF^-1.
    """
    inverse = np.linalg.inv(robot.inertia_matrix(q, check=False)[np.ix_(free, free)])
    rows = jacobian(robot, q)[0][:, free]
    if rows.any():
        spread = rows @ inverse
        products = np.linalg.pinv(spread @ rows.T, rcond=RANK**2, hermitian=True)
        inverse -= spread.T @ products @ spread
    return np.asarray(inverse, dtype=np.float64)


def impulse_response(robot: DifferentiableModel, q: Array, free: Int, jump: Array) -> Array:
    """Return the jump (n,) of all rates where some are made to jump and the free ones answer.

    Parameters
    ----------
    q : (n,)
    free : (f,) int array
        Coordinates that no impulse acts on.
    jump : (n,)
        One that obeys the loops; what it has of free coordinates does not matter otherwise.
    """
    answer: Array = jump.copy()
    if len(free):
        momentum = robot.inertia_matrix(q, check=False)[free] @ jump
        answer[free] -= response(robot, q, free) @ momentum
    return answer
