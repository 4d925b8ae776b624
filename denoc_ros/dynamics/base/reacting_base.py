"""A floating base beside given motions of all other coordinates: as it reacts, or held.

As the rest of the robot is moved, the robot keeps its momentum.
"""

from __future__ import annotations

import numpy as np

from denoc_ros.dynamics.base.floating_base import ATTITUDE, wrap_attitude
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.dynamics.rotations import left_jacobians, rotations
from denoc_ros.errors import StateError
from denoc_ros.model.overrides import with_held_base
from denoc_ros.types import Array

WRAP = 4.0  # rad: a rotation vector this long is brought back; at 2 pi its rates are singular


class ReactingBase:
    """The coordinates of a floating base beside given motions of all others.

    Parameters
    ----------
    robot : Robot
        Its workspace is used: do not share it with another thread.

    Attributes
    ----------
    floats : bool
        Whether there is a floating base.
    twist : (6,) array or None
        Measured velocity of the base's origin and angular velocity, in the axes of the link on
        the floating joint; None: the momentum is zero.

    Notes
    -----
    With b the base and r the rest: I_bb q'_b = -I_br q'_r is a momentum of zero, and
    I_bb q''_b = -(I_br q''_r + h_b) are equations of motion without forces on the base. A momentum
    that is not zero adds a uniform motion and a spin of the whole robot: the twist tells it.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.index = robot.base_indices
        self.floats = len(self.index) > 0
        self._rest = np.setdiff1d(np.arange(robot.n), self.index)
        self._inertia = np.zeros((robot.n, robot.n))
        self._force = np.zeros(robot.n)
        self.twist: Array | None = None

    def require_none(self, where: str) -> None:
        """Raise StateError for a floating base, where a known motion is needed."""
        if self.floats:
            raise StateError(
                f'{self.robot.tree.name}: the base must be fixed or its motion measured {where}, '
                'got one that floats'
            )

    def rates(self, q: Array, qd: Array) -> None:
        """Write the base's rates into qd (n,): the measured ones, else those of no momentum."""
        if self.twist is not None:
            phi = q[self.index[ATTITUDE]]
            turn, turning = rotations(phi), left_jacobians(phi)
            qd[self.index[:3]] = turn @ self.twist[:3]
            qd[self.index[ATTITUDE]] = np.linalg.solve(turning, turn @ self.twist[3:])
            return
        inertia = self.robot.inertia_matrix(q, out=self._inertia, check=False)[self.index]
        momentum = inertia[:, self._rest] @ qd[self._rest]
        qd[self.index] = -np.linalg.solve(inertia[:, self.index], momentum)

    def accelerations(self, q: Array, qd: Array, qdd: Array) -> None:
        """Write the base's accelerations into qdd (n,) so that nothing acts on the base."""
        qdd[self.index] = 0.0
        self.robot.inverse_dynamics(q, qd, qdd, out=self._force, check=False)
        inertia = self.robot.inertia_matrix(q, out=self._inertia, check=False)
        block = inertia[np.ix_(self.index, self.index)]
        qdd[self.index] = -np.linalg.solve(block, self._force[self.index])

    def wrap(self, q: Array, qd: Array) -> None:
        """Bring the rotation vector back in place before its rates become singular.

        Nothing where no base floats.
        """
        if not self.floats:
            return
        phi = self.index[ATTITUDE]
        if q[phi] @ q[phi] > WRAP * WRAP:
            q[phi], qd[phi] = wrap_attitude(q[phi], qd[phi])


def held_robot(robot: Robot) -> Robot:
    """Return the same robot, overrides and payloads included, on a base that is held.

    Itself, if no base floats. The base's motion is then that of its verbs' `base`.
    """
    if not len(robot.base_indices):
        return robot
    text = with_held_base(robot.tree.source)
    held = load_robot(text, robot.gravity, robot.geometric_stiffness)
    if robot.tree.overrides:
        held = held.with_overrides(dict(robot.tree.overrides))
    held._take_payloads(robot)
    return held
