"""A robot and all verbs of its dynamics: one immutable model, one workspace."""

from __future__ import annotations

import os

from numpy.typing import ArrayLike

from denoc_ros.dynamics.floating_base import FloatingBase
from denoc_ros.dynamics.linearize import Linearizable
from denoc_ros.dynamics.regressor import TorqueRegressor
from denoc_ros.dynamics.statics import StaticsAndVibration
from denoc_ros.model.urdf import load_tree


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
