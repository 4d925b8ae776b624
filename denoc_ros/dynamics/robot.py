"""A robot and all verbs of its dynamics: one immutable model, one workspace."""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics import equilibrium
from denoc_ros.dynamics import natural_modes as modes
from denoc_ros.dynamics.base_motion import Base, on_base
from denoc_ros.dynamics.batch import each_row
from denoc_ros.dynamics.derivatives import DifferentiableModel
from denoc_ros.dynamics.floating_base import FloatingBase
from denoc_ros.dynamics.linearize import Linearizable
from denoc_ros.dynamics.regressor import TorqueRegressor
from denoc_ros.dynamics.validation import as_states
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
