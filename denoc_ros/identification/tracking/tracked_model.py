"""The model of a robot along the measured motion of its joints, a block of time after another."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from denoc_ros.dynamics.constrained_dynamics import mimic_ties
from denoc_ros.dynamics.driven.driven_motion import driven_motion
from denoc_ros.dynamics.parameter_columns import LiveNumbers
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.errors import SolverError
from denoc_ros.identification.tracking.block_sensitivity import BlockSensitivity, BlockSensors
from denoc_ros.runtime.adaptation import BaseAt
from denoc_ros.types import Array, Flags

START = 0.005  # deviation of a tip's deflection at the start, as a share of the beam's length


class BlockMeans(NamedTuple):
    """Mean values of c channels over a block: torques of joints, then sensors."""

    # (c,) means of measured minus predicted, and of what is predicted
    gap: Array
    predicted: Array
    # by_state, by_parameters, over_long: arrays (c, s), (c, p), (c, p): derivatives of the
    # prediction; the last by parameters that were so for longer
    by_state: Array
    by_parameters: Array
    over_long: Array
    heard: Flags  # (c,) bool


class TrackedModel:
    """Amplitudes driven by the joints' motion, torques and sensors, and their derivatives.

    Parameters
    ----------
    robot : Robot
        Worked on as copies.
    numbers : LiveNumbers
        Those that are tracked.
    size : (p,) array
        Their units here.
    joints : sequence of str, optional
        That are measured; default all.
    step : float
        Usual time between two advances [s].

    Attributes
    ----------
    sensitivity : BlockSensitivity
    sensors : BlockSensors
    joints : (j,) int array
        Coordinates of the measured joints.
    base : callable or None
    """

    def __init__(
        self,
        robot: Robot,
        numbers: LiveNumbers,
        size: Array,
        joints: Sequence[str] | None,
        step: float,
    ) -> None:
        self.robot, self._numbers, self._size = robot.copy(), numbers, size
        self._motion = driven_motion(self.robot, joints)
        self.joints = self._motion.index
        self._stepper = Stepper(robot.copy(), step, self._motion.given)
        reduction = np.zeros((len(self.joints), robot.n))
        reduction[:, robot.joint_indices] = mimic_ties(robot, joints, {})[0].T
        self.sensitivity = BlockSensitivity(robot.copy(), reduction, len(size))
        self.sensors = BlockSensors(robot.copy(), self.sensitivity.states // 2)
        self._flexible = robot.flexible_indices
        self._regressor = np.zeros((robot.n, len(size)))
        self._q, self._qd = np.zeros((2, robot.n))
        self._torque, self._impulse, self._reduced = np.zeros((3, len(self.joints)))
        self._with_effort, self._step = 0.0, step
        self.base: BaseAt | None = None

    def start(self, time: float, q: Array, qd: Array) -> tuple[Array, Array]:
        """Start at a time [s] from joints (j,), the amplitudes in equilibrium.

        Returns
        -------
        covariance (s, s), by_parameters (s, p)
            Of the state for given parameters, and its derivatives by them.
        """
        self._move_base(time)
        self._motion.positions(self._q, q)
        self._qd[:] = self._q[self._flexible] = 0.0
        if len(self._flexible):
            # without an equilibrium at this posture (buckled) nothing is known of the amplitudes
            with suppress(SolverError):
                positions = self._q[self.robot.joint_indices]
                self._q[:] = self.robot.static_deflection(positions)
        self._motion.rates(self._qd, qd)
        self.begin_block()
        rest = np.zeros(self.robot.n)
        self._differentiate(self._q, rest, rest)
        bent = self.sensitivity.bent(self._regressor)
        self.sensitivity.start(bent)
        return self.sensitivity.start_covariance(START), bent

    def begin_block(self) -> None:
        """Begin a block from here."""
        self.sensitivity.begin(self._q, self._step)
        self.sensors.begin(self._q)
        self._impulse[:] = self._torque[:] = self._with_effort = 0.0

    def take_effort(self, impulse: Array, duration: float) -> None:
        """Take measured effort (j,) in, integrated over a time [s]."""
        self._impulse += impulse
        self._with_effort += duration

    def advance(self, begin: float, end: float, q: Array, qd: Array) -> None:
        """Go on from a time to another [s], the joints to positions and rates (j,)."""
        step = end - begin
        self._move_base(begin + 0.5 * step)
        q_before, qd_before = self._q.copy(), self._qd.copy()
        mean = self._motion.given_accelerations((qd - qd_before[self.joints]) / step)
        self._stepper.step = self._step = step
        self._stepper.driven(self._q, self._qd, mean)
        self._motion.positions(self._q, q)
        self._motion.rates(self._qd, qd)
        middle, rate = 0.5 * (q_before + self._q), 0.5 * (qd_before + self._qd)
        acceleration = (self._qd - qd_before) / step
        torque = self.robot.inverse_dynamics(middle, rate, acceleration)
        self._torque += step * self._motion.reduce(torque, self._reduced)
        self._differentiate(middle, rate, acceleration)
        derivatives = self.sensitivity.advance(middle, step, self._regressor)
        self.sensors.advance(begin, end, q_before, self._q, derivatives)

    def means(self, offsets: Array) -> BlockMeans:
        """Return the means of the block so far, offsets (c,) of the channels taken off."""
        sensitivity = self.sensitivity
        duration = sensitivity.duration
        torques = sensitivity.torques()
        sensors = self.sensors.means(sensitivity.columns)
        seen = sensitivity.split(sensors.derivatives)
        by_state, by, by_long = (np.vstack(pair) for pair in zip(torques, seen, strict=True))
        with_effort = self._with_effort > (1.0 - 1e-6) * duration
        gap = (self._impulse - self._torque) / duration
        return BlockMeans(
            np.concatenate([gap, sensors.gap]) - offsets,
            np.concatenate([self._torque / duration, sensors.value]),
            by_state,
            by,
            by_long,
            np.concatenate([np.full(len(gap), with_effort), sensors.heard]),
        )

    def error_covariance(self, share: float) -> Array:
        """Covariance in a block (s, s) by an error of the elastic forces by a share."""
        load = share * self.sensitivity.load_deviation(self._q, self._qd)
        by_force = self.sensitivity.end()[2]
        return np.asarray(by_force @ (load[:, None] * self.sensitivity.shape * load) @ by_force.T)

    def correct(self, change: Array) -> None:
        """Add a change (s,) to the state."""
        m = len(self._flexible)
        self._q[self._flexible] += change[:m]
        self._qd[self._flexible] += change[m:]

    def retune(self, change: Array) -> None:
        """Add a change (p,) to the numbers that are tracked, in their own units."""
        for robot in (self.robot, self._stepper.robot, self.sensitivity.robot):
            self._numbers.set(robot, change)

    def _differentiate(self, q: Array, qd: Array, qdd: Array) -> None:
        self._numbers.columns(q, qd, qdd, self._regressor)
        self._regressor *= self._size

    def _move_base(self, time: float) -> None:
        if self.base is not None:
            motion = self.base(time)
            self.robot.move_base(motion)
            self._stepper.robot.move_base(motion)
            self._numbers.move_base(motion)
