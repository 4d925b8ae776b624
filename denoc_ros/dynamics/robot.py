"""A robot and all verbs of its dynamics: one immutable model, one workspace."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics import equilibrium
from denoc_ros.dynamics import natural_modes as modes
from denoc_ros.dynamics.base_motion import Base, on_base
from denoc_ros.dynamics.batch import each_row
from denoc_ros.dynamics.derivatives import DifferentiableModel
from denoc_ros.dynamics.floating_base import FloatingBase
from denoc_ros.dynamics.linearize import Linearizable
from denoc_ros.dynamics.parameter_columns import (
    DIAGONAL_TERMS,
    Column,
    find_columns,
    massless,
)
from denoc_ros.dynamics.tree_dynamics import TreeDynamics
from denoc_ros.dynamics.validation import as_output, as_states, same_rows
from denoc_ros.model.friction import slip
from denoc_ros.model.urdf import load_tree
from denoc_ros.types import Array

Wrenches = Mapping[str, ArrayLike]


class StaticsAndVibration(DifferentiableModel):
    """Equilibria of a robot, and small vibrations about them."""

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


class TorqueRegressor(TreeDynamics):
    """Torque regressor: derivatives of inverse dynamics by parameters in which they are linear."""

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


class Robot(Linearizable, TorqueRegressor, StaticsAndVibration, FloatingBase):
    """A robot with rigid and flexible links (see :func:`load_robot`).

    States are vectors (n,) in the order of `coordinate_names`; every verb also takes rows (k, n)
    and then returns (k, …), rows in parallel. `out=` takes the result where no allocation is
    wanted, `check=False` skips the test that arguments are finite. A robot holds one workspace and
    so is not to be used by two threads at once: give each its own :meth:`copy`.

    The open tree: :class:`TreeDynamics`. Loops and mimic joints: :class:`ConstrainedModel`.
    Derivatives of the dynamics: :class:`DifferentiableModel`, with loops
    :class:`DifferentiableMechanism`; of kinematics: :class:`KinematicDerivatives`; by parameters:
    :class:`TorqueRegressor`. Linear models: :class:`Linearizable`. Attributes as in
    :class:`RobotModel`.
    """


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
