"""IMUs and accelerometers as topics: every value with its own place among those that are fused."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from geometry_msgs.msg import AccelStamped
from sensor_msgs.msg import Imu

from denoc_ros.estimation.clock import StampClock
from denoc_ros.model.tree import InertialSensor, Tree
from denoc_ros.nodes.robot_node import RobotNode
from denoc_ros.runtime.base_messages import read_accel, read_imu
from denoc_ros.runtime.input_monitor import InputMonitor
from denoc_ros.types import Array

TYPES = {
    'imu': ('sensor_msgs/msg/Imu', Imu),
    'accelerometer': ('geometry_msgs/msg/AccelStamped', AccelStamped),
}


class InertialInputs:
    """The robot's IMUs and accelerometers as inputs of a node.

    Parameters
    ----------
    node : RobotNode
        It subscribes.
    queue : deque of (place, time, value)
        Takes the values: which of those that are fused (sensors on beams first, then these in
        file order), when it was measured on the steady clock [s], and the value.
    """

    def __init__(self, node: RobotNode, queue: deque[tuple[int, float, float]]) -> None:
        self._node, self._queue = node, queue
        self._sensors: dict[str, tuple[int, InertialSensor]] = {}  # by topic
        self._subscribed: set[str] = set()
        self._refused: set[str] = set()

    def update(self, tree: Tree) -> None:
        """Take the sensors of a model; subscriptions stay."""
        place, found = len(tree.sensors), {}
        for sensor in tree.inertial_sensors:
            if sensor.topic:
                found[self._node.resolve_topic_name(sensor.topic)] = place, sensor
            place += len(sensor.parts)
        self._sensors = found

    def search(self) -> None:
        """Subscribe to the topics that have appeared since the last call."""
        if self._subscribed.issuperset(self._sensors):
            return
        for topic, types in self._node.get_topic_names_and_types():
            if topic not in self._sensors or topic in self._subscribed:
                continue
            sensor = self._sensors[topic][1]
            if TYPES[sensor.type][0] in types:
                self._subscribe(topic, sensor.type)
            elif topic not in self._refused:
                self._refused.add(topic)
                self._node.get_logger().error(
                    f'sensor topic {topic}: type must be {TYPES[sensor.type][0]}, got {types}'
                )

    def _subscribe(self, topic: str, kind: str) -> None:
        self._subscribed.add(topic)
        watch: list[InputMonitor] = []
        clock = StampClock()

        def handle(raw: bytes, now: float) -> None:
            self._take(topic, kind, raw, now, watch[0], clock)

        watch.append(self._node.listen_in_loop(TYPES[kind][1], topic, handle))

    def _take(
        self,
        topic: str,
        kind: str,
        raw: bytes,
        now: float,
        monitor: InputMonitor,
        clock: StampClock,
    ) -> None:
        stamp_ns, values = _read(raw, kind)
        monitor.accept(stamp_ns, now)
        taken = clock.taken_at(1e-9 * stamp_ns, now, 1e-9 * self._node.stamp_ns_at(now))
        known = self._sensors.get(topic)
        if known is None or known[1].type != kind:
            return  # of a model that was before
        taken = taken if math.isfinite(taken) else now
        for place, value in enumerate(values.tolist(), known[0]):
            self._queue.append((place, taken, value))


def _read(raw: bytes, kind: str) -> tuple[int, Array]:
    """Return stamp [ns] and values: of an Imu angular rate and specific force."""
    if kind == 'imu':
        stamp_ns, rate, force = read_imu(raw)
        return stamp_ns, np.concatenate([rate, force])
    stamp_ns, acceleration = read_accel(raw)
    return stamp_ns, acceleration[:3]
