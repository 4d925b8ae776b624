"""The plant node: a simulated flexible robot in real time, the stand-in for hardware."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory

from denoc_ros.bags.joint_state import FIELDS, IMPEDANCE, JointStateMessage
from denoc_ros.dynamics.driven.driven_motion import DrivenMotion, driven_motion
from denoc_ros.dynamics.driven.measured_side import MeasuredStates
from denoc_ros.dynamics.elastic.deflection import TipDeflections
from denoc_ros.dynamics.equilibrium import Equilibrium
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.rotations import quaternion
from denoc_ros.errors import StateError
from denoc_ros.kernels.jit.compiled import entry
from denoc_ros.kernels.runtime.torque_limits import saturate
from denoc_ros.model.plant_description import PlantDescription
from denoc_ros.nodes.base.denoc_node import DenocNode
from denoc_ros.nodes.base.messages import LATCHED, STATE, listeners, raw_publish
from denoc_ros.nodes.base.process import leave, run
from denoc_ros.nodes.base.robot_node import RobotNode
from denoc_ros.nodes.base.simulated_time import TimeSource
from denoc_ros.nodes.sensor_outputs import InertialOutputs, SensorOutputs
from denoc_ros.parts import required
from denoc_ros.runtime.inputs.input_monitor import InputError
from denoc_ros.runtime.inputs.message_numbers import MessageFiller
from denoc_ros.runtime.inputs.message_readers import CommandReader
from denoc_ros.runtime.inputs.trajectory_messages import has_many_points, read_trajectory
from denoc_ros.runtime.loop.clocks import Clock as RobotClock
from denoc_ros.runtime.loop.clocks import StampOf
from denoc_ros.runtime.loop.status import ERROR, WARN, Status
from denoc_ros.runtime.parameters.parameter_table import Settings
from denoc_ros.runtime.parameters.plant_parameters import TABLE
from denoc_ros.runtime.reference.reference import ReferenceFollower
from denoc_ros.runtime.safety.motion_bounds import motion_bounds
from denoc_ros.settings import Value
from denoc_ros.simulation.simulated_robot import Drives, ModalRobot, SimulatedRobot
from denoc_ros.types import Array

CATCH_UP = 50  # steps that a tick after a pause of the machine takes in any case
CATCH_UP_TIME = 0.02  # s of a processor for more of them; what is left is time lost
COMMANDS = 256  # that wait for the step which they come before
REFERENCE_GAP = 0.2  # s
REMEDY = (
    'it was put back to its start and braked: hold the joints by feedback.kp and feedback.kd, or '
    'command them by a model that is not rigid, then call ~/reset'
)


class BaseOutput:
    """Publishes pose and twist of a floating base.

    Parameters
    ----------
    node : DenocNode
    robot : Robot
        With a floating base.
    """

    def __init__(self, node: DenocNode, robot: Robot) -> None:
        (body,) = (body for body in robot.tree.bodies if body.floating)
        self._message = Odometry()
        root = next(f for f, place in robot.tree.frames.items() if place.body < 0)
        self._message.header.frame_id = root
        self._message.child_frame_id = body.name
        self._publisher = node.create_publisher(Odometry, 'base_motion', STATE)

    def send(self, stamp_ns: int, robot: Robot, q: Array, qd: Array) -> None:
        """Publish the base's motion at a state; the twist is along the base's own axes."""
        pose, twist = robot.base_odometry(q, qd)
        message = self._message
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        place, turned = message.pose.pose.position, message.pose.pose.orientation
        place.x, place.y, place.z = pose[:3, 3].tolist()
        turned.x, turned.y, turned.z, turned.w = quaternion(pose[:3, :3]).tolist()
        linear, angular = message.twist.twist.linear, message.twist.twist.angular
        linear.x, linear.y, linear.z = twist[:3].tolist()
        angular.x, angular.y, angular.z = twist[3:].tolist()
        self._publisher.publish(message)


class PlantNode(RobotNode):
    """Simulates the robot under the commanded effort and publishes its sensors' values."""

    def __init__(self, **options: Any) -> None:
        self.source: TimeSource | None = None
        super().__init__('plant', TABLE, **options)
        self.add_trigger_service('~/reset', self._reset)
        self._commands: deque[tuple[float, Array]] = deque(maxlen=COMMANDS)
        self._command: Array | None = None
        self._description_out = self.create_publisher(String, 'robot_description', LATCHED)

    def make_clock(self) -> RobotClock:
        """Return the plant's own time, unless it moves by that of others."""
        settings, partners = self.settings, self.settings.texts('lockstep.partners')
        if settings.text('clock') == 'none':
            return super().make_clock()
        if settings.text('clock') == 'lockstep' and not partners:
            rule = "parameter 'lockstep.partners' must name nodes where 'clock' is lockstep"
            raise self.config_error(f'{rule}, got none')
        if settings.text('clock') == 'publish':
            partners = []
        self.source = TimeSource(
            self, partners, settings.number('lockstep.timeout'), self.on_standing
        )
        self._set_pace(settings)
        return self.source.clock

    def _set_pace(self, settings: Settings) -> None:
        """Take how fast its own time goes, and where it stands."""
        if self.source is not None:
            self.source.clock.factor = settings.number('real_time_factor')
            self.source.clock.pause_at = settings.number('pause_at')

    # ---- configure

    def described(self, robot: Robot, settings: Settings) -> Robot:
        """Return the plant of a robot: with modes, shapes and segments of its own.

        MuJoCo's has no shapes, and hinges for segments: it is a chain of the robot as it is.
        """
        modes, shape = settings.integer('modes'), settings.text('shape')
        if settings.text('engine') == 'mujoco':
            if modes or shape:
                rule = "parameters 'modes' and 'shape' must be 0 and '' where 'engine' is mujoco"
                raise self.config_error(f'{rule}, got {modes} and {shape!r}')
            return robot
        plant = PlantDescription(modes, shape, settings.integer('segments'))
        return robot.with_overrides(plant.overrides(robot.tree)) if plant else robot

    def prepare(self) -> None:
        """Build stepper, start, drives and all messages; run each once."""
        settings, robot = self.settings, self.robot
        self.joints = self.driven_joints(settings)
        self._drives = np.array([robot.joint_names.index(joint) for joint in self.joints])
        self._index = np.ascontiguousarray(robot.joint_indices[self._drives])
        self._tau = np.zeros(robot.n)
        self._prepare_drives(settings)
        simulated = self._build(robot, settings)
        self._prepare_messages(settings)
        self._use(simulated)
        self._lost_steps = 0
        self._diverged = self._last_divergence = ''
        self._tick_time = self.clock.now()
        self._brake = settings.flag('brake')
        self._place()
        self._simulated.tip_deflections(*self._deflection_arrays)
        if settings.text('urdf_path'):
            self._description_out.publish(String(data=robot.tree.source))

    def _build(self, robot: Robot, settings: Settings) -> SimulatedRobot:
        """Return a robot that moves by the engine, every path of the tick taken once."""
        motion = driven_motion(robot, self.joints, posture=self.posture(robot, settings))
        start = self._start(motion, settings)
        drives = Drives(motion.given, self._index, self._kp, self._kd)
        if settings.text('engine') == 'mujoco':
            return self._in_mujoco(robot, settings, start, drives)
        if scene := settings.text('scene'):
            rule = "parameter 'scene' must be empty where 'engine' is denoc, which touches nothing"
            raise self.config_error(f'{rule}, got {scene!r}')
        return ModalRobot(robot, self.period, start, drives)

    def _in_mujoco(
        self, robot: Robot, settings: Settings, start: Array, drives: Drives
    ) -> SimulatedRobot:
        engine = required('export.mujoco_robot', f'{self.get_fully_qualified_name()}: engine')
        if not settings.flag('geometric_stiffness'):
            rule = "parameter 'geometric_stiffness' must be true where 'engine' is mujoco"
            raise self.config_error(f'{rule}, got false')
        assert self.model is not None
        chosen = engine.MujocoSettings(
            settings.integer('segments') or engine.SEGMENTS,
            settings.text('scene'),
            settings.text('start_deflection') == 'static',
        )
        found: SimulatedRobot = engine.MujocoRobot(
            robot, robot.tree, self.period, start, drives, chosen
        )
        return found

    def _use(self, simulated: SimulatedRobot) -> None:
        self._simulated, self.robot = simulated, simulated.robot
        self._measured = measured = MeasuredStates(self.robot)
        state, modal = self._state_message, self._modal_message
        q, qd, at = simulated.q, simulated.qd, measured.index
        self._fill = MessageFiller(
            (state, modal, self._deflection_message),
            (
                (state.position, (q, at)),
                (state.velocity, (qd, at)),
                (state.effort, np.zeros(len(at))),
                ((state.effort, self._drives), self.effort),
                (modal.position, q),
                (modal.velocity, qd),
            ),
        ).fill

    @property
    def q(self) -> Array:
        """Coordinates (n,)."""
        return self._simulated.q

    @property
    def qd(self) -> Array:
        """Rates (n,)."""
        return self._simulated.qd

    @property
    def start(self) -> Array:
        """Coordinates (n,) where it starts."""
        return self._simulated.start

    def _start(self, motion: DrivenMotion, settings: Settings) -> Array:
        """Return the state (n,) to start from."""
        count = len(self.joints)
        q: Array = motion.posture.copy()
        given = settings.numbers('start') or q[motion.index].tolist()
        if len(given) != count:
            rule = f"parameter 'start' must have {count} elements"
            raise self.config_error(f'{rule}, got {len(given)}')
        motion.positions(q, np.array(given))
        free = np.union1d(motion.bound, motion.robot.flexible_indices)
        falls = len(motion.robot.base_indices) > 0  # freely: nothing has a weight
        if len(free) and not falls and settings.text('start_deflection') == 'static':
            Equilibrium(motion.robot, free).find(q)
        return q

    def _prepare_drives(self, settings: Settings) -> None:
        """Read gains and limits; make the readers of commands and reference."""
        count = len(self.joints)
        self._kp, self._kd = (self.per_joint(f'feedback.{key}', settings) for key in ('kp', 'kd'))
        self._has_feedback = bool(self._kp.any() or self._kd.any())
        limits = {name: joint.limits.effort for name, joint in self.robot.tree.joints.items()}
        enforce = settings.flag('enforce_effort_limits')
        self._upper = np.array([limits[j] if enforce else math.inf for j in self.joints])
        self._saturate = entry(saturate)
        self._by_impedance = bool(settings.text('impedance_command'))
        self._reader = CommandReader(self.joints, len(IMPEDANCE) if self._by_impedance else 1)
        self._command_timeout = settings.number('command_timeout')
        self.bounds = motion_bounds(self.robot, self.joints, settings)
        self.follower = ReferenceFollower(count, REFERENCE_GAP, self.bounds)
        self._wanted, self._wanted_rate, self._wanted_acceleration = np.zeros((3, count))
        self.effort = np.zeros(count)

    def _prepare_messages(self, settings: Settings) -> None:
        robot = self.robot
        tips = TipDeflections(robot).names
        motion = ('position', 'velocity')
        self._state_message = JointStateMessage(robot.joint_names, FIELDS)
        self._deflection_message = JointStateMessage(tips, motion)
        bent = self._deflection_message
        self._deflection_arrays = bent.position, bent.velocity
        self._modal_message = JointStateMessage(robot.coordinate_names, motion)
        self._state_out, self._deflection_out, self._modal_out = (
            self.create_publisher(JointState, topic, STATE)
            for topic in ('joint_states', '~/true_deflection', '~/true_modal_state')
        )
        self._send_state, self._send_deflection, self._send_modal = map(
            raw_publish, (self._state_out, self._deflection_out, self._modal_out)
        )
        self._deflection_listeners = listeners(self._deflection_out)
        self._modal_listeners = listeners(self._modal_out)
        floats = len(robot.base_indices) > 0
        self._base_out = BaseOutput(self, robot) if floats else None
        self._generator = np.random.default_rng(settings.integer('seed'))
        self._noise = np.zeros(len(robot.joint_names))
        deviations = ((what, settings.number(f'noise.{what}')) for what in FIELDS)
        self._noisy: list[tuple[Array, float]] = [
            (getattr(self._state_message, what), deviation)
            for what, deviation in deviations
            if deviation > 0.0
        ]
        noisy = settings.flag('noise.sensors')
        self.sensors = SensorOutputs(self, robot, noisy, self._generator)
        self.inertial_sensors = InertialOutputs(self, robot, noisy, self._generator)

    def connect(self) -> None:
        """Subscribe."""
        self.command_input = self.listen_in_loop(
            Float64MultiArray,
            self.settings.text('impedance_command') or self.settings.text('command'),
            self._on_command,
            depth=COMMANDS,
        )
        if self.source is not None:
            self.source.commands = self._inputs[-1]
        if self._has_feedback:
            self.reference_input = self.listen_in_loop(
                JointTrajectory, 'reference', self._on_reference, has_many_points
            )

    # ---- inputs

    def _on_command(self, raw: bytes, now: float) -> None:
        self._reader.read(raw)
        self.command_input.accept(None, now)
        self._commands.append((now, self._reader.values))

    def _on_reference(self, raw: bytes, now: float) -> None:
        message = read_trajectory(raw, self.joints, self.bounds, partial=True)
        self.offer(self.follower, message, self.reference_input, now, self.q[self._index])

    def _reset(self) -> str:
        """Go back to the start; the brake holds until the next command."""
        if self.is_configured:
            self.follower.forget_begun(self._tick_time)
            self.command_input.reset()
            self.between_ticks(self._reset_state)
        return 'back at the start'

    def settings_changed(self, settings: Settings, changes: dict[str, Value]) -> None:
        """Take the pace of its own time; build a changed model or start beside the loop."""
        self._set_pace(settings)
        super().settings_changed(settings, changes)

    def rebuilds(self, name: str) -> bool:
        """Say whether a parameter changes the model or where it starts."""
        return name == 'start' or super().rebuilds(name)

    def take_robot(self, robot: Robot, settings: Settings) -> None:
        """Build the simulated robot anew; the coordinates must stay."""
        self.require_coordinates(robot)
        self.between_ticks(self._swap, self._build(robot, settings))

    def _swap(self, simulated: SimulatedRobot) -> None:
        """Go on with a changed model where the one before is."""
        simulated.follow(self._simulated)
        self._use(simulated)

    # ---- loop

    def begin(self) -> None:
        """Start the clock of the drives."""
        self._tick_time = self.clock.now()
        self._stamp_of = StampOf(self.clock)

    def activate(self) -> None:
        """Tell the time, then start the loop."""
        if self.source is not None:
            self.source.clock.tell()
        super().activate()

    def _reset_state(self) -> None:
        self._diverged = ''
        self._place()

    def _place(self) -> None:
        self._began = math.nan
        self._simulated.place()
        self.effort[:] = 0.0
        self._commands.clear()
        self._command = None

    def tick(self, steps: int) -> None:
        """Advance to now under the effort of the drives, and publish the sensors' readings."""
        if math.isnan(self._began):
            self._began = self._tick_time
        end = self._tick_time + steps * self._simulated.step
        if self.loop is not None:
            end = self.loop.deadline
        self._lost_steps += steps - self._catch_up(steps, end)
        self._tick_time = end
        if error := self._impossible():
            since = self._tick_time - self._began
            self._note_divergence(f'diverged {since:.2f} s after its start: {error}')
        else:
            # the state is that of the deadline, however late the machine let the tick begin
            self._publish(self._stamp_of(self._tick_time))
        if self.source is not None:
            self.source.clock.tell()
        if not error:
            self._publish_truth()  # while those who hear the time compute

    def _impossible(self) -> str:
        """Return why the state is none that the robot can have, '' if it is one."""
        simulated = self._simulated
        try:
            self.bounds.require(self.q[self._index], self.qd[self._index])
            if simulated.bounds is not None:
                simulated.bounds.require(self.q, self.qd)
        except (InputError, StateError) as error:
            return str(error)
        return ''

    def _note_divergence(self, how: str) -> None:
        """Put the robot back to its start, as ~/reset does; nothing of its state is published."""
        self._last_divergence = f'the simulated state {how}'
        if not self._diverged:
            self._diverged = self._last_divergence
            self.to_log.append(f'{self._diverged}; {REMEDY}')
        self.command_input.reset()
        self.follower.forget_begun(self._tick_time)
        self._place()

    def _catch_up(self, steps: int, end: float) -> int:
        """Take steps up to a time [s]; return how many there was time for."""
        begin = time.thread_time() if steps > CATCH_UP else math.inf
        for taken in range(steps):
            if taken >= CATCH_UP and time.thread_time() - begin > CATCH_UP_TIME:
                return taken
            self._tick_time = end - (steps - 1 - taken) * self._simulated.step
            self._step()
        return steps

    @property
    def _braked(self) -> bool:
        """Whether the brake holds: no command has reached the drives yet."""
        return self._brake and (self._command is None or not self.command_input.received)

    def _take_due(self) -> None:
        """Hand the drives the newest command that had come by this step.

        After a pause of the machine every step has the command that drives which do not pause
        would have had.
        """
        commands = self._commands
        while commands and commands[0][0] <= self._tick_time:
            self._command = commands.popleft()[1]

    def _step(self) -> None:
        """Take one step."""
        self._take_due()
        if self._braked:
            self._simulated.hold()
        else:
            self._advance()

    def rescue(self) -> bool:
        """Start anew: the model cannot go on from where it failed."""
        since = self._tick_time - self._began
        self._note_divergence(f'failed {since:.2f} s after its start: {self._tick_guard.last}')
        return False

    def _advance(self) -> None:
        """Step under the drives' effort: commands and feedback, saturated."""
        effort, tau, command = self.effort, self._tau, self._command
        wanted = effort
        if command is None or (self.command_input.age(self.clock.now()) > self._command_timeout):
            effort[:] = 0.0
        elif self._by_impedance:
            place, rate, stiffness, damping, given = command.T
            effort[:] = given + stiffness * (place - self.q[self._index])
            effort += damping * (rate - self.qd[self._index])
        else:
            wanted = command
        if self._has_feedback and self.follower.sample(
            self._tick_time, self._wanted, self._wanted_rate, self._wanted_acceleration
        ):
            # the state-independent part, for the step that takes the rest implicitly
            tau[self._index] = wanted + self._kp * self._wanted + self._kd * self._wanted_rate
            np.add(wanted, self._kp * (self._wanted - self.q[self._index]), out=effort)
            effort += self._kd * (self._wanted_rate - self.qd[self._index])
            if (np.abs(effort) <= self._upper).all():
                self._simulated.controlled(tau)
                return
            wanted = effort
        self._saturate(wanted, self._upper, effort, self._index, tau)
        self._simulated.free(tau)

    def _publish(self, stamp_ns: int) -> None:
        simulated, state = self._simulated, self._state_message
        if self._base_out is not None:
            self._base_out.send(stamp_ns, self.robot, simulated.q, simulated.qd)
        self._fill(stamp_ns)
        if self._measured.any_behind:
            q, qd = simulated.q, simulated.qd
            self._measured.positions(q, state.position)
            self._measured.positions(qd, state.velocity)
            self._measured.efforts(q, qd, state.effort)
        for values, deviation in self._noisy:
            self._generator.standard_normal(out=self._noise)
            self._noise *= deviation
            values += self._noise
        self._send_state(state.bytes())
        if self.sensors:
            self.sensors.send(stamp_ns, simulated.sensor_values())
        if self.inertial_sensors:
            self.inertial_sensors.send(stamp_ns, simulated.inertial_values())

    def _publish_truth(self) -> None:
        """Publish the true state: deflections of the tips, and all coordinates."""
        if self._deflection_listeners():
            self._simulated.tip_deflections(*self._deflection_arrays)
            self._send_deflection(self._deflection_message.bytes())
        if self._modal_listeners():
            self._send_modal(self._modal_message.bytes())

    # ---- diagnostics

    def work_statuses(self) -> list[Status]:
        """State of the simulation and of its time."""
        braked = self._braked
        status = Status('plant', message='braked' if braked else 'moving')
        status.values = {
            'lost_steps': self._lost_steps,
            'braked': braked,
            'divergence': self._last_divergence,
        }
        if self._diverged:
            status.worsen(ERROR, f'{self._diverged}; {REMEDY}')
        if self._lost_steps:
            status.worsen(WARN, f'simulated time is {self._lost_steps} steps behind')
        if self.source is None:
            return [status]
        self.fatal = self.fatal or self.source.trouble
        return [status, self.source.status()]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the node (console script `denoc-plant`)."""
    leave(run(PlantNode, arguments))


if __name__ == '__main__':
    main()
