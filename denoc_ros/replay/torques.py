"""Torque and deflection that a model has along a joint motion, term by term."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.deflection import TipDeflections
from denoc_ros.dynamics.feedforward import TorqueFeedforward
from denoc_ros.dynamics.joint_ties import joint_ties
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ModelError
from denoc_ros.kernels.handle import DAMPING, FRICTION
from denoc_ros.replay.friction import JointFriction
from denoc_ros.replay.motion import Motion

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

GAP = np.inf  # s: the feedforward starts anew


@dataclass(frozen=True)
class Torques:
    """What a model says of k rows of motion.

    Attributes
    ----------
    parts : dict of str to (k, joints) array
        gravity, inertia, coriolis, friction, elastic (flexible robots) and offset (with fitted
        friction): they add up to the torque of the best model [N m, N].
    models : dict of str to (k, joints) array
        Torque of the rigid and, with flexible links, of the flexible model.
    amplitudes : (2, k, n) array or None
        Coordinates and rates with the amplitudes, where there are any.
    deflection : (2, k, 6 links) array or None
        Tip deflections and their rates, as `TipDeflections.names`.
    """

    parts: dict[str, Array]
    models: dict[str, Array]
    amplitudes: Array | None
    deflection: Array | None

    @property
    def best(self) -> Array:
        """The torque of the flexible model where there is one, else of the rigid."""
        return self.models.get('flexible', self.models['rigid'])


class TorqueReplay:
    """Goes along a motion, block after block; the amplitudes are integrated alongside.

    Parameters
    ----------
    robot : Robot
        The model.
    joints : sequence of str
        The driven joints: order of all columns.
    held : mapping of str to float
        Where the other joints stand [rad, m].
    friction : JointFriction, optional
        Stands for the damping and friction that the robot's joints have.
    step : float
        Longest step of the integration [s].

    Raises
    ------
    ModelError
        The robot has loops.
    StateError
        A driven joint is unknown or a mimic.
    """

    def __init__(
        self,
        robot: Robot,
        joints: Sequence[str],
        held: Mapping[str, float] | None = None,
        friction: JointFriction | None = None,
        step: float = 1e-3,
    ) -> None:
        if robot.tree.loops:
            loops = [loop.name for loop in robot.tree.loops]
            raise ModelError(robot.tree.name, [f'robot must have no loops yet, got {loops}'])
        self._robot = robot.copy()
        self._ties, self._offsets, self.joints = joint_ties(robot, joints, held or {})
        self._friction = friction
        index = robot.joint_indices
        diagonals = robot.lowered.diagonals
        self._of_model = JointFriction(
            diagonals[DAMPING][index], diagonals[FRICTION][index], np.zeros(len(index))
        )
        self.deflections = TipDeflections(robot)
        self._along: TorqueFeedforward | None = None
        if len(robot.flexible_indices):
            self._along = TorqueFeedforward(
                robot.copy(), self.joints, 'flexible', step=step, held=held
            )
        self._last: float = np.nan

    @property
    def models(self) -> tuple[str, ...]:
        """The models whose torque is computed."""
        return ('rigid',) if self._along is None else ('rigid', 'flexible')

    def torques(self, t: Array, motion: Motion, starts: Flags) -> Torques:
        """Return what the model says of the next rows.

        Parameters
        ----------
        t : (k,) array
            Times [s], going on from the rows before.
        motion : Motion
            Of the driven joints.
        starts : (k,) bool array
            Where the amplitudes start anew, in equilibrium.
        """
        parts = self._rigid(motion)
        own = parts['friction']
        if self._friction is not None:
            parts['friction'] = self._friction.torque(motion.qd)
            parts['offset'] = np.broadcast_to(self._friction.offset, own.shape)
        models = {'rigid': np.sum(list(parts.values()), axis=0)}
        if self._along is None:
            return Torques(parts, models, None, None)
        flexible, amplitudes, deflection = self._flexible(self._along, t, motion, starts)
        rigid_alone = parts['gravity'] + parts['inertia'] + parts['coriolis'] + own
        parts['elastic'] = flexible - rigid_alone
        models['flexible'] = models['rigid'] + parts['elastic']
        return Torques(parts, models, amplitudes, deflection)

    def without_friction(self, torques: Torques) -> Array:
        """Return the best model's torque without friction of the joints and offset."""
        kept = (part for name, part in torques.parts.items() if name not in ('friction', 'offset'))
        rest: Array = np.sum(list(kept), axis=0)
        return rest

    def _rigid(self, motion: Motion) -> dict[str, Array]:
        """Return the terms of the undeformed robot."""
        robot, index = self._robot, self._robot.joint_indices
        q, qd, qdd, zero = np.zeros((4, len(motion.q), robot.n))
        q[:, index] = motion.q @ self._ties.T + self._offsets
        qd[:, index] = motion.qd @ self._ties.T
        qdd[:, index] = motion.qdd @ self._ties.T

        def torque(q: Array, qd: Array, qdd: Array) -> Array:
            force = robot.inverse_dynamics(q, qd, qdd)
            return np.asarray(force[:, index] @ self._ties)

        gravity, moving = torque(q, zero, zero), torque(q, qd, zero)
        friction = self._of_model.torque(qd[:, index]) @ self._ties
        return {
            'gravity': gravity,
            'inertia': torque(q, qd, qdd) - moving,
            'coriolis': moving - gravity - friction,
            'friction': friction,
        }

    def _flexible(
        self, along: TorqueFeedforward, t: Array, motion: Motion, starts: Flags
    ) -> tuple[Array, Array, Array]:
        count = len(t)
        torque = np.empty(motion.q.shape)
        amplitudes = np.empty((2, count, self._robot.n))
        deflection = np.empty((2, count, len(self.deflections.names)))
        q, qd, qdd = (np.ascontiguousarray(part) for part in vars(motion).values())
        elapsed = np.diff(t, prepend=self._last)
        elapsed[starts] = GAP
        for k in range(count):
            torque[k] = along.update(q[k], qd[k], qdd[k], elapsed[k])
            amplitudes[:, k] = along.q, along.qd
            self.deflections.evaluate(along.q, along.qd, (deflection[0, k], deflection[1, k]))
        self._last = float(t[-1])
        return torque, amplitudes, deflection
