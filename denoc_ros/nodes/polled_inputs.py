"""Polled inputs: read on demand, no message wakes the process."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial
from typing import Any

from denoc_ros.nodes.base import NEWEST, DenocNode
from denoc_ros.nodes.inputs import Input
from denoc_ros.nodes.without_events import WithoutEvents
from denoc_ros.runtime.input_monitor import InputMonitor

Admit = Callable[[int], None]
# takes a topic, as it was given, a raw message, and what admits its stamp [ns]
Taker = Callable[[str, bytes, Admit], None]


class _Aside(WithoutEvents):
    """A hidden node that no executor serves: its subscriptions come and go in any thread."""

    def __init__(self, owner: DenocNode) -> None:
        super().__init__(
            f'_{owner.get_name()}_inputs',
            namespace=owner.get_namespace(),
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self.refuse, self.clock = owner.refuse, owner.clock
        self.drop = self.destroy_subscription

    def take_aside(self, subscription: Any) -> None:
        """Do nothing: all are aside."""


class PolledInputs:
    """Subscriptions of which the newest message is taken now and then, by one thread.

    A callback for each message would take more time than all that is made of the few that are
    looked at.

    Parameters
    ----------
    node : DenocNode
        Whose inputs they are: its name space, its diagnostics.
    topics : mapping of str to type
        Message types by topic.
    take : callable
        Takes a topic, as it is given here, the raw message, and what admits its stamp [ns]; may
        raise InputError, which is counted.
    """

    def __init__(self, node: DenocNode, topics: Mapping[str, type], take: Taker) -> None:
        limit = node.settings.integer('max_publishers')
        self._owner, self._topics, self._take = node, topics, take
        self._names = {topic: node.resolve_topic_name(topic) for topic in topics}
        self._monitors = {topic: InputMonitor(self._names[topic], limit) for topic in topics}
        node.monitors.extend(self._monitors.values())
        self._inputs: dict[str, Input] = {}
        self._node = _Aside(node)

    @property
    def is_open(self) -> bool:
        """Whether there are subscriptions."""
        return bool(self._inputs)

    def listen(self, topics: Collection[str]) -> None:
        """Subscribe to topics of these inputs, and to no others any more."""
        for topic in self._inputs.keys() - set(topics):
            self._node.destroy_subscription(self._inputs.pop(topic).subscription)
        for topic in topics:
            if topic not in self._inputs:
                self._inputs[topic] = self._subscribed(topic)

    def _subscribed(self, topic: str) -> Input:
        monitor = self._monitors[topic]
        monitor.reset()
        handle = partial(self._hand_on, topic, monitor)
        name, kind = self._names[topic], self._topics[topic]
        return Input(self._node, kind, name, handle, NEWEST, monitor)

    def shut(self) -> None:
        """Subscribe to nothing any more."""
        self.listen(())

    def forget(self) -> None:
        """Discard the last stamps: the next messages may be older."""
        for monitor in self._monitors.values():
            monitor.reset()

    def take(self) -> None:
        """Hand the newest message of each topic on, where there is a new one."""
        for each in self._inputs.values():
            each.take()

    def close(self) -> None:
        """Leave the graph, and the owner's diagnostics."""
        self.shut()
        self._node.destroy_node()
        for monitor in self._monitors.values():
            self._owner.monitors.remove(monitor)

    def _hand_on(self, topic: str, monitor: InputMonitor, raw: bytes, arrived: float) -> None:
        self._take(topic, raw, partial(_admit, monitor, arrived))


def _admit(monitor: InputMonitor, arrived: float, stamp_ns: int) -> None:
    monitor.accept(stamp_ns, arrived)
