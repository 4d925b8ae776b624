"""One input topic of a node: raw messages, checked, handed on, refused and counted."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol

from rclpy.qos import QoSProfile

from denoc_ros.nodes.conversions import InputError
from denoc_ros.nodes.safety import InputMonitor

# raw message, and when it arrived on the steady clock [s]
Handler = Callable[[bytes, float], None]


class Subscriber(Protocol):
    """What makes the subscription, and hears of what is refused."""

    create_subscription: Callable[..., Any]

    def refuse(self, monitor: InputMonitor, error: InputError) -> None:
        """Count a bad message."""


class Input:
    """A subscription whose messages a node takes by a callback or, with `take`, in its loop.

    Parameters
    ----------
    node : Subscriber
    message_type : type
    topic : str
    handle : callable
        Parses and stores a message, or raises InputError.
    qos : QoSProfile
    monitor : InputMonitor
        It counts.

    Attributes
    ----------
    monitor : InputMonitor
        As given.
    subscription : rclpy Subscription
    """

    def __init__(
        self,
        node: Subscriber,
        message_type: type,
        topic: str,
        handle: Handler,
        qos: QoSProfile,
        monitor: InputMonitor,
    ) -> None:
        self.monitor = monitor
        self._node, self._handle = node, handle
        self._last_take = time.perf_counter()
        self._depth = qos.depth
        # one argument only: rclpy 7.1.6's EventsExecutor fails on raw messages with their info
        self.subscription: Any = node.create_subscription(
            message_type, topic, lambda raw: self._give(raw, time.perf_counter()), qos, raw=True
        )
        self._publishers = self.subscription.handle.get_publisher_count
        self._take_message = self.subscription.handle.take_message
        self._type = self.subscription.msg_type

    def take(self) -> None:
        """Handle all that has arrived since the last call, at most what the queue holds."""
        before = self._last_take
        self._last_take = time.perf_counter()
        for _ in range(self._depth):
            taken = self._take_message(self._type, True)
            if taken is None:
                return
            raw, info = taken
            now = time.perf_counter()
            waited = 1e-9 * (time.time_ns() - info['received_timestamp'])
            # whatever the wall clock was set to: it has come since the queue was last empty
            self._give(raw, min(max(now - waited, before), now))

    def _give(self, raw: bytes, arrived: float) -> None:
        try:
            self.monitor.check_publishers(self._publishers())
            self._handle(raw, arrived)
        except InputError as error:
            self._node.refuse(self.monitor, error)
