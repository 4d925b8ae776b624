"""Derivatives of dynamics with loops and mimic joints; docs/derivatives.md."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from denoc_ros.dynamics import constraints
from denoc_ros.dynamics.batch import each_row
from denoc_ros.dynamics.constraint_derivatives import (
    applied_change,
    row_derivatives,
    transposed_change,
)
from denoc_ros.dynamics.derivatives import DifferentiableModel
from denoc_ros.dynamics.validation import as_outputs, as_states

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot

Array = NDArray[np.float64]
Int = NDArray[np.int64]


class ConstrainedForwardDerivatives(NamedTuple):
    """How accelerations and multipliers change; rows (k, …) of states give (k, …) of each.

    Attributes
    ----------
    dqdd_dq, dqdd_dqd, dqdd_dtau : (n, n)
    dmultipliers_dq, dmultipliers_dqd, dmultipliers_dtau : (rows, n)
    """

    dqdd_dq: Array
    dqdd_dqd: Array
    dqdd_dtau: Array
    dmultipliers_dq: Array
    dmultipliers_dqd: Array
    dmultipliers_dtau: Array


class ConstrainedInverseDerivatives(NamedTuple):
    """How the torques of a actuated joints and the multipliers change.

    Rows (k, …) of states give (k, …) of each.

    Attributes
    ----------
    dtau_dq, dtau_dqd, dtau_dqdd : (a, n)
    dmultipliers_dq, dmultipliers_dqd, dmultipliers_dqdd : (rows, n)
    """

    dtau_dq: Array
    dtau_dqd: Array
    dtau_dqdd: Array
    dmultipliers_dq: Array
    dmultipliers_dqd: Array
    dmultipliers_dqdd: Array


class ConstrainedHybridDerivatives(NamedTuple):
    """How torques of a actuated joints, all accelerations and the multipliers change.

    By q, by q', by the accelerations of the actuated joints, and by the generalized forces of all
    coordinates (columns of actuated joints are zero). Rows (k, …) of states give (k, …) of each.

    Attributes
    ----------
    dtau_dq, dtau_dqd, dtau_dqdd, dtau_dtau : (a, n), (a, n), (a, a), (a, n)
    dqdd_dq, dqdd_dqd, dqdd_dqdd, dqdd_dtau : (n, n), (n, n), (n, a), (n, n)
    dmultipliers_dq, dmultipliers_dqd, dmultipliers_dqdd, dmultipliers_dtau :
        (rows, n), (rows, n), (rows, a), (rows, n)
    """

    dtau_dq: Array
    dtau_dqd: Array
    dtau_dqdd: Array
    dtau_dtau: Array
    dqdd_dq: Array
    dqdd_dqd: Array
    dqdd_dqdd: Array
    dqdd_dtau: Array
    dmultipliers_dq: Array
    dmultipliers_dqd: Array
    dmultipliers_dqdd: Array
    dmultipliers_dtau: Array


class TiedDerivatives(NamedTuple):
    """Derivatives of I q'' + h - J^T multipliers (n, n) with the multipliers constant."""

    by_q: Array
    by_rate: Array
    inertia: Array
    rows: Array  # J (rows, n)
    bias_by_q: Array  # of g'' (rows, n)
    bias_by_rate: Array


class DifferentiableMechanism(DifferentiableModel):
    """The verbs that say how motion, torques and multipliers change with loops closed.

    They hold for changes of state that keep the loops closed; what rows say twice leaves the
    multipliers of least norm, all along.
    """

    def constrained_forward_dynamics_derivatives(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        out: Sequence[Array] | None = None,
    ) -> ConstrainedForwardDerivatives:
        """Return the derivatives of :meth:`Robot.constrained_forward_dynamics`.

        Parameters
        ----------
        q, qd, tau : (n,) or (k, n)
            A closed state and the generalized forces.
        out : six arrays, optional
            Take the results, in the order of ConstrainedForwardDerivatives.

        Returns
        -------
        ConstrainedForwardDerivatives

        Raises
        ------
        StateError
            For a wrong shape or type, or a number that is not finite.
        SolverError
            A singular configuration in which no accelerations keep the loops closed.
        """
        robot, n = cast('Robot', self), self.n
        states = (as_states('q', q, n), as_states('qd', qd, n), as_states('tau', tau, n))
        found = each_row(lambda q, qd, tau: _forward(robot, q, qd, tau), *states)
        return ConstrainedForwardDerivatives(*_delivered(found, out))

    def constrained_inverse_dynamics_derivatives(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        actuated: Sequence[str] | None = None,
        out: Sequence[Array] | None = None,
    ) -> ConstrainedInverseDerivatives:
        """Return the derivatives of :meth:`Robot.constrained_inverse_dynamics`.

        They hold for changes that the actuated joints can give.

        Parameters
        ----------
        q, qd, qdd : (n,) or (k, n)
            Motion that keeps the loops closed.
        actuated : joint names, optional
            Any joints of the tree; default all that mimic none.
        out : six arrays, optional
            Take the results, in the order of ConstrainedInverseDerivatives.

        Returns
        -------
        ConstrainedInverseDerivatives
            Rows of torques in the order of `actuated`.

        Raises
        ------
        StateError
            The accelerations open a loop, or are none that these joints can give.
        """
        robot, n, index = cast('Robot', self), self.n, self._actuated(actuated)
        states = (as_states('q', q, n), as_states('qd', qd, n), as_states('qdd', qdd, n))
        found = each_row(lambda q, qd, qdd: _inverse(robot, q, qd, qdd, index), *states)
        return ConstrainedInverseDerivatives(*_delivered(found, out))

    def constrained_hybrid_dynamics_derivatives(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd_actuated: ArrayLike,
        actuated: Sequence[str] | None = None,
        tau: ArrayLike | None = None,
        out: Sequence[Array] | None = None,
    ) -> ConstrainedHybridDerivatives:
        """Return the derivatives of :meth:`Robot.constrained_hybrid_dynamics`.

        Parameters
        ----------
        q, qd : (n,) or (k, n)
        qdd_actuated : (actuated,) or (k, actuated)
        actuated : joint names, optional
            Any joints of the tree; default all that mimic none.
        tau : (n,) or (k, n), optional
            Generalized forces of the other coordinates; default zero.
        out : twelve arrays, optional
            Take the results, in the order of ConstrainedHybridDerivatives.

        Returns
        -------
        ConstrainedHybridDerivatives
            Rows of torques and columns of their accelerations in the order of `actuated`.

        Raises
        ------
        StateError
            For a wrong shape or type, or a number that is not finite.
        SolverError
            The given accelerations contradict the loops.
        """
        robot, n, index = cast('Robot', self), self.n, self._actuated(actuated)
        states = (as_states('q', q, n), as_states('qd', qd, n))
        given = as_states('qdd_actuated', qdd_actuated, len(index))
        loads = as_states('tau', np.zeros(n) if tau is None else tau, n)
        found = each_row(
            lambda q, qd, given, tau: _hybrid(robot, q, qd, given, index, tau),
            *states, given, loads,
        )  # fmt: skip
        return ConstrainedHybridDerivatives(*_delivered(found, out))


def _delivered(found: Sequence[Array], out: Sequence[Array] | None) -> Sequence[Array]:
    """Return results, in the caller's arrays where these are given."""
    if out is None:
        return found
    given = as_outputs(out, [each.shape for each in found])
    for target, each in zip(given, found, strict=True):
        target[...] = each
    return given


def _resistance(robot: Robot, axes: Array, qd: Array, friction: bool) -> tuple[Array, Array]:
    """Return force and slope (axes,) of damping and friction along the loops' free axes."""
    loops = [loop for loop in robot.tree.loops if loop.damping > 0.0 or loop.friction > 0.0]
    damping, dry = np.array([(x.damping, x.friction) for x in loops]).reshape(-1, 2).T
    rates, scale = axes @ qd, robot.slip_rate
    slip = np.tanh(rates / scale)
    slope = damping + dry / scale * (1.0 - slip**2) if friction else damping
    return damping * rates + dry * slip, slope


def tied_derivatives(
    robot: Robot, q: Array, qd: Array, qdd: Array, multipliers: Array, friction: bool = True
) -> TiedDerivatives:
    """Return how the forces that motion in the loops asks for change, and the rows.

    friction: False leaves out the slope of the loops' own friction.
    """
    rows, axes = constraints.jacobian(robot, q)
    force, slope = _resistance(robot, axes, qd, friction)
    by_q, by_rate, inertia = robot.inverse_dynamics_derivatives(q, qd, qdd)
    change = row_derivatives(robot, q, qd, qdd)
    by_q = by_q - transposed_change(robot, q, multipliers, -force)
    by_q = by_q + axes.T @ (slope[:, None] * change.axis_rates_by_q)
    by_rate = by_rate + axes.T @ (slope[:, None] * axes)
    return TiedDerivatives(by_q, by_rate, inertia, rows, change.by_q, change.by_rate)


def _accelerations(
    tied: TiedDerivatives, held: Int, changes: Sequence[tuple[Array, Array, Array]]
) -> list[Array]:
    """Return the changes of q'' (n, c) for each (force left, bias of rows, given) (…, c)."""
    n = len(tied.inertia)
    rows = np.vstack([tied.rows, np.eye(n)[held]])
    factor = np.linalg.inv(np.linalg.cholesky(tied.inertia))
    # in coordinates in which the inertia is 1, J's least solution and its null space
    white = np.linalg.pinv(rows @ factor.T, rcond=constraints.RANK)
    open_to = np.eye(n) - white @ (rows @ factor.T)
    found = []
    for left, bias, given in changes:
        wanted = np.concatenate([-bias, given])
        found.append(factor.T @ (white @ wanted - open_to @ (factor @ left)))
    return found


def _multipliers(
    robot: Robot, tied: TiedDerivatives, q: Array, multipliers: Array, changes: Sequence[Array]
) -> list[Array]:
    """Return their changes (rows, c) for changes (n, c) of J^T multipliers, J constant.

    The first changes are by q: with them turns what redundant rows leave open.
    """
    back = np.linalg.pinv(tied.rows.T, rcond=constraints.RANK)
    found = [back @ change for change in changes]
    if len(tied.rows):
        left = constraints.least_solution(tied.rows, multipliers)[0]
        turning = applied_change(robot, q, left)
        found[0] = found[0] + turning - back @ (tied.rows.T @ turning)
    return found


def _forward(robot: Robot, q: Array, qd: Array, tau: Array) -> tuple[Array, ...]:
    """Return q'' by q, q' and tau (n, n each), then the multipliers so (rows, n each)."""
    n = robot.n
    qdd, multipliers = constraints.forward(robot, q, qd, tau)
    tied = tied_derivatives(robot, q, qd, qdd, multipliers)
    none, still, unit = np.zeros((0, n)), np.zeros_like(tied.rows), -np.eye(n)
    left = (tied.by_q, tied.by_rate, unit)
    biases = (tied.bias_by_q, tied.bias_by_rate, still)
    held = np.zeros(0, dtype=np.int64)
    changes = [(a, b, none) for a, b in zip(left, biases, strict=True)]
    motion = _accelerations(tied, held, changes)
    pushed = [tied.inertia @ up + a for up, a in zip(motion, left, strict=True)]
    return (*motion, *_multipliers(robot, tied, q, multipliers, pushed))


def _inverse(robot: Robot, q: Array, qd: Array, qdd: Array, actuated: Int) -> tuple[Array, ...]:
    """Return torques (a, n) by q, q' and q'', then the multipliers so (rows, n each)."""
    load = np.zeros(robot.n)
    torque, multipliers = constraints.inverse_torques(robot, q, qd, qdd, actuated, load)
    tied = tied_derivatives(robot, q, qd, qdd, multipliers)
    asked = (tied.by_q, tied.by_rate, tied.inertia)
    return _forces(robot, tied, q, torque, multipliers, actuated, asked)


def _hybrid(
    robot: Robot, q: Array, qd: Array, given: Array, actuated: Int, tau: Array
) -> tuple[Array, ...]:
    """Return torques, accelerations and multipliers, each by q, q', given accelerations, tau."""
    n, a = robot.n, len(actuated)
    loads = tau.copy()
    loads[actuated] = 0.0
    qdd, _ = constraints.accelerations(robot, q, qd, loads, actuated, given)
    torque, multipliers = constraints.inverse_torques(robot, q, qd, qdd, actuated, loads)
    tied = tied_derivatives(robot, q, qd, qdd, multipliers)
    loaded = -np.eye(n)
    loaded[actuated, actuated] = 0.0
    still, held = np.zeros_like(tied.rows), np.zeros((a, n))
    left = (tied.by_q, tied.by_rate, np.zeros((n, a)), loaded)
    biases = (tied.bias_by_q, tied.bias_by_rate, still[:, :a], still)
    wanted = (held, held, np.eye(a), held)
    motion = _accelerations(tied, actuated, list(zip(left, biases, wanted, strict=True)))
    asked = [tied.inertia @ up + other for up, other in zip(motion, left, strict=True)]
    found = _forces(robot, tied, q, torque, multipliers, actuated, asked)
    return (*found[:4], *motion, *found[4:])


def _forces(
    robot: Robot,
    tied: TiedDerivatives,
    q: Array,
    torque: Array,
    multipliers: Array,
    actuated: Int,
    asked: Sequence[Array],
) -> tuple[Array, ...]:
    """Return changes of torques (a, c), then of multipliers (rows, c), for forces asked (n, c).

    The first forces are by q. Torques are least where J v = 0, v the torques at the actuated
    joints and multipliers of the other coordinates' equations; as J changes, the torques turn.
    """
    n, r = tied.rows.shape[1], len(tied.rows)
    passive = np.setdiff1d(np.arange(n), actuated)
    v, select = np.zeros(n), np.zeros((n, n))
    v[actuated], select[actuated, actuated] = torque, 1.0
    if r and len(passive):
        v[passive] = constraints.least_solution(tied.rows[:, passive], -tied.rows @ v)[0]
    saddle = np.block([[select, tied.rows.T], [tied.rows, np.zeros((r, r))]])
    below = [np.zeros((r, each.shape[1])) for each in asked]
    below[0] = -applied_change(robot, q, v)
    solve = np.linalg.pinv(saddle, rcond=constraints.RANK, hermitian=True)[actuated]
    torques = [solve @ np.vstack(parts) for parts in zip(asked, below, strict=True)]
    pushed = [each - select[:, actuated] @ t for each, t in zip(asked, torques, strict=True)]
    return (*torques, *_multipliers(robot, tied, q, multipliers, pushed))
