"""The player: a bag's joint states in real time, as measurement and as streamed reference."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.duration import Duration
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from scipy.interpolate import CubicSpline
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from denoc_ros.bags.joint_state import JointStateMessage
from denoc_ros.bags.series import read_joint_states
from denoc_ros.errors import BagError, DenocError
from denoc_ros.nodes.base import EVERY_MESSAGE
from denoc_ros.nodes.buffers import release_buffers
from denoc_ros.nodes.graph import leave_graph
from denoc_ros.nodes.messages import TrajectoryPointMessage
from denoc_ros.nodes.sockets import use_sockets
from denoc_ros.nodes.without_events import WithoutEvents
from denoc_ros.runtime.signals import SIGNALS, Interrupted
from denoc_ros.types import Array

LOOK = Duration(seconds=0.2)
DISCOVERY_TIMEOUT = 20.0  # s to wait for those who are to listen


@dataclass(frozen=True)
class RecordedMotion:
    """Joint states of a bag with accelerations, at strictly increasing stamps.

    Attributes
    ----------
    stamp_ns : (k,) int array
        As recorded [ns].
    names : tuple of str
        The n joints.
    position, velocity, acceleration, effort : (k, n) array
        rad or m, per s, per s^2, N m or N; effort is NaN where there is none.
    """

    stamp_ns: NDArray[np.int64]
    names: tuple[str, ...]
    position: Array
    velocity: Array
    acceleration: Array
    effort: Array


def read_motion(path: str | Path, topic: str = '/joint_states') -> RecordedMotion:
    """Read a bag's joint states and differentiate them.

    Parameters
    ----------
    path : path
        The bag.
    topic : str
        Of type sensor_msgs/JointState.

    Raises
    ------
    BagError
        When it cannot be read, or has fewer than four messages with all joints.

    Notes
    -----
    Accelerations are the derivative of the cubic spline (not-a-knot) through the recorded
    velocities over their stamps; velocities that were not recorded are the derivative of the same
    kind of spline through the positions. A message whose stamp is not later than the one before
    it is left out.
    """
    series = read_joint_states(path, topic)
    latest = np.maximum.accumulate(series.stamp_ns)
    later = np.concatenate(([True], series.stamp_ns[1:] > latest[:-1]))
    rows = later & np.isfinite(series.position).all(axis=1)
    if np.count_nonzero(rows) < 4:
        raise BagError(
            f'{path}: {topic} must have at least 4 messages with all joints, '
            f'got {np.count_nonzero(rows)}'
        )
    stamps = series.stamp_ns[rows]
    t = (stamps - stamps[0]) * 1e-9
    position, velocity = series.position[rows], series.velocity[rows]
    if not np.isfinite(velocity).all():
        velocity = CubicSpline(t, position)(t, 1)
    acceleration = CubicSpline(t, velocity)(t, 1)
    return RecordedMotion(
        stamps, series.names, position, velocity, acceleration, series.effort[rows]
    )


class Player(WithoutEvents):
    """Publishes a recorded motion on `joint_states` and, point by point, on `reference`.

    Stamps are the recorded ones moved to now by one constant, so that they stay exact.

    Parameters
    ----------
    motion : RecordedMotion
        What to publish.
    speed : float
        1 for real time, 2 for twice as fast; stamps are as for real time.
    """

    def __init__(self, motion: RecordedMotion, speed: float = 1.0) -> None:
        super().__init__('player')
        self._motion = motion
        self._speed = speed
        self._state = self.create_publisher(JointState, 'joint_states', EVERY_MESSAGE)
        self._reference = self.create_publisher(JointTrajectory, 'reference', EVERY_MESSAGE)
        fields = ['position', 'velocity']
        if np.isfinite(motion.effort).all():
            fields.append('effort')
        self._state_message = JointStateMessage(motion.names, fields)
        self._reference_message = TrajectoryPointMessage(motion.names)

    def play(self, listeners: Sequence[str] = ()) -> None:
        """Publish all messages, each at its time.

        Parameters
        ----------
        listeners : sequence of str
            Nodes that must have been found on both topics before the first message.

        Raises
        ------
        BagError
            When one of them does not listen.
        """
        self._wait_for(listeners)
        motion = self._motion
        start_ns = time.time_ns()
        since = (motion.stamp_ns - motion.stamp_ns[0]).tolist()
        begin = time.perf_counter()
        for k, elapsed_ns in enumerate(since):
            wait = begin + elapsed_ns * 1e-9 / self._speed - time.perf_counter()
            if wait > 0.0:
                time.sleep(wait)
            self._publish(k, start_ns + elapsed_ns)
        for publisher in (self._state, self._reference):
            while not publisher.wait_for_all_acked(LOOK):
                pass  # a signal has its turn between two looks

    def _publish(self, k: int, stamp_ns: int) -> None:
        state, point, motion = self._state_message, self._reference_message, self._motion
        state.position[:] = motion.position[k]
        state.velocity[:] = motion.velocity[k]
        if len(state.effort):
            state.effort[:] = motion.effort[k]
        point.positions[:] = motion.position[k]
        point.velocities[:] = motion.velocity[k]
        point.accelerations[:] = motion.acceleration[k]
        state.stamp(stamp_ns)
        point.stamp(stamp_ns)
        self._state.publish(state.bytes())
        self._reference.publish(point.bytes())

    def _wait_for(self, listeners: Sequence[str]) -> None:
        end = time.perf_counter() + DISCOVERY_TIMEOUT
        while missing := self._missing(listeners):
            if time.perf_counter() > end:
                raise BagError(f'player: {", ".join(missing)} must subscribe, got no subscriber')
            time.sleep(0.05)

    def _missing(self, listeners: Sequence[str]) -> list[str]:
        """Return which of the listeners still lack a connection to one of the topics."""
        missing: set[str] = set()
        for publisher in (self._state, self._reference):
            found = self.get_subscriptions_info_by_topic(publisher.topic)
            absent = set(listeners) - {info.node_name for info in found}
            # known is not yet connected: before that a message would be lost
            unconnected = publisher.get_subscription_count() < len(found)
            missing |= absent or (set(listeners) if unconnected else set())
        return sorted(missing)


def own_arguments(given: Sequence[str]) -> list[str]:
    """Return the words of a command line that are not for ROS."""
    return list(remove_ros_args(given))


def run(
    bag: Path, topic: str, speed: float, listeners: Sequence[str], arguments: Sequence[str]
) -> int:
    """Play a bag until it is over or a signal comes; return the exit status.

    Parameters
    ----------
    bag, topic, speed, listeners
        As of :func:`read_motion`, :class:`Player` and its `play`.
    arguments : sequence of str
        Command line, whose part for ROS counts.
    """
    SIGNALS.keep()
    use_sockets()
    release_buffers()  # whose heartbeat tells when all has arrived
    rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    player: Player | None = None
    try:
        with SIGNALS.interrupting():
            player = Player(read_motion(bag, topic), speed)
            player.play(listeners)
    except DenocError as error:
        print(f'player: {error}', file=sys.stderr)
        return 1
    except Interrupted:
        return 0
    finally:
        if player is not None:
            player.destroy_node()
        leave_graph()
    return 0
