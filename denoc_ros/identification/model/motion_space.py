"""Motions of a Fourier series within limits of joints, effort and deflection."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from denoc_ros.dynamics.driven.joint_limits import JointLimits
from denoc_ros.errors import ConfigError, SolverError
from denoc_ros.identification.model.excited_channels import (
    WHERE,
    MotionRows,
    PrescribedRobot,
    Response,
    RestSeries,
)
from denoc_ros.types import Array

FULL = 0.995  # of a limit: what a motion may take of it, the rest is for rounding
TURN = np.pi  # rad or m: the room about the start of a joint without position limits
HALVINGS = 14
SAMPLES = 24  # per period of the highest harmonic, at least
UNITS = {'position': '', 'velocity': '/s', 'acceleration': '/s^2'}


@dataclass(frozen=True)
class Extreme:
    """The largest magnitude of something that has a limit."""

    what: str  # position, velocity, acceleration, effort or deflection
    name: str  # of the joint or link
    # value, limit: positions count from the middle of their range
    value: float
    limit: float
    unit: str


@dataclass(frozen=True)
class MotionLimits:
    """Limits of all joints, and of the flexible links' tips across their axes [m]; inf: none."""

    joints: JointLimits
    deflection: Array


class MotionSpace:
    """Motions by their free coefficients x, 0 at rest; about 1 where a joint is at its limit.

    Parameters
    ----------
    start : (driven,) array
        Where the motion begins and ends [rad, m].

    Raises
    ------
    ConfigError
        The robot is beyond a limit where it starts, at rest.
    """

    def __init__(
        self, along: PrescribedRobot, series: RestSeries, start: Array, limits: MotionLimits
    ) -> None:
        self.along, self.series, self.start, self._limits = along, series, start, limits
        self.size = series.free * len(start)
        names = along.every_joint
        own = [names.index(joint) for joint in along.joints]
        joints, half = limits.joints, limits.joints.room
        bounded = np.isfinite(half)
        every = along.every(MotionRows(np.zeros(1), start[None], *np.zeros((2, 1, len(start)))))
        self._middle = np.where(bounded, joints.middle, every.q[0])
        self._half = np.where(bounded, half, TURN)
        room = np.maximum(self._half[own] - np.abs(start - self._middle[own]), 0.1 * TURN)
        fastest = 2.0 * np.pi / series.duration * room
        self._unit = np.minimum(joints.velocity[own], fastest)
        self._own = own
        self.labels = self._labels(names)
        self._require_start()

    def _labels(self, names: tuple[str, ...]) -> tuple[tuple[str, str, float, str], ...]:
        """Limited quantities: kind, name, limit, unit."""
        joints, found = self._limits.joints, []
        units = [self.along.units[name] for name in names]
        for what, limit in (
            ('position', self._half),
            ('velocity', joints.velocity),
            ('acceleration', joints.acceleration),
        ):
            found += [
                (what, name, float(value), unit[0] + UNITS[what])
                for name, value, unit in zip(names, limit, units, strict=True)
            ]
        found += [('effort', names[k], float(joints.effort[k]), units[k][1]) for k in self._own]
        bent = zip(self.along.links, self._limits.deflection, strict=True)
        return (*found, *(('deflection', name, float(value), 'm') for name, value in bent))

    def _require_start(self) -> None:
        share = self.shares(np.zeros(self.size), self.times(0.1))[0]
        findings = [
            f'{what} of {name} must be within its limit at the start, at rest '
            f'({limit:.4g} {unit}), got {part:.3g} times that'
            for part, (what, name, limit, unit) in zip(np.abs(share), self.labels, strict=True)
            if part > FULL
        ]
        ConfigError.raise_any(WHERE, findings)

    def times(self, step: float) -> Array:
        """Return even times (k,) over the motion, so far apart at most [s]."""
        count = max(
            int(np.ceil(self.series.duration / step)), SAMPLES * (self.series.harmonics + 1)
        )
        times: Array = np.linspace(0.0, self.series.duration, count + 1)
        return times

    def free(self, x: Array) -> Array:
        """Return the series' free coefficients (free, driven)."""
        found: Array = x.reshape(self.series.free, -1) * self._unit
        return found

    def rows(self, x: Array, times: Array) -> MotionRows:
        """Return the motion at times (k,)."""
        return self.series.rows(self.free(x), self.start, times)

    def shares(self, x: Array, times: Array) -> Array:
        """Return all that has a limit, as signed shares of it (k, limits)."""
        rows = self.rows(x, times)
        return self._shares(rows, self.along.response(rows))

    def _shares(self, rows: MotionRows, response: Response) -> Array:
        every = self.along.every(rows)
        parts = [every.q - self._middle, every.qd, every.qdd, response.drive, response.deflection]
        limit = np.array([limit for _, _, limit, _ in self.labels])
        shares: Array = np.hstack(parts) / limit
        return shares

    def to_limits(self, x: Array, times: Array, most: float = np.inf) -> Array:
        """Return a motion scaled so that it just keeps all limits, by a factor at most."""

        def fits(factor: float) -> bool:
            try:
                return bool(np.abs(self.shares(factor * x, times)).max() <= FULL)
            except SolverError:  # bent beyond what a model of small deflections has
                return False

        low, high = 0.0, min(most, self._kinematic_factor(x, times))
        if fits(high):
            return high * x
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if fits(middle) else (low, middle)
        return low * x

    def _kinematic_factor(self, x: Array, times: Array) -> float:
        """Return a factor of x that surely is beyond a limit, or just keeps the joints' own."""
        every = self.along.every(self.rows(x, times))
        limits = self._limits.joints
        largest = max(
            float((np.abs(every.q - every.q[0]) / self._half).max()) / 2.0,
            float((np.abs(every.qd) / limits.velocity).max()),
            float((np.abs(every.qdd) / limits.acceleration).max()),
            1e-12,
        )
        return 1.0 / largest

    def extremes(self, x: Array, times: Array) -> tuple[Extreme, ...]:
        """Return the largest magnitude of all that has a limit."""
        largest = np.abs(self.shares(x, times)).max(axis=0)
        return tuple(
            Extreme(what, name, float(part * limit), limit, unit)
            for part, (what, name, limit, unit) in zip(largest, self.labels, strict=True)
            if np.isfinite(limit)
        )


def deflection_limits(
    along: PrescribedRobot, lengths: Mapping[str, float], share: float, given: Mapping[str, float]
) -> Array:
    """Return the limits of the tips' deflections (links,) [m].

    Parameters
    ----------
    lengths : dict of str to float
        Of the flexible links [m].
    share : float
        Of its length that a link may bend by.
    given : dict of str to float
        Limits of links [m] instead.

    Raises
    ------
    ConfigError
        A link that is none or rigid, a limit that is not > 0; with every finding.
    """
    findings = [
        f'deflection must be of one of {", ".join(along.links) or "no link: all are rigid"}, '
        f'got {link!r}'
        for link in given
        if link not in along.links
    ]
    findings += [
        f'deflection of {link} must be > 0 m, got {value}'
        for link, value in given.items()
        if not value > 0.0
    ]
    ConfigError.raise_any(WHERE, findings)
    return np.array([given.get(link, share * lengths[link]) for link in along.links])
