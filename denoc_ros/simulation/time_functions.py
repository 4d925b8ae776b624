"""Torques, joint motions and motions of the base as functions of time, for `simulate`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from denoc_ros.dynamics.base.base_motion import BaseMotion
from denoc_ros.dynamics.base.reacting_base import ReactingBase
from denoc_ros.dynamics.robot import Robot
from denoc_ros.model.reading.poses import pose_of, rotation_rpy
from denoc_ros.simulation.equations_of_motion import Torque
from denoc_ros.trajectories import Trajectory
from denoc_ros.types import Array

SHIFTS = ('surge', 'sway', 'heave')  # m, along the world's x, y, z
TURNS = ('roll', 'pitch', 'yaw')  # rad, about x, then the turned y, then the turned z


@dataclass(frozen=True)
class Harmonic:
    """amplitude * sin(2 pi t / period + phase)."""

    amplitude: float  # m or rad
    period: float  # s
    phase: float = 0.0  # rad

    def __call__(self, t: float) -> tuple[float, float, float]:
        """Return value, rate and acceleration at a time [s]."""
        w = 2.0 * np.pi / self.period
        sine, cosine = np.sin(w * t + self.phase), np.cos(w * t + self.phase)
        return self.amplitude * sine, self.amplitude * w * cosine, -self.amplitude * w * w * sine


class SwayingBase:
    """The motion of a base by harmonics of its position and of roll, pitch and yaw.

    Parameters
    ----------
    motions : mapping of str to Harmonic
        Of `SHIFTS` and `TURNS`; what is not named stays zero.
    """

    def __init__(self, motions: Mapping[str, Harmonic]) -> None:
        still = Harmonic(0.0, 1.0)
        self._motions = [motions.get(name, still) for name in (*SHIFTS, *TURNS)]

    def __call__(self, t: float) -> BaseMotion:
        """Return twist, acceleration and pose at a time [s]."""
        place, rate, up = np.array([motion(t) for motion in self._motions]).T
        turn = rotation_rpy(place[3:])
        spin, grow = _turning(place[3:], rate[3:], up[3:])
        twist = np.concatenate([rate[:3] @ turn, spin])
        acceleration = np.concatenate([up[:3] @ turn, grow])
        return BaseMotion(twist, acceleration, pose_of(place[:3], turn))


def _turning(angles: Array, rates: Array, up: Array) -> tuple[Array, Array]:
    """Return angular velocity and acceleration in base axes of roll, pitch and yaw."""
    (ca, cb, _), (sa, sb, _) = np.cos(angles), np.sin(angles)
    a, b, _ = rates
    axes = np.array([[1.0, 0.0, -sb], [0.0, ca, cb * sa], [0.0, -sa, cb * ca]])
    change = np.array(
        [
            [0.0, 0.0, -b * cb],
            [0.0, -a * sa, -b * sb * sa + a * cb * ca],
            [0.0, -a * ca, -b * sb * ca - a * cb * sa],
        ]
    )
    return axes @ rates, axes @ up + change @ rates


class TimeFunction:
    """A trajectory as a function `t -> (q, qd, qdd)`, each (joints,), reused between calls."""

    def __init__(self, trajectory: Trajectory) -> None:
        self._trajectory = trajectory
        self._time = math.nan
        self._sample = np.zeros((3, trajectory.n))

    def __call__(self, t: float) -> tuple[Array, Array, Array]:
        """Return position, rate and acceleration at a time [s]."""
        q, qd, qdd = self._sample
        if t != self._time:
            self._trajectory.sample(t, q, qd, qdd)
            self._time = t
        return q, qd, qdd


def of_joint(law: TimeFunction, index: int) -> Callable[[float], tuple[float, float, float]]:
    """Return one joint's part of a law."""

    def motion(t: float) -> tuple[float, float, float]:
        q, qd, qdd = law(t)
        return float(q[index]), float(qd[index]), float(qdd[index])

    return motion


@dataclass(frozen=True)
class SpinUp:
    """A joint's rate rises smoothly from 0 over `time` [s] to `rate` [rad/s] and stays (eq. 3.55).

    Notes
    -----
    qd = rate / time (t - time / (2 pi) sin(2 pi t / time)) for t <= time.
    """

    rate: float
    time: float

    def __call__(self, t: float) -> tuple[float, float, float]:
        """Return position, rate and acceleration at a time [s]."""
        if t > self.time:
            return self.rate * (t - 0.5 * self.time), self.rate, 0.0
        slope, omega = self.rate / self.time, 2.0 * math.pi / self.time
        sine, cosine = math.sin(omega * t), math.cos(omega * t)
        return (
            slope * (0.5 * t * t + (cosine - 1.0) / omega**2),
            slope * (t - sine / omega),
            slope * (1.0 - cosine),
        )


def step_torque(robot: Robot, height: Mapping[str, float]) -> Torque:
    """Return constant torques [N m, N] at joints, by name; zero at the others."""
    tau = np.zeros(robot.n)
    for name, value in height.items():
        tau[robot.joint_indices[robot.joint_names.index(name)]] = value

    def torque(_t: float, _q: Array, _qd: Array) -> Array:
        return tau

    return torque


def rigid_torque(robot: Robot, reference: Trajectory) -> Torque:
    """Return the torques with which the robot, its links taken as rigid, follows a reference.

    The scheme of fig. 3.3: what comes of them in the flexible robot shows what flexibility does.
    The joint rows of inverse dynamics with all amplitudes at rest are the rigid robot's. A base
    that floats reacts.
    """
    model = robot.copy()
    joints = np.asarray(robot.joint_indices)
    law = TimeFunction(reference)
    q, qd, qdd = np.zeros((3, robot.n))
    needed, tau = np.zeros(robot.n), np.zeros(robot.n)
    base = ReactingBase(model)

    def torque(t: float, _q: Array, _qd: Array) -> Array:
        q[joints], qd[joints], qdd[joints] = law(t)
        if base.floats:
            base.rates(q, qd)
            base.accelerations(q, qd, qdd)
        model.inverse_dynamics(q, qd, qdd, out=needed, check=False)
        tau[joints] = needed[joints]
        return tau

    return torque


def rigid_robot(robot: Robot) -> Robot:
    """Return the robot with all of its links taken as rigid: its coordinates are the joints."""
    modes = {
        f'beam.{body.name}.{direction}.modes': 0
        for body in robot.tree.bodies
        if body.beam is not None and body.segment == 1
        for direction in ('y', 'z', 'torsion')
        if getattr(body.beam, direction) is not None
    }
    return robot.with_overrides(modes)


def rigid_loop_torque(robot: Robot, reference: Trajectory, actuated: Sequence[str]) -> Torque:
    """Return the torques of actuated joints with which the robot, rigid, follows a reference.

    As :func:`rigid_torque`, for a robot with loops (section 5.5): passive joints get none. The
    reference is of all joints and keeps the loops closed.
    """
    model = rigid_robot(robot)
    places = [robot.joint_names.index(name) for name in actuated]
    driven = np.asarray(robot.joint_indices)[places]
    law = TimeFunction(reference)
    tau = np.zeros(robot.n)

    def torque(t: float, _q: Array, _qd: Array) -> Array:
        q, qd, qdd = law(t)
        needed, _, _ = model.constrained_hybrid_dynamics(q, qd, qdd[places], actuated)
        tau[driven] = needed
        return tau

    return torque


class SampledTorque:
    """Torques that are known only every so often, as a controller or a file gives them.

    Parameters
    ----------
    torque : callable
        `(t, q, qd) -> (n,)` whose result depends on time only [N m, N].
    every : float
        s between entries.
    between : str
        `hold` (the last entry) or `linear`.
    """

    def __init__(self, torque: Torque, every: float, between: str) -> None:
        self._torque = torque
        self._every = every
        self._linear = between == 'linear'
        self._entries: dict[int, Array] = {}

    def __call__(self, t: float, q: Array, qd: Array) -> Array:
        """Return the torques (n,) at a time [s]."""
        place = t / self._every
        # an entry begins at its own time, not a rounding later
        k = math.floor(place + 1e-9)
        entry = self._entry(k, q, qd)
        if not self._linear:
            return entry
        share = max(0.0, place - k)
        return entry + share * (self._entry(k + 1, q, qd) - entry)

    def _entry(self, k: int, q: Array, qd: Array) -> Array:
        if k not in self._entries:
            self._entries[k] = self._torque(k * self._every, q, qd).copy()
        return self._entries[k]
