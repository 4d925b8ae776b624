"""Nodes without middleware: a test hands messages over, calls ticks and keeps the outputs."""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from rclpy.parameter import Parameter

from denoc_ros.bags.cdr import CdrReader
from denoc_ros.bags.joint_state import FIELDS, JointStateLayout, JointStateMessage
from denoc_ros.parts import node_main, nodes
from denoc_ros.runtime.loop.clocks import Clock
from denoc_ros.runtime.loop.status import OK, Status, input_status
from denoc_ros.types import Array

START_NS = 1_000_000_000_000  # stamp of time 0
# modules of nodes in which outputs and loops are made
# of nodes, and of what their outputs stand in
MODULES = (
    'denoc_ros.nodes.base.robot_node',
    'denoc_ros.nodes.torque_output',
    'denoc_ros.nodes.sensor_outputs',
    *(node_main(name) for name in ('predictor', 'plant', 'shaper') if name in nodes()),
)


class HandClock(Clock):
    """Time that a test sets: simulated, so that no budget of a processor's time counts."""

    is_simulated = True

    def __init__(self) -> None:
        self.moment_now = 0.0

    def now(self) -> float:
        return self.moment_now

    def now_ns(self) -> int:
        return self.stamp_ns(self.moment_now)

    def stamp_ns(self, moment: float) -> int:
        return START_NS + round(1e9 * moment)

    def moment(self, stamp_ns: int) -> float:
        return 1e-9 * (stamp_ns - START_NS)

    def first(self, period: float) -> float:
        return self.moment_now + period

    def after(self, deadline: float, period: float) -> float:
        return deadline + period

    def sleep(self, duration: float) -> bool:
        self.moment_now += duration
        return True

    def wait(self, deadline: float) -> float:
        self.moment_now = deadline
        return deadline


class HandLoop:
    """Takes the place of a node's loop: a test calls the ticks."""

    def __init__(self, *_given: Any) -> None:
        self.deadline = self.shift = 0.0
        self.running = False
        self.load = SimpleNamespace(threshold=1.0)

    def start(self) -> None:
        """Run nothing."""

    def stop(self) -> None:
        """Run nothing."""


class HandFedNode:
    """An active node whose time, inputs and ticks are a test's.

    Attributes
    ----------
    node : RobotNode
    sent : dict of str to list of bytes
        Messages that left since the last `tick`, by topic.
    """

    def __init__(self, make: Callable[..., Any], **parameters: Any) -> None:
        self.sent: dict[str, list[bytes]] = {}
        given = {name.replace('__', '.'): value for name, value in parameters.items()}
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        with self._kept():
            node = make(parameter_overrides=overrides, use_global_arguments=False)
            self.node, self.clock = node, HandClock()
            node.clock = self.clock
            node.trigger_configure()
            node.trigger_activate()
        assert node.state == 'active', node.failure

    @contextmanager
    def _kept(self) -> Iterator[None]:
        """Let the node's publishers keep what they are given."""

        def raw_publish(publisher: Any) -> Callable[[bytes], None]:
            topic = publisher.topic_name.lstrip('/')

            def publish(raw: bytes) -> None:
                self.sent.setdefault(topic, []).append(raw)

            return publish

        replaced = {
            'raw_publish': raw_publish,
            'listeners': lambda _: lambda: 1,
            'RealtimeLoop': HandLoop,
        }
        changed = []
        for name in MODULES:
            module = importlib.import_module(name)
            for function in replaced.keys() & vars(module).keys():
                changed.append((module, function, getattr(module, function)))
                setattr(module, function, replaced[function])
        try:
            yield
        finally:
            for module, function, before in changed:
                setattr(module, function, before)

    def begin(self) -> None:
        """Begin anew at time 0, with all counts at 0."""
        node = self.node
        self.clock.moment_now = node.loop.deadline = 0.0
        node._reset()
        node.begin()
        node.to_log.clear()
        for monitor in node.monitors:
            monitor.reset()
            monitor.rejected.clear()
            monitor.accepted = monitor.rejected_reported = 0
        self.sent.clear()
        self._inputs = {each.monitor.topic: each for each in node._inputs}

    def give(self, topic: str, raw: bytes, arrival: float) -> int:
        """Hand a message over that came at a time [s]; return how many are refused for it."""
        self.clock.moment_now = arrival
        one = self._inputs[topic]
        rejected: Counter[str] = one.monitor.rejected
        before = rejected.total()
        one._give(raw, arrival)
        return rejected.total() - before

    def tick(self, now: float) -> None:
        """Call the tick of a time [s]; a failure counts as in the loop."""
        node = self.node
        self.clock.moment_now = node.loop.deadline = now
        self.sent.clear()
        if node._changes:
            node._make_changes()
        try:
            node.tick(1)
            node._failing_since = np.inf
        except Exception as error:
            node._on_failure(error, now)

    def statuses(self) -> list[Status]:
        """Return what the node would say on /diagnostics."""
        node = self.node
        return [*node.work_statuses(), input_status(node.monitors, self.clock.now())]

    def says_ok(self) -> bool:
        return all(status.level == OK for status in self.statuses())

    def close(self) -> None:
        self.node.end()
        self.node.destroy_node()


@cache
def _message(names: tuple[str, ...], fields: tuple[str, ...]) -> JointStateMessage:
    return JointStateMessage(names, fields)


def joint_state_bytes(
    names: Sequence[str], stamp: float, position: Array, velocity: Array | None = None
) -> bytes:
    """Return a JointState of a time [s]."""
    message = _message(tuple(names), FIELDS[: 1 if velocity is None else 2])
    message.position[:] = position
    if velocity is not None:
        message.velocity[:] = velocity
    return bytes(message.bytes(START_NS + round(1e9 * stamp)))


class JointStateView:
    """Values of the JointState messages of a topic, whose layout stays."""

    def __init__(self) -> None:
        self._layout: JointStateLayout | None = None

    def values(self, raw: bytes, field: int = 0) -> Array:
        """Return the values of one of FIELDS: a view."""
        if self._layout is None:
            self._layout = JointStateLayout.of(CdrReader(raw))
        return self._layout.values(raw)[field]
