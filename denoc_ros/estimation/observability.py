"""Observability of modes and of sensors' biases, with measured joints at rest."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.structure import body_amplitudes
from denoc_ros.model.sensors import inertial_values
from denoc_ros.types import Array

VALUES = 1000  # of every sensor: ten seconds at 100 Hz
DEFLECTION = 0.01  # deviation of an amplitude before, as a share of its beam's length, or rad
OBSERVABLE = 0.5  # a state of whose deviation more is left counts as not observed


@dataclass(frozen=True)
class ObservedState:
    """A mode's vibration or a constant bias, and its uncertainty with the sensors."""

    name: str  # `mode 1`, or the biased value, such as `imu/gyro_x`
    frequency: float  # of the mode [Hz]; 0 for a bias
    left: float  # share of its standard deviation that is left

    @property
    def observable(self) -> bool:
        """Whether the sensors tell more than was known before."""
        return self.left < OBSERVABLE


def observability(robot: Robot, q: Array) -> list[ObservedState]:
    """Observability of every mode and bias by the sensors, about a state at rest.

    Parameters
    ----------
    robot : Robot
        Without loops and mimic joints. Only its sensors with noise count.
    q : (n,) array
        Joints held, the amplitudes in equilibrium.

    Returns
    -------
    list of ObservedState
        Modes with the joints held, by rising frequency, then biases in file order; empty for a
        robot without such sensors or without amplitudes.

    Notes
    -----
    Every amplitude is uncertain by `DEFLECTION`, a bias by its `gyro_bias` or `accel_bias`;
    `VALUES` of every sensor come. A mode vibrates with its frequency w: it shows as
    (H_d + i w H_d' - w^2 H_d'') s in the values, s its shape. A bias stands still, and so may an
    unknown load on the links: what a bias shows beside H_d d is told from that.
    """
    noise = _noises(robot)
    kept = np.flatnonzero(noise > 0.0)
    flexible = robot.flexible_indices
    if not len(kept) or not len(flexible) or robot.constraint_names:
        return []
    zero = np.zeros(robot.n)
    derivatives = robot.sensor_derivatives(q, zero, zero)
    rows = [each[kept][:, flexible] / noise[kept, None] for each in derivatives]
    prior = _amplitude_deviations(robot)[flexible]
    return [*_modes(robot, q, rows, prior), *_biases(robot, rows[0], noise, kept, prior)]


def _modes(robot: Robot, q: Array, rows: list[Array], prior: Array) -> list[ObservedState]:
    """Return the modes, each alone: they differ by their frequencies."""
    modes = robot.natural_modes(q, held=True)
    shapes = modes.shapes[robot.flexible_indices]
    # of the modes' own coordinates, amplitudes being uncertain one by one
    spread = np.sqrt(np.sum((np.linalg.pinv(shapes) * prior) ** 2, axis=1))
    found = []
    for number, (frequency, shape) in enumerate(zip(modes.frequencies, shapes.T, strict=True), 1):
        omega = 2.0 * math.pi * frequency
        shown = (rows[0] + 1j * omega * rows[1] - omega**2 * rows[2]) @ shape
        signal = spread[number - 1] * float(np.linalg.norm(shown))
        left = 1.0 / math.sqrt(1.0 + VALUES * signal**2)
        found.append(ObservedState(f'mode {number}', float(frequency), left))
    return found


def _biases(
    robot: Robot, rows: Array, noise: Array, kept: NDArray[np.intp], prior: Array
) -> list[ObservedState]:
    """Return the biases, together with deflections that stand still."""
    places = {place: k for k, place in enumerate(kept.tolist())}
    own = [
        (value.name, value.bias, places[value.place])
        for value in inertial_values(robot.tree)
        if value.bias > 0.0 and value.place in places
    ]
    shown = np.zeros((len(kept), len(own)))
    for k, (_, _, row) in enumerate(own):
        shown[row, k] = 1.0 / noise[kept[row]]
    whole = np.hstack([rows * prior, shown * np.array([deviation for _, deviation, _ in own])])
    information = np.eye(whole.shape[1]) + VALUES * whole.T @ whole
    left = np.sqrt(np.diag(np.linalg.inv(information)))[len(prior) :]
    return [ObservedState(name, 0.0, float(x)) for (name, _, _), x in zip(own, left, strict=True)]


def _noises(robot: Robot) -> Array:
    """Return the deviation of every sensor's value, in file order."""
    noise = np.zeros(len(robot.sensor_names))
    noise[robot.tree.beam_sensor_places] = [sensor.noise for sensor in robot.tree.sensors]
    for value in inertial_values(robot.tree):
        noise[value.place] = value.noise
    return noise


def _amplitude_deviations(robot: Robot) -> Array:
    """Return how far each coordinate may be off before (n,): of joints not looked at."""
    deviations = np.full(robot.n, DEFLECTION)
    for k, body in enumerate(robot.tree.bodies):
        if body.amplitudes:
            deviations[body_amplitudes(robot, k)] *= body.spans
    return deviations
