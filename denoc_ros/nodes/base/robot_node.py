"""Nodes with a robot's model, and with a real-time loop."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from denoc_ros.dynamics.driven.measured_side import measured_robot
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ConfigError, ModelError
from denoc_ros.model.numbers import FAMILIES
from denoc_ros.model.overrides import with_held_base
from denoc_ros.nodes.base.denoc_node import DenocNode
from denoc_ros.nodes.base.guarded_node import Guard
from denoc_ros.nodes.base.inputs import Handler, Input, never_heavy
from denoc_ros.nodes.base.messages import LATCHED
from denoc_ros.nodes.base.simulated_time import TickProgress
from denoc_ros.runtime.inputs.input_monitor import InputError, InputMonitor
from denoc_ros.runtime.inputs.message_readers import LONGEST
from denoc_ros.runtime.inputs.trajectory_messages import TrajectoryMessage
from denoc_ros.runtime.live_model import LiveModel, check_description
from denoc_ros.runtime.loop.realtime import lock_memory
from denoc_ros.runtime.loop.realtime_loop import RealtimeLoop, SharedCores
from denoc_ros.runtime.loop.status import ERROR, Status, loop_status, realtime_status
from denoc_ros.runtime.parameters.parameter_table import ParameterTable, Settings
from denoc_ros.runtime.reference.reference import ReferenceFollower
from denoc_ros.settings import Value
from denoc_ros.types import Array

# what a flood at 10 kHz brings between two ticks at 1 kHz, and some more
WITHIN_A_TICK = 16  # messages
STANDSTILL = 0.5  # s without a tick that are an error
SHORT = 1e-4  # s between looks for a message that is due
PATIENCE = 1.0  # s of failing ticks that nothing can be done about
WITHIN_A_MESSAGE = 1000  # messages between two ticks that one message of /clock may pass over
OVERDUE = 0.5  # s of wall time that a tick waits for a message that is due
CORES_PERIOD = 0.5  # s between looks at how full the cores are
ASIDE_PERIOD = 0.02  # s between looks at what the loop does not take


class ModelNode(DenocNode):
    """Loads the robot on configure, from a file or from the topic robot_description.

    A node overrides `prepare`, which builds all that it makes of the robot, and `connect`.

    Attributes
    ----------
    robot : Robot
        The node's own, with the overrides of the parameters.
    model : LiveModel or None
        What the robot is made from; None until the node is configured.
    floating : LiveModel or None
        The robot with its floating base, where the node's own has it held.
    description : str
        What robot_description last said.
    sees_joint_states : bool
        Whether the robot is the one that joint states describe: without the springs behind which
        joints are measured.
    """

    robot: Robot
    sees_joint_states = False

    def __init__(self, name: str, table: ParameterTable, **options: Any) -> None:
        super().__init__(name, table, **options)
        self.model: LiveModel | None = None
        self.floating: LiveModel | None = None
        self.description = ''
        self._connected = False
        self.add_post_set_parameters_callback(self._after_parameters)
        if not self.settings.text('urdf_path'):
            self.ready = False
            self._description_input = InputMonitor('robot_description')
            self.monitors.append(self._description_input)
            self.create_subscription(
                String, 'robot_description', self._on_description, LATCHED, raw=False
            )

    def _on_description(self, message: String) -> None:
        monitor = self._description_input
        try:
            check_description(monitor.topic, message.data)
        except InputError as error:
            self.refuse(monitor, error)
            return
        monitor.accept(None, self.clock.now())
        self.description = message.data
        self.ready = True

    def prepare(self) -> None:
        """Build from `self.robot` all that the node uses."""

    def connect(self) -> None:
        """Subscribe and set timers, after the first `prepare` only: they stay."""

    def read_model(self, settings: Settings) -> LiveModel:
        """Return the robot of the file or topic, to be changed by overrides.

        Raises
        ------
        ModelError
            The description does not give a model; every finding.
        ConfigError
            There is none, or gravity has not three elements.
        """
        source = settings.text('urdf_path') or self.description
        gravity = settings.numbers('gravity')
        if not source:
            raise self.config_error(
                "parameter 'urdf_path' or the topic robot_description must give the robot"
            )
        if len(gravity) != 3:
            raise self.config_error(f"parameter 'gravity' must have 3 elements, got {gravity}")
        options: dict[str, Any] = {
            'gravity': tuple(gravity),
            'geometric_stiffness': settings.flag('geometric_stiffness'),
        }
        robot = self.described(load_robot(source, **options), settings)
        if len(robot.base_indices) and self.holds_base:
            self.floating = LiveModel(self._seen(robot))
            robot = load_robot(with_held_base(robot.tree.source), **options)
        return LiveModel(self._seen(robot))

    def described(self, robot: Robot, settings: Settings) -> Robot:
        """Return the robot as the node describes its beams: here as it was loaded."""
        del settings
        return robot

    def _seen(self, robot: Robot) -> Robot:
        return measured_robot(robot) if self.sees_joint_states else robot

    @property
    def holds_base(self) -> bool:
        """Whether a floating base counts as one whose motion is known."""
        return False

    def adopt_model(self, model: LiveModel, settings: Settings) -> None:
        """Adopt a model for the overrides to change, and list them."""
        self.model = model
        overrides = model.plain(settings.family(*FAMILIES))
        self.settings = settings.without(*FAMILIES).replace(overrides)
        self.show(model.values(overrides))

    def changed_robot(self, settings: Settings, model: LiveModel | None = None) -> Robot:
        """Return a robot of its own with the overrides of `settings`, by default of `self.model`.

        Raises
        ------
        ConfigError, ModelError
            A path that names nothing, or a value that makes no model.
        """
        model = self.model if model is None else model
        assert model is not None
        return model.robot(settings.family(*FAMILIES))

    def posture(self, robot: Robot, settings: Settings) -> Array:
        """Return the coordinates (n,) near which the robot's loops are closed.

        Raises
        ------
        ConfigError
            The parameter has another number of elements than the robot has joints.
        """
        given = settings.numbers('posture')
        count = len(robot.joint_names)
        if given and len(given) != count:
            raise self.config_error(
                f"parameter 'posture' must have an element for each of the {count} joints "
                f'{list(robot.joint_names)}, got {len(given)}'
            )
        q = np.zeros(robot.n)
        q[robot.joint_indices] = given or 0.0
        return q

    def driven_joints(self, settings: Settings) -> list[str]:
        """Return the joints that the node works on: those given, else all that are not mimics.

        Raises
        ------
        ConfigError
            A given one is not the robot's, repeated or a mimic joint; none is given for a robot
            with loops.
        """
        given, tree = settings.texts('joints'), self.robot.tree
        if tree.loops and not given:
            rule = "parameter 'joints' must name the driven joints of a robot with loops"
            names = list(self.robot.joint_names)
            raise self.config_error(f'{rule}, some of {names}, got none')
        free = list(tree.non_mimic_joints)
        if not set(given) <= set(free) or len(set(given)) != len(given):
            raise self.config_error(
                f"parameter 'joints' must name different joints of {free}, got {given}"
            )
        return given or free

    def require_configured(self) -> None:
        """Raise ConfigError where there is no robot yet whose model could be read again."""
        if not self.is_configured:
            rule = 'the node must be configured to reload its model'
            raise ConfigError(self.get_name(), [rule])

    def require_coordinates(self, robot: Robot) -> None:
        """Refuse a changed robot that has other coordinates.

        Raises
        ------
        ConfigError
            With the coordinates it has.
        """
        if tuple(robot.coordinate_names) != tuple(self.robot.coordinate_names):
            got = list(robot.coordinate_names)
            raise self.config_error(f'the robot must keep its coordinates, got {got}')

    def require_joints(self, robot: Robot) -> None:
        """Refuse a changed robot that has other joints.

        Raises
        ------
        ConfigError
            With the joints it has.
        """
        if tuple(robot.joint_names) != tuple(self.robot.joint_names):
            rule = f'joints must stay {list(self.robot.joint_names)} on reload'
            got = f'(clean up and configure instead), got {list(robot.joint_names)}'
            raise ConfigError(self.get_name(), [f'{rule} {got}'])

    def plain(self, changes: dict[str, Value]) -> dict[str, Value]:
        """Return changes with overrides under their own paths."""
        return changes if self.model is None else self.model.plain(changes)

    def _after_parameters(self, parameters: Sequence[Any]) -> None:
        """Report the effects of a changed override: its other name, and dependent parameters."""
        changed = any(is_override(parameter.name) for parameter in parameters)
        if changed and self.model is not None and not self._showing:
            self.show(self.model.values(self.settings.family(*FAMILIES)))

    def configure(self) -> None:
        """Load the robot, then build the node's objects."""
        try:
            model = self.read_model(self.settings)
        except ModelError:  # a topic may say another one
            self.ready = bool(self.settings.text('urdf_path'))
            raise
        self.robot = self.changed_robot(self.settings, model)
        self.adopt_model(model, self.settings)
        for warning in self.robot.tree.warnings:
            self.get_logger().warning(warning)
        self.prepare()
        if not self._connected:
            self._connected = True
            self.connect()


def is_override(name: str) -> bool:
    """Say whether a parameter changes the model."""
    return name.split('.')[0] in FAMILIES and '.' in name


class RobotNode(ModelNode):
    """Loads the robot on configure and runs `tick` in a thread of its own while active.

    The loop takes its inputs itself, at the beginning of a tick: a callback in another thread
    would hold the interpreter just when the loop is due.

    A node overrides `prepare` (build and run once everything that `tick` uses), `connect`, `tick`,
    `take_robot` and, where it has more to say, `work_statuses`.

    Attributes
    ----------
    joints : list of str
        That it works on.
    loop : RealtimeLoop or None
        The loop while active.
    """

    joints: list[str]

    def __init__(self, name: str, table: ParameterTable, **options: Any) -> None:
        super().__init__(name, table, **options)
        self.loop: RealtimeLoop | None = None
        self._inputs: list[Input] = []
        self._changes: dict[Callable[..., None], tuple[Any, ...]] = {}
        self._tick_guard = Guard(self.to_log.append)
        self._failing_since = math.inf
        self._overdue = 0
        self.progress = TickProgress(self) if self.clock.is_simulated else None
        self._cores = SharedCores()
        if not self.clock.is_simulated and self.settings.integer('thread_priority') > 0:
            self.create_timer(CORES_PERIOD, self._watch_cores, clock=self.steady_clock)

    # ---- inputs

    def listen_in_loop(
        self,
        message_type: type,
        topic: str,
        handle: Handler,
        is_heavy: Callable[[bytes], bool] = never_heavy,
        depth: int = WITHIN_A_TICK,
    ) -> InputMonitor:
        """Subscribe as `listen` does; the loop takes the messages, but for heavy ones.

        `depth` of them wait for a tick, the newest.
        """
        if not self._inputs:
            self.create_timer(ASIDE_PERIOD, self._take_aside, clock=self.steady_clock)
        if self.clock.is_simulated:
            depth = max(depth, WITHIN_A_MESSAGE)
        qos = QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)
        added = self.subscribe(message_type, topic, handle, qos, is_heavy)
        added.longest = LONGEST
        self.take_aside(added.subscription)
        self._inputs.append(added)
        return added.monitor

    def _take_inputs(self) -> None:
        for each in self._inputs:
            each.take()

    def _await_inputs(self) -> None:
        """Wait for due messages of simulated time: the output depends on no lateness."""
        end = time.perf_counter() + OVERDUE
        while missing := [each for each in self._inputs if each.missing]:
            if time.perf_counter() > end:
                for each in missing:
                    each.expect_nothing()
                    self._overdue += 1
                return
            time.sleep(SHORT)
            for each in missing:
                each.take()

    def _take_aside(self) -> None:
        """Process the messages that the loop deferred, or all of them while there is no loop."""
        if not self._loop_runs:
            self._take_inputs()
        for each in self._inputs:
            each.take_heavy()

    def _turn(self, steps: int) -> None:
        try:
            self._take_inputs()
            if self.progress is not None:
                self._await_inputs()
            if self._changes:
                self._make_changes()
            self.tick(steps)
            self._failing_since = math.inf
        except Exception as error:
            self._on_failure(error, self.clock.now())
        if self.progress is not None:
            self._tell_progress()

    def offer(
        self,
        follower: ReferenceFollower,
        message: TrajectoryMessage,
        monitor: InputMonitor,
        now: float,
        there: Array | None,
    ) -> None:
        """Have a follower take a reference that came at a time, or refuse it by InputError.

        `there` (n,) is where the joints are, None where nobody knows.
        """
        stamp_ns = message.stamp_ns or None  # 0 starts now, whatever was sent before
        accept = partial(monitor.accept, stamp_ns, now)
        refuse = partial(self.refuse, monitor)
        count = follower.offer(message, now, self.stamp_ns_at(now), there, accept, refuse)
        monitor.revise(count)

    def per_joint(self, name: str, settings: Settings) -> Array:
        """Return a parameter of each driven joint (n,), given as one value or one per joint.

        Raises
        ------
        ConfigError
            It has another number of elements.
        """
        values, count = settings.numbers(name), len(self.joints)
        if len(values) not in (1, count):
            rule = f"parameter '{name}' must have 1 or {count} elements"
            raise self.config_error(f'{rule}, got {len(values)}')
        found: Array = np.broadcast_to(np.array(values), count).copy()
        return found

    # ---- changes while the loop runs

    def between_ticks(self, change: Callable[..., None], *arguments: Any) -> None:
        """Have a change made between two ticks; at once where no loop runs.

        Of several calls with the same change that wait, the last one's arguments count.
        """
        self._changes[change] = arguments
        if not self._loop_runs:
            self._make_changes()

    def _make_changes(self) -> None:
        for change in list(self._changes):
            change(*self._changes.pop(change))

    def rebuilds(self, name: str) -> bool:
        """Say whether a live parameter takes a changed robot."""
        return is_override(name)

    def take_robot(self, robot: Robot, settings: Settings) -> None:
        """Go on with a changed robot from the next tick on, or refuse it by DenocError."""

    def settings_changed(self, settings: Settings, changes: dict[str, Value]) -> None:
        """Take a changed robot, built beside the loop."""
        if self.is_configured and any(map(self.rebuilds, changes)):
            self.take_robot(self.changed_robot(settings), settings)

    def reload(self) -> str:
        """Read the robot again, as `~/reload_model` asks for."""
        self.require_configured()
        model = self.read_model(self.settings)
        robot = self.changed_robot(self.settings, model)
        self.take_robot(robot, self.settings)
        self.adopt_model(model, self.settings)
        return f'reloaded {robot.tree.name}'

    # ---- simulated time

    @property
    def _loop_runs(self) -> bool:
        return self.loop is not None and self.loop.running

    @property
    def holds_time(self) -> bool:
        """Whether work in another process belongs to the tick at hand."""
        return False

    def follow_clock(self) -> None:
        """Look at the time, where no loop does."""
        if not self._loop_runs:
            super().follow_clock()

    def on_standing(self) -> None:
        """Take new messages, and publish the node's progress anew, while time stands."""
        try:
            self._take_inputs()
        except Exception as error:
            self._on_failure(error, self.clock.now())
        self._tell_progress()

    def _tell_progress(self) -> None:
        """Tell who makes the time up to when all that leaves has left."""
        if self.progress is not None:
            now, following = self.clock.now(), self.clock.first(self.period)
            held = self.holds_time or following == math.inf
            self.progress.tell(now if held else following, self.sent)

    @property
    def sent(self) -> int:
        """How many commands have left."""
        return 0

    def restart(self) -> None:
        """Begin anew: time was set."""
        for each in self._inputs:
            each.forget()
        if self.state == 'active':
            self.begin_time()

    def guarded(self, act: Callable[[float], None], now: float) -> None:
        """Act like a tick outside of the loop; a failure counts as one of a tick."""
        try:
            act(now)
        except Exception as error:
            self._on_failure(error, now)

    def _on_failure(self, error: Exception, now: float) -> None:
        """Count and log a failure of the tick; end the loop where nothing else is left."""
        self._tick_guard.note('tick', error)
        self._failing_since = min(self._failing_since, now)
        if not self.rescue() and now - self._failing_since > PATIENCE:
            raise error

    @property
    def tick_failures(self) -> int:
        """Ticks that ended with an exception."""
        return self._tick_guard.failures['tick']

    # ---- what a node of this kind does

    def tick(self, steps: int) -> None:
        """Advance by `steps` periods; called in the loop thread."""

    def rescue(self) -> bool:
        """Act safely after a failed tick; say whether this can continue indefinitely."""
        return False

    def begin(self) -> None:
        """Prepare, just before the loop starts; a hook."""

    def begin_time(self) -> None:
        """Prepare for simulated time that begins anew."""
        self.begin()

    def come_to_rest(self) -> None:
        """Come to rest when the loop has stopped; a hook."""

    # ---- loop

    def configure(self) -> None:
        """Load the robot, build all that the loop uses, compile it by using it."""
        self.realtime_options.update(lock_memory(self.settings.flag('lock_memory')))
        super().configure()

    def activate(self) -> None:
        """Start the loop."""
        self._take_aside()
        self.begin()
        if self.progress is not None:
            self.progress.tell(0.0, self.sent)  # time may not go on before the first tick
        settings = self.settings
        self.loop = RealtimeLoop(
            settings.number('update_rate'),
            self._turn,
            0 if self.clock.is_simulated else settings.integer('thread_priority'),
            settings.integer('cpu_affinity'),
            self.clock,
            self.to_log.append,
        )
        self.loop.load.threshold = settings.number('diagnostics.threshold.load')
        self.loop.start()

    def await_pause(self) -> None:
        """Wait until the loop has just ended a tick."""
        if self._loop_runs and self.loop is not None and not self.clock.is_simulated:
            self.loop.await_pause()

    def _watch_cores(self) -> None:
        """Let the loop know when it and other real-time threads fill their cores together."""
        if self._loop_runs and self.loop is not None:
            priority = self.settings.integer('thread_priority')
            self.loop.load.crowd(self._cores.realtime_share(priority))
            self.log_waiting()

    def deactivate(self) -> None:
        """Stop the loop and its motion; time need not wait for the node any more."""
        if self.loop is not None:
            self.loop.stop()
        self.come_to_rest()
        if self.progress is not None:
            self.progress.tell(math.inf, self.sent)

    def works_on(self) -> str:
        """Return rate, robot and coordinates."""
        robot = self.robot
        amplitudes = len(robot.flexible_indices)
        return (
            f' at {self.settings.number("update_rate"):g} Hz: robot {robot.tree.name}, '
            f'{len(robot.joint_names)} joints, {amplitudes} amplitudes'
        )

    @property
    def period(self) -> float:
        """Period of the loop [s]."""
        return 1.0 / self.settings.number('update_rate')

    def statuses(self) -> list[Status]:
        """State of the loop, its real-time options, and the node's work."""
        return [*self._loop_statuses(), *(self.work_statuses() if self.is_configured else [])]

    def work_statuses(self) -> list[Status]:
        """State of the work of a configured node."""
        return []

    def _loop_statuses(self) -> list[Status]:
        """State of the loop and its real-time options; a failed loop fails the node."""
        loop = self.loop
        if loop is None:
            return [Status('loop', message=self.state)]
        loop.load.threshold = self.settings.number('diagnostics.threshold.load')
        status = loop_status(
            loop.statistics(),
            loop.load,
            self.settings.number('diagnostics.threshold.late_share'),
        )
        if loop.failure is not None:
            self.fatal = f'loop failed: {type(loop.failure).__name__}: {loop.failure}'
            status.worsen(ERROR, self.fatal)
        status.values['state'] = self.state
        status.values['failures'] = self.tick_failures
        if self.progress is not None:
            status.values['overdue_messages'] = self._overdue
        if self.tick_failures > self._tick_guard.reported:
            status.worsen(ERROR, self._tick_guard.last)
        self._tick_guard.reported = self.tick_failures
        behind = self.clock.now() - loop.deadline
        if loop.running and behind > STANDSTILL + 2.0 * loop.period:
            status.worsen(ERROR, f'no tick for {behind:.1f} s')
        loop_options = {f'loop {name}': what for name, what in loop.realtime_options.items()}
        return [status, realtime_status({**loop_options, **self.realtime_options})]
