"""The feedforward node: desired trajectory in, torque out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory

from denoc_ros.dynamics.driven.torque_feedforward import TorqueFeedforward
from denoc_ros.dynamics.robot import Robot
from denoc_ros.estimation.stamp_clock import StampClock
from denoc_ros.model.numbers import FAMILIES
from denoc_ros.nodes.base.messages import EVERY_MESSAGE
from denoc_ros.nodes.base.process import leave, run
from denoc_ros.nodes.base.robot_node import RobotNode
from denoc_ros.nodes.sensor_inputs import BaseInput
from denoc_ros.nodes.torque_output import BaseWrench, ImpedanceOutput, TorqueFeedback, TorqueOutput
from denoc_ros.runtime.inputs.input_monitor import InputError, InputMonitor
from denoc_ros.runtime.inputs.joint_gate import JointSample, joint_gate
from denoc_ros.runtime.inputs.joint_input import JointInput
from denoc_ros.runtime.inputs.trajectory_messages import has_many_points, read_trajectory
from denoc_ros.runtime.loop.clocks import StampOf
from denoc_ros.runtime.loop.realtime_loop import PLACE, PhaseLock
from denoc_ros.runtime.loop.status import Status
from denoc_ros.runtime.parameters.feedforward_parameters import TABLE
from denoc_ros.runtime.parameters.parameter_table import Settings
from denoc_ros.runtime.reference.reference import FiniteDifferencer, reference_follower
from denoc_ros.runtime.safety.motion_bounds import limits_of, motion_bounds
from denoc_ros.runtime.safety.stale_inputs import STALE_JOINTS, FollowingConditions
from denoc_ros.runtime.safety.torque import (
    CarryingTorque,
    LiveTorque,
    SafeCommand,
    TorqueLimiter,
    TorqueStatus,
    torque_feedforward,
    torque_limits,
)
from denoc_ros.settings import Value
from denoc_ros.types import Array

FINAL_COMMANDS = 5  # sent at the end, in case a reader misses some
FINAL_SPACING = 0.005  # s
LOOK_PERIOD = 0.02  # s between looks at whether the measured loops close
CARRYING_ACTIONS = ('hold', 'ramp_to_gravity')  # begin with the weight where nothing has left
DESIGN_PATIENCE = 30.0  # s that configure waits for gains: half of what a callback may take
TWISTS = ('odometry', 'odometry_accel', 'imu')  # what measures how a base turns
WATCH_PERIOD = 0.02  # s between looks at what the feedback needs gains for
END_PATIENCE = 1.0  # s beyond the ramp to reach it, however small max_delta_tau is


class FeedforwardNode(RobotNode):
    """Follows `reference` with the torque that the model says it takes."""

    sees_joint_states = True

    def __init__(self, **options: Any) -> None:
        super().__init__('feedforward', TABLE, **options)
        self.by_message = self.settings.text('trigger') == 'message'
        self.from_joints = self.settings.text('reference_source') == 'joint_states'
        self.conditions = FollowingConditions(self.settings, self.from_joints)
        self.create_service(SetBool, '~/enable', self._on_enable)
        self.add_trigger_service('~/stop', self._stop)
        self.add_trigger_service('~/reset', self._reset)
        self.add_trigger_service('~/reload_model', self.reload)
        self.feedback = TorqueFeedback(self)
        self._watches = False
        self.base = BaseInput(self)

    # ---- configure

    def prepare(self) -> None:
        """Build the torque, its guards, and all messages; run each once."""
        settings = self.settings
        source = settings.text('base_motion')
        if self.drifts and source not in TWISTS:  # what tells how the base turns
            rule = f"must be one of {', '.join(TWISTS)} where 'base' is drifting, got {source!r}"
            raise self.config_error(f"parameter 'base_motion' {rule}")
        self.joints = self.driven_joints(settings)
        n = len(self.joints)
        try:
            limits = torque_limits(self.robot, self.joints, settings)
        except ValueError as error:
            raise self.config_error(str(error)) from error
        self.limiter = TorqueLimiter(limits, settings.number('max_delta_tau'))
        for joint, limit in zip(self.joints, limits, strict=True):
            if limit == 0.0:
                self.get_logger().warning(f'{joint} has effort limit 0: its torque is always zero')
        self._build_feedback(self.robot, settings, limits, DESIGN_PATIENCE)
        self.carrying = CarryingTorque(n)
        self.safe = SafeCommand(settings.text('stale_action'), settings.number('ramp_time'), n)
        self.q, self.qd, self.qdd, self._posture = np.zeros((4, n))
        gap = settings.number('reference_timeout')
        self.bounds = motion_bounds(self.robot, self.joints, settings)
        posture = self.posture(self.robot, settings)
        self.follower = reference_follower(self.robot, self.joints, gap, self.bounds, posture)
        cutoff = settings.number('acceleration_cutoff')
        self.stream = FiniteDifferencer(n, gap, cutoff, self.bounds)
        self.stream_gate = joint_gate(self.robot, self.joints)
        self.output = TorqueOutput(
            self,
            self.joints,
            (self.q, self.qd, self.qdd),
            self.limiter.last,
            self.by_message,
            settings.flag('publish_joint_trajectory'),
            self._impedance(settings),
        )
        self.wrench = None
        if self.floating is not None and self.flies:  # thrusters hold it
            self.wrench = BaseWrench(self, self.floating.robot(settings.family(*FAMILIES)))
        self.motion = JointInput(
            self.robot,
            self.joints,
            self.bounds,
            settings.flag('allow_extra_joints'),
            timeout=lambda: self.settings.number('joint_state_timeout'),
        )
        self.torque = LiveTorque(self._build(self.robot, settings), self.in_hurry)
        self._has_loops = bool(self.robot.tree.loops)
        synchronous = settings.flag('sync_to_joint_states') and not self.by_message
        simulated = self.clock.is_simulated
        self.phase = PhaseLock(self.period) if synchronous and not simulated else None
        # simulated ticks are at the joint states' stamps, not half a period after them
        self._ahead = PLACE * self.period if synchronous and simulated else 0.0
        self._joint_clock = StampClock()
        self._cause = 'waiting'
        self._message_time: int | None = None
        self._said = TorqueStatus()
        self._takeovers = 0
        self.conditions.update(settings)
        self.base.build(self.robot.gravity)

    def _impedance(self, settings: Settings) -> ImpedanceOutput | None:
        """Return the output of the gains of drives, None where no stiffness is given."""
        if not settings.numbers('impedance.stiffness'):
            if any(settings.numbers('impedance.damping')):
                rule = "parameter 'impedance.stiffness' must be given beside 'impedance.damping'"
                raise self.config_error(f'{rule}, got none')
            return None
        stiffness, damping = (
            self.per_joint(f'impedance.{what}', settings) for what in ('stiffness', 'damping')
        )
        ramp_time = settings.number('ramp_time')
        return ImpedanceOutput(self, self.joints, stiffness, damping, ramp_time)

    def connect(self) -> None:
        """Subscribe."""
        self.base.connect()
        self.reference_input: InputMonitor | None = None
        joints, reference = self._on_joint_state, self._on_reference
        if self.by_message:  # the messages are the clock
            self.joint_input = self.listen(JointState, 'joint_states', joints, EVERY_MESSAGE)
            if not self.from_joints:
                self.reference_input = self.listen(
                    JointTrajectory, 'reference', reference, EVERY_MESSAGE
                )
            return
        self.joint_input = self.listen_in_loop(JointState, 'joint_states', joints)
        if not self.from_joints:
            self.reference_input = self.listen_in_loop(
                JointTrajectory, 'reference', reference, has_many_points
            )

    # ---- what depends on the model

    @property
    def flies(self) -> bool:
        """Whether thrusters hold a base that would float."""
        return self.settings.text('base') == 'free_flying'

    @property
    def drifts(self) -> bool:
        """Whether a base that floats reacts from a measured twist."""
        return self.settings.text('base') == 'drifting'

    @property
    def holds_base(self) -> bool:
        """Whether the base's motion is measured, or none."""
        return self.flies or (self.settings.text('base_motion') != 'off' and not self.drifts)

    @property
    def in_hurry(self) -> bool:
        """Whether a loop in real time waits for the model."""
        return not (self.by_message or self.clock.is_simulated)

    def _build(self, robot: Robot, settings: Settings) -> TorqueFeedforward:
        posture = self.posture(robot, settings)
        return torque_feedforward(robot, self.joints, settings, posture, self.in_hurry)

    def _build_feedback(
        self, robot: Robot, settings: Settings, limits: Array, patience: float = 0.0
    ) -> None:
        posture = self.posture(robot, settings)
        self.feedback.build(robot, self.joints, settings, limits, posture, patience)
        if self.feedback.law.needs_watch and not self._watches:
            self._watches = True
            # ticks of simulated time watch by themselves: they wait for the gains
            if not self.clock.is_simulated:
                self.create_timer(WATCH_PERIOD, self._watch, clock=self.steady_clock)

    def follow_clock(self) -> None:
        """Look at the time; who answers messages does not hold it."""
        super().follow_clock()
        if self.by_message and self.progress is not None and self.state == 'active':
            self.progress.tell(math.inf)

    def _watch(self) -> None:
        """Show the feedback the motion to come."""
        if self.state != 'active':
            return
        if self.follower.given:
            self.feedback.law.watch(self.follower, self.q)
        elif self.joint_input.received:
            self.feedback.law.watch(self.follower, self.motion.position)

    # ---- inputs: what is stored here, the tick consumes

    def _on_joint_state(self, raw: bytes, now: float) -> None:
        for each in self.motion.take(raw, now, self.joint_input, self.refuse):
            self._take_joints(each)

    def _take_joints(self, sample: JointSample) -> None:
        """Take measured joints: for the feedback, the loop's phase, and as reference."""
        now, stamp_ns = sample.arrival, sample.stamp_ns
        self.feedback.take_joints(sample)
        if self.phase is not None:
            wall = 1e-9 * self.stamp_ns_at(now)
            self.phase.take(self._joint_clock.taken_at(1e-9 * stamp_ns, now, wall))
        if not self.from_joints:
            return
        point = self.stream.complete(1e-9 * stamp_ns, sample.position, sample.velocity, None)
        if self.by_message:
            self._answer(stamp_ns, *point)
        else:
            self.follower.offer_point(now, *point)

    def _on_reference(self, raw: bytes, now: float) -> None:
        assert self.reference_input is not None
        message = read_trajectory(raw, self.joints, self.bounds, not self.by_message)
        if self.by_message and not message.is_streamed:
            raise InputError(
                'not_streamed',
                "reference must be single points for now while 'trigger' is message, "
                f'got {len(message.times)} points',
            )
        if not self.by_message:
            there = self.motion.position if self.joint_input.received else None
            self.offer(self.follower, message, self.reference_input, now, there)
            return
        self.reference_input.accept(message.stamp_ns, now)
        sample = JointSample(
            1e-9 * message.stamp_ns, *message.first, stamp_ns=message.stamp_ns, arrival=now
        )
        passed = [sample]
        if sample.velocity is None:  # Its rates are differences of positions.
            near = self.motion.position if self.joint_input.received else None
            refuse = partial(self.refuse, self.reference_input)
            passed = self.stream_gate.offer(sample, refuse, near)
            self.reference_input.revise(len(passed))
        for each in passed:
            motion = each.position, each.velocity, each.acceleration
            self._answer(each.stamp_ns, *self.stream.complete(each.time, *motion))

    def _answer(self, stamp_ns: int, q: Any, qd: Any, qdd: Any) -> None:
        """Publish the torque of one message's state, with its stamp."""
        if self.state != 'active':
            return
        if trouble := self.base.trouble(self.clock.now()):
            self._cause = trouble
            return
        if self.base.used:
            self._move_base(self.clock.now())
        before, self._message_time = self._message_time, stamp_ns
        elapsed = 0.0 if before is None else 1e-9 * (stamp_ns - before)
        torque = self.torque.update(q, qd, qdd, elapsed, self.clock.now())
        if torque is None:
            return
        self.q[:], self.qd[:] = q, qd
        if self._fresh:
            torque = torque.copy()
            self._start_torque(self.clock.now())
        self._cause = 'following messages'
        self.limiter.apply(torque)
        self.output.send_effort(stamp_ns)

    # ---- loop

    def cleanup(self) -> None:
        """End the process that designs gains."""
        self.feedback.law.close()

    def begin(self) -> None:
        """Start from rest: nothing is known and nothing has left."""
        self._fresh = True
        self.limiter.reset()
        self.carrying.forget()
        self.begin_time()

    def begin_time(self) -> None:
        """Forget all moments; the last torque still bounds the change of the next."""
        self._tick_time = self.clock.now()
        self._stamp_of = StampOf(self.clock)
        self._last_update = -math.inf
        self._look_due = -math.inf
        self._joint_clock.reset()
        self.motion.reset()
        self.stream_gate.reset()
        if self.phase is not None:
            self.phase.forget()
        self.carrying.hurry()
        self.safe.end()
        self.base.begin()
        self.torque.reset()
        self.feedback.law.begin()

    def activate(self) -> None:
        """Start the loop, unless messages are the clock."""
        if self.by_message:
            self._message_time = None
            self.begin()
        else:
            self.feedback.search()
            super().activate()

    def tick(self, steps: int) -> None:
        """Publish the torque for now: along the reference, else the safe command."""
        if self.loop is not None:
            self._tick_time = self.loop.deadline + self._ahead
            if self.phase is not None:
                self.loop.shift = self.phase.shift(self._tick_time)
        now = self.clock.now()
        if self.base.used:
            self._move_base(self._tick_time + self.conditions.lead)
        # the model goes on along the reference even while torque may not: so a short gap in the
        # joint states does not cost it the amplitudes
        reference_age = self.follower.age(now)
        torque = self._along_reference(reference_age)
        if torque is not None and (self._fresh or self._has_loops):
            torque = torque.copy()
            self._look(now)
        cause = self._trouble(now, reference_age) or ('model failed' if torque is None else '')
        if cause or torque is None:
            if torque is not None and cause == STALE_JOINTS:
                self.feedback.wait(torque, *self._plan())
            else:
                self.feedback.rest()
            self._be_safe(now)
        else:
            self.safe.end()
            if self._fresh:
                self._start_torque(now)
            if self.feedback.law.wanted:
                torque = self.feedback.add(torque, *self._plan())
            left = self.limiter.apply(torque)
            self.feedback.law.applied(left)
            self._publish(is_following=True)
            if self.wrench is not None:
                self.wrench.send(self._stamp_of(self._tick_time), self.torque.source)
        if cause and self._cause == 'following':
            self._takeovers += 1
        self._cause = cause or 'following'
        if self.clock.is_simulated:
            self._watch()

    def on_standing(self) -> None:
        """Look after the gains as well."""
        self._watch()
        super().on_standing()

    def restart(self) -> None:
        """Forget the reference too: it belongs to a time that is no more."""
        self.follower.clear()
        self._message_time = None
        super().restart()

    @property
    def holds_time(self) -> bool:
        """Whether gains of the feedback are in work."""
        return self.feedback.law.busy

    @property
    def sent(self) -> int:
        """How many commands have left."""
        return self.output.sent

    def _plan(self) -> tuple[TorqueFeedforward, Array, float, float]:
        """Return the tick's plan beside its torque, for the feedback."""
        return self.torque.source, self.q, self._tick_time, self.conditions.lead

    def _move_base(self, time: float) -> None:
        """Let the model's base move as measured, carried on to a time."""
        motion, source = self.base.at(time), self.torque.source
        if self.drifts and len(source.robot.base_indices):
            source.move_floating_base(None if motion is None else motion.twist)
        else:
            source.robot.move_base(motion)

    def _trouble(self, now: float, reference_age: float) -> str:
        """Return why the reference may not be followed, '' if it may."""
        age, has_posture = self.joint_input.age(now), not self.carrying.failure
        if self.base.used and (trouble := self.base.trouble(now)):
            return trouble
        return self.conditions.trouble(age, has_posture, self.follower.given, reference_age)

    def _along_reference(self, age: float) -> Array | None:
        """Return the torque (n,) along the reference, None if there is none or the model fails."""
        clock = self._tick_time
        if age > self.conditions.reference_timeout or not self.follower.sample(
            clock + self.conditions.lead, self.q, self.qd, self.qdd
        ):
            self.torque.source.reset()
            return None
        elapsed, self._last_update = clock - self._last_update, clock
        return self.torque.update(self.q, self.qd, self.qdd, elapsed, clock)

    def _publish(self, is_following: bool = False) -> None:
        """Publish the torque that the limiter let through, with the motion it is for."""
        self.output.send(self._stamp_of(self._tick_time), is_following)

    def _carry(self, now: float) -> bool:
        """Find the torque that holds the robot; say whether it is known."""
        measured = self.joint_input.received
        if measured:
            self._posture[:] = self.motion.position
        elif self.follower.given or self.by_message:
            self._posture[:] = self.q
        else:  # after a reset: what was known still carries it
            return self.carrying.found
        failure = self.carrying.update(self.torque.source, self._posture, now)
        if failure and measured:
            self.refuse(self.joint_input, InputError('no_posture', failure))
        return self.carrying.found

    def _look(self, now: float) -> None:
        """Look now and then at whether measured joints are where loops close."""
        if now >= self._look_due and self.joint_input.received:
            self._look_due = now + LOOK_PERIOD
            self._carry(now)

    def _start_torque(self, now: float) -> None:
        """Start the first torque from the holding torque: from zero the robot would drop."""
        self._fresh = False
        if self._carry(now):
            self.limiter.reset(self.carrying.torque)

    def _be_safe(self, now: float) -> None:
        """Publish the safe command, if a posture is known."""
        if not self._carry(now):
            return
        if self._fresh and self.safe.action in CARRYING_ACTIONS:
            self._start_torque(now)
        self.safe.begin(now, self.limiter.last)
        torque = self.safe.torque(now, self.carrying.torque)
        if torque is not None:
            self._fresh = False
            self.q[:] = self.carrying.posture
            self.qd[:] = self.qdd[:] = 0.0
            left = self.limiter.apply(torque)
            self.feedback.law.applied(left)
            self._publish()

    def rescue(self) -> bool:
        """Repeat the last command; say whether there was one."""
        if not self._fresh:
            self.qd[:] = self.qdd[:] = 0.0
            self.limiter.apply(self.limiter.last)
            self._publish()
        return not self._fresh

    def come_to_rest(self) -> None:
        """Go to the safe command, then say it again."""
        self.feedback.law.stop()
        if self.by_message:
            return
        self.feedback.rest()
        self._cause = 'ended'
        end = self.clock.now() + self.settings.number('ramp_time') + END_PATIENCE
        repeats = 0
        while repeats < FINAL_COMMANDS and self.clock.now() < end:
            before = self.limiter.last.copy()
            now = self._tick_time = self.clock.now()
            self.guarded(self._be_safe, now)
            if self._fresh:  # no posture was ever known: nothing has left, nothing will
                return
            changed = np.abs(self.limiter.last - before).max() > 1e-9
            repeats = 0 if changed or not self.safe.settled(now) else repeats + 1
            self._tell_progress()
            if not self.clock.sleep(max(self.period, FINAL_SPACING) if repeats else self.period):
                repeats = FINAL_COMMANDS  # time stands: nothing more will change

    # ---- services and live parameters

    def _on_enable(self, request: Any, response: Any) -> Any:
        self.conditions.enable(bool(request.data))
        response.success = True
        response.message = 'enabled' if self.conditions.enabled else 'disabled: safe command'
        return response

    def _stop(self) -> str:
        """Stop until enabled again; the reference is dropped."""
        self.conditions.stopped = True
        if self.is_configured:
            self.follower.clear()
        return 'stopped: safe command until ~/enable'

    def _reset(self) -> str:
        """Forget reference, stamps and amplitudes."""
        if self.is_configured:
            self.follower.clear()
            self.between_ticks(self.torque.reset)
            self.motion.reset()
            self.between_ticks(self.stream_gate.reset)
            self._message_time = None
        self.forget_stamps()
        return 'reset: waiting for a reference'

    def rebuilds(self, name: str) -> bool:
        """Say whether a parameter changes the model or the terms of its torque."""
        return name == 'model' or name.startswith('terms.') or super().rebuilds(name)

    def take_robot(self, robot: Robot, settings: Settings) -> None:
        """Build torque and feedback anew; the joints must stay."""
        self.require_joints(robot)
        limits = torque_limits(robot, self.joints, settings)
        source = self._build(robot, settings)
        self._build_feedback(robot, settings, limits)
        self.bounds.update(limits_of(robot, self.joints))
        self.robot = robot
        self.between_ticks(self._swap, source, limits)

    def _swap(self, source: TorqueFeedforward, limits: Array) -> None:
        """Go on with a changed model where the one before is."""
        self.torque.replace(source)
        self.limiter.take_limits(limits)

    def settings_changed(self, settings: Settings, changes: dict[str, Value]) -> None:
        """Build a changed model, or feedback alone; take the conditions of following."""
        if not self.is_configured:
            return
        if any(map(self.rebuilds, changes)):
            self.take_robot(self.changed_robot(settings), settings)
        elif any(name.startswith('feedback.') for name in changes):
            limits = torque_limits(self.robot, self.joints, settings)
            self._build_feedback(self.robot, settings, limits)
        self.conditions.update(settings)

    def save(self) -> None:
        """Leave no process behind, whatever hangs."""
        self.feedback.law.close()

    # ---- diagnostics

    def work_statuses(self) -> list[Status]:
        """State of torque and feedback."""
        more = {
            'enabled': self.conditions.enabled,
            'model': self.torque.source.model,
            'joints': ' '.join(self.joints),
            'takeovers': self._takeovers,
        }
        if self.phase is not None:
            more['synchronous'] = self.phase.is_steady
        restarts, now = self.torque.restarts, self.clock.now()
        status = self._said.status(self._cause, self.limiter, restarts, now, more)
        return [status, self.motion.status(), *self.feedback.law.statuses()]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the node (console script `denoc-feedforward`)."""
    leave(run(FeedforwardNode, arguments))


if __name__ == '__main__':
    main()
