"""The session's own node, in the process of `denoc up`: robot, reference, phases, health."""

from __future__ import annotations

import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.experimental import EventsExecutor
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.bags.reader import DESCRIPTION_TOPIC, SESSION_DESCRIPTION_TOPIC
from denoc_ros.errors import DenocError
from denoc_ros.nodes.base.guarded_node import WithoutEvents, leave_graph
from denoc_ros.nodes.base.inputs import arrived
from denoc_ros.nodes.base.messages import (
    COMMAND,
    LATCHED,
    duration_message,
    exact_bytes,
    time_message,
)
from denoc_ros.nodes.base.simulated_time import time_ns
from denoc_ros.runtime.loop.status import ERROR, OK
from denoc_ros.trajectories import Trajectory

MARKS = QoSProfile(  # none of a session's is lost, however busy a recorder is
    depth=1000, reliability=LATCHED.reliability, durability=LATCHED.durability
)
ASKED_TOPIC = '/up/asked'  # the motion that a reference was shaped from
REFERENCE_STEP = 0.05  # s; the quintics between such points are exact to 1e-9 rad
LARGEST_MESSAGE = 60_000  # bytes: a best-effort message should fit one datagram
DISCOVERY = 0.5  # s in which those who are there already make themselves known
# s since this node has joined in which those of other sessions are found, on a busy machine
OTHERS_DISCOVERY_S = 2.0
# s until a request is sent again: one that comes before the server has found the client is lost
RETRY = 1.0
PATIENCE = 30.0  # s that a service may take to answer on a loaded machine


class NodeError(DenocError):
    """A node did not answer a request of the session as required."""


class Driver(WithoutEvents):
    """The session's node, which takes /clock by itself: a callback each would cost more."""

    clock: Any = None

    @property
    def subscriptions(self) -> Iterator[Any]:
        """Yield those that the executor serves."""
        return (each for each in super().subscriptions if each is not self.clock)


class SessionClient:
    """Publisher of a session's inputs, and listener to its nodes' health.

    Parameters
    ----------
    description : str
        URDF text, latched on `SESSION_DESCRIPTION_TOPIC`, and on `robot_description` unless
        somebody else publishes there.
    drives : bool
        Whether it publishes `reference`: a second publisher there would be refused by the nodes.
    watch : callable
        Called during every wait, about every 20 ms; raises when the wait is pointless.
    topic : str
        Where it publishes instead of `reference`, such as the shaper's input.

    Attributes
    ----------
    has_other_robot : bool
        Whether `robot_description` has had another text than `description`.
    """

    def __init__(
        self,
        description: str,
        drives: bool = True,
        watch: Callable[[], None] = lambda: None,
        topic: str = 'reference',
    ) -> None:
        self._watches = [watch]
        self._running = True
        self._statuses: dict[str, dict[str, str]] = {}
        self._levels: dict[str, bytes] = {}
        self._reports: Counter[str] = Counter()
        self._reported_ns: dict[str, int] = {}
        self._clock_ns = -1
        self._text = description
        self.has_other_robot = False
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = Driver('up', use_global_arguments=False)
        self._executor = EventsExecutor()
        self._thread = threading.Thread(target=self._spin, name='driver', daemon=True)
        try:
            self._join(topic if drives else '')
        except BaseException:
            self.close()
            raise

    def _join(self, topic: str) -> None:
        """Publish and listen; give the robot where nobody else does."""
        node = self._node
        node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 50)
        # from the start, so that the recorder has found it when the first reference goes out
        self._reference = node.create_publisher(JointTrajectory, topic, COMMAND) if topic else None
        self._asked = (
            node.create_publisher(JointTrajectory, ASKED_TOPIC, COMMAND) if topic else None
        )
        self._phase = node.create_publisher(String, '/up/phase', MARKS)
        qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        node.clock = node.create_subscription(Clock, '/clock', lambda _raw: None, qos, raw=True)
        node.create_subscription(String, DESCRIPTION_TOPIC, self._on_description, LATCHED)
        self._executor.add_node(node)
        self._joined = time.perf_counter()
        self._ended = set[str]()
        self._thread.start()
        self._publish_robot(SESSION_DESCRIPTION_TOPIC)
        if not self.until(lambda: bool(node.count_publishers(DESCRIPTION_TOPIC)), DISCOVERY):
            self._publish_robot(DESCRIPTION_TOPIC)

    def _publish_robot(self, topic: str) -> None:
        publisher = self._node.create_publisher(String, topic, LATCHED)
        publisher.publish(String(data=self._text))

    def _on_description(self, message: Any) -> None:
        self.has_other_robot |= message.data != self._text

    def forget_nodes(self, names: Collection[str]) -> None:
        """Leave out a node of each name that the graph still has: the session has ended its own.

        The middleware may keep an ended node in the graph for as long as this process runs.
        """
        there = set(self._node.get_node_names_and_namespaces())
        self._ended = {name for name in names if (name, '/') in there}

    def require_alone(
        self, names: Collection[str], uses_clock: bool, own: int = 0, patience: float = 0.0
    ) -> None:
        """Refuse nodes of another session, which would take this one's messages for their own.

        Parameters
        ----------
        names : collection of str
            Nodes of the session.
        uses_clock : bool
            Whether simulated time may come from it.
        own : int
            How many nodes of each name, and publishers of /clock, are the session's.
        patience : float
            For the middleware to forget nodes of the session that were killed [s].

        Raises
        ------
        NodeError
            With those that the graph has beyond the session's own.
        """
        others: list[str] = []

        def finds_others() -> bool:
            there = Counter(self._node.get_node_names_and_namespaces())
            most = {name: own + (name in self._ended) for name in names}
            others[:] = [f'/{name}' for name in names if there[name, '/'] > most[name]]
            others.extend(['/up'] if there['up', '/'] > 1 else [])
            if uses_clock and self.clock_publishers() > own:
                others.append('a publisher of /clock')
            return bool(others)

        if own:
            self.until(lambda: not finds_others(), patience)
        else:  # Others take a while to be found.
            self.until(finds_others, self._joined + OTHERS_DISCOVERY_S - time.perf_counter())
        if others:
            raise NodeError(
                f'ROS domain {os.environ.get("ROS_DOMAIN_ID", 0)}: nodes of other sessions must '
                f'not run, got {", ".join(others)}; end them or set another ROS_DOMAIN_ID'
            )

    def __enter__(self) -> SessionClient:
        """Return itself."""
        return self

    def __exit__(self, *_error: object) -> None:
        """Leave the graph."""
        self.close()

    def close(self) -> None:
        """Leave the graph; nothing of it is left."""
        self._running = False
        if self._thread.is_alive():
            self._thread.join(2.0)
        self._executor.remove_node(self._node)
        self._node.destroy_node()
        self._executor.shutdown()
        leave_graph()

    def add_watch(self, watch: Callable[[], None]) -> None:
        """Have another function called during every wait."""
        self._watches.append(watch)

    def diagnostics(self, status: str) -> Mapping[str, str]:
        """Return the last values of a diagnostic status such as `feedforward: loop`.

        Its message stands under the empty key.
        """
        return self._statuses.get(status, {})

    def wait(self, seconds: float) -> None:
        """Let time pass, watching."""
        self.until(lambda: False, seconds)

    def until(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Wait for a condition, at most `timeout` [s]; return whether it came about."""
        end = time.perf_counter() + timeout
        while not condition():
            for watch in self._watches:
                watch()
            left = end - time.perf_counter()
            if left <= 0.0:
                return False
            time.sleep(min(0.02, left))
        return True

    def failure(self, status: str) -> str:
        """Return the message of a diagnostic status that is an error, '' if it is none."""
        return self._statuses[status][''] if self._levels.get(status, OK) >= ERROR else ''

    def reports(self, name: str) -> int:
        """Return how often a node has spoken on /diagnostics since it was started."""
        return self._reports[name]

    def reported_ns(self, name: str) -> int:
        """Return the stamp of a node's last report on /diagnostics [ns], -1 before the first."""
        return self._reported_ns.get(name, -1)

    def clock_ns(self) -> int:
        """Return the newest time of /clock [ns], -1 before the first."""
        for raw, *_ in arrived(self._node.clock, 1):
            self._clock_ns = time_ns(raw)
        return self._clock_ns

    def clock_publishers(self) -> int:
        """Return how many publishers /clock has."""
        return int(self._node.count_publishers('/clock'))

    def reported(self, what: str) -> str:
        """Return in words what all nodes report of a status such as `clock`."""
        found = [each for each in sorted(self._statuses.items()) if each[0].endswith(f': {what}')]
        return '; '.join(f'{name}: {values[""]}' for name, values in found) or 'nothing'

    def forget(self, name: str) -> None:
        """Forget a node's reports: it is about to be started anew."""
        self._reports.pop(name, None)
        self._reported_ns.pop(name, None)
        for status in [status for status in self._statuses if status.startswith(f'{name}: ')]:
            del self._statuses[status]

    def wait_active(self, name: str, timeout: float) -> None:
        """Wait until a node says on /diagnostics, which it does once a second, that it is active.

        Raises
        ------
        NodeError
            When it does not within `timeout` [s].
        """
        if not self.until(lambda: self._says_active(name), timeout):
            raise NodeError(f'{name}: node must be active within {timeout:g} s')

    def _says_active(self, name: str) -> bool:
        loop = self.diagnostics(f'{name}: loop')
        page = self.diagnostics(f'{name}: page')
        recording = self.diagnostics(f'{name}: recording')
        said = (loop.get('state'), loop.get(''), page.get('state'))
        return 'active' in said or 'path' in recording

    def trigger(self, service: str) -> None:
        """Call a Trigger service; NodeError when it fails or does not answer."""
        client = self._node.create_client(Trigger, service)
        reply = self._insist(client, Trigger.Request())
        self._node.destroy_client(client)
        if reply is None or not reply.success:
            answer = 'no answer' if reply is None else reply.message
            raise NodeError(f'{service}: request must succeed, got: {answer}')

    def set_parameters(self, name: str, values: Mapping[str, Any]) -> None:
        """Set live parameters of a node; NodeError when it refuses one."""
        client = self._node.create_client(SetParameters, f'/{name}/set_parameters')
        request = SetParameters.Request(
            parameters=[
                Parameter(key, value=value).to_parameter_msg() for key, value in values.items()
            ]
        )
        reply = self._insist(client, request)
        self._node.destroy_client(client)
        refused = (
            ['no answer']
            if reply is None
            else [result.reason for result in reply.results if not result.successful]
        )
        if refused:
            raise NodeError(f'{name}: parameters must be accepted, got: {"; ".join(refused)}')

    def begin_phase(self, name: str) -> None:
        """Tell everybody, the recorder above all, that a phase begins."""
        self._phase.publish(String(data=name))

    def end_phase(self) -> None:
        """Tell everybody that the phase is over."""
        self._phase.publish(String(data=''))

    def publish_reference(
        self, trajectory: Trajectory, joints: list[str], start_ns: int, listeners: int
    ) -> None:
        """Publish a trajectory of many points that starts at a stamp [ns].

        Raises
        ------
        NodeError
            When there are not as many listeners as there should be.
        """
        publisher = self._listened(listeners)
        publisher.publish(exact_bytes(reference_message(trajectory, joints, start_ns)))

    def await_listeners(self, listeners: int) -> None:
        """Wait until as many nodes listen to the reference as there should be; else NodeError."""
        self._listened(listeners)

    def _listened(self, listeners: int) -> Any:
        publisher = self._reference
        if publisher is None:
            raise NodeError('up: a session that publishes no reference was asked for one')
        if not self.until(lambda: publisher.get_subscription_count() >= listeners, PATIENCE):
            raise NodeError(
                f'{publisher.topic_name}: {listeners} nodes must listen, '
                f'got {publisher.get_subscription_count()}'
            )
        return publisher

    def publish_asked(self, trajectory: Trajectory, joints: list[str], start_ns: int) -> None:
        """Publish the wanted motion for the record, where the reference is shaped from it."""
        if self._asked is not None:
            self._asked.publish(exact_bytes(reference_message(trajectory, joints, start_ns)))

    def _insist(self, client: Any, request: Any) -> Any:
        """Ask until there is a reply, None if there is none in time; the request is idempotent."""
        end = time.perf_counter() + PATIENCE
        while time.perf_counter() < end:
            reply = self._ask(client, request, RETRY)
            if reply is not None:
                return reply
        return None

    def _ask(self, client: Any, request: Any, timeout: float) -> Any:
        """Return the reply of a service, None when there is none in time."""
        end = time.perf_counter() + timeout
        if not self.until(client.service_is_ready, timeout):
            return None
        future = client.call_async(request)
        self.until(future.done, max(0.0, end - time.perf_counter()))
        return future.result() if future.done() else None

    def _spin(self) -> None:
        while self._running and rclpy.ok():
            self._executor.spin_once(0.1)

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            self._statuses[status.name] = {'': status.message, **values}
            self._levels[status.name] = status.level
        names = {status.hardware_id for status in message.status}
        stamp = message.header.stamp
        self._reported_ns.update(dict.fromkeys(names, 1_000_000_000 * stamp.sec + stamp.nanosec))
        self._reports.update(names)


def reference_message(trajectory: Trajectory, joints: list[str], start_ns: int) -> JointTrajectory:
    """Return a trajectory as points with velocities and accelerations.

    Parameters
    ----------
    trajectory : Trajectory
        What to follow.
    joints : list of str
        Names of its joints.
    start_ns : int
        When it starts [ns].
    """
    row = 24 * len(joints) + 28  # bytes of a point
    step = max(REFERENCE_STEP, trajectory.duration * row / LARGEST_MESSAGE)
    times, q, qd, qdd = trajectory.table(step)
    message = JointTrajectory(joint_names=joints)
    message.header.stamp = time_message(start_ns)
    message.points = [
        JointTrajectoryPoint(
            positions=q[k].tolist(),
            velocities=qd[k].tolist(),
            accelerations=qdd[k].tolist(),
            time_from_start=duration_message(float(times[k])),
        )
        for k in range(len(times))
    ]
    return message
