"""The verbs of loops and mimic joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from denoc_ros.dynamics import assembling, constraints
from denoc_ros.dynamics.base_motion import Base, on_base
from denoc_ros.dynamics.batch import each_row
from denoc_ros.dynamics.tree_dynamics import TreeDynamics, Wrenches
from denoc_ros.dynamics.validation import as_states, same_rows
from denoc_ros.kernels import constrained
from denoc_ros.kernels.compiled import entry
from denoc_ros.kernels.handle import GOOD, MISFIT
from denoc_ros.model.arrays import ModelArrays
from denoc_ros.types import Array

_empty = np.empty  # a global name is found more quickly than a module's


class ConstrainedModel(TreeDynamics):
    """Dynamics of a robot with closed loops, and mimic joints on their leaders.

    Rows are loops in file order, then mimic joints in that of their coordinates. A loop's rows are
    the constrained components of the motion of its child's loop frame in its parent's, linear
    first; its multipliers are those of the wrench that the parent exerts on the child at the
    child's frame, in the parent's axes (docs/loops.md).
    """

    def _adopt(self, arrays: ModelArrays) -> None:
        super()._adopt(arrays)
        self._rows = len(arrays.constraint_names)
        # without rows the kernel is not ready, and not needed
        self._constrained: Callable[..., int] = lambda *_: MISFIT
        if self._rows:
            self._constrained = entry(constrained.constrained_dynamics)

    def closure(self, q: ArrayLike) -> Array:
        """Return the errors (rows,) or (k, rows) of the loops and mimic joints [m, rad]."""
        q = as_states('q', q, self.n)
        zero = np.zeros(self.n)
        errors: Array = each_row(lambda row: constraints.closure_rows(self, row, zero)[0], q)
        return errors

    def closure_jacobian(self, q: ArrayLike) -> Array:
        """Return J (rows, n) or (k, rows, n), the derivative of :meth:`closure`."""
        q = as_states('q', q, self.n)
        rows: Array = each_row(lambda row: constraints.jacobian(self, row)[0], q)
        return rows

    def closure_bias(self, q: ArrayLike, qd: ArrayLike) -> Array:
        """Return J' q' (rows,) or (k, rows), which accelerations J q'' must cancel."""
        states = as_states('q', q, self.n), as_states('qd', qd, self.n)
        bias: Array = each_row(lambda q, qd: constraints.closure_rows(self, q, qd)[2], *states)
        return bias

    def assemble(self, q_guess: ArrayLike, fixed: Sequence[str] = ()) -> Array:
        """Return a closed configuration (n,) or (k, n) near a guess.

        Parameters
        ----------
        q_guess : (n,) or (k, n)
        fixed : coordinate names, optional
            What stays as it is. Amplitudes stay too unless the joints alone cannot close.

        Raises
        ------
        SolverError
            None was found; names the loop and the error reached.
        """
        guess = as_states('q_guess', q_guess, self.n)
        q: Array = each_row(lambda row: assembling.assemble(self, row, fixed), guess)
        return q

    def assemble_rates(
        self, q: ArrayLike, qd_guess: ArrayLike, fixed: Sequence[str] = ()
    ) -> Array:
        """Return rates (n,) or (k, n) near a guess that keep the loops closed.

        As :meth:`assemble`; the change is the smallest there is.
        """
        q, guess = as_states('q', q, self.n), as_states('qd_guess', qd_guess, self.n)
        qd: Array = each_row(lambda q, qd: assembling.assemble_rates(self, q, qd, fixed), q, guess)
        return qd

    def constrained_forward_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        base: Base | None = None,
        wrenches: Wrenches | None = None,
    ) -> tuple[Array, Array]:
        """Return accelerations (n,) and multipliers (rows,), or rows of them.

        Parameters
        ----------
        q, qd, tau : (n,) or (k, n)
            A state that is closed (see :meth:`assemble`) and the generalized forces.
        base : (twist, acceleration[, pose]), optional
            A base that moves, as of :meth:`Robot.inverse_dynamics`.
        wrenches : {frame: (6,)}, optional
            External loads, base axes, linear first, at the frame's origin [N, N m].

        Raises
        ------
        SolverError
            A singular configuration in which no accelerations keep the loops closed.
        """
        if base is not None:
            return on_base(self, self.constrained_forward_dynamics, locals())
        n = self.n
        if wrenches:
            tau = as_states('tau', tau, n) + self._load(as_states('q', q, n), wrenches)
        qdd, multipliers = _empty(n), _empty(self._rows)
        zero = self._zero
        if self._constrained(self.handle, zero, q, qd, zero, tau, qdd, multipliers) == GOOD:
            return qdd, multipliers
        states = (as_states('q', q, n), as_states('qd', qd, n), as_states('tau', tau, n))
        single, (q, qd, tau) = all(state.ndim == 1 for state in states), same_rows(states)
        found = constraints.accelerations(self, zero, q, qd, np.zeros(q.shape), tau)
        return (found[0][0], found[1][0]) if single else found

    def constrained_inverse_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        actuated: Sequence[str] | None = None,
        base: Base | None = None,
        wrenches: Wrenches | None = None,
    ) -> tuple[Array, Array]:
        """Return the torques of actuated joints and the multipliers, both of least norm.

        Parameters
        ----------
        q, qd, qdd : (n,) or (k, n)
            Motion that keeps the loops closed.
        actuated : joint names, optional
            Any joints of the tree; default all that mimic none. With more than there are degrees
            of freedom the torques are those of least norm.
        base : (twist, acceleration[, pose]), optional
            A base that moves, as of :meth:`Robot.inverse_dynamics`.
        wrenches : {frame: (6,)}, optional

        Returns
        -------
        tau_actuated : (actuated,) or (k, actuated) [N m, N]
        multipliers : (rows,) or (k, rows)

        Raises
        ------
        StateError
            The accelerations open a loop, or are none that these joints can give; with the
            residual.
        """
        if base is not None:
            return on_base(self, self.constrained_inverse_dynamics, locals())
        index, n = self._actuated(actuated), self.n
        states = [as_states('q', q, n), as_states('qd', qd, n), as_states('qdd', qdd, n)]
        states.append(self._load(states[0], wrenches or {}))
        single, rows = all(state.ndim == 1 for state in states), same_rows(states)
        torque, multipliers = constraints.torques(self, self.held(index), *rows)
        torque = torque.take(index, axis=1)
        return (torque[0], multipliers[0]) if single else (torque, multipliers)

    def constrained_hybrid_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd_actuated: ArrayLike,
        actuated: Sequence[str] | None = None,
        tau: ArrayLike | None = None,
        base: Base | None = None,
        wrenches: Wrenches | None = None,
    ) -> tuple[Array, Array, Array]:
        """Return torques, accelerations and multipliers for given actuated accelerations.

        The other coordinates, passive joints and amplitudes, move freely in the loops.

        Parameters
        ----------
        q, qd : (n,) or (k, n)
        qdd_actuated : (actuated,) or (k, actuated)
        actuated : joint names, optional
            As in :meth:`constrained_inverse_dynamics`.
        tau : (n,) or (k, n), optional
            Generalized forces of the other coordinates; default zero.
        base : (twist, acceleration[, pose]), optional
            A base that moves, as of :meth:`Robot.inverse_dynamics`.
        wrenches : {frame: (6,)}, optional

        Returns
        -------
        tau_actuated : (actuated,) or (k, actuated) [N m, N]
        qdd : (n,) or (k, n)
        multipliers : (rows,) or (k, rows)

        Raises
        ------
        SolverError
            The given accelerations contradict the loops.
        """
        if base is not None:
            return on_base(self, self.constrained_hybrid_dynamics, locals())
        split = self._workspace.split(self._actuated(actuated))
        return self._hybrid(True, split, q, qd, ('qdd_actuated', qdd_actuated), tau, wrenches)

    def _actuated(self, names: Sequence[str] | None) -> NDArray[np.int64]:
        return self.indices(self.tree.non_mimic_joints if names is None else names)
