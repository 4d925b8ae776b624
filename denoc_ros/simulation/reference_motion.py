"""The `reference` of a configuration or scenario, and motions along a circle, as trajectories."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from denoc_ros.dynamics.assembling import least_change
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError, SolverError
from denoc_ros.model.reading.mapping_reader import MappingReader
from denoc_ros.trajectories import (
    CycloidalTrajectory,
    SineTrajectory,
    SplineTrajectory,
    Trajectory,
)
from denoc_ros.types import Array

KNOTS = 120  # per turn: quintics between them are true to 1e-9 of the radius
CLOSED = 1e-11  # m, rad
ITERATIONS = 50
KEYS = {
    'book': {'start', 'rate', 'period', 'form', 'duration'},
    'sine': {'start', 'amplitude', 'frequency', 'phase', 'duration', 'ramp'},
    'points': {'times', 'positions', 'velocities', 'accelerations'},
}
NEEDED = {
    'book': ('rate', 'period'),
    'sine': ('amplitude', 'frequency', 'duration'),
    'points': ('times', 'positions'),
}


@dataclass(frozen=True)
class Circle:
    """A circle in the base frame's X-Y directions, from rest to rest (eq. 4.1's law of time).

    phase = start + 2 pi turns (s - sin(2 pi s) / (2 pi)), s = t / duration.
    """

    frame: str
    centre: Array  # (3,) m, base frame
    radius: float  # m
    duration: float  # s
    start: float = 0.0  # rad
    turns: float = 1.0

    def sample(self, t: float) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration (3,) at a time [s]."""
        w = 2.0 * np.pi / self.duration
        rate = self.turns * w * (1.0 - np.cos(w * t))
        angle = self.start + self.turns * (w * t - np.sin(w * t))
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        along = np.array([-out[1], out[0], 0.0])
        bend = self.turns * w * w * np.sin(w * t)
        r = self.radius
        return self.centre + r * out, r * rate * along, r * (bend * along - rate * rate * out)


def follow(robot: Robot, circle: Circle, guess: Array) -> SplineTrajectory:
    """Return the joints' motion with which a rigid robot carries a frame along a circle.

    Parameters
    ----------
    robot : Robot
        All of its coordinates are joints.
    circle : Circle
        The frame keeps the directions that it has at the guess.
    guess : (n,) array
        Near the start.

    Raises
    ------
    SolverError
        A point is out of reach.
    """
    directions = robot.frame_pose(circle.frame, guess)[:3, :3]
    times = np.linspace(0.0, circle.duration, round(KNOTS * max(1.0, circle.turns)) + 1)
    q, qd, qdd = np.zeros((3, len(times), robot.n))
    near = guess
    for k, t in enumerate(times):
        point, velocity, acceleration = circle.sample(float(t))
        near = q[k] = _reach(robot, circle.frame, point, directions, near)
        rows = _rows(robot, circle.frame, near)
        none = np.zeros(len(rows) - 6)
        turning = np.zeros(3)
        qd[k] = least_change(np.concatenate([none, velocity, turning]), rows)
        turned = robot.frame_motion(circle.frame, near, qd[k])[1]
        bias = np.concatenate([robot.closure_bias(near, qd[k]), turned])
        qdd[k] = least_change(np.concatenate([none, acceleration, turning]) - bias, rows)
    return SplineTrajectory(times, q, qd, qdd)


def _rows(robot: Robot, frame: str, q: Array) -> Array:
    return np.vstack([robot.closure_jacobian(q), robot.frame_jacobian(frame, q)])


def _reach(robot: Robot, frame: str, point: Array, directions: Array, guess: Array) -> Array:
    """Return a closed configuration with the frame at a point, by Gauss-Newton steps."""
    q: Array = guess.copy()
    for _ in range(ITERATIONS):
        pose = robot.frame_pose(frame, q)
        turn = directions @ pose[:3, :3].T
        twist = 0.5 * np.array(
            [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
        )
        wanted = np.concatenate([-robot.closure(q), point - pose[:3, 3], twist])
        if np.max(np.abs(wanted)) <= CLOSED:
            return q
        q += least_change(wanted, _rows(robot, frame, q))
    raise SolverError(
        f'simulate: frame {frame!r} must reach {np.round(point, 6).tolist()} m with its '
        f'directions kept, got no closer than {np.max(np.abs(wanted)):.3g} m or rad'
    )


def trajectory_from_config(
    values: Mapping[str, Any], joints: Sequence[str], where: str = 'reference'
) -> Trajectory:
    """Return the trajectory of a `reference` mapping, for `joints` in their order.

    Parameters
    ----------
    values : mapping
        `kind` (book, sine or points), its keys, and optionally `joints`: the names that the
        numbers are for; the others stay at 0. A single number holds for all joints.
    joints : sequence of str
        The robot's joints.
    where : str
        Named in errors.

    Raises
    ------
    ConfigError
        With every finding.
    """
    kind = values.get('kind')
    if kind not in KEYS:
        raise ConfigError(where, [f'kind must be one of {", ".join(KEYS)}, got {kind!r}'])
    reader = _Reader(values, joints, KEYS[kind], NEEDED[kind])
    make = {'book': _book, 'sine': _sine, 'points': _points}[kind]
    trajectory = None if reader.findings else make(reader)
    if trajectory is None:
        raise ConfigError(where, reader.findings)
    return trajectory


def _book(reader: _Reader) -> Trajectory | None:
    start, rate = reader.column('start', 0.0), reader.column('rate', 0.0)
    period = reader.column('period', 1.0, positive=True)
    form, duration = reader.form(), reader.number('duration')
    if reader.findings:
        return None
    return CycloidalTrajectory(start, rate, period, form, duration)


def _sine(reader: _Reader) -> Trajectory | None:
    columns = [reader.column(key, 0.0) for key in ('start', 'amplitude', 'frequency', 'phase')]
    duration, ramp = reader.number('duration'), reader.number('ramp')
    if reader.findings or duration is None:
        return None
    return SineTrajectory(columns[0], columns[1], columns[2], columns[3], duration, ramp)


def _points(reader: _Reader) -> Trajectory | None:
    times = reader.times()
    positions, velocities, accelerations = (
        reader.rows(key) for key in ('positions', 'velocities', 'accelerations')
    )
    if reader.findings or positions is None:
        return None
    return SplineTrajectory(times, positions, velocities, accelerations)


class _Reader(MappingReader):
    """Reads a mapping's numbers into joint order."""

    def __init__(
        self,
        values: Mapping[str, Any],
        joints: Sequence[str],
        keys: set[str],
        needed: Sequence[str],
    ) -> None:
        super().__init__()
        self._values = values
        self._n = len(joints)
        given = values.get('joints', list(joints))
        unknown = [name for name in given if name not in joints]
        if unknown or len(set(given)) != len(given):
            self.find(f'joints must be different ones of {list(joints)}, got {given}')
        else:
            self._places = [list(joints).index(name) for name in given]
        for key in values:
            if key not in keys | {'kind', 'joints'}:
                self.fail('keys', f'be of {sorted(keys)}', key)
        for key in needed:
            if key not in values:
                self.find(f'{key} must be given')

    def _numbers(self, key: str, value: Any) -> Array | None:
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.array(np.nan)
        if np.isfinite(array).all():
            return array
        self.fail(key, 'be finite numbers', value)
        return None

    def column(self, key: str, default: float, positive: bool = False) -> Array:
        result = np.full(self._n, default)
        value = self._numbers(key, self._values.get(key, default))
        if value is None:
            return result
        if value.shape not in ((), (len(self._places),)):
            self.find(
                f'{key} must be a number or {len(self._places)} numbers, got {value.tolist()}'
            )
        elif positive and (value <= 0.0).any():
            self.find(f'{key} must be > 0 s, got {value.tolist()}')
        else:
            result[self._places] = value
        return result

    def number(self, key: str) -> float | None:
        value = self._values.get(key)
        if value is None:
            return None
        array = self._numbers(key, value)
        if array is not None and (array.shape != () or array <= 0.0):
            self.fail(key, 'be a number > 0 s', value)
        return None if array is None or array.shape != () else float(array)

    def form(self) -> str:
        form = self._values.get('form', 'full')
        if form not in ('full', 'half'):
            self.fail('form', 'be full or half', form)
        return str(form)

    def times(self) -> Array:
        times = self._numbers('times', self._values['times'])
        if times is None:
            return np.zeros(1)
        if times.ndim != 1 or not len(times) or times[0] < 0.0 or (np.diff(times) <= 0.0).any():
            self.find(f'times must increase from >= 0 s, got {times.tolist()}')
            return np.zeros(1)
        return times

    def rows(self, key: str) -> Array | None:
        if key not in self._values:
            return None
        value = self._numbers(key, self._values[key])
        shape = (len(np.atleast_1d(self._values['times'])), len(self._places))
        if value is None or value.shape != shape:
            got = None if value is None else value.shape
            self.find(f'{key} must have the shape {shape} (points, joints), got {got}')
            return None
        result = np.zeros((shape[0], self._n))
        result[:, self._places] = value
        return result
