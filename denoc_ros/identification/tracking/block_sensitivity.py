"""How torques and sensors' values of a block of time change with its start and with parameters."""

from __future__ import annotations

import bisect
import math
from typing import NamedTuple

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.structure import composed_sensors, sensor_rows
from denoc_ros.estimation.amplitude_filter import load_shapes
from denoc_ros.types import Array, Flags

MEMORY = 2.0  # s, of the sensitivities by which excitation is judged
ANEW = 0.25  # change of the step, as a share, for which the linearization is made anew


class BlockSensitivity:
    """Derivatives along a block, accumulated step by step.

    Parameters
    ----------
    robot : Robot
        Its workspace is used: do not share it with another thread.
    reduction : (j, n) array
        Torques of the measured joints by forces on all coordinates: those of mimic joints count
        in their leaders'.
    parameters : int
        p.

    Attributes
    ----------
    duration : float
        Of the block so far [s].
    states : int
        s = 2 m: amplitudes and their rates.

    Notes
    -----
    With the joints' motion given, M d'' = -K d - C d' - Y_d p + f for small changes of the
    amplitudes d, parameters p and forces f, Y the regressor. The torques of the joints change by
    Y_j p + M_jd d''. The state is stepped by (1 - a)^-1 (1 + a), a = h J / 2.
    """

    def __init__(self, robot: Robot, reduction: Array, parameters: int) -> None:
        self.robot, self._reduction, self._p = robot, reduction, parameters
        self._flexible = robot.flexible_indices
        m = self._m = len(self._flexible)
        self.states = s = 2 * m
        # of the state by its start, by parameters, by them over `MEMORY`, by constant forces
        self._parts = np.cumsum([s, parameters, parameters])
        self._whole: Array = np.zeros((s, s + 2 * parameters + m))
        self._transition: Array = np.eye(s)
        self._input: Array = np.zeros((s, m))
        self._lead: Array = np.zeros((len(reduction), m))  # of torques by forces on the amplitudes
        self._slope: Array = np.zeros((len(reduction), s))
        self._sum = np.zeros_like(self._whole)
        self._by_parameters = np.zeros((len(reduction), parameters))
        self._bent: Array = np.zeros((s, parameters))
        self._step, self.lowest = 0.0, 1.0
        self.mobility: Array = np.zeros((m, m))
        self.shape, self.first, self.lengths = load_shapes(robot)
        self.duration = 0.0

    @property
    def columns(self) -> int:
        """How many derivatives `advance` returns of each state."""
        return int(self._whole.shape[1])

    def linearize(self, q: Array, step: float) -> None:
        """Take the model about coordinates (n,), for steps of about this time [s]."""
        m, robot = self._m, self.robot
        if not m:
            return
        inertia = robot.inertia_matrix(q, check=False)
        stiffness, damping = robot.stiffness[self._flexible], robot.damping[self._flexible]
        answer = np.asarray(np.linalg.inv(inertia[np.ix_(self._flexible, self._flexible)]), float)
        self.mobility = answer
        root = np.sqrt(stiffness)
        lowest = float(np.linalg.eigvalsh(root[:, None] * answer * root)[0])
        self.lowest = math.sqrt(max(lowest, 1e-12))
        self._lead = (self._reduction @ inertia)[:, self._flexible] @ answer
        self._slope = -np.hstack([self._lead * stiffness, self._lead * damping])
        half = np.zeros((2 * m, 2 * m))
        half[:m, m:] = np.eye(m)
        half[m:, :m], half[m:, m:] = -answer * stiffness, -answer * damping
        half *= 0.5 * step
        implicit = np.asarray(np.linalg.inv(np.eye(2 * m) - half), float)
        self._transition = implicit @ (np.eye(2 * m) + half)
        self._input = implicit[:, m:] @ (step * answer)
        self._step = step

    def bent(self, regressor: Array) -> Array:
        """Return the state's derivatives (s, p) in equilibrium, by a regressor (n, p)."""
        found = np.zeros((self.states, self._p))
        stiffness = self.robot.stiffness[self._flexible]
        found[: self._m] = -regressor[self._flexible] / stiffness[:, None]
        return found

    def start(self, bent: Array) -> None:
        """Start from a state that changes so with the parameters (s, p)."""
        self._bent = bent
        self._whole[:, self._parts[1] : self._parts[2]] = bent

    def begin(self, q: Array, step: float) -> None:
        """Begin a block at coordinates (n,), its steps of about this time [s]."""
        self.linearize(q, step)
        start, _, kept = self._parts[0], self._parts[1], slice(self._parts[1], self._parts[2])
        self._whole[:, :start] = np.eye(self.states)
        self._whole[:, start : self._parts[1]] = self._whole[:, self._parts[2] :] = 0.0
        # what has vibrated for long is forgotten, not what a load bends
        self._whole[:, kept] -= self._bent
        self._whole[:, kept] *= math.exp(-self.duration / MEMORY)
        self._whole[:, kept] += self._bent
        self._sum[:], self._by_parameters[:], self.duration = 0.0, 0.0, 0.0

    def advance(self, q: Array, step: float, regressor: Array) -> Array:
        """Go on by a step [s] with the regressor (n, p) over it; return the state's mean change.

        Returns
        -------
        (s, s + 2 p + m) array
            Derivatives of the state over the step: by the block's start, by the parameters over
            the block, by them over a longer time, by constant forces.
        """
        if self._step and abs(step / self._step - 1.0) > ANEW:
            self.linearize(q, step)
        first, second, third = self._parts
        before = self._whole
        after = self._transition @ before
        force = self._input @ regressor[self._flexible]
        after[:, first:second] -= force
        after[:, second:third] -= force
        after[:, third:] += self._input
        self._whole = after
        mean: Array = 0.5 * (before + after)
        self._sum += step * mean
        self._bent = self.bent(regressor)
        own = self._reduction @ regressor - self._lead @ regressor[self._flexible]
        self._by_parameters += step * own
        self.duration += step
        return mean

    def torques(self) -> tuple[Array, Array, Array]:
        """Return the torques' mean derivatives over the block.

        Returns
        -------
        by_state (j, s), by_parameters (j, p), over_long (j, p)
            The last: by parameters that were so for longer than the block.
        """
        first, second, third = self._parts
        mean = self._slope @ self._sum
        mean[:, first:second] += self._by_parameters
        mean[:, second:third] += self._by_parameters
        mean /= self.duration
        return mean[:, :first], mean[:, first:second], mean[:, second:third]

    def split(self, derivatives: Array) -> tuple[Array, Array, Array]:
        """Return the parts by state, by parameters and over a longer time of rows (k, ...)."""
        first, second, third = self._parts
        return derivatives[:, :first], derivatives[:, first:second], derivatives[:, second:third]

    def end(self) -> tuple[Array, Array, Array]:
        """Return the end's derivatives by start (s, s), parameters (s, p), forces (s, m)."""
        first, second, third = self._parts
        return self._whole[:, :first], self._whole[:, first:second], self._whole[:, third:]

    def start_covariance(self, share: float) -> Array:
        """Return the covariance (s, s) of a start whose tips are off by a share of the lengths.

        Energy is shared equally among the amplitudes of a deformation.
        """
        m, stiffness = self._m, self.robot.stiffness[self._flexible]
        force = stiffness[self.first] * share * self.lengths
        energy = force * force / stiffness[self.first]
        covariance = np.zeros((2 * m, 2 * m))
        covariance[:m, :m] = np.diag(energy / stiffness)
        shared = np.sqrt(energy)
        covariance[m:, m:] = shared[:, None] * self.mobility * shared
        return covariance

    def load_deviation(self, q: Array, qd: Array) -> Array:
        """Return elastic forces (m,) at the present amplitude of vibration, at (n,) arrays."""
        d, rate = q[self._flexible][self.first], qd[self._flexible][self.first]
        stiffness = self.robot.stiffness[self._flexible][self.first]
        return np.asarray(stiffness * np.hypot(d, rate / self.lowest))


# sensors ----------------------------------------------------------------------------------------

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
