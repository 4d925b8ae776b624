"""The predictor node: measured joints in, estimated and predicted deflection out."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from denoc_ros.bags.joint_state import JointStateMessage
from denoc_ros.dynamics.elastic.deflection import TipDeflections
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError, SolverError, StateError
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.observer_history import ObserverHistory
from denoc_ros.estimation.stamp_clock import StampClock
from denoc_ros.kernels.algebra.rotation import write_quaternion
from denoc_ros.kernels.jit.compiled import ready
from denoc_ros.nodes.base.denoc_node import DenocNode
from denoc_ros.nodes.base.messages import STATE, PoseMessage, listeners, raw_publish
from denoc_ros.nodes.base.process import leave, run
from denoc_ros.nodes.base.robot_node import RobotNode
from denoc_ros.nodes.markers import CentreLines, LineMarkers
from denoc_ros.nodes.sensor_inputs import SEARCH_PERIOD, BaseInput, SensorInputs
from denoc_ros.runtime.adaptation import Adaptation, TrackedNumbers, adaptation
from denoc_ros.runtime.inputs.effort_check import EffortGuard, effort_guard
from denoc_ros.runtime.inputs.joint_input import JointInput
from denoc_ros.runtime.inputs.message_numbers import MessageFiller, Numbers
from denoc_ros.runtime.inputs.message_readers import JointStateReader
from denoc_ros.runtime.inputs.trajectory_messages import has_many_points, read_trajectory
from denoc_ros.runtime.live_observer import (
    accepted_values,
    build_observer,
    fusion_status,
    is_observers,
)
from denoc_ros.runtime.loop.clocks import StampOf
from denoc_ros.runtime.loop.status import WARN, Status
from denoc_ros.runtime.parameters.parameter_table import Settings
from denoc_ros.runtime.parameters.predictor_parameters import TABLE
from denoc_ros.runtime.reference.reference import reference_follower
from denoc_ros.runtime.safety.motion_bounds import limits_of, motion_bounds
from denoc_ros.runtime.safety.restarts import Restarts
from denoc_ros.types import Array

MOTION = ('position', 'velocity')
Measurement = tuple[float, Array, Array | None, Array | None]
MOST_STEPS = 20  # periods of a processor's time that measurements may take after a pause
QUEUE = 64  # measurements kept for a late tick
TRANSLATION = np.array([3, 7, 11], dtype=np.intp)  # where a pose has it, row by row


class PredictorOutputs:
    """Publishers and messages of tip deflections, tip pose, modal state and residuals.

    Parameters
    ----------
    node : DenocNode
        It publishes.
    coordinates : sequence of str
        Of the modal state.
    names : sequence of str
        Of the deflections.
    base_frame : str
        Of the pose's header.
    """

    def __init__(
        self, node: DenocNode, coordinates: Sequence[str], names: Sequence[str], base_frame: str
    ) -> None:
        self._deflection = JointStateMessage(names, MOTION)
        self._ahead = JointStateMessage(names, MOTION)
        self._modal = JointStateMessage(coordinates, MOTION)
        bent, modal, ahead = self._deflection, self._modal, self._ahead
        self._deflection_arrays = bent.position, bent.velocity
        self._modal_arrays = modal.position, modal.velocity
        self._ahead_arrays = ahead.position, ahead.velocity
        self._pose = PoseMessage(base_frame)
        self._tip = np.zeros((4, 4))
        self._turned = self._pose.values[3:]
        ready(write_quaternion)
        self._residual = JointStateMessage((), ('position',))
        self._heard: tuple[str, ...] = ()
        self._parameters = JointStateMessage((), ('position', 'effort'))
        publishers: dict[str, Any] = {
            topic: node.create_publisher(JointState, f'~/{topic}', STATE)
            for topic in (
                'tip_deflection',
                'tip_deflection_predicted',
                'modal_state',
                'sensor_residual',
                'model_parameters',
            )
        }
        publishers['tip_pose'] = node.create_publisher(PoseStamped, '~/tip_pose', STATE)
        self._sends = {topic: raw_publish(publisher) for topic, publisher in publishers.items()}
        self._listeners = {topic: listeners(publisher) for topic, publisher in publishers.items()}
        of_state = ('tip_deflection', 'modal_state', 'tip_pose')
        self._state_listeners = [self._listeners[topic] for topic in of_state]
        self._send_deflection, self._send_modal, self._send_pose = (
            self._sends[topic] for topic in of_state
        )

    def has_listener(self, topic: str) -> bool:
        """Say whether anybody would receive a message: without listeners it is not computed."""
        return bool(self._listeners[topic]())

    def attach(self, observer: Observer, write_pose: Callable[[Array, Array], object]) -> None:
        """Take what is published from an observer; `write_pose` writes the tip's pose (4, 4)."""
        self._observer, self._write_pose = observer, write_pose
        modal, pose = self._modal, self._pose
        self._has_springs = bool(observer.springs.hidden)
        copies: list[tuple[Numbers, Numbers]] = [
            (pose.values[:3], (self._tip.ravel(), TRANSLATION))
        ]
        if not self._has_springs:
            copies += [(modal.position, observer.q), (modal.velocity, observer.qd)]
        self._fill = MessageFiller((self._deflection, modal, pose), copies).fill

    def send_state(self, stamp_ns: int) -> None:
        """Publish tip deflections, modal state and the tip's pose, where somebody listens."""
        observer = self._observer
        bends, has_modes, is_placed = [listeners() for listeners in self._state_listeners]
        if bends:
            observer.deflections.evaluate(observer.q, observer.qd, out=self._deflection_arrays)
        if has_modes and self._has_springs:
            observer.modal_state(self._modal_arrays)
        if is_placed:
            self._write_pose(observer.q, self._tip)
            write_quaternion(self._tip, self._turned)
        self._fill(stamp_ns)
        if bends:
            self._send_deflection(self._deflection.bytes())
        if has_modes:
            self._send_modal(self._modal.bytes())
        if is_placed:
            self._send_pose(self._pose.bytes())

    def send_ahead(self, stamp_ns: int, q: Array, qd: Array, deflections: TipDeflections) -> None:
        """Publish predicted tip deflections; the stamp is the time they are for."""
        deflections.evaluate(q, qd, out=self._ahead_arrays)
        self._sends['tip_deflection_predicted'](self._ahead.bytes(stamp_ns))

    def send_residual(self, stamp_ns: int, sensors: SensorInputs, predicted: Array) -> None:
        """Publish measured minus predicted of the sensors heard so far."""
        gap = sensors.values - predicted
        heard = np.isfinite(gap)
        names = tuple(
            s.name for s, has in zip(sensors.sensors, heard.tolist(), strict=True) if has
        )
        if names != self._heard:
            self._heard = names
            self._residual = JointStateMessage(names, ('position',))
        self._residual.position[:] = gap[heard]
        self._sends['sensor_residual'](self._residual.bytes(stamp_ns))

    def send_parameters(self, stamp_ns: int, tracker: TrackedNumbers) -> None:
        """Publish numbers of the model that are tracked: value and standard deviation."""
        if tracker.paths != self._parameters.names:
            self._parameters = JointStateMessage(tracker.paths, ('position', 'effort'))
        self._parameters.position[:] = tracker.values
        self._parameters.effort[:] = tracker.deviations
        self._sends['model_parameters'](self._parameters.bytes(stamp_ns))


class PredictorNode(RobotNode):
    """Estimates the deflection of every flexible link, now and `horizon` ahead."""

    sees_joint_states = True

    def __init__(self, **options: Any) -> None:
        super().__init__('predictor', TABLE, **options)
        self.sensors = SensorInputs(self)
        self.base = BaseInput(self)
        self.add_trigger_service('~/reset', self._reset)
        self.add_trigger_service('~/tare', self._tare)
        self.add_trigger_service('~/reload_model', self.reload)

    @property
    def holds_base(self) -> bool:
        """Whether the base's motion is measured."""
        return self.base.used

    # ---- configure

    def prepare(self) -> None:
        """Build observer, inputs and messages; run everything of the tick once."""
        settings, robot = self.settings, self.robot
        self.joints = self.driven_joints(settings)
        frames = list(robot.tree.frames)
        self.tip = settings.text('tip_frame') or frames[-1]
        if self.tip not in frames:
            raise self.config_error(
                f"parameter 'tip_frame' must be one of {', '.join(frames)}, got {self.tip!r}"
            )
        self.base.build(robot.gravity)
        self.observer = self._build(robot, settings)
        self.efforts = self._guard(robot, settings)
        self.adaptation = self._adaptation(robot, settings)
        self.restarts = Restarts(self.observer.bounds)
        self._counted = self.observer.unsettled
        # A number is a time [s] from which on all is measured once more.
        self._queue: deque[Measurement | float] = deque(maxlen=QUEUE)
        self._history = ObserverHistory()
        self._stamps = StampClock()
        self._now = float('nan')
        self.bounds = motion_bounds(robot, self.joints, settings)
        self.follower = reference_follower(
            robot,
            self.joints,
            settings.number('reference_timeout'),
            self.bounds,
            self.posture(robot, settings),
        )
        self._wanted = np.zeros((3, len(self.joints)))
        self._effort_reader = JointStateReader(self.joints)
        self.by_torque = settings.text('source') == 'torque'
        self.by_command = settings.text('effort_source') == 'commanded'
        self._takes_effort = self.by_torque and not self.by_command
        self.motion = JointInput(
            robot,
            self.joints,
            self.bounds,
            settings.flag('allow_extra_joints'),
            rewinds=True,
            judges_effort=self._takes_effort,
            timeout=lambda: self.settings.number('joint_state_timeout'),
        )
        self.base_frame = next(f for f, place in robot.tree.frames.items() if place.body < 0)
        self.outputs = PredictorOutputs(
            self,
            self.observer.springs.whole.names,
            self.observer.deflections.names,
            self.base_frame,
        )
        self.outputs.attach(self.observer, robot.pose_of(self.tip))
        self.sensors.update(robot.tree)
        self._lines = CentreLines(robot.copy())
        self._line_markers = LineMarkers(self.base_frame)
        if settings.number('marker_rate'):
            self._markers = self.create_publisher(MarkerArray, '~/markers', STATE)
        self._rehearse()

    def _build(self, robot: Robot, settings: Settings) -> Observer:
        observer = build_observer(
            robot, settings, self.period, self.joints, self.posture(robot, settings)
        )
        if self.base.used:
            observer.base = self.base.at
        return observer

    def _guard(self, robot: Robot, settings: Settings) -> EffortGuard:
        posture = self.posture(robot, settings)
        return effort_guard(robot, settings, self.period, self.joints, posture)

    def _adaptation(self, robot: Robot, settings: Settings) -> Adaptation:
        name = self.get_fully_qualified_name()
        base = self.base.at if self.base.used else None
        return adaptation(robot, self.joints, settings, name, base)

    def _rehearse(self) -> None:
        """Run all functions of tick and timers once, so that nothing compiles in the loop."""
        zero = np.zeros(self.robot.n)
        self.observer.deflections.evaluate(zero, zero)
        self.robot.pose_of(self.tip)(zero, np.zeros((4, 4)))
        self.robot.beam_sensor_values(zero, zero, zero)
        self._line_markers.encode(self._lines.points(zero), 0)

    def connect(self) -> None:
        """Subscribe and set timers."""
        self.base.connect()
        self.joint_input = self.listen_in_loop(JointState, 'joint_states', self._on_joint_state)
        self.reference_input = self.listen_in_loop(
            JointTrajectory, 'reference', self._on_reference, has_many_points
        )
        if self.by_command:
            topic = self.settings.text('effort_topic')
            self.effort_input = self.listen_in_loop(JointState, topic, self._on_effort)
        self.create_timer(SEARCH_PERIOD, self._search, clock=self.steady_clock)
        rate = self.settings.number('marker_rate')
        if rate and not self.clock.is_simulated:  # else in the tick
            self.create_timer(1.0 / rate, self._draw, clock=self.steady_clock)

    # ---- inputs: what is stored here, the tick consumes

    def _on_joint_state(self, raw: bytes, now: float) -> None:
        samples = self.motion.take(raw, now, self.joint_input, self.refuse, self._takes_effort)
        for each in samples:
            arrival = each.arrival
            wall = 1e-9 * self.stamp_ns_at(arrival)
            taken = self._stamps.taken_at(1e-9 * each.stamp_ns, arrival, wall)
            effort = each.effort
            if self.by_command:
                fresh = self.effort_input.age(now) <= self.settings.number('joint_state_timeout')
                effort = self._effort_reader.effort if fresh else None
            if each.restarts:
                self._queue.clear()
                self._queue.append(taken)
            self._queue.append((taken, each.position, each.velocity, effort))

    def _on_effort(self, raw: bytes, now: float) -> None:
        reader = self._effort_reader
        reader.read(raw, partial(self.effort_input.accept, now=now), with_effort=True)
        if self.by_torque:
            self.observer.take_effort(reader.effort)

    def _on_reference(self, raw: bytes, now: float) -> None:
        message = read_trajectory(raw, self.joints, self.bounds, partial=True)
        there = self.motion.position if self.joint_input.received else None
        self.offer(self.follower, message, self.reference_input, now, there)

    def _reference(self, t: float) -> tuple[Array, Array, Array]:
        """Reference of the joints at steady time `t`."""
        q, qd, qdd = self._wanted
        self.follower.sample(t, q, qd, qdd)
        return q, qd, qdd

    # ---- loop

    def activate(self) -> None:
        """Listen to the sensors that are there, start the loop."""
        self.sensors.search()
        super().activate()

    def begin(self) -> None:
        """Start anew from the next measurement."""
        self._queue.clear()
        self._history.clear()
        self.efforts.reset()
        self.motion.reset()
        self.sensors.queue.clear()
        self._stamps.reset()
        self.base.begin()
        self.observer.reset()
        self.restarts.clear()
        self.adaptation.reset(values=False)
        self._now = self.clock.now()
        self._stamp_of = StampOf(self.clock)
        rate = self.settings.number('marker_rate')
        self._draw_period, self._draw_due = (1.0 / rate, -math.inf) if rate else (0.0, math.inf)

    def tick(self, steps: int) -> None:
        """Take the measurements in, go on to now and publish."""
        if self.loop is not None:
            self._now = self.loop.deadline
        else:
            self._now += steps * self.observer.settings.step
        observer = self.observer
        if self.base.used and (trouble := self.base.trouble(self._now)):
            # Without the base's motion there is no estimate.
            self._queue.clear()
            self.sensors.queue.clear()
            self._start_again(trouble)
            return
        try:
            self._measure(observer, steps)
            while self.sensors.queue:
                value = self.sensors.queue.popleft()
                observer.sense(*value)
                self.adaptation.sense(*value)
            self.adaptation.apply(observer)
            observer.tick(self._now)
            if observer.unsettled != self._counted:
                self._counted = observer.unsettled
                self._note_restart('no equilibrium where joint_states begin')
            if observer.is_current:
                self._publish(observer)
            if self.clock.is_simulated and self._now >= self._draw_due:
                self._draw_due = self._now + self._draw_period
                self._draw()
        except (StateError, SolverError) as error:
            # the estimate has left all bounds: better none than that
            self.restarts.note_failure(str(error))
            self._start_again(str(error))

    def _start_again(self, cause: str) -> None:
        """Start the estimate again at the next measurement, from equilibrium."""
        if self.observer.started:
            self._note_restart(cause)
        self.observer.reset()

    def _note_restart(self, cause: str, keeps_state: bool = False) -> None:
        observer = self.observer
        state = observer.q.copy(), observer.qd.copy()
        self.restarts.note_restart(cause, self._now, accepted_values(observer), state, keeps_state)

    def _measure(self, observer: Observer, steps: int) -> None:
        """Take measurements in, for the time that has passed at most; the rest waits."""
        queue, tracked, end = self._queue, self.adaptation, math.inf
        if len(queue) > 1 and not self.clock.is_simulated:
            end = time.thread_time() + min(steps, MOST_STEPS) * self.period
        while queue:
            measurement = queue.popleft()
            if isinstance(measurement, float):
                self._rewind(observer, measurement)
                tracked.reset(values=False)
                # A measurement that waits for the next tick would be too late for it.
                end = math.inf
                continue
            taken, q, qd, effort = measurement
            restarts = observer.restarts
            self.efforts.measure(observer, taken, q, qd, effort)
            tracked.measure(taken, q, qd, effort)
            self._history.add(observer)
            if observer.restarts != restarts:
                self._note_restart('a gap in joint_states', keeps_state=True)
            if queue and time.thread_time() > end:
                return

    def _rewind(self, observer: Observer, time: float) -> None:
        """Bring the observer back to before a time [s], else reset it."""
        if observer.started and not self._history.rewind(observer, time):
            self._start_again('wrong joint_states were taken in')
        self.efforts.follow(observer)

    def rescue(self) -> bool:
        """Start anew from the next measurement: better no estimate than a wrong one."""
        self._start_again('a tick failed')
        return False

    def _publish(self, observer: Observer) -> None:
        stamp_ns = self._stamp_of(observer.time)
        outputs = self.outputs
        outputs.send_state(stamp_ns)
        if self.adaptation.fresh and self.adaptation.tracker is not None:
            outputs.send_parameters(stamp_ns, self.adaptation.tracker)
        horizon = observer.settings.horizon
        if horizon > 0.0 and outputs.has_listener('tip_deflection_predicted'):
            follow = self._follows(observer.time)
            try:
                q_ahead, qd_ahead = observer.predict(self._reference if follow else None)
            except StateError as error:  # of a reference that the robot cannot follow
                self.restarts.note_failure(f'prediction: {error}')
            else:
                ahead_ns = stamp_ns + round(1e9 * horizon)
                outputs.send_ahead(ahead_ns, q_ahead, qd_ahead, observer.deflections)
        if self.sensors.fresh:
            self.sensors.fresh = False
            if outputs.has_listener('sensor_residual'):
                explained = self._explained(self.robot, observer)
                outputs.send_residual(stamp_ns, self.sensors, explained)

    def _explained(self, robot: Robot, observer: Observer) -> Array:
        """Predicted readings of the sensors with a topic, without loads outside the model."""
        values = observer.sensor_values(robot)
        if observer.fusion is not None:
            values -= observer.fusion.unexplained()
        return np.asarray(values[self.sensors.places])

    def _follows(self, now: float) -> bool:
        """Say whether there is a reference that the joints are on."""
        if not self.follower.given or self.follower.finished(now):
            return False
        return self.follower.age(now) <= self.settings.number('reference_timeout')

    def restart(self) -> None:
        """Forget the reference too: it belongs to a time that is no more."""
        self.follower.clear()
        super().restart()

    def _swap(
        self, robot: Robot, observer: Observer, tracked: Adaptation, efforts: EffortGuard
    ) -> None:
        """Go on with a changed model where the one before is."""
        self._history.clear()
        observer.adopt(self.observer)
        efforts.follow(observer)
        self.efforts = efforts
        tracked.adopt(self.adaptation)
        self.robot, self.observer, self.adaptation = robot, observer, tracked
        self.restarts.bounds = observer.bounds
        self.outputs.attach(observer, robot.pose_of(self.tip))
        self.sensors.update(robot.tree)

    def _start_anew(self) -> None:
        """Forget the estimate and the numbers found."""
        self._history.clear()
        self.efforts.reset()
        self.observer.reset()
        self.restarts.clear()
        self.adaptation.reset(values=True)

    # ---- beside the loop

    def _search(self) -> None:
        if self.is_configured:
            self.sensors.search()

    def _draw(self) -> None:
        """Publish the deflected centre lines while anybody listens."""
        active = self.state == 'active' and self.observer.started
        if active and self._markers.get_subscription_count():
            lines = self._lines.points(self.observer.q.copy())
            self._markers.publish(self._line_markers.encode(lines, self.stamp_ns()))

    def _reset(self) -> str:
        """Forget state, reference and stamps."""
        if self.is_configured:
            self.follower.clear()
            self._stamps.reset()
            self.motion.reset()
            self.between_ticks(self._start_anew)
        self.forget_stamps()
        return 'reset: starts from the next joint state'

    def _tare(self) -> str:
        """Set the difference between sensors and prediction as offset."""
        if self.state != 'active' or not self.observer.started:
            raise ConfigError(self.get_name(), ['the node must have joint states to tare by'])
        names = self.sensors.tare(self._explained(self.robot.copy(), self.observer))
        if not names:
            raise ConfigError(
                self.get_name(), ['a sensor must have sent a value before it can be tared']
            )
        # what was fused so far had the offsets in it
        self.sensors.queue.clear()
        if self.observer.fusion is not None:
            self.between_ticks(self._start_anew)
        return f'tared: {", ".join(names)}'

    def rebuilds(self, name: str) -> bool:
        """Say whether a parameter changes the model, the observer or the tracked numbers."""
        return super().rebuilds(name) or is_observers(name)

    def take_robot(self, robot: Robot, settings: Settings) -> None:
        """Build observer and tracker anew; the coordinates must stay."""
        self.require_coordinates(robot)
        observer, tracked = self._build(robot, settings), self._adaptation(robot, settings)
        self._lines = CentreLines(robot.copy())
        self.bounds.update(limits_of(robot, self.joints))
        efforts = self._guard(robot, settings)
        self.between_ticks(self._swap, robot, observer, tracked, efforts)

    # ---- diagnostics

    def work_statuses(self) -> list[Status]:
        """State of observer, fusion and tracked numbers."""
        observer = self.observer
        status = Status('observer', message='estimating')
        status.values = {
            'late': observer.late,
            'repeated': observer.repeated,
            'restarts': observer.restarts,
            'model_failures': self.restarts.failures,
            'sensors_heard': int(np.count_nonzero(np.isfinite(self.sensors.values))),
        }
        if trouble := self.base.trouble(self.clock.now()):
            status.worsen(WARN, f'{trouble}: nothing is published')
        elif not observer.started:
            status.worsen(WARN, 'no joint_states yet')
        elif observer.stale:
            status.worsen(WARN, 'stale joint_states: nothing is published')
        values, amplitudes = accepted_values(observer), len(observer.robot.flexible_indices)
        self.restarts.worsen(status, self._now, values, amplitudes, self.robot)
        fused = None if observer.fusion is None else fusion_status(observer.fusion, self._now)
        beside = (fused, self.adaptation.status())
        joints = self.motion.status()
        if reason := self.efforts.reason:
            joints.worsen(WARN, f'{reason}; the estimate uses positions and velocities only')
        return [status, joints, *(each for each in beside if each is not None)]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the node (console script `denoc-predictor`)."""
    leave(run(PredictorNode, arguments))


if __name__ == '__main__':
    main()
