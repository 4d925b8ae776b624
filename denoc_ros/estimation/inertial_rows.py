"""IMUs and accelerometers as rows of the filter: their values by its whole state."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from denoc_ros.errors import StateError
from denoc_ros.types import Array

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot
    from denoc_ros.estimation.amplitude_filter import AmplitudeFilter

# time, coordinates and rates (n,) to the robot on its base of then, the accelerations (n,) and
# the deviations (n,) of those measured
Accelerations = Callable[[float, Array, Array], 'tuple[Robot, Array, Array]']

OLDEST = 0.005  # s behind the joints: what a line through the newest values still serves
REFRESH = 0.01  # s after which the rows are worked out anew


class InertialRows:
    """Values of inertial sensors about a state x = [d; d'; f; b; e], b their biases.

    Forces on the amplitudes that the model leaves out are f + e K d, e shares.

    Parameters
    ----------
    robot : Robot

    Attributes
    ----------
    names : tuple of str
        Of the values, such as `imu/gyro_x`.
    noise, bias : (k,) arrays
        Standard deviations: of the values, and of their constant errors at the start.
    expected, change : (k,) arrays
        The values without biases at the last state, and by how much they change per second.
    rows : (k, 4 m + k) array
        Their derivatives by x.
    uncertain : (k,) array
        Deviation of the values by the joints' accelerations.

    Raises
    ------
    StateError
        A sensor has no noise, or the robot has loops.

    Notes
    -----
    With the joints' accelerations measured, whatever drives the model,
    d'' = M^-1 (f - K d - C d' + ...) makes a specific force a function of the state: with H the
    derivatives by d, d' and d'', the rows are
    [H_d - H_a M^-1 K, H_v - H_a M^-1 C, H_a M^-1, 1, H_a M^-1 K d].
    """

    def __init__(self, robot: Robot) -> None:
        sensors = robot.tree.inertial_sensors
        self.names = tuple(f'{s.name}/{part}' for s in sensors for part in s.parts)
        of = [(s, part.partition('_')[0]) for s in sensors for part in s.parts]
        self.noise = np.array([getattr(s, f'{kind}_noise') for s, kind in of])
        self.bias = np.array([getattr(s, f'{kind}_bias') for s, kind in of])
        self._places = [s.first + k for s in sensors for k in range(len(s.parts))]
        _require(robot, self.names, self.noise)
        count, m = len(self.names), len(robot.flexible_indices)
        self.rows = np.zeros((count, 4 * m + count))
        self.rows[:, 3 * m : 3 * m + count] = np.eye(count)
        self.expected, self.change, self.uncertain = np.zeros((3, count))
        self._by_acceleration = np.zeros((count, robot.n))
        if sensors:  # nothing compiles in the loop
            zero = np.zeros(robot.n)
            robot.sensor_values(zero)
            robot.sensor_derivatives(zero)
        self.forget()

    def forget(self) -> None:
        """Forget the last state: what comes is elsewhere."""
        self._time = self._refreshed = -math.inf

    def move(
        self, time: float, q: Array, qd: Array, motion: Accelerations, model: AmplitudeFilter
    ) -> None:
        """Work out values and rows at a time [s] and its state (n,)."""
        robot, qdd, deviation = motion(time, q, qd)
        values = robot.sensor_values(q, qd, qdd)[self._places]
        passed = time - self._time
        if 0.0 < passed <= OLDEST:
            self.change = (values - self.expected) / passed
        elif passed:
            self.change = np.zeros(len(values))
        if time - self._refreshed >= REFRESH:
            self._refresh(robot, q, qd, qdd, model)
            self._refreshed = time
        self.expected, self._time = values, time
        self.uncertain = np.abs(self._by_acceleration) @ deviation

    def _refresh(
        self, robot: Robot, q: Array, qd: Array, qdd: Array, model: AmplitudeFilter
    ) -> None:
        flexible, m = robot.flexible_indices, len(robot.flexible_indices)
        derivatives = robot.sensor_derivatives(q, qd, qdd)
        self._by_acceleration = derivatives[2][self._places]
        by_q, by_qd, by_qdd = (each[self._places][:, flexible] for each in derivatives)
        answer = by_qdd @ model.held_mobility
        self.rows[:, :m] = by_q - answer * model.stiffness
        self.rows[:, m : 2 * m] = by_qd - answer * model.damping
        self.rows[:, 2 * m : 3 * m] = answer
        self.rows[:, 3 * m + len(self.names) :] = answer * (model.stiffness * q[flexible])


def _require(robot: Robot, names: tuple[str, ...], noise: Array) -> None:
    silent = [name for name, value in zip(names, noise, strict=True) if not value > 0.0]
    if silent:
        raise StateError(
            f'{robot.tree.name}: inertial sensors that are fused must have gyro_noise and '
            f'accel_noise > 0, got 0 for {", ".join(silent)}'
        )
    if names and robot.tree.loops:
        raise StateError(
            f'{robot.tree.name}: a robot whose inertial sensors are fused must have no loops, '
            f'got {", ".join(loop.name for loop in robot.tree.loops)}'
        )
