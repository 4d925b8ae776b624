"""Derivatives of the dynamics by coordinates, rates and inputs; docs/derivatives.md."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import prod
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from denoc_ros.dynamics.base.base_motion import Base, on_base
from denoc_ros.dynamics.constrained_dynamics import raise_status
from denoc_ros.dynamics.state_rows import run_chunks, run_rows
from denoc_ros.dynamics.tree_dynamics import KernelOperation, TreeDynamics, Wrenches
from denoc_ros.dynamics.validation import as_outputs, as_rows, as_vector, require_finite, same_rows
from denoc_ros.errors import StateError
from denoc_ros.kernels.constraints.constrained_derivatives import constrained_derivatives_rows
from denoc_ros.kernels.derivatives import (
    forward_derivatives,
    inverse_derivatives,
    load_derivatives,
)
from denoc_ros.kernels.jit.compiled import entry
from denoc_ros.kernels.jit.handle import GOOD
from denoc_ros.kernels.layout import constrained_derivative_layout as cdiff_
from denoc_ros.types import Array

Int = NDArray[np.int64]
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


class DifferentiableModel(TreeDynamics):
    """Derivatives of torques, accelerations and multipliers by the state.

    Derivatives are matrices, a row per force or acceleration, a column per coordinate. With loops
    they hold for changes of state that keep the loops closed; what rows say twice leaves the
    multipliers of least norm, all along. Kernels compile when first asked for.
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
            target = part.reshape(k, len(places))
            # the other modes keep the result in a buffer
            buffer.take(places, axis=1, out=target, mode='clip')
        return given

    def constrained_forward_dynamics_derivatives(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        out: Sequence[Array] | None = None,
        wrenches: Wrenches | None = None,
        base: Base | None = None,
    ) -> ConstrainedForwardDerivatives:
        """Return the derivatives of :meth:`Robot.constrained_forward_dynamics`.

        Parameters
        ----------
        q, qd, tau : (n,) or (k, n)
            A closed state and the generalized forces.
        out : six arrays, optional
            Take the results, in the order of ConstrainedForwardDerivatives.
        wrenches : {frame: (6,)}, optional
            External loads, base axes, linear first, at the frame's origin [N, N m]; they keep
            their direction as the frame moves.
        base : (twist, acceleration[, pose]), optional
            A base that moves, as of :meth:`Robot.inverse_dynamics`; its motion stays as it is.

        Raises
        ------
        StateError
            For a wrong shape or type, or a number that is not finite.
        SolverError
            A singular configuration in which no accelerations keep the loops closed.
        """
        if base is not None:
            return on_base(self, self.constrained_forward_dynamics_derivatives, locals())
        n = self.n
        states = [as_rows('q', q, n), as_rows('qd', qd, n), as_rows('tau', tau, n)]
        call = _Call(cdiff_.FORWARD, np.zeros(0, dtype=np.int64), wrenches, ('q', 'qd', 'tau'))
        return ConstrainedForwardDerivatives(*_find(self, call, states, out))

    def constrained_inverse_dynamics_derivatives(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        actuated: Sequence[str] | None = None,
        out: Sequence[Array] | None = None,
        wrenches: Wrenches | None = None,
        base: Base | None = None,
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
        wrenches : {frame: (6,)}, optional
        base : (twist, acceleration[, pose]), optional

        Returns
        -------
        ConstrainedInverseDerivatives
            Rows of torques in the order of `actuated`.

        Raises
        ------
        StateError
            The accelerations open a loop, or are none that these joints can give.
        """
        if base is not None:
            return on_base(self, self.constrained_inverse_dynamics_derivatives, locals())
        n = self.n
        states = [as_rows('q', q, n), as_rows('qd', qd, n), as_rows('qdd', qdd, n)]
        call = _Call(cdiff_.INVERSE, self._actuated(actuated), wrenches, ('q', 'qd', 'qdd'))
        return ConstrainedInverseDerivatives(*_find(self, call, states, out))

    def constrained_hybrid_dynamics_derivatives(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd_actuated: ArrayLike,
        actuated: Sequence[str] | None = None,
        tau: ArrayLike | None = None,
        out: Sequence[Array] | None = None,
        wrenches: Wrenches | None = None,
        base: Base | None = None,
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
        wrenches : {frame: (6,)}, optional
        base : (twist, acceleration[, pose]), optional

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
        if base is not None:
            return on_base(self, self.constrained_hybrid_dynamics_derivatives, locals())
        n, index = self.n, self._actuated(actuated)
        states = [as_rows('q', q, n), as_rows('qd', qd, n)]
        states.append(as_rows('qdd_actuated', qdd_actuated, len(index)))
        states.append(self._zero if tau is None else as_rows('tau', tau, n))
        call = _Call(cdiff_.HYBRID, index, wrenches, ('q', 'qd', 'qdd_actuated', 'tau'))
        return ConstrainedHybridDerivatives(*_find(self, call, states, out))

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


class _Call(NamedTuple):
    """Which derivatives are asked for."""

    verb: int  # as the kernel counts them
    actuated: Int
    wrenches: Wrenches | None
    names: tuple[str, ...]  # of its states


class _Plan(NamedTuple):
    """Shapes of the results at one state, how many numbers precede each, and all of them."""

    shapes: tuple[tuple[int, ...], ...]
    before: Int
    total: int


@lru_cache(maxsize=64)
def _plan(verb: int, a: int, n: int, rows: int) -> _Plan:
    """Shapes of the derivatives of a verb with a actuated joints."""
    columns = (n, n, a, n) if verb == cdiff_.HYBRID else (n, n, n)
    lengths = {cdiff_.FORWARD: (n, rows), cdiff_.INVERSE: (a, rows), cdiff_.HYBRID: (a, n, rows)}[
        verb
    ]
    shapes = tuple((length, count) for length in lengths for count in columns)
    edges = np.cumsum([0, *(length * count for length, count in shapes)])
    return _Plan(shapes, edges[:-1].astype(np.int64), int(edges[-1]))


def _results(
    plan: _Plan, rows: tuple[int, ...], out: Sequence[Array] | None
) -> tuple[list[Array], Int]:
    """Return the results' arrays (*rows, *shape) and their addresses; all are one if not given."""
    shapes = [(*rows, *shape) for shape in plan.shapes]
    if out is not None:
        found = as_outputs(out, shapes)
        return found, np.array([each.ctypes.data for each in found], dtype=np.int64)
    k = rows[0] if rows else 1
    whole, before = np.empty(k * plan.total), k * plan.before
    found = [
        whole[start : start + prod(shape)].reshape(shape)
        for start, shape in zip(before.tolist(), shapes, strict=True)
    ]
    return found, whole.ctypes.data + whole.itemsize * before


def _find(
    robot: DifferentiableModel,
    call: _Call,
    states: Sequence[Array],
    out: Sequence[Array] | None,
) -> Sequence[Array]:
    """Return the derivatives at states q, q', third and perhaps tau, in `out` where given."""
    single = all(state.ndim == 1 for state in states)
    rows = [state[None] for state in states] if single else same_rows(states)
    k, n = len(rows[0]), robot.n
    plan = _plan(call.verb, len(call.actuated), n, len(robot.constraint_names))
    found, targets = _results(plan, () if single else (k,), out)
    if not robot.constraint_names:
        return _of_tree(robot, call, states, found)
    if call.verb != cdiff_.HYBRID:
        rows.append(robot._zero[None] if k == 1 else np.zeros((k, n)))
    choice = np.array([call.verb, *call.actuated], dtype=np.int64)
    kernel, loads = entry(constrained_derivatives_rows), _loads(robot, call.wrenches)

    def run(handle: int, first: int, last: int) -> int:
        return kernel(handle, choice, *rows, loads, first, last, targets)

    if run_chunks(robot, k, run) != GOOD:
        require_finite(dict(zip(call.names, states, strict=True)))
        for i in range(k):  # the first state that has no answer says why
            raise_status(robot, run(robot.handle, i, i + 1))
    return found


def _loads(robot: DifferentiableModel, wrenches: Wrenches | None) -> Array:
    """Return wrenches as the kernel takes them, (wrenches, 7)."""
    loads = np.zeros((len(wrenches or {}), 7))
    for row, (frame, wrench) in zip(loads, (wrenches or {}).items(), strict=True):
        row[0], row[1:] = robot._row(frame), as_vector('wrench', wrench, (6,))
    return loads


def _of_tree(
    robot: DifferentiableModel, call: _Call, states: Sequence[Array], found: Sequence[Array]
) -> Sequence[Array]:
    """Write the derivatives of a robot without constraints, which are those of its tree."""
    (q, qd, third), loads, index = states[:3], call.wrenches, call.actuated
    names = [robot.coordinate_names[k] for k in index]
    if call.verb == cdiff_.FORWARD:
        robot.forward_dynamics_derivatives(q, qd, third, loads, out=found[:3])
        return found
    if call.verb == cdiff_.INVERSE:
        robot.constrained_inverse_dynamics(q, qd, third, names, wrenches=loads)
        whole = robot.inverse_dynamics_derivatives(q, qd, third, loads)
        for target, each in zip(found, whole, strict=False):
            target[...] = each[..., index, :]
        return found
    free = np.setdiff1d(np.arange(robot.n), index)
    made = robot.hybrid_dynamics_derivatives(q, qd, third, names, tau=states[3], wrenches=loads)
    for target in found:
        target[...] = 0.0
    torques, motion = found[:4], found[4:8]
    for target, each in zip(torques[:3], made[:3], strict=True):
        target[...] = each
    torques[3][..., free] = made.dtau_dtau
    for target, each in zip(motion[:3], made[4:7], strict=True):
        target[..., free, :] = each
    motion[2][..., index, np.arange(len(index))] = 1.0
    motion[3][..., free[:, None], free] = made.inverse_inertia
    return found
