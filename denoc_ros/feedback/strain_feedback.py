"""Damping torque from strain gauges, for a node that commands torque."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError
from denoc_ros.feedback.strain_damping import StrainDamping
from denoc_ros.runtime.parameters.parameter_table import Settings
from denoc_ros.types import Array

DELAY = 1.5  # periods from a gauge's value to the torque: sampling, transport and half a hold


class StrainFeedback:
    """Adds the torque of :class:`denoc_ros.feedback.strain_damping.StrainDamping`."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._damping: StrainDamping | None = None

    @property
    def wanted(self) -> bool:
        """Whether there is a gain."""
        return self._damping is not None

    def build(
        self, robot: Robot, joints: Sequence[str], settings: Settings, limits: Array
    ) -> None:
        """Take a robot over; with gains, show that they dissipate.

        Raises
        ------
        ConfigError
            A gain without an effort limit, or for another number of joints.
        StateError
            The torque would not dissipate, or a gauge is missing.
        """
        gains = settings.numbers('feedback.strain_gain')
        if not any(gains):
            self._damping = None
            return
        name = self._name
        if len(gains) != len(joints):
            rule = f'must have {len(joints)} elements ({", ".join(joints)})'
            raise ConfigError(name, [f"parameter 'feedback.strain_gain' {rule}, got {len(gains)}"])
        most = settings.number('feedback.strain_limit') * limits
        if not np.isfinite(most[np.flatnonzero(gains)]).all():
            rule = "parameter 'feedback.strain_gain' must come with finite effort limits"
            raise ConfigError(name, [f'{rule}, got {limits.tolist()}'])
        delay = DELAY / settings.number('update_rate')
        cutoff = settings.number('feedback.cutoff')
        damping = StrainDamping(robot, joints, gains, most, cutoff, delay)
        self._timeout = settings.number('joint_state_timeout')
        count = len(robot.tree.sensors)
        self._values, self._times = np.full(count, np.nan), np.full(count, -np.inf)
        self._last = -np.inf
        self._damping = damping

    def take(self, place: int, taken: float, value: float) -> None:
        """Take a calibrated value of one of the robot's sensors, measured at a time [s]."""
        self._values[place], self._times[place] = value, taken

    def add(self, torque: Array, now: float) -> Array:
        """Return a torque (n,) with the damping at a time of the steady clock [s]."""
        damping = self._damping
        if damping is None:
            return torque
        self._values[now - self._times > self._timeout] = np.nan
        elapsed, self._last = now - self._last, now
        if elapsed > self._timeout:
            damping.reset()
            elapsed = 0.0
        return np.asarray(torque + damping.torque(self._values[damping.places], elapsed))
