"""Gains of the state feedback, designed in parallel to the loop."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from denoc_ros.control.feedback_settings import FeedbackSettings
from denoc_ros.control.gain_schedule import design
from denoc_ros.control.planned_states import state_at, states_along
from denoc_ros.control.state_feedback import StateFeedback
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.trajectories import SplineTrajectory
from denoc_ros.types import Array


@dataclass(frozen=True)
class FeedbackModel:
    """What gains are designed for: the robot with its driven joints, limits and settings.

    `has_rates` says whether the joints' rates are measured.
    """

    robot: Robot
    joints: tuple[str, ...]
    limits: Array
    posture: Array
    given: FeedbackSettings
    has_rates: bool = True

    @property
    def settings(self) -> FeedbackSettings:
        """What was asked for, without the rates where none are measured."""
        if self.has_rates:
            return self.given
        return replace(self.given, velocity_noise=math.inf)

    def at(self, position: Array, going_on: Callable[[], bool] = lambda: True) -> StateFeedback:
        """Return the feedback about rest with the driven joints at positions (joints,)."""
        robot, settings = self.robot.copy(), self.settings
        torque = settings.effort_share * self.limits
        state = state_at(robot, self.joints, position, torque, self.posture)
        schedule = design(
            robot, self.joints, self.limits, np.zeros(1), [state], settings, going_on
        )
        return StateFeedback(self.robot, schedule)

    def along(
        self, trajectory: SplineTrajectory, start: float, going_on: Callable[[], bool]
    ) -> StateFeedback:
        """Return the feedback along a trajectory that starts at a time of the steady clock [s]."""
        robot, settings = self.robot.copy(), self.settings
        times, states = states_along(
            robot, self.joints, trajectory.sample, trajectory.duration, settings.period,
            self.posture,
        )  # fmt: skip
        schedule = design(robot, self.joints, self.limits, times, states, settings, going_on)
        return StateFeedback(self.robot, schedule, start)


@dataclass(frozen=True)
class WantedGains:
    """Gains that are wanted: along a trajectory from its start [s], or about a posture."""

    model: FeedbackModel
    position: Array
    trajectory: SplineTrajectory | None = None
    start: float = -np.inf

    def is_like(self, other: WantedGains | None) -> bool:
        """Say whether it asks for the same gains, but for where a lone posture is."""
        return (
            other is not None
            and self.model is other.model
            and self.trajectory is other.trajectory
            and self.start == other.start
        )


class GainWorker:
    """One design at a time in a thread; a newer task ends an older one.

    Attributes
    ----------
    task : WantedGains or None
        The one in work, or done last.
    refusal : str
        Why the last one gave no gains, '' if it did.
    designs : int
        How many have been made.
    """

    def __init__(self) -> None:
        self.task: WantedGains | None = None
        self.refusal = ''
        self.designs = 0
        self._made: tuple[WantedGains, StateFeedback | None] | None = None
        self._thread: threading.Thread | None = None

    @property
    def busy(self) -> bool:
        """Whether a design is in work."""
        return self._thread is not None and self._thread.is_alive()

    def begin(self, task: WantedGains) -> None:
        """Begin a design; the one in work is dropped."""
        self.task = task
        self._thread = threading.Thread(target=self._work, args=(task,), daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Drop the design in work, and what was made."""
        self.task = self._made = None

    def take(self) -> tuple[WantedGains, StateFeedback | None] | None:
        """Return what was made since the last call: None in place of gains that were refused."""
        made, self._made = self._made, None
        return made

    def _work(self, task: WantedGains) -> None:
        def going_on() -> bool:
            return self.task is task

        feedback, refusal = None, ''
        try:
            if task.trajectory is None:
                feedback = task.model.at(task.position, going_on)
            else:
                feedback = task.model.along(task.trajectory, task.start, going_on)
        except (StateError, SolverError) as error:
            refusal = str(error)
        if going_on():
            self.refusal = refusal
            self.designs += 1
            self._made = task, feedback
