"""The stage of the siege: all nodes as processes, and who feeds, watches and mends them.

The stage's own node is the robot (joint states, sensors) and the planner. Its witness
holds each torque to the laws as it comes; two processes beside it measure how long the system
itself was away (see `trust.absence`).
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from bench.loops.rates_blocks import domain
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import ParameterEvent
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from trust.adversary import interface
from trust.sieges.siege_gauges import Gauges
from trust.sieges.siege_payload import Estimates, Swing
from trust.sieges.siege_scenes import FEED, PRIORITY, Scene
from trust.stage import FEED_PRIORITY, StageError, StageProcesses, stamp
from trust.witness import DEEP, Witness

from denoc_ros.cli.session.node_parameters import write_parameters
from denoc_ros.dynamics.elastic.state_bounds import StateBounds
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.errors import StateError
from denoc_ros.kernels.jit.cache import cache_folder
from denoc_ros.nodes.base.messages import time_message
from denoc_ros.nodes.base.middleware import PROFILES, use_sockets
from denoc_ros.parts import node_main
from denoc_ros.runtime.loop.realtime import make_thread_timely

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LOOK = 0.02  # s between two looks of the witness
DUMP = 5.0  # s that printing the threads may take
ANSWER = 60.0  # s within which a request is answered, on a busy machine
RECOVERY = 60.0  # s within which all is as before an attack
PATIENCE = 400.0  # s for a process to come up: a busy machine may take minutes to compile kernels
FRESH = 0.5  # s
SIMULATION_START = 1000 * 1_000_000_000  # ns
RELAYED = '/siege/commands'  # what left as torque, said to the plant by the stage
GET_STATE = GetState.Request()
OUTPUTS = {'predictor': '/predictor/modal_state', 'plant': '/plant/true_modal_state'}


class SiegeStage:
    """See the module.

    Attributes
    ----------
    witness : Witness
    kernels : Path
        Compiled ones that the nodes load, of this stage only.
    heard : dict of str to float
        When (perf_counter, s) each node's output came last.
    broken : list of str
        Laws broken beside those of torque.
    """

    def __init__(
        self, folder: Path, environment: Mapping[str, str], scene: Scene, slack: float
    ) -> None:
        self.folder, self.scene = folder, scene
        (folder / 'logs').mkdir(parents=True)
        self.kernels = own_kernels(folder)
        environment = {**environment, 'NUMBA_CACHE_DIR': str(self.kernels)}
        self.processes = StageProcesses(folder / 'logs', environment)
        self.heard: dict[str, float] = {}
        self.statuses: dict[str, Any] = {}
        self.broken: list[str] = []
        self.instead = 0  # attacks that speak in the robot's place
        self.fed = 0
        self.longest_answer = 0.0  # s
        self.aborted: set[str] = set()  # nodes whose end has been told of
        self.starts: Counter[str] = Counter()
        self.up: set[str] = set()  # nodes that have been active since their start
        self._meter: Any = None
        self._clients: dict[str, Any] = {}
        self._publishers: dict[str, Any] = {}
        self._lock = threading.RLock()
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node('siege', use_global_arguments=False)
        self.states = self.publisher('/joint_states', JointState)
        self.references = self.publisher('/reference', JointTrajectory)
        self.planned = self.publisher(scene.plans_for, JointTrajectory)
        relay = self.publisher(RELAYED, Float64MultiArray)
        self.witness = Witness(scene, folder, slack, relay.publish)
        for topic, kind in scene.sensors.items():
            self.publisher(topic, interface(kind))
        self.gauges = Gauges(scene.gauges)
        self.swing = Swing(FEED) if scene.adapts else None
        self.estimates = Estimates()
        self.attacked = {'/joint_states', '/reference', scene.plans_for, RELAYED, *scene.sensors}
        self.description = self.publisher('/robot_description', String, LATCHED)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_status, DEEP)
        robot = load_robot(scene.urdf(), gravity=scene.gravity)
        self._coordinates = list(robot.coordinate_names)
        self._bounds = StateBounds(robot, np.zeros(robot.n))
        for name, topic in OUTPUTS.items():
            self.node.create_subscription(JointState, topic, self._listener(name), 10)
        if scene.adapts:
            self._listen_to_estimates()
        self._running = True
        self._begin_ns = time.time_ns()
        self.executor = EventsExecutor()
        self.executor.add_node(self.node)
        self._threads = [
            threading.Thread(target=work, daemon=True)
            for work in (self._spin, self._feed, self._watch)
        ]
        for thread in self._threads:
            thread.start()
        self.say_description()

    # ---- what the robot, the planner and the attacks say

    def publisher(self, topic: str, kind: type, qos: Any = 10) -> Any:
        """Return the stage's one publisher of a topic, by which attacks speak as well."""
        with self._lock:
            if topic not in self._publishers:
                self._publishers[topic] = self.node.create_publisher(kind, topic, qos)
            return self._publishers[topic]

    def now_ns(self) -> int:
        """Return the time of the robot [ns]: of the scene's simulation, if it is one."""
        if not self.scene.factor:
            return time.time_ns()
        return SIMULATION_START + round(self.scene.factor * (time.time_ns() - self._begin_ns))

    def state(self) -> JointState:
        """Return what a good robot says now."""
        if self.swing is not None:
            return self.swing.state(self.now_ns())
        names, positions = list(self.scene.joints), list(self.scene.posture)
        message = JointState(name=names, position=positions, effort=[0.0] * len(names))
        stamp(message, self.now_ns())
        return message

    def trajectory(self, seconds: float = 0.001) -> JointTrajectory:
        """Return a reference that stands at the goal."""
        first, last = (JointTrajectoryPoint(positions=list(self.scene.goal)) for _ in range(2))
        last.time_from_start.sec, rest = divmod(round(1e9 * seconds), 1_000_000_000)
        last.time_from_start.nanosec = rest
        return JointTrajectory(joint_names=list(self.scene.joints), points=[first, last])

    def say_description(self) -> None:
        """Publish the good robot's description."""
        self.description.publish(String(data=self.scene.urdf()))

    def _feed(self) -> None:
        make_thread_timely(FEED_PRIORITY)
        start, count, told_ns = time.perf_counter(), 0, time.time_ns()
        while self._running:
            if not self.instead:
                self.states.publish(self.state())
                self.fed += 1
                for message in self.gauges.messages(self.now_ns()):
                    self._publishers['/strain'].publish(message)
            if self.scene.factor:
                self.publisher('/clock', Clock).publish(Clock(clock=time_message(self.now_ns())))
                before_ns, told_ns = told_ns, time.time_ns()
                self.witness.await_clock(before_ns, told_ns, 1.0 / FEED)
            count += 1
            time.sleep(max(0.0, start + count / FEED - time.perf_counter()))

    @contextmanager
    def silenced(self) -> Iterator[None]:
        """Say nothing as the robot meanwhile."""
        with self._lock:
            self.instead += 1
        try:
            yield
        finally:
            with self._lock:
                self.instead -= 1

    # ---- what the nodes say

    def _spin(self) -> None:
        while self._running and rclpy.ok():
            self.executor.spin_once(0.1)

    def _on_status(self, message: Any) -> None:
        for status in message.status:
            self.statuses[status.name] = (time.perf_counter(), status)

    def _listener(self, name: str) -> Callable[[Any], None]:
        def listen(message: Any) -> None:
            self.heard[name] = time.perf_counter()
            position, velocity = np.array(message.position), np.array(message.velocity)
            if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
                self.broken.append(f'{name}: what it publishes must be finite')
            elif list(message.name) == self._coordinates:  # an attack may bring another robot
                try:
                    self._bounds.require(position, velocity)
                except StateError as error:
                    self.broken.append(f'{name}: state must be one of the robot, got {error}')

        return listen

    def _listen_to_estimates(self) -> None:
        topic, take = '/predictor/model_parameters', self.estimates
        self.node.create_subscription(JointState, topic, take.take, DEEP)
        self.node.create_subscription(ParameterEvent, '/parameter_events', take.take_event, DEEP)

    def _watch(self) -> None:
        while self._running:
            self.witness.look()
            time.sleep(LOOK)

    def judge(self, final: bool = False) -> list[str]:
        """Return the laws that were broken since the last call."""
        told, self.broken = self.broken, []
        return [*told, *self.estimates.told(), *self.witness.judge(final)]

    def status(self, name: str, since: float = 0.0) -> tuple[int, str, dict[str, str]]:
        """Return level (-1: none), message and values of a status since a moment."""
        at, status = self.statuses.get(name, (-1.0, None))
        if at < since or status is None:
            return -1, '', {}
        level = int.from_bytes(status.level, 'little')
        return level, status.message, {value.key: value.value for value in status.values}

    # ---- processes

    def start(self, node: str) -> None:
        """Start a node as a process."""
        file = self.folder / f'{node}.yaml'
        self.starts[node] += 1
        self.up.discard(node)
        self.aborted.discard(node)
        if node == 'predictor':
            self.estimates.restart()
        bags = self.folder / f'recordings_{self.starts[node]}'
        bags.mkdir(exist_ok=True)
        write_parameters(file, self.scene.parameters(node, bags))
        arguments = ['-m', node_main(node), '--ros-args', *self.scene.remapped(node)]
        self.processes.start(node, [*arguments, '--params-file', str(file)])
        self._meter.stdin.write(f'{node} {self.process(node).pid}\n'.encode())
        self._meter.stdin.flush()

    def process(self, node: str) -> subprocess.Popen[bytes]:
        """Return the newest process of a node."""
        return self.processes.process(node)

    def abort(self, node: str) -> None:
        """End a process that does not end, or answer, otherwise, and print where it stood."""
        process = self.process(node)
        if process.poll() is None:
            self.aborted.add(node)
            process.send_signal(signal.SIGABRT)
            self.comes(lambda: process.poll() is not None, DUMP)
            print(self.words(node), flush=True)
        process.kill()
        process.wait()

    def words(self, node: str) -> str:
        """Return the last that a node has printed, without the list of its modules."""
        text = (self.folder / 'logs' / f'{node}.log').read_text(errors='replace')
        return re.sub(r'^Extension modules: .*\n?', '', text, flags=re.M)[-3000:]

    def start_all(self) -> None:
        """Start what measures, then all nodes; wait until each does what it is for."""
        module = [sys.executable, '-m', 'trust.absence']
        self._meter = subprocess.Popen(
            [*module, 'meter', str(self.folder / 'meter')], stdin=subprocess.PIPE
        )
        publisher = ['publisher', str(self.scene.rate), str(PRIORITY), str(self.folder / 'bare')]
        self.processes.start('bare', ['-m', 'trust.absence', *publisher])
        self._meter.stdin.write(f'stage {os.getpid()}\n'.encode())
        for node in self.scene.nodes:
            self.start(node)

    # ---- requests

    def client(self, service: str, kind: str) -> Any:
        with self._lock:
            if service not in self._clients:
                self._clients[service] = self.node.create_client(interface(kind), service)
            return self._clients[service]

    def ask(self, service: str, kind: str, request: Any, timeout: float = ANSWER) -> Any:
        """Return a service's reply, None if none came in time [s] or the node has ended."""
        client = self.client(service, kind)
        process = self.process(service.split('/')[1])

        def ended() -> bool:
            return process.poll() is not None

        self.comes(lambda: client.service_is_ready() or ended(), timeout)
        if ended() or not client.service_is_ready():
            return None
        begin = time.perf_counter()
        future = client.call_async(request)
        self.comes(lambda: future.done() or ended(), timeout)
        if future.done():
            self.longest_answer = max(self.longest_answer, time.perf_counter() - begin)
            return future.result()
        client.remove_pending_request(future)
        return None

    def ask_again(self, service: str, kind: str, request: Any, timeout: float = ANSWER) -> Any:
        """Return a reply; ask anew where one got lost, as it may while server and client meet."""
        end = time.perf_counter() + timeout
        process = self.process(service.split('/')[1])
        while (left := end - time.perf_counter()) > 0.0 and process.poll() is None:
            reply = self.ask(service, kind, request, min(10.0, left))
            if reply is not None:
                return reply
        raise StageError(f'{service}: must be answered within {timeout:g} s')

    def comes(self, condition: Callable[[], object], timeout: float) -> bool:
        """Wait for a condition; say whether it came about."""
        end = time.perf_counter() + timeout
        while not condition():
            if time.perf_counter() > end or not self._running:
                return False
            time.sleep(0.003)
        return True

    def lifecycle(self, node: str, timeout: float = ANSWER) -> str:
        """Return the label of a node's state."""
        kind = 'lifecycle_msgs/srv/GetState'
        reply = self.ask_again(f'/{node}/get_state', kind, GET_STATE, timeout)
        return str(reply.current_state.label)

    def change(self, node: str, transition: int, timeout: float = ANSWER) -> bool:
        """Ask for a transition; say whether it succeeded."""
        request = ChangeState.Request()
        request.transition.id = transition
        kind = 'lifecycle_msgs/srv/ChangeState'
        return bool(self.ask_again(f'/{node}/change_state', kind, request, timeout).success)

    def close(self) -> None:
        """End all processes, then the stage's own node."""
        self._running = False
        for thread in self._threads:
            thread.join(3.0)
        for node in self.scene.nodes:  # a stopped one hears nothing
            with suppress(KeyError, ProcessLookupError):
                self.process(node).send_signal(signal.SIGCONT)
        self.processes.stop_all(self.scene.nodes)
        if self._meter is not None:
            self._meter.stdin.close()
            self._meter.wait(5.0)
        self.executor.remove_node(self.node)
        for node in (self.node, self.witness.node):
            node.destroy_node()
        self.executor.shutdown()
        rclpy.try_shutdown()


def own_kernels(folder: Path) -> Path:
    """Return a folder with a copy of the user's compiled kernels, which attacks may damage."""
    kept, own = cache_folder(), folder / 'kernels'
    own.mkdir(mode=0o700)
    if kept is not None and kept.is_dir():
        shutil.copytree(kept, own / kept.name)
    return own


@contextmanager
def wide_sockets(environment: dict[str, str]) -> Iterator[None]:
    """Let this process have the nodes' sockets, which hold what comes while it waits for a core.

    Its children, with `environment`, choose theirs themselves.
    """
    before = os.environ.get(PROFILES, '')
    use_sockets()
    environment[PROFILES] = before
    try:
        yield
    finally:
        os.environ[PROFILES] = before


@contextmanager
def besieged(folder: Path, scene: Scene, slack: float) -> Iterator[SiegeStage]:
    """Give a stage in a ROS domain of its own, its processes started.

    Parameters
    ----------
    folder : Path
    scene : Scene
    slack : float
        s that torque may pause beyond the law: for a machine that does other things.
    """
    with domain() as environment, wide_sockets(environment):
        stage = SiegeStage(folder, environment, scene, slack)
        try:
            stage.start_all()
            yield stage
        finally:
            stage.close()
