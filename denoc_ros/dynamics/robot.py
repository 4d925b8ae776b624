"""A robot and all verbs of its dynamics: one immutable model, one workspace."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics import equilibrium
from denoc_ros.dynamics.base.base_motion import Base, on_base
from denoc_ros.dynamics.base.floating_base import ATTITUDE, wrap_attitude
from denoc_ros.dynamics.linear import natural_modes as modes
from denoc_ros.dynamics.linear.linear_model import LinearModel
from denoc_ros.dynamics.linear.linearize import linearize as linear_model_about
from denoc_ros.dynamics.parameter_columns import DIAGONAL_TERMS, Column, find_columns, massless
from denoc_ros.dynamics.rotations import left_jacobians, rotation_vectors, rotations
from denoc_ros.dynamics.sensor_values import SensorValues
from denoc_ros.dynamics.state_rows import each_row
from denoc_ros.dynamics.tree_dynamics import TreeDynamics, Wrenches
from denoc_ros.dynamics.validation import as_output, as_states, as_vector, same_rows
from denoc_ros.errors import StateError
from denoc_ros.model.joint_friction import slip
from denoc_ros.model.reading.poses import pose_of
from denoc_ros.model.reading.urdf import load_tree
from denoc_ros.types import Array


def _write(
    robot: TreeDynamics, columns: Iterable[Column], rows: Sequence[Array], out: Array
) -> None:
    """Write columns (k, n, parameters) at states (k, n)."""
    q, qd, qdd = rows
    factors = dict(zip(DIAGONAL_TERMS, (q, qd, slip(qd), qdd), strict=True))
    bare: TreeDynamics | None = None
    for index, column in enumerate(columns):
        if column.term in factors:
            np.multiply(factors[column.term], column.values, out=out[:, :, index])
            continue
        if bare is None:
            bare = massless(robot)
        constants = bare.constants[column.constants]
        bare.constants[column.constants] = column.values
        out[:, :, index] = bare.inverse_dynamics(q, qd, qdd)
        bare.constants[column.constants] = constants


class Robot(SensorValues):
    """A robot with rigid and flexible links (see :func:`load_robot`).

    States are vectors (n,) in the order of `coordinate_names`; every verb also takes rows (k, n)
    and then returns (k, …), rows in parallel. `out=` takes the result where no allocation is
    wanted, `check=False` skips the test that arguments are finite. A robot holds one workspace and
    so is not to be used by two threads at once: give each its own :meth:`copy`.

    Attributes as in :class:`RobotModel`. Dynamics: :class:`TreeDynamics`, and its derivatives:
    :class:`DifferentiableModel`. Frames, deflections, sensors: :class:`SensorValues`.

    A base on a floating joint has the coordinates `base_indices`: position of the link's frame [m]
    and rotation vector of its attitude [rad], in the joint's frame; nothing drives them. The verbs
    of the base raise StateError where it is fixed.
    """

    def static_deflection(
        self,
        q_joints: ArrayLike,
        wrenches: Wrenches | None = None,
        start: ArrayLike | None = None,
        base: Base | None = None,
    ) -> Array:
        """Return the state (n,) whose amplitudes are in equilibrium at given joint positions.

        Parameters
        ----------
        q_joints : (joints,)
        wrenches : {frame: (6,)}, optional
        start : (n,), optional
            First guess of the amplitudes (its joints are not used), and where a floating base is
            held; default undeformed and zero.
        base : (twist, acceleration[, pose]), optional
            A base that moves steadily: the amplitudes stand still on it.

        Raises
        ------
        SolverError
            Newton's iteration found no equilibrium (a load beyond buckling).
        """
        if base is not None:
            return on_base(self, self.static_deflection, locals())
        joints = as_states('q_joints', q_joints, len(self.joint_indices))
        states: Array = each_row(
            lambda row: equilibrium.static_deflection(self, row, wrenches, start),
            joints,
        )
        return states

    def natural_frequencies(self, q: ArrayLike, held: bool = True) -> Array:
        """Return the natural frequencies [Hz] at rest at q, ascending (see natural_modes)."""
        return self.natural_modes(q, held).frequencies

    def natural_modes(self, q: ArrayLike, held: bool = True) -> modes.NaturalModes:
        """Return frequencies [Hz], shapes (n, k) and damping ratios at rest at q.

        Gravity and load stiffness are as they are at q. `held` joints stay still, a floating
        base moves; else all n coordinates move. Rigid motions have frequency 0 and unstable ones a
        negative one. A robot whose base floats falls freely: gravity does nothing to its modes.
        """
        if len(self.base_indices) and self.base_motion is None:
            falling = np.append(self.gravity, np.zeros(3))
            given = {'q': q, 'held': held, 'base': (np.zeros(6), falling)}
            return on_base(self, self.natural_modes, given)
        q = as_states('q', q, self.n)
        found = each_row(lambda row: tuple(modes.natural_modes(self, row, held)), q)
        return modes.NaturalModes(*found)

    def torque_regressor(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        paths: Sequence[str],
        out: Array | None = None,
        base: Base | None = None,
    ) -> Array:
        """Return the derivatives of the generalized forces by parameters: exact, for any values.

        Parameters
        ----------
        q, qd, qdd : (n,) or (k, n)
        paths : sequence of str
            Dotted paths as overrides have them, and more (docs/linear_models.md):
            `beam.<link>.<y|z>.<ei|damping|damping_ratio>` and
            `beam.<link>.torsion.<gj|polar_inertia|damping|damping_ratio>`, of a mode alone with
            its number behind (`beam.arm.y.damping.2`); `beam.<link>.mass_per_length`, the rigid
            rest of the link held; `joint.<name>.<damping|friction|armature>` and `damping.*`;
            `payload.<link>.<mass|inertia.ixx|...>` about its centre of mass, which is held;
            `link.<link>.<mass|first_moment.x|...|inertia.ixx|...>` about the link frame's
            origin: the ten of a rigid body.
        out : (n, parameters) or (k, n, parameters), optional
        base : (twist, acceleration[, pose]), optional
            A base that moves, as of :meth:`Robot.inverse_dynamics`.

        Returns
        -------
        (n, parameters) or (k, n, parameters)
            Columns in the order of `paths`. For parameters p that are not of one number twice,
            tau(p) = regressor @ p + rest with a rest that does not depend on p.

        Raises
        ------
        ConfigError
            With every path that the robot does not have, or in which its forces are not linear.
        StateError
            For a wrong shape or type, or a number that is not finite.

        Notes
        -----
        Damping enters by its coefficients [N s/m, N m s/rad]: a damping ratio is one worked out
        as the model is loaded, and the columns of stiffness and mass hold it.
        """
        if base is not None:
            return on_base(self, self.torque_regressor, locals())
        given = zip(('q', 'qd', 'qdd'), (q, qd, qdd), strict=True)
        states = [as_states(name, value, self.n) for name, value in given]
        columns = find_columns(self, paths)
        single = all(state.ndim == 1 for state in states)
        rows = same_rows(states)
        k = len(rows[0])
        shape = (self.n, len(columns))
        result = as_output(out, shape if single else (k, *shape))
        _write(self, columns, rows, result.reshape(k, *shape))
        return result

    def linearize(
        self,
        q: ArrayLike,
        qd: ArrayLike | None = None,
        tau: ArrayLike | None = None,
        inputs: Sequence[str] | None = None,
        outputs: Sequence[str] = ('joints', 'sensors'),
        locked: Sequence[str] = (),
        friction: bool = True,
    ) -> LinearModel:
        """Return the linear model about a state: an equilibrium, or an instant of a motion.

        Parameters
        ----------
        q : (n,)
            Closed, where there are loops and mimic joints.
        qd : (n,), optional
            Default zero.
        tau : (n,), optional
            Generalized forces that act at that state. Default those of the joints that hold
            them: their accelerations are then zero, and where the amplitudes are not in
            equilibrium theirs are what `qdd` of the model says.
        inputs : names, optional
            A joint or any other coordinate (a generalized force along it), or `wrench:<frame>`
            (six: force and moment, base axes, at its origin). Default the joints, without those
            that mimic.
        outputs : names
            `joints`, `rates` (of the joints), `states`, `sensors`, a coordinate, a sensor,
            `deflection:<link>` (ux, uy, uz), `pose:<frame>` (position and small rotation, base
            axes), `velocity:<frame>`, `acceleration:<frame>`.
        locked : names of joints
            They do not move, whatever acts.
        friction : bool
            False leaves out the slope of Coulomb friction, which at rest is that of a damper of
            friction / 1e-3 rad/s: as for joints that are moving.

        Returns
        -------
        LinearModel
            Of x = [y; y'], y the coordinates that are left independent by locked joints, loops
            and mimic joints, in their order.

        Raises
        ------
        StateError
            For a wrong shape, unknown names, or a state that opens a loop.

        Notes
        -----
        Z^T (I dq'' + d(tau)/dq dq + d(tau)/dq' dq' - d(J^T lambda)/dq dq) = Z^T dtau with the
        null space Z of the closure Jacobian, dq = Z y, and dq', dq'' as the rows of the loops
        then say (docs/linear_models.md).
        """
        return linear_model_about(self, q, qd, tau, inputs, outputs, locked, friction)

    def wrap_base(self, q: ArrayLike, qd: ArrayLike) -> tuple[Array, Array]:
        """Return the same states (n,) or (k, n) with rotation vectors within pi of zero.

        Between |phi| = pi and 2 pi the equations hold as well, at 2 pi rates become singular:
        `dn.simulate` and the nodes bring states back in time, and so must a loop of your own.
        """
        states = [as_states('q', q, self.n).copy(), as_states('qd', qd, self.n).copy()]
        self._require_base()
        single = all(state.ndim == 1 for state in states)
        positions, rates = same_rows(states)
        index = self.base_indices[ATTITUDE]
        for row, rate in zip(positions, rates, strict=True):
            row[index], rate[index] = wrap_attitude(row[index], rate[index])
        return (positions[0], rates[0]) if single else (positions, rates)

    def base_coordinates(
        self, pose: ArrayLike, twist: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return coordinates and rates (6,) of the base at a pose and a twist.

        Parameters
        ----------
        pose : (4, 4)
            Of the base link in the URDF's root frame, as `frame_pose` gives it.
        twist : (6,), optional
            Velocity of its origin and angular velocity in the root frame's axes, as
            `frame_motion` gives them; default zero.

        Returns
        -------
        q, qd : (6,)
            What stands at `base_indices` of a state.
        """
        placement = self._require_base()
        wanted = as_vector('pose', pose, (4, 4))
        motion = np.zeros(6) if twist is None else as_vector('twist', twist, (6,))
        turn = placement[:3, :3]
        phi = rotation_vectors(turn.T @ wanted[:3, :3])
        rate = np.linalg.solve(left_jacobians(phi), turn.T @ motion[3:])
        position = turn.T @ (wanted[:3, 3] - placement[:3, 3])
        return np.append(position, phi), np.append(turn.T @ motion[:3], rate)

    def base_odometry(self, q: ArrayLike, qd: ArrayLike) -> tuple[Array, Array]:
        """Return pose (4, 4) and twist (6,) of the base, as an Odometry message has them.

        Parameters
        ----------
        q, qd : (n,)

        Returns
        -------
        pose : (4, 4)
            Of the base link in the URDF's root frame.
        twist : (6,) [m/s, rad/s]
            Velocity of its origin and angular velocity, along its own axes.
        """
        placement = self._require_base()
        state, rate = as_vector('q', q, (self.n,)), as_vector('qd', qd, (self.n,))
        index = self.base_indices
        phi, turning = state[index[ATTITUDE]], rate[index[ATTITUDE]]
        turn = rotations(phi)
        pose = placement @ pose_of(state[index[:3]], turn)
        return pose, np.append(rate[index[:3]] @ turn, left_jacobians(phi) @ turning @ turn)

    def base_wrench(self, q: ArrayLike, tau: ArrayLike) -> Array:
        """Return the wrench (6,) on the base link that equals generalized forces (n,).

        Parameters
        ----------
        q, tau : (n,)
            As `inverse_dynamics` takes and gives them.

        Returns
        -------
        (6,) [N, N m]
            Force, and torque about the base link's origin, in the root frame's axes: what
            thrusters and wheels must give.
        """
        turn = self._require_base()[:3, :3]
        state, force = as_vector('q', q, (self.n,)), as_vector('tau', tau, (self.n,))
        index = self.base_indices
        turning = left_jacobians(state[index[ATTITUDE]]).T
        torque = np.linalg.solve(turning, force[index[ATTITUDE]])
        return np.append(turn @ force[index[:3]], turn @ torque)

    def _require_base(self) -> Array:
        """Return the placement (4, 4) of the floating joint's frame in the root frame."""
        for body in self.tree.bodies:
            if body.floating:
                return body.attachment.placement
        raise StateError(f'{self.tree.name}: must have a floating joint, got a fixed base')


def load_robot(
    source: str | os.PathLike[str],
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
