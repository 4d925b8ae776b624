"""A robot that is simulated step by step: the interface of a plant's engines, and ours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from denoc_ros.dynamics.base.reacting_base import ReactingBase
from denoc_ros.dynamics.elastic.deflection import TipDeflections
from denoc_ros.dynamics.elastic.state_bounds import StateBounds
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.stepper import Stepper, with_joint_feedback
from denoc_ros.dynamics.structure import composed_sensors, sensor_rows
from denoc_ros.types import Array, IntArray


class Drives(NamedTuple):
    """The drives of a simulated robot."""

    # joints that stand still while the drives do: all but those that loops move
    given: Sequence[str]
    coordinates: IntArray  # (k,) of the driven joints
    # (k,) gains of their own feedback [N m/rad, N/m] and [N m s/rad, N s/m]
    kp: Array
    kd: Array


class SimulatedRobot(Protocol):
    """A robot that moves by fixed steps under the effort of its drives.

    Attributes
    ----------
    robot : Robot
        Its description: names, coordinates, sensors.
    q, qd : (n,) arrays
        Coordinates and rates of `robot`; an engine without amplitudes projects its state on them.
    step : float
        Length of a step [s].
    start : (n,) array
        Coordinates where it starts.
    bounds : StateBounds or None
        Of its state; None where it may bend as far as it likes.
    """

    robot: Robot
    q: Array
    qd: Array
    step: float
    start: Array
    bounds: StateBounds | None

    @property
    def qdd(self) -> Array:
        """Mean accelerations (n,) over the last step."""

    def place(self) -> None:
        """Put it to rest at its start."""

    def follow(self, before: SimulatedRobot) -> None:
        """Take over the state of the same robot with other numbers."""

    def hold(self) -> None:
        """Take a step with the drives standing still."""

    def free(self, tau: Array) -> None:
        """Take a step under generalized forces tau (n,), of which those of joints count."""

    def controlled(self, tau: Array) -> None:
        """Take a step under tau - kp q - kd q' of the driven joints, the feedback implicit."""

    def sensor_values(self) -> Array:
        """Return the values (sensors,) of `robot.tree.sensors`; the array is used again."""

    def inertial_values(self) -> Array:
        """Return the values of all sensors, of which those of inertial ones count."""

    def tip_deflections(self, position: Array, rate: Array) -> None:
        """Write the deflections (6 k,) of the beams' tips and their rates, beam frames."""


class ModalRobot:
    """A robot simulated by its own model: :class:`SimulatedRobot` has the public interface.

    Parameters
    ----------
    robot : Robot
        Its workspace is used: do not share it with another thread.
    step : float [s]
    start : (n,) array
        Where it starts, loops closed.
    """

    def __init__(self, robot: Robot, step: float, start: Array, drives: Drives) -> None:
        self.robot, self.step, self.start = robot, step, start
        self.bounds: StateBounds | None = StateBounds(robot, start)
        held = with_joint_feedback(robot, drives.coordinates, drives.kp, drives.kd)
        self._stepper = Stepper(robot, step, drives.given)
        self._feedback_stepper = Stepper(held, step)
        self._still = np.zeros(len(drives.given))
        self._base = ReactingBase(robot)
        self._tips = TipDeflections(robot)
        self._rows = sensor_rows(robot)
        self._values = np.zeros(len(self._rows))
        self._composed = [
            (k, 1 if sensor.direction == 'y' else 2, *robot.section(sensor.link, sensor.station))
            for k, sensor in composed_sensors(robot)
        ]
        self.q, self.qd, self._qd_before = np.zeros((3, robot.n))
        self.place()
        self._warm_up()

    def _warm_up(self) -> None:
        """Take every path of a step once."""
        zero = np.zeros(self.robot.n)
        self.hold()
        self.free(zero)
        self.controlled(zero)
        self.sensor_values()
        if self.robot.tree.inertial_sensors:
            self.inertial_values()
        self.place()

    def place(self) -> None:
        """Put it to rest at its start."""
        self.q[:], self.qd[:], self._qd_before[:] = self.start, 0.0, 0.0

    def follow(self, before: SimulatedRobot) -> None:
        """Take over the state of the same robot with other numbers."""
        self.q[:], self.qd[:] = before.q, before.qd
        self._qd_before[:] = before.qd - self.step * before.qdd

    @property
    def qdd(self) -> Array:
        """Accelerations (n,): the change of the rates in the last step, over it."""
        return np.asarray((self.qd - self._qd_before) / self.step)

    def hold(self) -> None:
        """Take a step with the drives standing still."""
        self._begin()
        self._stepper.driven(self.q, self.qd, self._still)

    def free(self, tau: Array) -> None:
        """Take a step under generalized forces tau (n,)."""
        self._begin()
        self._stepper.free(self.q, self.qd, tau)

    def controlled(self, tau: Array) -> None:
        """Take a step under tau - kp q - kd q' of the driven joints, the feedback implicit."""
        self._begin()
        self._feedback_stepper.free(self.q, self.qd, tau)

    def sensor_values(self) -> Array:
        """Return the values (sensors,) of `robot.tree.sensors`; the array is used again."""
        np.dot(self._rows, self.q, out=self._values)
        for place, axis, section, own in self._composed:
            self._values[place] = section.deflection(self.q[own])[axis]
        if len(self._values):
            self._values += self.robot.beyond_shapes(self.q, self.qd, self.qdd)
        return self._values

    def inertial_values(self) -> Array:
        """Return the values of all sensors."""
        return self.robot.sensor_values(self.q, self.qd, self.qdd)

    def tip_deflections(self, position: Array, rate: Array) -> None:
        """Write the deflections (6 k,) of the beams' tips and their rates, beam frames."""
        self._tips.evaluate(self.q, self.qd, out=(position, rate))

    def _begin(self) -> None:
        self._base.wrap(self.q, self.qd)
        self._qd_before[:] = self.qd
