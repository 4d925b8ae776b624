"""Predicted channels of the recording of a motion that has not been driven yet."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy.interpolate import CubicSpline

from denoc_ros.dynamics.constrained_dynamics import mimic_ties
from denoc_ros.dynamics.driven.measured_side import MotorSide
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.errors import ConfigError
from denoc_ros.identification.model.free_parameters import FreeParameters, SearchPoint
from denoc_ros.model.beams.segments import whole_beams
from denoc_ros.types import Array

FEWEST_HARMONICS = 3  # harmonics: fewer leave nothing free beside the rest at the ends
WHERE = 'identify excite'
SHARE_OF_LIMIT = 1e-2  # of a joint's effort limit: the noise of its measured effort, not given
SHARE_OF_LARGEST = 2e-2  # the same of the largest torque, where a joint has no effort limit
STEP = 1e-4  # of the differences by theta


@dataclass(frozen=True)
class MotionRows:
    """A motion of k rows."""

    t: Array  # (k,) [s]
    # (k, joints) [rad, m], and per s, per s^2
    q: Array
    qd: Array
    qdd: Array


def waves(times: Array, duration: float, harmonics: int, derivative: int = 0) -> Array:
    """Return sin(j w t) and cos(j w t) - 1, w = 2 pi / duration: (k times, 2 harmonics)."""
    rate = 2.0 * np.pi / duration * np.arange(1.0, harmonics + 1)
    angle = np.outer(times, rate) + 0.5 * np.pi * derivative
    both = [np.sin(angle), np.cos(angle) - (derivative == 0)]
    return np.hstack(both) * np.tile(rate**derivative, 2)


class RestSeries:
    """Sums of s_k sin(k w t) + c_k (cos(k w t) - 1), w = 2 pi / duration, at rest at both ends.

    Velocity, acceleration and jerk are 0 at both ends, so that flexible links start without a
    jolt: sum k s_k = 0, sum k^3 s_k = 0, sum k^2 c_k = 0. The motion ends where it begins.

    Parameters
    ----------
    harmonics : int
        At least 3.

    Attributes
    ----------
    free : int
        Coefficients of each joint that are free: 2 harmonics - 3. Each alone has a peak velocity
        of 1 per s.

    Notes
    -----
    Finite Fourier series as excitation: J. Swevers et al., Optimal robot excitation and
    identification, IEEE Transactions on Robotics and Automation 13, 1997.
    """

    def __init__(self, duration: float, harmonics: int) -> None:
        self.duration = float(duration)
        self.harmonics = int(harmonics)
        k = np.arange(1, harmonics + 1, dtype=np.float64)
        sines = scipy.linalg.null_space(np.array([k, k**3 / harmonics**2]))
        cosines = scipy.linalg.null_space(k[None, :] ** 2)
        self._basis = scipy.linalg.block_diag(sines, cosines)
        self.free = self._basis.shape[1]
        t = np.linspace(0.0, self.duration, 64 * harmonics + 1)
        self._basis = self._basis / np.abs(self.design(t, 1)).max(axis=0)

    def design(self, times: Array, derivative: int = 0) -> Array:
        """Basis functions of the free coefficients at times (k,) in [0, duration]: (k, free)."""
        columns: Array = waves(times, self.duration, self.harmonics, derivative) @ self._basis
        return columns

    def coefficients(self, free: Array) -> tuple[Array, Array]:
        """Return s_k and c_k (harmonics, joints) of free coefficients (free, joints)."""
        both = self._basis @ free
        return both[: self.harmonics], both[self.harmonics :]

    def rows(self, free: Array, start: Array, times: Array) -> MotionRows:
        """Return the motion of free coefficients (free, joints) about a start (joints,)."""
        q, qd, qdd = (self.design(times, order) @ free for order in range(3))
        return MotionRows(times, q + start, qd, qdd)


@dataclass(frozen=True)
class Response:
    """Response of a robot to a motion of k rows."""

    effort: Array  # (k, driven) as joint states have it [N m, N]
    # (k, driven) of the motors: more, where joints are measured behind their springs [N m, N]
    drive: Array
    sensors: Array  # (k, sensors) raw readings
    inertial: Array  # (k, values) of IMUs and accelerometers, one after another [rad/s, m/s^2]
    deflection: Array  # (k, flexible links) of the tips across their axes [m]


class PrescribedRobot:
    """A robot that is led along motions of its joints; the amplitudes follow from equilibrium.

    Parameters
    ----------
    robot : Robot
        Without loops; mimic joints follow their leaders.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot.copy()
        self._ties, self._offsets, self.joints = mimic_ties(robot, None, {})
        self._stepper = Stepper(robot.copy(), 1.0)
        self._motors = MotorSide(robot, self.joints)
        self.every_joint = tuple(robot.joint_names)
        joints = robot.tree.joints.items()
        self.units = {name: (joint.unit, joint.effort_unit) for name, joint in joints}
        self.links = tuple(beam.link for beam in whole_beams(robot.tree))
        self._tips = [robot.section(link) for link in self.links]
        self._free = np.setdiff1d(np.arange(robot.n), robot.joint_indices)

    def every(self, rows: MotionRows) -> MotionRows:
        """Return the motion of all joints by that of the driven ones."""
        ties = self._ties.T
        return MotionRows(rows.t, rows.q @ ties + self._offsets, rows.qd @ ties, rows.qdd @ ties)

    def response(self, rows: MotionRows) -> Response:
        """Return effort, readings and deflection at even rows of the driven joints."""
        robot, every = self._robot, self.every(rows)
        bends = len(robot.flexible_indices) > 0
        q, qd = self._states(every, bends)
        qdd = np.zeros_like(q)
        qdd[:, robot.joint_indices] = every.qdd
        if bends:
            torque, qdd[:, self._free] = robot.hybrid_dynamics(q, qd, every.qdd)
        else:
            torque = robot.inverse_dynamics(q, qd, qdd)[:, robot.joint_indices]
        values = robot.beam_sensor_values(q, qd, qdd)
        for k, sensor in enumerate(robot.tree.sensors):
            values[:, k] = (values[:, k] - sensor.offset) / sensor.gain
        tips = [np.hypot(*tip.deflection(q[:, own])[:, 1:3].T) for tip, own in self._tips]
        bent = np.column_stack(tips) if tips else np.zeros((len(q), 0))
        inertial = np.zeros((len(q), 0))
        if robot.tree.inertial_sensors:
            inertial = robot.sensor_values(q, qd, qdd)[:, robot.tree.inertial_sensors[0].first :]
        effort = torque @ self._ties
        drive = self._motors.driven_by(effort, (rows.qd, rows.qdd))
        return Response(effort, drive, values, inertial, bent)

    def slopes(self, rows: MotionRows, paths: list[str]) -> Array:
        """Return the derivatives of a rigid robot's effort by its parameters (k, driven, p)."""
        robot, every = self._robot, self.every(rows)
        states = np.zeros((3, len(rows.t), robot.n))
        for state, part in zip(states, (every.q, every.qd, every.qdd), strict=True):
            state[:, robot.joint_indices] = part
        columns = robot.torque_regressor(states[0], states[1], states[2], paths)
        found: Array = np.einsum('kjp,jd->kdp', columns[:, robot.joint_indices], self._ties)
        return found

    def _states(self, every: MotionRows, bends: bool) -> tuple[Array, Array]:
        """Return coordinates and rates (k, n) with the amplitudes."""
        robot, index = self._robot, self._robot.joint_indices
        count = len(every.t)
        states, rates = np.zeros((2, count, robot.n))
        states[:, index], rates[:, index] = every.q, every.qd
        if not bends:
            return states, rates
        q, qd = robot.static_deflection(every.q[0]), np.zeros(robot.n)
        self._stepper.step = float(every.t[1] - every.t[0])
        middle = 0.5 * (every.qdd[1:] + every.qdd[:-1])
        driven = self._stepper.driven
        free = self._free
        for k in range(count):
            q[index], qd[index] = every.q[k], every.qd[k]
            states[k, free], rates[k, free] = q[free], qd[free]
            if k + 1 < count:
                driven(q, qd, middle[k])
        return states, rates


class ExcitedChannels:
    """Sensitivities of all channels by the free numbers, in the channels' noise.

    Parameters
    ----------
    noise : dict of str to float
        Deviation of one sample of each channel: `effort.<joint>` [N m, N], `<sensor>` in the unit
        of its value, `<imu>.gyro` [rad/s] and `<imu>.accel` [m/s^2]; infinite: not recorded.
    rate : float
        Of recording [Hz].
    """

    def __init__(
        self,
        along: PrescribedRobot,
        parameters: FreeParameters,
        noise: Mapping[str, float],
        rate: float,
    ) -> None:
        self.along, self.parameters, self.rate = along, parameters, rate
        sensors = parameters.robot.tree.sensors
        self.noise = dict(noise)
        self._effort_noise = np.array([noise[f'effort.{joint}'] for joint in along.joints])
        self._sensor_noise = np.array([noise[s.name] / abs(s.gain) for s in sensors])
        self._names = [sensor.name for sensor in sensors]
        self._parts = [
            (each.name, part) for each in parameters.robot.tree.inertial_sensors
            for part in each.parts
        ]  # fmt: skip
        self._inertial_noise = np.array(
            [noise[f'{name}.{part.partition("_")[0]}'] for name, part in self._parts]
        )
        linear, self._paths = parameters.linear(set(parameters.robot.joint_names))
        self._linear, self._slopes = linear, parameters.slopes(np.zeros(parameters.size))
        self._others = sorted(set(range(parameters.size)) - set(linear))
        self._sides: dict[tuple[int, float], tuple[PrescribedRobot, SearchPoint]] = {}
        self.evaluations = 0

    def whitened(self, along: PrescribedRobot, point: SearchPoint, rows: MotionRows) -> Array:
        """Return all channels (k, channels), in deviations of so many samples."""
        self.evaluations += 1
        response = along.response(rows)
        gains = [point.gains.get(joint, 1.0) for joint in along.joints]
        offsets = [point.offsets.get(joint, 0.0) for joint in along.joints]
        measured = response.effort * gains + offsets
        effort = _late(rows.t, measured, point.delays.get('effort', 0.0))
        sensors = response.sensors
        for k, name in enumerate(self._names):
            if name in point.delays:
                sensors[:, k] = _late(rows.t, sensors[:, k], point.delays[name])
        inertial = self._inertial(rows.t, response.inertial, point)
        found = np.hstack([effort / self._effort_noise, sensors / self._sensor_noise, inertial])
        return found * self._weight(rows)

    def _inertial(self, t: Array, values: Array, point: SearchPoint) -> Array:
        """Readings of IMUs and accelerometers (k, values), divided by their noise."""
        raw = values.copy()
        for k, (name, part) in enumerate(self._parts):
            offset = point.channels.get(f'sensor.{name}.offset.{part}', 0.0)
            gain = point.channels.get(f'sensor.{name}.gain.{part}', 1.0)
            raw[:, k] = (raw[:, k] - offset) / gain
            if name in point.delays:
                raw[:, k] = _late(t, raw[:, k], point.delays[name])
        return np.asarray(raw / self._inertial_noise)

    def jacobian(self, rows: MotionRows, both: bool = False) -> Array:
        """Return the derivatives of all channels by theta (k channels, parameters).

        Parameters
        ----------
        both : bool
            Differences to both sides: twice the work, squares of the error.
        """
        size = self.parameters.size
        width = len(self._effort_noise) + len(self._names) + len(self._parts)
        found = np.zeros((len(rows.t), width, size))
        if self._linear:
            self.evaluations += 1
            columns = self.along.slopes(rows, self._paths)
            turned = columns @ self._slopes[np.ix_(self._linear, self._linear)]
            joints = len(self._effort_noise)
            found[:, :joints, self._linear] = turned / self._effort_noise[:, None]
            found *= self._weight(rows)
        here = None
        for k in self._others:
            above = self.whitened(*self._side(k, STEP), rows)
            if both:
                below = self.whitened(*self._side(k, -STEP), rows)
                found[:, :, k] = (above - below) / (2.0 * STEP)
                continue
            here = self.whitened(*self._side(k, 0.0), rows) if here is None else here
            found[:, :, k] = (above - here) / STEP
        return found.reshape(-1, size)

    def _weight(self, rows: MotionRows) -> float:
        """Return the root of how many samples a row stands for."""
        return float(np.sqrt(self.rate * (rows.t[1] - rows.t[0])))

    def _side(self, k: int, change: float) -> tuple[PrescribedRobot, SearchPoint]:
        """Return the robot with one theta changed, or none by 0; made once."""
        if (k, change) not in self._sides:
            theta = np.zeros(self.parameters.size)
            theta[k] = change
            point = self.parameters.settings(theta)
            self._sides[k, change] = PrescribedRobot(self.parameters.robot_at(point)), point
        return self._sides[k, change]


def _late(t: Array, values: Array, delay: float) -> Array:
    """Return values (k, ...) as they come a delay [s] later."""
    if not delay:
        return values
    late: Array = CubicSpline(t, values)(t - delay)
    return late


def channel_noise(
    robot: Robot,
    joints: Iterable[str],
    given: Mapping[str, float],
    effort_limits: Mapping[str, float],
    largest: Mapping[str, float],
) -> dict[str, float]:
    """Return the deviation of one sample of each channel.

    Parameters
    ----------
    given : dict of str to float
        `effort` of all joints, `effort.<joint>`, `<sensor>`, `<imu>.gyro`, `<imu>.accel`;
        infinite: not recorded, as IMUs are whose description has no noise.
    effort_limits, largest : dict of str to float
        By joint: its effort limit (infinite: none), and the largest torque on motions tried.

    Raises
    ------
    ConfigError
        A channel that is none, a deviation that is not > 0; with every finding.
    """
    sensors = {sensor.name: sensor.noise for sensor in robot.tree.sensors}
    for each in robot.tree.inertial_sensors:
        for vector in sorted(each.kind.vectors):
            sensors[f'{each.name}.{vector}'] = getattr(each, f'{vector}_noise') or np.inf
    names = list(joints)
    known = ['effort', *(f'effort.{joint}' for joint in names), *sensors]
    findings = [
        f'noise must be of one of {", ".join(known)}, got {name!r}'
        for name in given
        if name not in known
    ]
    found: dict[str, float] = {}
    for joint in names:
        limit = effort_limits[joint]
        usual = SHARE_OF_LIMIT * limit if np.isfinite(limit) else SHARE_OF_LARGEST * largest[joint]
        found[f'effort.{joint}'] = given.get(f'effort.{joint}', given.get('effort', usual))
    found.update({name: given.get(name, noise) for name, noise in sensors.items()})
    findings += [
        f'noise of {name} must be > 0 (inf: not recorded), got {value}'
        for name, value in found.items()
        if not value > 0.0
    ]
    ConfigError.raise_any(WHERE, findings)
    return found
