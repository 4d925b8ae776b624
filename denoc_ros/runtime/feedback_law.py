"""Feedback law of a node that commands torque: what the part feedback gives, if it is there."""

from __future__ import annotations

from collections.abc import Sequence

from denoc_ros.dynamics.driven.torque_feedforward import TorqueFeedforward
from denoc_ros.dynamics.robot import Robot
from denoc_ros.parts import optional
from denoc_ros.runtime.loop.status import Status
from denoc_ros.runtime.parameters.parameter_table import Settings
from denoc_ros.runtime.reference.reference import ReferenceFollower
from denoc_ros.types import Array


class FeedbackLaw:
    """Torque that is added to that of a plan, from measured joints and sensors.

    This class adds none; the part feedback extends it.

    `build`, `watch`, `stop` and `close` are called beside the loop, all others in the loop.
    """

    @property
    def wanted(self) -> bool:
        """Whether the parameters ask for feedback, or earlier feedback still acts."""
        return False

    @property
    def needs_watch(self) -> bool:
        """Whether `watch` must be called."""
        return False

    @property
    def busy(self) -> bool:
        """Whether gains are in work."""
        return False

    def build(
        self, robot: Robot, joints: Sequence[str], settings: Settings, limits: Array,
        posture: Array, patience: float = 0.0,
    ) -> None:  # fmt: skip
        """Take a robot and its settings over, and prove the wanted feedback safe.

        With `patience` [s] gains about the posture are tried; their design may go on beside.

        Raises
        ------
        ConfigError
            Parameters that the feedback cannot work with.
        StateError
            The feedback would not be stable, or a sensor is missing.
        """

    def watch(self, follower: ReferenceFollower, position: Array) -> None:
        """Begin the design of gains that will be needed; `position` (joints,) is wanted or is."""

    def stop(self) -> None:
        """Drop a design in work."""

    def close(self) -> None:
        """End the process that designs."""

    def begin(self) -> None:
        """Start anew: nothing is known and no torque has left."""

    def take_joints(
        self, stamp: float, now: float, wall: float, q: Array, qd: Array | None
    ) -> None:
        """Take measured joints: stamp, arrival on the steady clock and on that of stamps [s]."""

    def take_sensor(self, place: int, taken: float, value: float) -> None:
        """Take a calibrated value of one of the robot's sensors, measured at a time [s]."""

    def torque(
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
        return torque

    def wait(
        self, torque: Array, source: TorqueFeedforward, wanted: Array, now: float, lead: float
    ) -> None:
        """Go on with the estimate in a tick in which another torque leaves; as `torque`.

        A machine that stood still has no joint states in its first tick: the estimate knows what
        the torque did meanwhile.
        """

    def applied(self, left: Array) -> None:
        """Take the torque (n,) that left after all limits."""

    def rest(self) -> None:
        """Let go: something else than the plan leaves."""

    def statuses(self) -> list[Status]:
        """State of the feedback, if it is wanted."""
        return []


def feedback_law(name: str, in_hurry: bool = True) -> FeedbackLaw:
    """Return the feedback law of a node: none acts where the part feedback is not there.

    Parameters
    ----------
    name : str
        Of the node.
    in_hurry : bool
        Whether ticks are held to time; those of simulated time are not.
    """
    part = optional('feedback.live_feedback')
    found: FeedbackLaw = FeedbackLaw() if part is None else part.LiveFeedback(name, in_hurry)
    return found
