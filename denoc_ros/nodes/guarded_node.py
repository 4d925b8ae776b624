"""A lifecycle node that survives every request and message, and ends without residue."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import ParameterType
from rclpy.lifecycle import LifecycleNode

from denoc_ros.nodes.guarding import Guard, Service
from denoc_ros.nodes.without_events import WithoutEvents

LONGEST_LOG = 100  # lines that wait, within a second, to be logged


class GuardedNode(WithoutEvents, LifecycleNode):
    """A lifecycle node whose callbacks, rclpy's own among them, are all guarded.

    Attributes
    ----------
    guard : Guard
        Counts the calls that failed.
    to_log : deque of str
        What is to be logged within a second: not at once, for a log that blocks must not block
        a loop.
    """

    def __init__(self, name: str, **options: Any) -> None:
        self.to_log: deque[str] = deque(maxlen=LONGEST_LOG)
        self.guard = Guard(self.to_log.append)
        super().__init__(name, **options)
        for service in self._services:  # rclpy makes some without `create_service`
            service.callback = self._serving(service.srv_name, service.srv_type, service.callback)

    def create_subscription(
        self, kind: Any, topic: str, callback: Callable[[Any], None], *given: Any, **options: Any
    ) -> Any:
        """Subscribe as rclpy does; a callback that fails does not end the node."""
        handle = self.guard.handling(f'topic {topic}', callback)
        return super().create_subscription(kind, topic, handle, *given, **options)

    def create_timer(
        self, period: float, callback: Callable[[], None], *given: Any, **options: Any
    ) -> Any:
        """Make a timer as rclpy does; a callback that fails does not end the node."""
        tick = self.guard.ticking(f'timer {callback.__name__.strip("_")}', callback)
        return super().create_timer(period, tick, *given, **options)

    def create_service(self, kind: Any, name: str, callback: Service, **options: Any) -> Any:
        """Make a service as rclpy does; a callback that fails answers that it did."""
        return super().create_service(kind, name, self._serving(name, kind, callback), **options)

    def _serving(self, name: str, kind: Any, callback: Service) -> Service:
        if hasattr(callback, 'guards'):
            return callback
        return self.guard.serving(f'service {name.rpartition("/")[2]}', kind, callback)

    def get_parameter_type(self, name: str) -> Any:
        """Return a parameter's type as a message has it: not set for an unknown one."""
        known = self.has_parameter(name)
        return super().get_parameter_type(name) if known else ParameterType.PARAMETER_NOT_SET

    def destroy_node(self) -> None:
        """Leave the graph.

        What rclpy's own leaves behind, above all the state machine, would keep the participant
        of the middleware, and its threads, alive to the end of the process.
        """
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()
