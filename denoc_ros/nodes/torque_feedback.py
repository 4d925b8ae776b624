"""Feedback that a node adds to its torque: damping by strain, or state feedback."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from denoc_ros.dynamics.feedforward import TorqueFeedforward
from denoc_ros.dynamics.robot import Robot
from denoc_ros.nodes.robot_node import RobotNode
from denoc_ros.nodes.sensor_inputs import SEARCH_PERIOD, SensorInputs
from denoc_ros.runtime.conversions import JointStateReader
from denoc_ros.runtime.live_state_feedback import LiveStateFeedback
from denoc_ros.runtime.parameters import Settings
from denoc_ros.runtime.reference import ReferenceFollower
from denoc_ros.runtime.status import Status
from denoc_ros.runtime.strain_feedback import StrainFeedback
from denoc_ros.types import Array


class TorqueFeedback:
    """Feedback by the parameters `feedback.*`; without them it neither listens nor acts.

    Parameters
    ----------
    node : RobotNode
        It subscribes to the sensors once they are needed.

    Attributes
    ----------
    state : LiveStateFeedback
    """

    def __init__(self, node: RobotNode) -> None:
        name = node.get_fully_qualified_name()
        self._node = node
        self._strain = StrainFeedback(name)
        self.state = LiveStateFeedback(name)
        self._strain_robot: Robot | None = None
        self._sensors: SensorInputs | None = None
        self._plan: Array | None = None

    def build(
        self,
        robot: Robot,
        joints: Sequence[str],
        settings: Settings,
        limits: Array,
        posture: Array,
        patience: float = 0.0,
    ) -> None:
        """Take a robot over; prove the wanted feedback safe, and listen to its sensors.

        `patience` [s] is of :meth:`LiveStateFeedback.build`.

        Raises
        ------
        ConfigError, StateError
            As of :meth:`StrainFeedback.build` and :meth:`LiveStateFeedback.build`.
        """
        before = self.wanted
        self.state.build(robot, joints, settings, limits, posture, patience)
        if robot is not self._strain_robot:  # its parameters are not live, its filter goes on
            self._strain.build(robot, joints, settings, limits)
            self._strain_robot = robot
        if not self.wanted:
            return
        if self._sensors is None:
            self._sensors = SensorInputs(self._node)
            self._node.create_timer(
                SEARCH_PERIOD, self._sensors.search, clock=self._node.steady_clock
            )
        if not before:
            self._sensors.queue.clear()  # of a time in which nobody listened
        self._sensors.update(robot.tree)

    @property
    def wanted(self) -> bool:
        """Whether there is a feedback, or one that fades."""
        return self._strain.wanted or self.state.wanted

    def take_joints(self, reader: JointStateReader, now: float) -> None:
        """Take the joint states that have arrived at a time of the steady clock [s]."""
        if self.state.wanted:
            velocity = reader.velocity if reader.has_velocity else None
            wall = 1e-9 * self._node.stamp_ns_at(now)
            self.state.take_joints(1e-9 * reader.stamp_ns, now, wall, reader.position, velocity)

    def watch(self, follower: ReferenceFollower, position: Array) -> None:
        """Prepare the feedback beside the loop; see :meth:`LiveStateFeedback.watch`."""
        self.state.watch(follower, position)

    @property
    def busy(self) -> bool:
        """Whether gains are in work."""
        return self.state.wanted and self.state.busy

    def search(self) -> None:
        """Listen to the sensors that have appeared."""
        if self._sensors is not None:
            self._sensors.search()

    def begin(self) -> None:
        """Start anew."""
        self._plan = None
        self.state.begin()

    def stop(self) -> None:
        """End the work beside the loop."""
        self.state.stop()

    def close(self) -> None:
        """End the process that designs gains, if there is one."""
        self.state.close()

    def add(
        self, torque: Array, source: TorqueFeedforward, wanted: Array, now: float, lead: float
    ) -> Array:
        """Return a torque (n,) with the feedback.

        Parameters
        ----------
        torque : (n,) array
            Of the plan.
        source : TorqueFeedforward
            With the plan's state.
        wanted : (n,) array
            Reference of the driven joints.
        now, lead : float
            Time of the tick, steady clock [s], and how far ahead the plan is.
        """
        if not self.wanted:
            return torque
        self._take_values()
        if self._strain.wanted:
            return self._strain.add(torque, now)
        self._plan = torque.copy()
        added = self.state.torque(now, lead, wanted, source.whole_motion(), self._plan)
        return torque if added is None else np.asarray(torque + added)

    def wait(
        self, torque: Array, source: TorqueFeedforward, wanted: Array, now: float, lead: float
    ) -> None:
        """Go on with the estimate in a tick in which another torque leaves; arguments as `add`.

        A machine that stood still has no joint states in its first tick: the estimate knows what
        the torque did meanwhile.
        """
        if self.state.wanted:
            self._take_values()
            self._plan = torque.copy()
            self.state.wait(now, lead, wanted, source.whole_motion(), self._plan)

    def applied(self, left: Array) -> None:
        """Take the torque (n,) that left after all limits."""
        if self._plan is not None:
            self.state.applied(left - self._plan)
            self._plan = None

    def rest(self) -> None:
        """Let go: something else than the plan leaves."""
        self._plan = None
        if self.state.wanted:
            self._take_values()
            self.state.rest()

    def _take_values(self) -> None:
        """Pass on the values of the sensors."""
        assert self._sensors is not None
        queue = self._sensors.queue
        while queue:
            value = queue.popleft()
            if self._strain.wanted:
                self._strain.take(*value)
            self.state.take_sensor(*value)

    def statuses(self) -> list[Status]:
        """State of the state feedback, if it is wanted."""
        return [self.state.status()] if self.state.wanted else []
