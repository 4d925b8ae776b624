"""Load for a recorder, and garbage for a controller: a process that talks when it is told to.

`python -m bench.loops.publisher load TOPICS RATE BYTES` publishes numbered messages on
`/load/t0`, …;
`python -m bench.loops.publisher garbage RATE` publishes joint states and references to be refused;
`python -m bench.loops.publisher joints RATE JOINT …` publishes good joint states of a robot
that stands,
`python -m bench.loops.publisher moving RATE JOINT …` of one whose joints swing.
SIGUSR1 begins, SIGUSR2 pauses, SIGINT ends; `joints` and `moving` begin by themselves.
"""

from __future__ import annotations

import gc
import math
import os
import signal
import struct
import sys
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import UInt8MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.bags.joint_state import JointStateMessage
from denoc_ros.runtime.loop.realtime import make_thread_timely

DEPTH = 500  # ten seconds of the load that a busy reader may still ask for
NUMBER = struct.Struct('<Q')
NUMBER_OFFSET = 4 + 4 + 4 + 4  # behind encapsulation, no dimensions, offset and length
PAUSED = 0.005  # s between looks whether it is told to talk
SWING, SWINGING = 0.2, 3.0  # rad, rad/s
RELIABLE = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE)


def load(node: Node, topics: int, size: int) -> Callable[[], None]:
    """Return what publishes one numbered message of each topic."""
    publishers = [
        node.create_publisher(UInt8MultiArray, f'/load/t{k}', RELIABLE) for k in range(topics)
    ]
    raw = bytearray(serialize_message(UInt8MultiArray(data=bytes(size))))
    filling = slice(NUMBER_OFFSET + NUMBER.size, NUMBER_OFFSET + size)
    number = [0]

    def talk() -> None:
        NUMBER.pack_into(raw, NUMBER_OFFSET, number[0])
        number[0] += 1
        for publisher in publishers:
            # nothing for the recorder's compression to save
            raw[filling] = os.urandom(size - NUMBER.size)
            publisher.publish(bytes(raw))

    return talk


def garbage(node: Node) -> Callable[[], None]:
    """Return what publishes a joint state and a reference that are not finite."""
    states = node.create_publisher(JointState, 'joint_states', 10)
    references = node.create_publisher(JointTrajectory, 'reference', 10)
    bad = JointState(name=['joint_1'], position=[math.nan])
    point = JointTrajectoryPoint(positions=[math.inf])
    worse = JointTrajectory(joint_names=['joint_1'], points=[point])
    messages = [(states, serialize_message(bad)), (references, serialize_message(worse))]

    def talk() -> None:
        for publisher, message in messages:
            publisher.publish(message)

    return talk


def joints(node: Node, names: list[str], swing: float = 0.0) -> Callable[[], None]:
    """Return what publishes good joint states of joints that swing [rad]."""
    message = JointStateMessage(names, ('position', 'velocity'))
    publisher = node.create_publisher(JointState, 'joint_states', 10)

    def talk() -> None:
        stamp_ns = time.time_ns()
        phase = SWINGING * (1e-9 * stamp_ns % (math.tau / SWINGING))
        message.position[:] = swing * math.sin(phase)
        message.velocity[:] = swing * SWINGING * math.cos(phase)
        publisher.publish(message.bytes(stamp_ns))

    return talk


def main() -> None:
    kind, *arguments = sys.argv[1:]
    told: list[Any] = [kind in ('joints', 'moving'), False]  # talks, ends
    signal.signal(signal.SIGUSR1, lambda *_: told.__setitem__(0, True))
    signal.signal(signal.SIGUSR2, lambda *_: told.__setitem__(0, False))
    signal.signal(signal.SIGINT, lambda *_: told.__setitem__(1, True))
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = Node(f'publisher_{kind}', use_global_arguments=False)
    if kind == 'load':
        rate = float(arguments[1])
        talk = load(node, int(arguments[0]), int(arguments[2]))
    elif kind == 'garbage':
        rate, talk = float(arguments[0]), garbage(node)
    else:
        swing = SWING if kind == 'moving' else 0.0
        rate, talk = float(arguments[0]), joints(node, arguments[1:], swing)
        make_thread_timely(30)
    gc.freeze()
    gc.disable()
    deadline = time.perf_counter()
    while not told[1]:
        now = time.perf_counter()
        if told[0]:
            talk()
            deadline = max(deadline + 1.0 / rate, now - 1.0)
        else:
            # begins when it is told to: each block has another phase to the loop's
            deadline = now + PAUSED
        time.sleep(max(0.0, deadline - time.perf_counter()))
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
