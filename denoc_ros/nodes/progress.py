"""How far a node in simulated time is, told for who makes the time."""

from __future__ import annotations

import math
import struct
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import MultiArrayDimension, UInt64MultiArray

from denoc_ros.nodes.messages import exact_bytes, listeners, raw_publish

TOPIC = '_time'  # hidden, as it is of the machine: recorders leave it out
PROGRESS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
VALUES = struct.Struct('<QQ')  # the last bytes of a message
FOREVER = (1 << 64) - 1


class TickProgress:
    """Publishes `~/_time` of a node in simulated time, for who waits for it.

    The message (UInt64MultiArray) has two numbers: the time [ns] before which nothing more will
    leave the node, which is that of its next tick; and how many commands it has sent.

    Parameters
    ----------
    node : DenocNode
    """

    def __init__(self, node: Any) -> None:
        self._clock = node.clock
        message = UInt64MultiArray(data=[0, 0])
        message.layout.dim = [MultiArrayDimension(label='until_ns,commands', size=2, stride=2)]
        self._front = exact_bytes(message)[: -VALUES.size]
        self._publisher = node.create_publisher(UInt64MultiArray, f'~/{TOPIC}', PROGRESS)
        self._listeners = listeners(self._publisher)
        self._publish = raw_publish(self._publisher)

    def tell(self, until: float, commands: int = 0) -> None:
        """Tell that all has left that belongs to moments before `until` [s]; infinite: ever."""
        if self._listeners():
            until_ns = FOREVER if until == math.inf else max(0, self._clock.stamp_ns(until))
            self._publish(self._front + VALUES.pack(until_ns, commands))
