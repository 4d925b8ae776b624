"""Outputs of the feedforward node: commands, stamped effort, a point for JTC."""

from __future__ import annotations

from collections.abc import Sequence

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from denoc_ros.bags.joint_state import JointStateMessage
from denoc_ros.nodes.base import COMMAND, EVERY_MESSAGE, STATE, DenocNode
from denoc_ros.nodes.messages import (
    CommandMessage,
    TrajectoryPointMessage,
    listeners,
    raw_publish,
)
from denoc_ros.types import Array


class TorqueOutput:
    """The publishers of one set of joints, with their prebuilt messages.

    Parameters
    ----------
    node : DenocNode
    joints : sequence of str
    every_message : bool
        Whether effort is an answer to each input, of which none may be lost.
    with_point : bool
        Whether `~/joint_trajectory` is published.

    Attributes
    ----------
    sent : int
        How many commands have left.
    """

    def __init__(
        self, node: DenocNode, joints: Sequence[str], every_message: bool, with_point: bool
    ) -> None:
        self.sent = 0
        self._effort = JointStateMessage(joints, ('position', 'velocity', 'effort'))
        self._commands = CommandMessage(joints)
        self._point = TrajectoryPointMessage(joints) if with_point else None
        effort_qos = EVERY_MESSAGE if every_message else STATE
        self._effort_out = node.create_publisher(JointState, '~/effort', effort_qos)
        self._effort_listeners = listeners(self._effort_out)
        # in simulated time none may be lost; in real time an old one is worth nothing
        command_qos = EVERY_MESSAGE if node.clock.is_simulated else COMMAND
        self._commands_out = node.create_publisher(Float64MultiArray, '~/commands', command_qos)
        self._point_out = (
            node.create_publisher(JointTrajectory, '~/joint_trajectory', COMMAND)
            if with_point
            else None
        )
        self._publish_effort = raw_publish(self._effort_out)
        self._publish_commands = raw_publish(self._commands_out)

    def send(self, stamp_ns: int, q: Array, qd: Array, qdd: Array, torque: Array) -> None:
        """Publish the torque (n,) that goes with a desired state, on all topics."""
        self._commands.values[:] = torque
        self._publish_commands(self._commands.bytes())
        self.sent += 1
        self.send_effort(stamp_ns, q, qd, torque)
        point = self._point
        if point is not None and self._point_out is not None:
            point.positions[:] = q
            point.velocities[:] = qd
            point.accelerations[:] = qdd
            point.effort[:] = torque
            self._point_out.publish(point.bytes())

    def send_effort(self, stamp_ns: int, q: Array, qd: Array, torque: Array) -> None:
        """Publish `~/effort` only: position and velocity are those the torque is for."""
        if not self._effort_listeners():
            return
        message = self._effort
        message.stamp(stamp_ns)
        message.position[:] = q
        message.velocity[:] = qd
        message.effort[:] = torque
        self._publish_effort(message.bytes())

    def close(self, node: DenocNode) -> None:
        """Destroy the publishers."""
        for publisher in (self._effort_out, self._commands_out, self._point_out):
            if publisher is not None:
                node.destroy_publisher(publisher)
