"""IMUs and accelerometers as rows of the filter: their values by its whole state."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from denoc_ros.errors import StateError
from denoc_ros.model.inertial_sensors import inertial_values
from denoc_ros.types import Array

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot
    from denoc_ros.estimation.amplitude_filter import AmplitudeFilter

# time, coordinates and rates (n,) to the robot on its base of then, the accelerations (n,) and
# the deviations (n,) of those measured
Accelerations = Callable[[float, Array, Array], 'tuple[Robot, Array, Array]']

OLDEST = 0.005  # s behind the joints: what a line through the newest values still serves
REFRESH = 0.01  # s after which the rows are worked out anew
CHANGE = 0.01  # of a load, in the difference that is its derivative


class InertialRows:
    """Values of inertial sensors about a state x = [d; d'; f; b; e], b their biases.

    Forces on the amplitudes that the model leaves out are f + P e, e shares of the elastic forces
    and of what the loads at the ends of the robot take.

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
    loads : int
        Bodies on which no other stands: each may be heavier or lighter than the model says.
    rows : (k, 4 m + k + loads) array
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
    [H_d - H_a M^-1 K, H_v - H_a M^-1 C, H_a M^-1, 1, H_a M^-1 P].
    """

    def __init__(self, robot: Robot) -> None:
        sensors = inertial_values(robot.tree)
        self.names = tuple(value.name for value in sensors)
        self.noise = np.array([value.noise for value in sensors])
        self.bias = np.array([value.bias for value in sensors])
        self._places = [value.place for value in sensors]
        _require(robot, self.names, self.noise)
        count, m = len(self.names), len(robot.flexible_indices)
        self._plain = robot.copy()
        self._heavier = [
            robot.with_scaled_load(frame, 1.0 + CHANGE) for frame in _ends(robot) if sensors
        ]
        self.loads = len(self._heavier)
        self.rows = np.zeros((count, 4 * m + count + self.loads))
        self.rows[:, 3 * m : 3 * m + count] = np.eye(count)
        self.expected, self.change, self.uncertain = np.zeros((3, count))
        self._by_acceleration = np.zeros((count, robot.n))
        if sensors:  # nothing compiles in the loop
            zero = np.zeros(robot.n)
            robot.sensor_values(zero)
            robot.sensor_derivatives(zero)
        self.forget()

    def forget(self) -> None:
        """Forget the last state: the next one is elsewhere."""
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
        derivatives = robot.sensor_derivatives(q, qd, qdd, by_shapes=True)
        self._by_acceleration = derivatives[2][self._places]
        by_q, by_qd, by_qdd = (each[self._places][:, flexible] for each in derivatives)
        answer = by_qdd @ model.held_mobility
        self.rows[:, :m] = by_q - answer * model.stiffness
        self.rows[:, m : 2 * m] = by_qd - answer * model.damping
        self.rows[:, 2 * m : 3 * m] = answer
        model.carried = self._carried(robot, q, qd, qdd)
        self.rows[:, 3 * m + len(self.names) :] = answer @ model.shared(q[flexible])

    def _carried(self, robot: Robot, q: Array, qd: Array, qdd: Array) -> Array:
        """Return the forces (m, loads) on the amplitudes that the loads at the ends take."""
        found = np.zeros((len(robot.flexible_indices), self.loads))
        motion = robot.base_motion
        for column, heavier in enumerate(self._heavier):
            forces = []
            for one in (self._plain, heavier):
                one.move_base(motion)
                forces.append(
                    one.inverse_dynamics(q, qd, qdd, check=False)[robot.flexible_indices]
                )
            found[:, column] = (forces[0] - forces[1]) / CHANGE
        return found


def _ends(robot: Robot) -> list[str]:
    """Return the links of bodies that move and carry no other."""
    bodies = robot.tree.bodies
    carrying = {body.attachment.body for body in bodies}
    return [
        body.name
        for place, body in enumerate(bodies)
        if place not in carrying and body.name in robot.tree.frames
    ]


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
