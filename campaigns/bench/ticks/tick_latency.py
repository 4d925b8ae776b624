"""A whole tick of the flexible feedforward, message to message, beside an empty rclpy node.

Each node is a process of its own on loopback, in a domain of its own. A JointState of the robot's
joints goes to one node after another in blocks; each next message leaves a period after the reply
to the last, so that nothing queues. No gravity: the arm works in orbit. The feedforward node takes
every message as its tick: it differences accelerations, integrates the amplitudes over the stamps'
interval, works out the torque and publishes it. That torque is checked first, against the
library's own for the same messages.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from book.benchmarks.results import BenchCheck, BenchLine, Reach, relative_error
from book.benchmarks.timing import Times, ratio

from denoc_ros.cli.session.processes import free_domain
from denoc_ros.dynamics.driven.torque_feedforward import TorqueFeedforward
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.errors import DenocError
from denoc_ros.types import Array

ROBOT = Path(__file__).resolve().parents[3] / 'config' / 'robots' / 'ssrms.urdf'
ECHO = Path(__file__).resolve().parents[1] / 'loops' / 'echo_node.py'
REACH = 1.25
PERIOD = 1e-3  # s, of the stamps and between a reply and the next message
PATIENCE = 60.0  # s for a node to come up
REPLY = 2.0  # s for an answer
CUTOFF = 20.0  # Hz of the node's low pass on differenced accelerations, its default
TOLERANCE = 1e-9
FEEDFORWARD, ECHO_EVENTS, ECHO_DEFAULT = 'feedforward', 'echo_events', 'echo_default'


@dataclass
class Station:
    """The probe's end of one node: what it sends to, and what came back."""

    publisher: Any
    sent: int = 0
    replies: list[Any] = field(default_factory=list)
    blocks: list[Array] = field(default_factory=list)  # s, a call each

    def times(self) -> Times:
        every = np.concatenate(self.blocks)
        medians = np.array([np.median(block) for block in self.blocks])
        return Times(float(np.median(every)), float(np.percentile(every, 99)), medians)


class Probe:
    """Sends messages to the nodes and measures until the replies."""

    def __init__(self, joints: Sequence[str], names: Sequence[str]) -> None:
        import rclpy
        from rclpy.experimental import EventsExecutor
        from rclpy.node import Node
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from sensor_msgs.msg import JointState

        rclpy.init(args=[])
        self._ok = rclpy.ok
        self._shutdown = rclpy.try_shutdown
        qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
        self.node = Node('probe')
        self.executor = EventsExecutor()
        self.executor.add_node(self.node)
        self.message = JointState()
        self.message.name = list(joints)
        self.stations = {}
        for name in names:
            station = Station(self.node.create_publisher(JointState, f'/{name}/in', qos))
            self.node.create_subscription(
                JointState, f'/{name}/out', self._keeper(station), qos, raw=False
            )
            self.stations[name] = station

    def _keeper(self, station: Station) -> Any:
        def keep(message: Any) -> None:
            station.replies.append((time.perf_counter(), message))

        return keep

    def wait_for_nodes(self) -> None:
        end = time.perf_counter() + PATIENCE
        for name, station in self.stations.items():
            while station.publisher.get_subscription_count() == 0 or not self._replies(name):
                if time.perf_counter() > end:
                    raise DenocError(f'node {name!r} must answer within {PATIENCE} s')
                self.executor.spin_once(0.1)

    def _replies(self, name: str) -> bool:
        return bool(self.node.count_publishers(f'/{name}/out') > 0)

    def block(self, name: str, states: Sequence[tuple[Array, Array]]) -> None:
        """Send states one by one; keep what each took from its publishing to its reply."""
        station = self.stations[name]
        station.blocks.append(np.array([self.turn(station, *state) for state in states]))

    def turn(self, station: Station, q: Array, qd: Array) -> float:
        """Send one state, wait for the reply, then for the rest of a period [s]."""
        message = self.message
        station.sent += 1
        stamp_ns = round(1e9 * PERIOD) * station.sent
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        message.position = q.tolist()
        message.velocity = qd.tolist()
        message.effort = [0.0] * len(q)
        before = len(station.replies)
        start = time.perf_counter()
        station.publisher.publish(message)
        while len(station.replies) == before:
            self.executor.spin_once(REPLY)
            if time.perf_counter() - start > REPLY:
                raise DenocError(f'a reply must come within {REPLY} s, none to {station.sent}')
        arrived, _ = station.replies[-1]
        time.sleep(PERIOD)
        return float(arrived - start)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self._shutdown()


def motion(joints: int, first: int, count: int) -> list[tuple[Array, Array]]:
    """Return joint positions and rates of a slow swing at `count` periods after `first`."""
    t = PERIOD * np.arange(first, first + count)[:, None]
    phase = np.arange(joints)
    return list(zip(0.2 * np.sin(t + phase), 0.2 * np.cos(t + phase), strict=True))


def expected_torque(states: Sequence[tuple[Array, Array]]) -> list[Array]:
    """Return the torque of the library for the same messages, accelerations differenced."""
    robot = load_robot(ROBOT, gravity=(0.0, 0.0, 0.0))
    source = TorqueFeedforward(robot, step=PERIOD)
    share = 1.0 - np.exp(-2.0 * np.pi * CUTOFF * PERIOD)
    qdd, found = np.zeros(len(states[0][0])), []
    for k, (q, qd) in enumerate(states):
        if k > 0:
            qdd = qdd + share * ((qd - states[k - 1][1]) / PERIOD - qdd)
        found.append(source.update(q, qd, qdd, PERIOD if k else 0.0).copy())
    return found


@contextmanager
def started(command: Sequence[str]) -> Iterator[None]:
    """Run a process as long as the context lasts."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def commands() -> dict[str, list[str]]:
    """Return the nodes' command lines by the names of their topics."""
    feedforward = [sys.executable, '-m', 'denoc_ros.nodes.feedforward', '--ros-args']
    parameters = {
        'urdf_path': str(ROBOT),
        'model': 'flexible',
        'trigger': 'message',
        'reference_source': 'joint_states',
        'enforce_command_limits': 'false',
        'update_rate': str(1.0 / PERIOD),
        'gravity': '[0.0, 0.0, 0.0]',
    }
    for name, value in parameters.items():
        feedforward += ['-p', f'{name}:={value}']
    found = {
        FEEDFORWARD: feedforward,
        ECHO_EVENTS: [sys.executable, str(ECHO), 'events', '--ros-args'],
        ECHO_DEFAULT: [sys.executable, str(ECHO), 'default', '--ros-args'],
    }
    for name, command in found.items():
        ends = ('joint_states', '~/effort') if name == FEEDFORWARD else ('in', 'out')
        for topic, end in zip(ends, ('in', 'out'), strict=True):
            command += ['-r', f'{topic}:=/{name}/{end}']
        command += ['-r', f'__node:={name}']
    return found


def measure(blocks: int, count: int) -> list[BenchLine]:
    """Return the tick beside the two echoes.

    Parameters
    ----------
    blocks, count : int
        Blocks per node, and messages in each.
    """
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ['ROS_DOMAIN_ID'] = str(free_domain())
    joints = load_robot(ROBOT).joint_names
    with ExitStack() as stack:
        for command in commands().values():
            stack.enter_context(started(command))
        probe = Probe(joints, list(commands()))
        stack.callback(probe.close)
        probe.wait_for_nodes()
        checked = checked_replies(probe, len(joints), count)
        names = list(probe.stations)
        if checked.good:
            for block in range(1, blocks + 1):
                for turn in range(len(names)):
                    name = names[(turn + block) % len(names)]
                    probe.block(name, motion(len(joints), block * count, count))
    return lines(probe, checked)


def checked_replies(probe: Probe, joints: int, count: int) -> BenchCheck:
    """Send one block to every node, which warms them too, and compare the torque that came."""
    states = motion(joints, 0, count)
    for name in probe.stations:
        probe.block(name, states)
        probe.stations[name].blocks.clear()
    replies = probe.stations[FEEDFORWARD].replies
    torque = [np.array(message.effort) for _, message in replies]
    error = relative_error(torque, expected_torque(states))
    return BenchCheck('TorqueFeedforward on the same messages', error, TOLERANCE)


def lines(probe: Probe, checked: BenchCheck) -> list[BenchLine]:
    """Return the feedforward's line beside each echo; only the faster one's has a reach."""
    what = 'tick of the flexible feedforward, SSRMS, message to message'
    if not checked.good:
        return [BenchLine('tick', what, 'an empty node', checked)]
    ours = probe.stations[FEEDFORWARD].times()
    found = []
    for name, against, reach in (
        (ECHO_EVENTS, 'an empty rclpy node, EventsExecutor', Reach(REACH)),
        (ECHO_DEFAULT, 'an empty rclpy node, rclpy.spin', None),
    ):
        peer = probe.stations[name].times()
        found.append(
            BenchLine(
                'tick',
                what,
                against,
                checked,
                value=ratio(ours, peer),
                reach=reach,
                ours=ours,
                peer=peer,
            )
        )
    return found


def main(argv: Sequence[str] | None = None) -> int:
    from book.bench import line_text

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument('--blocks', type=int, default=15, help='per node')
    parser.add_argument('--count', type=int, default=200, help='messages in a block')
    parser.add_argument('--json', action='store_true', help='print machine-readable JSON')
    args = parser.parse_args(argv)
    try:
        found = measure(args.blocks, args.count)
    except DenocError as error:
        print(f'tick_latency: {error}', file=sys.stderr)
        return 1
    if args.json:
        print(json.dumps([line.record() for line in found], indent=2, allow_nan=False))
    else:
        print('\n'.join(line_text(line) for line in found))
    return 0 if all(line.check.good for line in found) else 2


if __name__ == '__main__':
    sys.exit(main())
