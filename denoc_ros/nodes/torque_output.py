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
    ImpedanceCommandMessage,
    TrajectoryPointMessage,
    listeners,
    raw_publish,
)
from denoc_ros.types import Array


class ImpedanceOutput:
    """Commands of position, velocity, gains and torque in one, for drives that close the loop.

    Stiffness rises over the ramp while the reference is followed, and falls over it, about the
    last position that was commanded, while it is not: neither begins nor ends with a jump.

    Parameters
    ----------
    node : DenocNode
    joints : sequence of str
    stiffness, damping : (joints,) arrays
        Gains of the drives [N m/rad, N m s/rad; N/m, N s/m].
    ramp_time : float
        [s]
    """

    def __init__(
        self,
        node: DenocNode,
        joints: Sequence[str],
        stiffness: Array,
        damping: Array,
        ramp_time: float,
    ) -> None:
        self._stiffness, self._ramp_time = stiffness, ramp_time
        self._share, self._last_ns = 0.0, 0
        self._message = ImpedanceCommandMessage(joints)
        self._message.values[:, 3] = damping
        qos = EVERY_MESSAGE if node.clock.is_simulated else COMMAND
        publisher = node.create_publisher(Float64MultiArray, '~/impedance_commands', qos)
        self._publish = raw_publish(publisher)

    def send(self, stamp_ns: int, q: Array, qd: Array, torque: Array, is_following: bool) -> None:
        """Publish the commands (joints,) of now."""
        step = max(0.0, 1e-9 * (stamp_ns - self._last_ns)) if self._last_ns else 0.0
        self._last_ns = stamp_ns
        change = step / self._ramp_time
        self._share = min(max(self._share + (change if is_following else -change), 0.0), 1.0)
        values = self._message.values
        if is_following or self._share == 0.0:
            values[:, 0] = q
        values[:, 1] = qd
        values[:, 2] = self._share * self._stiffness
        values[:, 4] = torque
        self._publish(self._message.bytes())


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
    impedance : ImpedanceOutput, optional
        Also sends the gains of drives.

    Attributes
    ----------
    sent : int
        How many commands have left.
    """

    def __init__(
        self,
        node: DenocNode,
        joints: Sequence[str],
        every_message: bool,
        with_point: bool,
        impedance: ImpedanceOutput | None = None,
    ) -> None:
        self.sent, self._impedance = 0, impedance
        self._effort = JointStateMessage(joints, ('position', 'velocity', 'effort'))
        self._commands = CommandMessage(joints)
        self._point = TrajectoryPointMessage(joints) if with_point else None
        effort_qos = EVERY_MESSAGE if every_message else STATE
        effort = node.create_publisher(JointState, '~/effort', effort_qos)
        self._effort_listeners = listeners(effort)
        # in simulated time none may be lost; in real time an old one is worth nothing
        command_qos = EVERY_MESSAGE if node.clock.is_simulated else COMMAND
        commands = node.create_publisher(Float64MultiArray, '~/commands', command_qos)
        self._point_out = (
            node.create_publisher(JointTrajectory, '~/joint_trajectory', COMMAND)
            if with_point
            else None
        )
        self._publish_effort, self._publish_commands = raw_publish(effort), raw_publish(commands)

    def send(
        self,
        stamp_ns: int,
        q: Array,
        qd: Array,
        qdd: Array,
        torque: Array,
        is_following: bool = True,
    ) -> None:
        """Publish the torque (n,) that goes with a desired state, on all topics.

        `is_following` says whether the state is the reference's.
        """
        self._commands.values[:] = torque
        self._publish_commands(self._commands.bytes())
        self.sent += 1
        self.send_effort(stamp_ns, q, qd, torque)
        if self._impedance is not None:
            self._impedance.send(stamp_ns, q, qd, torque, is_following)
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
