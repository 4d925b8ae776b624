"""The coordinates of a floating base: position and rotation vector, and how they are kept small.

A rotation vector phi turns the base by Exp phi; its rate gives the angular velocity J phi', with
the left Jacobian J, which is singular at |phi| = 2 pi only. As phi and phi (1 - 2 pi / |phi|) are
the same attitude, every state is brought back within pi before that comes near.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics.robot_model import RobotModel
from denoc_ros.dynamics.rotations import left_jacobians, rotation_vectors, rotations
from denoc_ros.dynamics.validation import as_states, as_vector, same_rows
from denoc_ros.errors import StateError
from denoc_ros.types import Array

ATTITUDE = slice(3, 6)  # of a floating base's coordinates


def wrap_attitude(phi: Array, rate: Array) -> tuple[Array, Array]:
    """Return the same attitude and angular velocity with |phi| <= pi."""
    angle = float(np.linalg.norm(phi))
    turns = np.round(angle / (2.0 * np.pi))
    if turns == 0.0:
        return phi, rate
    wrapped = phi * (1.0 - 2.0 * np.pi * turns / angle)
    spin = left_jacobians(phi) @ rate
    return wrapped, np.asarray(np.linalg.solve(left_jacobians(wrapped), spin), dtype=np.float64)


def require_known_base(robot: RobotModel, whose: str) -> None:
    """Refuse a robot whose base floats, for methods that need a known motion of the base.

    Raises
    ------
    StateError
        With a way out.
    """
    if len(robot.base_indices):
        raise StateError(
            f'{whose}: the base of {robot.tree.name} must be fixed, got one that floats '
            '(make the floating joint a fixed one where the base is held)'
        )


class FloatingBase(RobotModel):
    """The base coordinates of a robot on a floating joint; StateError for a fixed base.

    The base is the link on the floating joint. Its coordinates, `base_indices`, are the position
    of its frame [m] and the rotation vector of its attitude [rad] in the joint's frame; nothing
    drives them.
    """

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
        pose, turn = np.eye(4), rotations(phi)
        pose[:3, :3] = placement[:3, :3] @ turn
        pose[:3, 3] = placement[:3, :3] @ state[index[:3]] + placement[:3, 3]
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
