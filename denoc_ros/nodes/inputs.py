"""One input topic of a node: raw messages, checked, handed on, refused and counted."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, Protocol

from rclpy.qos import QoSProfile

from denoc_ros.nodes.conversions import InputError
from denoc_ros.nodes.safety import InputMonitor

HELD = 4  # heavy messages that wait; more of them in so short a time are a flood
# raw message, and when it arrived on the steady clock [s]
Handler = Callable[[bytes, float], None]


def never_heavy(_raw: bytes) -> bool:
    """Say that a loop has time for every message."""
    return False


def arrived(subscription: Any, depth: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield what waits in a subscription that no executor serves.

    Parameters
    ----------
    subscription : rclpy Subscription
    depth : int
        Of its queue: no more than that, as publishers go on meanwhile.

    Yields
    ------
    raw : bytes
    received_ns, sent_ns : int
        When, by the system's clock; 0 where the middleware does not say.
    """
    take, kind = subscription.handle.take_message, subscription.msg_type
    for _ in range(depth):
        taken = take(kind, True)
        if taken is None:
            return
        raw, info = taken
        yield raw, info['received_timestamp'], info['source_timestamp']


class Subscriber(Protocol):
    """What makes the subscription, and hears of what is refused."""

    create_subscription: Callable[..., Any]

    def refuse(self, monitor: InputMonitor, error: InputError) -> None:
        """Count a bad message."""


class Input:
    """A subscription whose messages a node takes by a callback or, with `take`, in its loop.

    What would take a loop too long waits, with what comes after it, for `take_heavy` in another
    thread.

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
    is_heavy : callable
        Says of a raw message whether a loop has no time for it.

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
        is_heavy: Callable[[bytes], bool] = never_heavy,
    ) -> None:
        self.monitor = monitor
        self._is_heavy = is_heavy
        self._heavy: deque[tuple[bytes, float, int]] = deque()
        self._node, self._handle = node, handle
        self._last_take = time.perf_counter()
        self._depth = qos.depth
        # one argument only: rclpy 7.1.6's EventsExecutor fails on raw messages with their info
        self.subscription: Any = node.create_subscription(
            message_type, topic, self._on_message, qos, raw=True
        )
        self._publishers = self.subscription.handle.get_publisher_count
        self._publishing = 0  # publishers after the last take

    def take(self) -> None:
        """Handle all that has arrived since the last call, at most what the queue holds."""
        before = self._last_take
        self._last_take = time.perf_counter()
        waiting = list(arrived(self.subscription, self._depth))
        # counted after that, and before: what waited may be from one that came or went since
        publishers = self._publishers()
        publishing, self._publishing = max(publishers, self._publishing), publishers
        for raw, received_ns, _ in waiting:
            now = time.perf_counter()
            waited = 1e-9 * (time.time_ns() - received_ns)
            # whatever the wall clock was set to: it has come since the queue was last empty
            came = min(max(now - waited, before), now)
            if self._heavy or self._is_heavy(raw):
                self._hold(raw, came, publishing)
            else:
                self._give(raw, came, publishing)

    def _on_message(self, raw: bytes) -> None:
        self._give(raw, time.perf_counter(), self._publishers())

    def take_heavy(self) -> None:
        """Handle what was too long for the loop."""
        while self._heavy:
            self._give(*self._heavy[0])
            self._heavy.popleft()  # only now may the loop handle again what it takes

    def _hold(self, raw: bytes, came: float, publishing: int) -> None:
        if len(self._heavy) < HELD:
            self._heavy.append((raw, came, publishing))
        else:
            rule = f'{self.monitor.topic} must have at most {HELD} long messages at a time'
            self._node.refuse(self.monitor, InputError('flood', f'{rule}, got one more'))

    def _give(self, raw: bytes, came: float, publishing: int) -> None:
        try:
            self.monitor.check_publishers(publishing)
            self._handle(raw, came)
        except InputError as error:
            self._node.refuse(self.monitor, error)
