"""The feedback law of a running node: of the strain rate, or of the whole state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from denoc_ros.dynamics.driven.torque_feedforward import TorqueFeedforward
from denoc_ros.dynamics.robot import Robot
from denoc_ros.feedback.live_state_feedback import LiveStateFeedback
from denoc_ros.feedback.strain_feedback import StrainFeedback
from denoc_ros.runtime.feedback_law import FeedbackLaw
from denoc_ros.runtime.loop.status import Status
from denoc_ros.runtime.parameters.parameter_table import Settings
from denoc_ros.runtime.reference.reference import ReferenceFollower
from denoc_ros.types import Array


class LiveFeedback(FeedbackLaw):
    """Feedback by the parameters `feedback.*`.

    Parameters
    ----------
    name : str
        Of the node.
    in_hurry : bool
        Whether ticks are held to time.

    Attributes
    ----------
    state : LiveStateFeedback
    """

    def __init__(self, name: str, in_hurry: bool = True) -> None:
        self._strain = StrainFeedback(name)
        self.state = LiveStateFeedback(name, in_hurry)
        self._strain_robot: Robot | None = None
        self._plan: Array | None = None

    @property
    def wanted(self) -> bool:
        """Whether there is a feedback, or one that fades."""
        return self._strain.wanted or self.state.wanted

    @property
    def needs_watch(self) -> bool:
        """Whether gains must be designed for the motion to come."""
        return self.state.wanted

    @property
    def busy(self) -> bool:
        """Whether gains are in work."""
        return self.state.wanted and self.state.busy

    def build(
        self, robot: Robot, joints: Sequence[str], settings: Settings, limits: Array,
        posture: Array, patience: float = 0.0,
    ) -> None:  # fmt: skip
        """Take a robot over; prove the wanted feedback safe.

        Raises
        ------
        ConfigError, StateError
            As of :meth:`StrainFeedback.build` and :meth:`LiveStateFeedback.build`.
        """
        self.state.build(robot, joints, settings, limits, posture, patience)
        if robot is not self._strain_robot:  # its parameters are not live, its filter goes on
            self._strain.build(robot, joints, settings, limits)
            self._strain_robot = robot

    def watch(self, follower: ReferenceFollower, position: Array) -> None:
        """Begin the design of gains that will be needed."""
        self.state.watch(follower, position)

    def stop(self) -> None:
        """Drop a design in work."""
        self.state.stop()

    def close(self) -> None:
        """End the process that designs."""
        self.state.close()

    def begin(self) -> None:
        """Start anew."""
        self._plan = None
        self.state.begin()

    def take_joints(
        self, stamp: float, now: float, wall: float, q: Array, qd: Array | None
    ) -> None:
        """Take measured joints."""
        if self.state.wanted:
            self.state.take_joints(stamp, now, wall, q, qd)

    def take_sensor(self, place: int, taken: float, value: float) -> None:
        """Take a calibrated value of one of the robot's sensors, measured at a time [s]."""
        if self._strain.wanted:
            self._strain.take(place, taken, value)
        self.state.take_sensor(place, taken, value)

    def torque(
        self, torque: Array, source: TorqueFeedforward, wanted: Array, now: float, lead: float
    ) -> Array:
        """Return a torque (n,) with the feedback."""
        if self._strain.wanted:
            return self._strain.add(torque, now)
        self._plan = torque.copy()
        added = self.state.torque(now, lead, wanted, source.whole_motion(), self._plan)
        return torque if added is None else np.asarray(torque + added)

    def wait(
        self, torque: Array, source: TorqueFeedforward, wanted: Array, now: float, lead: float
    ) -> None:
        """Go on with the estimate in a tick in which another torque leaves."""
        if self.state.wanted:
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
            self.state.rest()

    def statuses(self) -> list[Status]:
        """State of the state feedback, if it is wanted."""
        return [self.state.status()] if self.state.wanted else []
