"""The feedforward node's torque: feedback added to it, and the topics that it leaves by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from denoc_ros.bags.joint_state import JointStateMessage
from denoc_ros.dynamics.driven.torque_feedforward import TorqueFeedforward
from denoc_ros.dynamics.robot import Robot
from denoc_ros.nodes.base.denoc_node import DenocNode
from denoc_ros.nodes.base.messages import (
    COMMAND,
    EVERY_MESSAGE,
    STATE,
    CommandMessage,
    ImpedanceCommandMessage,
    TrajectoryPointMessage,
    listeners,
    raw_publish,
)
from denoc_ros.nodes.base.robot_node import RobotNode
from denoc_ros.nodes.sensor_inputs import SEARCH_PERIOD, SensorInputs
from denoc_ros.runtime.feedback_law import feedback_law
from denoc_ros.runtime.inputs.joint_gate import JointSample
from denoc_ros.runtime.inputs.message_numbers import MessageFiller, Numbers
from denoc_ros.runtime.parameters.parameter_table import Settings
from denoc_ros.types import Array


class TorqueFeedback:
    """The feedback law of the node and its sensors; without a law it neither listens nor acts.

    Parameters
    ----------
    node : RobotNode
        It subscribes to the sensors once they are needed.

    Attributes
    ----------
    law : FeedbackLaw
    """

    def __init__(self, node: RobotNode) -> None:
        self._node = node
        in_hurry = not node.clock.is_simulated
        self.law = feedback_law(node.get_fully_qualified_name(), in_hurry)
        self._sensors: SensorInputs | None = None

    def build(
        self,
        robot: Robot,
        joints: Sequence[str],
        settings: Settings,
        limits: Array,
        posture: Array,
        patience: float = 0.0,
    ) -> None:
        """Take a robot over, and listen to the sensors of a wanted feedback.

        Raises
        ------
        ConfigError, StateError
            As of :meth:`FeedbackLaw.build`.
        """
        before = self.law.wanted
        self.law.build(robot, joints, settings, limits, posture, patience)
        if not self.law.wanted:
            return
        if self._sensors is None:
            self._sensors = SensorInputs(self._node)
            self._node.create_timer(
                SEARCH_PERIOD, self._sensors.search, clock=self._node.steady_clock
            )
        if not before:
            self._sensors.queue.clear()  # of a time in which nobody listened
        self._sensors.update(robot.tree)

    def take_joints(self, sample: JointSample) -> None:
        """Take measured joints."""
        if not self.law.wanted:
            return
        if sample.restarts:
            self.law.begin()
        wall = 1e-9 * self._node.stamp_ns_at(sample.arrival)
        self.law.take_joints(
            1e-9 * sample.stamp_ns, sample.arrival, wall, sample.position, sample.velocity
        )

    def search(self) -> None:
        """Listen to the sensors that have appeared."""
        if self._sensors is not None:
            self._sensors.search()

    def add(
        self, torque: Array, source: TorqueFeedforward, wanted: Array, now: float, lead: float
    ) -> Array:
        """Return a torque (n,) with the feedback; arguments of :meth:`FeedbackLaw.torque`."""
        if not self.law.wanted:
            return torque
        self._take_values()
        return self.law.torque(torque, source, wanted, now, lead)

    def wait(
        self, torque: Array, source: TorqueFeedforward, wanted: Array, now: float, lead: float
    ) -> None:
        """Go on with the estimate in a tick in which another torque leaves; arguments as `add`."""
        if self.law.wanted:
            self._take_values()
            self.law.wait(torque, source, wanted, now, lead)

    def rest(self) -> None:
        """Let go: something else than the plan leaves."""
        if self.law.wanted:
            self._take_values()
        self.law.rest()

    def _take_values(self) -> None:
        """Pass on the values of the sensors."""
        assert self._sensors is not None
        queue = self._sensors.queue
        while queue:
            self.law.take_sensor(*queue.popleft())


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
    motion : three (joints,) arrays
        Desired positions, rates and accelerations: what is in them when a torque is sent goes
        with it.
    torque : (joints,) array
        What is sent [N m or N].
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
        motion: tuple[Array, Array, Array],
        torque: Array,
        every_message: bool,
        with_point: bool,
        impedance: ImpedanceOutput | None = None,
    ) -> None:
        self.sent, self._impedance = 0, impedance
        self._motion, self._torque = motion, torque
        self._effort = JointStateMessage(joints, ('position', 'velocity', 'effort'))
        self._commands = CommandMessage(joints)
        self._point = TrajectoryPointMessage(joints) if with_point else None
        effort_qos = EVERY_MESSAGE if every_message else STATE
        effort = node.create_publisher(JointState, '~/effort', effort_qos)
        self._effort_listeners = listeners(effort)
        # in simulated time none may be lost; in real time an old one is worth nothing
        command_qos = EVERY_MESSAGE if node.clock.is_simulated else COMMAND
        commands = node.create_publisher(Float64MultiArray, '~/commands', command_qos)
        self._publish_effort, self._publish_commands = raw_publish(effort), raw_publish(commands)
        q, qd, qdd = motion
        message, point = self._effort, self._point
        copies: list[tuple[Numbers, Numbers]] = [
            (self._commands.values, torque),
            (message.position, q),
            (message.velocity, qd),
            (message.effort, torque),
        ]
        if point is not None:
            publisher = node.create_publisher(JointTrajectory, '~/joint_trajectory', COMMAND)
            self._publish_point = raw_publish(publisher)
            copies += [(point.positions, q), (point.velocities, qd), (point.accelerations, qdd)]
            copies += [(point.effort, torque)]
        self._fill = MessageFiller((message,), copies).fill

    def send(self, stamp_ns: int, is_following: bool = True) -> None:
        """Publish the torque on all topics; say whether the motion is the reference's."""
        self._fill(stamp_ns)
        self._publish_commands(self._commands.bytes())
        self.sent += 1
        if self._effort_listeners():
            self._publish_effort(self._effort.bytes())
        if self._impedance is not None:
            q, qd, _ = self._motion
            self._impedance.send(stamp_ns, q, qd, self._torque, is_following)
        if self._point is not None:
            self._publish_point(self._point.bytes())

    def send_effort(self, stamp_ns: int) -> None:
        """Publish `~/effort` only: position and velocity are those the torque is for."""
        self._fill(stamp_ns)
        if self._effort_listeners():
            self._publish_effort(self._effort.bytes())


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
