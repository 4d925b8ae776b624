"""State feedback in a running node: gains come from another process."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from denoc_ros.dynamics.base.floating_base import require_known_base
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError, StateError
from denoc_ros.estimation.stamp_clock import StampClock
from denoc_ros.feedback.feedback_parameters import FEEDBACK
from denoc_ros.feedback.feedback_settings import FeedbackSettings
from denoc_ros.feedback.gain_jobs import CHANGED
from denoc_ros.feedback.gain_schedule import require_sensors
from denoc_ros.feedback.gain_worker import TURN, FeedbackModel, GainWorker, WantedGains
from denoc_ros.feedback.planned_states import Row
from denoc_ros.feedback.read_values import unread_values
from denoc_ros.feedback.state_feedback import FEEDBACK_KERNELS, RAMP, StateFeedback
from denoc_ros.kernels.jit.compiled import ready
from denoc_ros.model.numbers import FAMILIES
from denoc_ros.runtime.live_observer import trusted_sensors
from denoc_ros.runtime.loop.status import ERROR, WARN, Status
from denoc_ros.runtime.parameters.parameter_table import Settings
from denoc_ros.runtime.reference.reference import ReferenceFollower
from denoc_ros.runtime.safety.stale_inputs import STALE_JOINTS
from denoc_ros.types import Array

INTERVALS = 25  # between joint states, of which the shortest counts: others may have been lost
MOST_PERIODS = 2.5  # of the loop from a joint state to the next
REACH = 0.3  # rad or m from where they were shown stable within which gains are used


class LiveStateFeedback:
    """Torque of :class:`denoc_ros.feedback.state_feedback.StateFeedback` in a node's loop.

    Gains are made in another process (`watch`): along a trajectory when it has come, else about
    where a streamed reference is. The loop takes them between two ticks. Without gains for where
    reference and joints are, there is no feedback. Neither waits for the other process.

    What leaves changes without a jump where parameters or the model change, or gains for them are
    refused: the difference fades within `RAMP`.

    There is none either where joint states come more rarely than every `MOST_PERIODS` of the loop:
    drives that are told as rarely hold a torque longer than the design knows.

    Ticks may come more often than `feedback.rate`: in a hurry, those in between hold its torque.

    Parameters
    ----------
    name : str
        Of the node.
    in_hurry : bool
        Whether ticks are held to time; those of simulated time are not.

    Attributes
    ----------
    cause : str
        Why none does, '' if one does or soon will.
    """

    def __init__(self, name: str, in_hurry: bool = True) -> None:
        self._name, self._in_hurry = name, in_hurry
        self._model: FeedbackModel | None = None
        self._worker = GainWorker()
        self._using = threading.Lock()  # the worker: by whoever builds, or watches
        self._now: StateFeedback | None = None
        self._waiting: tuple[WantedGains, StateFeedback | None] | None = None
        self._made_for: FeedbackModel | None = None  # of the gains in force
        self._left: Array = np.zeros(0)  # (joints,) what was added last, after all limits
        self._fading: Array | None = None  # (joints,) as it was in the beginning
        self._fades_from = -np.inf  # s of the clock of ticks
        self._stamps = StampClock()
        self._taken = -np.inf  # when the last joint state was [s]
        self._position: Array | None = None  # (joints,) where that one was
        self._intervals = deque[float](maxlen=INTERVALS)  # s
        self._fallbacks = self._told = 0
        self._acted = False  # there was a torque by gains in the last tick
        self._period = 0.0  # of the loop [s]
        self._asked_at = -np.inf  # when the gains gave a torque last [s]
        self._held: Array | None = None  # (joints,) which it was
        self._holds = False  # whether this tick only holds it
        self.active, self.cause = False, 'no gains yet'
        self._has_rates, self._unread = True, list[str]()

    @property
    def wanted(self) -> bool:
        """Whether the parameters ask for feedback, or earlier feedback still acts."""
        return self._model is not None or self._now is not None or self._fading is not None

    def build(
        self, robot: Robot, joints: Sequence[str], settings: Settings, limits: Array,
        posture: Array, patience: float = 0.0,
    ) -> None:  # fmt: skip
        """Take a robot and its settings over, if state feedback is wanted, else end it.

        With `patience` [s] gains about the posture are tried, which may take longer: then this
        goes on beside.

        Raises
        ------
        ConfigError
            Parameters that state feedback cannot work with.
        StateError
            There are no gains about the posture, or they are not stable for models 20 % off.
        """
        if settings.text('feedback.state') == 'off':
            self._model = None
            with self._using:
                self._worker.close()
            return
        self._require(settings)
        ready(*FEEDBACK_KERNELS)
        index = [robot.joint_indices[robot.joint_names.index(joint)] for joint in joints]
        rate = settings.number('update_rate')
        period, held = 1.0 / rate, 1
        if self._in_hurry:
            held = max(1, int(rate / settings.number('feedback.rate')))
        wanted = FEEDBACK.read(
            settings,
            period=held * period,
            tip=settings.text('feedback.tip') or list(robot.tree.frames)[-1],
            delay=settings.number('feedback.delay') * period,
        )
        require_known_base(robot, 'feedback.state')
        require_sensors(robot, joints, limits, wanted)
        model = FeedbackModel(
            robot, tuple(joints), limits.copy(), posture.copy(), wanted,
            _description(robot, settings),
        )  # fmt: skip
        if patience > 0.0:
            with self._using:
                self._try(WantedGains(model, np.array(posture[index])), patience)
        self._model, self._unread, self._period = model, unread_values(robot.tree), period

    def _try(self, task: WantedGains, patience: float) -> None:
        """Begin a design and give it some time [s]; raise StateError if it is refused."""
        worker = self._worker
        worker.begin(task)
        worker.await_design(patience)
        if not worker.busy and worker.refusal:
            worker.close()
            raise StateError(worker.refusal)

    def _require(self, settings: Settings) -> None:
        """Refuse parameters that do not go together."""
        needed = (
            ('trigger', 'clock'), ('reference_source', 'topic'), ('model', 'flexible'),
        )  # fmt: skip
        findings = [
            f"parameter '{key}' must be {value} with state feedback, got {settings.text(key)!r}"
            for key, value in needed
            if settings.text(key) != value
        ]
        if not settings.flag('terms.elastic'):
            findings.append("parameter 'terms.elastic' must be true with state feedback")
        if any(settings.numbers('feedback.strain_gain')):
            findings.append(
                "parameters 'feedback.state' and 'feedback.strain_gain' must not be set both: the "
                'stability check of one does not cover the other'
            )
        ConfigError.raise_any(self._name, findings)

    @property
    def busy(self) -> bool:
        """Whether gains are in work that a tick has not taken yet."""
        return self._worker.busy

    @property
    def designs(self) -> int:
        """How often gains were designed, refusals included."""
        return self._worker.designs

    @property
    def postures(self) -> int:
        """Of how many postures the gains in force are; 0: there are none."""
        return 0 if self._now is None else len(self._now.schedule.times)

    # ---- beside the loop

    def watch(self, follower: ReferenceFollower, position: Array) -> None:
        """Begin the design of gains that will be needed.

        Parameters
        ----------
        position : (joints,) array
            Where the joints are wanted, or stand.
        """
        if self._model is None or not self._using.acquire(blocking=False):
            return
        try:
            self._watch(self._model, follower, position)
        finally:
            self._using.release()

    def _watch(self, model: FeedbackModel, follower: ReferenceFollower, position: Array) -> None:
        worker = self._worker
        worker.look()
        if model.has_rates != self._has_rates:
            model = self._model = replace(model, has_rates=self._has_rates)
        coming, known = follower.trajectories(), worker.task
        task = WantedGains(model, position.copy(), *(coming[-1] if coming else ()))
        moved = known is None or np.abs(position - known.position).max() > TURN
        if task.is_like(known) and (coming or not moved):
            return
        if coming or not worker.busy:
            self._waiting = None
            worker.begin(task)

    def begin(self) -> None:
        """Start anew: nothing is known and no torque has left."""
        self._stamps.reset()
        self._intervals.clear()
        self._position = None
        self._forget_left()
        if self._now is not None:
            self._now.reset()

    def stop(self) -> None:
        """Drop a design in work."""
        self._worker.stop()

    def close(self) -> None:
        """End the process that designs."""
        self._worker.close()

    # ---- in the loop

    def take_joints(
        self, stamp: float, now: float, wall: float, q: Array, qd: Array | None
    ) -> None:
        """Take measured joints: stamp, arrival on the steady clock and on that of stamps [s]."""
        self._has_rates = qd is not None
        before, self._taken = self._taken, self._stamps.taken_at(stamp, now, wall)
        self._intervals.append(self._taken - before)
        self._position = q
        if self._now is not None:
            self._now.filter.take_joints(self._taken, q, qd)

    def take_sensor(self, place: int, taken: float, value: float) -> None:
        """Take a calibrated value of one of the robot's sensors, measured at a time [s]."""
        if self._now is not None:
            self._now.filter.take_sensor(place, taken, value)

    def torque(
        self, now: float, lead: float, wanted: Array, motion: Row, plan: Array | None = None
    ) -> Array | None:
        """Return the torque (joints,) to add to the plan's, None if there is none.

        Parameters
        ----------
        now : float
            Time of the tick, steady clock [s].
        lead : float
            How far ahead of it the plan is taken [s].
        wanted : (joints,) array
            Reference of the driven joints.
        motion : (q, qd, qdd)
            All coordinates (n,) of the plan and their derivatives, of the robot with all its
            springs.
        plan : (joints,) array, optional
            Torque of the plan, for ticks that come late; it must not change before the next tick.
        """
        changed = self._swap(now)
        torque = self._torque(now, lead, wanted, motion, plan)
        left, self._acted = self._acted and torque is None, torque is not None
        if (changed or left) and self._left.any():
            self._fading = self._left - (0.0 if torque is None else torque)
            self._fades_from = now
        if self._fading is None:
            return torque
        share = 1.0 - (now - self._fades_from) / RAMP
        if share <= 0.0:
            self._fading = None
            return torque
        return share * self._fading if torque is None else torque + share * self._fading

    def _torque(
        self, now: float, lead: float, wanted: Array, motion: Row, plan: Array | None
    ) -> Array | None:
        """Return the torque (joints,) by the gains in force, None if there are none for here."""
        feedback = self._now
        if feedback is None:
            self._note('refused' if self._worker.refusal else 'no gains yet', False)
            return None
        period = feedback.schedule.settings.period
        held = 0.0 <= now - self._asked_at < period - 0.5 * self._period
        self._holds = held and self._held is not None
        if self._holds:
            return self._held
        self._held = None
        longest = MOST_PERIODS * self._period
        if len(self._intervals) == INTERVALS and min(self._intervals) > longest:
            feedback.rest()
            self._note(
                f'joint states must come every {1e3 * longest:.3g} ms or more often, '
                f'got one every {1e3 * min(self._intervals):.2g} ms',
                False,
            )
            return None
        feedback.follow(now + lead, *motion)
        if not feedback.is_near(now, wanted, REACH):
            feedback.rest()
            self._note('no gains for this posture yet', False)
            return None
        if self._position is not None and not feedback.is_near(now, self._position, REACH):
            feedback.rest()
            self._note(
                f'joints must be within {REACH:g} of where the gains are, got others', False
            )
            return None
        self._held, self._asked_at = feedback.torque(now, plan), now
        self._note(feedback.cause, feedback.active)
        return self._held

    def wait(self, now: float, lead: float, wanted: Array, motion: Row, plan: Array) -> None:
        """Do all that :meth:`torque` does, but let none leave."""
        self.torque(now, lead, wanted, motion, plan)
        self._note(STALE_JOINTS, False)

    def applied(self, change: Array) -> None:
        """Take the torque (joints,) that was added to the plan's after all limits, and go on."""
        self._left = change
        if self._now is not None and not self._holds:
            self._now.applied(change)

    def rest(self) -> None:
        """Let go: something else than the plan leaves."""
        self._forget_left()
        if self._now is not None:
            self._now.rest()
            self.active = False

    def _forget_left(self) -> None:
        self._left, self._fading, self._held = np.zeros(0), None, None

    def _note(self, cause: str, active: bool) -> None:
        self._fallbacks += self.active and not active
        self.active, self.cause = active, cause

    def _swap(self, now: float) -> bool:
        """Take gains that are made over: when their trajectory begins, or while none act.

        Returns whether they are of another model or other settings, or there are none any more.
        """
        if self._model is None:
            changed, self._now, self._waiting = self._now is not None, None, None
            return changed
        made = self._waiting or self._worker.take()
        if made is None:
            return False
        task, feedback = made
        if task.start > now and self._acted:
            self._waiting = made
            return False
        self._waiting = None
        goes_on = feedback is not None and (self._now is None or feedback.adopt(self._now))
        changed = not goes_on or self._made_for is not task.model
        if feedback is not None:
            feedback.hold = self._period
        if not goes_on:
            self._held = None
        self._now, self._made_for = feedback, task.model
        return changed

    # ---- diagnostics

    def status(self) -> Status:
        """State of the feedback, with warnings for events since the last call."""
        feedback, worker = self._now, self._worker
        if self._model is None:
            return Status('state feedback', message='switched off')
        status = Status('state feedback', message=self.cause or 'active')
        status.values = {
            'active': self.active,
            'cause': self.cause,
            'fallbacks': self._fallbacks,
            'designs': worker.designs,
            'designing': worker.busy,
            'refused': worker.refusal,
            'unread': ' '.join(self._unread),
        }
        if feedback is not None:
            status.values['share'] = round(feedback.share, 3)
            status.values['joint_share'] = round(feedback.joint_share, 3)
            status.values['slowest'] = str(feedback.schedule.slowest)
            status.values['lowered'] = lowered = self._lowered(feedback.schedule.settings)
            if lowered and not self.cause:
                status.message = f'active, made stable: {lowered}'
            status.values['limited'] = feedback.limited
            if feedback.filter.faults is not None:
                status.values |= trusted_sensors(feedback.filter.faults)
            status.values['outliers'] = ' '.join(map(str, feedback.filter.refused.tolist()))
        if worker.refusal:
            status.worsen(ERROR, worker.refusal)
        elif self._fallbacks > self._told or self.cause:
            status.worsen(WARN, f'plan alone: {self.cause}' if self.cause else 'was plan alone')
        self._told = self._fallbacks
        return status

    def _lowered(self, settings: FeedbackSettings) -> str:
        """Return which settings a design has changed so that the loop is stable."""
        given = None if self._made_for is None else self._made_for.settings
        return ', '.join(
            f'{name} {getattr(settings, name):.3g} in place of {getattr(given, name):.3g}'
            for name in CHANGED
            if given is not None and getattr(settings, name) != getattr(given, name)
        )


def _description(robot: Robot, settings: Settings) -> dict[str, Any]:
    """Description of the robot for another process."""
    return {
        'source': robot.tree.source,
        'gravity': robot.gravity.tolist(),
        'geometric_stiffness': robot.geometric_stiffness,
        'overrides': settings.family(*FAMILIES),
    }
