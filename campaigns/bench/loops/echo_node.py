"""An empty node: sends every JointState that it hears on, and nothing else.

`python echo_node.py events|default [--ros-args …]`: spun by rclpy's EventsExecutor, the faster
one, or by `rclpy.spin`.
"""

from __future__ import annotations

import sys

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState

from denoc_ros.nodes.base.middleware import use_sockets

DEPTH = 100


def main() -> None:
    use_sockets()
    rclpy.init()
    node = Node('echo')
    publisher = node.create_publisher(JointState, 'out', DEPTH)
    node.create_subscription(JointState, 'in', publisher.publish, DEPTH)
    try:
        if sys.argv[1] == 'default':
            rclpy.spin(node)
        executor = EventsExecutor()
        executor.add_node(node)
        while rclpy.ok():
            executor.spin_once(0.1)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == '__main__':
    main()
