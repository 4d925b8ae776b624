"""The topic `~/base_wrench`: the thrusters' wrench that holds a base that would float."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import WrenchStamped

from denoc_ros.dynamics.feedforward import TorqueFeedforward
from denoc_ros.dynamics.robot import Robot
from denoc_ros.nodes.base import STATE, DenocNode
from denoc_ros.types import Array


class BaseWrench:
    """Publishes the wrench that a motion of the robot takes of its base.

    Parameters
    ----------
    node : DenocNode
    floating : Robot
        The robot with its floating base; the torque is that of the same robot, its base held.
    """

    def __init__(self, node: DenocNode, floating: Robot) -> None:
        self._robot = floating
        (body,) = (body for body in floating.tree.bodies if body.floating)
        self._rest = np.setdiff1d(np.arange(floating.n), floating.base_indices)
        self._state = np.zeros((3, floating.n))
        self._message = WrenchStamped()
        self._message.header.frame_id = body.name
        self._publisher = node.create_publisher(WrenchStamped, '~/base_wrench', STATE)

    def wrench(self, source: TorqueFeedforward) -> Array:
        """Return the wrench (6,) that goes with the torque's last update, in the base's axes."""
        state = self._state
        state[0, self._rest], state[1, self._rest] = source.q, source.qd
        state[2, self._rest] = source.qdd
        force = self._robot.inverse_dynamics(state[0], state[1], state[2], check=False)
        found: Array = force[self._robot.base_indices]  # at the origin: no turn, Jacobian one
        return found

    def send(self, stamp_ns: int, source: TorqueFeedforward) -> None:
        """Publish it, if it is finite."""
        wrench = self.wrench(source)
        if not np.isfinite(wrench).all():
            return
        message = self._message
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        force, torque = message.wrench.force, message.wrench.torque
        force.x, force.y, force.z, torque.x, torque.y, torque.z = wrench.tolist()
        self._publisher.publish(message)
