"""Gain and offset of a sensor from readings at known references (the book's section 8.3.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from denoc_ros.bags.series import inertial_numbers, read_joint_states, read_numbers
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.rotations import cross_matrices
from denoc_ros.dynamics.structure import sensor_rows
from denoc_ros.dynamics.validation import as_vector
from denoc_ros.errors import ConfigError, IdentificationError, StateError
from denoc_ros.estimation.joint_motion import smooth
from denoc_ros.estimation.turns import without_turns
from denoc_ros.model.tree import INERTIAL_UNITS
from denoc_ros.types import Array

REFERENCES = ('value', 'deflection', 'load')
LEAST_POINTS = 3
BLOCKS = 10  # per shortest plateau
STEADY = 6.0  # standard deviations that a plateau's parts may be apart
CREEP = 0.01  # share of the signal's range that they may be apart for other reasons
EDGE = 0.1  # share of a plateau at either end that is not used
SIGNIFICANT = 3.0  # standard errors that a slope must be from 0
MOST_HYSTERESIS = 0.02
MOST_CURVATURE = 0.02
MOST_GAIN_ERROR = 0.01
MOST_READINGS = 1000  # evenly out of all: the amplitudes of each are in equilibrium
CUTOFF = 5.0  # Hz, of the joints' motion: vibration is not what is looked for


@dataclass(frozen=True)
class Calibration:
    """value = gain raw + offset, with its uncertainty and quality."""

    # [value per raw], [value]
    gain: float
    offset: float
    # their standard errors
    gain_error: float
    offset_error: float
    residual: float  # standard deviation of the references about the line [value]
    # largest gap between loading and unloading, as a share of the range; NaN where the references
    # only rise or only fall
    hysteresis: float
    # largest departure of a parabola through the points from the line, as a share of the range
    curvature: float
    points: int
    noise: float  # standard deviation of the value while it stood still; NaN where it is not known
    doubts: tuple[str, ...]  # what speaks against the line


@dataclass(frozen=True)
class Plateaus:
    """Plateaus of a signal: means (k,), and the pooled standard deviation within."""

    means: Array
    deviation: float


def calibrate(raw: ArrayLike, reference: ArrayLike, deviation: float = math.nan) -> Calibration:
    """Fit gain and offset.

    Parameters
    ----------
    raw : (k,) array
        Readings, in the order in which they were taken.
    reference : (k,) array
        What the sensor's value should have been [value], taken as exact.
    deviation : float
        Standard deviation of a single reading, where known [raw].

    Raises
    ------
    StateError
        Arrays of different length, or a number that is not finite.
    IdentificationError
        Fewer than three points, or references or readings that are all the same.

    Notes
    -----
    References are exact and readings are not, so raw is regressed on the reference,
    raw = a reference + b by least squares, inverted: gain = 1/a, offset = -b/a; their errors
    to first order from those of a and b.
    """
    reference = as_vector('reference', reference, np.shape(reference))
    raw = as_vector('raw', raw, reference.shape)
    _require_spread(raw, reference)
    centre = reference.mean()
    spread = float(np.sum((reference - centre) ** 2))
    slope = float(np.sum((reference - centre) * (raw - raw.mean()))) / spread
    reach = float(np.ptp(reference))
    scatter = raw - raw.mean() - slope * (reference - centre)
    sigma = math.sqrt(float(scatter @ scatter) / (len(raw) - 2))
    if abs(slope) <= SIGNIFICANT * sigma / math.sqrt(spread):
        raise IdentificationError(
            'calibration: readings must follow the references, got a slope of '
            f'{slope:.3g} +- {sigma / math.sqrt(spread):.2g} raw per value'
        )
    gain = 1.0 / slope
    offset = centre - gain * float(raw.mean())
    gain_error = abs(gain) * sigma / math.sqrt(spread) / abs(slope)
    offset_error = math.hypot(gain * sigma / math.sqrt(len(raw)), gain_error * raw.mean())
    value = gain * raw + offset
    found = Calibration(
        gain,
        offset,
        gain_error,
        offset_error,
        abs(gain) * sigma,
        _hysteresis(value, reference) / reach,
        _curvature(value, reference) / reach,
        len(raw),
        abs(gain) * deviation,
        (),
    )
    return _doubted(found)


def _require_spread(raw: Array, reference: Array) -> None:
    if len(raw) < LEAST_POINTS:
        raise IdentificationError(
            f'calibration: points must be at least {LEAST_POINTS}, got {len(raw)}'
        )
    for name, values in (('references', reference), ('readings', raw)):
        if not np.ptp(values) > 0.0:
            raise IdentificationError(
                f'calibration: {name} must not be all the same, got {values[0]:g} only'
            )


def _doubted(found: Calibration) -> Calibration:
    doubts = []
    for what, share, most in (
        ('hysteresis', found.hysteresis, MOST_HYSTERESIS),
        ('curvature', found.curvature, MOST_CURVATURE),
        ('standard error of the gain', found.gain_error / abs(found.gain), MOST_GAIN_ERROR),
    ):
        if share > most:
            doubts.append(f'{what} must be <= {most:.0%}, got {share:.2%}')
    return Calibration(**{**found.__dict__, 'doubts': tuple(doubts)})


def _hysteresis(value: Array, reference: Array) -> float:
    """Return the largest gap between values read on the way up and on the way down."""
    change = np.diff(reference)
    # turning points belong to both ways
    up, down = (
        _branch(value, reference, np.append(way, False) | np.insert(way, 0, False))
        for way in (change > 0.0, change < 0.0)
    )
    lowest = max(up[0][0], down[0][0]) if len(up[0]) and len(down[0]) else math.nan
    highest = min(up[0][-1], down[0][-1]) if len(up[0]) and len(down[0]) else math.nan
    at = np.unique(reference[(reference >= lowest) & (reference <= highest)])
    if len(at) < 2:
        return math.nan
    return float(np.abs(np.interp(at, *up) - np.interp(at, *down)).max())


def _branch(value: Array, reference: Array, chosen: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the means of chosen values per reference, by rising reference."""
    at, group = np.unique(reference[chosen], return_inverse=True)
    count = np.bincount(group, minlength=len(at))
    return at, np.bincount(group, value[chosen], minlength=len(at)) / np.maximum(count, 1)


def _curvature(value: Array, reference: Array) -> float:
    """Return the largest departure of a parabola through the points from their line."""
    if len(np.unique(reference)) <= LEAST_POINTS:
        return math.nan
    fitted = np.polynomial.Polynomial.fit(reference, value, 2)(reference)
    line = np.polynomial.Polynomial.fit(reference, value, 1)(reference)
    return float(np.abs(fitted - line).max())


def find_plateaus(t: ArrayLike, raw: ArrayLike, hold: float = 1.0) -> Plateaus:
    """Find the plateaus of a signal.

    Parameters
    ----------
    t : (k,) array
        Times [s], rising.
    raw : (k,) array
        Readings.
    hold : float
        Shortest plateau [s].

    Raises
    ------
    StateError
        Arrays of different length, a number that is not finite, times that do not rise.
    IdentificationError
        The signal never stands still, or is shorter than a plateau.
    """
    times = as_vector('t', t, np.shape(t))
    signal = as_vector('raw', raw, times.shape)
    if not hold > 0.0 or np.any(np.diff(times) < 0.0):
        raise StateError(f'plateaus: t must rise and hold must be > 0 s, got {hold}')
    block = ((times - times[:1]) // (hold / BLOCKS)).astype(int)
    filled, starts, counts = np.unique(block, return_index=True, return_counts=True)
    if len(filled) < BLOCKS:
        raise IdentificationError(f'plateaus: the signal must last {hold:g} s, got less')
    means = np.add.reduceat(signal, starts) / counts
    jumps = np.abs(np.diff(signal))
    sigma = 1.0484 * float(np.median(jumps))  # median |difference| of two normal numbers
    near = STEADY * sigma / math.sqrt(float(np.median(counts))) + CREEP * float(np.ptp(means))
    found, within = [], []
    for begin, end in _runs(means, near):
        cut = round(EDGE * (end - begin))
        part = signal[starts[begin + cut] : starts[end - 1 - cut] + counts[end - 1 - cut]]
        found.append(part.mean())
        within.append(part)
    if not found:
        raise IdentificationError(f'plateaus: the signal must stand still for {hold:g} s')
    freedom = sum(len(part) - 1 for part in within)
    squares = sum(float(np.var(part)) * len(part) for part in within)
    return Plateaus(np.array(found), math.sqrt(squares / max(freedom, 1)))


def _runs(means: Array, near: float) -> list[tuple[int, int]]:
    """Return the longest stretches, first to last, whose means stay near their median."""
    runs, begin = [], 0
    while begin + BLOCKS <= len(means):
        end = begin + BLOCKS
        if np.ptp(means[begin:end]) > 2.0 * near:
            begin += 1
            continue
        centre = float(np.median(means[begin:end]))
        while end < len(means) and abs(means[end] - centre) <= near:
            end += 1
        runs.append((begin, end))
        begin = end
    return runs


def sensor_values(robot: Robot, sensor: str, reference: ArrayLike, kind: str = 'value') -> Array:
    """Predicted values of a sensor at known references.

    Parameters
    ----------
    sensor : str
        Its name.
    reference : (k,) array
        By kind: the sensor's own values; tip deflections [m] in the sensor's direction, or
        loads [N] there, of its link held at the root and loaded at the tip.
    kind : {'value', 'deflection', 'load'}

    Raises
    ------
    StateError
        An unknown sensor or kind, or a sensor that does not see a load at the tip.

    Notes
    -----
    By the modes that the model has: the calibrated sensor then gives the deflection it was
    calibrated with, though their sum is not quite the static curve.
    """
    known = {found.name: found for found in robot.tree.sensors}
    if sensor not in known:
        raise StateError(f'sensor must be one of {", ".join(known) or "none"}, got {sensor!r}')
    if kind not in REFERENCES:
        raise StateError(f'reference must be one of {", ".join(REFERENCES)}, got {kind!r}')
    values = as_vector('reference', reference, np.shape(reference))
    if kind == 'value':
        return values
    section, own = robot.section(known[sensor].link)
    row = sensor_rows(robot)[list(known).index(sensor)][own]
    uy, uz = section.linear[1], section.linear[2]
    tip = uy if np.any(row[uy != 0.0]) else uz
    bent = tip / robot.stiffness[own]
    shown, moved = float(row @ bent), float(tip @ bent)
    if not moved > 0.0 or shown == 0.0:
        raise StateError(
            f'sensor {sensor!r} must respond to a load at the tip, got one that does not'
        )
    return np.asarray(values * (shown if kind == 'load' else shown / moved))


def calibration_paths(sensor: str, found: Calibration) -> dict[str, float]:
    """Return the overrides that put a calibration into a robot's description."""
    paths = {f'sensor.{sensor}.gain': found.gain, f'sensor.{sensor}.offset': found.offset}
    if math.isfinite(found.noise):
        paths[f'sensor.{sensor}.noise'] = found.noise
    return paths


def match_levels(plateaus: Plateaus, levels: Sequence[float]) -> Array:
    """Return levels, one per plateau in order.

    Raises
    ------
    IdentificationError
        As many plateaus as levels were not found.
    """
    if len(levels) != len(plateaus.means):
        shown = ', '.join(f'{mean:.4g}' for mean in plateaus.means)
        raise IdentificationError(
            f'plateaus must be as many as levels ({len(levels)}), got {len(plateaus.means)} '
            f'at {shown}'
        )
    return np.array(levels, dtype=np.float64)


# mounting of inertial sensors -------------------------------------------------------------------

ITERATIONS = 20
CLOSE = 1e-12  # rad, of a step that ends the iteration
# Of the spread of directions: the second greatest in terms of the greatest. Below it the record
# turns the sensor, and what it feels, about one axis only.
LEAST_SPREAD = 1e-3
DOUBTFUL_ANGLE = np.radians(1.0)
DOUBTFUL_TURN = np.radians(20.0)


@dataclass(frozen=True)
class Mounting:
    """Mounting of a sensor, and its bias."""

    rotation: Array  # (3, 3) the true axes seen from those that the file says
    # of that rotation [rad], and its standard deviation
    angle: float
    angle_error: float
    # (3,) along the true axes [rad/s, m/s^2]; of an accelerometer the first is zero
    gyro_bias: Array
    accel_bias: Array
    # (3,) standard deviations, for residuals that are independent of each other
    gyro_bias_error: Array
    accel_bias_error: Array
    # rms of what is left [rad/s, m/s^2]
    gyro_residual: float
    accel_residual: float
    doubts: tuple[str, ...]  # why the result may not be what it says


def calibrate_mounting(
    robot: Robot, sensor: str, q: Array, qd: Array, qdd: Array, readings: Array
) -> Mounting:
    """Return the mounting that explains a sensor's readings along a motion.

    Parameters
    ----------
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
    return _described(found[0].kind.vectors, rotation, bias, covariance, 1.0 / weights)


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


def _described(
    vectors: Sequence[str], rotation: Array, bias: Array, covariance: Array, residual: Array
) -> Mounting:
    """Result with its doubts; bias and residual are those of the vectors that are measured."""
    angle = float(np.linalg.norm(Rotation.from_matrix(rotation).as_rotvec()))
    errors = np.sqrt(np.diag(covariance))
    angle_error = float(np.linalg.norm(errors[:3]))
    doubts = []
    if angle_error > DOUBTFUL_ANGLE:
        doubts.append(f'the rotation must be certain to 1 deg, got {np.degrees(angle_error):.2g}')
    if angle > DOUBTFUL_TURN:
        doubts.append(f'the rotation must be a small one, got {np.degrees(angle):.3g} deg')
    of = {
        vector: (bias[k], errors[3 * k + 3 : 3 * k + 6], float(residual[k]))
        for k, vector in enumerate(vectors)
    }
    gyro, accel = (of.get(vector, (np.zeros(3), np.zeros(3), 0.0)) for vector in INERTIAL_UNITS)
    return Mounting(
        rotation, angle, angle_error, gyro[0], accel[0], gyro[1], accel[1], gyro[2], accel[2],
        tuple(doubts),
    )  # fmt: skip


def read_motion(
    path: str, robot: Robot, name: str, where: str
) -> tuple[Array, Array, Array, Array]:
    """Return motion and readings of a sensor out of a bag, as `calibrate_mounting` takes them.

    Parameters
    ----------
    path : str
        The bag, with joint states and the sensor's topic.
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
    numbers = inertial_numbers(sensor.kind.message, sensor.kind.vectors)
    stamp_ns, readings = read_numbers(path, sensor.topic, numbers)
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
    rising = without_turns(joints.rising(), robot.tree)
    t = 1e-9 * (rising.stamp_ns - begin)
    rates = rising.velocity
    motion = smooth(t, rising.position, rates if np.isfinite(rates).all() else None, cutoff=CUTOFF)
    at = 1e-9 * (stamp_ns[chosen] - begin)
    q, qd, qdd = (
        np.column_stack([np.interp(at, t, column) for column in part.T])
        for part in (motion.q, motion.qd, motion.qdd)
    )
    whole = np.zeros((3, len(at), robot.n))
    whole[0] = robot.static_deflection(q)
    whole[1][:, robot.joint_indices], whole[2][:, robot.joint_indices] = qd, qdd
    return whole[0], whole[1], whole[2], readings[chosen]
