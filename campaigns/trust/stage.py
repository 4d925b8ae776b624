"""The stage of the fault campaign: one feedforward node as a process, and all that surrounds it.

The stage's own node is the robot (joint states), the planner (reference) and the witness: it keeps
every torque and every diagnostic message that comes. Following, the arm is asked to stand at GOAL
while it is measured at POSTURE: so each effort message says by its positions whether its torque
is the reference's or the safe command's. A torque counts from its stamp: on a busy machine the
stage hears of it later.
"""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from bench.loops.rates_blocks import domain
from diagnostic_msgs.msg import DiagnosticArray
from node_robots import GRAVITY, JOINTS, two_links
from numpy.typing import NDArray
from rcl_interfaces.srv import SetParameters
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.cli.session.node_parameters import write_parameters
from denoc_ros.cli.session.processes import Processes
from denoc_ros.parts import node_main
from denoc_ros.runtime.loop.realtime import make_thread_timely

POSTURE, GOAL = [0.4, -0.7], [0.1, 0.2]
RATE = 500.0  # Hz of the loop
FEED = 200.0  # Hz of joint states and streamed references
LIMITS = [60.0, 40.0]  # N m
DELTA = 4.0  # N m per tick
RECOVERY = 60.0  # s after a fault, on a busy machine
FEED_PRIORITY = 30  # SCHED_FIFO where allowed, below the node's own threads
PATIENCE = 240.0  # s for a process to come up: a busy machine may take minutes to compile kernels
# s: a machine that pauses the stage for so long may pause its messages and the nodes as well
OWN_PAUSE = 0.05
LAG = 1.0  # s that a busy machine may take to bring a message
SETTLED = 5  # torques along the reference in a row, until it counts as followed
AGAIN = 0.2  # s until the reference is asked for again
INPUTS = 'feedforward: inputs'  # status on /diagnostics
PARAMETERS: dict[str, Any] = {
    'gravity': GRAVITY,
    'update_rate': RATE,
    'model': 'flexible',
    'effort_limits': LIMITS,
    'max_delta_tau': DELTA,
    'joint_state_timeout': 0.1,
    'reference_timeout': 0.1,
    'ramp_time': 0.1,
    'thread_priority': 40,
}
EVERY = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)


class StageError(AssertionError):
    """What had to come about did not."""


@dataclass(frozen=True)
class Torques:
    """Effort messages in the order they came: stamp [s], position, effort (k, n).

    `absent` is for how long [s] the machine paused the stage meanwhile, at most.
    """

    stamp: NDArray[np.float64]
    position: NDArray[np.float64]
    effort: NDArray[np.float64]
    absent: float

    @property
    def following(self) -> NDArray[np.bool_]:
        return np.asarray((self.position == GOAL).all(axis=1))


class StageProcesses(Processes):
    """Processes that may be signalled, and started in another environment."""

    def process(self, name: str) -> subprocess.Popen[bytes]:
        """Return a process that is watched."""
        return self._running[name]

    def signal(self, name: str, number: int) -> subprocess.Popen[bytes]:
        """Send a signal to a process, which is not watched any more; return it."""
        process = self._running.pop(name)
        process.send_signal(number)
        return process

    @contextmanager
    def environment(self, **more: str) -> Iterator[None]:
        """Start what is started meanwhile with more in its environment."""
        before = self._environment
        self._environment = {**before, **more}
        try:
            yield
        finally:
            self._environment = before


class Stage:
    """See the module."""

    def __init__(self, folder: Path, environment: Mapping[str, str]) -> None:
        self.folder = folder
        self.urdf = folder / 'arm.urdf'
        self.urdf.write_text(two_links())
        (folder / 'logs').mkdir()
        self.processes = StageProcesses(folder / 'logs', environment)
        self.environment = dict(environment)
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node('stage', use_global_arguments=False)
        self.states = self.node.create_publisher(JointState, 'joint_states', 10)
        self.references = self.node.create_publisher(JointTrajectory, 'reference', 10)
        self._torque: list[tuple[float, float, Any, Any]] = []
        self._commands: list[Any] = []
        self.diagnostics: list[tuple[float, Any]] = []
        for kind, topic, keep in (
            (JointState, '/feedforward/effort', self._keep_effort),
            (Float64MultiArray, '/feedforward/commands', self._commands.append),
            (DiagnosticArray, '/diagnostics', self._keep_diagnostics),
        ):
            self.node.create_subscription(kind, topic, keep, EVERY)
        self._fed: list[float] = []
        self.clock_offset_ns = 0
        self.robot: Callable[[], Sequence[Any]] = self.good_state
        self.planner: Callable[[], Sequence[Any]] = lambda: ()
        self._running = True
        self.executor = EventsExecutor()
        self.executor.add_node(self.node)
        self._threads = [
            threading.Thread(target=work, daemon=True) for work in (self._spin, self._feed)
        ]
        for thread in self._threads:
            thread.start()

    # ---- what the robot and the planner say

    def state(self, positions: Sequence[float] = POSTURE, names: Any = JOINTS) -> JointState:
        message = JointState(name=list(names), position=list(positions))
        stamp(message, time.time_ns() + self.clock_offset_ns)
        return message

    def good_state(self) -> Sequence[JointState]:
        return [self.state()]

    def point(self, positions: Sequence[float] = GOAL, **more: Any) -> JointTrajectory:
        """Return a streamed reference."""
        given = {'positions': list(positions), **more}
        message = JointTrajectory(joint_names=JOINTS, points=[JointTrajectoryPoint(**given)])
        stamp(message, time.time_ns() + self.clock_offset_ns)
        return message

    def hold(self) -> None:
        """Ask for GOAL from now on, as a trajectory."""
        first, last = (JointTrajectoryPoint(positions=GOAL) for _ in range(2))
        last.time_from_start.nanosec = 1_000_000
        self.references.publish(JointTrajectory(joint_names=JOINTS, points=[first, last]))

    def _feed(self) -> None:
        make_thread_timely(FEED_PRIORITY)
        start, count = time.perf_counter(), 0
        while self._running:
            self._fed.append(time.time())
            for publisher, source in ((self.states, self.robot), (self.references, self.planner)):
                for message in source():
                    publisher.publish(message)
            count += 1
            time.sleep(max(0.0, start + count / FEED - time.perf_counter()))

    def absence(self, begin: float, end: float) -> float:
        """Return for how long [s] a busy machine paused the stage, at most; 0 if not for long."""
        inside = [begin, *(moment for moment in list(self._fed) if begin < moment < end), end]
        longest = float(np.diff(inside).max())
        return longest if longest > OWN_PAUSE else 0.0

    # ---- what the nodes say

    def _spin(self) -> None:
        while self._running and rclpy.ok():
            self.executor.spin_once(0.1)

    def _keep_effort(self, message: Any) -> None:
        seconds = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        self._torque.append((time.time(), seconds, list(message.position), list(message.effort)))

    def _keep_diagnostics(self, message: Any) -> None:
        now = time.time()
        self.diagnostics += [(now, status) for status in message.status]

    def torques(self, begin: float, end: float) -> Torques:
        """Return the efforts that left between two moments [s], once they have come."""
        with suppress(StageError):
            self.until(lambda: self._torque and self._torque[-1][1] >= end, LAG, 'later torque')
        rows = [row[1:] for row in list(self._torque) if begin <= row[1] <= end]
        stamps, position, effort = zip(*rows, strict=True) if rows else ([],) * 3
        shape = (len(rows), len(JOINTS))
        return Torques(
            np.array(stamps),
            np.reshape(np.array(position, dtype=float), shape),
            np.reshape(np.array(effort, dtype=float), shape),
            self.absence(begin, end),
        )

    def commands(self) -> NDArray[np.float64]:
        """Return all commands that came (k, n)."""
        return np.array([message.data for message in list(self._commands)])

    def statuses(self, name: str, since: float) -> list[Any]:
        """Return the statuses of a name that came since a moment [s]."""
        return [s for moment, s in list(self.diagnostics) if moment >= since and s.name == name]

    def heard_at(self, name: str) -> float:
        """Return when a status came last [s], 0 if it never did."""
        return next((t for t, s in reversed(self.diagnostics) if s.name == name), 0.0)

    def count(self, name: str, key: str) -> int:
        """Return the newest value of a counter, 0 if there is none."""
        for _, status in reversed(self.diagnostics):
            if status.name == name:
                return int({v.key: v.value for v in status.values}.get(key, 0))
        return 0

    def following(self, since: float = 0.0) -> bool:
        """Say whether torques still come, the newest along the reference and of after `since`."""
        newest = self._torque[-SETTLED:]
        return (
            len(newest) == SETTLED
            and time.time() - newest[-1][0] < 0.1
            and all(position == GOAL and left > since for _, left, position, _ in newest)
        )

    def is_safe(self) -> bool:
        """Say whether the torque is no longer the reference's, once that can have been heard."""
        with suppress(StageError):
            self.until(lambda: not self.following(), LAG, 'the safe command')
        return not self.following()

    # ---- what is done

    def until(self, condition: Callable[[], object], timeout: float, what: str) -> float:
        """Wait for a condition; return how long that took [s]."""
        begin = time.perf_counter()
        while not condition():
            if time.perf_counter() - begin > timeout:
                raise StageError(f'{what} must come about within {timeout:g} s')
            time.sleep(0.005)
        return time.perf_counter() - begin

    def start(self, node: str, parameters: Mapping[str, Any]) -> None:
        """Start a node as a process."""
        file = self.folder / f'{node}.yaml'
        write_parameters(file, dict(parameters))
        arguments = ['-m', node_main(node), '--ros-args', '--params-file', str(file)]
        self.processes.start(node, arguments)

    def start_feedforward(self) -> float:
        """Start it and wait until it follows; return how long that took [s]."""
        self.robot, self.planner, self.clock_offset_ns = self.good_state, lambda: (), 0
        self.start('feedforward', {**PARAMETERS, 'urdf_path': str(self.urdf)})
        begin = time.perf_counter()
        self.until(self._hears, PATIENCE, 'feedforward: its subscriptions')
        return time.perf_counter() - begin + self.follow(PATIENCE)

    def _hears(self) -> bool:
        return bool(
            self.states.get_subscription_count() and self.references.get_subscription_count()
        )

    def follow(self, timeout: float = RECOVERY) -> float:
        """Ask for GOAL until it is followed; return how long that took [s]."""
        self.hold()
        begin = asked = time.time()

        def asked_again() -> bool:
            nonlocal asked
            if self.following(begin):
                return True
            if time.time() - asked > AGAIN:
                asked = time.time()
                self.hold()
            return False

        return self.until(asked_again, timeout, 'following the reference')

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """Return a service's reply."""
        client = self.node.create_client(kind, service)
        try:
            self.until(client.service_is_ready, 5.0, f'{service}: the service')
            future = client.call_async(request)
            self.until(future.done, 5.0, f'{service}: a reply')
            return future.result()
        finally:
            self.node.destroy_client(client)

    def reset(self) -> None:
        """Call the feedforward's ~/reset."""
        assert self.call(Trigger, '/feedforward/reset', Trigger.Request()).success

    def set_parameters(self, values: Sequence[tuple[str, Any]]) -> list[Any]:
        """Set parameters of the feedforward one by one; return the results."""
        request = SetParameters.Request(
            parameters=[Parameter(key, value=value).to_parameter_msg() for key, value in values]
        )
        return list(self.call(SetParameters, '/feedforward/set_parameters', request).results)

    def close(self) -> None:
        self._running = False
        for thread in self._threads:
            thread.join(2.0)
        self.processes.stop_all(())
        self.executor.remove_node(self.node)
        self.node.destroy_node()
        self.executor.shutdown()
        rclpy.try_shutdown()


def stamp(message: Any, stamp_ns: int) -> None:
    """Write a header's stamp."""
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    message.header.stamp.sec, message.header.stamp.nanosec = seconds, nanoseconds


@contextmanager
def staged(folder: Path) -> Iterator[Stage]:
    """Give a stage in a ROS domain of its own."""
    with domain() as environment:
        stage = Stage(folder, environment)
        try:
            yield stage
        finally:
            stage.close()
