"""The topic `base_motion` of a plant whose base floats: readings of a real base's sensors."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nav_msgs.msg import Odometry

from denoc_ros.dynamics.robot import Robot
from denoc_ros.nodes.base import STATE
from denoc_ros.nodes.predictor_outputs import quaternion
from denoc_ros.types import Array

if TYPE_CHECKING:
    from denoc_ros.nodes.base import DenocNode


class BaseOutput:
    """Publishes pose and twist of a floating base.

    Parameters
    ----------
    node : DenocNode
    robot : Robot
        With a floating base.
    """

    def __init__(self, node: DenocNode, robot: Robot) -> None:
        (body,) = (body for body in robot.tree.bodies if body.floating)
        self._message = Odometry()
        root = next(f for f, place in robot.tree.frames.items() if place.body < 0)
        self._message.header.frame_id = root
        self._message.child_frame_id = body.name
        self._publisher = node.create_publisher(Odometry, 'base_motion', STATE)

    def send(self, stamp_ns: int, robot: Robot, q: Array, qd: Array) -> None:
        """Publish the base's motion at a state; the twist is along the base's own axes."""
        pose, twist = robot.base_odometry(q, qd)
        message = self._message
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        place, turned = message.pose.pose.position, message.pose.pose.orientation
        place.x, place.y, place.z = pose[:3, 3].tolist()
        turned.x, turned.y, turned.z, turned.w = quaternion(pose[:3, :3]).tolist()
        linear, angular = message.twist.twist.linear, message.twist.twist.angular
        linear.x, linear.y, linear.z = twist[:3].tolist()
        angular.x, angular.y, angular.z = twist[3:].tolist()
        self._publisher.publish(message)
