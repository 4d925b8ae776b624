"""Mounting errors and biases of an IMU or accelerometer from a record of still and moving."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from denoc_ros.bags.series import INERTIAL_NUMBERS, read_joint_states, read_numbers
from denoc_ros.dynamics.rotations import cross_matrices
from denoc_ros.errors import ConfigError, IdentificationError
from denoc_ros.estimation.joint_motion import smooth
from denoc_ros.types import Array

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot

MOST_READINGS = 1000  # evenly out of all: the amplitudes of each are in equilibrium
CUTOFF = 5.0  # Hz, of the joints' motion: vibration is not what is looked for
ITERATIONS = 20
CLOSE = 1e-12  # rad, of a step that ends the iteration
# Of the spread of directions: the second greatest in terms of the greatest. Below it the record
# turns the sensor, and what it feels, about one axis only.
LEAST_SPREAD = 1e-3
DOUBTFUL_ANGLE = np.radians(1.0)
DOUBTFUL_TURN = np.radians(20.0)


@dataclass(frozen=True)
class Mounting:
    """Mounting of a sensor, and its bias.

    Attributes
    ----------
    rotation : (3, 3) array
        The true axes seen from those that the file says.
    angle, angle_error : float
        Of that rotation [rad], and its standard deviation.
    gyro_bias, accel_bias : (3,) arrays
        Along the true axes [rad/s, m/s^2]; of an accelerometer the first is zero.
    gyro_bias_error, accel_bias_error : (3,) arrays
        Standard deviations, for residuals that are independent of each other.
    gyro_residual, accel_residual : float
        Rms of what is left [rad/s, m/s^2].
    doubts : tuple of str
        Why the result may not be what it says.
    """

    rotation: Array
    angle: float
    angle_error: float
    gyro_bias: Array
    accel_bias: Array
    gyro_bias_error: Array
    accel_bias_error: Array
    gyro_residual: float
    accel_residual: float
    doubts: tuple[str, ...]


def calibrate_mounting(
    robot: Robot, sensor: str, q: Array, qd: Array, qdd: Array, readings: Array
) -> Mounting:
    """Return the mounting that explains a sensor's readings along a motion.

    Parameters
    ----------
    robot : Robot
    sensor : str
        Name of an IMU or accelerometer.
    q, qd, qdd : (k, n) arrays
        The motion at the readings' times: several still postures, moves between them.
    readings : (k, 6) or (k, 3) array
        Angular rate and specific force; of an accelerometer the force.

    Raises
    ------
    IdentificationError
        The robot has no such sensor, or the motion does not determine the mounting.

    Notes
    -----
    readings = E^T predicted + bias, E a rotation: Gauss-Newton on E from the rotation that fits
    the differences from the means best (a singular value decomposition), rate and force each
    weighted by its own residual.
    """
    found = [each for each in robot.tree.inertial_sensors if each.name == sensor]
    if not found:
        known = ', '.join(each.name for each in robot.tree.inertial_sensors) or 'none'
        raise IdentificationError(
            f'sensor must be an IMU or accelerometer ({known}), got {sensor!r}'
        )
    parts = len(found[0].parts)
    if readings.shape != (len(q), parts):
        raise IdentificationError(
            f'{sensor}: readings must have shape ({len(q)}, {parts}), got {readings.shape}'
        )
    first = found[0].first
    predicted = robot.sensor_values(q, qd, qdd)[:, first : first + parts]
    seen, given = (each.reshape(len(q), -1, 3) for each in (readings, predicted))
    rotation, weights = _start(sensor, seen, given)
    for number in range(ITERATIONS):
        step, bias, covariance = _fit(rotation, seen, given, weights)
        rotation = rotation @ Rotation.from_rotvec(step).as_matrix()
        left = seen - given @ rotation - bias
        weights = 1.0 / np.maximum(np.sqrt(np.mean(left**2, axis=(0, 2))), 1e-12)
        if number > 1 and np.linalg.norm(step) < CLOSE:  # with weights by the residuals
            break
    return _described(rotation, bias, covariance, 1.0 / weights)


def _start(sensor: str, seen: Array, given: Array) -> tuple[Array, Array]:
    """Return the rotation that fits the differences from the means, and weights of the groups."""
    varied = seen - seen.mean(axis=0), given - given.mean(axis=0)
    weights = 1.0 / np.maximum(np.sqrt(np.mean(varied[1] ** 2, axis=(0, 2))), 1e-12)
    # what hardly varies says nothing of the rotation
    weights = np.where(weights > 1e6, 0.0, weights)
    spread = np.einsum('kgi,kgj,g->ij', varied[1], varied[0], weights**2)
    u, sizes, vt = np.linalg.svd(spread)
    if not sizes[1] > LEAST_SPREAD * sizes[0]:
        raise IdentificationError(
            f'{sensor}: the motion must turn the sensor about two axes at least, got one that '
            f'leaves the mounting open (spread {sizes[1]:.3g} of {sizes[0]:.3g})'
        )
    proper = np.diag([1.0, 1.0, np.linalg.det(u @ vt)])
    rotation: Array = np.asarray(u @ proper @ vt)
    return rotation, np.where(weights > 0.0, weights, weights.max())


def _fit(rotation: Array, seen: Array, given: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Return a step of the rotation vector, biases (groups, 3) and the covariance of both."""
    turned = given @ rotation
    k, groups, _ = turned.shape
    rows = np.zeros((k, groups, 3, 3 + 3 * groups))
    rows[..., :3] = cross_matrices(turned)
    for group in range(groups):
        rows[:, group, :, 3 + 3 * group : 6 + 3 * group] = np.eye(3)
    rows *= weights[:, None, None]
    wanted = (seen - turned) * weights[:, None]
    matrix = rows.reshape(-1, rows.shape[-1])
    solution = np.linalg.lstsq(matrix, wanted.ravel(), rcond=None)[0]
    covariance: Array = np.linalg.inv(matrix.T @ matrix)
    step, bias = np.asarray(solution[:3]), np.asarray(solution[3:]).reshape(groups, 3)
    return step, bias, covariance


def _described(rotation: Array, bias: Array, covariance: Array, residual: Array) -> Mounting:
    """Result with its doubts."""
    angle = float(np.linalg.norm(Rotation.from_matrix(rotation).as_rotvec()))
    errors = np.sqrt(np.diag(covariance))
    angle_error = float(np.linalg.norm(errors[:3]))
    doubts = []
    if angle_error > DOUBTFUL_ANGLE:
        doubts.append(f'the rotation must be certain to 1 deg, got {np.degrees(angle_error):.2g}')
    if angle > DOUBTFUL_TURN:
        doubts.append(f'the rotation must be a small one, got {np.degrees(angle):.3g} deg')
    has_gyro = len(bias) == 2
    gyro = (bias[0], errors[3:6], float(residual[0])) if has_gyro else (np.zeros(3),) * 2 + (0.0,)
    return Mounting(
        rotation, angle, angle_error, gyro[0], bias[-1], gyro[1], errors[-3:], gyro[2],
        float(residual[-1]), tuple(doubts),
    )  # fmt: skip


def read_motion(
    path: str, robot: Robot, name: str, where: str
) -> tuple[Array, Array, Array, Array]:
    """Return motion and readings of a sensor out of a bag, as `calibrate_mounting` takes them.

    Parameters
    ----------
    path : str
        The bag, with joint states and the sensor's topic.
    robot : Robot
    name : str
        The sensor's.
    where : str
        The robot's name in errors.

    Returns
    -------
    three (k, n) arrays
        Positions, rates, accelerations; amplitudes in equilibrium.
    (k, …) array
        Readings.

    Raises
    ------
    BagError, ConfigError, IdentificationError
        The bag cannot be read or has too few readings, or the sensor has no topic.
    """
    (sensor,) = (s for s in robot.tree.inertial_sensors if s.name == name)
    if not sensor.topic:
        raise ConfigError(where, [f'sensor {sensor.name!r} must have a topic, got none'])
    stamp_ns, readings = read_numbers(path, sensor.topic, INERTIAL_NUMBERS)
    joints = read_joint_states(path, names=robot.joint_names)
    inside = np.flatnonzero(
        (stamp_ns >= joints.stamp_ns.min(initial=np.iinfo(np.int64).max))
        & (stamp_ns <= joints.stamp_ns.max(initial=0))
    )
    if len(inside) < 10:
        raise IdentificationError(
            f'{name}: at least 10 readings must come with joint states, got {len(inside)}'
        )
    chosen = inside[np.linspace(0, len(inside) - 1, min(MOST_READINGS, len(inside))).astype(int)]
    begin = joints.stamp_ns[0]
    rising = np.flatnonzero(np.diff(joints.stamp_ns, prepend=begin - 1) > 0)
    t = 1e-9 * (joints.stamp_ns[rising] - begin)
    rates = joints.velocity[rising]
    motion = smooth(
        t, joints.position[rising], rates if np.isfinite(rates).all() else None, cutoff=CUTOFF
    )
    at = 1e-9 * (stamp_ns[chosen] - begin)
    q, qd, qdd = (
        np.column_stack([np.interp(at, t, column) for column in part.T])
        for part in (motion.q, motion.qd, motion.qdd)
    )
    whole = np.zeros((3, len(at), robot.n))
    whole[0] = robot.static_deflection(q)
    whole[1][:, robot.joint_indices], whole[2][:, robot.joint_indices] = qd, qdd
    return whole[0], whole[1], whole[2], readings[chosen]
