"""The shaper node: a motion in, a joint motion without residual vibration out."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from denoc_ros.dynamics.driven.driven_joints import all_joints
from denoc_ros.dynamics.driven.joint_limits import joint_limits
from denoc_ros.dynamics.driven.torque_feedforward import TorqueFeedforward
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import DenocError
from denoc_ros.model.mode_table import ModeTable
from denoc_ros.nodes.base.messages import (
    TrajectoryPointMessage,
    exact_bytes,
    planned_message,
    unshaped_message,
)
from denoc_ros.nodes.base.process import leave, run
from denoc_ros.nodes.base.robot_node import RobotNode
from denoc_ros.planning.motion_planning import (
    MotionPlanning,
    check_planning,
    given_limits,
    mode_table,
    robot_job,
    servo_columns,
    shape_job,
)
from denoc_ros.planning.shaper_parameters import OF_STREAMS, TABLE
from denoc_ros.planning.shapers.joint_servo import joint_servo
from denoc_ros.planning.shapers.ringing import RingingModes, ringing_modes, ringing_robot
from denoc_ros.planning.shapers.shaped_stream import ShapedStream
from denoc_ros.runtime.inputs.input_monitor import InputError
from denoc_ros.runtime.inputs.joint_input import JointInput
from denoc_ros.runtime.inputs.trajectory_messages import (
    RequestedMotion,
    TrajectoryMessage,
    has_many_points,
    read_trajectory,
)
from denoc_ros.runtime.loop.clocks import StampOf
from denoc_ros.runtime.loop.status import ERROR, WARN, Status
from denoc_ros.runtime.parameters.parameter_table import Settings
from denoc_ros.runtime.reference.braking import Rows, brake
from denoc_ros.runtime.reference.reference import reference_follower
from denoc_ros.runtime.safety.motion_bounds import motion_bounds
from denoc_ros.runtime.worker.worker import Answer
from denoc_ros.settings import Value
from denoc_ros.trajectories import SplineTrajectory
from denoc_ros.types import Array

LOOK_PERIOD = 0.02  # s between looks at the planner
LOADING_PATIENCE = 30.0  # s that configure waits for the planner: half of what a callback may take
RETUNE_PERIOD = 0.05  # s between looks at the modes of a stream
STOP_MARGIN = 0.1  # s from a stop to the first change of the motion, at most
OWN_ROWS = 100  # of a motion, to find its largest accelerations and torques
WITHIN = 1.01  # times a limit that a braking may take
ROUNDING = 1e-9  # rad/s^2 or m/s^2
STOP_TOLERANCE = 5e-3  # rad or m beside where a stop ended that a motion may begin
# one whole motion after the other must not lose the first
REFERENCE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)


@dataclass(frozen=True)
class CarriedMotion:
    """A published motion."""

    trajectory: SplineTrajectory  # of all joints
    start: float  # when it begins, by the node's clock [s]
    named: Sequence[int] | None  # places of the joints that it was published for; None: all
    stops: bool = False  # whether it is a braking

    @property
    def end(self) -> float:
        """When it is at rest, by the node's clock [s]."""
        return self.start + self.trajectory.duration


class ShaperNode(RobotNode):
    """Plans whole motions in a process of its own, and shapes streams in its loop."""

    sees_joint_states = True

    def __init__(self, **options: Any) -> None:
        super().__init__('shaper', TABLE, **options)
        self.planning = MotionPlanning(self.to_log.append, self._take_answer)
        self._lock = threading.Lock()
        self._table: ModeTable | None = None
        self.add_trigger_service('~/stop', self._stop)
        self.add_trigger_service('~/reset', self._reset)
        self.add_trigger_service('~/reload_model', self.reload)
        self.create_timer(LOOK_PERIOD, self._look, clock=self.steady_clock)
        if not self.clock.is_simulated:  # else in the tick
            self.create_timer(RETUNE_PERIOD, self._retune, clock=self.steady_clock)
        self._carried: CarriedMotion | None = None  # what was published last
        self._known: Array | None = None  # (joints,) where the last motion ends
        self._stopped_at: Array | None = None  # (joints,) the same, after a stop on the way
        self._said = {'planned': 0, 'refused': 0, 'passed on': 0, 'streams': 0}
        self._last_failure, self._failures_reported = '', 0
        self._solve_last = self._solve_max = 0.0

    # ---- configure

    def prepare(self) -> None:
        """Build the shaper of streams and start the planner; run each once."""
        settings, robot = self.settings, self.robot
        self.joints = self.driven_joints(settings)
        self._table = mode_table(settings)
        self._check(settings)
        n = len(self.joints)
        self.bounds = motion_bounds(robot, self.joints, settings)
        self.motion = JointInput(robot, self.joints, self.bounds, allow_extra=True)
        stale_after, posture = settings.number('stream_timeout'), self.posture(robot, settings)
        self.stream = ShapedStream(
            n,
            self.period,
            stale_after,
            settings.number('stop_time'),
            reference_follower(robot, self.joints, stale_after, self.bounds, posture),
        )
        self._modes_robot = ringing_robot(robot, settings.text('base'))
        self._point = TrajectoryPointMessage(self.joints)
        self._reference = self.create_publisher(JointTrajectory, 'reference', REFERENCE)
        self._load(LOADING_PATIENCE)
        if self.planning.load_error:
            rule = f'the planner must load the robot, got: {self.planning.load_error}'
            raise self.config_error(rule)

    def connect(self) -> None:
        """Subscribe."""
        self.input = self.listen_in_loop(
            JointTrajectory, '~/input', self._on_input, has_many_points
        )
        self.joint_input = self.listen_in_loop(JointState, 'joint_states', self._on_joint_state)

    def _load(self, patience: float = 0.0) -> None:
        robot = robot_job(self.settings, self.description)
        self._rest = self.posture(self.robot, self.settings)
        job = shape_job(self.settings, robot, self.joints)
        self.planning.load(job, self._rest, patience)

    def _check(self, settings: Settings) -> None:
        """Refuse settings that the planner cannot work with."""
        try:
            check_planning(self.robot, self.joints, settings, self._table)
        except DenocError as error:
            raise self.config_error(str(error)) from error

    def _modes(self, driven: Array, settings: Settings) -> RingingModes:
        robot = self._modes_robot
        (posture,) = all_joints(robot, self.joints, driven[None])
        return ringing_modes(robot, posture, settings.integer('modes') or None, self._table)

    # ---- inputs

    def _on_joint_state(self, raw: bytes, now: float) -> None:
        self.motion.take(raw, now, self.joint_input, self.refuse)

    def _where(self) -> Array | None:
        """Return the joint positions (joints,), None if they are unknown."""
        if self._known is not None:
            return self._known
        return self.motion.position.copy() if self.joint_input.received else None

    def _on_input(self, raw: bytes, now: float) -> None:
        if self.state != 'active':
            raise InputError('inactive', 'the node must be active, got a motion before that')
        message = read_trajectory(raw, self.joints, self.bounds, partial=True)
        with self._lock:
            if message.is_cancel:
                self.input.accept(message.stamp_ns or None, now)
                self._brake(now)
                if not self.stream.active and not self._left(now):
                    empty = JointTrajectory(joint_names=self.joints)
                    self._reference.publish(exact_bytes(empty))
            elif message.is_streamed:
                self._take_point(message, now)
            else:
                self._take_motion(message, now)

    def _require_rest(self, now: float) -> None:
        """Refuse a motion while another one is planned or carried out."""
        if self.planning.busy:
            raise InputError('busy', 'a motion must come after the one before is planned')
        left = self._left(now)
        if left > 0.0:
            raise InputError(
                'in_motion', f'a motion must begin at rest, got one {left:.3g} s before that'
            )

    def _left(self, now: float) -> float:
        """Remaining time of the published motion [s]."""
        return 0.0 if self._carried is None else max(0.0, self._carried.end - now)

    def _require_continuity(self, message: TrajectoryMessage) -> None:
        """Refuse a motion that begins elsewhere than where the one before was stopped."""
        stopped = self._stopped_at
        if stopped is None or message.times[0] > 0.0:
            return
        away = np.abs(message.positions[0] - stopped)
        away[list(message.held)] = 0.0
        if (far := float(away.max())) > STOP_TOLERANCE:
            there = ', '.join(f'{q:.4f}' for q in stopped)
            raise InputError(
                'not_at_start',
                f'after a stop a motion must begin where the joints came to rest ({there}), or '
                f'after time 0, got {far:.3g} rad or m beside it',
            )

    def _take_motion(self, message: TrajectoryMessage, now: float) -> None:
        """Keep a whole motion for the planner."""
        if self.stream.active:
            raise InputError('in_motion', 'a motion must begin at rest, got one within a stream')
        self._require_rest(now)
        self._require_posture(message)
        self._require_continuity(message)
        self.input.accept(message.stamp_ns or None, now)
        self.planning.take(RequestedMotion(message, self._where()))

    def _require_posture(self, message: TrajectoryMessage) -> None:
        begins_later = len(message.times) > 0 and message.times[0] > 0.0
        if (message.held or begins_later) and self._where() is None:
            raise InputError(
                'missing_joint',
                'a motion must name all joints from time 0 on while their positions are unknown',
            )

    def _take_point(self, message: TrajectoryMessage, now: float) -> None:
        method = self.settings.text('method')
        if self.stream.ending:
            raise InputError(
                'in_motion', 'a stream must begin at rest, got a point while it stops'
            )
        if not self.stream.active:
            self._require_rest(now)
            self._require_posture(message)
            self._require_continuity(message)
        if method not in OF_STREAMS:
            self.input.accept(message.stamp_ns or None, now)
            why = f'method {method} needs whole motions, got a single point'
            self._fail(RequestedMotion(message, self._where()), why)
            return
        if not self.stream.active:
            start = RequestedMotion(message, self._where()).whole().positions[0]
            modes = self._modes(start, self.settings)
            servo = joint_servo(len(self.joints), **servo_columns(self.settings))
            self.stream.begin(method, modes, start, servo)
            self._carried = self._stopped_at = None
            self._said['streams'] += 1
        self.offer(self.stream.follower, message, self.input, now, self.stream.last)

    def _drop(self) -> None:
        """Forget planned and streamed motions; published ones go on."""
        self.planning.drop()
        self.stream.end()

    def _brake(self, now: float) -> None:
        """Drop planned motions; bring streamed or published ones to rest."""
        self.planning.drop()
        if self.stream.active:
            self.stream.brake()
            return
        carried = self._carried
        if carried is None or carried.stops or now >= carried.end:
            return
        braked = self._braked(carried)
        if braked is None:  # it is at rest before
            return
        begin, rows = braked
        begin_ns = self.stamp_ns_at(begin)
        arrays = dict(zip(('t', 'q', 'qd', 'qdd'), rows, strict=True))
        message = planned_message(self.joints, arrays, begin_ns, carried.named)
        self._publish_motion(
            message, CarriedMotion(SplineTrajectory(*rows), begin, carried.named, True)
        )
        self._stopped_at = self._known

    def _braked(self, carried: CarriedMotion) -> tuple[float, Rows] | None:
        """Return when the braking of a motion begins, by the node's clock [s], and its rows.

        It begins so far ahead that it has been found by then: a follower would jump to it.
        """
        settings = self.settings
        step, shortest = settings.number('output_step'), settings.number('stop_time')
        allows = self._braking_limits(carried.trajectory)
        wait = min(settings.number('start_margin'), STOP_MARGIN)
        while True:
            now = self.clock.now()
            moment = now + wait - carried.start
            rows: Rows | None
            if moment <= 0.0:  # it has not begun, and does not
                q = np.repeat(carried.trajectory.knots()[1][:1], 2, axis=0)
                rest = np.zeros_like(q)
                rows = np.array([0.0, step]), q, rest, rest
            else:
                rows = brake(carried.trajectory, moment, shortest, step, allows)
            if rows is None:
                return None
            if self.clock.now() - now <= 0.5 * wait:
                return now + wait, rows
            wait = max(2.0 * wait, LOOK_PERIOD)

    def _braking_limits(
        self, trajectory: SplineTrajectory
    ) -> Callable[[Array, Array, Array], bool]:
        """Make a check whether the joints can brake so: by their limits, or as in the motion.

        Where the motion itself is beyond a limit, its own largest value is the limit.
        """
        places = [self.robot.joint_names.index(joint) for joint in self.joints]
        given = given_limits(self.settings, self.joints)
        limits = joint_limits(self.robot, **given).of(np.array(places))
        source = TorqueFeedforward(self.robot.copy(), self.joints, 'rigid', posture=self._rest)
        own = trajectory.table(trajectory.duration / OWN_ROWS)[1:]

        def torque(q: Array, qd: Array, qdd: Array) -> Array:
            return np.array(
                [source.update(*row, 0.0).copy() for row in zip(q, qd, qdd, strict=True)]
            )

        largest = np.abs(own[2]).max(axis=0)
        acceleration = np.maximum(limits.acceleration, largest) + ROUNDING
        effort, known = limits.effort, bool(np.isfinite(limits.effort).all())
        try:
            effort = np.maximum(effort, np.abs(torque(*own)).max(axis=0)) if known else effort
        except DenocError:  # a motion that the model cannot follow: its own accelerations do
            known = False
        if not known:
            acceleration = np.where(np.isinf(acceleration), largest + ROUNDING, acceleration)

        def allows(q: Array, qd: Array, qdd: Array) -> bool:
            if (np.abs(qdd).max(axis=0) > WITHIN * acceleration).any():
                return False
            some = slice(None, None, max(1, len(q) // OWN_ROWS))
            try:
                found = torque(q[some], qd[some], qdd[some]) if known else np.zeros(1)
            except DenocError:
                return False
            return not known or bool((np.abs(found) <= WITHIN * effort).all())

        return allows

    # ---- loop: streams

    def begin(self) -> None:
        """Start without a motion, but for a published one that goes on."""
        with self._lock:
            self._drop()
            if self._left(self.clock.now()) == 0.0:
                self._forget()
        self._stamp_of = StampOf(self.clock)
        self._retune_due = -math.inf

    def restart(self) -> None:
        """Forget published motions too: they belong to a time that is no more."""
        self._forget()
        super().restart()

    def _forget(self) -> None:
        self._carried = self._known = self._stopped_at = None

    def tick(self, steps: int) -> None:
        """Publish a streamed motion's shaped sample for now."""
        assert self.loop is not None
        now = self.loop.deadline
        if self.clock.is_simulated and now >= self._retune_due:
            self._retune_due = now + RETUNE_PERIOD
            self._retune()
        row = self.stream.tick(now, steps)
        if row is None:
            return
        self.bounds.require(row[0], row[1])  # what a follower would refuse does not leave
        self._known = self.stream.last
        point = self._point
        point.positions[:], point.velocities[:], point.accelerations[:] = row
        self._reference.publish(point.bytes(self._stamp_of(now)))

    @property
    def holds_time(self) -> bool:
        """Whether a plan is in work: it belongs to the time at which it was asked for."""
        return self.planning.busy

    def rescue(self) -> bool:
        """End a stream that fails: nothing more leaves."""
        self.stream.end()
        return True

    def _retune(self) -> None:
        """Take the modes of where a stream is now."""
        if self.state == 'active' and self.stream.active:
            self.stream.retune(self._modes(self.stream.last, self.settings))

    # ---- planner: whole motions

    def _look(self) -> None:
        """Hand motions to the planner, take plans from it, start it anew where it died."""
        if self.is_configured:
            with self._lock:
                self.planning.look(self.settings, robot_job(self.settings, self.description))

    def _take_answer(self, motion: RequestedMotion, answer: Answer) -> None:
        if self.state != 'active':
            return
        if answer.error:
            self._fail(motion, answer.error)
        else:
            self._release(motion, answer)

    def _release(self, motion: RequestedMotion, answer: Answer) -> None:
        """Publish a plan, once and whole, to begin early enough for its preaction."""
        took = float(answer.header['took'])
        self._solve_last, self._solve_max = took, max(self._solve_max, took)
        now, now_ns = self.clock.now(), self.stamp_ns()
        margin = round(1e9 * self.settings.number('start_margin'))
        arrays = answer.arrays
        wanted = motion.message.stamp_ns + round(1e9 * arrays['t'][0])
        begin_ns = max(now_ns + margin, wanted if motion.message.stamp_ns else 0)
        chosen = motion.named if self.settings.text('method') in OF_STREAMS else None
        message = planned_message(self.joints, arrays, begin_ns, chosen)
        rows = arrays['t'] - arrays['t'][0], arrays['q'], arrays['qd'], arrays['qdd']
        begin = now + 1e-9 * (begin_ns - now_ns)
        self._publish_motion(message, CarriedMotion(SplineTrajectory(*rows), begin, chosen))
        self._said['planned'] += 1
        self.to_log.append(
            f'planned in {took:.3g} s: {arrays["t"][-1] - arrays["t"][0]:.3g} s of motion, '
            f'{answer.header["delay"]:.3g} s later than asked for'
        )

    def _publish_motion(self, message: JointTrajectory, carried: CarriedMotion) -> None:
        self._carried, self._stopped_at = carried, None
        self._known = carried.trajectory.knots()[1][-1]
        if not self._reference.get_subscription_count():
            self.to_log.append('reference must have a subscriber, got none: a motion is lost')
        self._reference.publish(exact_bytes(message))

    def _fail(self, motion: RequestedMotion, why: str) -> None:
        """Refuse a motion, or let it through as it came."""
        self._last_failure = why
        if self.settings.text('on_failure') == 'refuse':
            self._said['refused'] += 1
            self.refuse(self.input, InputError('not_shaped', why))
            return
        self._said['passed on'] += 1
        self.to_log.append(f'passed on as it came: {why}')
        now, now_ns = self.clock.now(), self.stamp_ns()
        stamp_ns = motion.message.stamp_ns
        begin_ns = max(stamp_ns, now_ns)
        message = unshaped_message(self.joints, motion.message, begin_ns, motion.named)
        given = motion.whole()
        still = None if motion.where is None else (motion.where, *np.zeros((2, len(motion.where))))
        trajectory = SplineTrajectory(
            given.times, given.positions, given.velocities, given.accelerations, still
        )
        begin = now + 1e-9 * (begin_ns - now_ns)
        self._publish_motion(message, CarriedMotion(trajectory, begin, motion.named))

    # ---- services, live parameters, end

    def _stop(self) -> str:
        """Drop planned motions; bring moving joints to rest along their path."""
        if not self.is_configured:
            return 'stopped: at rest'
        now = self.clock.now()
        with self._lock:
            self._brake(now)
            left, streams = self._left(now), self.stream.active
        if streams:
            return 'stopped: the stream brakes'
        return f'stopped: at rest in {left:.3g} s' if left else 'stopped: at rest'

    def _reset(self) -> str:
        """Forget motions and stamps; moving joints come to rest first."""
        self._stop()
        with self._lock:
            if not self.stream.active and self._left(self.clock.now()) == 0.0:
                self._forget()
        if self.is_configured:
            self.motion.reset()
        self.forget_stamps()
        return 'reset: waiting for a motion'

    def reload(self) -> str:
        """Read robot and table of modes again, and have the planner load them."""
        self.require_configured()
        before, self._table = self._table, mode_table(self.settings)
        try:
            answer = super().reload()
        except DenocError:
            self._table = before
            raise
        with self._lock:
            self._drop()
            self._load()
        return answer

    def settings_changed(self, settings: Settings, changes: dict[str, Value]) -> None:
        """Take a changed model for the next motion and for the stream."""
        if self.is_configured:
            self._check(settings)
        super().settings_changed(settings, changes)

    def rebuilds(self, name: str) -> bool:
        """Say whether a parameter changes the model or its modes."""
        return name == 'base' or super().rebuilds(name)

    def take_robot(self, robot: Robot, settings: Settings) -> None:
        """Plan and shape with a robot of the same joints."""
        self.require_joints(robot)
        check_planning(robot, self.joints, settings, self._table)
        self.robot, self._modes_robot = robot, ringing_robot(robot, settings.text('base'))

    def deactivate(self) -> None:
        """Stop the loop; planned and streamed motions are dropped."""
        super().deactivate()
        with self._lock:
            self._drop()

    def cleanup(self) -> None:
        """End the planner."""
        self.planning.planner.close()

    def save(self) -> None:
        """Leave no planner behind, whatever hangs."""
        self.planning.planner.close()

    # ---- diagnostics

    def work_statuses(self) -> list[Status]:
        """Motions so far, and times of planning."""
        status = Status('shaper')
        status.values = {
            'doing': self._doing(self.clock.now()),
            'method': self.settings.text('method'),
            'joints': ' '.join(self.joints),
            **self._said,
            'solve_last_s': self._solve_last,
            'solve_max_s': self._solve_max,
            'stream_delay_s': self.stream.delay,
            'planner_pid': self.planning.planner.pid or 'none',
            'planner_deaths': self.planning.planner.deaths,
        }
        failures = self._said['refused'] + self._said['passed on']
        if failures > self._failures_reported:
            status.worsen(WARN, f'not shaped: {self._last_failure}')
        self._failures_reported = failures
        if not self.planning.planner.running:
            status.worsen(ERROR, 'no planner: it died and will be restarted')
        if self.planning.load_error:
            status.worsen(ERROR, self.planning.load_error)
        return [status]

    def _doing(self, now: float) -> str:
        if self.stream.active:
            return 'streaming'
        if self.planning.busy:
            return 'planning'
        if self.planning.loading:
            return 'loading'
        return 'moving' if self._left(now) else 'waiting'


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the node (console script `denoc-shaper`)."""
    leave(run(ShaperNode, arguments))


if __name__ == '__main__':
    main()
