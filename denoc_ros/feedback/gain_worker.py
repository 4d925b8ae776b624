"""Gains of the state feedback, designed in another process than the loop's."""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.feedback.feedback_settings import FeedbackSettings
from denoc_ros.feedback.gain_jobs import GainJob, read_schedule
from denoc_ros.feedback.gain_schedule import GainSchedule
from denoc_ros.feedback.state_feedback import StateFeedback
from denoc_ros.runtime.worker.worker import Answer, Planner
from denoc_ros.trajectories import SplineTrajectory
from denoc_ros.types import Array

LIMIT = 120.0  # s for a design: a cold kernel cache compiles on a slow machine
TRIES = 3  # of a design in a process that dies or hangs
LOOK = 0.005  # s between looks for an answer that is waited for
KEPT = 4  # schedules of motions that may come again, beside that of one posture
TURN = 0.1  # rad or m from a posture within which its gains need not be made anew


@dataclass(frozen=True)
class FeedbackModel:
    """Input of the gains' design: the robot with its driven joints, limits and settings.

    `source` describes the robot to the other process: `source`, `gravity`,
    `geometric_stiffness`, `overrides`. `has_rates` says whether the joints' rates are measured.
    """

    robot: Robot
    joints: tuple[str, ...]
    limits: Array
    posture: Array
    given: FeedbackSettings
    source: dict[str, Any] = field(default_factory=dict)
    has_rates: bool = True

    @property
    def settings(self) -> FeedbackSettings:
        """The given settings, without rates where none are measured."""
        if self.has_rates:
            return self.given
        return replace(self.given, velocity_noise=math.inf)

    def job(self, position: Array, trajectory: SplineTrajectory | None = None) -> GainJob:
        """Return the job to design gains along a trajectory, else about a position (joints,)."""
        return GainJob(self.joints, self.limits, self.posture, self.settings, position, trajectory)


@dataclass(frozen=True)
class WantedGains:
    """Gains that are wanted: along a trajectory from its start [s], or about a posture."""

    model: FeedbackModel
    position: Array
    trajectory: SplineTrajectory | None = None
    start: float = -np.inf

    @property
    def job(self) -> GainJob:
        """The job of the other process."""
        return self.model.job(self.position, self.trajectory)

    def is_like(self, other: WantedGains | None) -> bool:
        """Say whether it asks for the same gains; where a single posture is does not matter."""
        return (
            other is not None
            and self.model is other.model
            and self.trajectory is other.trajectory
            and self.start == other.start
        )

    def has_gains_of(self, other: WantedGains) -> bool:
        """Say whether another's gains serve: the same motion at any time, or a posture near by."""
        mine, its = self.trajectory, other.trajectory
        if self.model is not other.model:
            return False
        if mine is None or its is None:
            near = np.abs(self.position - other.position).max() <= TURN
            return mine is its and bool(near)
        return all(map(np.array_equal, mine.knots(), its.knots()))


class GainWorker:
    """One design at a time in a process of its own; a newer task makes an older one void.

    A motion that comes again, with another start, has the gains of the last time at once, and so
    has the posture of the last ones about a posture.

    In a thread beside the loop the design would hold the interpreter when the loop is due. All
    methods but `take` are one thread's.

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
        self.planner = Planner()
        self._waiting: WantedGains | None = None
        self._solving: WantedGains | None = None
        self._tries = 0
        # for the loop, whole: it takes what is there at any moment
        self._made = deque[tuple[WantedGains, StateFeedback | None]](maxlen=1)
        self._kept = deque[tuple[WantedGains, GainSchedule]](maxlen=KEPT)
        self._kept_posture = deque[tuple[WantedGains, GainSchedule]](maxlen=1)

    @property
    def busy(self) -> bool:
        """Whether a design is in work, or waits for the process."""
        return self._waiting is not None or self._solving is not None

    def begin(self, task: WantedGains) -> None:
        """Ask for a design; one in work counts if its gains serve."""
        self.task = self._waiting = task
        self._tries, self.refusal = 0, ''
        for known, schedule in (*self._kept, *self._kept_posture):
            if task.has_gains_of(known):
                self._waiting = None
                self._made.append((task, StateFeedback(task.model.robot, schedule, task.start)))
                break
        self.look()

    def look(self) -> None:
        """Take the answer of the process; start it anew where it died, hand it the next task."""
        answer = self.planner.poll()
        if answer is not None:
            self._finish(answer)
        if self._waiting is None or not self.planner.start() or self.planner.busy:
            return
        task, self._waiting = self._waiting, None
        self._solving = task
        header, arrays = task.job.message()
        self.planner.submit({**header, 'robot': task.model.source}, arrays, LIMIT)

    def await_design(self, patience: float) -> None:
        """Wait for the design in work, for some time [s]; whether it is made is told by `busy`.

        Not for a callback of a node that is active: nothing is known of how long a process takes.
        """
        end = time.perf_counter() + patience
        while self.busy and time.perf_counter() < end:
            time.sleep(LOOK)
            self.look()

    def stop(self) -> None:
        """Drop the current design, and its result."""
        self.task = self._waiting = None
        self._made.clear()

    def close(self) -> None:
        """End the process."""
        self.stop()
        self._solving = None
        self.planner.close()

    def take(self) -> tuple[WantedGains, StateFeedback | None] | None:
        """Take the design made since the last call: None in place of refused gains."""
        try:
            return self._made.pop()
        except IndexError:
            return None

    def _finish(self, answer: Answer) -> None:
        solved, task, self._solving = self._solving, self.task, None
        if solved is None:
            return
        schedule: GainSchedule | None = None
        if not answer.error:
            schedule = read_schedule(answer.header, answer.arrays, solved.job)
            kept = self._kept_posture if solved.trajectory is None else self._kept
            kept.append((solved, schedule))
        if task is None or not (task is solved or task.has_gains_of(solved)):
            return
        if not answer.header and self._tries < TRIES - 1:  # the process died or hung
            self._tries += 1
            self._waiting = task
            return
        feedback = None
        if schedule is not None:
            feedback = StateFeedback(task.model.robot, schedule, task.start)
        self._waiting, self.refusal = None, answer.error
        self._made.append((task, feedback))
        self.designs += 1
