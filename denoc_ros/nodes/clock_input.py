"""The topic /clock, taken by the thread that waits for it."""

from __future__ import annotations

from bisect import bisect_right
from typing import Any

from rclpy.clock_type import ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from denoc_ros.bags.cdr import CdrError, CdrReader
from denoc_ros.nodes.inputs import arrived, subscribe_aside

TOPIC = '/clock'
ROS_TIME = ClockType.ROS_TIME
KEPT = 20_000  # times kept for messages that are looked at later


class WaitSet:
    """Waits for messages of subscriptions that no executor serves.

    A callback of an executor for each message would cost several times as much.
    """

    def __init__(self, context: Any, subscriptions: list[Any]) -> None:
        self._handles = [each.handle for each in subscriptions]
        counts = len(self._handles), 0, 0, 0, 0, 0
        self._set = rclpy_implementation.WaitSet(*counts, context.handle)

    def wait(self, timeout: float) -> None:
        """Wait for a message, at most so long [s]."""
        wait_set = self._set
        wait_set.clear_entities()
        for handle in self._handles:
            wait_set.add_subscription(handle)
        wait_set.wait(round(1e9 * timeout))


class ClockInput:
    """Messages of /clock, and the node's own ROS clock set by them.

    rclpy's time source has a callback of the executor for each message; its subscription is
    replaced.

    Parameters
    ----------
    node : DenocNode
        Its parameter `use_sim_time` is true.
    depth : int
        Messages that wait; with more than 1 the times are kept for :meth:`time_of`.
    """

    def __init__(self, node: Any, depth: int = 1) -> None:
        release_clock(node)
        self._node = node
        self._clock, self._depth, self._guard = node.get_clock(), depth, node.guard
        self._reliability = ReliabilityPolicy.BEST_EFFORT  # suits every publisher
        self._subscribe()
        self._sent: list[int] = []
        self._told: list[int] = []

    def _subscribe(self) -> None:
        qos = QoSProfile(depth=self._depth, reliability=self._reliability)
        self._subscription = subscribe_aside(self._node, Clock, TOPIC, qos)
        self._waits = WaitSet(self._node.context, [self._subscription])

    def miss_nothing(self) -> None:
        """Subscribe as reliable where all who publish are; no thread may be waiting."""
        offers = self._node.get_publishers_info_by_topic(TOPIC)
        reliable = [each.qos_profile.reliability == ReliabilityPolicy.RELIABLE for each in offers]
        wanted = ReliabilityPolicy.BEST_EFFORT
        if offers and all(reliable):
            wanted = ReliabilityPolicy.RELIABLE
        if offers and wanted != self._reliability:
            self._reliability = wanted
            self._node.drop(self._subscription)
            self._subscribe()

    @property
    def last_sent_ns(self) -> int:
        """When the newest message that is kept was sent [ns, system's clock]; 0: there is none."""
        return self._sent[-1] if self._sent else 0

    @property
    def publishers(self) -> int:
        """How many publish the time."""
        return int(self._subscription.handle.get_publisher_count())

    def receive(self, timeout: float) -> int | None:
        """Wait at most so long [s] for a message; return the newest time [ns], None: none came."""
        newest = self._take()
        if newest is None and timeout > 0.0:
            self._waits.wait(timeout)
            newest = self._take()
        if newest is not None:
            self._clock.set_ros_time_override(Time(nanoseconds=newest, clock_type=ROS_TIME))
        return newest

    def time_of(self, sent_ns: int) -> int | None:
        """Time on /clock [ns] when a message was sent [ns, system's clock]."""
        place = bisect_right(self._sent, sent_ns)
        return self._told[place - 1] if place else None

    def _take(self) -> int | None:
        newest = None
        for raw, _, sent_ns, _ in arrived(self._subscription, self._depth):
            try:
                newest = time_ns(raw)
            except CdrError as error:
                self._guard.note(f'topic {TOPIC}', error)
                continue
            if self._depth > 1:
                self._sent.append(sent_ns)
                self._told.append(newest)
        if len(self._sent) > KEPT:
            del self._sent[: KEPT // 2], self._told[: KEPT // 2]
        return newest


def release_clock(node: Any) -> bool:
    """Drop the subscription of rclpy's time source; say whether there was one."""
    source = node._time_source
    if source._clock_sub is None:
        return False
    node.destroy_subscription(source._clock_sub)
    source._clock_sub = None
    return True


def time_ns(raw: bytes) -> int:
    """Return the time of a Clock message [ns].

    Raises
    ------
    CdrError
        The bytes are no message, or the time is before all time.
    """
    found = CdrReader(raw).stamp_ns()
    if found < 0:
        raise CdrError(f'clock must be >= 0 s, got {1e-9 * found:g}')
    return found
