"""The player: a bag's joint states in real time, as measurement and as streamed reference.

With a clock it plays all that was recorded and nobody else publishes, as it is, by the recorded
time.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import islice
from pathlib import Path
from typing import Any

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
from denoc_ros.bags.reader import bag_contents, read_raw
from denoc_ros.bags.series import elapsed, read_joint_states
from denoc_ros.errors import BagError, DenocError
from denoc_ros.estimation.turns import unwrap_path
from denoc_ros.nodes.base.guarded_node import WithoutEvents, leave_graph
from denoc_ros.nodes.base.inputs import stamp_reader
from denoc_ros.nodes.base.messages import (
    EVERY_MESSAGE,
    LATCHED,
    TrajectoryPointMessage,
    message_class,
)
from denoc_ros.nodes.base.middleware import release_buffers, use_sockets
from denoc_ros.nodes.base.simulated_time import TimeSource
from denoc_ros.runtime.loop.ending import SIGNALS, Interrupted
from denoc_ros.terminal_text import say
from denoc_ros.types import Array

LOOK = Duration(seconds=0.2)
DISCOVERY_TIMEOUT = 20.0  # s to wait for those who are to listen
ANSWER_TIMEOUT = 10.0  # s of wall time that a listener may be silent
LATEST = 1_000_000_000  # ns between a message's stamp and its recording
OF_THE_MACHINE = ('/clock', '/diagnostics', '/rosout', '/parameter_events')


@dataclass(frozen=True)
class RecordedMotion:
    """Joint states of a bag with accelerations, at strictly increasing stamps."""

    stamp_ns: NDArray[np.int64]  # (k,) int as recorded [ns]
    names: tuple[str, ...]  # the n joints
    # (k, n) rad or m, per s, per s^2, N m or N; effort is NaN where there is none
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
    kind of spline through the positions, without jumps by a turn. A message whose stamp is not
    later than the one before it is left out.
    """
    series = read_joint_states(path, topic)
    rows = series.rising().complete()
    if len(rows.t) < 4:
        raise BagError(
            f'{path}: {topic} must have at least 4 messages with all joints, got {len(rows.t)}'
        )
    t = elapsed(rows.stamp_ns)
    # Without a robot any joint may be continuous: a step that is one turn too long is a turn.
    any_joint = np.ones(len(rows.names), dtype=bool)
    position, velocity = unwrap_path(t, rows.position, any_joint), rows.velocity
    if not np.isfinite(velocity).all():
        velocity = CubicSpline(t, position)(t, 1)
    acceleration = CubicSpline(t, velocity)(t, 1)
    return RecordedMotion(rows.stamp_ns, rows.names, position, velocity, acceleration, rows.effort)


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
        self._state.publish(state.bytes(stamp_ns))
        self._reference.publish(point.bytes(stamp_ns))

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


class ClockPlayer(WithoutEvents):
    """Publishes a bag's messages as they are, and `/clock` by the recorded stamps.

    Messages with a stamp are out before the clock shows it. Those without count from when they
    were recorded: they follow when the listeners have answered the time before. So a recording
    made in lockstep gives in listeners what the run gave.

    Parameters
    ----------
    bag : path
    topic : str
        Of the joint states, whose stamps are the times that the clock shows.
    speed : float
        Of the clock over wall time, at most.
    listeners : sequence of str
        Nodes that each step waits for, all with `use_sim_time`.

    Raises
    ------
    BagError
        The bag cannot be read, or has fewer than two joint states.
    """

    def __init__(
        self, bag: Path, topic: str, speed: float = 1.0, listeners: Sequence[str] = ()
    ) -> None:
        super().__init__('player')
        self._bag, self._topic, self._listeners = bag, topic, listeners
        # A publisher has one type: of a topic that was recorded with several, the first is played.
        self._types: dict[str, str] = {}
        for recorded in bag_contents(bag).topics:
            self._types.setdefault(recorded.name, recorded.type)
        first = [log_ns for _, _, log_ns, _ in islice(self._in_order([topic]), 2)]
        if len(first) < 2:
            raise BagError(f'{bag}: {topic} must have at least 2 messages, got {len(first)}')
        start_ns = max(0, 2 * first[0] - first[1])
        self.source = TimeSource(self, listeners, ANSWER_TIMEOUT, start_ns=start_ns)
        self.source.clock.factor = speed
        self._played: dict[str, Any] = {}

    def take_aside(self, subscription: Any) -> None:
        """Do nothing: no executor serves the player."""

    def play(self) -> None:
        """Publish all messages, each at its time.

        Raises
        ------
        BagError
            A listener does not answer.
        """
        self._wait_for_listeners()
        self._played = self._missing_publishers()
        self._wait_for_subscribers()
        now_ns, told = -1, True
        for is_late, topic, due_ns, raw in self._in_order(self._played):
            if (is_late or due_ns > now_ns) and not told:
                self.source.clock.tell()
                told = True
            if is_late:
                self._settle()
            elif topic == self._topic and due_ns > now_ns:
                now_ns, told = due_ns, False
                self._go_on(self.source.clock.moment(due_ns))
            self._played[topic].publish(raw)
        self.source.clock.tell()
        self._settle()

    def _in_order(self, topics: Collection[str]) -> Iterator[tuple[bool, str, int, bytes]]:
        """Yield whether a message follows the clock, its topic, time [ns] and bytes, by time."""
        readers: dict[str, Callable[[bytes], int]] = {}
        waiting: list[tuple[int, bool, int, str, bytes]] = []
        for count, (topic, kind, log_ns, raw) in enumerate(read_raw(self._bag, topics)):
            if kind != self._types[topic]:
                continue
            if topic not in readers:
                readers[topic] = stamp_reader(message_class(kind))
            stamp_ns = readers[topic](raw)
            is_late = stamp_ns == 0 or abs(log_ns - stamp_ns) > LATEST
            heappush(
                waiting,
                (log_ns if is_late else stamp_ns, is_late, count, topic, bytes(raw)),
            )
            while waiting[0][0] < log_ns - LATEST:
                due_ns, is_late, _, topic, raw = heappop(waiting)
                yield is_late, topic, due_ns, raw
        while waiting:
            due_ns, is_late, _, topic, raw = heappop(waiting)
            yield is_late, topic, due_ns, raw

    def _missing_publishers(self) -> dict[str, Any]:
        """Return publishers of the topics that nobody publishes."""
        time.sleep(LOOK.nanoseconds * 1e-9)  # those who are there make themselves known
        found = {}
        for recorded in bag_contents(self._bag).topics:
            if recorded.name in OF_THE_MACHINE or self.count_publishers(recorded.name):
                continue
            if recorded.type != self._types[recorded.name]:
                continue
            latched = any(profile.durability == LATCHED.durability for profile in recorded.qos)
            qos = LATCHED if latched else EVERY_MESSAGE
            found[recorded.name] = self.create_publisher(
                message_class(recorded.type), recorded.name, qos
            )
        if self._topic not in found:
            raise BagError(f'{self._topic} must have no publisher but the player, got another')
        return found

    def _wait_for_listeners(self) -> None:
        """Wait until all listeners have answered the time before the first message."""
        end = time.perf_counter() + DISCOVERY_TIMEOUT
        now_ns = self.source.clock.now_ns()
        while not self.source.may_leave(now_ns):
            if time.perf_counter() > end:
                names = ', '.join(self.source.awaited())
                raise BagError(f'player: {names} must listen to /clock and answer, got no answer')
            self.source.clock.tell()

    def _wait_for_subscribers(self) -> None:
        """Wait until all who subscribe are connected: before that a message would be lost."""
        end = time.perf_counter() + DISCOVERY_TIMEOUT
        time.sleep(LOOK.nanoseconds * 1e-9)
        for topic, publisher in self._played.items():
            while publisher.get_subscription_count() < self.count_subscribers(topic):
                if time.perf_counter() > end:
                    raise BagError(f'player: who subscribes to {topic} must be connected in time')
                time.sleep(0.01)

    def _settle(self) -> None:
        """Wait until the listeners have answered the present moment."""
        while not self.source.may_leave(self.source.clock.now_ns()):
            self._require_answers()

    def _go_on(self, moment: float) -> None:
        """Wait until time may be at a moment [s]."""
        while self.source.clock.wait(moment) is None:
            self._require_answers()

    def _require_answers(self) -> None:
        if self.source.trouble:
            raise BagError(f'player: {self.source.trouble}')


def own_arguments(given: Sequence[str]) -> list[str]:
    """Return the words of a command line that are not for ROS."""
    return list(remove_ros_args(given))


def run(
    bag: Path,
    topic: str,
    speed: float,
    listeners: Sequence[str],
    arguments: Sequence[str],
    clock: bool = False,
) -> int:
    """Play a bag until it is over or a signal comes; return the exit status.

    Parameters
    ----------
    bag, topic, speed, listeners
        As of :func:`read_motion`, :class:`Player` and its `play`.
    arguments : sequence of str
        Command line, whose part for ROS counts.
    clock : bool
        Whether all is played, with the time: :class:`ClockPlayer`.
    """
    SIGNALS.keep()
    use_sockets()
    release_buffers()  # whose heartbeat tells when all has arrived
    rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    player: Player | ClockPlayer | None = None
    try:
        with SIGNALS.interrupting():
            if clock:
                player = ClockPlayer(bag, topic, speed, listeners)
                player.play()
                return 0
            player = Player(read_motion(bag, topic), speed)
            player.play(listeners)
    except DenocError as error:
        say(f'player: {error}', file=sys.stderr)
        return 1
    except Interrupted:
        return 0
    finally:
        if player is not None:
            player.destroy_node()
        leave_graph()
    return 0
