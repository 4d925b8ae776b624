"""Nodes on real DDS, on loopback, in the domain of this test session."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from node_robots import two_links
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from viewer_client import ViewerClient

PATIENCE = 120.0  # s for what takes a second on a machine that does nothing else


class Graph:
    """A node under test and a probe beside it, in one executor that the test itself spins."""

    def __init__(self) -> None:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.executor = EventsExecutor()
        self.probe = Node('probe', use_global_arguments=False)
        self.executor.add_node(self.probe)
        self.nodes: list[Any] = []
        self.diagnostics: dict[str, Any] = {}
        self.probe.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 50)

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            self.diagnostics[status.name] = status

    def add(
        self,
        make: Callable[..., Any],
        start: bool = True,
        parameters: dict[str, Any] | None = None,
        **more: Any,
    ) -> Any:
        """Make a node with parameters, by dictionary or by keyword with `__` for a dot."""
        given = {name.replace('__', '.'): value for name, value in more.items()}
        given.update(parameters or {})
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        node = make(parameter_overrides=overrides, use_global_arguments=False)
        self.nodes.append(node)
        self.executor.add_node(node)
        if start:
            node.trigger_configure()
            node.trigger_activate()
            assert node.state == 'active', node.failure
        return node

    def until(self, condition: Callable[[], object], timeout: float = PATIENCE) -> None:
        """Spin until a condition holds; fail after `timeout` seconds."""
        end = time.perf_counter() + timeout
        while not condition():
            assert time.perf_counter() < end, 'the condition did not come about in time'
            self.executor.spin_once(0.01)

    def spin(self, duration: float) -> None:
        """Spin for a while."""
        end = time.perf_counter() + duration
        while time.perf_counter() < end:
            self.executor.spin_once(0.005)

    def publisher(self, message_type: type, topic: str, depth: int = 10) -> Any:
        """Return a reliable publisher that has found its subscribers."""
        publisher = self.probe.create_publisher(message_type, topic, depth)
        self.until(lambda: publisher.get_subscription_count() > 0)
        return publisher

    def collect(self, message_type: type, topic: str, reliable: bool = True) -> list[Any]:
        """Return a list that fills with a topic's messages."""
        messages: list[Any] = []
        reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        qos = QoSProfile(depth=5000, reliability=reliability)
        self.probe.create_subscription(message_type, topic, messages.append, qos)
        return messages

    def value(self, status: str, key: str) -> str | None:
        """Return a value of the last diagnostics, None if there is none."""
        found = self.diagnostics.get(status)
        values = {each.key: each.value for each in found.values} if found else {}
        return values.get(key)

    def remove(self, node: Any) -> None:
        """End a node."""
        self.nodes.remove(node)
        node.end()
        self.executor.remove_node(node)
        self.spin(0.05)  # timers that are due already
        node.destroy_node()

    def close(self) -> None:
        """End all nodes."""
        for node in [*self.nodes, self.probe]:
            if node is not self.probe:
                node.end()
            self.executor.remove_node(node)
            node.destroy_node()
        self.executor.shutdown()
        rclpy.try_shutdown()


@pytest.fixture
def urdf(tmp_path: Path) -> str:
    """Return the file of the arm of two flexible links with three sensors."""
    file = tmp_path / 'arm.urdf'
    file.write_text(two_links())
    return str(file)


@pytest.fixture
def graph() -> Iterator[Graph]:
    """Return a fresh graph."""
    graph = Graph()
    yield graph
    graph.close()


@pytest.fixture
def watch() -> Iterator[Any]:
    """Watch a page until the test ends, or until what is returned is called."""
    ends: list[Any] = []

    def begin(address: str) -> Any:
        client = ViewerClient(address)
        stop = threading.Event()

        def receive() -> None:
            while not stop.is_set():
                client.receive(0.05)
            client.close()

        thread = threading.Thread(target=receive)
        thread.start()

        def end() -> None:
            stop.set()
            thread.join(5.0)

        ends.append(end)
        return end

    yield begin
    for end in ends:
        end()
