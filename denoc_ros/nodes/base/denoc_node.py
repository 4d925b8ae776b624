"""The lifecycle node under every node: parameters, inputs, diagnostics, start and clean end."""

from __future__ import annotations

import gc
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger

from denoc_ros.errors import ConfigError, DenocError
from denoc_ros.nodes.base.guarded_node import Guard, GuardedNode
from denoc_ros.nodes.base.inputs import Handler, Input, never_heavy
from denoc_ros.nodes.base.messages import NEWEST, wait_until_delivered
from denoc_ros.nodes.base.simulated_time import ClockInput
from denoc_ros.runtime.inputs.input_monitor import InputError, InputMonitor
from denoc_ros.runtime.loop.clocks import Clock as RobotClock
from denoc_ros.runtime.loop.clocks import SimulatedClock, SteadyClock
from denoc_ros.runtime.loop.ending import SIGNALS
from denoc_ros.runtime.loop.realtime import freeze_gc, make_callbacks_timely
from denoc_ros.runtime.loop.status import WARN, Status, clock_status, input_status
from denoc_ros.runtime.parameters.parameter_table import ParameterTable, Settings, shared_names
from denoc_ros.settings import Value

POLL_PERIOD = 0.02  # s of wall time between looks at a clock that no loop waits for
# parameters that rclpy itself declares
SIMULATED = 'use_sim_time'
FOREIGN = (SIMULATED, 'start_type_description_service', 'qos_overrides.')


class DiagnosticsPublisher:
    """Publishes a node's statuses on /diagnostics."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)

    def publish(self, statuses: Sequence[Status]) -> None:
        """Publish statuses, stamped now."""
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        name = self._node.get_fully_qualified_name().lstrip('/')
        message.status = [_message(name, status) for status in statuses]
        self._publisher.publish(message)


def _message(node: str, status: Status) -> DiagnosticStatus:
    return DiagnosticStatus(
        name=f'{node}: {status.name}',
        level=status.level,
        message=status.message,
        hardware_id=node,
        values=[KeyValue(key=key, value=_shown(value)) for key, value in status.values.items()],
    )


def _shown(value: object) -> str:
    return f'{value:.6g}' if isinstance(value, float) else str(value)


def callback_status(guard: Guard) -> Status:
    """Return which callbacks failed, and how often; warns of new failures."""
    status = Status('callbacks', values=dict(sorted(guard.failures.items())))
    failed = guard.failures.total()
    if failed > guard.reported:
        status.worsen(WARN, guard.last)
    guard.reported = failed
    return status


class DenocNode(GuardedNode):
    """A lifecycle node with a parameter table, monitored inputs and diagnostics.

    A node overrides `configure`, `activate`, `deactivate`, `cleanup` (they may raise DenocError:
    the transition fails and the message is logged), `statuses` and `settings_changed`.

    Parameters
    ----------
    name : str
        Default node name.
    table : ParameterTable
        Its parameters.

    Raises
    ------
    ConfigError
        A parameter given at the start is not one of the table's or not valid; every finding.

    Attributes
    ----------
    settings : Settings
        The parameters' values now.
    clock : denoc_ros.runtime.loop.clocks.Clock
        The robot's time: simulated with `use_sim_time`.
    failure : str
        Why the last transition failed; '' if it did not.
    fatal : str
        Why the process cannot go on; '' if it can.
    starting : bool
        Whether the node is starting itself.
    ready : bool
        Whether `configure` has what it needs from topics.
    owns_process : bool
        Whether garbage collection is the node's to settle.
    realtime_options : dict of str to str
        What was asked of the system to be on time: `taken: …`, `refused: …` or `off`.
    """

    clock_depth = 1  # messages of /clock that wait
    prioritized: Callable[[int], dict[str, str]] = staticmethod(make_callbacks_timely)

    def __init__(self, name: str, table: ParameterTable, **options: Any) -> None:
        self._unserved: set[int] = set()
        # the table decides: undeclared names are the members of its families
        super().__init__(name, allow_undeclared_parameters=True, **options)
        self.table = table
        self.failure = ''
        self.fatal = ''
        self.starting = False
        self.ready = True
        self.owns_process = False
        self.realtime_options: dict[str, str] = {}
        self.monitors: list[InputMonitor] = []
        self._shown: dict[str, Value] = {}
        self._showing = False
        self._lasting: list[Any] = []  # publishers that configure has not made
        given = {
            key: parameter.value
            for key, parameter in self._parameter_overrides.items()
            if not key.startswith(FOREIGN)
        }
        for other in self._for_others(table.unknown(given), options):
            del given[other]
            self.get_logger().warning(
                f"parameter '{other}' is ignored: this node has no parameter of this name, "
                'and its section of the file is for all nodes'
            )
        try:
            self.settings = table.settings(given, self.get_fully_qualified_name())
        except DenocError:
            self.destroy_node()
            raise
        self._declare()
        self.steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.clock_input: ClockInput | None = None
        self.clock = self.make_clock()
        self._diagnostics = DiagnosticsPublisher(self)
        self.create_timer(1.0, self._every_second, clock=self.steady_clock)

    # ---- parameters

    def _for_others(self, unknown: Sequence[str], options: Mapping[str, Any]) -> list[str]:
        """Return which of unknown parameters a file gives to all nodes alike."""
        if not unknown:
            return []
        arguments = list(options.get('cli_args') or ())
        if options.get('use_global_arguments', True):
            arguments = [*sys.argv, *arguments]
        own = {parameter.name for parameter in options.get('parameter_overrides') or ()}
        shared = shared_names(arguments, self.get_fully_qualified_name())
        return [name for name in unknown if name in shared - own]

    def _declare(self) -> None:
        for name in self.settings:
            value = self.settings[name]
            # not as it was given: an empty list comes as None, and a double as an integer
            self.declare_parameter(name, value, self._descriptor(name), ignore_override=True)
        self.add_pre_set_parameters_callback(self._typed)
        self.add_on_set_parameters_callback(self._on_parameters)

    def _typed(self, parameters: Sequence[Any]) -> list[Any]:
        """Return parameters that are to be set with values of their rows' types."""
        found = []
        for parameter in parameters:
            with suppress(ValueError):
                value = self.table.accept(parameter.name, parameter.value)
                parameter = rclpy.Parameter(parameter.name, value=value)
            found.append(parameter)
        return found

    def _descriptor(self, name: str) -> ParameterDescriptor:
        row = self.table.row(name)
        assert row is not None
        text = row.text + (f' [{row.unit}]' if row.unit else '')
        return ParameterDescriptor(
            description=text.replace('\\', ''),
            additional_constraints=row.range.replace('\\', ''),
            dynamic_typing=True,  # the table checks types: it takes 5 for 5.0
        )

    def describe_parameter(self, name: str) -> Any:
        """Return a parameter's descriptor; any type for an unknown one: the table refuses it."""
        descriptor = super().describe_parameter(name)
        if not self.has_parameter(name):
            descriptor.dynamic_typing = True
        return descriptor

    def show(self, values: Mapping[str, Value]) -> None:
        """List members of families that were not given, with the values that hold.

        Parameters
        ----------
        values : mapping of str to value
            All of them; those shown before and not among these are taken off the list.
        """
        self._showing = True
        for name in self._shown.keys() - values.keys():
            self.undeclare_parameter(name)
        for name, value in values.items():
            if self._shown.get(name) == value:
                continue
            if not self.has_parameter(name):
                self.declare_parameter(name, value, self._descriptor(name), ignore_override=True)
            elif not np.array_equal(self.get_parameter(name).value, value):
                self.set_parameters([rclpy.Parameter(name, value=value)])
        self._shown = dict(values)
        self._showing = False

    def _on_parameters(self, parameters: Sequence[Any]) -> SetParametersResult:
        if self._showing:
            return SetParametersResult(successful=True)
        given = {p.name: p.value for p in parameters if not p.name.startswith(FOREIGN)}
        used = self.get_parameter(SIMULATED).value
        if any(p.name == SIMULATED and p.value != used for p in parameters):
            reason = f"parameter '{SIMULATED}' must be given when the node starts, got it later"
            return SetParametersResult(successful=False, reason=reason)
        try:
            changes = self.plain(self.table.changes(self.settings, given))
            if changes:
                self.settings_changed(self.settings.replace(changes), changes)
                self.settings = self.settings.replace(changes)
        except (ValueError, DenocError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def plain(self, changes: dict[str, Value]) -> dict[str, Value]:
        """Return changes under the names that the settings have them by."""
        return changes

    def settings_changed(self, settings: Settings, changes: dict[str, Value]) -> None:
        """Take live changes before they are stored; may refuse by DenocError or ValueError."""

    def config_error(self, finding: str) -> ConfigError:
        """Return the error of a parameter that does not suit, under the node's full name."""
        return ConfigError(self.get_fully_qualified_name(), [finding])

    # ---- inputs

    def listen(
        self,
        message_type: type,
        topic: str,
        handle: Handler,
        qos: QoSProfile = NEWEST,
    ) -> InputMonitor:
        """Subscribe to raw messages that the executor serves.

        `handle(raw, arrived)` parses and stores, or raises InputError; it calls
        `monitor.accept(stamp_ns, arrived)` on the monitor returned here.
        """
        return self.subscribe(message_type, topic, handle, qos).monitor

    def subscribe(
        self,
        message_type: type,
        topic: str,
        handle: Handler,
        qos: QoSProfile,
        is_heavy: Callable[[bytes], bool] = never_heavy,
    ) -> Input:
        """Subscribe as `listen` does; return the input itself."""
        limit = self.settings.integer('max_publishers') if 'max_publishers' in self.settings else 1
        monitor = InputMonitor(topic, limit)
        self.monitors.append(monitor)
        return Input(self, message_type, topic, handle, qos, monitor, is_heavy)

    @property
    def subscriptions(self) -> Iterator[Any]:
        """Yield those that the executor serves."""
        return (each for each in super().subscriptions if id(each) not in self._unserved)

    def take_aside(self, subscription: Any) -> None:
        """Keep the executor from a subscription: the node takes its messages itself."""
        self._unserved.add(id(subscription))

    def drop(self, subscription: Any) -> None:
        """Destroy a subscription that was taken aside."""
        self.destroy_subscription(subscription)
        self._unserved.discard(id(subscription))

    def refuse(self, monitor: InputMonitor, error: InputError) -> None:
        """Count a bad message; the first of each cause is logged within a second."""
        if monitor.reject(error):  # not here: a log that blocks must not block a loop
            self.to_log.append(f'{monitor.topic} rejected ({error.cause}): {error}')

    def forget_stamps(self) -> None:
        """Accept inputs with any stamp: the next messages may be older than the last ones."""
        for monitor in self.monitors:
            monitor.reset()

    def add_trigger_service(self, name: str, act: Callable[[], str]) -> None:
        """Offer a Trigger service: `act` returns a message or raises DenocError."""

        def on_request(_request: Any, response: Any) -> Any:
            try:
                response.message = act()
                response.success = True
            except DenocError as error:
                response.success, response.message = False, str(error)
            return response

        self.create_service(Trigger, name, on_request)

    def stamp_ns_at(self, moment: float) -> int:
        """Return the stamp [ns] of a moment of the clock [s]."""
        return self.clock.stamp_ns(moment)

    def stamp_ns(self) -> int:
        """Return now for headers [ns]: the system's time, or simulated time where in use."""
        return self.clock.now_ns()

    # ---- time

    def make_clock(self) -> RobotClock:
        """Return the robot's time: of /clock where `use_sim_time` is true."""
        if not self.get_parameter(SIMULATED).value:
            return SteadyClock()
        self.clock_input = ClockInput(self, self.clock_depth)
        self.create_timer(POLL_PERIOD, self.follow_clock, clock=self.steady_clock)
        return SimulatedClock(self.clock_input.receive, self._on_new_time, self.on_standing)

    def follow_clock(self) -> None:
        """Look at the time, where no loop does."""
        if isinstance(self.clock, SimulatedClock):
            self.clock.poll()

    def on_standing(self) -> None:
        """Act while a loop waits for a clock that stands; a hook."""

    def _on_new_time(self, by: float) -> None:
        """Begin anew: simulated time was set by so many seconds."""
        way = 'back' if by < 0.0 else 'ahead'
        self.to_log.append(f'simulated time was set {way} by {abs(by):.3f} s: all begins anew')
        self.forget_stamps()
        self.restart()

    def restart(self) -> None:
        """Forget the state of a time that is no more."""

    # ---- diagnostics

    def statuses(self) -> list[Status]:
        """Return the node's own statuses for /diagnostics."""
        return []

    def await_pause(self) -> None:
        """Wait until a loop leaves the interpreter to others for a while."""

    def log_waiting(self) -> None:
        """Log the messages that a loop has left."""
        while self.to_log:
            self.get_logger().warning(self.to_log.popleft())

    def _every_second(self) -> None:
        self.log_waiting()
        self.await_pause()
        statuses = self.guard.calling('diagnostics', self.statuses)() or []
        if self.clock_input is not None and isinstance(self.clock, SimulatedClock):
            silence = time.perf_counter() - self.clock.heard
            statuses.append(clock_status(self.clock, silence, self.clock_input.publishers))
        if self.monitors:
            statuses.append(input_status(self.monitors, self.clock.now()))
        if self.guard.failures:
            statuses.append(callback_status(self.guard))
        self.await_pause()
        self._diagnostics.publish(statuses)
        if self.owns_process:
            self.await_pause()
            # all that existed at configure is frozen: this looks at the few new objects only
            gc.collect()

    # ---- lifecycle

    def configure(self) -> None:
        """Load, build, compile, touch."""

    def activate(self) -> None:
        """Begin."""

    def deactivate(self) -> None:
        """End safely."""

    def cleanup(self) -> None:
        """Drop the products of configure, but for its publishers: those are dropped anyway."""

    def _transition(self, act: Callable[[], None]) -> TransitionCallbackReturn:
        self.failure = ''
        try:
            act()
        except (DenocError, OSError, ValueError) as error:
            self.failure = str(error)
            if not self.starting:  # else the process ends with this as its one message
                self.get_logger().error(self.failure)
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self.failure = f'{type(error).__name__}: {error}'
            self.get_logger().error(traceback.format_exc())
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Configure; then settle memory so that no collection interrupts the loop."""
        self._lasting = list(self.publishers)
        if self.owns_process:
            with SIGNALS.interrupting():  # it may compile for a minute
                result = self._transition(self.configure)
                self.realtime_options.update(freeze_gc())
        else:
            result = self._transition(self.configure)
        if result != TransitionCallbackReturn.SUCCESS:
            self._drop_publishers()
        return result

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Activate; then give the threads their priority."""
        result = self._transition(self.activate)
        if result == TransitionCallbackReturn.SUCCESS:
            self.get_logger().info(self.summary())
        if self.owns_process and 'thread_priority' in self.settings:
            # simulated time waits for everybody: as fast as it goes, a priority would take it all
            priority = 0 if self.clock.is_simulated else self.settings.integer('thread_priority')
            self.realtime_options.update(self.prioritized(priority))
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate."""
        return self._transition(self.deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Clean up."""
        return self._transition(self._clean_up)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate if active, then clean up."""

        def end() -> None:
            if state.label == 'active':
                self.deactivate()
            if state.label != 'unconfigured':  # else there is nothing to drop
                self._clean_up()

        return self._transition(end)

    def _clean_up(self) -> None:
        self.cleanup()
        self._drop_publishers()

    def _drop_publishers(self) -> None:
        """Destroy the publishers that configure has made; the next one makes them anew."""
        for publisher in [each for each in self.publishers if each not in self._lasting]:
            self.destroy_publisher(publisher)

    def summary(self) -> str:
        """Describe the node's inputs and outputs in a line, for the log."""
        own = {'/rosout', '/parameter_events', '/diagnostics'}
        inputs = [monitor.topic for monitor in self.monitors]
        outputs = [p.topic_name for p in self.publishers if p.topic_name not in own]
        outputs = [name for name in outputs if not name.endswith('/transition_event')]
        return (
            f'active{self.works_on()}; listens to {", ".join(inputs) or "nothing"}; publishes '
            f'{", ".join(dict.fromkeys(outputs)) or "nothing"}'
        )

    def works_on(self) -> str:
        """Describe the node's robot and rate, for the log."""
        return ''

    @property
    def state(self) -> str:
        """Label of the lifecycle state."""
        return str(self._state_machine.current_state[1])

    @property
    def is_configured(self) -> bool:
        """Whether the node is configured: active or not."""
        return self.state in ('active', 'inactive')

    def save(self) -> None:
        """Save the state when the executor hangs: called last, from another thread."""

    def end(self) -> None:
        """Go to the end of the life cycle from wherever the node is."""
        if self.state == 'active':
            self.trigger_deactivate()
        wait_until_delivered(self.publishers)
        if self.state == 'inactive':
            self.trigger_cleanup()
        self.save()  # what no transition has: interrupted on its way, or begun outside of active
