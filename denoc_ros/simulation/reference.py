"""The `reference` of a configuration or scenario: read, checked, made a trajectory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from denoc_ros.errors import ConfigError
from denoc_ros.model.mapping_reader import MappingReader
from denoc_ros.trajectories import (
    CycloidalTrajectory,
    SineTrajectory,
    SplineTrajectory,
    Trajectory,
)
from denoc_ros.types import Array

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
                self.find(f'keys must be of {sorted(keys)}, got {key!r}')
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
        self.find(f'{key} must be finite numbers, got {value!r}')
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
            self.find(f'{key} must be a number > 0 s, got {value!r}')
        return None if array is None or array.shape != () else float(array)

    def form(self) -> str:
        form = self._values.get('form', 'full')
        if form not in ('full', 'half'):
            self.find(f'form must be full or half, got {form!r}')
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
