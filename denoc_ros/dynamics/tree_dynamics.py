"""The verbs of the dynamics: inverse, forward, hybrid; loops; inertia, momentum, frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from denoc_ros.dynamics import assembling, structure
from denoc_ros.dynamics import constrained_dynamics as constraints
from denoc_ros.dynamics.base.base_motion import Base, on_base
from denoc_ros.dynamics.robot_model import RobotModel, Split
from denoc_ros.dynamics.state_rows import each_row, run_rows
from denoc_ros.dynamics.validation import (
    as_output,
    as_outputs,
    as_rows,
    as_states,
    as_vector,
    require_finite,
    same_rows,
)
from denoc_ros.errors import StateError
from denoc_ros.kernels.constraints import constrained
from denoc_ros.kernels.dynamics import articulated, composite, inverse, world
from denoc_ros.kernels.jit.compiled import entry, ready
from denoc_ros.kernels.jit.handle import GOOD, MISFIT
from denoc_ros.kernels.springs import sprung
from denoc_ros.model.arrays import ModelArrays
from denoc_ros.types import Array

Wrenches = Mapping[str, ArrayLike]
_empty = np.empty  # a global name is found more quickly than a module's


class KernelOperation:
    """A kernel, the same over rows, and the shapes of its results for n coordinates.

    Attributes
    ----------
    call : callable
        The compiled kernel, which takes types on trust; compiled when first called.
    """

    __slots__ = ('call', 'kernel', 'rows', 'shapes')

    def __init__(
        self,
        kernel: Callable[..., int],
        rows: Callable[..., int],
        shapes: Callable[[int], Sequence[tuple[int, ...]]],
    ) -> None:
        self.kernel, self.rows, self.shapes = kernel, rows, shapes
        self.call: Callable[..., int] = self._first

    def _first(self, *arguments: object) -> int:
        self.call = entry(self.kernel)
        return self.call(*arguments)


INVERSE = KernelOperation(
    inverse.inverse_dynamics, inverse.inverse_dynamics_rows, lambda n: ((n,),)
)
FORWARD = KernelOperation(
    articulated.forward_dynamics, articulated.forward_dynamics_rows, lambda n: ((n,),)
)
# of robots with elastic joints
SPRUNG_INVERSE = KernelOperation(
    sprung.inverse_dynamics, sprung.inverse_dynamics_rows, INVERSE.shapes
)
SPRUNG_FORWARD = KernelOperation(
    sprung.forward_dynamics, sprung.forward_dynamics_rows, FORWARD.shapes
)
INERTIA = KernelOperation(
    composite.inertia_matrix, composite.inertia_matrix_rows, lambda n: ((n, n),)
)
ENERGY = KernelOperation(composite.energies, composite.energies_rows, lambda n: ((2,),))
FRAME_POSE = KernelOperation(world.frame_pose, world.frame_pose_rows, lambda n: ((4, 4),))
FRAME_JACOBIAN = KernelOperation(
    world.frame_jacobian, world.frame_jacobian_rows, lambda n: ((6, n),)
)


class TreeDynamics(RobotModel):
    """Dynamics of the tree, without and with its constraint rows, and poses of its frames.

    Rows are loops in file order, then mimic joints on their leaders in that of their coordinates.
    A loop's rows are the constrained components of the motion of its child's loop frame in its
    parent's, linear first; its multipliers are those of the wrench that the parent exerts on the
    child at the child's frame, in the parent's axes (docs/loops.md).
    """

    def _adopt(self, arrays: ModelArrays) -> None:
        super()._adopt(arrays)
        elastic = arrays.link_side is not None
        self._inverse_operation = SPRUNG_INVERSE if elastic else INVERSE
        self._forward_operation = SPRUNG_FORWARD if elastic else FORWARD
        if elastic:
            ready(sprung.inverse_dynamics, sprung.forward_dynamics)
        self._inverse = entry(self._inverse_operation.kernel)
        self._forward = entry(self._forward_operation.kernel)
        self._inertia = entry(composite.inertia_matrix)
        self._energies = entry(composite.energies)
        self._rows = len(arrays.constraint_names)
        # without rows the kernel is not ready, and not needed
        self._constrained: Callable[..., int] = lambda *_: MISFIT
        if self._rows:
            self._constrained = entry(constrained.constrained_dynamics)

    # dynamics ---------------------------------------------------------------------------------

    def inverse_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        wrenches: Wrenches | None = None,
        out: Array | None = None,
        check: bool = True,
        base: Base | None = None,
    ) -> Array:
        """Return the generalized forces I q'' + h.

        Parameters
        ----------
        q, qd, qdd : (n,) or (k, n)
        wrenches : {frame: (6,)}, optional
            External loads, base axes, linear first, at the frame's origin [N, N m].
        base : (twist, acceleration) or (twist, acceleration, pose), optional
            A base that moves, as :class:`BaseMotion` says: (6,) or a row for each state.

        Returns
        -------
        tau : (n,) or (k, n) [N m, N]

        Raises
        ------
        StateError
            For a wrong shape or type, or a number that is not finite.
        """
        if base is not None:
            return on_base(self, self.inverse_dynamics, locals())
        result = _empty(self.n) if out is None else out
        status = self._inverse(self.handle, q, qd, qdd, result)
        if status != GOOD:
            arguments = {'q': q, 'qd': qd, 'qdd': qdd}
            verb = self._inverse_operation
            (result,) = self._settle(status, verb, arguments, _one(out), [result], check)
        if wrenches:
            result -= self._load(as_rows('q', q, self.n), wrenches)
        return result

    def forward_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        wrenches: Wrenches | None = None,
        out: Array | None = None,
        check: bool = True,
        base: Base | None = None,
    ) -> Array:
        """Return the accelerations (n,) or (k, n) under generalized forces tau, by UDU^T, O(n).

        Parameters and errors as in :meth:`inverse_dynamics`; SolverError where the inertia is
        singular (a massless chain).
        """
        if base is not None:
            return on_base(self, self.forward_dynamics, locals())
        if wrenches:
            tau = as_rows('tau', tau, self.n) + self._load(as_rows('q', q, self.n), wrenches)
        result = _empty(self.n) if out is None else out
        status = self._forward(self.handle, q, qd, tau, result)
        if status != GOOD:
            arguments = {'q': q, 'qd': qd, 'tau': tau}
            verb = self._forward_operation
            (result,) = self._settle(status, verb, arguments, _one(out), [result], check)
        return result

    def hybrid_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd_joints: ArrayLike,
        joints: Sequence[str] | None = None,
        tau: ArrayLike | None = None,
        wrenches: Wrenches | None = None,
        check: bool = True,
        base: Base | None = None,
    ) -> tuple[Array, Array]:
        """Return the torques of joints whose motion is given and the other accelerations.

        Parameters
        ----------
        q, qd : (n,) or (k, n)
        qdd_joints : (joints,) or (k, joints)
            In the order of `joints`.
        joints : names, optional
            The prescribed joints; default all, in the order of `joint_names`.
        tau : (n,) or (k, n), optional
            Generalized forces of the free coordinates; default zero.
        base : (twist, acceleration[, pose]), optional
            As in :meth:`inverse_dynamics`.

        Returns
        -------
        tau_joints : (joints,) or (k, joints) [N m, N]
        qdd_free : (n - joints,) or (k, n - joints), the other coordinates in order
        """
        if base is not None:
            return on_base(self, self.hybrid_dynamics, locals())
        names = self.joint_names if joints is None else tuple(joints)
        split, drive = self._workspace.split(self.indices(names)), ('qdd_joints', qdd_joints)
        torque, qdd, _ = self._hybrid(False, split, q, qd, drive, tau, wrenches, check)
        return torque, qdd.take(split.free, axis=-1)

    def _hybrid(
        self,
        closed: bool,
        split: Split,
        q: ArrayLike,
        qd: ArrayLike,
        drive: tuple[str, ArrayLike],
        tau: ArrayLike | None,
        wrenches: Wrenches | None,
        check: bool = True,
    ) -> tuple[Array, Array, Array]:
        """Return torques of given joints, all accelerations and multipliers, or rows of them.

        closed: whether constraint rows count; drive: the joints' accelerations after their name.
        """
        # of an open tree the results tell whether all is finite
        n, taken = self.n, as_states if closed else as_rows
        index, held = split.index, split.flags
        states = [taken('q', q, n), taken('qd', qd, n), taken(*drive, len(index))]
        force = self._zero
        if tau is not None:
            force = taken('tau', tau, n).copy()
            force[..., index] = 0.0
        if wrenches:
            force = force + self._load(states[0], wrenches)
        single = force.ndim == 1 and all(state.ndim == 1 for state in states)
        q, qd, qdd_joints, force = same_rows([*states, force])
        given = np.zeros(q.shape)
        given[:, index] = qdd_joints
        try:
            torque, *rest = constraints.hybrid(self, closed, held, q, qd, given, force, check)
        except StateError:
            require_finite({'q': q, 'qd': qd, drive[0]: qdd_joints, 'tau': force})
            raise
        found = torque.take(index, axis=1), *rest
        a, b, c = [each[0] for each in found] if single else found
        return a, b, c

    def inertia_matrix(self, q: ArrayLike, out: Array | None = None, check: bool = True) -> Array:
        """Return the generalized inertia matrix (n, n) or (k, n, n), armature included."""
        result = _empty(self._square) if out is None else out
        status = self._inertia(self.handle, q, result)
        if status != GOOD:
            (result,) = self._settle(status, INERTIA, {'q': q}, _one(out), [result], check)
        return result

    def bias_forces(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        out: Array | None = None,
        check: bool = True,
        base: Base | None = None,
    ) -> Array:
        """Return h (n,) or (k, n): velocity, gravity, elastic, damping and friction forces.

        On a base that moves, also what its motion alone asks for.
        """
        return self.inverse_dynamics(q, qd, self._zero, out=out, check=check, base=base)

    def energy(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        out: Array | None = None,
        check: bool = True,
        base: Base | None = None,
    ) -> Array:
        """Return (kinetic, potential) [J], shape (2,) or (k, 2).

        Potential is gravity, with zero at the base origin, plus strain. On a base that moves, the
        kinetic energy is that of the motion in space; with its pose, gravity's is zero at the
        world's origin.
        """
        if base is not None:
            return on_base(self, self.energy, locals())
        result = np.empty(2) if out is None else out
        status = self._energies(self.handle, q, qd, result)
        if status != GOOD:
            arguments = {'q': q, 'qd': qd}
            (result,) = self._settle(status, ENERGY, arguments, _one(out), [result], check)
        if self._base is not None and self._base.pose is not None:
            result[..., 1] -= self.mass * (self.gravity @ self._base.pose[:3, 3])
        return result

    def denoc_matrices(self, q: ArrayLike) -> tuple[Array, Array]:
        """Return the dense decoupled natural orthogonal complement N_l, N_d (section 3.1.4).

        Stacked twists t_i = [v; omega; d'; c'] of the bodies, each in its body frame at its
        origin, are N_l @ N_d @ qd.
        """
        q = as_states('q', q, self.n)
        n_l, n_d = each_row(lambda row: structure.denoc_matrices(self, row), q)
        return n_l, n_d

    # mass and momentum without what is fixed to the base ----------------------------------------

    @property
    def mass(self) -> float:
        """Mass of all bodies and payloads [kg]."""
        return float(self._sums(self._zero, self._zero)[composite.MASS])

    def momentum(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        out: Array | None = None,
        check: bool = True,
        base: Base | None = None,
    ) -> Array:
        """Return linear and angular momentum, base axes, about the base frame's origin.

        A robot whose base floats keeps both where nothing acts from outside: no gravity, no
        forces on the base.

        Parameters
        ----------
        q, qd : (n,) or (k, n)
        out : (6,) or (k, 6), optional
        base : (twist, acceleration[, pose]), optional
            Of a base that moves: the momentum is that of the motion in space, its components
            along the base's axes of that moment.

        Returns
        -------
        (6,) or (k, 6) [kg m/s, kg m^2/s]

        Raises
        ------
        StateError
            For a wrong shape or type, or a number that is not finite.

        Notes
        -----
        Rotors (armature) turn with their joint alone and have no part in it, as they have none in
        the equations of the other coordinates.
        """
        if base is not None:
            return on_base(self, self.momentum, locals())
        sums = self._sums(q, qd, check)
        out = as_output(out, (*sums.shape[:-1], 6))
        out[...] = sums[..., : composite.MASS]
        return out

    def centre_of_mass(self, q: ArrayLike, check: bool = True) -> Array:
        """Return the centre of mass (3,) or (k, 3) of all bodies in the base frame [m]."""
        sums = self._sums(q, self._zero, check)
        return np.asarray(sums[..., composite.FIRST_MOMENT :] / sums[..., composite.MASS, None])

    def _sums(self, q: ArrayLike, qd: ArrayLike, check: bool = True) -> Array:
        """Return momentum, mass and first moment (10,) or (k, 10)."""
        states = [as_rows('q', q, self.n), as_rows('qd', qd, self.n)]
        single = all(state.ndim == 1 for state in states)
        rows = same_rows(states)
        out = np.empty((len(rows[0]), composite.MOMENTUM_SIZE))
        status = run_rows(self, composite.momentum_rows, len(out), *rows, out)
        self._raise_for_status(status, check, q=states[0], qd=states[1])
        return out[0] if single else out

    # loops and mimic joints ---------------------------------------------------------------------

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

    # kinematics -------------------------------------------------------------------------------

    def frame_pose(
        self, frame: str, q: ArrayLike, out: Array | None = None, check: bool = True
    ) -> Array:
        """Return the pose (4, 4) of a link or loop frame in the base frame, deflected."""
        return self._of_frame(FRAME_POSE, frame, q, out, check)

    def pose_of(self, frame: str) -> Callable[[Array, Array], None]:
        """Return a function that writes a frame's pose (4, 4) for coordinates (n,), for loops.

        It looks at neither: both must be contiguous arrays of doubles, and the coordinates finite.
        """
        verb, row = FRAME_POSE.kernel, self._row(frame)

        def write(q: Array, out: Array) -> None:
            verb(self.handle, q, row, out)

        return write

    def frame_jacobian(self, frame: str, q: ArrayLike, out: Array | None = None) -> Array:
        """Return the Jacobian (6, n) of a frame: linear first, base axes, at its origin."""
        return self._of_frame(FRAME_JACOBIAN, frame, q, out)

    def amplitudes(self, link: str) -> slice:
        """Return the indices of a flexible link's amplitudes among the coordinates.

        Of a link of several segments all of them; `link/2` is its second segment alone.
        """
        return structure.amplitudes(self, link)

    def _load(self, q: Array, wrenches: Wrenches) -> Array:
        """Return the generalized forces (n,) or (k, n) of wrenches on frames."""
        if q.ndim == 2:
            return np.array([self._load(row, wrenches) for row in q])
        require_finite({'q': q})
        load, jacobian = np.zeros(self.n), np.empty((6, self.n))
        for frame, wrench in wrenches.items():
            world.frame_jacobian(self.handle, q, self._row(frame), jacobian)
            load += jacobian.T @ as_vector('wrench', wrench, (6,))
        return load

    def _of_frame(
        self,
        verb: KernelOperation,
        frame: str,
        q: ArrayLike,
        out: Array | None,
        check: bool = True,
    ) -> Array:
        """Return a pose or Jacobian of a frame, at one state or many."""
        row, (shape,) = self._row(frame), verb.shapes(self.n)
        q = as_states('q', q, self.n) if check else as_rows('q', q, self.n)
        if q.ndim == 1:
            out = as_output(out, shape)
            verb.call(self.handle, q, row, out)
        else:
            out = as_output(out, (len(q), *shape))
            run_rows(self, verb.rows, len(q), q, np.array([float(row)]), out)
        return out

    def _settle(
        self,
        status: int,
        verb: KernelOperation,
        arguments: dict[str, ArrayLike],
        out: Sequence[Array] | None,
        results: Sequence[Array],
        check: bool,
    ) -> Sequence[Array]:
        """Return a verb's results on the slow path: batches, conversions, errors.

        Rows, lists and wrong arguments come here, and results that are not finite.
        """
        shapes = verb.shapes(self.n)
        arrays = {name: as_rows(name, value, self.n) for name, value in arguments.items()}
        single = all(array.ndim == 1 for array in arrays.values())
        if status == MISFIT and single:
            results = as_outputs(out, shapes)
            status = verb.call(self.handle, *arrays.values(), *results)
        if status == MISFIT:
            rows = same_rows(list(arrays.values()))
            k = len(rows[0])
            results = as_outputs(out, [shape if single else (k, *shape) for shape in shapes])
            flat = [each[None] for each in results] if single else results
            status = run_rows(self, verb.rows, k, *rows, *flat)
        self._raise_for_status(status, check, **arrays)
        return results


def _one(out: Array | None) -> list[Array] | None:
    """Return the caller's output array as one of several."""
    return None if out is None else [out]
