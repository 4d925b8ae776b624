"""Springs that joint states do not show: those behind which joints are measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from denoc_ros.dynamics.measured_side import MotorSide, WholeCoordinates
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.springs import CUTOFF, GearSprings
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.types import Array

State = tuple[Array, Array]


class HiddenSprings:
    """Estimates s and s' of the springs behind which joints are measured.

    Parameters
    ----------
    robot : Robot
        As of :class:`WholeCoordinates`; its workspace is used.
    joints : sequence of str
        That are measured.
    settings : ObserverSettings
        `cutoff` is the bandwidth of the filter on the gears' torque, at most 100 Hz.

    Attributes
    ----------
    whole : WholeCoordinates
    hidden : tuple of str
        The joints.
    by_effort : bool
        Whether the gears' torque is measured.

    Notes
    -----
    The links' motion, which is measured, takes a torque t of the gear, and that bends the spring:
    k s + d s' = -t. With the source `torque` t is the effort that was measured behind the gear.
    The motor's own dynamics do not enter.
    """

    def __init__(self, robot: Robot, joints: Sequence[str], settings: ObserverSettings) -> None:
        self._robot = robot
        self.whole = WholeCoordinates(robot)
        self.hidden = self.whole.hidden
        self._springs = GearSprings(self.whole.springs, min(settings.cutoff, CUTOFF))
        self._motors = MotorSide(robot, joints) if settings.motor_effort else None
        self.by_effort = settings.source == 'torque' and not settings.motor_effort
        self._qdd, self._force = np.zeros((2, robot.n))
        self._ahead = 0.0  # s from the instant of the last torque to the last measurement

    def reset(self) -> None:
        """Forget all: the springs start at rest."""
        self._springs.reset()

    def adopt(self, other: HiddenSprings) -> None:
        """Go on from the state of another robot's with the same joints."""
        self._springs.adopt(other._springs)
        self._ahead = other._ahead

    def gear_torque(self, effort: Array, motion: State) -> Array:
        """Output torque of the gears (joints,) by efforts, rates and accelerations of links."""
        if self._motors is None:
            return effort
        torque = np.array(effort, dtype=np.float64)
        self._motors.take_off(torque, motion)
        return torque

    def follow(
        self, stepper: Stepper, states: tuple[State, State], given: Array, tau: Array,
        interval: float,
    ) -> None:  # fmt: skip
        """Go on to the next measurement by the torque that the motion up to there takes.

        Parameters
        ----------
        stepper : Stepper
            Of a robot whose base is where it was in the middle.
        states : pair of pairs of (n,) arrays
            Coordinates and rates before and after.
        given : (given joints,) array
            Accelerations in between.
        tau : (n,) array
            Loads that sensors show.
        interval : float
            [s]; 0: the springs start at rest.
        """
        (q_before, qd_before), (q, qd) = states
        if not len(self._robot.base_indices):  # a rotation vector may jump
            q, qd = 0.5 * (q_before + q), 0.5 * (qd_before + qd)
        stepper.accelerations(q, qd, given, self._qdd, tau)
        stepper.robot.inverse_dynamics(q, qd, self._qdd, out=self._force, check=False)
        self.take(self._force, interval)
        self._ahead = 0.5 * interval

    def take(self, force: Array, interval: float) -> None:
        """Go on by the gears' torques of generalized forces (n,) of the last measurement."""
        self._springs.follow(force[self.whole.places], interval)
        self._ahead = 0.0

    def write(self, described: State, ahead: float, out: State) -> None:
        """Write the whole robot's coordinates and rates from those described.

        Parameters
        ----------
        described : pair of (n,) arrays
            Coordinates and rates of the robot that joint states describe.
        ahead : float
            How long after the last measurement they are [s].
        out : pair of arrays
            Written, in the order of `whole.names`. Of joints measured behind their springs they
            have the motor's side.
        """
        if not self.hidden:
            out[0][:], out[1][:] = described
            return
        rate = self._springs.rate
        lead = self._ahead + ahead
        self.whole.write(described[0], self._springs.deflection + lead * rate, out[0])
        self.whole.write(described[1], rate, out[1])
