"""A lifecycle node that survives every request and message, and ends without residue."""

from __future__ import annotations

import gc
from collections import Counter, deque
from collections.abc import Callable
from typing import Any

import rclpy
from rcl_interfaces.msg import ParameterType, SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node

from denoc_ros.nodes.base.node_log import VisibleLog

LONGEST_REASON = 1000  # characters of what a message may have put into an error
# how service types say that they failed, and why
FAILED = {'success': False, 'successful': False}
REASONS = ('message', 'reason', 'failure_reason')
Service = Callable[[Any, Any], Any]
LONGEST_LOG = 100  # lines that wait, within a second, to be logged


def leave_graph() -> None:
    """Destroy the default context, which ends the last of the middleware's threads.

    All nodes must have been destroyed. A thread that is alive when the process exits may still
    be at work on what is being freed.
    """
    context = rclpy.get_default_context()
    rclpy.try_shutdown()
    context.destroy()
    gc.collect()


class WithoutEvents(Node):
    """A node that no event of the middleware can hold up.

    Taking an event (rmw_fastrtps 8.4.3) locks the event and then the reader, while a thread that
    receives, and tells of a lost message or a publisher that does not fit, locks them the other
    way round: under load the executor stops for good, and with it all that the process receives.
    """

    def get_logger(self) -> Any:
        """Return the node's logger; it shows control characters."""
        return VisibleLog(super().get_logger())

    def create_subscription(self, *given: Any, **options: Any) -> Any:
        """Subscribe as rclpy does."""
        events = SubscriptionEventCallbacks(use_default_callbacks=False)
        return super().create_subscription(*given, event_callbacks=events, **options)

    def create_publisher(self, *given: Any, **options: Any) -> Any:
        """Publish as rclpy does."""
        events = PublisherEventCallbacks(use_default_callbacks=False)
        return super().create_publisher(*given, event_callbacks=events, **options)


class Guard:
    """Keeps exceptions from ending the process whose executor calls back.

    Parameters
    ----------
    log : callable
        Takes the first failure of each kind.

    Attributes
    ----------
    failures : Counter
        Failed calls, by what was called.
    last : str
        The last failure.
    reported : int
        How many of them /diagnostics has warned of.
    """

    def __init__(self, log: Callable[[str], None]) -> None:
        self.failures: Counter[str] = Counter()
        self.last = ''
        self.reported = 0
        self._log = log
        self._logged: set[tuple[str, str]] = set()

    def note(self, what: str, error: Exception) -> str:
        """Count a failure, log the first of its kind; return it in words."""
        kind = type(error).__name__
        text = f'{kind}: {error}'.encode(errors='replace').decode()[:LONGEST_REASON]
        self.failures[what] += 1
        self.last = f'{what} failed, got {text}'
        if (what, kind) not in self._logged:
            self._logged.add((what, kind))
            self._log(f'{self.last}{_place(error)}')
        return text

    def calling(self, what: str, callback: Callable[..., Any]) -> Callable[..., Any]:
        """Return a callback that fails for nobody; it then returns None."""

        def guarded(*arguments: Any) -> Any:
            try:
                return callback(*arguments)
            except Exception as error:
                self.note(what, error)
                return None

        return guarded

    def handling(self, what: str, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        """Return a guarded callback of a subscription: rclpy counts its arguments."""
        call = self.calling(what, callback)

        def guarded(message: Any) -> None:
            call(message)

        return guarded

    def ticking(self, what: str, callback: Callable[[], None]) -> Callable[[], None]:
        """Return a guarded callback of a timer: rclpy counts its arguments."""
        call = self.calling(what, callback)

        def guarded() -> None:
            call()

        return guarded

    def serving(self, what: str, kind: Any, callback: Service) -> Service:
        """Return a callback of a service that answers a failure with a failure.

        Parameters
        ----------
        what : str
            For the log.
        kind : type
            Of the service.
        callback : callable
            Takes request and response.
        """

        def guarded(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except Exception as error:
                return _refusal(kind.Response(), self.note(what, error))

        served = _one_by_one(guarded) if kind is SetParameters else guarded
        served.guards = callback  # type: ignore[attr-defined]
        return served


def _place(error: Exception) -> str:
    """Return where an error was raised, for the log."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if trace is None:
        return ''
    return f' ({trace.tb_frame.f_code.co_filename}:{trace.tb_lineno})'


def _refusal(response: Any, reason: str) -> Any:
    """Say in a response of any type that the request failed, and why where it can be said."""
    parts = [response, *(getattr(response, name, None) for name in ('result', 'results'))]
    for part in parts:
        for name, value in {**FAILED, **dict.fromkeys(REASONS, reason)}.items():
            if hasattr(part, name):
                setattr(part, name, value)
    if isinstance(response, SetParameters.Response):
        response.results = [SetParametersResult(successful=False, reason=reason)]
    return response


def _one_by_one(callback: Service) -> Service:
    """Return a service that sets each parameter by a call of its own: each has its result."""

    def guarded(request: Any, response: Any) -> Any:
        for parameter in request.parameters:
            one = callback(SetParameters.Request(parameters=[parameter]), SetParameters.Response())
            response.results.extend(one.results)
        return response

    return guarded


class GuardedNode(WithoutEvents, LifecycleNode):
    """A lifecycle node whose callbacks, rclpy's own among them, are all guarded.

    Attributes
    ----------
    guard : Guard
        Counts the calls that failed.
    to_log : deque of str
        What is to be logged within a second: not at once, for a log that blocks must not block
        a loop.
    """

    def __init__(self, name: str, **options: Any) -> None:
        self.to_log: deque[str] = deque(maxlen=LONGEST_LOG)
        self.guard = Guard(self.to_log.append)
        super().__init__(name, **options)
        for service in self._services:  # rclpy makes some without `create_service`
            service.callback = self._serving(service.srv_name, service.srv_type, service.callback)

    def create_subscription(
        self, kind: Any, topic: str, callback: Callable[[Any], None], *given: Any, **options: Any
    ) -> Any:
        """Subscribe as rclpy does; a callback that fails does not end the node."""
        handle = self.guard.handling(f'topic {topic}', callback)
        return super().create_subscription(kind, topic, handle, *given, **options)

    def create_timer(
        self, period: float, callback: Callable[[], None], *given: Any, **options: Any
    ) -> Any:
        """Make a timer as rclpy does; a callback that fails does not end the node."""
        tick = self.guard.ticking(f'timer {callback.__name__.strip("_")}', callback)
        return super().create_timer(period, tick, *given, **options)

    def create_service(self, kind: Any, name: str, callback: Service, **options: Any) -> Any:
        """Make a service as rclpy does; a callback that fails answers that it did."""
        return super().create_service(kind, name, self._serving(name, kind, callback), **options)

    def _serving(self, name: str, kind: Any, callback: Service) -> Service:
        if hasattr(callback, 'guards'):
            return callback
        return self.guard.serving(f'service {name.rpartition("/")[2]}', kind, callback)

    def get_parameter_type(self, name: str) -> Any:
        """Return a parameter's type as a message has it: not set for an unknown one."""
        known = self.has_parameter(name)
        return super().get_parameter_type(name) if known else ParameterType.PARAMETER_NOT_SET

    def destroy_node(self) -> None:
        """Leave the graph.

        What rclpy's own leaves behind, above all the state machine, would keep the participant
        of the middleware, and its threads, alive to the end of the process.
        """
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()
