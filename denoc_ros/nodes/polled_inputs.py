"""Inputs that are looked at when they are wanted: no message wakes the process."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from rclpy.node import Node

from denoc_ros.nodes.base import NEWEST, DenocNode
from denoc_ros.nodes.conversions import InputError
from denoc_ros.nodes.safety import InputMonitor

Admit = Callable[[int], None]
Handler = Callable[[str, bytes, Admit], None]


class PolledInputs:
    """Subscriptions of which the newest message is taken now and then, by one thread.

    They belong to a hidden node that no executor serves: a callback for each message would take
    more time than all that is made of the few that are looked at.

    Parameters
    ----------
    node : DenocNode
        Whose inputs they are: its name space, its diagnostics.
    topics : mapping of str to type
        Message types by topic.
    """

    def __init__(self, node: DenocNode, topics: Mapping[str, type]) -> None:
        self._owner = node
        self._topics = {node.resolve_topic_name(topic): kind for topic, kind in topics.items()}
        self._given = dict(zip(self._topics, topics, strict=True))
        limit = node.settings.integer('max_publishers')
        self._monitors = {topic: InputMonitor(topic, limit) for topic in self._topics}
        node.monitors.extend(self._monitors.values())
        self._subscriptions: dict[str, Any] = {}
        self._node = Node(
            f'_{node.get_name()}_inputs',
            namespace=node.get_namespace(),
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )

    @property
    def is_open(self) -> bool:
        """Whether there are subscriptions."""
        return bool(self._subscriptions)

    def open(self) -> None:
        """Subscribe; what the topics said before is forgotten."""
        self.forget()
        for topic, kind in self._topics.items():
            if topic not in self._subscriptions:
                self._subscriptions[topic] = self._node.create_subscription(
                    kind, topic, _never, NEWEST, raw=True
                )

    def shut(self) -> None:
        """Subscribe to nothing any more."""
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()

    def forget(self) -> None:
        """Forget the last stamps: what comes next may be older."""
        for monitor in self._monitors.values():
            monitor.reset()

    def close(self) -> None:
        """Leave the graph; counts are those of the next configuration then."""
        self.shut()
        self._node.destroy_node()
        for monitor in self._monitors.values():
            self._owner.monitors.remove(monitor)

    def take(self, handle: Handler) -> None:
        """Hand the newest message of each topic over, where there is a new one.

        Parameters
        ----------
        handle : callable
            Takes the topic, as it was given, the raw message, and what admits its stamp [ns]:
            either may raise InputError, which is counted.
        """
        for topic, subscription in self._subscriptions.items():
            monitor, reader = self._monitors[topic], subscription.handle
            with reader:
                taken = reader.take_message(subscription.msg_type, True)
                publishers = reader.get_publisher_count()
            if taken is None:
                continue
            admit = partial(_admit, monitor, time.perf_counter())
            try:
                monitor.check_publishers(publishers)
                handle(self._given[topic], taken[0], admit)
            except InputError as error:
                self._owner.refuse(monitor, error)


def _admit(monitor: InputMonitor, now: float, stamp_ns: int) -> None:
    monitor.accept(stamp_ns, now)


def _never(_raw: bytes) -> None:
    """Stand for the callback that rclpy asks for; no executor calls it."""
