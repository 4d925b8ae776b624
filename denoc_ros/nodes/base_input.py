"""The topic `base_motion`: how the robot's base moves, as an input of a node's loop."""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import AccelStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu

from denoc_ros.dynamics.base_motion import BaseMotion
from denoc_ros.estimation.base_track import BaseTrack
from denoc_ros.estimation.clock import StampClock
from denoc_ros.nodes.robot_node import RobotNode
from denoc_ros.runtime.base_messages import (
    BaseLimits,
    imu_mounting,
    read_accel,
    read_imu,
    read_odometry,
)
from denoc_ros.runtime.input_monitor import InputMonitor
from denoc_ros.runtime.shared_parameters import BASE_LIMITS
from denoc_ros.types import Array


class BaseInput:
    """The base's motion as messages say it.

    Parameters
    ----------
    node : RobotNode
        Its parameters `base_motion`, `base_motion_timeout` and `base_motion_cutoff` say how; it
        subscribes.
    """

    def __init__(self, node: RobotNode) -> None:
        self._node = node
        self.source = node.settings.text('base_motion')
        self._timeout = node.settings.number('base_motion_timeout')
        self._clock = StampClock()
        self._monitor: InputMonitor | None = None
        self._beside: InputMonitor | None = None
        rate, acceleration, angular = (
            node.settings.number(f'base_{what}_limit') for what, *_ in BASE_LIMITS
        )
        self._limits = BaseLimits(rate, acceleration, angular, self._timeout)
        self.track = BaseTrack(1.0, 1.0, np.zeros(3))

    @property
    def used(self) -> bool:
        """Whether the node listens to the base's motion."""
        return self.source != 'off'

    def build(self, gravity: Array) -> None:
        """Begin anew for a robot with its gravity (3,).

        Raises
        ------
        ConfigError
            The IMU's pose is not of three and three numbers, or there is no IMU.
        """
        settings, node = self._node.settings, self._node.get_fully_qualified_name()
        cutoff = settings.number('base_motion_cutoff')
        xyz, rpy = (settings.numbers(f'base_imu_{part}') for part in ('xyz', 'rpy'))
        mounting = imu_mounting(node, self.source, xyz, rpy)
        self.track = BaseTrack(cutoff, self._timeout, gravity, mounting)

    def connect(self) -> None:
        """Subscribe to the topic that the parameter names."""
        listen = self._node.listen_in_loop
        if self.source in ('odometry', 'odometry_accel'):
            self._monitor = listen(Odometry, 'base_motion', self._on_odometry)
        elif self.source == 'imu':
            self._monitor = listen(Imu, 'base_motion', self._on_imu)
        elif self.source == 'accel':
            self._monitor = listen(AccelStamped, 'base_motion', self._on_accel)
        if self.source == 'odometry_accel':
            self._beside = listen(AccelStamped, 'base_acceleration', self._on_accel)

    def begin(self) -> None:
        """Forget all messages before the loop starts."""
        self.track.reset()
        self._limits.forget()
        self._clock.reset()

    def trouble(self, now: float) -> str:
        """Return why the base's motion is not known, '' if it is or is not listened to."""
        if self.source == 'off':
            return ''
        for monitor, stale, missing in (
            (self._monitor, 'stale base_motion', 'no base_motion yet'),
            (self._beside, 'stale base_acceleration', 'no base_acceleration yet'),
        ):
            if monitor is not None and not monitor.age(now) <= self._timeout:
                return stale if monitor.received else missing
        return 'no base_motion yet' if self.track.at(now) is None else ''

    def at(self, time: float) -> BaseMotion | None:
        """Return the motion at a time of the steady clock [s]; None: at rest, for all we know."""
        return self.track.at(time) if self.used else None

    def _taken(self, monitor: InputMonitor | None, stamp_ns: int, now: float) -> float:
        """Admit a message; return when it was measured on the steady clock."""
        assert monitor is not None
        monitor.accept(stamp_ns, now)
        taken = self._clock.taken_at(1e-9 * stamp_ns, now, 1e-9 * self._node.stamp_ns_at(now))
        return taken if math.isfinite(taken) else now

    def _on_odometry(self, raw: bytes, now: float) -> None:
        stamp_ns, pose, twist = read_odometry(raw)
        measured = _measured(stamp_ns, now)
        self._limits.require(measured, twist)
        self.track.take_odometry(self._taken(self._monitor, stamp_ns, now), pose, twist)
        self._limits.took(measured, twist)

    def _on_accel(self, raw: bytes, now: float) -> None:
        stamp_ns, acceleration = read_accel(raw)
        self._limits.require(now, None, acceleration)
        alone = self._beside is None
        monitor = self._monitor if alone else self._beside
        self.track.take_acceleration(self._taken(monitor, stamp_ns, now), acceleration, alone)

    def _on_imu(self, raw: bytes, now: float) -> None:
        stamp_ns, rate, force = read_imu(raw)
        measured, twist = _measured(stamp_ns, now), np.concatenate((np.zeros(3), rate))
        self._limits.require(measured, twist, force)
        self.track.take_imu(self._taken(self._monitor, stamp_ns, now), rate, force)
        self._limits.took(measured, twist)


def _measured(stamp_ns: int, now: float) -> float:
    """Return when a reading was taken [s], for differences."""
    return 1e-9 * stamp_ns if stamp_ns else now
