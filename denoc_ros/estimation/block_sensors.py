"""Values of sensors on beams over a block of time, against the model's."""

from __future__ import annotations

import bisect
import math
from typing import NamedTuple

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.structure import composed_sensors, sensor_rows
from denoc_ros.types import Array, Flags

WAITING = 8192  # values that wait for the joints' motion at most
TINY = 1e-300  # noise of a sensor that says none of its own
LARGEST = 1e30  # in any unit: what is beyond is no measurement, and its square may not be finite


class SensorMeans(NamedTuple):
    """Means over a block: measured minus predicted (s,), predicted (s,), its derivatives."""

    gap: Array
    value: Array
    derivatives: Array
    heard: Flags


class BlockSensors:
    """Takes values in at their stamps and compares them with the model's amplitudes.

    Parameters
    ----------
    robot : Robot
        Its workspace is used: do not share it with another thread.
    amplitudes : int
        m.

    Attributes
    ----------
    count : int
    noise : (s,) array
        What the sensors say of one value.
    late : int
        Values that came after their block.
    """

    def __init__(self, robot: Robot, amplitudes: int) -> None:
        self._robot = robot
        self._m = amplitudes
        self._bent = bool(composed_sensors(robot))
        sensors = robot.tree.sensors
        self.names = tuple(sensor.name for sensor in sensors)
        self.count = count = len(sensors)
        self._noise = np.array([max(sensor.noise, TINY) for sensor in sensors])
        self._rows = sensor_rows(robot) if count else np.zeros((0, robot.n))
        self._shift = np.zeros(count)
        self._waiting: list[tuple[float, int, float]] = []
        self._counts, self._gaps, self._values = np.zeros((3, count))
        self._derivatives: Array = np.zeros((count, 1))
        self.late = 0

    @property
    def noise(self) -> Array:
        """Standard deviation of one value of each sensor (s,)."""
        return self._noise

    def clear(self) -> None:
        """Forget the values that wait."""
        self._waiting.clear()

    def take(self, place: int, stamp: float, value: float) -> None:
        """Take a value of a time [s]; an invalid one, or one of no beam, is left out."""
        if place < self.count and abs(value) < LARGEST and math.isfinite(stamp):
            if len(self._waiting) == WAITING:
                self._waiting.pop(0)
            bisect.insort(self._waiting, (stamp, place, value))

    def begin(self, q: Array) -> None:
        """Begin a block at coordinates (n,)."""
        if self._bent:  # deflections of segments are not linear
            self._rows = self._robot.beam_sensor_rows(q)
            self._shift = self._robot.beam_sensor_values(q) - self._rows @ q
        self._counts[:] = self._gaps[:] = self._values[:] = 0.0
        self._derivatives[:] = 0.0

    def advance(
        self, begin: float, end: float, before: Array, after: Array, derivatives: Array
    ) -> None:
        """Take in the measurements of a step.

        Parameters
        ----------
        begin, end : float
            Of the step [s].
        before, after : (n,) arrays
            Coordinates.
        derivatives : (2 m, k) array
            Of amplitudes and rates over the step.
        """
        waiting = self._waiting
        count = bisect.bisect_right(waiting, (end, self.count, 0.0))
        if not count:
            return
        values, waiting[:count] = waiting[:count], []
        heard, measured, shares = np.zeros((3, self.count))
        for stamp, place, value in values:
            if stamp <= begin:
                self.late += 1
                continue
            heard[place] += 1.0
            measured[place] += value
            shares[place] += (stamp - begin) / (end - begin)
        predicted = heard * (self._rows @ before + self._shift)
        predicted += shares * (self._rows @ (after - before))
        self._counts += heard
        self._gaps += measured - predicted
        self._values += predicted
        if self._derivatives.shape[1] != derivatives.shape[1]:
            self._derivatives = np.zeros((self.count, derivatives.shape[1]))
        own = self._rows[:, self._robot.flexible_indices] @ derivatives[: self._m]
        self._derivatives += heard[:, None] * own

    def means(self, columns: int) -> SensorMeans:
        """Return the block's means, zero for sensors that were silent; of so many derivatives."""
        counts = np.maximum(self._counts, 1.0)
        if self._derivatives.shape[1] != columns:
            self._derivatives = np.zeros((self.count, columns))
        return SensorMeans(
            self._gaps / counts,
            self._values / counts,
            self._derivatives / counts[:, None],
            self._counts > 0.0,
        )
