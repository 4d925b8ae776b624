"""Bytecodes and Python calls of a tick of plant, feedforward and predictor: no load changes them.

`python -m campaigns bytecodes --config config/ssrms.yaml`: the three nodes of a session in one
process, their ticks called in turn as their loops would, all topics listened to. A tracer counts
what the interpreter does; ticks without it give the thread's time (10 % quantile).
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import Any

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from ros_domains import claimed_domain
from trajectory_msgs.msg import JointTrajectory

from denoc_ros.cli.session.node_parameters import node_parameters, write_parameters
from denoc_ros.cli.session.session_config import load_config
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.nodes.base.messages import exact_bytes, message_class
from denoc_ros.nodes.feedforward import FeedforwardNode
from denoc_ros.nodes.plant import PlantNode
from denoc_ros.nodes.predictor import PredictorNode
from denoc_ros.nodes.session_client import reference_message
from denoc_ros.runtime.loop.realtime_loop import RealtimeLoop
from denoc_ros.simulation.reference_motion import trajectory_from_config

NODES = {'plant': PlantNode, 'feedforward': FeedforwardNode, 'predictor': PredictorNode}
DELIVERED = 0.002  # s until a message has come
LEAD = 0.2  # s until the reference begins
WARMUP = 300  # ticks before any counts
PACKAGE = 'denoc_ros'


class Tracer:
    """Counts bytecodes and calls of Python functions."""

    def __init__(self) -> None:
        self.bytecodes = self.calls = 0
        self.by_function: Counter[str] = Counter()

    def run(self, act: Callable[[], None]) -> None:
        sys.settrace(self._enter)
        try:
            act()
        finally:
            sys.settrace(None)

    def _enter(self, frame: FrameType, _event: str, _argument: object) -> Any:
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        self.calls += 1
        code = frame.f_code
        _, _, place = code.co_filename.partition(f'{PACKAGE}/')
        name = (
            f'{place or Path(code.co_filename).name} {getattr(code, "co_qualname", code.co_name)}'
        )

        def count(_frame: FrameType, event: str, _argument: object) -> Any:
            if event == 'opcode':
                self.bytecodes += 1
                self.by_function[name] += 1
            return count

        return count


def subscribe_to_all(node: Node, topics: Sequence[tuple[str, Sequence[str]]]) -> list[Any]:
    """Listen to all topics, so that everything is computed and sent."""
    qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    return [
        node.create_subscription(message_class(types[0]), topic, lambda _raw: None, qos, raw=True)
        for topic, types in topics
        if not topic.startswith('/_')
    ]


def made(config_file: Path, phase: int, folder: Path) -> dict[str, Any]:
    """Return the nodes of a session, configured, with loops that do not run."""
    config = load_config(config_file)
    nodes: dict[str, Any] = {}
    for name, kind in NODES.items():
        given = {**node_parameters(config, name, config.phases[phase], folder)}
        given |= {'urdf_path': str(config.robot)}
        write_parameters(folder / f'{name}.yaml', given)
        arguments = ['--ros-args', '--params-file', str(folder / f'{name}.yaml')]
        node = nodes[name] = kind(cli_args=arguments, use_global_arguments=False)
        node.trigger_configure()
        assert node.state == 'inactive', node.failure
    return nodes


def turn(node: Any, moment: float) -> None:
    node.loop.deadline = moment
    node._turn(1)


def follow(nodes: dict[str, Any], config_file: Path) -> None:
    """Have the feedforward and the predictor follow the session's reference."""
    config = load_config(config_file)
    robot = load_robot(config.robot, gravity=config.gravity)
    joints = list(config.joints or robot.tree.non_mimic_joints)
    trajectory = trajectory_from_config(config.reference, joints, 'reference')
    sender = Node('sender', use_global_arguments=False)
    publisher = sender.create_publisher(JointTrajectory, 'reference', 1)
    while publisher.get_subscription_count() < 2:
        time.sleep(0.01)
    begin_ns = time.time_ns() + round(1e9 * LEAD)
    publisher.publish(exact_bytes(reference_message(trajectory, joints, begin_ns)))
    time.sleep(0.1)
    for node in nodes.values():
        node._take_aside()


def measured(config_file: Path, phase: int, ticks: int) -> dict[str, dict[str, Any]]:
    """Return bytecodes, calls and thread time [us] of a tick, by node."""
    tracers = {name: Tracer() for name in NODES}
    spent: dict[str, list[float]] = {name: [] for name in NODES}
    with TemporaryDirectory() as folder:
        nodes = made(config_file, phase, Path(folder))
        probe = Node('probe', use_global_arguments=False)
        time.sleep(0.5)
        heard = subscribe_to_all(probe, probe.get_topic_names_and_types())
        for name, node in nodes.items():
            if name != 'plant':
                (getattr(node, 'sensors', None) or node.feedback).search()
            node.begin()
            node.loop = RealtimeLoop(node.settings.number('update_rate'), node._turn)
        follow(nodes, config_file)
        for count in range(WARMUP + 2 * ticks):
            for name, node in nodes.items():
                moment = time.perf_counter()
                if count < WARMUP or count % 2:
                    before = time.thread_time()
                    turn(node, moment)
                    if count >= WARMUP:
                        spent[name].append(time.thread_time() - before)
                else:
                    tracers[name].run(partial(turn, node, moment))
                time.sleep(DELIVERED)
        said = {name: [each.message for each in node.statuses()] for name, node in nodes.items()}
        del heard
    return {
        name: {
            'bytecodes': tracer.bytecodes / ticks,
            'calls': tracer.calls / ticks,
            'microseconds': 1e6 * float(np.quantile(spent[name], 0.1)),
            'says': said[name],
            'largest': [(what, n / ticks) for what, n in tracer.by_function.most_common(70)],
        }
        for name, tracer in tracers.items()
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--config', type=Path, default=Path('config/ssrms.yaml'))
    parser.add_argument('--phase', type=int, default=1, help='place of the phase')
    parser.add_argument('--ticks', type=int, default=300)
    parser.add_argument('--functions', action='store_true', help='by function as well')
    parser.add_argument('--json', action='store_true')
    args = parser.parse_args()
    with claimed_domain() as domain:
        os.environ['ROS_DOMAIN_ID'] = str(domain)
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        found = measured(args.config, args.phase, args.ticks)
        rclpy.try_shutdown()
    if args.json:
        print(json.dumps(found, indent=2))
        return 0
    for name, each in found.items():
        print(
            f'{name:12} {each["bytecodes"]:7.0f} bytecodes, {each["calls"]:5.1f} calls, '
            f'{each["microseconds"]:6.1f} us of the thread; {"; ".join(each["says"])}'
        )
        for what, count in each['largest'] if args.functions else ():
            print(f'    {count:7.1f}  {what}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
