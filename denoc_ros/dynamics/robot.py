"""A robot and the verbs of its dynamics: one immutable model, one workspace."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from denoc_ros.dynamics import equilibrium, linearization, structure
from denoc_ros.dynamics.batch import each_row, run_rows
from denoc_ros.dynamics.constrained_derivatives import DifferentiableMechanism
from denoc_ros.dynamics.constrained_model import ConstrainedModel
from denoc_ros.dynamics.kinematic_derivatives import KinematicDerivatives
from denoc_ros.dynamics.linearize import Linearizable
from denoc_ros.dynamics.regressor import TorqueRegressor
from denoc_ros.dynamics.robot_model import Source
from denoc_ros.dynamics.validation import as_output, as_rows, as_states, same_rows
from denoc_ros.kernels import articulated, composite, inverse, world
from denoc_ros.kernels.compiled import entry
from denoc_ros.kernels.handle import GOOD, MISFIT
from denoc_ros.model.tree import Tree
from denoc_ros.model.urdf import load_tree

Array = NDArray[np.float64]
Wrenches = Mapping[str, ArrayLike]


_empty = np.empty  # a global name is found more quickly than a module's


class KernelOperation(NamedTuple):
    """A kernel, the same over rows, and the shape of its result for n coordinates."""

    kernel: Callable[..., int]
    rows: Callable[..., int]
    shape: Callable[[int], tuple[int, ...]]


INVERSE = KernelOperation(inverse.inverse_dynamics, inverse.inverse_dynamics_rows, lambda n: (n,))
FORWARD = KernelOperation(
    articulated.forward_dynamics, articulated.forward_dynamics_rows, lambda n: (n,)
)
INERTIA = KernelOperation(
    composite.inertia_matrix, composite.inertia_matrix_rows, lambda n: (n, n)
)
ENERGY = KernelOperation(composite.energies, composite.energies_rows, lambda n: (2,))
FRAME_POSE = KernelOperation(world.frame_pose, world.frame_pose_rows, lambda n: (4, 4))
FRAME_JACOBIAN = KernelOperation(world.frame_jacobian, world.frame_jacobian_rows, lambda n: (6, n))


class Robot(
    DifferentiableMechanism,
    KinematicDerivatives,
    TorqueRegressor,
    Linearizable,
    ConstrainedModel,
):
    """A robot with rigid and flexible links (see :func:`load_robot`).

    States are vectors (n,) in the order of `coordinate_names`; every verb also takes rows (k, n)
    and then returns (k, …), rows in parallel. `out=` takes the result where no allocation is
    wanted, `check=False` skips the test that arguments are finite. A robot holds one workspace and
    so is not to be used by two threads at once: give each its own :meth:`copy`.

    Loops and mimic joints: :class:`ConstrainedModel`. Derivatives of the dynamics:
    :class:`DifferentiableModel`, with loops :class:`DifferentiableMechanism`; of kinematics:
    :class:`KinematicDerivatives`; by parameters: :class:`TorqueRegressor`. Linear models:
    :class:`Linearizable`. Attributes as in :class:`RobotModel`.
    """

    def __init__(
        self,
        tree: Tree,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        geometric_stiffness: bool = True,
    ) -> None:
        super().__init__(tree, gravity, geometric_stiffness)
        self._inverse = entry(inverse.inverse_dynamics)
        self._forward = entry(articulated.forward_dynamics)
        self._inertia = entry(composite.inertia_matrix)
        self._energies = entry(composite.energies)

    # dynamics ---------------------------------------------------------------------------------

    def inverse_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        wrenches: Wrenches | None = None,
        out: Array | None = None,
        check: bool = True,
    ) -> Array:
        """Return the generalized forces I q'' + h.

        Parameters
        ----------
        q, qd, qdd : (n,) or (k, n)
        wrenches : {frame: (6,)}, optional
            External loads, base axes, linear first, at the frame's origin [N, N m].

        Returns
        -------
        tau : (n,) or (k, n) [N m, N]

        Raises
        ------
        StateError
            For a wrong shape or type, or a number that is not finite.
        """
        result = _empty(self.n) if out is None else out
        status = self._inverse(self.handle, q, qd, qdd, result)
        if status != GOOD:
            arguments = {'q': q, 'qd': qd, 'qdd': qdd}
            result = self._settle(status, INVERSE, arguments, out, result, check)
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
    ) -> Array:
        """Return the accelerations (n,) or (k, n) under generalized forces tau, by UDU^T, O(n).

        Parameters and errors as in :meth:`inverse_dynamics`; SolverError where the inertia is
        singular (a massless chain).
        """
        if wrenches:
            tau = as_rows('tau', tau, self.n) + self._load(as_rows('q', q, self.n), wrenches)
        result = _empty(self.n) if out is None else out
        status = self._forward(self.handle, q, qd, tau, result)
        if status != GOOD:
            arguments = {'q': q, 'qd': qd, 'tau': tau}
            result = self._settle(status, FORWARD, arguments, out, result, check)
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

        Returns
        -------
        tau_joints : (joints,) or (k, joints) [N m, N]
        qdd_free : (n - joints,) or (k, n - joints), the other coordinates in order
        """
        names = self.joint_names if joints is None else tuple(joints)
        index = self.indices(names)
        n = self.n
        q, qd = as_rows('q', q, n), as_rows('qd', qd, n)
        qdd_joints = as_rows('qdd_joints', qdd_joints, len(names))
        force = self._zero if tau is None else as_rows('tau', tau, n)
        if wrenches:
            force = force + self._load(q, wrenches)
        single = q.ndim == qd.ndim == qdd_joints.ndim == force.ndim == 1
        arrays = (q, qd, qdd_joints, force)
        q, qd, qdd_joints, force = same_rows([a[None] for a in arrays] if single else arrays)
        given = np.zeros(q.shape)
        given[:, index] = qdd_joints
        qdd, torque = np.empty(q.shape), np.empty(q.shape)
        rows = (self.held(index), q, qd, given, force)
        status = run_rows(self, articulated.articulated_dynamics_rows, len(q), rows, (qdd, torque))
        self._raise_for_status(status, check, q=q, qd=qd, qdd_joints=qdd_joints, tau=force)
        free = np.setdiff1d(np.arange(n), index)
        torque, qdd = np.ascontiguousarray(torque[:, index]), np.ascontiguousarray(qdd[:, free])
        return (torque[0], qdd[0]) if single else (torque, qdd)

    def inertia_matrix(self, q: ArrayLike, out: Array | None = None, check: bool = True) -> Array:
        """Return the generalized inertia matrix (n, n) or (k, n, n), armature included."""
        result = _empty((self.n, self.n)) if out is None else out
        status = self._inertia(self.handle, q, result)
        if status != GOOD:
            result = self._settle(status, INERTIA, {'q': q}, out, result, check)
        return result

    def bias_forces(
        self, q: ArrayLike, qd: ArrayLike, out: Array | None = None, check: bool = True
    ) -> Array:
        """Return h (n,) or (k, n): velocity, gravity, elastic, damping and friction forces."""
        return self.inverse_dynamics(q, qd, self._zero, out=out, check=check)

    def energy(
        self, q: ArrayLike, qd: ArrayLike, out: Array | None = None, check: bool = True
    ) -> Array:
        """Return (kinetic, potential) [J], shape (2,) or (k, 2).

        Potential is gravity, with zero at the base origin, plus strain.
        """
        result = np.empty(2) if out is None else out
        status = self._energies(self.handle, q, qd, result)
        if status != GOOD:
            result = self._settle(status, ENERGY, {'q': q, 'qd': qd}, out, result, check)
        return result

    def denoc_matrices(self, q: ArrayLike) -> tuple[Array, Array]:
        """Return the dense decoupled natural orthogonal complement N_l, N_d (section 3.1.4).

        Stacked twists t_i = [v; omega; d'; c'] of the bodies, each in its body frame at its
        origin, are N_l @ N_d @ qd.
        """
        q = as_states('q', q, self.n)
        n_l, n_d = each_row(lambda row: structure.denoc_matrices(self, row), q)
        return n_l, n_d

    # kinematics -------------------------------------------------------------------------------

    def frame_pose(self, frame: str, q: ArrayLike, out: Array | None = None) -> Array:
        """Return the pose (4, 4) of a link or loop frame in the base frame, deflected."""
        return self._of_frame(FRAME_POSE, frame, q, out)

    def frame_jacobian(self, frame: str, q: ArrayLike, out: Array | None = None) -> Array:
        """Return the Jacobian (6, n) of a frame: linear first, base axes, at its origin."""
        return self._of_frame(FRAME_JACOBIAN, frame, q, out)

    def tip_deflection(self, link: str, q: ArrayLike, station: float | None = None) -> Array:
        """Return the deflection (3,) [m] of a link's beam in the beam frame; default the tip."""
        section, amplitudes = self.section(link, station)
        q = as_states('q', q, self.n)
        return section.deflection(q[..., amplitudes])[..., :3]

    def sensor_values(
        self, q: ArrayLike, qd: ArrayLike | None = None, qdd: ArrayLike | None = None
    ) -> Array:
        """Return the predicted values of the sensors, in file order (each in its own unit).

        All types read the shape of a beam, so rates and accelerations do not matter to them.
        """
        q = as_states('q', q, self.n)
        values = np.empty((*q.shape[:-1], len(self.tree.sensors)))
        for k, sensor in enumerate(self.tree.sensors):
            values[..., k] = q[..., self.amplitudes(sensor.link)] @ sensor.row
        return values

    def amplitudes(self, link: str) -> slice:
        """Return where the amplitudes of a flexible link stand among the coordinates."""
        return structure.amplitudes(self, link)

    # statics and vibration --------------------------------------------------------------------

    def static_deflection(
        self, q_joints: ArrayLike, wrenches: Wrenches | None = None, start: ArrayLike | None = None
    ) -> Array:
        """Return the state (n,) whose amplitudes are in equilibrium at given joint positions.

        Parameters
        ----------
        q_joints : (joints,)
        wrenches : {frame: (6,)}, optional
        start : (n,), optional
            First guess of the amplitudes (its joints are not used); default undeformed.

        Raises
        ------
        SolverError
            Newton's iteration found no equilibrium (a load beyond buckling).
        """
        joints = as_states('q_joints', q_joints, len(self.joint_indices))
        states: Array = each_row(
            lambda row: equilibrium.static_deflection(self, row, wrenches, start), joints
        )
        return states

    def natural_frequencies(self, q: ArrayLike, held: bool = True) -> Array:
        """Return the natural frequencies [Hz] at rest at q, ascending (see natural_modes)."""
        return self.natural_modes(q, held).frequencies

    def natural_modes(self, q: ArrayLike, held: bool = True) -> linearization.NaturalModes:
        """Return frequencies [Hz], shapes (n, k) and damping ratios at rest at q.

        Gravity and load stiffness are as they are at q. `held` joints stay still; else all n
        coordinates move: rigid motions have frequency 0 and unstable ones a negative one.
        """
        q = as_states('q', q, self.n)
        modes = each_row(lambda row: tuple(linearization.natural_modes(self, row, held)), q)
        return linearization.NaturalModes(*modes)

    def _of_frame(
        self, verb: KernelOperation, frame: str, q: ArrayLike, out: Array | None
    ) -> Array:
        """Return a pose or Jacobian of a frame, at one state or many."""
        row, shape = self._row(frame), verb.shape(self.n)
        q = as_states('q', q, self.n)
        if q.ndim == 1:
            out = as_output(out, shape)
            verb.kernel(self.handle, q, row, out)
        else:
            out = as_output(out, (len(q), *shape))
            run_rows(self, verb.rows, len(q), (q, row), (out,))
        return out

    def _settle(
        self,
        status: int,
        verb: KernelOperation,
        arguments: dict[str, ArrayLike],
        out: Array | None,
        result: Array,
        check: bool,
    ) -> Array:
        """Return the result of a verb that the kernel did not give at the first try.

        Rows, lists and wrong arguments come here, and results that are not finite.
        """
        shape = verb.shape(self.n)
        arrays = {name: as_rows(name, value, self.n) for name, value in arguments.items()}
        single = all(array.ndim == 1 for array in arrays.values())
        if status == MISFIT and single:
            result = as_output(out, shape)
            status = entry(verb.kernel)(self.handle, *arrays.values(), result)
        if status == MISFIT:
            rows = same_rows(list(arrays.values()))
            k = len(rows[0])
            result = as_output(out, shape if single else (k, *shape))
            status = run_rows(self, verb.rows, k, rows, (result.reshape(k, *shape),))
        self._raise_for_status(status, check, **arrays)
        return result


def load_robot(
    source: Source,
    gravity: ArrayLike = (0.0, 0.0, -9.81),
    geometric_stiffness: bool = True,
) -> Robot:
    """Load a robot from a URDF with an optional `<flexibility>` block.

    Parameters
    ----------
    source : path, or the XML text itself
    gravity : (3,) [m/s^2], base frame
    geometric_stiffness : bool
        False drops the foreshortening of bent beams (the book's slow-motion model).

    Raises
    ------
    ModelError
        With every finding of the file.
    """
    return Robot(load_tree(source), gravity, geometric_stiffness)
