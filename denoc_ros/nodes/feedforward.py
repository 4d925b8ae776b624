"""The feedforward node: desired trajectory in, torque out."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory

from denoc_ros.dynamics.feedforward import Terms, TorqueFeedforward
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError, SolverError, StateError
from denoc_ros.nodes.base import EVERY_MESSAGE
from denoc_ros.nodes.conversions import (
    InputError,
    JointStateReader,
)
from denoc_ros.nodes.diagnostics import Status
from denoc_ros.nodes.feedforward_parameters import TABLE
from denoc_ros.nodes.model_node import driven_joints, is_override
from denoc_ros.nodes.motion_bounds import motion_bounds
from denoc_ros.nodes.parameters import Settings, Value
from denoc_ros.nodes.process import leave, run
from denoc_ros.nodes.reference import DifferencedStream, ReferenceFollower
from denoc_ros.nodes.robot_node import RobotNode
from denoc_ros.nodes.safety import InputMonitor, SafeCommand, torque_limiter
from denoc_ros.nodes.stamps import StampOf
from denoc_ros.nodes.strain_feedback import StrainFeedback
from denoc_ros.nodes.torque_output import TorqueOutput
from denoc_ros.nodes.torque_status import TorqueStatus
from denoc_ros.nodes.trajectory_messages import has_many_points, read_trajectory

FINAL_COMMANDS = 5  # sent at the end, in case a reader misses some
FINAL_SPACING = 0.005  # s
END_PATIENCE = 1.0  # s beyond the ramp to reach it, however small max_delta_tau is


class FeedforwardNode(RobotNode):
    """Follows `reference` with the torque that the model says it takes."""

    def __init__(self, **options: Any) -> None:
        super().__init__('feedforward', TABLE, **options)
        self.enabled = self.settings.flag('enabled')
        self.stopped = False
        self.by_message = self.settings.text('trigger') == 'message'
        self.from_joints = self.settings.text('reference_source') == 'joint_states'
        self.create_service(SetBool, '~/enable', self._on_enable)
        self.offer('~/stop', self._stop)
        self.offer('~/reset', self._reset)
        self.offer('~/reload_model', self._reload)
        self.feedback = StrainFeedback(self)
        self._connected = False

    # ---- configure

    def prepare(self) -> None:
        """Build the torque, what guards it, and all messages; run each once."""
        settings, name = self.settings, self.get_fully_qualified_name()
        self.joints = driven_joints(self.robot, settings.texts('joints'), name)
        n = len(self.joints)
        try:
            self.limiter = torque_limiter(self.robot, self.joints, settings)
        except ValueError as error:
            raise ConfigError(name, [str(error)]) from error
        for joint, limit in zip(self.joints, self.limiter.limits, strict=True):
            if limit == 0.0:
                self.get_logger().warning(f'{joint} has effort limit 0: no torque will leave it')
        self.feedback.build(self.robot, self.joints, settings, self.limiter.limits)
        self.safe = SafeCommand(settings.text('stale_action'), settings.number('ramp_time'), n)
        self.q, self.qd, self.qdd, self._posture = np.zeros((4, n))
        gap = settings.number('reference_timeout')
        self.bounds = motion_bounds(self.robot, self.joints, settings)
        self.follower = ReferenceFollower(n, gap, self.bounds)
        cutoff = settings.number('acceleration_cutoff')
        self.stream = DifferencedStream(n, gap, cutoff, self.bounds)
        self.output = TorqueOutput(
            self, self.joints, self.by_message, settings.flag('publish_joint_trajectory')
        )
        self._reader = JointStateReader(
            self.joints,
            settings.flag('allow_extra_joints'),
            self.robot.joint_names,
            self.bounds,
        )
        self.torque_source = self._build(self.robot, settings)
        self._pending: TorqueFeedforward | None = None
        self._cause = 'waiting'
        self._message_time: int | None = None
        self._said = TorqueStatus()
        self._model_failures = self._takeovers = 0
        self._reset_wanted = False
        self._cache(settings)
        self._connect()

    def _build(self, robot: Robot, settings: Settings) -> TorqueFeedforward:
        """Return the torque of a model, each of its verbs called once."""
        terms = Terms(**{name: settings.flag(f'terms.{name}') for name in Terms.names()})
        source = TorqueFeedforward(
            robot,
            self.joints,
            settings.text('model'),
            terms,
            self.period,
            posture=self.posture(robot, settings),
        )
        zero, there = np.zeros(len(self.joints)), source.q[source.motion.index]
        source.update(there, zero, zero, 0.0)
        source.update(there, zero, zero, self.period)
        source.gravity(there)
        source.reset()
        return source

    def _cache(self, settings: Settings) -> None:
        """Keep what the loop reads each tick at hand."""
        self._joint_timeout = settings.number('joint_state_timeout')
        self._reference_timeout = settings.number('reference_timeout')
        self._needs_joints = settings.flag('require_joint_states')
        self._lead = settings.number('lead_time')

    def _connect(self) -> None:
        """Subscribe, once: a node that is configured again keeps its subscriptions."""
        if self._connected:
            return
        self._connected = True
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

    # ---- inputs: what is stored here, the tick consumes

    def _on_joint_state(self, raw: bytes, now: float) -> None:
        reader = self._reader
        reader.read(raw, lambda stamp_ns: self.joint_input.accept(stamp_ns, now))
        if not self.from_joints:
            return
        velocity = reader.velocity if reader.has_velocity else None
        point = self.stream.complete(1e-9 * reader.stamp_ns, reader.position, velocity, None)
        if self.by_message:
            self._answer(reader.stamp_ns, *point)
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
        take = self.reference_input.accept
        if not self.by_message:
            measured = self._reader.position if self.joint_input.received else None
            self.follower.offer(
                message,
                now,
                self.stamp_ns_at(now),
                measured,
                # stamp 0 starts now, whatever was sent before
                lambda: take(message.stamp_ns or None, now),
            )
            return
        take(message.stamp_ns, now)
        velocities, accelerations = message.velocities, message.accelerations
        point = self.stream.complete(
            1e-9 * message.stamp_ns,
            message.positions[0],
            None if velocities is None else velocities[0],
            None if accelerations is None else accelerations[0],
        )
        self._answer(message.stamp_ns, *point)

    def _answer(self, stamp_ns: int, q: Any, qd: Any, qdd: Any) -> None:
        """Publish the torque of one message's state, with its stamp."""
        if self.state != 'active':
            return
        self._swap()
        before, self._message_time = self._message_time, stamp_ns
        elapsed = 0.0 if before is None else 1e-9 * (stamp_ns - before)
        torque = self._torque(q, qd, qdd, elapsed)
        if torque is None:
            return
        self.q[:], self.qd[:] = q, qd
        self._cause = 'following messages'
        self.output.send_effort(stamp_ns, self.q, self.qd, self.limiter.apply(torque))

    # ---- loop

    def cleanup(self) -> None:
        """Take the publishers down; the next configure makes them for its joints."""
        self.output.close(self)

    def begin(self) -> None:
        """Start from rest: nothing is known and nothing has left."""
        self._tick_time = time.perf_counter()
        self._stamp_of = StampOf(self.stamp_ns)
        self._last_update = -math.inf
        self._fresh = True
        self.limiter.reset()
        self.safe.end()
        self.torque_source.reset()

    def activate(self) -> None:
        """Start the loop, unless messages are the clock."""
        if self.by_message:
            self._message_time = None
            self.begin()
        else:
            super().activate()

    def tick(self, steps: int) -> None:
        """Publish the torque for now: along the reference, else the safe command."""
        if self.loop is not None:
            self._tick_time = self.loop.deadline
        now = time.perf_counter()
        self._swap()
        # the model goes on along the reference even while torque may not: so a short gap in the
        # joint states does not cost it the amplitudes
        torque = self._along_reference(now)
        cause = self._trouble(now) or ('model failed' if torque is None else '')
        if cause or torque is None:
            self._be_safe(now)
        else:
            self.safe.end()
            self._fresh = False
            self._publish(self.limiter.apply(self.feedback.add(torque, now)))
        if cause and self._cause == 'following':
            self._takeovers += 1
        self._cause = cause or 'following'

    def _swap(self) -> None:
        """Take over a changed model between two ticks."""
        if self._reset_wanted:
            self._reset_wanted = False
            self.torque_source.reset()
        pending = self._pending
        if pending is not None:
            self._pending = None
            pending.adopt(self.torque_source)
            self.torque_source = pending

    def _trouble(self, now: float) -> str:
        """Return why the reference may not be followed, '' if it may."""
        if self.stopped:
            return 'stopped'
        if not self.enabled:
            return 'disabled'
        if self._needs_joints or self.from_joints:
            age = self.joint_input.age(now)
            if age > self._joint_timeout:
                return 'stale joint_states' if age < math.inf else 'no joint_states yet'
        if not self.follower.given:
            return 'no reference yet'
        if self.follower.age(now) > self._reference_timeout:
            return 'stale reference'
        return ''

    def _along_reference(self, now: float) -> Any:
        """Return the torque (n,) along the reference, None if there is none or the model fails."""
        clock = self._tick_time
        if self.follower.age(now) > self._reference_timeout or not self.follower.sample(
            clock + self._lead, self.q, self.qd, self.qdd
        ):
            self.torque_source.reset()
            return None
        elapsed, self._last_update = clock - self._last_update, clock
        return self._torque(self.q, self.qd, self.qdd, elapsed)

    def _torque(self, q: Any, qd: Any, qdd: Any, elapsed: float) -> Any:
        """Return the torque (n,) of a motion, None if the model fails (numbers out of reach)."""
        try:
            return self.torque_source.update(q, qd, qdd, elapsed)
        except (StateError, SolverError):
            self._model_failures += 1
            self.torque_source.reset()
            return None

    def _publish(self, torque: Any) -> None:
        self.output.send(self._stamp_of(self._tick_time), self.q, self.qd, self.qdd, torque)

    def _be_safe(self, now: float) -> None:
        """Publish the safe command, if a posture is known."""
        if self.joint_input.received:
            self._posture[:] = self._reader.position
        elif self.follower.given:
            self._posture[:] = self.q
        else:
            return
        gravity = self.torque_source.gravity(self._posture)
        if self._fresh:
            self._fresh = False
            # a robot that stands there is carried at once: a ramp from zero would let it drop
            if self.safe.action == 'ramp_to_gravity':
                self.limiter.reset(gravity)
        self.safe.begin(now, self.limiter.last)
        torque = self.safe.torque(now, gravity)
        if torque is not None:
            self.q[:] = self._posture
            self.qd[:] = self.qdd[:] = 0.0
            self._publish(self.limiter.apply(torque))

    def deactivate(self) -> None:
        """Stop the loop, go to the safe command, then say it again."""
        super().deactivate()
        if self.by_message:
            return
        self._cause = 'ended'
        end = time.perf_counter() + self.settings.number('ramp_time') + END_PATIENCE
        repeats = 0
        while repeats < FINAL_COMMANDS and time.perf_counter() < end:
            before = self.limiter.last.copy()
            now = self._tick_time = time.perf_counter()
            self._be_safe(now)
            if not self.safe.active:  # no posture was ever known: nothing has left, nothing will
                return
            changed = np.abs(self.limiter.last - before).max() > 1e-9
            repeats = 0 if changed or not self.safe.settled(now) else repeats + 1
            time.sleep(max(self.period, FINAL_SPACING) if repeats else self.period)

    # ---- services and live parameters

    def _on_enable(self, request: Any, response: Any) -> Any:
        self.enabled = bool(request.data)
        self.stopped = self.stopped and not self.enabled
        response.success = True
        response.message = 'enabled' if self.enabled else 'disabled: safe command'
        return response

    def _stop(self) -> str:
        """Stop until enabled again; the reference is dropped."""
        self.stopped = True
        if self.state in ('active', 'inactive'):
            self.follower.clear()
        return 'stopped: safe command until ~/enable'

    def _reset(self) -> str:
        """Forget reference, stamps and amplitudes."""
        if self.state in ('active', 'inactive'):
            self.follower.clear()
            self._reset_wanted = True
            self._message_time = None
        for monitor in self.monitors:
            monitor.reset()
        return 'reset: waiting for a reference'

    def _reload(self) -> str:
        """Read the robot again; its joints must be the same."""
        self.require_configured('to reload its model')
        model = self.read_model(self.settings)
        robot = self.changed_robot(self.settings, model)
        if tuple(robot.joint_names) != tuple(self.robot.joint_names):
            rule = f'joints must stay {list(self.robot.joint_names)} on reload'
            got = f'(clean up and configure instead), got {list(robot.joint_names)}'
            raise ConfigError(self.get_name(), [f'{rule} {got}'])
        self.feedback.build(robot, self.joints, self.settings, self.limiter.limits)
        self._pending = self._build(robot, self.settings)
        self.robot = robot
        self.adopt_model(model, self.settings)
        return f'reloaded {robot.tree.name}'

    def settings_changed(self, settings: Settings, changes: dict[str, Value]) -> None:
        """Build a changed model beside the loop; the next tick takes it."""
        if self.state not in ('active', 'inactive'):
            return
        if any(is_override(n) or n.split('.')[0] in ('model', 'terms') for n in changes):
            robot = self.changed_robot(settings)
            self.feedback.build(robot, self.joints, settings, self.limiter.limits)
            self._pending, self.robot = self._build(robot, settings), robot
        self._cache(settings)

    # ---- diagnostics

    def statuses(self) -> list[Status]:
        """Return loop and torque."""
        found = super().statuses()
        if self.state not in ('active', 'inactive'):
            return found
        more = {
            'enabled': self.enabled,
            'model': self.torque_source.model,
            'joints': ' '.join(self.joints),
            'takeovers': self._takeovers,
        }
        status = self._said.status(self._cause, self.limiter, self._model_failures, more)
        return [*found, status]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the node (console script `denoc-feedforward`)."""
    leave(run(FeedforwardNode, arguments))


if __name__ == '__main__':
    main()
