"""Derivatives of the dynamics by coordinates, rates and inputs; docs/derivatives.md."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics.base_motion import Base, on_base
from denoc_ros.dynamics.batch import run_rows
from denoc_ros.dynamics.constrained_model import ConstrainedModel
from denoc_ros.dynamics.tree_dynamics import KernelOperation, Wrenches
from denoc_ros.dynamics.validation import (
    as_outputs,
    as_rows,
    as_vector,
    same_rows,
)
from denoc_ros.errors import StateError
from denoc_ros.kernels import (
    forward_derivatives,
    inverse_derivatives,
    load_derivatives,
)
from denoc_ros.kernels.handle import GOOD
from denoc_ros.types import Array

Derivatives = tuple[Array, Array, Array]
_empty = np.empty  # a global name is found more quickly than a module's


class HybridDerivatives(NamedTuple):
    """How the torques of h joints and the accelerations of the f = n - h others change.

    By q and q' of all coordinates; by what drives them, the joints' accelerations and the other
    coordinates' generalized forces. Rows (k, …) of states give (k, …) of each.

    Attributes
    ----------
    dtau_dq, dtau_dqd : (h, n)
    dtau_dqdd : (h, h)
        By the joints' accelerations.
    dtau_dtau : (h, f)
        By the others' forces.
    dqdd_dq, dqdd_dqd : (f, n)
    dqdd_dqdd : (f, h)
    inverse_inertia : (f, f)
        That of the other coordinates, the joints held: by their forces.
    """

    dtau_dq: Array
    dtau_dqd: Array
    dtau_dqdd: Array
    dtau_dtau: Array
    dqdd_dq: Array
    dqdd_dqd: Array
    dqdd_dqdd: Array
    inverse_inertia: Array


INVERSE = KernelOperation(
    inverse_derivatives.inverse_dynamics_derivatives,
    inverse_derivatives.inverse_dynamics_derivatives_rows,
    lambda n: ((n, n),) * 3,
)
FORWARD = KernelOperation(
    forward_derivatives.forward_dynamics_derivatives,
    forward_derivatives.forward_dynamics_derivatives_rows,
    INVERSE.shapes,
)


class DifferentiableModel(ConstrainedModel):
    """The verbs for derivatives of torque and acceleration by the state.

    Derivatives are matrices, a row per force or acceleration, a column per coordinate. Their
    kernels compile when the first of these verbs is called.
    """

    def inverse_dynamics_derivatives(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        wrenches: Wrenches | None = None,
        out: Sequence[Array] | None = None,
        check: bool = True,
        base: Base | None = None,
    ) -> Derivatives:
        """Return the derivatives of :meth:`Robot.inverse_dynamics`.

        Parameters
        ----------
        q, qd, qdd : (n,) or (k, n)
        wrenches : {frame: (6,)}, optional
            External loads, base axes, linear first, at the frame's origin [N, N m]; they keep
            their direction as the frame moves.
        out : three arrays, optional
            Take the results.
        base : (twist, acceleration[, pose]), optional
            A base that moves, as of :meth:`Robot.inverse_dynamics`; its motion stays as it is.

        Returns
        -------
        dtau_dq, dtau_dqd, inertia : (n, n) or (k, n, n) each
            Armature, elasticity, damping and the slope of friction included; dtau_dqdd is the
            generalized inertia matrix.

        Raises
        ------
        StateError
            For a wrong shape or type, or a number that is not finite.
        """
        if base is not None:
            return on_base(self, self.inverse_dynamics_derivatives, locals())
        if out is None:
            result = (_empty(self._square), _empty(self._square), _empty(self._square))
        else:
            result = _three(out)
        status = INVERSE.call(self.handle, q, qd, qdd, *result)
        if status != GOOD:
            arguments = {'q': q, 'qd': qd, 'qdd': qdd}
            a, b, c = self._settle(status, INVERSE, arguments, out, result, check)
            result = (a, b, c)
        if wrenches:
            self._subtract_loads(as_rows('q', q, self.n), wrenches, result[0])
        return result

    def forward_dynamics_derivatives(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        wrenches: Wrenches | None = None,
        out: Sequence[Array] | None = None,
        check: bool = True,
        base: Base | None = None,
    ) -> Derivatives:
        """Return the derivatives of :meth:`Robot.forward_dynamics`.

        Parameters as in :meth:`inverse_dynamics_derivatives`, with generalized forces tau.

        Returns
        -------
        dqdd_dq, dqdd_dqd, inverse_inertia : (n, n) or (k, n, n) each
            dqdd_dtau is the inverse of the generalized inertia matrix.

        Raises
        ------
        StateError
            For a wrong shape or type, or a number that is not finite.
        SolverError
            The inertia is singular (a massless chain).
        """
        if base is not None:
            return on_base(self, self.forward_dynamics_derivatives, locals())
        load = None
        if wrenches:
            load = self.load_derivative(q, wrenches)
            tau = as_rows('tau', tau, self.n) + self._load(as_rows('q', q, self.n), wrenches)
        if out is None:
            result = (_empty(self._square), _empty(self._square), _empty(self._square))
        else:
            result = _three(out)
        status = FORWARD.call(self.handle, q, qd, tau, *result)
        if status != GOOD:
            arguments = {'q': q, 'qd': qd, 'tau': tau}
            a, b, c = self._settle(status, FORWARD, arguments, out, result, check)
            result = (a, b, c)
        if load is not None:
            result[0][...] += result[2] @ load
        return result

    def hybrid_dynamics_derivatives(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd_joints: ArrayLike,
        joints: Sequence[str] | None = None,
        tau: ArrayLike | None = None,
        wrenches: Wrenches | None = None,
        check: bool = True,
        out: Sequence[Array] | None = None,
        base: Base | None = None,
    ) -> HybridDerivatives:
        """Return the derivatives of :meth:`Robot.hybrid_dynamics`.

        Parameters
        ----------
        q, qd : (n,) or (k, n)
        qdd_joints : (joints,) or (k, joints)
        joints : names, optional
            The prescribed joints; default all.
        tau : (n,) or (k, n), optional
            Generalized forces of the free coordinates; default zero.
        wrenches : {frame: (6,)}, optional
        out : eight arrays, optional
            Take the results, in the order of HybridDerivatives.
        base : (twist, acceleration[, pose]), optional

        Returns
        -------
        HybridDerivatives
            Rows of torques in the order of `joints`, of accelerations in that of the others.

        Raises
        ------
        StateError, SolverError
            As :meth:`forward_dynamics_derivatives`.
        """
        if base is not None:
            return on_base(self, self.hybrid_dynamics_derivatives, locals())
        n = self.n
        names = self.joint_names if joints is None else tuple(joints)
        index = self.indices(names)
        split = self._workspace.split(index)
        q, qd = as_rows('q', q, n), as_rows('qd', qd, n)
        qdd_joints = as_rows('qdd_joints', qdd_joints, len(names))
        force = self._zero if tau is None else as_rows('tau', tau, n)
        if wrenches:
            force = force + self._load(q, wrenches)
        arrays = (q, qd, qdd_joints, force)
        single = all(array.ndim == 1 for array in arrays)
        rows = same_rows(arrays)
        k = len(rows[0])
        given = _hybrid_output(out, () if single else (k,), len(index), n)
        sizes = (k, 4, n), (k, n * (4 * n + 1))
        states, buffer = (
            self._workspace.hybrid() if k == 1 else (np.empty(sizes[0]), np.empty(sizes[1]))
        )
        states[:, 0], states[:, 1], states[:, 2], states[:, 3] = rows[0], rows[1], 0.0, rows[3]
        states[:, 2, index] = rows[2]
        kernel = forward_derivatives.hybrid_dynamics_derivatives_rows
        status = run_rows(self, kernel, k, split.flags, states, buffer)
        self._raise_for_status(status, check, q=q, qd=qd, qdd_joints=qdd_joints, tau=force)
        if wrenches:
            by_q, _, driven, _ = buffer[:, : 4 * n * n].reshape(k, 4, n, n).swapaxes(0, 1)
            load, free = self.load_derivative(rows[0], wrenches), split.free
            by_q += driven[:, :, free] @ load[:, free]
            by_q[:, index] -= load[:, index]
        for part, places in zip(given, split.places, strict=True):
            for row, matrices in enumerate(buffer):
                target = part.reshape(k, -1)[row] if part.size else part.reshape(0)
                # the other modes keep the result in a buffer
                matrices.take(places, out=target, mode='clip')
        return given

    def load_derivative(self, q: ArrayLike, wrenches: Wrenches) -> Array:
        """Return the derivative (n, n) or (k, n, n) by q of the forces that wrenches make."""
        q = as_rows('q', q, self.n)
        out = np.zeros((*q.shape, self.n))
        self._subtract_loads(q, wrenches, out)
        return -out

    def _subtract_loads(self, q: Array, wrenches: Wrenches, out: Array) -> None:
        """Subtract the derivative by q of the loads from out (n, n) or (k, n, n)."""
        count = out.shape[0] if out.ndim == 3 else 1
        rows = np.array(np.broadcast_to(q, (count, self.n)))
        for frame, wrench in wrenches.items():
            loaded = np.array([self._row(frame), *as_vector('wrench', wrench, (6,))])
            flat = out.reshape(count, self.n, self.n)
            kernel = load_derivatives.subtract_load_rows
            self.raise_for_status(run_rows(self, kernel, count, rows, loaded, flat), q=q)


def _three(out: Sequence[Array]) -> Derivatives:
    """Return three result arrays, or raise StateError."""
    if len(out) != 3:
        raise StateError(f'out must be three arrays, got {len(out)}')
    return out[0], out[1], out[2]


def _hybrid_output(
    out: Sequence[Array] | None, rows: tuple[int, ...], h: int, n: int
) -> HybridDerivatives:
    """Return the arrays that take the results, the caller's after a check."""
    f = n - h
    shapes = ((h, n), (h, n), (h, h), (h, f), (f, n), (f, n), (f, h), (f, f))
    return HybridDerivatives(*as_outputs(out, [(*rows, *shape) for shape in shapes]))
